"""A scenario: one run as a file, from plant and law to the changes that happen while it goes."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from cmf_mj.analysis.linear.binding import bound
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import load_protection
from cmf_mj.control.states import load_state_settings
from cmf_mj.core.arrays import check_memory
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import (
    Count,
    Seed,
    Settings,
    Time,
    checked_name,
    merged,
    validated,
)
from cmf_mj.core.units import LONGEST, MOST_FRAMES, RATE
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.run import dcu_of
from cmf_mj.facility.scenario.signal import Signal
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.machine import load_machine
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.events import MOST_FORCE, Event, Failure
from cmf_mj.plant.hexapod import make_plant
from cmf_mj.plant.parameters import hydraulics_of
from cmf_mj.signals.signal import plain

LEGS = 6  #: Of the machines that a scenario runs.

Gains = dict[str, Any]
"""Fields of a law to replace, as `laws.toml` names them: `{direct_gain = {velocity = -2.0}}`."""

_Force = Annotated[float, Field(ge=-MOST_FORCE, le=MOST_FORCE)]
Vector = tuple[_Force, _Force, _Force]
Signals = Annotated[tuple[Signal, ...], Field(max_length=100)]
RequestName = Literal["off", "settle", "raise", "hold", "engage", "trip", "reset"]
Length = Annotated[float, Field(gt=0.0, le=LONGEST)]


def _ending(*allowed: str) -> AfterValidator:
    def check(name: str) -> str:
        if Path(name).suffix not in allowed or Path(name).name != name:
            raise InputError(f"must be a plain file name that ends in {' or '.join(allowed)}")
        checked_name(Path(name).stem)
        return name

    return AfterValidator(check)


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

    at: Time | None = None
    """When [s], to the nearest control frame; in a file this or `frame`."""
    frame: Annotated[int, Field(ge=0, lt=MOST_FRAMES)] | None = None  #: In which control frame.
    law: str | None = None  #: Law that takes over, by name or TOML file; drops earlier `gains`.
    gains: Gains = {}  #: Fields of the law in force to replace.
    signal: Signals | None = None
    """Signals that take over, beginning now; `[]` goes to neutral."""
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
            raise InputError("at: is missing; a change in a scenario needs `at` or `frame`")
        return round(self.at * rate)


class RequestAt(Settings):
    """One request of the operator."""

    at: Time  #: When [s].
    request: RequestName  #: What is requested.


class OperationChoice(Settings):
    """The whole chain from host to valves; without it the signal is the demand itself."""

    begin: Literal["off", "settled", "hold", "engaged"] = "settled"  #: Operating state to begin in.
    request: tuple[RequestAt, ...] = (RequestAt(at=0.0, request="engage"),)  #: Operator's requests.
    host_every: Annotated[int, Field(ge=1, le=RATE)] = 26
    """Control frames from one host frame to the next; 26 are 78.8 Hz."""
    dcu: str | None = None  #: Digital Control Unit, `default` or a file; default the machine's.
    limits: str | None = None  #: File of the limits of platform and legs.
    states: str | None = None  #: File of the operating states' times.


class VideoChoice(Settings):
    """A film of the run."""

    file: Annotated[str, _ending(".mp4", ".gif")] = "video.mp4"  #: Name.
    camera: str = "overview"  #: Camera of the model.
    fps: Annotated[int, Field(ge=1, le=120)] = 30  #: Frame rate [1/s].
    speed: Annotated[float, Field(ge=0.01, le=100.0)] = 1.0
    """Times real speed; below 1 is slow motion."""


class Outputs(Settings):
    """What `cmf run` writes, besides the scenario itself."""

    record: Annotated[str, _ending(".parquet")] | Literal[False] = "record.parquet"
    """All signals, or false."""
    plot: Annotated[str, _ending(".png", ".svg", ".pdf")] | Literal[False] = "overview.png"
    """Figure of demand, response, valves and pressures, or false."""
    video: VideoChoice | None = None  #: Film.


class Scenario(Settings):
    """One run."""

    title: str = ""  #: What it shows.
    plant: Literal["hexapod", "single_legs"] = "hexapod"  #: The whole machine, or its legs alone.
    machine: str = CMF  #: The motion base by name or TOML file.
    cab: str | None = None
    """Its cab by name or TOML file, default its first, of the CMF `gfd`; single legs have none."""
    hydraulics: str | None = None
    """`report`, `hardware`, `lossy` or a TOML file; default the machine's own, here `hardware`."""
    law: str = "velocity"  #: Control law by name or TOML file; default the machine's.
    gains: Gains = {}  #: Fields of the law to replace.
    signal: Signals = ()  #: Demand: the sum of these; none is rest at neutral.
    event: tuple[Event, ...] = ()  #: Failures on the time line.
    electronics: ElectronicsSettings | None = None
    """Noisy sensors and servo electronics; default ideal ones."""
    protection: str | None = None
    """Fault detection that makes an emergency stop, `default` or a file; default none."""
    operation: OperationChoice | None = None  #: The chain from host to valves; default none.
    duration: Length | Literal["open"] = 10.0
    """Length [s]; an `open` run goes on until it is ended, and can only be run live."""
    seed: Seed = 0  #: Of noise and random phases.
    record_every: Count = 1  #: Keep one control frame in this many.
    outputs: Outputs = Outputs()  #: What to write.
    change: tuple[Change, ...] = ()  #: What changes, in order of time.

    @model_validator(mode="before")
    @classmethod
    def _with_law(cls, table: Any) -> Any:
        if not (isinstance(table, dict) and isinstance(table.get("machine"), str)):
            return table
        return {"law": load_machine(table["machine"]).law} | table

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._files()
        self._times()
        law, laws = self.begun_law(), Laws()
        for change in self.change:
            self.check_change(change)
            law = bound(changed_law(law, change, laws), self.law_key)
        for event in self.event:
            _check_leg(event)
        if self.outputs.video is not None:
            if self.frames is not None and self.frames <= self.record_every:
                raise InputError(
                    f"record_every: {self.record_every} leaves one row; allowed for a film: below "
                    f"{self.frames}"
                )
            cameras = names_of(self.plant).cameras
            check_name("outputs.video.camera", self.outputs.video.camera, cameras)
        return self

    def _files(self) -> None:
        """Refuse settings that cannot be loaded."""
        hydraulics_of(self.carried.machine, self.hydraulics)
        if self.protection is not None:
            load_protection(self.protection)
        if self.electronics is not None:
            self.electronics.of(self.carried.machine)
        if self.operation is not None:
            if self.plant != "hexapod":
                raise InputError(f"operation: is for the hexapod, plant is {self.plant}")
            dcu_of(self.carried.machine, self.operation.dcu)
            load_motion_limits(self.operation.limits, self.carried.machine)
            load_state_settings(self.operation.states)

    def _times(self) -> None:
        """Refuse what never happens, or not in this order, or is too much to hold."""
        rate, signals = self.rate, list(self.signal)
        signals += [one for change in self.change for one in change.signal or ()]
        seconds = sum(signal.at_rate(rate).length for signal in signals)
        check_memory("signal", f"the demand of {len(signals)} signals", 6.0 * rate * seconds)
        last, end = 0, MOST_FRAMES if self.frames is None else self.frames
        for number, change in enumerate(self.change):
            if change.at is None and change.frame is None:
                raise InputError(f"change.{number}: needs `at` in s or `frame`")
            frame = change.when(rate)
            if frame < last:
                raise InputError(f"change: frame {frame} comes after frame {last}; sort by time")
            last = frame
        happens = [("change", change.when(rate)) for change in self.change]
        happens += [("event", round(event.at * rate)) for event in self.event]
        if self.operation is not None:
            happens += [("operation.request", round(r.at * rate)) for r in self.operation.request]
        for field, frame in happens:
            if frame >= end:
                raise InputError(
                    f"{field}: at {frame / rate:g} s never happens; allowed: before the end of the "
                    f"run at {end / rate:g} s"
                )

    def check_change(self, change: Change) -> None:
        """Refuse a change that this machine cannot do; the law apart."""
        for failure in change.failure:
            _check_leg(failure)
        if change.push is not None and change.push.body:
            check_name("body", change.push.body, names_of(self.plant).bodies)
        if change.request is not None and self.operation is None:
            raise InputError(f"change: request {change.request!r} needs [operation]")

    @property
    def law_key(self) -> str | Cab:
        """What a law is bound to, as of its plant."""
        return self.carried.known_as if self.plant == "hexapod" else self.plant

    @property
    def carried(self) -> Cab:
        """The cab on its machine."""
        return load_cab(self.cab, self.machine)

    @property
    def rate(self) -> int:
        """Control frames a second [Hz]."""
        return self.carried.machine.rate

    def begun_law(self) -> Law:
        """The law at the start, bound to the machine."""
        return bound(overlaid_law(load_law(self.law), self.gains), self.law_key).on(
            self.carried.machine
        )

    @property
    def frames(self) -> int | None:
        """Control frames of the run; None for ever."""
        return None if self.duration == "open" else max(round(self.duration * self.rate), 1)

    def chosen_electronics(self) -> ElectronicsSettings | None:
        """Electronics of the run."""
        chosen = self.electronics
        if chosen is None or chosen.seed is not None:
            return chosen
        return chosen.model_copy(update={"seed": self.seed})


