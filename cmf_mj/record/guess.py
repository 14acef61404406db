"""A guess of the columns of a recording from their names, as a map to read and correct.

Six names that differ in one number 1 to 6, or 0 to 5, or one letter a to f, are the legs of one
channel. Its words say which: pos, x, length; ref, dmd, set; vel, v; cap, pa; rod, pb; force;
valve, u. Units stand in brackets or at the end: `p1 [bar]`, `x1_mm`.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import tomlkit

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.columns import CHANNELS, POSES
from cmf_mj.record.sources import Source, read_source
from cmf_mj.record.times import even_clock

_WORDS = {
    "leg_reference": "ref reference xref dmd demand demanded dem setpoint sp target desired xd",
    "leg_velocity": "vel velocity speed v xdot dx xd_dot",
    "leg_acceleration": "acc acceleration accel a xddot ddx",
    "cap_pressure": "cap pcap capprs bore head pa pc pk p p1 prs pressure press",
    "rod_pressure": "rod prod rodprs annulus pb pr ps p2",
    "leg_force": "force f load fax loadcell",
    "valve_command": "valve vlv u servo sv spool current",
    "compensator_output": "cmp compensator controller",
    "leg_position": "pos position x l s ext extension len length stroke fdk feedback meas leg act",
}
"""Words of names by channel; the earlier channel is preferred."""

_POSE = dict(
    zip(
        DOFS,
        (
            "surge x px",
            "sway y py",
            "heave z pz",
            "roll phi rx",
            "pitch theta ry",
            "yaw psi rz heading",
        ),
        strict=True,
    )
)
_TIME = "time t zeit timestamp sec seconds clock"
_PLAIN = {"s": "s", "sec": "s", "msec": "ms", "°": "deg", "pct": "%", "percent": "%", "inch": "in"}
_ENDS = (
    "mm",
    "cm",
    "m",
    "in",
    "ft",
    "bar",
    "psi",
    "kpa",
    "mpa",
    "pa",
    "kn",
    "n",
    "lbf",
    "deg",
    "rad",
    "ms",
    "s",
    "us",
    "%",
    "mms",
    "mps",
)
_LABELS = ("123456", "012345", "abcdef")
_BY_SI = {"m": "mm", "m/s": "mm/s", "m/s^2": "m/s^2", "Pa": "bar", "N": "N", "1": "%"}
"""Units of the field where a name states none, for the reader to correct."""


class _Name(NamedTuple):
    """A name taken apart."""

    words: frozenset[str]
    unit: str  #: Empty where none is stated.


def _apart(name: str, stated: str = "") -> _Name:
    bracket = re.search(r"[\[(]([^\])]*)[\])]", name)
    plain = re.sub(r"[\[(][^\])]*[\])]", "", name)
    parts = [part for part in re.split(r"[^a-zA-Z%°]+|(?<=[a-z])(?=[A-Z])", plain) if part]
    words = [part.lower() for part in parts]
    unit = _unit(stated or (bracket[1] if bracket else ""))
    if not unit and len(words) > 1 and words[-1] in _ENDS:
        unit = _unit(parts[-1])
        words = words[:-1] if unit else words
    return _Name(frozenset(words), unit)


def _unit(text: str) -> str:
    """A unit as this project spells it, empty where it has none."""
    known = {
        one.lower(): one
        for one in (
            "m",
            "mm",
            "cm",
            "Pa",
            "kPa",
            "MPa",
            "N",
            "kN",
            "bar",
            "psi",
            "in",
            "ft",
            "lbf",
            "deg",
            "rad",
            "s",
            "ms",
            "us",
            "%",
            "1",
            "g",
        )
    } | _PLAIN
    text = text.strip().replace("²", "^2").replace("s2", "s^2")
    parts = [known.get(part.strip().lower(), part) for part in text.split("/")]
    try:
        units.factor("/".join(parts))
    except InputError:
        return ""
    return "/".join(parts)


def _sixes(names: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Patterns with {leg} that six names fit, and what stands for it."""
    seen: set[str] = set()
    for name in names:
        for spot in re.finditer(r"\d|(?<![a-zA-Z])[a-fA-F](?![a-zA-Z])", name):
            pattern = f"{name[: spot.start()]}{{leg}}{name[spot.end() :]}"
            for labels in _LABELS:
                each = labels.upper() if spot[0].isupper() else labels
                if pattern not in seen and all(pattern.replace("{leg}", k) in names for k in each):
                    seen.add(pattern)
                    yield pattern, list(each)


