"""Failure events as data on a time line, and the faults that they leave in the plant.

An `Event` says when what fails, where and how much; a run takes any number of them. `KINDS` has
what can fail.
"""

from collections import namedtuple
from collections.abc import Sequence
from math import nan
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from cmf_mj.core.arrays import record_array
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Count, Settings, Time, validated
from cmf_mj.core.units import INCH, POUND_FORCE, RATE, from_si, to_si
from cmf_mj.plant.valve import JAMMED, OVERRIDE

MOST_FORCE = 1e7  #: Largest external force [N]: some eighty times the weight of platform and cab.


class _Kind(NamedTuple):
    """Where something fails, and what its size means."""

    part: Literal["", "valve", "sensor"] = ""  #: Part of a leg that fails, if it is one's.
    default_size: float = 0.0  #: In SI; NaN for the lower end of the leg's stroke.
    units: tuple[str, ...] = ()  #: Units of a size; none for a kind that has no size.
    largest_size: float = 0.0  #: Largest size in SI.
    is_whole: bool = False  #: Whether the size is a whole number.


_KINDS = {
    "pump_lost": _Kind(),  # the pump stops; a check valve keeps the manifold's oil
    "accumulator_lost": _Kind("", 1.0, ("1",), 100.0, is_whole=True),  # accumulators shut off
    "supply_hose_burst": _Kind("", INCH**2, ("in^2", "m^2"), 1.0),  # hole to the tank
    "valve_hard_over": _Kind("valve", 1.0, ("%", "1"), 1.0),  # spool driven to an end
    "valve_jammed": _Kind("valve"),  # spool stays where it is
    "valve_dead": _Kind("valve"),  # spool goes to its null
    "sensor_stuck": _Kind("sensor"),  # position sensor stays where it is
    "sensor_offset": _Kind("sensor", 2.0 * INCH, ("in", "m"), 100.0),  # it reads too much
    "sensor_open": _Kind("sensor", nan, ("in", "m"), 100.0),  # wire off: an end of range
    "overload": _Kind("", 10_000.0 * POUND_FORCE, ("lbf", "N"), MOST_FORCE),  # on the platform
    "emergency_stop": _Kind(),  # valves shut off from supply and return, settle valves open
}

KINDS = tuple(_KINDS)  #: What can fail.

if TYPE_CHECKING:  # mypy reads only what a Literal spells out
    KindName = str
else:
    KindName = Literal[KINDS]


class Failure(Settings):
    """Something that fails."""

    kind: KindName  #: What fails.
    leg: Count | None = None  #: Leg of a valve or sensor, from 1.
    valve: Annotated[int, Field(ge=1, le=2)] | None = None  #: Valve of the leg; both if left out.
    size: tuple[float, str] | None = None  #: How much, with its unit, e.g. `(1.0, "in^2")`.

    @model_validator(mode="after")
    def _check_fields(self) -> Self:
        kind = _KINDS[self.kind]
        part, allowed_units = kind.part, kind.units
        if part and self.leg is None:
            raise InputError(f"leg: is missing; {self.kind} needs the leg it happens to")
        if not part and self.leg is not None:
            raise InputError(f"leg: {self.leg} is not allowed; {self.kind} has no leg")
        if self.valve is not None and part != "valve":
            raise InputError(f"valve: {self.valve} is not allowed; {self.kind} has no valve")
        if self.size is not None:
            if not allowed_units:
                raise InputError(f"size: {self.size} is not allowed; {self.kind} has none")
            value, unit = self.size
            if unit not in allowed_units:
                raise InputError(f"size: unit {unit!r} is not one of {', '.join(allowed_units)}")
            if value <= 0.0 and not part:
                raise InputError(f"size: {value:g} {unit} must be greater than 0 {unit}")
            if kind.is_whole and not value.is_integer():
                raise InputError(f"size: {value:g} {unit} must be a whole number")
            largest_size = from_si(unit, kind.largest_size)
            if abs(value) > largest_size:
                ways = " either way" if part else ""
                raise InputError(
                    f"size: {value:g} {unit} must be at most {largest_size:g} {unit}{ways}"
                )
        return self

    def magnitude(self, half_stroke: float) -> float:
        """The size in SI, on a leg of that half stroke [m]; 0 for kinds without one."""
        if self.size is not None:
            return to_si(self.size[1], self.size[0])
        default_size = _KINDS[self.kind].default_size
        return -half_stroke if np.isnan(default_size) else default_size


class Event(Failure):
    """A failure on the time line."""

    at: Time  #: When [s].


def default_event(kind: str, at: float, **fields: Any) -> Event:
    """An `Event` of a kind, on leg 1 where it needs a leg and none of the `fields` names one."""
    if fields.get("leg") is None and kind in _KINDS and _KINDS[kind].part:
        fields["leg"] = 1
    return validated(Event, fields | {"at": at, "kind": kind}, "event")


