"""A session: one plant, one controller and the compiled loop, run in one go or in parts."""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control import dcl as control
from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import (
    Fault,
    ProtectionSettings,
    latched,
    load_protection,
    make_protection,
    protection_state,
)
from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.rates import FRAME
from cmf_mj.electronics.chain import ElectronicsSettings, make_electronics, measure
from cmf_mj.facility.front import Chain
from cmf_mj.facility.loop import (
    FINITE,
    LEG_CHANNELS,
    PROOF,
    SOLUTION,
    STROKE,
    VACUUM,
    Controller,
    Layout,
    Machine,
    make_memory,
    run,
)
from cmf_mj.facility.pace import Pace, idle_pace
from cmf_mj.plant.events import Event, make_timeline
from cmf_mj.plant.faults import no_faults
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.plant import Plant

_VERSIONS = {name: version(name) for name in ("cmf-mj", "mujoco", "numpy", "numba")}

SUPPLY_CHANNELS = {
    "supply_content": "m^3",
    "return_content": "m^3",
    "accumulator_oil": "m^3",
    "pump_flow": "m^3/s",
    "tank_content": "m^3",
    "isolation": "1",
    "supply_pressure": "Pa",
    "return_pressure": "Pa",
    "accumulator_pressure": "Pa",
}
"""State of the supply, in the order of `plant.supply`."""


_SENSOR_UNITS = {"gyro": "rad/s", "force": "N"}
"""Units of MuJoCo's sensors by the last word of their channel; m/s^2 for all others."""


class OutOfBounds(RunError):
    """The state of a run left its physical bounds."""

    def __init__(self, message: str, frame: int) -> None:
        """Keep what to say and the control frame it happened in."""
        super().__init__(message)
        self.frame = frame


