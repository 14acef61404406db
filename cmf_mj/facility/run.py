"""A run: everything that determines a record, and the sessions that are made of it.

The settings of a run are those of a scenario's file. What no file holds, a plant that was built, a
command, frames of a host, is given to the same settings by a program.

The demand of signals is made in blocks of frames. A block begins at a multiple of its length
whatever the parts a session is run in, so that a live session and the scenario it leaves behind
compute the same numbers in the same arrays: the same bits.
"""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PlainValidator, field_validator, model_validator
from pydantic.json_schema import SkipJsonSchema

from cmf_mj.analysis.modes import bound
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.control.states import Request
from cmf_mj.core.arrays import check_memory
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Arguments, Seed, in_range, name_or
from cmf_mj.core.units import LONGEST, MOST_FRAMES, RATE
from cmf_mj.electronics.chain import AnyElectronics
from cmf_mj.facility import settings as parts
from cmf_mj.facility import signal as demands
from cmf_mj.facility.front import Source, from_table
from cmf_mj.facility.host.handover import Ring
from cmf_mj.facility.pace import Pace
from cmf_mj.facility.session import Session
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.models import CMF
from cmf_mj.plant.events import Event
from cmf_mj.plant.hexapod import PLANTS, make_plant
from cmf_mj.plant.parameters import fitting, hydraulics_of
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record

_IN_NO_FILE: Any = Field(None, exclude=True)


