"""A run: everything that determines a record, and the sessions that are made of it.

The settings of a run are those of a scenario's file. A program gives the same settings also what no
file holds: a plant that was built, a command, frames of a host.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, PlainValidator, field_validator, model_validator
from pydantic.json_schema import SkipJsonSchema

from cmf_mj.analysis.modes import bound
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.core.arrays import check_memory
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Arguments, Seed, in_range, name_or
from cmf_mj.core.units import LONGEST, MOST_FRAMES, RATE
from cmf_mj.electronics.chain import AnyElectronics
from cmf_mj.facility import changes
from cmf_mj.facility.front import Source
from cmf_mj.facility.host.handover import Ring
from cmf_mj.facility.host_chain import HostChain, dcu_of
from cmf_mj.facility.pace import Pace
from cmf_mj.facility.session import Session, SessionSettings
from cmf_mj.facility.signal import ValveCommands, as_source
from cmf_mj.facility.signal_session import BLOCK, SignalSession
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.models import CMF
from cmf_mj.plant.hexapod import PLANTS, make_plant
from cmf_mj.plant.parameters import fitting, hydraulics_of
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record

_IN_NO_FILE: Any = Field(None, exclude=True)


def _built_or_named(plant: Any) -> Any:
    """A plant by its name, or one that was built."""
    if not (plant in PLANTS if isinstance(plant, str) else isinstance(plant, Plant)):
        raise InputError(f"input should be {' or '.join(map(repr, PLANTS))}")
    return plant


_Whole = Annotated[int, BeforeValidator(lambda x: int(x) if isinstance(x, np.integer) else x)]
"""A whole number; NumPy's become Python's, so that runs share a compiled loop."""


class Run(Arguments):
    """Everything that determines a record; settings by name, TOML file or loaded.

    >>> command = cmf_mj.signals.sine("heave", 0.01, frequency=2.0, cycles=1)
    >>> run = cmf_mj.Run(plant=cmf_mj.Hexapod(), source=command, record_every=16)
    >>> record = run.record()  # what `simulate` gives
    >>> session = run.changed(law="original").session()
    >>> session.run(100)  # and then look at it, push it, hand over to another law
    >>> session.law_in_force.name
    'original'
    """

    title: str = ""  #: What it shows.
    plant: Annotated[
        str | Plant, PlainValidator(_built_or_named, json_schema_input_type=Literal[PLANTS])
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
    gains: changes.Gains = {}  #: Fields of the law to replace.
    signal: changes.Signals = ()  #: Demand: the sum of these; none is rest at neutral.
    source: SkipJsonSchema[Any] = _IN_NO_FILE
    """In place of signals a `Command`, poses (N, 6) [m, rad], z down, `LegDemand`, `ValveCommands`,
    a table of any of them, or the frames of a host."""
    start: SkipJsonSchema[Any] = _IN_NO_FILE
    """Configuration to start from, as `plant.place` takes it, by default the first pose of the
    demand, else the model's own; with a host the pose at which the demand begins."""
    events: changes.Events = changes.plural("event", "events")
    """Failures on the time line."""
    electronics: AnyElectronics = None
    """Sensors and servo electronics: `noisy`, or chosen part by part; default `ideal` ones."""
    protection: Annotated[str | ProtectionSettings, name_or(ProtectionSettings)] | None = None
    """Fault detection that makes an emergency stop, `default` or a file; default none."""
    operation: HostChain | None = None
    """The chain from host to valves; without it the signal is the demand itself."""
    duration: Annotated[float, Field(gt=0.0, le=LONGEST)] | Literal["open"] = 10.0
    """Length [s], by default of a table that of its rows; an `open` run goes on until it is ended,
    and can only be run live."""
    seed: Seed = 0  #: Of noise and random phases.
    record_every: Annotated[_Whole, Field(ge=1, le=MOST_FRAMES)] = 1
    """Keep one control frame in this many."""
    command_delay: Annotated[_Whole, Field(ge=0, le=RATE)] = 1
    """Control frames from the DCL to the valves."""
    change: tuple[changes.Change, ...] = ()  #: What changes, in order of time; of signals.

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
        has_host, has_source = self.operation is not None, self.source is not None
        if has_source and has_host != isinstance(self.source, Arrivals):
            raise InputError("operation: goes with signals or a host's frames, and these with it")
        if has_source and (self.signal or self.change):
            raise InputError("source: is given; allowed beside it: neither `signal` nor `change`")
        has_valve_commands = isinstance(self.source, ValveCommands)
        if has_valve_commands != (self.law is None) and not isinstance(self.source, Source):
            raise InputError("law: None opens the loop; allowed with a `source` of valve commands")
        if isinstance(self.plant, str):
            self._check_files()
        if not has_source:
            self._check_signals()
        return self

    def _check_files(self) -> None:
        """Refuse settings of a named plant that cannot be loaded."""
        machine = self.loaded_cab.machine
        hydraulics_of(machine, self.hydraulics)
        if self.protection is not None:
            load_protection(self.protection)
        if self.electronics is not None:
            self.electronics.of(machine)
        if self.operation is not None:
            self.operation.check(self.plant, machine)
        for event in self.events:
            changes.check_leg(event)

    def _check_signals(self) -> None:
        """Refuse what is too much to hold, never happens or cannot be made."""
        rate, signals = self.rate, list(self.signal)
        for change in self.change:
            signals += change.signal or ()
        seconds = sum(signal.at_rate(rate).length for signal in signals)
        check_memory("signal", f"the demand of {len(signals)} signals", 6.0 * rate * seconds)
        requests = () if self.operation is None else self.operation.requests
        end = self.frames or MOST_FRAMES
        changes.check_order(self.change, self.events, requests, end, rate)
        law, load = self.first_law(), cache(partial(load_law, machine=self.loaded_machine))
        for change in self.change:
            change.check(self.plant, self.operation is not None)
            named_law = law if change.law is None else load(change.law)
            law = bound(changes.overlaid_law(named_law, change.gains), self._law_carrier)

    def table(self) -> dict[str, Any]:
        """The run as a file has it, defaults left out."""
        if self.source is not None or isinstance(self.plant, Plant) or isinstance(self.law, Law):
            raise InputError("plant, law, source: a file holds names and signals, not what is made")
        left_out: Any = {"exclude_none": True, "exclude_defaults": True}
        table = self.model_dump(mode="json", by_alias=True, **left_out)
        if self.law != load_machine(self.machine).law:  # the field's default is the CMF's own
            table["law"] = str(self.law)
        return table

    def changed(self, **fields: Any) -> "Run":
        """The same run with other `fields`, checked again."""
        return Run(**{name: getattr(self, name) for name in self.model_fields_set} | fields)

    @property
    def loaded_cab(self) -> Cab:
        """The cab on the machine that are named."""
        return load_cab(self.cab, self.machine)

    @property
    def loaded_machine(self) -> Machine:
        """The machine that is named, or that of a plant that was built."""
        return self.loaded_cab.machine if isinstance(self.plant, str) else self.plant.machine

    @property
    def rate(self) -> int:
        """Control frames a second [Hz]."""
        return self.loaded_machine.rate

    @property
    def _law_carrier(self) -> str | Cab | Plant:
        """What laws are bound to."""
        return self.loaded_cab.assumed if self.plant == "hexapod" else self.plant

    def first_law(self) -> Law:
        """The law at the start, bound to the machine."""
        assert self.law is not None
        machine = self.loaded_machine
        law = changes.overlaid_law(load_law(self.law, machine), self.gains)
        return bound(law, self._law_carrier).for_machine(machine)

    @property
    def frames(self) -> int | None:
        """Control frames of the run; None for ever, or as many as the rows of its table."""
        has_table = self.source is not None and self.operation is None
        if self.duration == "open" or (has_table and "duration" not in self.model_fields_set):
            return None
        return max(round(self.duration * self.rate), 1)

    def session(
        self,
        *,
        kept_seconds: float | None = None,
        ring: Ring | None = None,
        pace: Pace | None = None,
    ) -> Session:
        """The run before its first frame, to be run in parts.

        All rows are kept, or those of the latest `kept_seconds`. With a `ring` of live frames the
        source is the log that they are collected in. Without `pace` the run does not wait.
        """
        if self.source is None:
            return SignalSession(self, kept_seconds)
        plant = self.built_plant()
        law = None if self.law is None else self.first_law()
        source, start, context = as_source(self.source, plant, self.start)
        if self.operation is not None:
            source, start = self.operation.source(plant.machine, source, self.start, ring)
        settings = self.session_settings(plant.machine)
        how: Any = {"frames": self.frames, "kept_seconds": kept_seconds, "pace": pace}
        return Session(plant, law, source, start, settings, context=context, **how)

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
        session, part_frames = self.session(), None if progress is None else BLOCK
        while session.frame < session.frames:
            session.run(part_frames)
            if progress is not None:
                progress(session.frame, session.frames)
        return session.record()

    def built_plant(self) -> Plant:
        """The plant that was given, or a new one of that name."""
        if isinstance(self.plant, Plant):
            return self.plant
        return make_plant(self.plant, self.loaded_cab, self.hydraulics)

    def session_settings(self, machine: Machine) -> SessionSettings:
        """Settings of the run as its session on a `machine` takes them."""
        protection, electronics, chain = self.protection, self.electronics, self.operation
        if electronics is not None and electronics.seed is None:
            electronics = electronics.model_copy(update={"seed": self.seed})
        return SessionSettings(
            self.events,
            self.record_every,
            self.command_delay,
            None if protection is None else load_protection(protection, fitting(machine)),
            electronics,
            None if chain is None else dcu_of(machine, chain.dcu),
        )
