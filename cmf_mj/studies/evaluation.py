"""What a case of a study measures: one row a degree of freedom, whatever the method.

    sweep    the compiled simulation of the report's chirp and step in one degree of freedom
    linear   the plant linearised about rest with its own actuators, the law closed around it:
             poles, the 6 by 6 response and the steps of all degrees of freedom at once
    matrix   the compiled simulation of orthogonal multisines in all degrees of freedom, for the
             6 by 6 response, and of a step in each

Crosstalk is the largest gain, 0.1 to 10 Hz, from the demand of one degree of freedom to the true
motion of another, each counted in the report's amplitudes (0.33 in and 0.2 deg): 1 is as much as
was asked for. A `sweep` and a `matrix` see a narrow peak only where they have a line; `linear` has
lines at the poles.
"""

import threading
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import (
    Bandwidths,
    bandwidths,
    dof_history,
    matrix_frequency_response,
)
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.law import labels
from cmf_mj.analysis.linear.loop import STEP_DURATION, closed_loop
from cmf_mj.analysis.linear.reduction import jacobian_of, pose_loop
from cmf_mj.analysis.measures import crosstalk as largest_gains
from cmf_mj.analysis.measures import least_damped_mode, oscillations
from cmf_mj.analysis.response.welch import welch_response
from cmf_mj.analysis.step_response import measure_step, step_metrics
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME
from cmf_mj.facility.simulation import simulate
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals import composite as excitations
from cmf_mj.studies.comparison import (
    STEP_PER_AMPLITUDE,
    chirp_and_step,
    dof_amplitude,
    sweep_measures,
)
from cmf_mj.studies.mismatch import with_gain_errors
from cmf_mj.studies.settings import NOMINAL, StudyCase
from cmf_mj.studies.variants import rung_named

BAND = (0.1, 10.0)
"""Frequencies of all responses [Hz]."""

FREQUENCIES = np.geomspace(*BAND, 120)
"""Lines of the linear responses [Hz], beside those of their own poles."""

MULTISINE_SHARE = 0.25
"""Amplitude of each of six multisines over that of a sweep: together they ask a leg for no more."""

MULTISINE_PERIOD = 30.0
"""Of the orthogonal multisines [s]: a line every 0.4 Hz a degree of freedom."""

_BLOCK = 64
"""Frames between the states that a step response goes through."""

_NAN = float("nan")
_NOTHING = Bandwidths(_NAN, _NAN, _NAN)
_UNIT = np.array([dof_amplitude(dof) for dof in DOFS])


class StudyRow(NamedTuple):
    """Measures of one degree of freedom; NaN where a method has none, empty where all failed."""

    dof: str
    stable: bool  #: `linear`: all poles within the unit circle. Otherwise the verdict on the step.
    phase_bandwidth_hz: float
    gain_bandwidth_hz: float
    peak_gain_db: float
    overshoot: float
    damping_ratio: float  #: From the overshoot; NaN below an overshoot of 0.001.
    steady_state_error: float
    mode_damping_ratio: float
    """`linear`: least damping ratio of all oscillating poles below 50 Hz; negative if unstable."""
    mode_frequency_hz: float  #: Its frequency.
    crosstalk_surge: float  #: Into surge from this degree of freedom, and so on; NaN into itself.
    crosstalk_sway: float
    crosstalk_heave: float
    crosstalk_roll: float
    crosstalk_pitch: float
    crosstalk_yaw: float
    error_type: str = ""  #: Class of the error that ended the case.
    error_message: str = ""


def evaluate(case: StudyCase) -> list[StudyRow]:
    """Run a case.

    Raises:
        InputError: the rung, the pose or the law does not go with the method.
        FloatingPointError: a run left its physical bounds.
    """
    rung = rung_named(case.rung)
    plant = rung.build(case.cab, case.hydraulics)
    errors: dict[str, NDArray[np.float64]] = {}
    if case.draw != NOMINAL:
        own = case.study
        drawn = own.mismatch.draw_hydraulics(case.hydraulics, plant.actuators, own.seed, case.draw)
        plant = rung.build(case.cab, drawn)
        errors = own.mismatch.draw_gain_errors(plant.legs, own.seed, case.draw)
    method = {"sweep": _sweep, "linear": _linear, "matrix": _matrix}[case.method]
    return method(case, plant, errors)