class Run(Arguments):
    """Everything that determines a record; settings by name, TOML file or loaded.

    >>> command = cmf_mj.signals.sine("heave", 0.01, frequency=2.0, cycles=1)
    >>> run = cmf_mj.Run(plant=cmf_mj.Hexapod(), source=command, record_every=16)
    >>> record = run.record()  # what `simulate` gives
    >>> session = run.but(law="original").session()
    >>> session.run(100)  # and then look at it, push it, exchange its law
    >>> session.look().law
    'original'
    """

    title: str = ""  #: What it shows.
    plant: Annotated[
        str | Plant, PlainValidator(parts.built_or_named, json_schema_input_type=Literal[PLANTS])
    ] = "hexapod"
    """The whole machine, its legs alone, or a plant that was built; that one has its own machine,
    cab and hydraulics."""
    machine: str = CMF  #: The motion base by name or TOML file.
    cab: str | None = None
    """Its cab by name or TOML file, default its first, of the CMF `gfd`; single legs have none."""
    hydraulics: str | None = None
    """`report`, `hardware`, `lossy` or a TOML file; default the machine's own, here `hardware`."""
    law: Annotated[str | Path | Law, name_or(Law)] | None = "velocity"
    """Control law by name or TOML file; default the machine's. None opens the loop: the source
    holds valve commands."""
    gains: parts.Gains = {}  #: Fields of the law to replace.
    signal: parts.Signals = ()  #: Demand: the sum of these; none is rest at neutral.
    source: SkipJsonSchema[Any] = _IN_NO_FILE
    """In place of signals a `Command`, poses (N, 6) [m, rad], z down, `LegDemand`, `ValveCommands`,
    a table of any of them, or the frames of a host."""
    start: SkipJsonSchema[Any] = _IN_NO_FILE
    """Configuration to start from, as `plant.place` takes it, by default the first pose of the
    demand, else the model's own; with a host the pose at which the demand begins."""
    events: parts.Events = parts.plural("event", "events")
    """Failures on the time line."""
    electronics: AnyElectronics = None
    """Sensors and servo electronics: `noisy`, or chosen part by part; default `ideal` ones."""
    protection: Annotated[str | ProtectionSettings, name_or(ProtectionSettings)] | None = None
    """Fault detection that makes an emergency stop, `default` or a file; default none."""
    operation: parts.HostChain | None = None
    """The chain from host to valves; without it the signal is the demand itself."""
    duration: Annotated[float, Field(gt=0.0, le=LONGEST)] | Literal["open"] = 10.0
    """Length [s], by default of a table that of its rows; an `open` run goes on until it is ended,
    and can only be run live."""
    seed: Seed = 0  #: Of noise and random phases.
    record_every: Annotated[parts.Whole, Field(ge=1, le=MOST_FRAMES)] = 1
    """Keep one control frame in this many."""
    command_delay: Annotated[parts.Whole, Field(ge=0, le=RATE)] = 1
    """Control frames from the DCL to the valves."""
    change: tuple[parts.Change, ...] = ()  #: What changes, in order of time; of signals.

    @field_validator("*")
    @classmethod
    def _numbers(cls, value: Any, info: Any) -> Any:  # type: ignore[override]
        return value if info.field_name in ("source", "start") else in_range(value)

    @model_validator(mode="wrap")
    @classmethod
    def _with_law(cls, table: Any, make: Callable[[Any], Self]) -> Self:
        """The machine's law where a run names none; it counts as not set."""
        if (
            not isinstance(table, dict)
            or "law" in table
            or not isinstance(table.get("machine"), str)
        ):
            return make(table)
        run = make({"law": load_machine(table["machine"]).law} | table)
        run.model_fields_set.discard("law")
        return run

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        hosted = self.operation is not None
        if hosted != isinstance(self.source, Arrivals) and self.source is not None:
            raise InputError("operation: goes with signals or a host's frames, and these with it")
        if self.source is not None and (self.signal or self.change):
            raise InputError("source: is given; allowed beside it: neither `signal` nor `change`")
        opened = isinstance(self.source, demands.ValveCommands)
        if opened != (self.law is None) and not isinstance(self.source, Source):
            raise InputError("law: None opens the loop; allowed with a `source` of valve commands")
        if isinstance(self.plant, str):
            self._files()
        if self.source is None:
            self._signals()
        return self

    def _files(self) -> None:
        """Refuse settings of a named plant that cannot be loaded."""
        machine = self.carried.machine
        hydraulics_of(machine, self.hydraulics)
        if self.protection is not None:
            load_protection(self.protection)
        if self.electronics is not None:
            self.electronics.of(machine)
        if self.operation is not None:
            self.operation.check(self.plant, machine)
        for event in self.events:
            parts.check_leg(event)

    def _signals(self) -> None:
        """Refuse what is too much to hold, never happens or cannot be made."""
        rate, signals = self.rate, list(self.signal)
        signals += [one for change in self.change for one in change.signal or ()]
        seconds = sum(signal.at_rate(rate).length for signal in signals)
        check_memory("signal", f"the demand of {len(signals)} signals", 6.0 * rate * seconds)
        requests = () if self.operation is None else self.operation.requests
        parts.check_order(self.change, self.events, requests, self.frames or MOST_FRAMES, rate)
        law, load = self.begun_law(), cache(partial(load_law, machine=self._base))
        for change in self.change:
            change.check(self.plant, self.operation is not None)
            named = None if change.law is None else load(change.law)
            law = bound(parts.overlaid_law(named or law, change.gains), self._bound_to)

    def table(self) -> dict[str, Any]:
        """The run as a file has it, defaults left out."""
        if self.source is not None or isinstance(self.plant, Plant) or isinstance(self.law, Law):
            raise InputError("plant, law, source: a file holds names and signals, not what is made")
        how: Any = {"mode": "json", "by_alias": True, "exclude_none": True}
        table = self.model_dump(**how, exclude_defaults=True)
        if self.law != load_machine(self.machine).law:  # the field's default is the CMF's own
            table["law"] = str(self.law)
        return table

    def but(self, **fields: Any) -> "Run":
        """The same run with other `fields`, checked again."""
        return Run(**{name: getattr(self, name) for name in self.model_fields_set} | fields)

    @property
    def carried(self) -> Cab:
        """The cab on the machine that are named."""
        return load_cab(self.cab, self.machine)

    @property
    def rate(self) -> int:
        """Control frames a second [Hz]."""
        return self._base.rate

    @property
    def _base(self) -> Machine:
        return self.carried.machine if isinstance(self.plant, str) else self.plant.machine

    @property
    def _bound_to(self) -> str | Cab | Plant:
        """What laws are bound to."""
        return self.carried.assumed if self.plant == "hexapod" else self.plant

    def begun_law(self) -> Law:
        """The law at the start, bound to the machine."""
        assert self.law is not None
        law = parts.overlaid_law(load_law(self.law, self._base), self.gains)
        return bound(law, self._bound_to).for_machine(self._base)

    @property
    def frames(self) -> int | None:
        """Control frames of the run; None for ever, or as many as the rows of its table."""
        tabled = self.source is not None and self.operation is None
        if self.duration == "open" or (tabled and "duration" not in self.model_fields_set):
            return None
        return max(round(self.duration * self.rate), 1)

    def session(
        self, *, keep: float | None = None, ring: Ring | None = None, pace: Pace | None = None
    ) -> Session:
        """The run before its first frame, to be run in parts.

        Of all frames, or of the latest that are so many seconds, `keep`, the rows are kept. With a
        `ring` of live frames the source is the log that they are collected in. Without `pace` the
        run goes as fast as possible.
        """
        if self.source is None:
            return SignalSession(self, keep)
        plant = self.built_plant()
        law = None if self.law is None else self.begun_law()
        source, start, context = demands.as_source(self.source, plant, self.start)
        if self.operation is not None:
            source, start = self.operation.source(plant.machine, source, self.start, ring)
        settings, frames = self._session_settings(plant.machine), self.frames
        how: Any = {"frames": frames, "context": context, "keep": keep, "pace": pace}
        return Session(plant, law, source, start, settings, **how)

    def record(self, *, progress: Callable[[int, int], None] | None = None) -> Record:
        """All signals from beginning to end.

        Args:
            progress: called about twice a second of the run, with frames run and those in all.

        Raises:
            InputError: an argument out of range, named; an `open` duration.
            OutOfBounds: the state left its physical bounds; leg, time and value are named.
        """
        if self.duration == "open":
            raise InputError("duration: is open; a run to the end needs one in s")
        session, part = self.session(), None if progress is None else demands.BLOCK
        while session.frame < session.frames:
            session.run(part)
            if progress is not None:
                progress(session.frame, session.frames)
        return session.record()

    def built_plant(self) -> Plant:
        """The plant that was given, or a new one of that name."""
        if isinstance(self.plant, Plant):
            return self.plant
        return make_plant(self.plant, self.carried, self.hydraulics)

    def _session_settings(self, machine: Machine) -> parts.SessionSettings:
        """Settings of the run as its session takes them."""
        guard, electronics = self.protection, self.electronics
        if electronics is not None and electronics.seed is None:
            electronics = electronics.model_copy(update={"seed": self.seed})
        return parts.SessionSettings(
            self.events,
            self.record_every,
            self.command_delay,
            None if guard is None else load_protection(guard, fitting(machine)),
            electronics,
            None if self.operation is None else parts.dcu_of(machine, self.operation.dcu),
        )


