"""What a calibration study is, and its results at trial values: linear, and of the simulation.

Linear: the plant is linearised about rest (`linearization`), the law closes the loop, and -90 deg,
-3 dB and the step's overshoot are read from the exact response: a tenth of a second a law.
Simulated: the report's chirp and step as `studies.compare` runs them, some seconds a law.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import control
import numpy as np
from pydantic import Field, model_validator

from cmf_mj.analysis.frequency_response import Bandwidths, bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.measures import Measures, joined, least_damped_mode, measure_loop, step_metrics
from cmf_mj.analysis.published import Published, published_results
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Name, Settings, read_toml, validated
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.machine import load_machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs, design_point
from cmf_mj.studies.case import make_case, run_case

_FILE = Path(__file__).with_name("studies.toml")

Measure = Literal["phase", "gain", "damping"]
"""Frequency of -90 deg, of -3 dB from absolute 0 dB, damping ratio from a step's overshoot."""

MEASURES: dict[Measure, str] = {
    "phase": "phase_bandwidth_hz",
    "gain": "gain_bandwidth_hz",
    "damping": "damping_ratio",
}
"""Fields of `Measures` and `Published` by measure."""

_Measures = Annotated[tuple[Measure, ...], Field(strict=False)]


def computed(measures: Measures, measure: Measure) -> float:
    """One of the `MEASURES`."""
    return float(getattr(measures, MEASURES[measure]))


class FreeParameter(Unknown):
    """A number of the plant or the law, and the range its source allows."""

    name: str
    free: bool = False  #: Fitted; otherwise it only enters the uncertainty.


class Row(Settings):
    """A published result and what is done with its quantities."""

    table: str
    law: str
    of: str
    fitted: _Measures = ()
    predicted: _Measures = ()  #: Held back: computed and compared, but nothing is fitted to it.

    @property
    def published(self) -> Published:
        """The printed numbers."""
        for row in published_results():
            if (row.table, row.law, row.of, row.dof) == (self.table, self.law, self.of, "heave"):
                return row
        raise InputError(f"rows: Table {self.table} has no {self.law} of {self.of} in heave")

    def printed(self, measure: Measure) -> float:
        """A printed number, NaN where there is none."""
        value = getattr(self.published, MEASURES[measure])
        return float("nan") if value is None else float(value)


class CalibrationStudy(Settings):
    """One calibration."""

    name: Name
    title: str
    hydraulics: str  #: Hydraulic set: starting values, and all that is not a parameter.
    plant: Literal["hexapod", "single_legs"]
    cab: str = ""  #: Of the hexapod.
    tolerance: dict[Measure, Annotated[float, Field(gt=0.0)]]
    """Scales of the residuals, and what counts as met: relative, of damping ratios absolute."""
    stable_cabs: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Cabs with which the velocity law must be stable in six degrees of freedom."""
    least_damping: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Least damping ratio of the velocity law's loop with each of these cabs."""
    parameters: Annotated[tuple[FreeParameter, ...], Field(strict=False)]
    rows: Annotated[tuple[Row, ...], Field(strict=False)]

    @model_validator(mode="after")
    def _sound(self) -> "CalibrationStudy":
        for row in self.rows:
            for measure in (*row.fitted, *row.predicted):
                if row.printed(measure) != row.printed(measure):
                    raise InputError(f"rows: Table {row.table} prints no {measure} of {row.law}")
            if set(row.fitted) & set(row.predicted):
                raise InputError(
                    f"rows: Table {row.table}, {row.law}: a quantity is fitted and predicted"
                )
        free = len(self.free)
        fitted = sum(len(row.fitted) for row in self.rows)
        if not 0 < free <= fitted:
            raise InputError(f"parameters: {free} are free; allowed: 1 to the {fitted} fitted")
        return self

    @property
    def unknowns(self) -> Unknowns:
        """The parameters by name."""
        return Unknowns((parameter.name, parameter) for parameter in self.parameters)

    @property
    def free(self) -> tuple[FreeParameter, ...]:
        """The parameters that are fitted."""
        return tuple(parameter for parameter in self.parameters if parameter.free)

    @property
    def laws(self) -> tuple[str, ...]:
        """Laws of all rows, once each."""
        return tuple(dict.fromkeys(row.law for row in self.rows))


@lru_cache
def load_studies() -> dict[str, CalibrationStudy]:
    """The shipped studies by name."""
    return {
        name: validated(CalibrationStudy, table | {"name": name}, f"{_FILE.name}: {name}")
        for name, table in read_toml(_FILE).items()
    }


def load_calibration(name: str) -> CalibrationStudy:
    """A shipped study by name."""
    studies = load_studies()
    return studies[check_name("study", name, studies)]


Values = Mapping[str, float]
"""Parameter values by name, in the units of the study."""

_LINES = np.geomspace(0.4, 15.0, 400)
"""Lines the bandwidths are read between [Hz], 1 % apart."""
_STEP = 1.5
"""Length of the linear steps [s]: the overshoot comes within the first half second."""
_FASTEST_HZ = 30.0
"""Modes above it are of valves and sensors, not of the machine [Hz]."""


