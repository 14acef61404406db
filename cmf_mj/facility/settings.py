"""Parts of a run's description, as scenario files have them and as a session takes them.

`HostChain` is the way from host to valves, `Change` what changes from a frame on; `SessionSettings`
is what a session is given. `run.Run` is made of all of them.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, BeforeValidator, Field, model_validator

from cmf_mj.control import limiter, states
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.dcu.state import DcuSettings, load_dcu, make_dcu
from cmf_mj.control.law import Law
from cmf_mj.control.protection import ProtectionSettings
from cmf_mj.control.states import Request, State, StateSettings, load_state_settings
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.settings import Settings, Time, merged, name_or, validated
from cmf_mj.core.units import INCH, MOST_FRAMES, RATE
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.front import Blocks, Source, from_host
from cmf_mj.facility.host.handover import Ring
from cmf_mj.facility.signal import ScenarioSignal
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.events import MOST_FORCE, Event, Failure
from cmf_mj.plant.hexapod import PLANTS, make_plant
from cmf_mj.plant.parameters import fitting
from cmf_mj.plant.plant import Plant
from cmf_mj.signals.signal import Motion, as_plain

Gains = dict[str, Any]
"""Fields of a law to replace, as `laws.toml` names them: `{direct_gain = {velocity = -2.0}}`."""

_Force = Annotated[float, Field(ge=-MOST_FORCE, le=MOST_FORCE)]
Vector = tuple[_Force, _Force, _Force]
Signals = Annotated[tuple[ScenarioSignal, ...], Field(max_length=100)]
BeginName = Literal["off", "settled", "hold", "engaged"]
RequestName = Literal["off", "settle", "raise", "hold", "engage", "trip", "reset"]

LEGS = 6  #: Of the machines that a file names.

_RESTING = 0.05  #: What a leg on the stops is above its mechanical end [in].


def _named(value: Any) -> Any:
    """A state or request by its name."""
    return value.name.lower() if isinstance(value, State | Request) else value


def _listed(value: Any) -> Any:
    """A list as a tuple."""
    return tuple(value) if isinstance(value, list) else value


def _whole_number(value: Any) -> Any:
    return int(value) if isinstance(value, np.integer) else value


Events = Annotated[tuple[Event, ...], BeforeValidator(_listed)]
Whole = Annotated[int, BeforeValidator(_whole_number)]
"""A whole number, of NumPy made one of Python: those of one type share a compiled loop."""


def built_or_named(value: Any) -> Any:
    """A plant by its name, or one that was built."""
    if not (value in PLANTS if isinstance(value, str) else isinstance(value, Plant)):
        raise InputError(f"input should be {' or '.join(map(repr, PLANTS))}")
    return value


def plural(one: str, many: str, default: Any = ()) -> Any:
    """A field of several, which a file has by the name of one: `[[event]]`."""
    return Field(default, validation_alias=AliasChoices(one, many), serialization_alias=one)


class Push(Settings):
    """An external force on a body, held until the next push on it; without force it lets go.

    On the platform an `overload` that strikes while it is pushed suspends the vertical push for
    that one frame.
    """

    body: str = ""  #: Body of the MuJoCo model; default the one that carries the payload.
    force: Vector = (0.0, 0.0, 0.0)
    """At the body's centre of mass in MuJoCo's world axes: forward, left, up [N]."""
    torque: Vector = (0.0, 0.0, 0.0)  #: In the same axes [N m].


class Change(Settings):
    """What changes from a control frame on. Nothing that is left out does."""

    at: Time | None = None  #: When [s], to the nearest control frame; in a file this or `frame`.
    frame: Annotated[int, Field(ge=0, lt=MOST_FRAMES)] | None = None  #: In which control frame.
    law: str | None = None  #: Law that takes over, by name or TOML file; drops earlier `gains`.
    gains: Gains = {}  #: Fields of the law in force to replace.
    signal: Signals | None = None  #: Signals that take over, beginning now; `[]` goes to neutral.
    fade: Time = 1.0  #: Time in which they do [s]; 0 jumps.
    failure: tuple[Failure, ...] = ()  #: What fails.
    push: Push | None = None  #: External force from now on.
    request: RequestName | None = None  #: Operator's request, with `operation`.

    @model_validator(mode="after")
    def _once(self) -> Self:
        if self.at is not None and self.frame is not None:
            raise InputError("at, frame: both are given; allowed: one of them")
        return self

    def when(self, rate: int = RATE) -> int:
        """Control frame of the change at a control rate [Hz]."""
        if self.frame is not None:
            return self.frame
        if self.at is None:
            raise InputError("needs `at` in s or `frame`")
        return round(self.at * rate)

    def check(self, plant: str | Plant, hosted: bool) -> None:
        """Refuse what a machine cannot do; the law apart."""
        for failure in self.failure:
            check_leg(failure)
        if self.push is not None and self.push.body:
            model = _model(plant) if isinstance(plant, str) else plant.drawn_model
            names = (model.body(i).name for i in range(1, model.nbody))
            check_name("body", self.push.body, list(names))
        if self.request is not None and not hosted:
            raise InputError(f"change: request {self.request!r} needs [operation]")


class Due(NamedTuple):
    """A change that is still to happen, and what was made of it when it was announced."""

    frame: int
    change: Change
    motion: Motion | None  #: Sum of its signals.
    law: Law | None  #: That it names.


class RequestAt(Settings):
    """One request of the operator."""

    at: Time  #: When [s].
    request: Annotated[RequestName, BeforeValidator(_named)]  #: What is requested.

    @model_validator(mode="before")
    @classmethod
    def _pair(cls, value: Any) -> Any:
        pair = isinstance(value, tuple) and len(value) == 2
        return dict(zip(("at", "request"), value, strict=True)) if pair else value


class HostChain(Settings):
    """The whole chain from host to valves."""

    begin: Annotated[BeginName, BeforeValidator(_named)] = "settled"
    """Operating state to begin in. Off and settled begin on the stops, the others at the demand's
    pose. Settled has its valves open from the first frame, so that a law whose balance is elsewhere
    jumps; off fades them in."""
    requests: Annotated[tuple[RequestAt, ...], BeforeValidator(_listed)] = plural(
        "request", "requests", (RequestAt(at=0.0, request="engage"),)
    )
    """Operator's requests; of one instant the last counts, after any trip."""
    host_every: Annotated[int, Field(ge=1, le=RATE)] = 26
    """Control frames from one frame of the host to the next, where signals are what it sends; 26
    are 78.8 Hz."""
    dcu: Annotated[str | Path | DcuSettings, name_or(DcuSettings)] | None = None
    """Digital Control Unit, `default` or a file; default the machine's."""
    limits: Annotated[str | Path | MotionLimits, name_or(MotionLimits)] | None = None
    """Limits of platform and legs; default Table 2-1 with the assumed rates."""
    states: Annotated[str | Path | StateSettings, name_or(StateSettings)] | None = None
    """Times of the operating states."""

    def check(self, plant: str | Plant, machine: Machine) -> None:
        """Refuse what cannot be loaded, or another plant than the hexapod."""
        if plant != "hexapod":
            raise InputError(f"operation: is for the hexapod, plant is {plant}")
        dcu_of(machine, self.dcu)
        load_motion_limits(self.limits, machine)
        load_state_settings(self.states)

    def starting_pose(self, machine: Machine, arrivals: Arrivals) -> NDArray[np.float64]:
        """The first frame's pose, or neutral where the limits forbid it."""
        limits = load_motion_limits(self.limits, machine)
        pose, (low, high) = arrivals.values[0, 0], limits.operational.T
        inside = bool(((pose >= low) & (pose <= high)).all())
        if inside and np.abs(pose_to_legs(pose, machine)).max() <= limits.leg.position.si:
            return np.array(pose)
        return np.zeros(6)

    def source(
        self, machine: Machine, arrivals: Arrivals, start: Any, ring: Ring | None = None
    ) -> tuple[Source, NDArray[np.float64]]:
        """The chain before any frame, and the pose that the platform stands at.

        By default the demand begins at the first frame's pose, or at neutral where that is beyond
        the limits. With a ring of live frames the arrivals are the log that they are collected in.
        """
        frame, begin = machine.frame, State[self.begin.upper()]
        limits = load_motion_limits(self.limits, machine)
        operating = load_state_settings(self.states, fitting(machine))
        pose = self.starting_pose(machine, arrivals) if start is None else np.array(start)
        legs, place = pose_to_legs(pose, machine), pose
        if begin in (State.OFF, State.SETTLED):
            legs = np.full(6, -round(machine.half_stroke / INCH - _RESTING, 9) * INCH)
            place = legs_to_pose(legs, machine)
        blocks = Blocks(
            make_dcu(dcu_of(machine, self.dcu), frame),
            limiter.make_pose_limiter(limits, frame),
            machine.geometry,
            states.make_states(operating, machine),
            limiter.make_leg_limiter(limits, frame=frame),
        )
        timed = [(round(r.at * machine.rate), Request[r.request.upper()]) for r in self.requests]
        requests = sorted(timed, key=itemgetter(0))
        made = from_host(blocks, arrivals, requests, begin, position=legs, pose=pose, ring=ring)
        return made, place


