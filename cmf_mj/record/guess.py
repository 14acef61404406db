"""A guess of the columns of a recording from their names, as a map to read and correct.

Six names that differ in one number 1 to 6, or 0 to 5, or one letter a to f, are the legs of one
channel; six with the words of six axes are a pose. Words, also two joined as in `Xcmd`, say which
channel: pos, length; ref, cmd, set; vel; cap, pa; rod, pb; valve, u. Units stand in brackets
or at the end: `p1 [bar]`, `x1_mm`, `v1_mm_s`. A last word that may be a unit or not, as in
`pose_psi` and `valve_in`, is one only if the words before it name something of that unit.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.columns import CHANNELS, POSES, si_units
from cmf_mj.record.sources import Source, even_clock, read_source

_PRESSURES = "p prs pressure press druck"
_CAP, _ROD = "cap pcap head bore pa pc pk", "rod prod annulus ann pb pr ps"
_LENGTHS = "x l s pos position length len ext extension stroke leg act cyl weg hub"
_CHANNELS = (
    ("demand_pose", "pose"),
    ("platform_pose", "pose"),
    ("valve_command", "valve vlv ventil servo sv spool u current ma"),
    ("compensator_output", "cmp compensator controller"),
    ("leg_velocity", "vel velocity speed v xdot dx"),
    ("leg_acceleration", "acc acceleration accel a xddot ddx"),
    ("rod_pressure", _ROD),
    ("cap_pressure", _CAP),
    ("cap_pressure", _PRESSURES),
    ("rod_pressure", _PRESSURES),
    ("leg_reference", f"{_LENGTHS} soll"),
    ("leg_position", f"{_LENGTHS} feedback fdk ist"),
)
"""Words of names by channel; an earlier entry is preferred."""

_DEMAND = "ref reference cmd dmd demand demanded dem set setpoint sp target desired xd soll"
_DEMAND_WORDS = {*_DEMAND.split()}  #: Names of demands have one, names of measurements none.
_DEMAND_CHANNELS = ("demand_pose", "leg_reference")
_UNDECIDED_CHANNELS = ("valve_command", "compensator_output")  #: Their names may have one or not.

_POSE_UNITS = si_units("demand_pose")
_AXES = ("surge x px", "sway y py", "heave z pz", "roll phi rx", "pitch theta ry", "yaw psi rz")
_TIME = {*"time t zeit timestamp date sec seconds clock".split()}
_MEANINGS = [({*words.split()}, si_units(channel)[0]) for channel, words in _CHANNELS]
_MEANINGS += [(_TIME, "s"), *zip(({*axis.split()} for axis in _AXES), _POSE_UNITS, strict=True)]
"""Words of names, and the SI unit of what they name."""
_WORDS = _DEMAND_WORDS.union(*(words for words, _ in _MEANINGS))

_UNITS = "m mm cm Pa kPa MPa N kN bar psi in ft lbf deg rad"
_UNIT_SPELLING = {unit.lower(): unit for unit in _UNITS.split()}
_UNIT_SPELLING |= {unit: unit for unit in "s ms us % 1 g".split()}
_UNIT_SPELLING |= {"sec": "s", "msec": "ms", "°": "deg", "pct": "%", "percent": "%", "inch": "in"}
_TRAILING_UNITS = {*_UNIT_SPELLING} - {"1", "g"}  #: Units that may be the last word of a name.
_UNITS_OR_WORDS = _TRAILING_UNITS & {*_WORDS, "in"}  #: Which are words of names too.
_LABELS = ("123456", "012345", "abcdef")
_DEFAULT_UNITS = {"m": "mm", "m/s": "mm/s", "m/s^2": "m/s^2", "Pa": "bar", "1": "%"}
"""Units of the field where a name states none, for the reader to correct."""


class _NameParts(NamedTuple):
    """What the name of a column says."""

    words: set[str]  #: In lower case.
    unit: str  #: Empty where neither the file nor the name states one.

    def may_be(self, si_unit: str) -> bool:
        return not self.unit or units.si_unit(self.unit) == si_unit


def _name_parts(source: Source, name: str) -> _NameParts:
    """Words of a column's name, and the unit that the file or the name states."""
    bracket = re.search(r"[\[(]([^\])]*)[\])]", name)
    plain = re.sub(r"[\[(][^\])]*[\])]", "", name)
    pattern = r"mA\b|[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[%°]+"
    words = [word.lower() for word in re.findall(pattern, plain)]
    unit = _unit(source.units.get(name) or (bracket[1] if bracket else ""))
    for size in (2, 1):  # mm_s, mm
        words_before, last_words = words[:-size], words[-size:]
        if unit or not words_before or not {*last_words} <= _TRAILING_UNITS:
            continue
        last_unit = _unit("/".join(last_words))
        expected_units = {unit for meaning, unit in _MEANINGS if meaning & _split(words_before)}
        is_unambiguous = size == 2 or words[-1] not in _UNITS_OR_WORDS
        if last_unit and (is_unambiguous or units.si_unit(last_unit) in expected_units):
            words, unit = words_before, last_unit
    return _NameParts(_split(words), unit)


def _split(words: list[str]) -> set[str]:
    """Words, and in place of one such as `xcmd` the two that it joins."""
    parts = set[str]()
    for word in words:
        pairs = ({word[:k], word[k:]} for k in range(1, len(word)))
        known_pair = next((pair for pair in pairs if pair <= _WORDS), {word})
        parts |= {word} if word in _WORDS else known_pair
    return parts


def _unit(text: str) -> str:
    """A unit as this project spells it, empty where it has none."""
    text = text.strip().replace("²", "^2").replace("s2", "s^2")
    unit = "/".join(_UNIT_SPELLING.get(part.strip().lower(), part) for part in text.split("/"))
    return unit if units.is_known(unit) else ""