class Names(NamedTuple):
    """Names of a machine's model."""

    bodies: tuple[str, ...]
    cameras: tuple[str, ...]


@lru_cache
def names_of(plant: str) -> Names:
    """The names of a plant, with whatever cab."""
    model = make_plant(plant).drawn_model
    bodies = tuple(model.body(i).name for i in range(1, model.nbody))
    return Names(bodies, tuple(model.camera(i).name for i in range(model.ncam)))


def _check_leg(failure: Failure) -> None:
    if failure.leg is not None and failure.leg > LEGS:
        raise InputError(f"leg: {failure.leg} of {failure.kind} is not a leg; allowed: 1 to {LEGS}")


def overlaid_law(law: Law, gains: Mapping[str, Any]) -> Law:
    """A law with some of its fields replaced, tables entry by entry."""
    return validated(Law, merged(law.model_dump(), gains), "gains") if gains else law


class Laws(dict[str, Law]):
    """Laws by name or TOML file, each read when it is asked for first."""

    def __missing__(self, source: str) -> Law:
        """Read one."""
        self[source] = load_law(source)
        return self[source]


def changed_law(law: Law, change: Change, laws: Laws) -> Law:
    """The law after a change."""
    if change.law is not None:
        law = laws[change.law]
    return overlaid_law(law, change.gains)


def change_of(table: Mapping[str, Any], where: str = "change") -> Change:
    """A change from plain values, lists included."""
    return validated(Change, plain(table), where)
