"""Hostile scenario files and changes: good ones with a field or two odd, gone or too many."""

import copy
from collections.abc import Iterator
from typing import Any

from hypothesis import strategies as st
from numpy.random import Generator

from cmf_mj.control.law import law_names

Path = tuple[str | int, ...]

BODY, LAWS = "cab/cab", law_names("all")

NUMBERS: tuple[Any, ...] = (
    *(0, -1, 1, 2, 9, 2**31, 2**53 + 1, 2**70, -(2**70)),
    *(0.0, -0.0, -1.0, 0.5, 1e-310, 1e-30, 1e3, 1e9, 1e17, 1e300, 1.7e308, -1e300),
    *(float("inf"), float("-inf"), float("nan")),
)
TEXTS: tuple[Any, ...] = (
    *("", "x", "gone.toml", "gone.csv", "../../x", "a[/b]c", "x" * 300, "\0", ".toml", "/"),
    *("open", "default", "velocity", "modal_plan", "heave", "in", "deg", "N", "%"),
)
ODD: tuple[Any, ...] = (*NUMBERS, *TEXTS, True, [], {}, [0.0, "in"], [[]], {"a": 1}, None)


def signals() -> list[dict[str, Any]]:
    """One of each kind that needs no file."""
    along: dict[str, Any] = {"dof": "heave", "amplitude": [0.1, "in"]}
    return [
        {"kind": "step", "at": 0.02, "duration": 0.1} | along,
        {"kind": "pulse", "at": 0.02, "width": 0.01, "duration": 0.1} | along,
        {"kind": "sine", "frequency": 2.0, "cycles": 1.0, "fade": 0.1, "rest": 0.1} | along,
        {"kind": "chirp", "start": 1.0, "stop": 9.0, "duration": 0.5, "settle": 0.1} | along,
        {"kind": "noise", "start": 4.0, "duration": 0.5, "settle": 0.1, "fade": 0.1} | along,
        {"kind": "multisine", "start": 2.0, "period": 0.5, "periods": 2, "fade": 0.1} | along,
        {"kind": "seven_sines", "number": 5, "cycles": 1, "fade": 0.1, "settle": 0.1} | along,
        {
            **{"kind": "stepped_sines", "dof": "roll", "frequencies": [5.0, 9.0], "cycles": 1},
            **{"amplitudes": [[0.1, "deg"], 0.001], "transient": 0.1, "fade": 0.1, "settle": 0.1},
        },
        {"kind": "acceleration_step", "dof": "yaw", "acceleration": 0.1, "hold": 0.1, "at": 0.02},
        {"kind": "waypoints", "times": [0.0, 0.5], "poses": [[0.0] * 6, [0.0, 0.0, 0.01, 0, 0, 0]]},
    ]


def scenarios() -> list[dict[str, Any]]:
    """Good scenarios of less than 400 frames, with every field there is."""
    plain = {
        **{"title": "plain", "plant": "single_legs", "hydraulics": "report", "law": "velocity"},
        **{"gains": {"direct_gain": {"velocity": -1.5}}, "seed": 1, "record_every": 2},
        **{"signal": signals(), "duration": 0.15, "protection": "default"},
        "event": [
            {"at": 0.03, "kind": "supply_hose_burst", "size": [0.1, "in^2"]},
            {"at": 0.03, "kind": "valve_jammed", "leg": 2, "valve": 1},
        ],
        "change": [
            {"at": 0.05, "law": "force", "gains": {"direct_gain": {"force": -0.01}}},
            {"frame": 120, "signal": signals()[:1], "fade": 0.02},
            {"frame": 130, "push": {"body": "leg_3", "force": [0.0, 0.0, 1e3]}},
        ],
    }
    chain = {
        **{"cab": "ifd", "hydraulics": "hardware", "law": "modal_plan", "duration": 0.18},
        **{"protection": "default", "record_every": 1, "signal": [signals()[2]]},
        "electronics": {"sensors": "noisy", "converters": "sixteen_bit"},
        "operation": {
            **{"begin": "settled", "host_every": 26, "dcu": "default"},
            "request": [{"at": 0.0, "request": "engage"}, {"at": 0.1, "request": "settle"}],
        },
        "event": [{"at": 0.02, "kind": "sensor_offset", "leg": 1, "size": [1.0, "in"]}],
        "change": [
            {"at": 0.05, "failure": [{"kind": "overload", "size": [1e4, "N"]}]},
            {"at": 0.06, "push": {"body": BODY, "force": [1e3, 0.0, 0.0], "torque": [0.0, 1.0, 0]}},
            {"at": 0.08, "request": "trip", "failure": [{"kind": "valve_hard_over", "leg": 6}]},
        ],
    }
    return [plain, chain]


def places(value: Any, here: Path = ()) -> Iterator[Path]:
    """Where something stands in nested tables and lists."""
    if here:
        yield here
    inner: Any = value.items() if isinstance(value, dict) else ()
    if isinstance(value, list):
        inner = enumerate(value)
    for key, one in inner:
        yield from places(one, (*here, key))


def spoiled(table: dict[str, Any], place: Path, value: Any) -> dict[str, Any]:
    """A copy with something else in its place; nothing at all for `...`, many for a list."""
    result = copy.deepcopy(table)
    holder: Any = result
    for key in place[:-1]:
        holder = holder[key]
    last = place[-1]
    if value is ...:
        del holder[last]
    elif value == "many" and isinstance(holder[last], list):
        holder[last] = holder[last] * 700
    else:
        holder[last] = value
    return result


@st.composite
def hostile(draw: st.DrawFn) -> dict[str, Any]:
    """A good scenario with one or two fields spoiled."""
    table = draw(st.sampled_from(scenarios()))
    for _ in range(draw(st.integers(1, 2))):
        spots = sorted(places(table), key=str)
        place = draw(st.sampled_from(spots)) if spots else ()
        if place:
            table = spoiled(table, place, draw(st.sampled_from((*ODD, ..., "many"))))
    return table


def random_change(draw: Generator, chain: bool) -> dict[str, Any]:
    """Something an operator may do, or a mistake: a good change, or one with a field spoiled."""
    kinds: list[dict[str, Any]] = [
        {"law": str(draw.choice(LAWS))},
        {"gains": {"direct_gain": {"velocity": -float(draw.uniform(0.0, 4.0))}}},
        {"signal": [signals()[int(draw.integers(10))]], "fade": float(draw.choice([0.0, 0.05]))},
        {"push": {"force": (draw.uniform(-1.0, 1.0, 3) * 10.0 ** draw.uniform(0, 7)).tolist()}},
        {"push": {}},
        {"signal": [], "fade": 0.2},
    ]
    if draw.random() < 0.2:
        leg = int(draw.integers(1, 7))
        kind = str(draw.choice(["sensor_stuck", "sensor_offset", "valve_dead", "valve_jammed"]))
        kinds = [{"failure": [{"kind": kind, "leg": leg}]}, {"failure": [{"kind": "overload"}]}]
    if chain and draw.random() < 0.4:
        names = ("off", "settle", "raise", "hold", "engage", "trip", "reset")
        kinds = [{"request": str(draw.choice(names))}]
    change = kinds[int(draw.integers(len(kinds)))]
    if draw.random() < 0.15:
        spots = list(places(change))
        change = spoiled(
            change,
            spots[int(draw.integers(len(spots)))],
            ["x", -1, 1e300, 9][int(draw.integers(4))],
        )
    return change
