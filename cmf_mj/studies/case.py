"""A case: one law on one machine in one degree of freedom, and the runs that measure it.

The report sweeps 0.33 in or 0.2 deg (Appendix D) from 0 to 10 Hz and steps 1 in; `run_case` does
both on a machine built for the case, so that cases share nothing and may run anywhere.

Beside a case's measures stand -90 deg of small motion (`small_motion_loop`), and the verdict of a
short simulation in which all degrees of freedom step at once (`swing_after_step`).
"""

from dataclasses import KW_ONLY, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.poles import holds_position
from cmf_mj.analysis.measures import Measures, measure_loop, measures_from, sweep_response
from cmf_mj.analysis.published import Published, published
from cmf_mj.analysis.step_response import ends_off_demand, step_metrics
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import NotLinearError, check_name
from cmf_mj.core.files import plain_path
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.run import Run
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.geometry import DOFS, by_kind, dof_index
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.models import CMF
from cmf_mj.plant.hexapod import PLANTS, Hexapod, make_plant
from cmf_mj.plant.parameters import HydraulicParameters, hydraulics_of
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, check_positive

AMPLITUDE = 0.33 * units.INCH  #: Translational amplitude of the report's frequency responses [m].
ROTATION_PER_TRANSLATION = 0.2 * units.DEGREE / AMPLITUDE
"""The report takes 0.2 deg in rotation to 0.33 in in translation (Appendix D) [rad/m]."""
STEP_PER_AMPLITUDE = 1.0 * units.INCH / AMPLITUDE  #: The report steps 1 in and sweeps 0.33 in.

FULL_SWEEP, QUICK_SWEEP = 100.0, 30.0  #: Durations of the chirp [s].
RECORDER = 128  #: Rows of a record in a second, at least, as of the facility's recorder [Hz].

_SMALL_MOTION_HZ = np.linspace(0.1, 19.9, 1999)  #: Lines of small motion; sweeps end at 10 Hz.


def dof_amplitude(dof: str, amplitude: float = AMPLITUDE) -> float:
    """Amplitude in a degree of freedom [m or rad] that goes with one in translation [m]."""
    return amplitude * by_kind(dof, 1.0, ROTATION_PER_TRANSLATION)


REPORT_AMPLITUDES: NDArray[np.float64] = np.array([dof_amplitude(dof) for dof in DOFS])
"""The report's amplitudes by degree of freedom [m, rad], (6,): what counts alike."""