class SignalSession(Session):
    """A session on signals: change it as it goes, and take away what was done."""

    def __init__(self, run: Run, keep: float | None = None) -> None:
        """Put the plant at rest at the first pose of the demand and engage the law.

        The latest `keep` seconds are kept, by default all, of an `open` run 600 s.
        """
        if run.source is not None:
            raise InputError("source: is a table or a host's; allowed: a run of signals")
        plant, operation = run.built_plant(), run.operation
        self._scenario, rate, frames = run, plant.machine.rate, run.frames
        self._demand = demands.LayeredDemand(demands.added(run.signal, run.seed, rate))
        if operation is None:
            table = demands.TableFeed(self._demand, plant.machine)
            self._feed: demands.TableFeed | demands.HostFeed = table
            source = from_table(table.legs, table.poses)
            start = table.poses[0] if run.start is None else run.start
        else:
            hosted = demands.HostFeed(self._demand, rate, operation.host_every, frames)
            self._feed = hosted
            source, start = operation.source(plant.machine, hosted.log, run.start)
        keep = 600.0 if frames is None and keep is None else keep
        settings, frames = run._session_settings(plant.machine), frames or MOST_FRAMES
        super().__init__(plant, run.begun_law(), source, start, settings, frames=frames, keep=keep)
        self._filled = 0
        load = cache(partial(load_law, machine=plant.machine))
        self._due = deque(self._checked(one.when(rate), one, load) for one in run.change)
        self._laws_after(self._due)
        self._done: list[parts.Change] = []
        self._pushes: dict[int, tuple[float, ...]] = {}
        self._after_failures = sorted(round(event.at * rate) + 1 for event in run.events)

    def run(self, frames: int | None = None) -> None:
        """Run a number of control frames, at most to the end; refusals as of any session.

        In parts, each to the next frame in which something is due: the end, a change, a new block
        of the demand, or the frame after a failure, in which an overload joins the pushes.
        """
        target = self.frames if frames is None else min(self.frame + frames, self.frames)
        while self.frame < target:
            while self._due and self._due[0].frame <= self.frame:
                self._carry_out(self._due.popleft())
            if self.frame % demands.BLOCK == 0:
                self._refill(self.frame)
            self.push(self._pushes)
            ends = [target, (self.frame // demands.BLOCK + 1) * demands.BLOCK]
            ends += [due.frame for due in self._due]
            ends += [strike for strike in self._after_failures if strike > self.frame]
            super().run(min(ends) - self.frame)

    def apply(self, change: parts.Change) -> None:
        """Change something from the next frame on.

        A law takes over as `control.engage` says, signals as `LayeredDemand` says. A change with a
        time is refused.
        """
        if (change.at, change.frame) != (None, None):
            raise InputError("at, frame: a change applied live happens in the next frame")
        at = sum(due.frame <= self.frame for due in self._due)
        coming = list(self._due)
        load = partial(load_law, machine=self.plant.machine)
        coming.insert(at, self._checked(self.frame, change, load))
        self._laws_after(coming)
        self._due = deque(coming)

    def done(self) -> Run:
        """What has been done so far, as a run that does it again bit for bit."""
        frames, begun, rate = max(self.frame, 1), self._scenario, self.rate
        past: dict[str, Any] = {
            "change": tuple(change for change in self._done if change.when(rate) < frames),
            "events": tuple(event for event in begun.events if round(event.at * rate) < frames),
            "duration": frames / rate,
        }
        if begun.operation is not None:
            asked = tuple(r for r in begun.operation.requests if round(r.at * rate) < frames)
            past["operation"] = begun.operation.model_copy(update={"requests": asked})
        return begun.model_copy(update=past)

    def describe(self) -> dict[str, Any]:
        """What a record keeps of the run, the scenario among it."""
        done, command = self.done(), {"kind": "scenario"}
        if len(done.signal) == 1 and all(change.signal is None for change in done.change):
            command = done.signal[0].described()
        said: dict[str, Any] = {"command": command, "seed": done.seed}
        with suppress(InputError):  # of a plant or law that was made
            said["scenario"] = done.table()
        return said | super().describe()

    def _checked(self, frame: int, change: parts.Change, load: Any) -> parts.Due:
        """The change with its motion, after a check that all of it is possible."""
        run, signal = self._scenario, change.signal
        change.check(run.plant, run.operation is not None)
        motion = None if signal is None else demands.added(signal, run.seed, self.rate)
        return parts.Due(frame, change, motion, None if change.law is None else load(change.law))

    def _laws_after(self, coming: Sequence[parts.Due]) -> list[Law]:
        """The law after each of the coming changes; one may make the next impossible."""
        laws = [] if self._engaged is None else [self._engaged]
        for due in coming:
            law = parts.overlaid_law(due.law or laws[-1], due.change.gains)
            laws.append(bound(law, self.plant))
        return laws[1:]

    def _carry_out(self, due: parts.Due) -> None:
        """Make a change, and keep it with its frame for `done`."""
        change = due.change
        self._done.append(change.model_copy(update={"at": None, "frame": self.frame}))
        if change.law is not None or change.gains:
            self.engage(self._laws_after([due])[0])
        if due.motion is not None:
            self._demand.change(self.frame, due.motion, round(change.fade * self.rate))
            if self.frame % demands.BLOCK:
                self._refill(self._filled)
        for failure in change.failure:
            self.inject(Event(at=self.frame / self.rate, **dict(failure)))
            self._after_failures.append(self.frame + 1)
        if change.push is not None:
            push = change.push
            self._pushes[self.body(push.body)] = (*push.force, *push.torque)
        if change.request is not None:
            self.request(Request[change.request.upper()])

    def _refill(self, first: int) -> None:
        self._feed.fill(first)
        if isinstance(self._feed, demands.HostFeed):
            self.exchange(arrivals=self._feed.log)
        self._filled = first
