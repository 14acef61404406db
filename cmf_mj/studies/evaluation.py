"""What a case of a study measures: one row a degree of freedom, whatever the method.

    sweep    the compiled simulation of the report's chirp and step in one degree of freedom
    linear   the plant linearised about rest with its actuators, the law closed around it:
             poles, the 6 by 6 response and the steps of all degrees of freedom at once

Crosstalk is the largest gain, 0.1 to 10 Hz, from the demand of one degree of freedom to the true
motion of another, each counted in the report's amplitudes (0.33 in and 0.2 deg): at 1 the other
moves as much as the demand. A `sweep` sees a narrow peak only where it has a line; `linear` has
lines at the poles.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import crosstalk
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.measurable import dof_history
from cmf_mj.analysis.measures import BAND, Measures, measure_axes, measure_records
from cmf_mj.analysis.spectra import welch_response
from cmf_mj.core.errors import NoPoseError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.electronics.sensors import CHANNELS, load_sensors
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.studies.case import REPORT_AMPLITUDES, Case
from cmf_mj.studies.settings import NOMINAL, StudyCase, rung_named

MEASURE_NAMES = (
    *("stable", "phase_bandwidth_hz", "gain_bandwidth_hz", "peak_gain_db", "overshoot"),
    *("damping_ratio", "steady_state_error", "mode_damping_ratio", "mode_frequency_hz"),
    *("later_phase_hz", "graze_from_hz", "graze_to_hz"),
)
"""Measures in the table of results."""

Gains = NDArray[np.float64]

_NANS: Gains = np.full(len(DOFS), np.nan)


class StudyRow(NamedTuple):
    """Measures of one degree of freedom; NaN where a method has none, empty where all failed.

    `linear` is stable with all poles within the unit circle, and its mode is the least damped
    below 50 Hz; `sweep` judges the step and has no mode.
    """

    dof: str
    measures: Measures
    crosstalk: Gains  #: Into all degrees of freedom from this one, (6,); NaN into itself.
    error_type: str = ""  #: Class of the error that ended the case.
    error_message: str = ""

    @property
    def columns(self) -> dict[str, Any]:
        """The row in the table of results."""
        gains = zip(DOFS, self.crosstalk, strict=True)
        return {
            "dof": self.dof,
            **{name: getattr(self.measures, name) for name in MEASURE_NAMES},
            **{f"crosstalk_{dof}": float(gain) for dof, gain in gains},
            "error_type": self.error_type,
            "error_message": self.error_message,
        }


def evaluate(study_case: StudyCase, shared: dict[str, Linear] | None = None) -> list[StudyRow]:
    """Run a case; `shared` keeps the linearised plant for further cases on the same plant.

    Raises FloatingPointError where a run leaves its physical bounds.
    """
    rung, case, settings = rung_named(study_case.rung), study_case.case, study_case.settings
    mismatch, values = Unknowns(settings.mismatch), {}
    if study_case.draw != NOMINAL:
        values = mismatch.streams(settings.seed, study_case.draw)
    assert case.cab is not None  # single legs take the machine of the cab
    cab = mismatch.apply(values, case.cab)
    plant = rung.build(cab, mismatch.apply(values, case.hydraulics))
    case = replace(case, law=mismatch.apply(values, case.law))
    ideal = load_sensors("ideal")
    sensors = mismatch.apply(values, ideal, "mismatched")
    if settings.method == "linear":
        stated = {channel: getattr(sensors, channel).gain_errors for channel in CHANNELS}
        known = {channel: errors for channel, errors in stated.items() if errors}
        gain_errors = {name: np.array([e.si for e in errors]) for name, errors in known.items()}
        return _linear_rows(case, plant, gain_errors, {} if shared is None else shared)
    chain = ElectronicsSettings(seed=settings.seed) if "electronics" in rung.effects else None
    if sensors is not ideal:
        chain = ElectronicsSettings(sensors=sensors, converters="off")
    case = replace(case, electronics=chain, command_delay=int("delay" in rung.effects))
    sweep, step = case.sweep_and_step(plant)
    measures = measure_records(sweep, step, segment=case.segment)
    return [StudyRow(case.dof, measures, _sweep_crosstalk(sweep, case))]


def error_row(error: BaseException) -> StudyRow:
    """The row of a case that could not be run."""
    return StudyRow("", Measures(), _NANS, type(error).__name__, str(error))


def _sweep_crosstalk(sweep: Record, case: Case) -> Gains:
    """Largest gains (6,) from the demand of a chirp to the true motion."""
    begin = round(sweep.signal.lead * sweep.rate) - 1
    demand = dof_history(sweep, "leg_reference", case.dof)[begin:]
    options: dict[str, Any] = {"segment": case.segment, "band": (0.2, BAND[1]), "pad": True}
    responses = []
    for dof in DOFS:
        try:
            motion = dof_history(sweep, "leg_extension", dof)[begin:]
        except NoPoseError:
            return _NANS
        estimate = welch_response(demand - demand[0], motion - motion[0], sweep.rate, **options)
        responses.append(estimate.response)
    index = DOFS.index(case.dof)
    gains = np.abs(responses).max(axis=1) * REPORT_AMPLITUDES[index] / REPORT_AMPLITUDES
    gains[index] = np.nan
    return np.asarray(gains)


def _linear_rows(
    case: Case, plant: Plant, gain_errors: dict[str, Gains], shared: dict[str, Linear]
) -> list[StudyRow]:
    """Rows of all degrees of freedom, where sensors have gain errors by channel and leg."""
    if "linear" not in shared:
        shared["linear"] = Linear(plant, case.pose)
    linear = shared["linear"].sensed(gain_errors)
    loop = linear.loop(case.law)
    measures, response = measure_axes(loop)
    if response is None:
        return [StudyRow(dof, of_dof, _NANS) for dof, of_dof in zip(DOFS, measures, strict=True)]
    # The motion of a leg is the reading of its sensor over the sensor's gain.
    gains = 1.0 + gain_errors.get("leg_position", np.zeros(plant.legs))
    pose_per_reading = np.linalg.solve(linear.jacobian, linear.jacobian / gains[:, None])
    true_response = np.einsum("ij,jkf->ikf", pose_per_reading, response)
    gains_by_dof = crosstalk(true_response, REPORT_AMPLITUDES).T
    return [StudyRow(*row) for row in zip(DOFS, measures, gains_by_dof, strict=True)]