class PlantFaults(NamedTuple):
    """What has failed of the supply and on the platform; all 0 when nothing has."""

    pump_lost: float = 0.0  #: Whether the pump has stopped.
    accumulators_lost: float = 0.0  #: How many are shut off.
    burst_area: float = 0.0  #: Hole in the supply manifold [m^2].
    overload: float = 0.0  #: Weight more on the platform [N].


STUCK, OFFSET, OPEN_CIRCUIT = 1.0, 2.0, 3.0
"""What a faulty position sensor does; 0 for a sound one."""


class Faults(NamedTuple):
    """What has failed, read by hydraulics and sensors every step; all zero when nothing has."""

    plant: np.recarray  #: (1,) of `PlantFaults`.
    valve: NDArray[np.float64]  #: What each valve obeys, (n, 2), see `valve.NORMAL`.
    spool: NDArray[np.float64]  #: Value put on an overridden spool, (n, 2).
    sensor: NDArray[np.float64]  #: State of each position sensor, (n,).
    reading: NDArray[np.float64]  #: Reading of a stuck or open one, error of an offset one [m].


def no_faults(actuators: int) -> Faults:
    """Everything works."""
    return Faults(
        plant=record_array(PlantFaults, [PlantFaults()]),
        valve=np.zeros((actuators, 2)),
        spool=np.zeros((actuators, 2)),
        sensor=np.zeros(actuators),
        reading=np.zeros(actuators),
    )


class Timeline(NamedTuple):
    """Events in order of time, as the compiled loop reads them, arrays (m,)."""

    frame: NDArray[np.int64]  #: Control frame.
    kind: NDArray[np.int64]  #: Index into `KINDS`.
    leg: NDArray[np.int64]  #: Leg from 0, -1 for none.
    valve: NDArray[np.int64]  #: Valve from 0, -1 for both.
    size: NDArray[np.float64]  #: In SI.


def make_timeline(
    events: Sequence[Event], half_stroke: NDArray[np.float64], rate: int = RATE
) -> Timeline:
    """Put events in order, at a control rate [Hz], for legs of half strokes (n,) [m].

    An event of a leg beyond these is refused.
    """
    legs = half_stroke.size
    for event in events:
        if event.leg is not None and event.leg > legs:
            raise InputError(f"leg: {event.leg} of {event.kind} is not a leg; allowed: 1 to {legs}")
    sorted_events = sorted(events, key=lambda event: event.at)
    sizes = [event.magnitude(half_stroke[(event.leg or 1) - 1]) for event in sorted_events]
    return Timeline(
        frame=np.array([round(event.at * rate) for event in sorted_events], dtype=np.int64),
        kind=np.array([KINDS.index(event.kind) for event in sorted_events], dtype=np.int64),
        leg=np.array([(event.leg or 0) - 1 for event in sorted_events], dtype=np.int64),
        valve=np.array([(event.valve or 0) - 1 for event in sorted_events], dtype=np.int64),
        size=np.array(sizes, dtype=float),
    )


_KindNumbers = namedtuple("_KindNumbers", KINDS)  # type: ignore[misc]
_KIND: Any = _KindNumbers(*range(len(KINDS)))
"""Numbers of the kinds by name, as a `Timeline` has them; compiled code reads no strings."""


@compiled
def apply_event(timeline, event, faults, position):  # type: ignore[no-untyped-def]
    """Write one event into the faults; whether it is an emergency stop, which the controller makes.

    `position` (n,) is what the sensors read now [m].
    """
    kind, leg, size = timeline.kind[event], timeline.leg[event], timeline.size[event]
    plant = faults.plant[0]
    if kind == _KIND.pump_lost:
        plant.pump_lost = 1.0
    elif kind == _KIND.accumulator_lost:
        plant.accumulators_lost += size
    elif kind == _KIND.supply_hose_burst:
        plant.burst_area += size
    elif kind == _KIND.overload:
        plant.overload += size
    elif kind == _KIND.valve_hard_over or kind == _KIND.valve_jammed or kind == _KIND.valve_dead:
        for index in range(2):
            if timeline.valve[event] < 0 or timeline.valve[event] == index:
                faults.valve[leg, index] = JAMMED if kind == _KIND.valve_jammed else OVERRIDE
                faults.spool[leg, index] = size
    elif kind == _KIND.sensor_stuck:
        faults.sensor[leg] = STUCK
        faults.reading[leg] = position[leg]
    elif kind == _KIND.sensor_offset:
        faults.sensor[leg] = OFFSET
        faults.reading[leg] = size
    elif kind == _KIND.sensor_open:
        faults.sensor[leg] = OPEN_CIRCUIT
        faults.reading[leg] = size
    return kind == _KIND.emergency_stop


@compiled
def read_position(faults, leg, position):  # type: ignore[no-untyped-def]
    """What a position sensor, sound or not, makes of the true extension [m]."""
    state = faults.sensor[leg]
    if state == STUCK or state == OPEN_CIRCUIT:
        return faults.reading[leg]
    if state == OFFSET:
        return position + faults.reading[leg]
    return position
