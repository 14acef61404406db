"""A session: one plant, one controller and the compiled loop, run in one go or in parts."""

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.modes import bound
from cmf_mj.control import protection
from cmf_mj.control.dcl import make_dcl
from cmf_mj.control.dcu.state import DcuSettings
from cmf_mj.control.engage import engaged_state, handed_over_state, integral_gain
from cmf_mj.control.law import Gains, Law
from cmf_mj.control.protection import ProtectionSettings
from cmf_mj.control.states import Request, State
from cmf_mj.core.arrays import FrozenList, check_memory
from cmf_mj.core.errors import InputError, RunError, check_name
from cmf_mj.electronics.chain import (
    ElectronicsSettings,
    ideal_electronics,
    make_electronics,
    measure,
)
from cmf_mj.facility import loop
from cmf_mj.facility.front import Source
from cmf_mj.facility.loop import Controller, Dynamics, Memory, Recorder, make_memory
from cmf_mj.facility.pace import Pace, make_pace
from cmf_mj.facility.record_layout import RecordRows, make_layout
from cmf_mj.plant.events import Event, make_timeline, no_faults
from cmf_mj.plant.hydraulics import open_to_hold
from cmf_mj.plant.native import without_clock
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record

_VERSIONS = {name: version(name) for name in ("cmf-mj", "mujoco", "numpy", "numba")}

_NO_LAW = Law(name="none", title="Open loop: the table is the valve command", direct_gain=Gains())
"""All gains are zero. The DCL of an open loop never runs; compiled code needs one of its type."""


class SessionSettings(NamedTuple):
    """Settings of a run, loaded."""

    events: tuple[Event, ...] = ()
    record_every: int = 1
    command_delay: int = 1
    protection: ProtectionSettings | None = None
    electronics: ElectronicsSettings | None = None
    dcu: DcuSettings | None = None  #: Of a run with a host.


class OutOfBounds(RunError):
    """The state of a run left its physical bounds."""

    def __init__(self, message: str, frame: int) -> None:
        """Keep the text of the error, and the control frame in which the state left its bounds."""
        super().__init__(message)
        self.frame = frame


