"""A guess of the columns of a recording from their names, as a map to read and correct.

Six names that differ in one number 1 to 6, or 0 to 5, or one letter a to f, are the legs of one
channel; six with the words of six axes are a pose. Words, also two joined as in `Xcmd`, say which
channel: pos, length; ref, cmd, set; vel; cap, pa; rod, pb; valve, u. Units stand in brackets
or at the end: `p1 [bar]`, `x1_mm`, `v1_mm_s`.
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.columns import CHANNELS, POSES
from cmf_mj.record.sources import Source, even_clock, read_source

_LENGTHS = "x l s pos position length len ext extension stroke leg act cyl weg hub"
_CHANNELS = (
    ("demand_pose", "pose"),
    ("platform_pose", "pose"),
    ("valve_command", "valve vlv ventil servo sv spool u current ma"),
    ("compensator_output", "cmp compensator controller"),
    ("leg_velocity", "vel velocity speed v xdot dx"),
    ("leg_acceleration", "acc acceleration accel a xddot ddx"),
    ("rod_pressure", "rod prod annulus ann pb pr ps"),
    ("cap_pressure", "cap pcap head bore pa pc pk"),
    ("cap_pressure", "p prs pressure press druck"),
    ("rod_pressure", "p prs pressure press druck"),
    ("leg_reference", f"{_LENGTHS} soll"),
    ("leg_position", f"{_LENGTHS} feedback fdk ist"),
)
"""Words of names by channel; an earlier entry is preferred."""

_DEMAND = {*"ref reference cmd dmd demand demanded dem set setpoint sp".split()}
_DEMAND |= {*"target desired xd soll".split()}
"""Words of what is asked for, which these channels have and those that are measured have not."""
_ASKED, _EITHER = ("demand_pose", "leg_reference"), ("valve_command", "compensator_output")

_AXES = ("surge x px", "sway y py", "heave z pz", "roll phi rx", "pitch theta ry", "yaw psi rz")
_TIME = {*"time t zeit timestamp date sec seconds clock".split()}
_WORDS = {*" ".join([*(words for _, words in _CHANNELS), *_AXES]).split(), *_DEMAND, *_TIME}

_SPELLED = {one.lower(): one for one in "m mm cm Pa kPa MPa N kN bar psi in ft lbf deg rad".split()}
_SPELLED |= {one: one for one in "s ms us % 1 g".split()}
_SPELLED |= {"sec": "s", "msec": "ms", "°": "deg", "pct": "%", "percent": "%", "inch": "in"}
_AFTER = {*_SPELLED} - {"1", "g"}  #: Units that may be the last word of a name.
_LABELS = ("123456", "012345", "abcdef")
_BY_SI = {"m": "mm", "m/s": "mm/s", "m/s^2": "m/s^2", "Pa": "bar", "1": "%"}
"""Units of the field where a name states none, for the reader to correct."""


_Name = tuple[set[str], str]  #: Words of a name, and its unit, empty where none is stated.


def _apart(source: Source, name: str) -> _Name:
    bracket = re.search(r"[\[(]([^\])]*)[\])]", name)
    plain = re.sub(r"[\[(][^\])]*[\])]", "", name)
    words = re.findall(r"mA\b|[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[%°]+", plain)
    words = [word.lower() for word in words]
    unit = _unit(source.units.get(name) or (bracket[1] if bracket else ""))
    for size in (2, 1):  # mm_s, mm
        if not unit and len(words) > size and {*words[-size:]} <= _AFTER:
            unit = _unit("/".join(words[-size:]))
            words = words[:-size] if unit else words
    return {part for word in words for part in _two(word)}, unit


def _two(word: str) -> tuple[str, ...]:
    """A word, or the two that it joins, such as `xcmd`."""
    cuts = ((word[:k], word[k:]) for k in range(1, len(word)))
    return (word,) if word in _WORDS else next((c for c in cuts if {*c} <= _WORDS), (word,))


def _unit(text: str) -> str:
    """A unit as this project spells it, empty where it has none."""
    text = text.strip().replace("²", "^2").replace("s2", "s^2")
    unit = "/".join(_SPELLED.get(part.strip().lower(), part) for part in text.split("/"))
    try:
        units.factor(unit)
    except InputError:
        return ""
    return unit


def _sixes(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Patterns with {leg} that six names fit, and what stands for it."""
    for name in names:
        for spot in re.finditer(r"\d|(?<![a-zA-Z])[a-fA-F](?![a-zA-Z])", name):
            pattern = f"{name[: spot.start()]}{{leg}}{name[spot.end() :]}"
            for labels in _LABELS:
                each = labels.upper() if spot[0].isupper() else labels
                if spot[0] == each[0] and all(pattern.replace("{leg}", k) in names for k in each):
                    yield pattern, each


