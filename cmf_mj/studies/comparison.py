"""Comparisons: laws on both plants, degree of freedom by degree of freedom.

A case is one law on one plant in one degree of freedom. It is run twice: with the report's chirp,
for the frequency response, and with a step, for damping, steady-state error and stability. Cases
share nothing, so they run on threads (the compiled loop releases the interpreter lock) and their
results do not depend on how many there are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import (
    Bandwidths,
    FrequencyResponse,
    bandwidths,
    frequency_response,
)
from cmf_mj.analysis.published import published
from cmf_mj.analysis.step_response import StepMetrics, step_metrics
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_csv
from cmf_mj.core.threads import on_threads
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.simulation import simulate
from cmf_mj.machine import models
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.build import PLANTS, make_plant
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record

DEFAULT_LAWS = ("velocity", "position_error_rate", "acceleration")
"""The law flown, and the report's two advances on it."""

AMPLITUDE = 0.33 * units.INCH
"""Translational amplitude of the report's frequency responses [m]."""

ROTATION_PER_TRANSLATION = 0.2 * units.DEGREE / AMPLITUDE
"""The report takes 0.2 deg in rotation to 0.33 in in translation (Appendix D) [rad/m]."""

STEP_PER_AMPLITUDE = 1.0 * units.INCH / AMPLITUDE
"""The report steps 1 in and sweeps 0.33 in."""

FULL_SWEEP, QUICK_SWEEP = 100.0, 30.0
"""Durations of the chirp [s]."""


def dof_amplitude(dof: str, amplitude: float = AMPLITUDE) -> float:
    """Amplitude of a sweep in a degree of freedom [m or rad], given that in translation [m]."""
    return amplitude * by_kind(dof, 1.0, ROTATION_PER_TRANSLATION)


@dataclass(frozen=True)
class Case:
    """One law on one plant in one degree of freedom; everything needed to run it anywhere."""

    plant: str
    cab: str
    hydraulics: HydraulicParameters
    law: Law
    dof: str
    amplitude: float  #: Of the chirp [m or rad].
    quick: bool = False
    electronics: ElectronicsSettings | None = None
    """Sensors, converters, servo electronics; None for ideal ones."""

    @property
    def label(self) -> str:
        """Name for files."""
        parts = (self.plant, self.cab, self.hydraulics.name, self.law.name, self.dof)
        return "-".join(part for part in parts if part)

    def build(self) -> Plant:
        """A plant of its own for this case."""
        return make_plant(self.plant, self.cab, self.hydraulics)


class CaseResult(NamedTuple):
    """What a case gave."""

    case: Case
    response: FrequencyResponse | None  #: None where the legs left what a platform pose can have.
    bandwidths: Bandwidths
    metrics: StepMetrics
    step: Record  #: The step run at 256 Hz.
    gimbal_error: float  #: Largest gap of a closed gimbal over both runs [m].


class ComparisonRow(NamedTuple):
    """One line of `comparison.csv`; NaN where a measure does not exist."""

    plant: str
    cab: str
    hydraulics: str
    law: str
    dof: str
    phase_bandwidth_hz: float
    gain_bandwidth_hz: float
    peak_gain_db: float
    damping_ratio: float
    overshoot: float
    steady_state_error: float
    stable: bool
    published_phase_bandwidth_hz: float
    published_gain_bandwidth_hz: float
    published_damping_ratio: float


@dataclass(frozen=True)
class Comparison:
    """All cases of a comparison, in the order asked for."""

    results: tuple[CaseResult, ...]

    @property
    def rows(self) -> list[ComparisonRow]:
        """One row a case, published values beside ours."""
        return [_row(result) for result in self.results]

    def save_csv(self, path: str | Path) -> Path:
        """Write the rows as CSV; missing measures are empty."""
        known = (["" if value != value else value for value in row] for row in self.rows)
        return write_csv(Path(path), ComparisonRow._fields, known, digits=6)


def _row(result: CaseResult) -> ComparisonRow:
    case = result.case
    beside = published(case.law.name, case.dof, case.hydraulics.name)

    def print_of(field: str) -> float:
        value = getattr(beside, field) if beside is not None else None
        return float("nan") if value is None else value

    return ComparisonRow(
        plant=case.plant,
        cab=case.cab,
        hydraulics=case.hydraulics.name,
        law=case.law.name,
        dof=case.dof,
        phase_bandwidth_hz=result.bandwidths.phase_hz,
        gain_bandwidth_hz=result.bandwidths.gain_hz,
        peak_gain_db=result.bandwidths.peak_db,
        damping_ratio=result.metrics.damping_ratio,
        overshoot=result.metrics.overshoot,
        steady_state_error=result.metrics.steady_state_error,
        stable=result.metrics.stable,
        published_phase_bandwidth_hz=print_of("phase_bandwidth_hz"),
        published_gain_bandwidth_hz=print_of("gain_bandwidth_hz"),
        published_damping_ratio=print_of("damping_ratio"),
    )


