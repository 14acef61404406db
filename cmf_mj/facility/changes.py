"""What happens in a run, and when: failures, changes, and requests of the operator."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple, Self

import mujoco
from pydantic import AliasChoices, BeforeValidator, Field, model_validator

from cmf_mj.control.law import Law
from cmf_mj.control.states import Request, State
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.settings import Settings, Time, merged, validated
from cmf_mj.core.units import MOST_FRAMES, RATE
from cmf_mj.facility.signal import ScenarioSignal
from cmf_mj.plant.events import MOST_FORCE, Event, Failure
from cmf_mj.plant.hexapod import make_plant
from cmf_mj.plant.plant import Plant
from cmf_mj.signals.signal import Motion, as_plain

Gains = dict[str, Any]
"""Fields of a law to replace, as `laws.toml` names them: `{direct_gain = {velocity = -2.0}}`."""

_Force = Annotated[float, Field(ge=-MOST_FORCE, le=MOST_FORCE)]
_Vector = tuple[_Force, _Force, _Force]
Signals = Annotated[tuple[ScenarioSignal, ...], Field(max_length=100)]
_RequestName = Literal["off", "settle", "raise", "hold", "engage", "trip", "reset"]

_LEGS = 6  #: Of the machines that a file names.


def name_of_state(value: Any) -> Any:
    """Name of a state or request."""
    return value.name.lower() if isinstance(value, State | Request) else value


_ListAsTuple = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)
Events = Annotated[tuple[Event, ...], _ListAsTuple]


def plural(singular: str, name: str, default: Any = ()) -> Any:
    """A field of several, which a file has by the name of one: `[[event]]`."""
    alias = AliasChoices(singular, name)
    return Field(default, validation_alias=alias, serialization_alias=singular)


class Push(Settings):
    """An external force on a body, held until the next push on it; without force it lets go.

    An `overload` that strikes suspends a vertical push on the platform for one frame.
    """

    body: str = ""  #: Body of the MuJoCo model; default the one that carries the payload.
    force: _Vector = (0.0, 0.0, 0.0)
    """At the body's centre of mass in MuJoCo's world axes: forward, left, up [N]."""
    torque: _Vector = (0.0, 0.0, 0.0)  #: In the same axes [N m].


class Change(Settings):
    """What changes from a control frame on; what is left out stays as it is."""

    at: Time | None = None  #: When [s], to the nearest control frame; in a file this or `frame`.
    frame: Annotated[int, Field(ge=0, lt=MOST_FRAMES)] | None = None  #: In which control frame.
    law: str | None = None  #: Law that takes over, by name or TOML file; drops earlier `gains`.
    gains: Gains = {}  #: Fields of the law in force to replace.
    signal: Signals | None = None  #: Signals that take over, beginning now; `[]` goes to neutral.
    fade: Time = 1.0  #: Time in which the signals take over [s]; 0 jumps.
    failure: tuple[Failure, ...] = ()  #: What fails.
    push: Push | None = None  #: External force from now on.
    request: _RequestName | None = None  #: Operator's request, with `operation`.

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.at is not None and self.frame is not None:
            raise InputError("at, frame: both are given; allowed: one of them")
        return self

    def at_frame(self, rate: int = RATE) -> int:
        """Control frame of the change at a control rate [Hz]."""
        if self.frame is not None:
            return self.frame
        if self.at is None:
            raise InputError("needs `at` in s or `frame`")
        return round(self.at * rate)

    def check(self, plant: str | Plant, hosted: bool) -> None:
        """Refuse what a machine cannot do; the law is checked elsewhere."""
        for failure in self.failure:
            check_leg(failure)
        if self.push is not None and self.push.body:
            model = _model(plant) if isinstance(plant, str) else plant.drawn_model
            names = [model.body(number).name for number in range(1, model.nbody)]
            check_name("body", self.push.body, names)
        if self.request is not None and not hosted:
            raise InputError(f"change: request {self.request!r} needs [operation]")


class ComingChange(NamedTuple):
    """A change that is still to happen, and what was loaded for it when it was announced."""

    frame: int
    change: Change
    motion: Motion | None  #: Sum of its signals.
    law: Law | None  #: The law that it names.


class RequestAt(Settings):
    """One request of the operator."""

    at: Time  #: When [s].
    request: Annotated[_RequestName, BeforeValidator(name_of_state)]  #: What is requested.

    @model_validator(mode="before")
    @classmethod
    def _from_pair(cls, value: Any) -> Any:
        match value:
            case (time, request) if isinstance(value, tuple):
                return {"at": time, "request": request}
        return value


Requests = Annotated[tuple[RequestAt, ...], _ListAsTuple]


@lru_cache
def _model(plant: str) -> mujoco.MjModel:
    return make_plant(plant).drawn_model


def check_leg(failure: Failure) -> None:
    """Refuse a leg that no machine of a file has."""
    leg, kind = failure.leg, failure.kind
    if leg is not None and leg > _LEGS:
        raise InputError(f"leg: {leg} of {kind} is not a leg; allowed: 1 to {_LEGS}")


def check_order(
    changes: Sequence[Change],
    events: Sequence[Event],
    requests: Sequence[RequestAt],
    end: int,
    rate: int,
) -> None:
    """Refuse what never happens before the end, or changes not in the order of their frames."""
    frames_of_fields, frame_before = list[tuple[str, int]](), 0
    for number, change in enumerate(changes):
        with within(f"change.{number}"):
            frame = change.at_frame(rate)
        if frame < frame_before:
            text = f"frame {frame} comes after frame {frame_before}; sort by time"
            raise InputError(f"change: {text}")
        frames_of_fields.append(("change", frame))
        frame_before = frame
    frames_of_fields += [("event", round(event.at * rate)) for event in events]
    frames_of_fields += [("operation.request", round(x.at * rate)) for x in requests]
    for field, frame in frames_of_fields:
        if frame >= end:
            allowed = f"before the end of the run at {end / rate:g} s"
            raise InputError(f"{field}: at {frame / rate:g} s never happens; allowed: {allowed}")


def overlaid_law(law: Law, gains: Mapping[str, Any]) -> Law:
    """A law with some of its fields replaced, tables entry by entry."""
    return validated(Law, merged(law.model_dump(), gains), "gains") if gains else law


def change_of(table: Mapping[str, Any]) -> Change:
    """A change from plain values, lists included."""
    return validated(Change, as_plain(table), "change")