class Session:
    """Plant, controller and record of one run, which other modules work on between its parts."""

    def __init__(
        self,
        plant: Plant,
        law: Law | None,
        source: Source,
        start: ArrayLike | None,
        settings: SessionSettings,
        *,
        frames: int | None = None,
        kept_seconds: float | None = None,
        pace: Pace | None = None,
        context: Mapping[str, Any] | None = None,
    ) -> None:
        """Put the plant at rest and engage the law there; see `run.Run`, which makes sessions."""
        self.plant, self.rate = plant, plant.machine.rate
        self.frames = source.table.shape[0] if frames is None else frames  #: Of the whole run.
        self.frame = 0  #: Control frames run so far.
        self._first_law = None if law is None else bound(law, plant)
        """The law at the start; None in an open loop. A record names it."""
        self.law_in_force = self._first_law  #: The last that `engage` was given.
        self._first_law_state: dict[str, list[float]] = {}
        """State of the law before the first frame, by dotted name; a record keeps it."""
        self._settings, self._context = settings, dict(context or {})
        self._events, self.record_every = settings.events, settings.record_every
        state_at_rest = plant.start(start)
        self._plant_start = plant.started  # another number means that it was reset since
        half_strokes = plant.hydraulics.cylinder.half_stroke
        self.dynamics = Dynamics(
            plant.mechanics(),
            plant.hydraulics,
            state_at_rest,
            no_faults(plant.legs),
            make_timeline(self._events, half_strokes, self.rate),
        )
        self.memory = make_memory(self.dynamics, settings.command_delay)
        self.controller = self._make_controller(source, pace)
        self.layout = make_layout(plant, has_law=law is not None, source=source)
        self.record_rows = self._make_record_rows(kept_seconds)
        self._recorder = self._make_recorder()

    def _make_controller(self, source: Source, pace: Pace | None) -> Controller:
        """The controller, engaged at rest; on the stops its valves are shut."""
        plant, law, settings, memory = self.plant, self._first_law, self._settings, self.memory
        at_rest, feedback, hold_commands = memory.truth, memory.feedback, memory.command
        electronics = ideal_electronics(plant.legs)
        if settings.electronics is not None:
            electronics = make_electronics(settings.electronics, at_rest, plant.machine)
        dcl = make_dcl(law or _NO_LAW.for_machine(plant.machine), plant.legs)
        reads_inertial = dcl.feedback.gravity_compensation
        measure(electronics, self.dynamics.faults, 0, at_rest, reads_inertial, feedback)
        on_stops = source.hosted and source.progress[0].state in (State.OFF, State.SETTLED)
        if not on_stops and integral_gain(dcl).all():
            hold_commands[:] = open_to_hold(plant.hydraulics, self.dynamics.state)
        reference = source.table[0].copy() if law else feedback.position
        state = engaged_state(dcl, reference, feedback, hold_commands[0])
        if on_stops:
            state.error.integral[:] = 0.0
        thresholds = settings.protection or protection.load_protection()
        return Controller(
            closed=law is not None,
            dcl=dcl,
            state=state,
            source=source,
            delay=settings.command_delay,
            guarded=settings.protection is not None,
            protection=protection.make_protection(thresholds, plant.machine.frame),
            guard=protection.protection_state(feedback.position),
            electronics=electronics,
            pace=pace or make_pace(),
        )

    def _make_record_rows(self, kept_seconds: float | None) -> RecordRows:
        frames = self.frames
        if kept_seconds is not None:
            frames = min(round(kept_seconds * self.rate), frames)
        rows = math.ceil(max(frames, 1) / self.record_every)
        text = f"a record of {rows} rows with {self.layout.width} numbers"
        check_memory("record_every", text, 1.0 * rows * self.layout.width)
        return RecordRows(self.layout, rows, keeps_all=kept_seconds is None)

    def _make_recorder(self) -> Recorder:
        step, frame = float(self.plant.model.opt.timestep), self.plant.machine.frame
        steps = round(frame / step)
        if steps < 1 or abs(steps * step - frame) > 1e-12:
            raise InputError(f"timestep: {step} s must divide the control frame of {frame} s")
        return Recorder(
            sensors=np.concatenate([*self.plant.sensors.values(), np.empty(0, dtype=np.int64)]),
            gimbals=self.plant.gimbal_sites,
            steps=steps,
            every=self.record_every,
            columns=self.layout.columns,
            out=self.record_rows.window,
        )

    @property
    def parts(self) -> tuple[Dynamics, Controller, Memory, Recorder]:
        """All that the loop works on, in the order of its arguments."""
        return self.dynamics, self.controller, self.memory, self._recorder

    @property
    def source(self) -> Source:
        """What gives the reference."""
        return self.controller.source

    @property
    def fault(self) -> protection.Fault | None:
        """The fault detected, also one that was reset, if there is one."""
        last = self.memory.progress[0]
        present = protection.latched_fault(self.controller.guard)
        return present or protection.fault_of(last.reset_code, last.reset_leg, last.reset_frame)

    def run(self, frames: int | None = None) -> None:
        """Run a number of control frames, by default all that are left.

        Raises `OutOfBounds` where the state leaves its bounds or MuJoCo warns; what and when are
        named. A plant that is another run's by now, or another thread's, is refused.
        """
        if self.frame == 0:
            state = self.controller.state.arrays()
            self._first_law_state = {name: FrozenList(x.tolist()) for name, x in state.items()}
        end = self.frames if frames is None else min(self.frame + frames, self.frames)
        block = self.record_rows.window.shape[0] * self.record_every
        while self.frame < end:
            stop = min(end, (self.frame // block + 1) * block)
            with self.plant.alone, without_clock():
                if self.plant.started != self._plant_start:
                    raise InputError("plant: has been reset since; allowed: one run at a time")
                breach_frame, bound_left, leg = loop.run(*self.parts, self.frame, stop)
            self.frame = stop if breach_frame < 0 else breach_frame
            self.record_rows.take(math.ceil(self.frame / self.record_every))
            if breach_frame >= 0:
                raise OutOfBounds(self._breach_text(bound_left, leg), breach_frame)

    def _breach_text(self, bound_left: int, leg: int) -> str:
        """Text on the bound that the state has left; what MuJoCo warns of comes first."""
        cap, rod = self.dynamics.state.pressure[leg]
        extension = self.memory.extension[leg]
        pressures = f"cap {cap:.4g} Pa, rod {rod:.4g} Pa gauge"
        hydraulics = self.dynamics.hydraulics
        half, proof = hydraulics.cylinder.half_stroke[leg], hydraulics.proof_pressure
        text_of_bound = {
            loop.FINITE: f"is not finite: {pressures}, extension {extension:.4g} m",
            loop.VACUUM: f"has a chamber below vacuum ({pressures}); cavitation_gas sets a floor",
            loop.PROOF: f"has a chamber beyond the proof pressure of {proof:.4g} Pa ({pressures})",
            loop.STROKE: f"is at {extension:.4f} m, beyond its stops at +-{half:.4f} m",
            loop.SOLUTION: "and its supply have no solution for this step",
        }
        text = self.plant.warning_text()
        if not text:
            text = f"{self.plant.actuators[leg]} {text_of_bound.get(bound_left, '')}"
        with_law = f" with law {self.law_in_force.name}" if self.law_in_force else ""
        return f"{self.plant.name}{with_law}: {text} at {self.frame / self.rate:.4f} s"

    def describe(self) -> dict[str, Any]:
        """What a record keeps of the run."""
        fault, law, settings = self.fault, self._first_law, self._settings
        detected = None
        if fault is not None:
            detected = {"name": fault.name, "leg": fault.leg, "time": fault.frame / self.rate}
        electronics, dcu_state = settings.electronics, self.source.dcu_state
        host: dict[str, Any] = {}
        if settings.dcu is not None:
            host["dcu"] = settings.dcu.model_dump(mode="json")
            host |= {"host_counts": dcu_state.counts, "host_rejections": dcu_state.rejections}
        return {
            **self.plant.describe(),
            "law": law.name if law else "",
            "law_parameters": law.model_dump(mode="json") if law else {},
            "law_state": self._first_law_state if law else {},
            "events": [event.model_dump(exclude_none=True) for event in self._events],
            "fault": detected,
            "electronics": electronics.describe(self.plant.machine) if electronics else None,
            "sample_rate": self.rate / self.record_every,
            "command_delay": settings.command_delay,
            "versions": dict(_VERSIONS),
            **self._context,
            **host,
        }

    def engage(self, law: Law) -> None:
        """Hand over to another law, from the next frame on, as `control.engage` says.

        Refused in an open loop, which has none to hand over from.
        """
        if self._first_law is None:
            raise InputError(f"law: {law.name} is refused; allowed: in a loop closed by a law")
        self.law_in_force = bound(law, self.plant)
        controller, feedback = self.controller, self.memory.feedback
        electronics = controller.electronics
        dcl = make_dcl(self.law_in_force, self.plant.legs)
        limited_reference = controller.dcl.workspace.limited_demand
        state = handed_over_state(
            controller.dcl,
            controller.state,
            dcl,
            limited_reference.copy() if self.frame else feedback.position,
            feedback,
            electronics.gravity if electronics.active else None,
        )
        self.controller = controller._replace(dcl=dcl, state=state)

    def replace_source(self, **fields: Any) -> None:
        """Continue with other values of fields of `Source`."""
        self.controller = self.controller._replace(source=self.source._replace(**fields))

    def request(self, code: Request) -> None:
        """Let the operator request something from the next frame on; refused without a host."""
        source = self.source
        if not source.hosted:
            raise InputError(f"request: {code.name} is refused; allowed: in a run with a host")
        self.replace_source(
            request_frame=np.append(source.request_frame, self.frame),
            request=np.append(source.request, int(code)),
        )

    def body_number(self, name: str = "") -> int:
        """Number of a body of the model, by default the first that carries the payload."""
        model = self.plant.model
        names = [model.body(i).name for i in range(1, model.nbody)]
        if not name:
            return int(self.dynamics.mechanics.payload_bodies[0])
        return int(model.body(check_name("body", name, names)).id)

    def push(self, wrenches: Mapping[int, Sequence[float]]) -> None:
        """Apply external forces and torques (6,) to bodies, by their numbers, besides an overload.

        An overload that strikes during a part of the run is part of them from the next part on.
        """
        forces, loaded = self.dynamics.mechanics.payload, self.dynamics.mechanics.payload_bodies
        for body, wrench in wrenches.items():
            forces[body] = wrench
            if body in loaded:
                forces[body, 2] -= self.dynamics.faults.plant[0].overload / loaded.size

    def inject(self, event: Event) -> None:
        """Put one more event on the time line, not before the present frame."""
        if round(event.at * self.rate) < self.frame:
            now = self.frame / self.rate
            raise InputError(f"at: {event.at} s of {event.kind} is past; allowed: from {now} s")
        events = (*self._events, event)
        strokes = self.plant.hydraulics.cylinder.half_stroke
        timeline = make_timeline(events, strokes, self.rate)
        self.dynamics = self.dynamics._replace(timeline=timeline)
        self._events = events

    def history(self) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]], dict[str, str]]:
        """Times, channels and units of all rows so far that are kept."""
        first, channels = self.record_rows.histories()
        units = {channel.name: channel.unit for channel in self.layout.channels}
        for name, (values, unit) in self.plant.derived_channels(channels).items():
            channels[name], units[name] = values, unit
        count = channels["leg_position"].shape[0]
        time = np.arange(first, first + count, dtype=np.float64) * self.record_every / self.rate
        return time, channels, units

    def record(self) -> Record:
        """All signals so far that are kept, and what determined them."""
        return Record(*self.history(), self.describe())
