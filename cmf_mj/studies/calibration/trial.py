"""Results of a study at given parameter values: of the linear loop, and of the simulation.

Linear: the plant is linearised about rest (`linearization`), the law closes the loop, and -90 deg,
-3 dB and the step's overshoot are read from the exact response: a tenth of a second a law.
Simulated: the report's chirp and step as `studies.compare` runs them, some seconds a law.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import control
import mujoco
import numpy as np

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import bandwidths
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop, loop_response, loop_step
from cmf_mj.analysis.linear.reduction import leg_model
from cmf_mj.analysis.step_response import measure_step, step_metrics
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME
from cmf_mj.core.settings import validated
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.simulation import simulate
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import EFFECTIVE_MASS, STATIC_LOAD, SingleLegs
from cmf_mj.studies.calibration.definition import Measure, Study
from cmf_mj.studies.comparison import ROTATION_PER_TRANSLATION, compare
from cmf_mj.studies.linear_agreement import loop_between

Values = Mapping[str, float]
"""Parameter values by name, in the units of the study."""

_LINES = np.geomspace(0.4, 15.0, 400)
"""Lines the bandwidths are read between [Hz], 1 % apart."""
_STEP = 1.5
"""Length of the linear steps [s]: the overshoot comes within the first half second."""
_FASTEST = 30.0 * units.HERTZ
"""Modes above it are of valves and sensors, not of the machine [rad/s]."""
_SWEPT = units.to_si("in", 1.0)
"""Step of the stability runs [m]."""


class Measured(NamedTuple):
    """Measures of one law; NaN where the response has no such thing."""

    phase: float  #: -90 deg [Hz].
    gain: float  #: -3 dB from absolute 0 dB [Hz].
    damping: float  #: Damping ratio from the overshoot of a step.
    stable: bool

    def value(self, measure: Measure) -> float:
        """One of the three numbers."""
        return float(getattr(self, measure))


def starting_values(study: Study) -> dict[str, float]:
    """Values of all parameters as the set and the laws ship, in the units of the study."""
    quantities = load_hydraulics(study.hydraulics).quantities()
    found: dict[str, float] = {}
    for parameter in study.parameters:
        if parameter.name == "derivative_pole":
            found[parameter.name] = load_law("position_error_rate").derivative_pole
        elif parameter.name == "payload":
            found[parameter.name] = 1.0
        else:
            quantity = quantities[parameter.name]
            found[parameter.name] = units.from_si(parameter.unit, quantity.si)
    return found


def hydraulics_of(study: Study, values: Values) -> HydraulicParameters:
    """The study's hydraulic set with the values of a trial, checked."""
    table = load_hydraulics(study.hydraulics).model_dump(exclude_none=True)
    for parameter in study.parameters:
        if parameter.name in values and parameter.name in table:
            table[parameter.name] |= {"value": values[parameter.name], "unit": parameter.unit}
    return validated(HydraulicParameters, table, f"calibration: {study.name}")


def law_of(name: str, values: Values) -> Law:
    """A law with the derivative pole of a trial."""
    law = load_law(name)
    if "derivative_pole" not in values:
        return law
    return law.model_copy(update={"derivative_pole": values["derivative_pole"]})


def plant_of(study: Study, values: Values, cab: str = "") -> Plant:
    """The study's plant with the values of a trial.

    Args:
        study: the study.
        values: parameters by name; those left out are as shipped.
        cab: another cab than the study's.
    """
    hydraulics, factor = hydraulics_of(study, values), values.get("payload", 1.0)
    if study.plant == "single_legs":
        return SingleLegs(
            hydraulics, effective_mass=factor * EFFECTIVE_MASS, static_load=factor * STATIC_LOAD
        )
    plant = Hexapod(cab or study.cab, hydraulics)
    if factor != 1.0:
        carried = plant.model.body_rootid == plant.model.body("platform").rootid
        plant.model.body_mass[carried] *= factor
        plant.model.body_inertia[carried] *= factor
        mujoco.mj_setConst(plant.model, plant.data)
    return plant


