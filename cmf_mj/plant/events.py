"""Failure events as data on a time line, and what is broken at the moment.

An `Event` says when what fails, where and how much; a run takes any number of them. Every kind,
what its size means, and its size if none is given:

    pump_lost            the pump stops; a check valve keeps the manifold's oil
    accumulator_lost     accumulators shut off, 1
    supply_hose_burst    hole from the supply manifold to the tank, 1 in^2
    valve_hard_over      spool driven to an end, +100 % (extending)
    valve_jammed         spool stays where it is
    valve_dead           spool goes to its null
    sensor_stuck         position sensor stays where it is
    sensor_offset        position sensor reads too much, 2 in
    sensor_open          position sensor's wire is off: it reads an end of its range, -38 in
    overload             weight on the platform, 10 000 lbf
    emergency_stop       valves shut off from supply and return, settle valves open
"""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from cmf_mj.core import units
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Count, Settings, Time, validated
from cmf_mj.core.units import RATE
from cmf_mj.plant.valve import JAMMED, OVERRIDE

Kind = Literal[
    "pump_lost",
    "accumulator_lost",
    "supply_hose_burst",
    "valve_hard_over",
    "valve_jammed",
    "valve_dead",
    "sensor_stuck",
    "sensor_offset",
    "sensor_open",
    "overload",
    "emergency_stop",
]
"""What can fail."""

KINDS: tuple[str, ...] = get_args(Kind)
"""The same, in order."""

MOST_FORCE = 1e7
"""Largest external force [N]: some eighty times the weight of platform and cab."""

_SIZES: dict[str, tuple[float, tuple[str, ...], float]] = {
    "accumulator_lost": (1.0, ("1",), 100.0),
    "supply_hose_burst": (1.0 * units.INCH**2, ("in^2", "m^2"), 1.0),
    "valve_hard_over": (1.0, ("%", "1"), 1.0),
    "sensor_offset": (2.0 * units.INCH, ("in", "m"), 100.0),
    "sensor_open": (-38.0 * units.INCH, ("in", "m"), 100.0),
    "overload": (10_000.0 * units.POUND_FORCE, ("lbf", "N"), MOST_FORCE),
}
"""Size in SI where none is given, the units it may be given in, and the largest in SI."""

_VALVES = ("valve_hard_over", "valve_jammed", "valve_dead")
_SENSORS = ("sensor_stuck", "sensor_offset", "sensor_open")


class Failure(Settings):
    """Something that fails."""

    kind: Kind  #: What fails.
    leg: Count | None = None  #: Leg of a valve or sensor, from 1.
    valve: Annotated[int, Field(ge=1, le=2)] | None = None
    """Valve of the leg, 1 or 2; both if left out."""
    size: tuple[float, str] | None = None  #: How much, with its unit, e.g. `(1.0, "in^2")`.

    @model_validator(mode="after")
    def _complete(self) -> Self:
        local = self.kind in _VALVES + _SENSORS
        if local and self.leg is None:
            raise InputError(f"leg: is missing; {self.kind} needs the leg it happens to")
        if not local and self.leg is not None:
            raise InputError(f"leg: {self.leg} is not allowed; {self.kind} has no leg")
        if self.valve is not None and self.kind not in _VALVES:
            raise InputError(f"valve: {self.valve} is not allowed; {self.kind} has no valve")
        if self.size is not None:
            if self.kind not in _SIZES:
                raise InputError(f"size: {self.size} is not allowed; {self.kind} has none")
            value, unit = self.size
            if unit not in _SIZES[self.kind][1]:
                allowed = ", ".join(_SIZES[self.kind][1])
                raise InputError(f"size: unit {unit!r} is not one of {allowed}")
            signed = self.kind in ("valve_hard_over", *_SENSORS)
            if value <= 0.0 and not signed:
                raise InputError(f"size: {value:g} {unit} must be greater than 0 {unit}")
            most = units.from_si(unit, _SIZES[self.kind][2])
            if abs(value) > most:
                ways = " either way" if signed else ""
                raise InputError(f"size: {value:g} {unit} must be at most {most:g} {unit}{ways}")
        return self

    @property
    def magnitude(self) -> float:
        """The size in SI; 0 for kinds without one."""
        if self.size is None:
            return _SIZES[self.kind][0] if self.kind in _SIZES else 0.0
        return units.to_si(self.size[1], self.size[0])


class Event(Failure):
    """A failure on the time line."""

    at: Time  #: When [s].