def chirp_and_step(
    plant: Plant,
    law: Law,
    dof: str,
    amplitude: float,
    *,
    quick: bool,
    electronics: ElectronicsSettings | None = None,
    command_delay: int = 1,
    about: ArrayLike = (0.0,) * 6,
) -> tuple[Record, Record]:
    """Run the report's chirp and its step in one degree of freedom about a pose.

    Args:
        plant: to run.
        law: to run.
        dof: degree of freedom.
        amplitude: of the chirp [m or rad]; the step keeps the report's proportion to it.
        quick: sweep in 30 s instead of 100 s.
        electronics: sensors, converters and servo electronics; default ideal.
        command_delay: frames from a DCL frame to its command at the valves.
        about: pose the motion is added to [m, rad].
    """
    duration = QUICK_SWEEP if quick else FULL_SWEEP
    chirp = signals.chirp(dof, amplitude, duration=duration)
    step = signals.step(dof, amplitude * STEP_PER_AMPLITUDE)
    first, second = (
        simulate(
            plant,
            law,
            signals.Command(command.pose + np.asarray(about), command.description, command.seed),
            electronics=electronics,
            record_every=every,
            command_delay=command_delay,
        )
        for command, every in ((chirp, 16), (step, 8))
    )
    return first, second


def sweep_measures(sweep: Record, *, quick: bool) -> tuple[FrequencyResponse | None, Bandwidths]:
    """Response and bandwidths of a chirp; None and NaN where no platform joins the legs any more.

    Single legs can swing that far apart; the verdict on the step then says unstable.
    """
    try:
        response = frequency_response(sweep, segment=10.0 if quick else 20.0)
    except ValueError:
        return None, Bandwidths(float("nan"), float("nan"), float("nan"))
    return response, bandwidths(response)


def run_case(case: Case, records: Path | None = None) -> CaseResult:
    """Run chirp and step of a case; keep both records in the folder `records` if one is given.

    `quick` sweeps in 30 s instead of 100 s: the same band at three times the rate, bandwidths
    within about 2 %.
    """
    sweep, step = chirp_and_step(
        case.build(),
        case.law,
        case.dof,
        case.amplitude,
        quick=case.quick,
        electronics=case.electronics,
    )
    if records is not None:
        sweep.save(records / f"{case.label}-chirp.parquet")
        step.save(records / f"{case.label}-step.parquet")
    response, widths = sweep_measures(sweep, quick=case.quick)
    gap = max(float(sweep["gimbal_error"].max()), float(step["gimbal_error"].max()))
    return CaseResult(case, response, widths, step_metrics(step), step, gap)


def compare(
    laws: Sequence[str | Path | Law] = DEFAULT_LAWS,
    dofs: Sequence[str] = DOFS,
    *,
    plants: Sequence[str] = PLANTS,
    cab: str = "gfd",
    hydraulics: str | Path | HydraulicParameters = "hardware",
    amplitude: float = AMPLITUDE,
    jobs: int | None = None,
    quick: bool = False,
    records: str | Path | None = None,
    electronics: ElectronicsSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Compare control laws in several degrees of freedom on both plants.

    Args:
        laws: names, TOML files or loaded laws.
        dofs: degrees of freedom.
        plants: `hexapod`, `single_legs` or both; both get the same hydraulics.
        cab: `gfd`, `rfd` or `ifd`, for the hexapod.
        hydraulics: `report`, `hardware`, `lossy`, a TOML file or a loaded set.
        amplitude: of the chirp in translation [m]; rotations and steps keep the report's
            proportions to it, 0.2 deg and 1 in to 0.33 in.
        jobs: threads; default one per core. Results do not depend on it.
        quick: shorter sweeps.
        records: folder for the records of all runs.
        electronics: sensors, converters and servo electronics; default ideal.
        progress: called with (cases done, cases in all) after each case.

    Raises:
        InputError: an argument out of range, named; nothing has been run or written then.
    """
    loaded = [load_law(law) for law in laws]
    for field, chosen, known in (("dofs", dofs, DOFS), ("plants", plants, PLANTS)):
        for name in chosen:
            if name not in known:
                raise InputError(f"{field}: {name!r} is not one of {', '.join(known)}")
        if not chosen:
            raise InputError(f"{field}: is empty; choose from {', '.join(known)}")
    if not loaded:
        raise InputError("laws: is empty; name at least one law")
    models.cab_path(cab)
    parameters = load_hydraulics(hydraulics)
    if not (np.isfinite(amplitude) and 0.0 < amplitude <= 0.5):
        raise InputError(f"amplitude: {amplitude} m must be greater than 0 and at most 0.5")
    cases = [
        Case(
            plant,
            cab if plant == "hexapod" else "",
            parameters,
            law,
            dof,
            dof_amplitude(dof, amplitude),
            quick,
            electronics,
        )
        for plant in plants
        for law in loaded
        for dof in dofs
    ]
    folder = Path(records) if records is not None else None
    results = on_threads(lambda case: run_case(case, folder), cases, jobs, progress)
    return Comparison(tuple(results))