def _channel(words: set[str], unit: str, taken: Sequence[str]) -> str | None:
    """The first channel whose words a name has, and whose unit fits."""
    asked = bool(words & _DEMAND)
    for channel, known in _CHANNELS:
        due = "m" if channel in POSES else CHANNELS[channel]
        fits = (not unit or units.si_unit(unit) == due) and channel not in taken
        if (
            fits
            and words & {*known.split()}
            and (channel in _EITHER or (channel in _ASKED) == asked)
        ):
            return channel
    return None


def guess_columns(path: str | Path) -> str:
    """A map of a file's columns, as TOML text; what was not recognised is in comments."""
    source = read_source(path)
    names = {name: _apart(source, name) for name in source.columns}
    channels: dict[str, Any] = {}
    doubts: list[str] = []
    time = _time(source, names, doubts)
    legs = ""
    left = [name for name in names if name != time.get("column")]

    def take(channel: str, columns: str | list[str], taken: list[str]) -> None:
        nonlocal left
        si = ["m"] * 3 + ["rad"] * 3 if channel in POSES else [CHANNELS[channel]] * len(taken)
        stated = [names[name][1] for name in taken]
        usual = {due: due for due in si} if channel in POSES else _BY_SI
        unit = [one or usual[due] for one, due in zip(stated, si, strict=True)]
        if not all(stated):
            doubts.append(f"{channel}: no unit in {taken[0]!r}: the one below is a guess")
        channels[channel] = {"columns": columns, "unit": unit if len({*unit}) > 1 else unit[0]}
        left = [name for name in left if name not in taken]

    sixes = list(_sixes(left))
    alike = {pattern.replace("{leg}", one) for pattern, labels in sixes for one in labels}
    for pattern, labels in sixes:
        taken = [pattern.replace("{leg}", label) for label in labels]
        channel = _channel(*names[taken[0]], [*channels]) if {*taken} <= {*left} else None
        if channel is not None:
            legs = legs or labels
            take(channel, pattern if labels == legs else taken, taken)
    for channel, asked in zip(POSES, (True, False), strict=True):
        found: dict[str, str] = {}
        for name in (one for one in left if one not in alike):
            words, _ = names[name]
            for dof, known in zip(DOFS, _AXES, strict=True):
                if words & {*known.split()} and bool(words & _DEMAND) == asked:
                    found.setdefault(dof, name)
        if channel not in channels and len({*found.values()}) == 6:
            take(channel, [found[dof] for dof in DOFS], [found[dof] for dof in DOFS])
    lines = ["A guess from the header: read it, correct it, then `cmf recording check`.", *doubts]
    lines += [f"not recognised: {', '.join(left)}"] if left else []
    lines.append(f"other channels: {', '.join(one for one in CHANNELS if one not in channels)}")
    table = {"legs": [*legs]} if legs not in ("", _LABELS[0]) else {}
    text = tomlkit.dumps(table | {"time": time, "channels": channels})
    return "".join(f"# {line}\n" for line in lines) + "\n" + text


def _time(source: Source, names: dict[str, _Name], doubts: list[str]) -> dict[str, Any]:
    """The time column, its unit by its name, else by what makes an ordinary rate."""
    for name, (words, unit) in names.items():
        if words & _TIME and (not unit or units.si_unit(unit) == "s"):
            step = float(np.median(np.diff(source.columns[name])))
            if not unit:
                unit = next((one for one in ("s", "ms") if step * units.factor(one) < 0.1), "us")
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