def default_event(
    kind: str,
    at: float,
    *,
    leg: int | None = None,
    valve: int | None = None,
    size: tuple[float, str] | None = None,
) -> Event:
    """An `Event` of a kind, on leg 1 where it needs a leg and none is named."""
    chosen = 1 if leg is None and kind in _VALVES + _SENSORS else leg
    fields = {"at": at, "kind": kind, "leg": chosen, "valve": valve, "size": size}
    return validated(Event, fields, "event")


PUMP_LOST, ACCUMULATORS_LOST, BURST_AREA, STOPPED, OVERLOAD = range(5)
"""Columns of `Faults.plant`: pump stopped (0 or 1), number of accumulators shut off, hole in the
supply manifold [m^2], emergency stop (0 or 1), extra weight on the platform [N]."""

STUCK, OFFSET, OPEN_CIRCUIT = 1.0, 2.0, 3.0
"""What a faulty position sensor does; 0 for a sound one."""


class Faults(NamedTuple):
    """What has failed, read by hydraulics and sensors every step; all zero when nothing has."""

    plant: NDArray[np.float64]  #: (5,), see the columns.
    valve: NDArray[np.float64]  #: What each valve obeys, (n, 2), see `valve.NORMAL`.
    spool: NDArray[np.float64]  #: Value put on an overridden spool, (n, 2).
    sensor: NDArray[np.float64]  #: State of each position sensor, (n,).
    reading: NDArray[np.float64]
    """Reading of a stuck or open one, error of an offset one [m], (n,)."""


def no_faults(actuators: int) -> Faults:
    """Everything works."""
    return Faults(
        np.zeros(5),
        np.zeros((actuators, 2)),
        np.zeros((actuators, 2)),
        np.zeros(actuators),
        np.zeros(actuators),
    )


class Timeline(NamedTuple):
    """Events in order of time, as the compiled loop reads them, arrays (m,)."""

    frame: NDArray[np.int64]  #: Control frame.
    kind: NDArray[np.int64]  #: Index into `KINDS`.
    leg: NDArray[np.int64]  #: Leg from 0, -1 for none.
    valve: NDArray[np.int64]  #: Valve from 0, -1 for both.
    size: NDArray[np.float64]  #: In SI.


def make_timeline(events: Sequence[Event], legs: int, rate: int = RATE) -> Timeline:
    """Put events in order, at a control rate [Hz]; a leg that is not there is refused."""
    for event in events:
        if event.leg is not None and event.leg > legs:
            raise InputError(f"leg: {event.leg} of {event.kind} is not a leg; allowed: 1 to {legs}")
    ordered = sorted(events, key=lambda event: event.at)
    rows = [
        (round(e.at * rate), KINDS.index(e.kind), (e.leg or 0) - 1, (e.valve or 0) - 1)
        for e in ordered
    ]
    frame, kind, leg, valve = np.array(rows, dtype=np.int64).reshape(-1, 4).T.copy()
    return Timeline(frame, kind, leg, valve, np.array([e.magnitude for e in ordered], dtype=float))


_PUMP, _ACCUMULATOR, _BURST, _HARD, _JAMMED, _DEAD, _STUCK, _OFFSET, _OPEN, _LOAD, _STOP = range(11)


@compiled
def strike(timeline, number, faults, position):  # type: ignore[no-untyped-def]
    """Write one event into the faults; `position` (n,) is what the sensors read now [m]."""
    kind, leg, size = timeline.kind[number], timeline.leg[number], timeline.size[number]
    plant = faults.plant
    if kind == _PUMP:
        plant[PUMP_LOST] = 1.0
    elif kind == _ACCUMULATOR:
        plant[ACCUMULATORS_LOST] += size
    elif kind == _BURST:
        plant[BURST_AREA] += size
    elif kind == _LOAD:
        plant[OVERLOAD] += size
    elif kind == _STOP:
        plant[STOPPED] = 1.0
    elif kind == _HARD or kind == _JAMMED or kind == _DEAD:
        for index in range(2):
            if timeline.valve[number] < 0 or timeline.valve[number] == index:
                faults.valve[leg, index] = JAMMED if kind == _JAMMED else OVERRIDE
                faults.spool[leg, index] = size
    elif kind == _STUCK:
        faults.sensor[leg] = STUCK
        faults.reading[leg] = position[leg]
    elif kind == _OFFSET:
        faults.sensor[leg] = OFFSET
        faults.reading[leg] = size
    elif kind == _OPEN:
        faults.sensor[leg] = OPEN_CIRCUIT
        faults.reading[leg] = size


@compiled
def read_position(faults, leg, position):  # type: ignore[no-untyped-def]
    """What a position sensor, sound or not, makes of the true extension [m]."""
    state = faults.sensor[leg]
    if state == STUCK or state == OPEN_CIRCUIT:
        return faults.reading[leg]
    if state == OFFSET:
        return position + faults.reading[leg]
    return position
