"""What a case of a study measures: one row a degree of freedom, whatever the method.

    sweep    the compiled simulation of the report's chirp and step in one degree of freedom
    linear   the plant linearised about rest with its actuators, the law closed around it:
             poles, the 6 by 6 response and the steps of all degrees of freedom at once
    matrix   the compiled simulation of orthogonal multisines in all degrees of freedom, for the
             6 by 6 response, and of a step in each

Crosstalk is the largest gain, 0.1 to 10 Hz, from the demand of one degree of freedom to the true
motion of another, each counted in the report's amplitudes (0.33 in and 0.2 deg): 1 is as much as
was asked for. A `sweep` and a `matrix` see a narrow peak only where they have a line; `linear` has
lines at the poles.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import bandwidths, matrix_frequency_response
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.law import labels
from cmf_mj.analysis.linear.loop import STEP_DURATION, closed_loop
from cmf_mj.analysis.linear.reduction import jacobian_of, pose_loop
from cmf_mj.analysis.measurable import dof_history
from cmf_mj.analysis.measures import (
    Measures,
    crosstalk,
    joined,
    least_damped_mode,
    measure_records,
    oscillations,
)
from cmf_mj.analysis.response.welch import welch_response
from cmf_mj.analysis.step_response import measure_step, step_metrics
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.binding import bound
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.studies.case import REPORT_AMPLITUDES, STEP_PER_AMPLITUDE, Case
from cmf_mj.studies.mismatch import with_gain_errors
from cmf_mj.studies.settings import NOMINAL, StudyCase, rung_named

BAND = (0.1, 10.0)
"""Frequencies of all responses [Hz]."""

FREQUENCIES = np.geomspace(*BAND, 120)
"""Lines of the linear responses [Hz], next to those of their poles."""

MULTISINE_SHARE = 0.25
"""Amplitude of each of six multisines over that of a sweep: together they ask a leg for no more."""

MULTISINE_PERIOD = 30.0
"""Of the orthogonal multisines [s]: a line every 0.4 Hz a degree of freedom."""

MEASURED = (
    *("stable", "phase_bandwidth_hz", "gain_bandwidth_hz", "peak_gain_db", "overshoot"),
    *("damping_ratio", "steady_state_error", "mode_damping_ratio", "mode_frequency_hz"),
    *("later_phase_hz", "graze_from_hz", "graze_to_hz"),
)
"""Measures in the table of results."""

_BLOCK = 64
"""Frames between the states that a step response goes through."""

Gains = NDArray[np.float64]

_NONE: Gains = np.full(len(DOFS), np.nan)


class StudyRow(NamedTuple):
    """Measures of one degree of freedom; NaN where a method has none, empty where all failed.

    `linear` is stable with all poles within the unit circle, and its mode is the least damped
    below 50 Hz; the other methods judge the step and have no mode.
    """

    dof: str
    measures: Measures
    crosstalk: Gains  #: Into all degrees of freedom from this one, (6,); NaN into itself.
    error_type: str = ""  #: Class of the error that ended the case.
    error_message: str = ""

    @property
    def columns(self) -> dict[str, Any]:
        """The row in the table of results."""
        return {
            "dof": self.dof,
            **{name: getattr(self.measures, name) for name in MEASURED},
            **{f"crosstalk_{dof}": float(g) for dof, g in zip(DOFS, self.crosstalk, strict=True)},
            **{"error_type": self.error_type, "error_message": self.error_message},
        }


def evaluate(
    study_case: StudyCase, shared: dict[str, control.StateSpace] | None = None
) -> list[StudyRow]:
    """Run a case; `shared` keeps the linearised machine for further cases of the same one.

    Raises FloatingPointError where a run leaves its physical bounds.
    """
    rung, case, study = rung_named(study_case.rung), study_case.case, study_case.study
    plant = rung.build(case.cab or "gfd", case.hydraulics)
    errors: dict[str, Gains] = {}
    if study_case.draw != NOMINAL:
        mismatch, key = study.mismatch, (study.seed, study_case.draw)
        drawn = mismatch.draw_hydraulics(case.hydraulics, plant.actuators, *key)
        plant = rung.build(case.cab or "gfd", drawn)
        errors = mismatch.draw_gain_errors(plant.legs, *key)
    if study_case.method == "linear":
        return _linear(study_case, plant, errors, {} if shared is None else shared)
    noisy = ElectronicsSettings(seed=study.seed) if "electronics" in rung.effects else None
    delay, chain = int("delay" in rung.effects), with_gain_errors(errors) or noisy
    case = replace(case, electronics=chain, command_delay=delay)
    if study_case.method == "matrix":
        return _matrix(case, plant, study_case.sizes, study.seed)
    sweep, step = case.sweep_and_step(plant)
    measures = measure_records(sweep, step, segment=case.segment)
    return [StudyRow(case.dof, measures, _sweep_crosstalk(sweep, case))]


def failed(error: BaseException) -> StudyRow:
    """The row of a case that could not be run."""
    return StudyRow("", Measures(), _NONE, type(error).__name__, str(error))


def _sweep_crosstalk(sweep: Record, case: Case) -> Gains:
    """Largest gains (6,) from the demand of a chirp to the true motion."""
    begin = round(sweep.signal.lead * sweep.rate) - 1
    demand = dof_history(sweep, "leg_reference", case.dof)[begin:]
    responses = []
    for other in DOFS:
        try:
            moved = dof_history(sweep, "leg_extension", other)[begin:]
        except ValueError:
            return _NONE
        x, y, length, band = demand - demand[0], moved - moved[0], case.segment, (0.2, BAND[1])
        estimate = welch_response(x, y, sweep.rate, segment=length, band=band, pad=True)
        responses.append(estimate.response)
    index = DOFS.index(case.dof)
    gains = np.abs(responses).max(axis=1) * REPORT_AMPLITUDES[index] / REPORT_AMPLITUDES
    gains[index] = np.nan
    return np.asarray(gains)


def _linear(
    study_case: StudyCase,
    plant: Plant,
    errors: dict[str, Gains],
    shared: dict[str, control.StateSpace],
) -> list[StudyRow]:
    case = study_case.case
    if "system" not in shared:
        shared["system"] = linearize(plant, case.pose)
    system = shared["system"].copy()
    for channel, error in errors.items():
        for name, part in zip(labels((channel,), plant.legs), error, strict=True):
            system.C[system.output_labels.index(name)] *= 1.0 + part
    loop = pose_loop(closed_loop(bound(case.law, plant), system), plant, case.pose)
    measures, response = loop_measures(loop)
    if response is None:
        return [StudyRow(dof, one, _NONE) for dof, one in zip(DOFS, measures, strict=True)]
    # What the legs do is what their sensors read over its gain.
    jacobian = jacobian_of(plant, case.pose)
    gains = 1.0 + errors.get("leg_position", np.zeros(plant.legs))
    true = np.linalg.solve(jacobian, jacobian / gains[:, None])
    shares = crosstalk(np.einsum("ij,jkf->ikf", true, response), REPORT_AMPLITUDES)
    return [StudyRow(*row) for row in zip(DOFS, measures, shares.T, strict=True)]


def loop_measures(
    loop: control.StateSpace,
) -> tuple[tuple[Measures, ...], NDArray[np.complex128] | None]:
    """Measures of each axis of a discrete loop, and its response (n, n, K).

    `loop` goes from n demands to n motions. Its lines are `FREQUENCIES` and those of its poles. A
    loop that is not stable has no response and only a mode, the least damped of all.
    """
    poles = np.linalg.eigvals(np.asarray(loop.A))
    mode = least_damped_mode(poles, frame=loop.dt)
    axes = int(loop.noutputs)
    if not np.abs(poles).max() < 1.0:
        return (joined(mode=mode),) * axes, None
    modes = np.abs(oscillations(poles, loop.dt)) / (2.0 * np.pi)
    lines = np.union1d(FREQUENCIES, modes[(modes > BAND[0]) & (modes < BAND[1])])
    omega = 2.0 * np.pi * lines
    response = np.asarray(control.frequency_response(loop, omega).frdata)
    steps = _steps(loop)
    final = np.real(np.asarray(np.atleast_2d(control.dcgain(loop))))
    measures = []
    for i in range(axes):
        widths = bandwidths(control.FrequencyResponseData(response[i, i], omega))
        step = measure_step(steps[:, i, i], 1.0 / loop.dt, final=float(final[i, i]))
        measures.append(joined(widths, step, mode))
    return tuple(measures), response


def _steps(loop: control.StateSpace) -> NDArray[np.float64]:
    """Responses to unit steps of a discrete loop, (N, outputs, inputs), from the step on.

    Blocks of outputs from states a block apart: [C; CA; ...] x_k, x_(k+1) = A^n x_k + b.
    """
    a, b, c = (np.asarray(m) for m in (loop.A, loop.B, loop.C))
    order, inputs = b.shape
    # The step is one more state that stands still.
    whole = np.block([[a, b], [np.zeros((inputs, order)), np.eye(inputs)]])
    rows = [np.hstack([c, np.asarray(loop.D)])]
    for _ in range(_BLOCK - 1):
        rows.append(rows[-1] @ whole)
    reader = np.vstack(rows)
    stride = np.linalg.matrix_power(whole, _BLOCK)
    state = np.vstack([np.zeros((order, inputs)), np.eye(inputs)])
    blocks = []
    for _ in range(round(STEP_DURATION / loop.dt / _BLOCK)):
        blocks.append((reader @ state).reshape(_BLOCK, c.shape[0], inputs))
        state = stride @ state
    return np.concatenate(blocks)


def _matrix(case: Case, plant: Plant, sizes: Gains, seed: int) -> list[StudyRow]:
    amplitudes = dict(zip(DOFS, (MULTISINE_SHARE * sizes).tolist(), strict=True))
    how: dict[str, Any] = {"period": MULTISINE_PERIOD, "periods": 2, "seed": seed}
    sines = composite.orthogonal_multisines(amplitudes, start=BAND[0], stop=BAND[1], **how)
    sweep = case.run(sines, plant)
    try:
        measured = matrix_frequency_response(sweep)
    except ValueError:  # the legs went where no platform joins them
        measured = None
    rows = []
    for i, dof in enumerate(DOFS):
        command = signals.step(dof, float(sizes[i]) * STEP_PER_AMPLITUDE)
        step = step_metrics(case.run(command, plant, every=8))
        widths, gains = None, _NONE
        if measured is not None:
            response = np.asarray(measured.frdata)
            known = ~np.isnan(response[i, i])
            lines = np.asarray(measured.omega)[known]
            widths = bandwidths(control.FrequencyResponseData(response[i, i, known], lines))
            gains = crosstalk(response, REPORT_AMPLITUDES)[:, i]
        rows.append(StudyRow(dof, joined(widths, step), gains))
    return rows