def failed(error: BaseException) -> StudyRow:
    """The row of a case that could not be run."""
    nothing = _row(
        "",
        stable=False,
        widths=_NOTHING,
        step=(_NAN, _NAN, _NAN),
        crosstalk=np.full(len(DOFS), _NAN),
    )
    return nothing._replace(error_type=type(error).__name__, error_message=str(error))


def _sizes(case: StudyCase) -> NDArray[np.float64]:
    whole = case.study.amplitude * units.INCH
    return np.array([dof_amplitude(dof, whole) for dof in DOFS])


def _row(
    dof: str,
    *,
    stable: bool,
    widths: Bandwidths,
    step: tuple[float, float, float],
    crosstalk: NDArray[np.float64],
    mode: tuple[float, float] = (_NAN, _NAN),
) -> StudyRow:
    surge, sway, heave, roll, pitch, yaw = (
        _NAN if moved == dof else float(value) for moved, value in zip(DOFS, crosstalk, strict=True)
    )
    return StudyRow(dof, bool(stable), *widths, *step, *mode, surge, sway, heave, roll, pitch, yaw)


def _step_measures(record: Record) -> tuple[bool, tuple[float, float, float]]:
    found = step_metrics(record)
    return found.stable, (found.overshoot, found.damping_ratio, found.steady_state_error)


def _sweep(case: StudyCase, plant: Plant, errors: dict[str, NDArray[np.float64]]) -> list[StudyRow]:
    rung, quick = rung_named(case.rung), case.study.quick
    sweep, step = chirp_and_step(
        plant,
        case.law,
        case.dof,
        float(_sizes(case)[DOFS.index(case.dof)]),
        quick=quick,
        electronics=with_gain_errors(errors) or rung.between(case.study.seed),
        command_delay=rung.command_delay,
        about=case.pose,
    )
    _, widths = sweep_measures(sweep, quick=quick)
    stable, shape = _step_measures(step)
    return [
        _row(
            case.dof,
            stable=stable,
            widths=widths,
            step=shape,
            crosstalk=_sweep_crosstalk(sweep, case.dof, quick=quick),
        )
    ]


def _sweep_crosstalk(sweep: Record, dof: str, *, quick: bool) -> NDArray[np.float64]:
    """Largest gains (6,) from the demand of a chirp to the true motion."""
    begin = round(float(sweep.metadata["command"]["settle"]) * sweep.rate) - 1
    demand = dof_history(sweep, "leg_reference", dof)[begin:]
    unit = _UNIT[DOFS.index(dof)]
    gains = np.full(len(DOFS), _NAN)
    for i, other in enumerate(DOFS):
        try:
            moved = dof_history(sweep, "leg_extension", other)[begin:]
        except ValueError:
            return gains
        response = welch_response(
            demand - demand[0],
            moved - moved[0],
            sweep.rate,
            segment=10.0 if quick else 20.0,
            band=(0.2, BAND[1]),
            pad=True,
        ).response
        gains[i] = float(np.abs(response).max()) * unit / _UNIT[i]
    return gains


class _Machine(threading.local):
    """The machine a worker linearised last: the laws of a study meet it one after the other."""

    key: object = None
    system: control.StateSpace = None


_LAST = _Machine()


def _linearised(case: StudyCase, plant: Plant) -> control.StateSpace:
    key = (case.rung, case.cab, case.pose, case.draw, case.study, case.hydraulics)
    if key != _LAST.key:
        _LAST.system, _LAST.key = linearize(plant, case.pose), key
    return _LAST.system.copy()


