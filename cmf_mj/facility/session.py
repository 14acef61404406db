"""A session: one plant, one controller and the compiled loop, run in one go or in parts."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.modes import bound
from cmf_mj.control import protection
from cmf_mj.control.dcl import make_dcl
from cmf_mj.control.dcu.acceptance import host_is_late
from cmf_mj.control.engage import engaged_state, handed_over_state, integral_gain
from cmf_mj.control.law import Gains, Law
from cmf_mj.control.states import Request, State
from cmf_mj.core.arrays import FrozenList, check_memory
from cmf_mj.core.errors import InputError, RunError, check_name
from cmf_mj.electronics.chain import ideal_electronics, make_electronics, measure
from cmf_mj.facility import loop
from cmf_mj.facility.front import Source
from cmf_mj.facility.loop import Controller, Dynamics, Memory, Recorder, make_memory
from cmf_mj.facility.pace import Pace, make_pace
from cmf_mj.facility.record_layout import CHAIN, LAW, make_layout
from cmf_mj.facility.settings import SessionSettings
from cmf_mj.plant import fit
from cmf_mj.plant.cylinder import CAP, ROD
from cmf_mj.plant.events import Event, make_timeline, no_faults
from cmf_mj.plant.hydraulics import open_to_hold
from cmf_mj.plant.native import without_clock
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.supply import RETURN_PRESSURE, SUPPLY_PRESSURE
from cmf_mj.record.record import Record

_VERSIONS = {name: version(name) for name in ("cmf-mj", "mujoco", "numpy", "numba")}

_NO_LAW = Law(name="none", title="Open loop: the table is the valve command", direct_gain=Gains())
"""All gains are zero. The DCL of an open loop never runs; compiled code needs one of its type."""

_ROWS = 2048  #: Rows that the loop writes before each channel takes its own out of them.


class OutOfBounds(RunError):
    """The state of a run left its physical bounds."""

    def __init__(self, message: str, frame: int) -> None:
        """Keep what to say and the control frame it happened in."""
        super().__init__(message)
        self.frame = frame


class Live(NamedTuple):
    """The present state of a run, copied; arrays with a leg axis are (n,)."""

    time: float  #: Time of the next frame [s].
    qpos: NDArray[np.float64]  #: MuJoCo's generalised positions, (nq,).
    demand: NDArray[np.float64]  #: Platform demand, last frame [m, rad], z down, (6,), or NaN.
    reference: NDArray[np.float64]  #: Leg reference [m].
    extension: NDArray[np.float64]  #: True leg extension from neutral [m].
    valve_command: NDArray[np.float64]  #: Fraction of full command.
    cap_pressure: NDArray[np.float64]  #: [Pa] gauge.
    rod_pressure: NDArray[np.float64]  #: [Pa] gauge.
    force: NDArray[np.float64]  #: Cylinder force [N], positive extending.
    supply_pressure: float  #: [Pa] gauge.
    return_pressure: float  #: [Pa] gauge.
    law: str  #: Name of the law in force.
    state: str  #: Operating state; empty without a host.
    fault: protection.Fault | None  #: Fault detected.
    late: bool  #: Whether the host is late.


class Session:
    """Plant, controller and record of one run.

    Others work on its insides between parts of the run: `run.SignalSession`, the subclass, reads
    `_engaged`; `host.moog` reads `source` and `memory` and puts requests in `source.progress`;
    environments read `memory` and `dynamics`, `operation` `source`, `export.machine` all `parts`.
    """

    def __init__(
        self,
        plant: Plant,
        law: Law | None,
        source: Source,
        start: ArrayLike | None,
        settings: SessionSettings,
        *,
        frames: int | None = None,
        keep: float | None = None,
        pace: Pace | None = None,
        context: Mapping[str, Any] | None = None,
    ) -> None:
        """Put the plant at rest and engage the law there; see `run.Run`, which makes sessions."""
        self.plant, self.rate = plant, plant.machine.rate
        self._law = None if law is None else bound(law, plant)
        """The law at the start, bound to the plant; a record names it."""
        self._engaged = self._law
        """The law in force, the last that `engage` was given; None in an open loop."""
        self._settings, self._context = settings, dict(context or {})
        self._events, self.every = settings.events, settings.record_every
        self.frames = source.table.shape[0] if frames is None else frames
        self.frame = 0
        """Control frames run so far."""
        state = plant.start(start)
        self.dynamics = Dynamics(
            plant.mechanics(),
            plant.hydraulics,
            state,
            no_faults(plant.legs),
            make_timeline(self._events, plant.hydraulics.cylinder.half_stroke, self.rate),
        )
        self.memory = make_memory(self.dynamics, settings.command_delay)
        self.controller = self._controller(source, pace)
        self._started = plant.started
        """Number of the plant's last start: another one means that it was reset since."""
        self._begun: dict[str, list[float]] = {}
        """State of the law before the first frame, by dotted name; a record keeps it."""
        posed = {"demand_pose"} if source.poses.size else set()
        absent = set() if source.hosted else set(CHAIN) - posed
        self.layout = make_layout(plant, absent if law else absent | set(LAW))
        self._taken = 0
        """Rows that the channels have taken so far."""
        self._kept: dict[str, NDArray[np.float64]] = {}
        """All rows of each channel; empty where only the latest are kept."""
        self._recorder = self._make_recorder(keep)

    def _controller(self, source: Source, pace: Pace | None) -> Controller:
        """The controller, engaged at rest."""
        plant, law, settings = self.plant, self._law, self._settings
        at_rest, feedback = self.memory.truth, self.memory.feedback
        parts = ideal_electronics(plant.legs)
        if settings.electronics is not None:
            parts = make_electronics(settings.electronics, at_rest, plant.machine)
        dcl = make_dcl(law or _NO_LAW.for_machine(plant.machine), plant.legs)
        compensated = dcl.feedback.gravity_compensation
        measure(parts, self.dynamics.faults, 0, at_rest, compensated, feedback)
        off = source.hosted and source.progress[0].state in (State.OFF, State.SETTLED)
        hold = self.memory.command
        if not off and integral_gain(dcl).all():
            hold[:] = open_to_hold(plant.hydraulics, self.dynamics.state)
        reference = source.table[0].copy() if law else feedback.position
        state = engaged_state(dcl, reference, feedback, hold[0])
        if off:
            state.error.integral[:] = 0.0
        guard = settings.protection
        frame = plant.machine.frame
        thresholds = protection.make_protection(guard or protection.load_protection(), frame)
        return Controller(
            closed=law is not None,
            dcl=dcl,
            state=state,
            source=source,
            delay=settings.command_delay,
            guarded=guard is not None,
            protection=thresholds,
            guard=protection.protection_state(feedback.position),
            electronics=parts,
            pace=pace or make_pace(),
        )

    def _make_recorder(self, keep: float | None) -> Recorder:
        """A recorder of all rows, a block at a time, or of the latest of some seconds."""
        plant, step = self.plant, float(self.plant.model.opt.timestep)
        steps = round(plant.machine.frame / step)
        if steps < 1 or abs(steps * step - plant.machine.frame) > 1e-12:
            frame = plant.machine.frame
            raise InputError(f"timestep: {step} s must divide the control frame of {frame} s")
        window = self.frames if keep is None else min(round(keep * self.rate), self.frames)
        rows = -(-max(window, 1) // self.every)
        part = f"a record of {rows} rows with {self.layout.width} numbers"
        check_memory("record_every", part, 1.0 * rows * self.layout.width)
        if keep is None:
            for name, _, _, width in self.layout.channels:
                self._kept[name] = np.empty(rows if width is None else (rows, width))
            rows = min(rows, _ROWS)
        return Recorder(
            sensors=np.concatenate([*plant.sensors.values(), np.empty(0, dtype=np.int64)]),
            gimbals=plant.gimbal_sites,
            steps=steps,
            every=self.every,
            columns=self.layout.columns,
            out=np.empty((rows, self.layout.width)),
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
        earlier = self.memory.progress[0]
        present = protection.latched_fault(self.controller.guard)
        return present or protection.fault_of(earlier.code, earlier.leg, earlier.frame)

    def run(self, frames: int | None = None) -> None:
        """Run a number of control frames, by default all that are left.

        Raises `OutOfBounds` where the state leaves its bounds or MuJoCo warns; what and when are
        named. A plant that is another run's by now, or another thread's, is refused.
        """
        if self.frame == 0:
            state = self.controller.state.arrays()
            self._begun = {n: FrozenList(values.tolist()) for n, values in state.items()}
        end = self.frames if frames is None else min(self.frame + frames, self.frames)
        block = self._recorder.out.shape[0] * self.every
        while self.frame < end:
            stop = min(end, (self.frame // block + 1) * block)
            with self.plant.alone, without_clock():
                if self.plant.started != self._started:
                    raise InputError("plant: has been reset since; allowed: one run at a time")
                frame, cause, leg = loop.run(*self.parts, self.frame, stop)
            self.frame = stop if frame < 0 else frame
            self._take()
            if frame >= 0:
                raise OutOfBounds(self._left(frame, cause, leg), frame)

    def _take(self) -> None:
        """Let each channel take its own out of the rows that are new."""
        first, last = self._taken, -(-self.frame // self.every)
        rows = self._recorder.out[first % self._recorder.out.shape[0] :][: last - first]
        for channel in self.layout.channels if self._kept and last > first else ():
            values = self._kept[channel.name]
            values[first:last] = channel.of(rows)
            values.setflags(write=last < values.shape[0])
        self._taken = last

    def _left(self, frame: int, cause: int, leg: int) -> str:
        """What to say of a state beyond its bounds; first what MuJoCo says of it."""
        cap, rod = self.dynamics.state.pressure[leg]
        extension = self.memory.extension[leg]
        pressures = f"cap {cap:.4g} Pa, rod {rod:.4g} Pa gauge"
        hydraulics = self.dynamics.hydraulics
        half, proof = hydraulics.cylinder.half_stroke[leg], hydraulics.proof_pressure
        what = {
            loop.FINITE: f"is not finite: {pressures}, extension {extension:.4g} m",
            loop.VACUUM: f"has a chamber below vacuum ({pressures}); cavitation_gas sets a floor",
            loop.PROOF: f"has a chamber beyond the proof pressure of {proof:.4g} Pa ({pressures})",
            loop.STROKE: f"is at {extension:.4f} m, beyond its stops at +-{half:.4f} m",
            loop.SOLUTION: "and its supply have no solution for this step",
        }.get(cause, "")
        with_law = f" with law {self._engaged.name}" if self._engaged else ""
        said = fit.warnings_of(self.plant.data) or f"{self.plant.actuators[leg]} {what}"
        return f"{self.plant.name}{with_law}: {said} at {frame / self.rate:.4f} s"

    def describe(self) -> dict[str, Any]:
        """What a record keeps of the run."""
        fault, law = self.fault, self._law
        detected = None
        if fault is not None:
            detected = {"name": fault.name, "leg": fault.leg, "time": fault.frame / self.rate}
        electronics, state = self._settings.electronics, self.source.dcu_state
        hosted: dict[str, Any] = {}
        if self._settings.dcu is not None:
            hosted["dcu"] = self._settings.dcu.model_dump(mode="json")
            hosted |= {"host_counts": state.counts, "host_rejections": state.rejections}
        return {
            **self.plant.describe(),
            "law": law.name if law else "",
            "law_parameters": law.model_dump(mode="json") if law else {},
            "law_state": self._begun if law else {},
            "events": [event.model_dump(exclude_none=True) for event in self._events],
            "fault": detected,
            "electronics": electronics.describe(self.plant.machine) if electronics else None,
            "sample_rate": self.rate / self.every,
            "command_delay": self.controller.delay,
            "versions": dict(_VERSIONS),
            **self._context,
            **hosted,
        }

    def look(self) -> Live:
        """The present state."""
        memory, state, source = self.memory, self.dynamics.state, self.source
        poses, operating, late = source.poses, "", False
        demand = poses[max(self.frame - 1, 0) % len(poses)] if poses.size else np.full(6, np.nan)
        if source.hosted:
            late = bool(host_is_late(source.blocks.dcu, source.dcu_state))
            demand, operating = source.motion[0], State(source.progress[0].state).name.lower()
        return Live(
            time=self.frame / self.rate,
            qpos=self.plant.data.qpos.copy(),
            demand=demand.copy(),
            reference=memory.reference.copy(),
            extension=self.plant.extensions(),
            valve_command=memory.command[0].copy(),
            cap_pressure=state.pressure[:, CAP].copy(),
            rod_pressure=state.pressure[:, ROD].copy(),
            force=memory.load.copy(),
            supply_pressure=float(state.supply[SUPPLY_PRESSURE]),
            return_pressure=float(state.supply[RETURN_PRESSURE]),
            law=self._engaged.name if self._engaged else "",
            state=operating,
            fault=self.fault,
            late=late,
        )

    def engage(self, law: Law) -> None:
        """Hand over to another law, from the next frame on, as `control.engage` says.

        Refused in an open loop, which has none to hand over from.
        """
        if self._law is None:
            raise InputError(f"law: {law.name} is refused; allowed: in a loop closed by a law")
        self._engaged = bound(law, self.plant)
        controller, memory = self.controller, self.memory
        dcl = make_dcl(self._engaged, self.plant.legs)
        limited = controller.dcl.workspace.limited_demand
        reference = limited.copy() if self.frame else memory.feedback.position
        parts = controller.electronics
        state = handed_over_state(
            controller.dcl,
            controller.state,
            dcl,
            reference,
            memory.feedback,
            parts.gravity if parts.active else None,
        )
        self.controller = controller._replace(dcl=dcl, state=state)

    def exchange(self, **parts: Any) -> None:
        """Continue with other parts of the source, by their field in `Source`."""
        self.controller = self.controller._replace(source=self.source._replace(**parts))

    def request(self, code: Request) -> None:
        """Let the operator request something from the next frame on; refused without a host."""
        source = self.source
        if not source.hosted:
            raise InputError(f"request: {code.name} is refused; allowed: in a run with a host")
        self.exchange(
            request_frame=np.append(source.request_frame, self.frame),
            request=np.append(source.request, int(code)),
        )

    def body(self, name: str = "") -> int:
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

    def rows(self, first: int, last: int) -> NDArray[np.float64]:
        """Copy of the record's rows from `first` to before `last`, which the window still holds."""
        out = self._recorder.out
        return out[np.arange(first, last) % out.shape[0]]

    def history(self) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]], dict[str, str]]:
        """Times, channels and units of all rows so far that are kept.

        Those of a run that has ended are read-only, and a record takes them without a copy.
        """
        first = 0
        if not self._kept:
            last = -(-self.frame // self.every)
            first = max(last - self._recorder.out.shape[0], 0)
            rows = self.rows(first, last)
            channels = {channel.name: channel.of(rows) for channel in self.layout.channels}
        elif self.frame < self.frames:
            channels = {name: values[: self._taken] for name, values in self._kept.items()}
        else:
            channels = dict(self._kept)
        units = {channel.name: channel.unit for channel in self.layout.channels}
        for name, (values, unit) in self.plant.derived_channels(channels).items():
            channels[name], units[name] = values, unit
        count = channels["leg_position"].shape[0]
        time = np.arange(first, first + count, dtype=np.float64) * self.every / self.rate
        return time, channels, units

    def record(self) -> Record:
        """All signals so far that are kept, and what determined them."""
        return Record(*self.history(), self.describe())