def _channel(words: Iterable[str], unit: str, taken: Iterable[str]) -> str | None:
    """The channel whose words a name has, and whose unit fits; one with a unit alone is not one."""
    for channel, known in _WORDS.items():
        fits = not unit or units.si_unit(unit) == CHANNELS[channel]
        if fits and channel not in taken and set(words) & set(known.split()):
            return channel
    return None


def guess_columns(path: str | Path) -> str:
    """A map of a file's columns, as TOML text; what was not recognised is in comments."""
    source = read_source(path)
    left = list(source.columns)
    table: dict[str, Any] = {"time": _time(source, left)}
    channels: dict[str, Any] = {}
    doubts: list[str] = []
    for pattern, labels in list(_sixes(left)):
        names = [pattern.replace("{leg}", label) for label in labels]
        if not set(names) <= set(left):
            continue
        words, unit = _apart(names[0], source.units.get(names[0], ""))
        pose = next((p for p in POSES if p in re.sub(r"\W", "_", pattern.lower())), None)
        channel = pose or _channel(words, unit, channels)
        if channel is None or channel in channels:
            continue
        due = CHANNELS[channel]
        stated = [unit or _BY_SI[due]] * 6 if pose is None else ["m"] * 3 + ["rad"] * 3
        channels[channel] = {"columns": pattern, "unit": stated if pose else stated[0]}
        if not unit:
            doubts.append(f"{channel}: no unit in {names[0]!r}: {stated} is a guess")
        if labels != list("123456"):
            table["legs"] = labels
        left = [name for name in left if name not in names]
    left = _poses(source, left, channels, doubts)
    for name in list(left):
        words, unit = _apart(name, source.units.get(name, ""))
        scalar = "supply_pressure" if words & {"supply", "psup"} else "return_pressure"
        if scalar not in channels and words & {"supply", "psup", "return", "tank"} and unit:
            channels[scalar] = {"columns": name, "unit": unit}
            left.remove(name)
    lines = ["A guess from the header: read it, correct it, then `cmf recording check`.", *doubts]
    lines += [f"not recognised: {name}" for name in left]
    if not channels:
        lines.append("no channel was recognised; name some of " + ", ".join(CHANNELS))
    text = tomlkit.dumps(
        {
            **{k: v for k, v in table.items() if k == "legs"},
            "time": table["time"],
            "channels": channels,
        }
    )
    return "".join(f"# {line}\n" for line in lines) + "\n" + text


def _time(source: Source, left: list[str]) -> dict[str, Any]:
    """The time column, its unit by its name, else by what makes an ordinary rate."""
    for name in list(left):
        words, unit = _apart(name, source.units.get(name, ""))
        if words & set(_TIME.split()) and (not unit or units.si_unit(unit) == "s"):
            left.remove(name)
            table: dict[str, Any] = {"column": name, "unit": unit or "s"}
            try:
                even_clock(source.columns[name])
            except InputError:
                table["resample"] = 500.0
            return table
    return {"rate": 500.0}


def _poses(
    source: Source, left: list[str], channels: dict[str, Any], doubts: list[str]
) -> list[str]:
    """Take six axes by their words, of a demand and of a measurement; what is left."""
    demand = set(_WORDS["leg_reference"].split())
    for channel, asked in zip(POSES, (True, False), strict=True):
        found: dict[str, str] = {}
        for name in left:
            words, _ = _apart(name)
            axis = next((a for a, known in _POSE.items() if words & set(known.split())), None)
            if axis is not None and bool(words & demand) == asked:
                found.setdefault(axis, name)
        if channel not in channels and len(found) == 6:
            names = [found[axis] for axis in DOFS]
            stated = [_apart(name, source.units.get(name, "")).unit for name in names]
            due = ["m"] * 3 + ["deg"] * 3
            unit = [one or other for one, other in zip(stated, due, strict=True)]
            if not all(stated):
                doubts.append(f"{channel}: not all names state a unit: {unit} is a guess")
            channels[channel] = {"columns": names, "unit": unit}
            left = [name for name in left if name not in names]
    return left