def _linear(
    case: StudyCase, plant: Plant, errors: dict[str, NDArray[np.float64]]
) -> list[StudyRow]:
    system = _linearised(case, plant)
    for channel, error in errors.items():
        for name, own in zip(labels((channel,), plant.legs), error, strict=True):
            system.C[system.output_labels.index(name)] *= 1.0 + own
    delay = rung_named(case.rung).command_delay
    law = case.law.mounted(plant.mounting)
    loop = pose_loop(closed_loop(law, system, command_delay=delay), plant, case.pose)
    poles = np.linalg.eigvals(np.asarray(loop.A))
    stable = bool(np.abs(poles).max() < 1.0)
    mode = least_damped_mode(poles)
    if not stable:  # there is no response to measure
        blank, nowhere = (_NAN, _NAN, _NAN), np.full(len(DOFS), _NAN)
        return [
            _row(dof, stable=False, widths=_NOTHING, step=blank, crosstalk=nowhere, mode=mode)
            for dof in DOFS
        ]
    omega = 2.0 * np.pi * _lines(poles)
    response = np.asarray(control.frequency_response(loop, omega).frdata)
    # What the legs do is what their sensors read over its gain.
    jacobian = jacobian_of(plant, case.pose)
    gains = 1.0 + errors.get("leg_position", np.zeros(plant.legs))
    true = np.linalg.solve(jacobian, jacobian / gains[:, None])
    moved = np.einsum("ij,jkf->ikf", true, response)
    crosstalk = largest_gains(moved, _UNIT)
    steps = _steps(loop)
    reached = np.real(np.asarray(control.dcgain(loop)))
    rows = []
    for i, dof in enumerate(DOFS):
        final = float(reached[i, i])
        shape = measure_step(steps[:, i, i], 1.0 / FRAME, final=final)
        rows.append(
            _row(
                dof,
                stable=True,
                widths=bandwidths(control.FrequencyResponseData(response[i, i], omega)),
                step=(shape.overshoot, shape.damping_ratio, shape.steady_state_error),
                crosstalk=crosstalk[:, i],
                mode=mode,
            )
        )
    return rows


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
    for _ in range(round(STEP_DURATION / FRAME / _BLOCK)):
        blocks.append((reader @ state).reshape(_BLOCK, c.shape[0], inputs))
        state = stride @ state
    return np.concatenate(blocks)


def _lines(poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Frequencies [Hz] of a response, among them those of all poles in the band."""
    own = np.abs(oscillations(poles)) / (2.0 * np.pi)
    return np.union1d(FREQUENCIES, own[(own > BAND[0]) & (own < BAND[1])])


def _matrix(
    case: StudyCase, plant: Plant, errors: dict[str, NDArray[np.float64]]
) -> list[StudyRow]:
    rung = rung_named(case.rung)
    electronics = with_gain_errors(errors) or rung.between(case.study.seed)
    sizes = _sizes(case)

    def run(command: signals.Command, every: int) -> Record:
        moved = signals.Command(
            command.pose + np.array(case.pose), command.description, command.seed
        )
        return simulate(
            plant,
            case.law,
            moved,
            electronics=electronics,
            record_every=every,
            command_delay=rung.command_delay,
        )

    sweep = run(
        excitations.orthogonal_multisines(
            dict(zip(DOFS, (MULTISINE_SHARE * sizes).tolist(), strict=True)),
            start=BAND[0],
            stop=BAND[1],
            period=MULTISINE_PERIOD,
            periods=2,
            seed=case.study.seed,
        ),
        16,
    )
    try:
        measured = matrix_frequency_response(sweep)
    except ValueError:  # the legs went where no platform joins them
        measured = None
    rows = []
    for i, dof in enumerate(DOFS):
        step = run(signals.step(dof, float(sizes[i]) * STEP_PER_AMPLITUDE), 8)
        stable, shape = _step_measures(step)
        widths, crosstalk = _NOTHING, np.full(len(DOFS), _NAN)
        if measured is not None:
            column = np.asarray(measured.frdata)[:, i]
            known = ~np.isnan(column[i])
            lines = np.asarray(measured.omega)[known]
            widths = bandwidths(control.FrequencyResponseData(column[i, known], lines))
            crosstalk = np.abs(column[:, known]).max(axis=1) * _UNIT[i] / _UNIT
        rows.append(_row(dof, stable=stable, widths=widths, step=shape, crosstalk=crosstalk))
    return rows