def starting_values(study: CalibrationStudy) -> dict[str, float]:
    """Values of all parameters as the set and the laws ship, in the units of the study."""
    oil, law = load_hydraulics(study.hydraulics), load_law("position_error_rate")
    shipped = {"derivative_pole": law.derivative_pole, "payload": 1.0}
    for one in study.parameters:
        if one.path.startswith("hydraulics."):
            shipped[one.name] = float(units.from_si(one.unit, getattr(oil, one.name).si))
    return {one.name: shipped[one.name] for one in study.parameters}


def hydraulics_of(study: CalibrationStudy, values: Values) -> HydraulicParameters:
    """The study's hydraulic set with the values of a trial, checked."""
    return study.unknowns.apply(values, load_hydraulics(study.hydraulics))


def law_of(study: CalibrationStudy, name: str, values: Values) -> Law:
    """A law with the derivative pole of a trial."""
    return study.unknowns.apply(values, load_law(name))


def plant_of(study: CalibrationStudy, values: Values, cab: str = "") -> Plant:
    """The study's plant with the values of a trial.

    Parameters left out are as shipped; `cab` stands in for the study's.
    """
    hydraulics = hydraulics_of(study, values)
    if study.plant == "single_legs":
        point, factor = design_point(load_machine()), values.get("payload", 1.0)
        return SingleLegs(
            hydraulics,
            effective_mass=factor * point.effective_mass,
            static_load=factor * point.static_load,
        )
    return Hexapod(study.unknowns.apply(values, load_cab(cab or study.cab)), hydraulics)


def linear_results(
    study: CalibrationStudy, values: Values, laws: Sequence[str], *, damping: bool = True
) -> dict[str, Measures]:
    """Measures of laws around the linearised plant, in heave.

    Parameters left out are as shipped; without `damping` no loop is stepped and the ratios are NaN.
    Bandwidths are those of the response, also of an unstable loop: a fit must pass through it.
    """
    linear = Linear(plant_of(study, values))
    if study.plant == "single_legs":
        leg = linear.model("leg_1")
        loops = {name: closed_loop(law_of(study, name, values), leg) for name in laws}
    else:
        loops = {name: linear.loop(law_of(study, name, values), "heave") for name in laws}
    return {name: _measure(loop, damping) for name, loop in loops.items()}


def _measure(loop: control.StateSpace, step: bool) -> Measures:
    widths = bandwidths(loop_response(loop, _LINES))
    if step:
        return _unjudged(measure_loop(loop, frequencies=_LINES, duration=_STEP), widths)
    return joined(widths)


def _unjudged(measures: Measures, widths: Bandwidths) -> Measures:
    """Measures with bandwidths also where the step rings on.

    A fit follows the response at 2 to 6 Hz while the leg mode rings at 11 Hz.
    """
    return measures._replace(phase_bandwidth_hz=widths.phase_hz, gain_bandwidth_hz=widths.gain_hz)


def least_damping(study: CalibrationStudy, values: Values) -> dict[str, float]:
    """Smallest damping ratio of the velocity law's loop, all degrees of freedom, for each cab."""
    law = law_of(study, "velocity", values)
    loops = {cab: Linear(plant_of(study, values, cab)).leg_loop(law) for cab in study.stable_cabs}
    return {cab: least_damped_mode(loop.poles(), _FASTEST_HZ)[0] for cab, loop in loops.items()}


def simulated_results(
    study: CalibrationStudy,
    values: Values,
    laws: Sequence[str],
    *,
    quick: bool = False,
    jobs: int | None = None,
) -> dict[str, Measures]:
    """Measures of laws in the simulation, in heave.

    The `payload` must be as shipped; `quick` sweeps in 30 s instead of 100 s. Bandwidths are those
    of the response, also where the step rings on.
    """
    if values.get("payload", 1.0) != 1.0:
        raise InputError(f"payload: {values['payload']} must be 1 in a simulation")
    machine: Any = ("heave", study.plant, study.cab or "gfd", hydraulics_of(study, values))
    cases = [make_case(law_of(study, name, values), *machine, quick=quick) for name in laws]
    return {
        result.case.law.name: _unjudged(result.measures, bandwidths(result.response))
        if result.response is not None
        else result.measures
        for result in on_threads(run_case, cases, jobs)
    }


class StepVerdict(NamedTuple):
    """The end of one step run of the velocity law."""

    cab: str
    dof: str
    stable: bool
    residual: float  #: Largest leg swing of the last second over the largest leg step.


def simulated_stability(
    study: CalibrationStudy, values: Values, *, dofs: Sequence[str] = DOFS, jobs: int | None = None
) -> list[StepVerdict]:
    """Steps of 1 in or 0.6 deg of the velocity law with every cab of the study."""
    hydraulics, law = hydraulics_of(study, values), law_of(study, "velocity", values)

    def run(cab_and_dof: tuple[str, str]) -> StepVerdict:
        cab, dof = cab_and_dof
        case = make_case(law, dof, cab=cab, hydraulics=hydraulics)
        metrics = step_metrics(case.run(case.step(), rate=256))
        return StepVerdict(cab, dof, metrics.stable, metrics.residual)

    return on_threads(run, list(product(study.stable_cabs, dofs)), jobs)
