"""Modes of a linearised plant: poles, damping, and what takes part in them.

With right and left eigenvectors R and L = R^-1 the share of state k in mode i is the participation
factor |R_ki L_ik|, scaled to a sum of 1. The leg motion of a mode is the part of R at the
extensions; a degree of freedom's share in it is

    Re(phi* J_j x_j) / |phi|^2,    phi = J x

so that all six add to 1; one may be negative where two degrees of freedom work against each other.

Why a law around a leg oscillates: the least damped poles and the phase crossover of its loop.

The loop broken at the valve command, with leg plant P and DCL C in discrete time,

    L(f) = C(e^(2 pi i f T)) P(e^(2 pi i f T)) e^(-2 pi i f T),

oscillates where the phase of L is a whole turn. A command clamped at 100 % lowers the gain and
leaves the phase: a limit cycle ends up between the frequency of the unstable poles and this one.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.law import DCL_INPUTS, FEEDBACK, dcl_state_space, labels
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.reduction import jacobian_of, leg_model
from cmf_mj.analysis.measures import least_damped_mode
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.record.record import Record

_FAMILIES = {
    "drive": ("drive",),
    "spool": ("spool",),
    "motion": ("leg_position", "leg_velocity"),
    "oil": ("cap_pressure", "rod_pressure"),
    "supply": ("supply_pressure", "return_pressure", "accumulator_oil", "pump_flow"),
}
"""Kinds of state, with the beginnings of their names."""

_STILL = 1e-6
"""Pole [rad/s] of an integrator: round-off of the eigenvalues."""


class Mode(NamedTuple):
    """One real pole or one pair."""

    pole: complex  #: [rad/s], of a pair the one above the real axis.
    frequency: float  #: Modulus of the pole [rad/s].
    damping_ratio: float  #: -Re / modulus; 1 for a stable real pole, NaN for an integrator.
    shares: dict[str, float]  #: Shares of drive, spool, motion, oil and supply, sum 1.
    leg_shape: NDArray[np.complex128]  #: Leg motion, (n,), the largest 1; zero where no leg moves.
    dof_shares: NDArray[np.float64]
    """Shares of the degrees of freedom in the leg motion, (6,); NaN where none are asked for."""


def modes(
    system: control.StateSpace, plant: Plant | None = None, pose: ArrayLike | None = None
) -> tuple[Mode, ...]:
    """All modes of a linearised plant, slowest first.

    Of poles that coincide, such as those of uncoupled equal legs, only the space of all is
    determined, not the shape of one. `plant`, with the legs of the facility in the `pose` of
    `system`, is for the shares of degrees of freedom.
    """
    if not system.isctime(strict=True):
        raise InputError("system: is discrete; a linearised plant, which is continuous, is needed")
    family = [_family(name) for name in system.state_labels]
    matrix, (scale, _) = linalg.matrix_balance(np.asarray(system.A), permute=False, separate=True)
    poles, right = np.linalg.eig(matrix)
    poles = np.where(np.abs(poles) < _STILL, 0.0, poles)
    factors = np.abs(right * np.linalg.inv(right).T)
    factors /= factors.sum(axis=0)
    right = right * scale[:, None]
    legs = int(system.ninputs)
    rows = [system.state_labels.index(name) for name in labels(("leg_position",), legs)]
    jacobian = None if plant is None else jacobian_of(plant, pose)
    result = []
    for i in np.argsort(np.abs(poles), kind="stable"):
        if poles[i].imag < 0.0:
            continue
        size = float(np.abs(poles[i]))
        shape = right[rows, i]
        most = shape[np.argmax(np.abs(shape))]
        parts = list(zip(factors[:, i], family, strict=True))
        moves = np.abs(most) > 1e-12 * np.abs(right[:, i]).max()
        shape = shape / most if moves else np.zeros(legs, dtype=complex)
        damping = float(-poles[i].real / size) if size > _STILL else float("nan")
        shares = {name: float(sum(f for f, kind in parts if kind == name)) for name in _FAMILIES}
        dofs = _dof_shares(shape, jacobian)
        result.append(Mode(complex(poles[i]), size, damping, shares, shape, dofs))
    return tuple(result)


def _family(state: str) -> str:
    for family, starts in _FAMILIES.items():
        if state.startswith(starts):
            return family
    raise InputError(f"system: its state {state!r} is none of a linearised plant")


def _dof_shares(
    shape: NDArray[np.complex128], jacobian: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    if jacobian is None or not shape.any():
        return np.full(6, np.nan)
    parts = jacobian * np.linalg.solve(jacobian, shape)
    return np.real(np.conj(shape) @ parts) / float(np.sum(np.abs(shape) ** 2))


_FREQUENCY = np.geomspace(2.0, 100.0, 4000)
_TAIL = 4.0
"""Length of the steady oscillation examined [s]."""


class Oscillation(NamedTuple):
    """What the linear loop says; NaN where it has no such thing."""

    pole_hz: float  #: Modulus of the least damped pair.
    pole_damping: float  #: Its damping ratio, negative where it grows.
    crossover_hz: float
    """Where the phase of the open loop is a whole turn, at the highest gain there."""
    crossover_gain: float  #: Of the open loop there; above 1 the loop oscillates.


def open_loop(law: Law, leg: control.StateSpace, f: NDArray[np.float64]) -> NDArray[np.complex128]:
    """L at `f` [Hz], (K,): from the command at the valve around to the DCL's output."""
    omega = 2.0 * np.pi * f
    sampled = control.sample_system(leg, law.frame, method="zoh", copy_names=True)
    plant = control.frequency_response(sampled, omega).frdata[:, 0, :]
    dcl = control.frequency_response(dcl_state_space(law), omega).frdata[0]
    rows = {name: plant[sampled.output_labels.index(name)] for name in FEEDBACK}
    total = sum(dcl[DCL_INPUTS.index(name)] * rows[name] for name in FEEDBACK)
    return np.asarray(total * np.exp(-1j * omega * law.frame))


def oscillation(law: Law, parameters: HydraulicParameters) -> Oscillation:
    """Least damped poles and phase crossover of one leg under a law."""
    leg = leg_model(linearize(SingleLegs(parameters)), 1)
    # Slower pairs belong to the law's integrator, not to an oscillation.
    damping, frequency = least_damped_mode(
        closed_loop(law, leg).poles(), 200.0, lowest_hz=4.0, frame=law.frame
    )
    loop = open_loop(law, leg, _FREQUENCY)
    turns = np.flatnonzero((loop.imag[1:] * loop.imag[:-1] < 0.0) & (loop.real[1:] > 0.0))
    crossover, gain = float("nan"), float("nan")
    if turns.size:
        at = turns[np.argmax(np.abs(loop[turns]))]
        crossover, gain = float(_FREQUENCY[at]), float(np.abs(loop[at]))
    return Oscillation(frequency, damping, crossover, gain)


def limit_cycle(record: Record) -> tuple[float, float, float]:
    """Frequency [Hz], amplitude [psi] and largest acceleration [g] of leg 1 at the end of a run.

    The frequency is NaN where the oscillation has died down.
    """
    tail = round(_TAIL * record.rate)
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[-tail:, 0])
    acceleration = float(np.abs(record["leg_acceleration"][-tail:, 0]).max())
    acceleration /= units.STANDARD_GRAVITY
    swing = difference - difference.mean()
    amplitude = float(np.ptp(swing)) / 2.0
    if amplitude < 10.0:
        return float("nan"), amplitude, acceleration
    spectrum = np.abs(np.fft.rfft(swing * np.hanning(tail)))
    return float(np.argmax(spectrum) / _TAIL), amplitude, acceleration