def frames_a_row(machine: Machine, rate: int) -> int:
    """Control frames from row to row of `rate` rows a second [Hz].

    Or of as few more as make rows and frames a second whole numbers.
    """
    candidates = range(1, machine.rate // rate + 1)
    return max((frames for frames in candidates if machine.rate % frames == 0), default=1)


@dataclass(frozen=True)
class Case:
    """One law on one machine; everything needed to run it anywhere. See `make_case`."""

    plant: str
    cab: Cab | None  #: Of the hexapod; None for single legs.
    hydraulics: HydraulicParameters
    law: Law
    dof: str
    amplitude: float | None = None  #: Of the chirp [m or rad]; None for the report's.
    _: KW_ONLY
    quick: bool = False  #: Sweep in 30 s instead of 100 s.
    electronics: ElectronicsSettings | None = None
    """Sensors, converters, servo electronics; None for ideal ones."""
    pose: tuple[float, ...] = (0.0,) * 6  #: About which it moves [m, rad], z down.
    machine: Machine = field(default_factory=load_machine)  #: Of the legs where there is no cab.
    command_delay: int = 1  #: Frames from the control law to the valves.

    @property
    def size(self) -> float:
        """Amplitude of the chirp [m or rad]."""
        return dof_amplitude(self.dof) if self.amplitude is None else self.amplitude

    @property
    def segment(self) -> float:
        """Length of the segments that the response to the sweep is estimated from [s]."""
        return 10.0 if self.quick else 20.0

    @property
    def motion_base(self) -> Machine:
        """The machine of the cab, or of single legs."""
        return self.cab.machine if self.cab else self.machine

    @property
    def cab_name(self) -> str:
        """Name of the cab; empty for single legs."""
        return self.cab.name if self.cab else ""

    @property
    def label(self) -> str:
        """Name for files."""
        parts = (self.plant, self.cab_name, self.hydraulics.name, self.law.name, self.dof)
        return "-".join(filter(None, parts))

    def build(self) -> Plant:
        """A new plant."""
        return make_plant(self.plant, self.cab, self.hydraulics, self.motion_base)

    def run(self, command: Command, plant: Plant | None = None, *, rate: int = RECORDER) -> Record:
        """Simulate a command.

        `command` is added to the pose of the case; `rate` is that of the record's rows, see
        `frames_a_row`.
        """
        plant = self.build() if plant is None else plant
        pose = command.pose + np.asarray(self.pose)
        pose.setflags(write=False)  # the command then takes it without a copy
        return Run(
            plant=plant,
            law=self.law,
            source=Command(pose, command.signal, command.seed),
            electronics=self.electronics,
            command_delay=self.command_delay,
            record_every=frames_a_row(plant.machine, rate),
        ).record()

    def sweep_and_step(self, plant: Plant | None = None) -> tuple[Record, Record]:
        """Run the report's chirp and its step, at 128 and 256 Hz."""
        plant = self.build() if plant is None else plant
        duration = QUICK_SWEEP if self.quick else FULL_SWEEP
        sweep = self.run(signals.chirp(self.dof, self.size, duration=duration), plant)
        return sweep, self.run(self.step(), plant, rate=2 * RECORDER)

    def step(self) -> Command:
        """The report's step, in proportion to the chirp."""
        return signals.step(self.dof, self.size * STEP_PER_AMPLITUDE)


def make_case(
    law: str | Path | Law,
    dof: str = "heave",
    plant: str = "hexapod",
    cab: str | Path | Cab | None = None,
    hydraulics: str | Path | HydraulicParameters | None = None,
    *,
    machine: str | Path | Machine | None = None,
    amplitude: float | None = None,
    **options: Any,
) -> Case:
    """A case from names; what is refused is named before anything runs.

    Laws, cabs, hydraulic sets and the machine are names, TOML files or loaded ones, the machine by
    default that of a loaded cab, or the CMF; `amplitude` of the chirp is in m or rad, by default
    the report's 0.33 in or 0.2 deg; `options` are further fields of `Case`.
    """
    dof_index(dof)
    check_name("plant", plant, PLANTS)
    for name in options:
        check_name("option", name, [option.name for option in fields(Case) if option.kw_only])
    if amplitude is not None:
        check_positive(amplitude=amplitude)
    loaded_cab = load_cab(cab, machine)
    options["machine"] = motion_base = loaded_cab.machine
    parameters, loaded_law = hydraulics_of(motion_base, hydraulics), load_law(law, motion_base)
    own_cab = loaded_cab if plant == Hexapod.name else None
    return Case(plant, own_cab, parameters, loaded_law, dof, amplitude, **options)


class CaseResult(NamedTuple):
    """Chirp and step of a case."""

    case: Case
    response: FrequencyResponse | None  #: None where the legs left what a platform pose can have.
    measures: Measures
    step: Record  #: The step run at 256 Hz.
    gimbal_error: float  #: Largest gap of a closed gimbal over both runs [m].
    small_motion_phase_hz: float
    """First fall through -90 deg of the linearised machine [Hz]; see `small_motion_loop`."""
    drifts: bool = False  #: Whether the law holds no position, by the step or a pole of the loop.

    @property
    def verdict(self) -> str:
        """`unstable`, `drifts`, or nothing of a law that is stable."""
        if self.measures.stable:
            return ""
        return "drifts" if self.drifts else "unstable"

    @property
    def published(self) -> Published | None:
        """The published values of the case, if there are any: of the CMF alone."""
        case = self.case
        if case.motion_base.name != CMF:
            return None
        return published(case.law.name, case.dof, case.hydraulics.name)


def run_case(case: Case, records: Path | None = None) -> CaseResult:
    """Run chirp and step of a case, whose records go to the folder `records` if one is named.

    `quick` sweeps in 30 s instead of 100 s: the same band at three times the rate, bandwidths
    within about 2 %.
    """
    sweep, step = case.sweep_and_step()
    if records is not None:
        sweep.save(plain_path(records, f"{case.label}-chirp.parquet"))
        step.save(plain_path(records, f"{case.label}-step.parquet"))
    response = sweep_response(sweep, segment=case.segment)
    measures = measures_from(bandwidths(response) if response else None, step_metrics(step))
    gimbal_error = max(float(run["gimbal_error"].max()) for run in (sweep, step))
    drifts, small_motion = ends_off_demand(step), Measures()
    loop = small_motion_loop(case) if measures.stable else None
    if loop is not None:
        drifts = not holds_position(loop.poles())
        small_motion = measure_loop(loop, frequencies=_SMALL_MOTION_HZ)
    measures, phase_hz = Measures() if drifts else measures, small_motion.phase_bandwidth_hz
    return CaseResult(case, response, measures, step, gimbal_error, phase_hz, drifts=drifts)


def small_motion_loop(case: Case) -> control.StateSpace | None:
    """The loop of a case linearised about its pose, which a chirp tends to as it gets smaller.

    At the report's amplitude the valves' mean opening damps the legs and the load takes pressure
    from the valves, which moves -90 deg. None for what has no linearisation, such as dry friction,
    and with `electronics`.
    """
    if case.electronics is not None:
        return None
    try:
        linear = Linear(case.build(), case.pose)
    except NotLinearError:
        return None
    return linear.loop(case.law, case.dof, command_delay=case.command_delay)


SMALL_STEP = 0.15
"""Step of the simulated verdict over the report's amplitudes, all degrees of freedom at once."""

_STEP_TIME, _DURATION = 0.5, 12.0  #: Step and end of the run of the simulated verdict [s].
_WINDOW_LENGTH, _WINDOW_BEGIN = 2.0, 2.5
"""Of two windows, and of the first after the step [s]; the second ends the run."""
_NO_SWING, _LIMIT_CYCLE = 1e-4, 1.0
"""Swing over the largest leg step that counts as none, and what only a limit cycle exceeds."""


def swing_after_step(plant: Hexapod, law: Law) -> dict[str, Any]:
    """Run the step of the simulated verdict under a law; returned as by `measure_swing`."""
    rate = plant.machine.rate
    pose = np.zeros((round(_DURATION * rate), len(DOFS)))
    pose[round(_STEP_TIME * rate) :] = SMALL_STEP * REPORT_AMPLITUDES
    try:
        return measure_swing(simulate(plant, law, Command.from_pose(pose, rate), record_every=16))
    except FloatingPointError:  # it left the bounds of the model
        return {"stable": False, "first": float("nan"), "last": float("nan")}


def measure_swing(record: Record) -> dict[str, Any]:
    """Whether a run with a step at 0.5 s is stable, and the swing of its windows.

    `first` and `last` are the largest standard deviations of a leg about a straight line within the
    windows, over the largest leg step.
    """
    legs, reference = record["leg_position"], record["leg_reference"]
    leg_step = float(np.abs(reference[-1] - reference[0]).max())
    count = round(_WINDOW_LENGTH * record.rate)
    begin = round((_STEP_TIME + _WINDOW_BEGIN) * record.rate)
    time = np.linspace(-1.0, 1.0, count)

    def swing_in(window: NDArray[np.float64]) -> float:
        line = np.polynomial.polynomial.polyfit(time, window, 1)
        deviation = window - np.polynomial.polynomial.polyval(time, line).T
        return float(deviation.std(axis=0).max()) / leg_step

    first, last = swing_in(legs[begin : begin + count]), swing_in(legs[-count:])
    stable = bool(last < _NO_SWING or last < min(first, _LIMIT_CYCLE))
    return {"stable": stable, "first": first, "last": last}