def dcu_of(machine: Machine, source: str | Path | DcuSettings | None = None) -> DcuSettings:
    """A DCU fitted to a machine, by default the machine's."""
    return load_dcu(machine.dcu if source is None else source, fitting(machine))


class SessionSettings(NamedTuple):
    """Settings of a run, loaded."""

    events: tuple[Event, ...] = ()
    record_every: int = 1
    command_delay: int = 1
    protection: ProtectionSettings | None = None
    electronics: ElectronicsSettings | None = None
    dcu: DcuSettings | None = None  #: Of a run with a host.


@lru_cache
def _model(plant: str) -> mujoco.MjModel:
    return make_plant(plant).drawn_model


def check_leg(failure: Failure) -> None:
    """Refuse a leg that no machine of a file has."""
    if failure.leg is not None and failure.leg > LEGS:
        raise InputError(f"leg: {failure.leg} of {failure.kind} is not a leg; allowed: 1 to {LEGS}")


def check_order(
    changes: Sequence[Change],
    events: Sequence[Event],
    requests: Sequence[RequestAt],
    end: int,
    rate: int,
) -> None:
    """Refuse what never happens before the end, or changes not in the order of their frames."""
    happens, last = list[tuple[str, int]](), 0
    for number, change in enumerate(changes):
        with within(f"change.{number}"):
            frame = change.when(rate)
        if frame < last:
            raise InputError(f"change: frame {frame} comes after frame {last}; sort by time")
        happens.append(("change", frame))
        last = frame
    happens += [("event", round(event.at * rate)) for event in events]
    happens += [("operation.request", round(one.at * rate)) for one in requests]
    for field, frame in happens:
        if frame >= end:
            allowed = f"before the end of the run at {end / rate:g} s"
            raise InputError(f"{field}: at {frame / rate:g} s never happens; allowed: {allowed}")


def overlaid_law(law: Law, gains: Mapping[str, Any]) -> Law:
    """A law with some of its fields replaced, tables entry by entry."""
    return validated(Law, merged(law.model_dump(), gains), "gains") if gains else law


def change_of(table: Mapping[str, Any], where: str = "change") -> Change:
    """A change from plain values, lists included."""
    return validated(Change, as_plain(table), where)