def linear_results(
    study: Study, values: Values, laws: Sequence[str], *, damping: bool = True
) -> dict[str, Measured]:
    """Measures of laws around the linearised plant, in heave.

    Args:
        study: plant and parameters.
        values: parameters by name; those left out are as shipped.
        laws: names.
        damping: step the loop too; without it the damping ratios are NaN.
    """
    plant = plant_of(study, values)
    system = linearize(plant)
    if study.plant == "single_legs":
        leg = leg_model(system, 1)
        return {name: _measure(closed_loop(law_of(name, values), leg), damping) for name in laws}
    return {
        name: _measure(loop_between(plant, system, law_of(name, values), None, "heave"), damping)
        for name in laws
    }


def _measure(loop: control.StateSpace, step: bool) -> Measured:
    widths = bandwidths(loop_response(loop, _LINES))
    stable = bool(np.all(np.abs(loop.poles()) < 1.0 + 1e-9))
    damping = float("nan")
    if stable and step:
        _, reached = loop_step(loop, _STEP)
        static = float(np.real(np.squeeze(loop.dcgain())))
        damping = measure_step(reached, 1.0 / FRAME, final=static).damping_ratio
    return Measured(widths.phase_hz, widths.gain_hz, damping, stable)


def least_damping(study: Study, values: Values) -> dict[str, float]:
    """Smallest damping ratio of the velocity law's loop, all degrees of freedom, for each cab."""
    found = {}
    for cab in study.stable_cabs:
        system = linearize(plant_of(study, values, cab))
        poles = closed_loop(law_of("velocity", values), system).poles()
        modes = np.log(poles[np.abs(poles) > 0.1].astype(complex)) / FRAME
        modes = modes[(modes.imag > 0.0) & (np.abs(modes) < _FASTEST)]
        found[cab] = float((-modes.real / np.abs(modes)).min())
    return found


def simulated_results(
    study: Study,
    values: Values,
    laws: Sequence[str],
    *,
    quick: bool = False,
    jobs: int | None = None,
) -> dict[str, Measured]:
    """Measures of laws in the simulation, in heave.

    Args:
        study: the study; `payload` must be as shipped.
        values: parameters by name.
        laws: names.
        quick: sweeps of 30 s instead of 100 s.
        jobs: threads; default one per core.

    Raises:
        InputError: another payload.
    """
    if values.get("payload", 1.0) != 1.0:
        raise InputError(f"payload: {values['payload']} must be 1 in a simulation")
    found = compare(
        [law_of(name, values) for name in laws],
        ["heave"],
        plants=[study.plant],
        cab=study.cab or "gfd",
        hydraulics=hydraulics_of(study, values),
        quick=quick,
        jobs=jobs,
    )
    return {
        row.law: Measured(
            row.phase_bandwidth_hz, row.gain_bandwidth_hz, row.damping_ratio, row.stable
        )
        for row in found.rows
    }


class Verdict(NamedTuple):
    """The end of one step run of the velocity law."""

    cab: str
    dof: str
    stable: bool
    residual: float  #: Largest leg swing of the last second over the largest leg step.


def simulated_stability(
    study: Study, values: Values, *, dofs: Sequence[str] = DOFS, jobs: int | None = None
) -> list[Verdict]:
    """Steps of 1 in or 0.6 deg of the velocity law with every cab of the study."""
    hydraulics, law = hydraulics_of(study, values), law_of("velocity", values)

    def run(case: tuple[str, str]) -> Verdict:
        cab, dof = case
        size = _SWEPT * by_kind(dof, 1.0, ROTATION_PER_TRANSLATION)
        record = simulate(Hexapod(cab, hydraulics), law, signals.step(dof, size), record_every=8)
        metrics = step_metrics(record)
        return Verdict(cab, dof, metrics.stable, metrics.residual)

    return on_threads(run, list(product(study.stable_cabs, dofs)), jobs)
