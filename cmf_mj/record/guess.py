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
from typing import Any

import numpy as np
import tomlkit

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.columns import CHANNELS, POSES
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
_DEMAND_WORDS = {*_DEMAND.split()}
"""Words that names of demands have and names of measurements have not."""
_DEMAND_CHANNELS = ("demand_pose", "leg_reference")
_UNDECIDED_CHANNELS = ("valve_command", "compensator_output")
"""Channels whose names may have such words or not."""

_POSE_UNITS = ("m", "m", "m", "rad", "rad", "rad")
_AXES = ("surge x px", "sway y py", "heave z pz", "roll phi rx", "pitch theta ry", "yaw psi rz")
_TIME = {*"time t zeit timestamp date sec seconds clock".split()}
_MEANINGS = [({*words.split()}, CHANNELS[name].partition(",")[0]) for name, words in _CHANNELS]
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


_Name = tuple[set[str], str]  #: Words of a name, and its unit, empty where none is stated.


def _words_and_unit(source: Source, name: str) -> _Name:
    """Words of a name, in lower case, and the unit that the file or the name states."""
    bracket = re.search(r"[\[(]([^\])]*)[\])]", name)
    plain = re.sub(r"[\[(][^\])]*[\])]", "", name)
    words = re.findall(r"mA\b|[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[%°]+", plain)
    words = [word.lower() for word in words]
    unit = _unit(source.units.get(name) or (bracket[1] if bracket else ""))
    for size in (2, 1):  # mm_s, mm
        rest, last = words[:-size], words[-size:]
        if not unit and rest and {*last} <= _TRAILING_UNITS and (found := _unit("/".join(last))):
            due = {si for meaning, si in _MEANINGS if meaning & _split(rest)}
            if size == 2 or last[0] not in _UNITS_OR_WORDS or units.si_unit(found) in due:
                words, unit = rest, found
    return _split(words), unit


def _split(words: list[str]) -> set[str]:
    """Words, and in place of one such as `xcmd` the two that it joins."""
    parts = set[str]()
    for word in words:
        cuts = ({word[:k], word[k:]} for k in range(1, len(word)))
        known = next((cut for cut in cuts if cut <= _WORDS), {word})
        parts |= {word} if word in _WORDS else known
    return parts


def _unit(text: str) -> str:
    """A unit as this project spells it, empty where it has none."""
    text = text.strip().replace("²", "^2").replace("s2", "s^2")
    unit = "/".join(_UNIT_SPELLING.get(part.strip().lower(), part) for part in text.split("/"))
    return unit if units.is_known(unit) else ""


def _leg_patterns(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Patterns with {leg} that six names fit, and the six labels."""
    for name in names:
        for spot in re.finditer(r"\d|(?<![a-zA-Z])[a-fA-F](?![a-zA-Z])", name):
            pattern = f"{name[: spot.start()]}{{leg}}{name[spot.end() :]}"
            for labels in _LABELS:
                each = labels.upper() if spot[0].isupper() else labels
                if spot[0] == each[0] and all(pattern.replace("{leg}", k) in names for k in each):
                    yield pattern, each


def _channel(words: set[str], unit: str, taken: Collection[str]) -> str | None:
    """The first channel whose words a name has, and whose unit fits."""
    asked = bool(words & _DEMAND_WORDS)
    for channel, known in _CHANNELS:
        due = CHANNELS[channel].partition(",")[0]
        fits = (not unit or units.si_unit(unit) == due) and channel not in taken
        decided = channel in _UNDECIDED_CHANNELS or (channel in _DEMAND_CHANNELS) == asked
        if fits and decided and words & {*known.split()}:
            return channel
    return None


def _described(channel: str, names: Mapping[str, _Name], doubts: list[str]) -> dict[str, Any]:
    """Columns and units of a channel by its six names; what is a guess goes to the doubts."""
    si = _POSE_UNITS if channel in POSES else (CHANNELS[channel],) * 6
    usual = dict(zip(si, si, strict=True)) if channel in POSES else _DEFAULT_UNITS
    unit = [one or usual[due] for (_, one), due in zip(names.values(), si, strict=True)]
    if bare := [name for name, (_, one) in names.items() if not one]:
        doubts.append(f"{channel}: no unit in {bare[0]!r}: the one below is a guess")
    name, (words, _) = next(iter(names.items()))
    if CHANNELS[channel] == "Pa" and not words & {*f"{_CAP} {_ROD}".split()}:
        side = channel.removesuffix("_pressure")
        doubts.append(f"{channel}: {name!r} names no side of the piston: {side} is a guess")
    return {"columns": [*names], "unit": unit if len({*unit}) > 1 else unit[0]}


def guess_columns(path: str | Path) -> str:
    """A map of a file's columns, as TOML text; what was not recognised is in comments."""
    source = read_source(path)
    names = {name: _words_and_unit(source, name) for name in source.columns}
    channels: dict[str, Any] = {}
    doubts: list[str] = []
    time = _time(source, names, doubts)
    leg_labels = ""
    left = {name: named for name, named in names.items() if name != time.get("column")}

    def take(channel: str, taken: list[str]) -> None:
        channels[channel] = _described(channel, {name: left.pop(name) for name in taken}, doubts)

    patterns = list(_leg_patterns([*left]))
    alike = {pattern.replace("{leg}", one) for pattern, labels in patterns for one in labels}
    for pattern, labels in patterns:
        taken = [pattern.replace("{leg}", label) for label in labels]
        channel = _channel(*names[taken[0]], channels) if {*taken} <= {*left} else None
        if channel is not None:
            leg_labels = leg_labels or labels
            take(channel, taken)
            if labels == leg_labels:
                channels[channel]["columns"] = pattern
    for channel, asked in zip(POSES, (True, False), strict=True):
        found: dict[str, str] = {}
        for name in sorted(left, key=lambda one: not names[one][1]):  # those with a unit first
            words, unit = names[name]
            for dof, known, si in zip(DOFS, _AXES, _POSE_UNITS, strict=True):
                fits = name not in alike and (not unit or units.si_unit(unit) == si)
                if fits and words & {*known.split()} and bool(words & _DEMAND_WORDS) == asked:
                    found.setdefault(dof, name)
        if channel not in channels and len({*found.values()}) == 6:
            take(channel, [found[dof] for dof in DOFS])
    lines = ["A guess from the header: read it, correct it, then `cmf recording check`.", *doubts]
    lines += [f"not recognised: {', '.join(left)}"] if left else []
    lines.append(f"other channels: {', '.join(one for one in CHANNELS if one not in channels)}")
    table = {"legs": [*leg_labels]} if leg_labels not in ("", _LABELS[0]) else {}
    text = tomlkit.dumps(table | {"time": time, "channels": channels})
    return "".join(f"# {line}\n" for line in lines) + "\n" + text


def _time(source: Source, names: dict[str, _Name], doubts: list[str]) -> dict[str, Any]:
    """The time column, its unit by its name, else the first that makes 10 Hz or more."""
    for name, (words, unit) in names.items():
        if words & _TIME and (not unit or units.si_unit(unit) == "s"):
            step = float(np.median(np.diff(source.columns[name])))
            if not unit:
                unit = next((one for one in ("s", "ms") if step * units.factor(one) < 0.101), "us")
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