def _leg_patterns(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Patterns with {leg} that six names fit, and the six labels."""
    for name in names:
        for label in re.finditer(r"\d|(?<![a-zA-Z])[a-fA-F](?![a-zA-Z])", name):
            pattern = f"{name[: label.start()]}{{leg}}{name[label.end() :]}"
            for lower_labels in _LABELS:
                labels = lower_labels.upper() if label[0].isupper() else lower_labels
                if labels.startswith(label[0]) and {*_leg_names(pattern, labels)} <= {*names}:
                    yield pattern, labels


def _leg_names(pattern: str, labels: str) -> list[str]:
    return [pattern.replace("{leg}", label) for label in labels]


def _channel(parts: _NameParts, used_channels: Collection[str]) -> str | None:
    """The first unused channel whose words a name has, and whose unit fits."""
    for channel, channel_words in _CHANNELS:
        fits = parts.may_be(si_units(channel)[0]) and channel not in used_channels
        is_demand = channel in _DEMAND_CHANNELS
        fits &= channel in _UNDECIDED_CHANNELS or is_demand == bool(parts.words & _DEMAND_WORDS)
        if fits and parts.words & {*channel_words.split()}:
            return channel
    return None


def _description(
    channel: str, names: Mapping[str, _NameParts], doubts: list[str]
) -> dict[str, Any]:
    """Columns and units of a channel by its six names; what is a guess goes to the doubts."""
    unit = [
        parts.unit or (si_unit if channel in POSES else _DEFAULT_UNITS[si_unit])
        for parts, si_unit in zip(names.values(), si_units(channel), strict=True)
    ]
    if unitless_names := [name for name, parts in names.items() if not parts.unit]:
        doubts.append(f"{channel}: no unit in {unitless_names[0]!r}: the one below is a guess")
    name, parts = next(iter(names.items()))
    if CHANNELS[channel] == "Pa" and not parts.words & {*f"{_CAP} {_ROD}".split()}:
        side = channel.removesuffix("_pressure")
        doubts.append(f"{channel}: {name!r} names no side of the piston: {side} is a guess")
    return {"columns": [*names], "unit": unit if len({*unit}) > 1 else unit[0]}


def _pose_columns(names: Mapping[str, _NameParts], is_demand: bool) -> dict[str, str]:
    """Columns of a pose by degree of freedom, of those with a unit first."""
    column_of: dict[str, str] = {}
    for name, parts in sorted(names.items(), key=lambda item: not item[1].unit):
        for dof, axis_words, si_unit in zip(DOFS, _AXES, _POSE_UNITS, strict=True):
            fits = parts.may_be(si_unit) and bool(parts.words & _DEMAND_WORDS) == is_demand
            if fits and parts.words & {*axis_words.split()}:
                column_of.setdefault(dof, name)
    return column_of


def guess_columns(path: str | Path) -> str:
    """A map of a file's columns, as TOML text; what was not recognised is in comments."""
    source = read_source(path)
    names = {name: _name_parts(source, name) for name in source.columns}
    channels, doubts, leg_labels = dict[str, Any](), list[str](), ""
    time = _time(source, names, doubts)
    names.pop(time.get("column", ""), None)
    patterns = list(_leg_patterns([*names]))
    names_of_legs = {name for pattern in patterns for name in _leg_names(*pattern)}
    for pattern, labels in patterns:
        columns = _leg_names(pattern, labels)
        channel = _channel(names[columns[0]], channels) if {*columns} <= {*names} else None
        if channel is not None:
            leg_labels = leg_labels or labels
            names_of_channel = {name: names.pop(name) for name in columns}
            channels[channel] = _description(channel, names_of_channel, doubts)
            if labels == leg_labels:
                channels[channel]["columns"] = pattern
    for channel in POSES:
        candidates = {name: names[name] for name in names if name not in names_of_legs}
        column_of = _pose_columns(candidates, channel in _DEMAND_CHANNELS)
        if channel not in channels and len({*column_of.values()}) == 6:
            names_of_channel = {column_of[dof]: names.pop(column_of[dof]) for dof in DOFS}
            channels[channel] = _description(channel, names_of_channel, doubts)
    lines = ["A guess from the header: read it, correct it, then `cmf recording check`.", *doubts]
    lines += [f"not recognised: {', '.join(names)}"] if names else []
    lines.append(f"other channels: {', '.join(name for name in CHANNELS if name not in channels)}")
    table = {"legs": [*leg_labels]} if leg_labels not in ("", _LABELS[0]) else {}
    text = tomlkit.dumps(table | {"time": time, "channels": channels})
    return "".join(f"# {line}\n" for line in lines) + "\n" + text


def _time(source: Source, names: Mapping[str, _NameParts], doubts: list[str]) -> dict[str, Any]:
    """The time column, its unit by its name, else the first that makes 10 Hz or more."""
    for name, (words, unit) in names.items():
        if words & _TIME and names[name].may_be("s"):
            step = float(np.median(np.diff(source.columns[name])))
            if not unit:
                fast_units = [unit for unit in ("s", "ms") if step * units.factor(unit) < 0.101]
                unit = [*fast_units, "us"][0]
                doubts.append(f"time: no unit in {name!r}: {unit!r} is a guess")
            try:
                even_clock(units.to_si(unit, source.columns[name]))
            except InputError as error:
                doubts.append(f"{error}; resampled below")
                rate = float(f"{1.0 / units.to_si(unit, step):.3g}") if step > 0.0 else 500.0
                return {"column": name, "unit": unit, "resample": rate}
            return {"column": name, "unit": unit}
    doubts.append("time: no column was recognised: the rate [Hz] below is a guess")
    return {"rate": 500.0}