class Session:
    """Plant, controller and record of one run."""

    def __init__(
        self,
        plant: Plant,
        law: Law | None,
        table: NDArray[np.float64],
        *,
        frames: int | None = None,
        window: int | None = None,
        start: ArrayLike | None = None,
        events: Sequence[Event] = (),
        protection: ProtectionSettings | None = None,
        electronics: ElectronicsSettings | None = None,
        chain: Chain | None = None,
        pace: Pace | None = None,
        record_every: int = 1,
        command_delay: int = 1,
    ) -> None:
        """Put the plant at rest and engage the law there.

        Args:
            plant: any plant; its mechanical step must divide the control frame.
            law: control law; None to take the table for valve commands.
            table: leg references [m] or valve commands as fractions, (N, n); with a chain only the
                reference to engage at, (1, n).
            frames: control frames of the run; default the rows of the table.
            window: control frames to keep in the record; later ones overwrite the first. Default
                all of them.
            start: configuration to start from, as `plant.place` takes it; default neutral.
            events: failures on the time line.
            protection: conditions that make an emergency stop.
            electronics: sensors, converters, servo electronics; default ideal.
            chain: host to reference; default the table.
            pace: real time; default as fast as possible.
            record_every: keep one frame in this many.
            command_delay: frames from a DCL frame to its command at the valves.

        Raises:
            InputError: an argument out of range, named.
        """
        for field, value, least in (
            ("record_every", record_every, 1),
            ("window", 1 if window is None else window, 1),
            ("command_delay", command_delay, 0),
        ):
            if value < least:
                raise InputError(f"{field}: {value} frames must be at least {least}")
        step = float(plant.model.opt.timestep)
        steps = round(FRAME / step)
        if steps < 1 or abs(steps * step - FRAME) > 1e-12:
            raise InputError(f"timestep: {step} s must divide the control frame of {FRAME} s")
        self.plant = plant
        law = None if law is None else law.mounted(plant.mounting)
        self._law = law
        self._engaged = law
        self._events = tuple(events)
        self.frames = table.shape[0] if frames is None else frames
        self.frame = 0
        """Control frames run so far."""
        self.every = record_every
        self.machine = Machine(
            plant.mechanics(),
            plant.hydraulics,
            plant.start(start),
            no_faults(plant.legs),
            make_timeline(events, plant.legs),
        )
        self.memory = make_memory(self.machine, command_delay)
        at_rest, feedback = self.memory.truth, self.memory.feedback
        parts = None if electronics is None else make_electronics(electronics, at_rest)
        self._electronics = electronics
        dcl = control.make_dcl(law or load_law("original"), plant.legs)
        compensated = dcl.feedback.gravity_compensation
        measure(parts, self.machine.faults, 0, at_rest, compensated, feedback)
        self.controller = Controller(
            closed=law is not None,
            dcl=dcl,
            state=control.engaged(dcl, feedback.position if law is None else table[0], feedback),
            table=np.ascontiguousarray(table),
            delay=command_delay,
            guarded=protection is not None,
            protection=make_protection(protection or load_protection()),
            guard=protection_state(feedback.position),
            electronics=parts,
            chain=chain,
            # One compilation for runs of the chain in real time and without.
            pace=pace if chain is None or pace is not None else idle_pace(),
        )
        self._begun: dict[str, list[float]] = {}
        self._groups = plant.sensors
        indices = np.concatenate([*self._groups.values(), np.empty(0, dtype=np.int64)])
        widths = (
            len(LEG_CHANNELS) * plant.legs,
            1,
            len(SUPPLY_CHANNELS),
            len(ENERGIES),
            plant.model.nq,
            indices.size,
        )
        kept = self.frames if window is None else window
        out = np.empty((-(-kept // record_every), sum(widths)))
        self.layout = Layout(indices, plant.gimbal_sensors, steps, record_every, out)

    @property
    def fault(self) -> Fault | None:
        """The fault detected, also one that was reset, if there is one."""
        found = latched(self.controller.guard)
        if found is None and self.memory.marks[2] != 0:
            guard = self.controller.guard
            found = latched(guard._replace(fault=self.memory.marks[2:]))
        return found

    def run(self, frames: int | None = None) -> None:
        """Run a number of control frames, by default all that are left.

        Raises:
            OutOfBounds: the state left its physical bounds; leg, time and value are named.
        """
        if self.frame == 0:
            state = self.controller.state._asdict()
            self._begun = {name: values.tolist() for name, values in state.items()}
        end = self.frames if frames is None else min(self.frame + frames, self.frames)
        frame, bound, leg = run(
            self.machine, self.controller, self.memory, self.layout, self.frame, end
        )
        self.frame = end if frame < 0 else frame
        if frame >= 0:
            raise OutOfBounds(self._left(frame, bound, leg), frame)

    def _left(self, frame: int, bound: int, leg: int) -> str:
        """What to say of a state beyond its physical bounds."""
        cap, rod = self.machine.state.pressure[leg]
        extension = self.memory.extension[leg]
        pressures = f"cap {cap:.4g} Pa, rod {rod:.4g} Pa gauge"
        hydraulics = self.machine.hydraulics
        half, proof = hydraulics.cylinder.half_stroke[leg], hydraulics.proof_pressure
        said = {
            FINITE: f"is not finite: {pressures}, extension {extension:.4g} m",
            VACUUM: f"has a chamber below vacuum ({pressures}); cavitation_gas sets a floor",
            PROOF: f"has a chamber beyond the proof pressure of {proof:.4g} Pa ({pressures})",
            STROKE: f"is at {extension:.4f} m, beyond its stops at +-{half:.4f} m",
            SOLUTION: "and its supply have no solution for this step",
        }[bound]
        with_law = f" with law {self._engaged.name}" if self._engaged else ""
        name = self.plant.actuators[leg]
        return f"{self.plant.name}{with_law}: {name} {said} at {frame * FRAME:.4f} s"

    def describe(self) -> dict[str, Any]:
        """What a record keeps of the run."""
        fault, law = self.fault, self._law
        found = None
        if fault is not None:
            found = {"name": fault.name, "leg": fault.leg, "time": fault.frame * FRAME}
        return {
            **self.plant.describe(),
            "law": law.name if law else "",
            "law_parameters": law.model_dump(mode="json") if law else {},
            "law_state": self._begun if law else {},
            "events": [event.model_dump(exclude_none=True) for event in self._events],
            "fault": found,
            "electronics": self._electronics.describe() if self._electronics else None,
            "sample_rate": 1.0 / (FRAME * self.every),
            "command_delay": self.controller.delay,
            "versions": dict(_VERSIONS),
        }

    def engage(self, law: Law, dcl: control.Dcl, state: control.DclState) -> None:
        """Go on with another law from the next frame.

        Args:
            law: which.
            dcl: compiled.
            state: its state there.
        """
        self._engaged = law
        self.controller = self.controller._replace(dcl=dcl, state=state)

    def inject(self, event: Event) -> None:
        """Put one more event on the time line.

        Raises:
            InputError: it names a leg that is not there, or its time is past.
        """
        if round(event.at / FRAME) < self.frame:
            raise InputError(
                f"at: {event.at} s of {event.kind} is past; allowed: from {self.frame * FRAME} s"
            )
        events = (*self._events, event)
        self.machine = self.machine._replace(timeline=make_timeline(events, self.plant.legs))
        self._events = events

    def rows(self, first: int, last: int) -> NDArray[np.float64]:
        """Copy of the record's rows from `first` to before `last`, which must still be kept."""
        return self.layout.out[np.arange(first, last) % self.layout.out.shape[0]]

    def history(
        self, out: NDArray[np.float64] | None = None, first: int = 0
    ) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]], dict[str, str]]:
        """Times, channels and units.

        Args:
            out: rows, as of `rows`; default those of all frames run so far.
            first: number of their first one.
        """
        legs = self.plant.legs
        if out is None:
            out = self.layout.out[: -(-self.frame // self.every)]
        channels: dict[str, NDArray[np.float64]] = {}
        units: dict[str, str] = {}
        base = 0

        def take(name: str, unit: str, width: int | None = None) -> None:
            nonlocal base
            size = 1 if width is None else width
            values = out[:, base : base + size]
            channels[name] = values[:, 0] if width is None else values
            units[name] = unit
            base += size

        for name, unit in LEG_CHANNELS.items():
            take(name, unit, legs)
        take("gimbal_error", "m")
        for name, unit in SUPPLY_CHANNELS.items():
            take(name, unit)
        take("energy", "J", len(ENERGIES))
        take("generalised_position", "m, rad, 1", self.plant.model.nq)
        for name, indices in self._groups.items():
            take(name, _SENSOR_UNITS.get(name.split("_")[-1], "m/s^2"), indices.size)
        for name, (values, unit) in self.plant.derived_channels(channels).items():
            channels[name], units[name] = values, unit
        time = np.arange(first, first + out.shape[0], dtype=np.float64) * (self.every * FRAME)
        return time, channels, units
