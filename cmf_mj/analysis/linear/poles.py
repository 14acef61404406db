"""Poles of linear systems: stability and damping of loops, and the modes of a linearised plant.

A discrete loop is stable when all of its poles lie within the unit circle; one at 1, an
integrator's, holds no position. A mode of a plant is a pole with what takes part in its motion.

A pole of a loop counts in a degree of freedom where its residue |c_i v| |w b_i| in the response
from that demand to that motion is at least 0.003 of the largest. The damping ratio of a degree of
freedom is the least of the poles that count in it, between 0.5 and 50 Hz. The *pair* are the least
damped poles in which the heavy modes of sway with roll and of surge with pitch lie, below 8 Hz.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.core.errors import InputError
from cmf_mj.core.units import FRAME
from cmf_mj.machine.geometry import DOFS

Matrix = NDArray[np.float64]
Poles = NDArray[np.complex128]

_OSCILLATING = 0.9  #: Damping ratio below which a pair oscillates; else it may be two real poles.
_INSIDE = 1.0 - 1e-9  #: Modulus below which a pole counts as inside, not as an integrator's.
_RESIDUE_SHARE = 0.003  #: Residue over the largest from which a pole counts in a degree of freedom.
_DAMPING_BAND = (0.5, 50.0)  #: Poles whose damping counts [Hz].
_PAIR_HZ = 8.0  #: Below this, the least damped poles are the pair [Hz].


class PoleDamping(NamedTuple):
    """Damping of a pair of poles; NaN where there is no pair."""

    damping_ratio: float = float("nan")  #: -Re / modulus of the continuous poles.
    frequency_hz: float = float("nan")  #: Their modulus [Hz].


def are_stable(poles: Poles) -> bool:
    """The verdict on a discrete loop: whether all of its poles lie within the unit circle."""
    return bool((np.abs(poles) < _INSIDE).all())


def holds_position(poles: Poles) -> bool:
    """Whether a discrete loop holds its position: no real pole at 1 or beyond."""
    return not bool((poles.real[np.abs(poles.imag) < 1e-9] >= _INSIDE).any())


def oscillations(poles: Poles, frame: float = FRAME) -> Poles:
    """Continuous poles [rad/s] above the real axis of a loop discrete in frames [s]."""
    upper: Poles = poles[poles.imag > 1e-9]
    return np.asarray(np.log(upper) / frame, dtype=complex)


def least_damped_mode(
    poles: Poles, highest_hz: float = 50.0, lowest_hz: float = 0.0, frame: float = FRAME
) -> PoleDamping:
    """The least damped pair of a loop, discrete in frames [s], between frequencies."""
    pairs = oscillations(poles, frame)
    modulus = np.abs(pairs)
    pairs = pairs[(modulus < 2.0 * np.pi * highest_hz) & (modulus > 2.0 * np.pi * lowest_hz)]
    return _pair_of_lowest(pairs, -pairs.real / np.abs(pairs))


def slowest_oscillation(poles: Poles, frame: float = FRAME) -> PoleDamping:
    """The slowest pair of a loop, discrete in frames [s], that is damped by less than 0.9."""
    pairs = oscillations(poles, frame)
    pairs = pairs[-pairs.real < _OSCILLATING * np.abs(pairs)]
    return _pair_of_lowest(pairs, np.abs(pairs))


def _pair_of_lowest(pairs: Poles, rank: Matrix) -> PoleDamping:
    """Damping of the pair of the lowest rank."""
    if pairs.size == 0:
        return PoleDamping()
    pair = pairs[np.argmin(rank)]
    return PoleDamping(float(-pair.real / np.abs(pair)), float(np.abs(pair) / (2.0 * np.pi)))


def loop_damping(loop: control.StateSpace) -> dict[str, float]:
    """Least damping ratios of a discrete loop from demands to motions of `DOFS`.

    `least` of all poles, of the `pair` with its frequency `pair_hz`, and of each degree of freedom;
    `stable` is the verdict `are_stable`, of real and slow poles too.
    """
    poles, vectors = np.linalg.eig(np.asarray(loop.A))
    motion = np.abs(np.asarray(loop.C) @ vectors)
    excitation = np.abs(np.linalg.solve(vectors, np.asarray(loop.B)))
    residues = (motion * excitation.T)[:, poles.imag > 1e-9]
    pairs = oscillations(poles, loop.dt)
    hertz = np.abs(pairs) / (2.0 * np.pi)
    ratios = -pairs.real / np.abs(pairs)
    lowest, highest = _DAMPING_BAND
    in_band = (hertz > lowest) & (hertz < highest)
    largest = residues[:, in_band].max(axis=1, keepdims=True, initial=0.0)
    counts = in_band & (residues >= _RESIDUE_SHARE * largest)
    slow = in_band & (hertz < _PAIR_HZ)
    pair_hz = float(hertz[slow][np.argmin(ratios[slow])]) if slow.any() else float("nan")
    damping: dict[str, float] = {"stable": are_stable(poles), "least": _least(ratios[in_band])}
    damping |= {"pair": _least(ratios[slow]), "pair_hz": pair_hz}
    return damping | {dof: _least(ratios[counts[i]]) for i, dof in enumerate(DOFS)}


def _least(ratios: Matrix) -> float:
    return float(ratios.min()) if ratios.size else float("nan")


_STATE_KINDS = {
    "drive": ("drive",),
    "spool": ("spool",),
    "motion": ("leg_position", "leg_velocity"),
    "oil": ("cap_pressure", "rod_pressure"),
    "supply": ("supply_pressure", "return_pressure", "accumulator_oil", "pump_flow"),
}
"""Kinds of state, with the beginnings of their names."""

_INTEGRATOR = 1e-6  #: A pole of smaller modulus [rad/s] is taken as 0: round-off of eigenvalues.


class Mode(NamedTuple):
    """One real pole or one pair."""

    pole: complex  #: [rad/s], of a pair the one above the real axis.
    frequency: float  #: Modulus of the pole [rad/s].
    damping_ratio: float  #: -Re / modulus; 1 for a stable real pole, NaN for an integrator.
    participation: dict[str, float]  #: Sums of participation factors by kind of state; sum 1.
    leg_shape: NDArray[np.complex128]  #: Leg motion s, (n,), the largest 1; 0 where no leg moves.
    dof_shares: Matrix  #: Re(s^H J_j x_j) / |s|^2 with x = J^-1 s, (6,), sum 1; NaN without J.


def modes(system: control.StateSpace, jacobian: Matrix | None = None) -> tuple[Mode, ...]:
    """All modes of a linearised plant, slowest first.

    Of poles that coincide, such as those of uncoupled equal legs, no single shape is determined.
    With the `jacobian` J = d(legs)/d(pose) (6, 6), of a system of six legs, modes have shares of
    degrees of freedom. Raises `InputError` for other systems.
    """
    if not system.isctime(strict=True):
        raise InputError("system: is discrete; a linearised plant, which is continuous, is needed")
    kinds = [_state_kind(label) for label in system.state_labels]
    positions = [i for i, name in enumerate(system.state_labels) if name.startswith("leg_position")]
    legs = len(positions)
    if jacobian is not None and len(jacobian) != legs:
        raise InputError(f"jacobian: has {len(jacobian)} legs; allowed: the system's {legs}")
    matrix, (scale, _) = linalg.matrix_balance(np.asarray(system.A), permute=False, separate=True)
    poles, vectors = np.linalg.eig(matrix)
    poles = np.where(np.abs(poles) < _INTEGRATOR, 0.0, poles)
    factors = np.abs(vectors * np.linalg.inv(vectors).T)
    factors /= factors.sum(axis=0)
    vectors = vectors * scale[:, None]
    result = []
    for i in np.argsort(np.abs(poles), kind="stable"):
        if poles[i].imag < 0.0:
            continue
        frequency = float(np.abs(poles[i]))
        shape = vectors[positions, i]
        largest = shape[np.argmax(np.abs(shape))]
        has_motion = np.abs(largest) > 1e-12 * np.abs(vectors[:, i]).max()
        shape = shape / largest if has_motion else np.zeros(legs, dtype=complex)
        damping = float(-poles[i].real / frequency) if frequency > _INTEGRATOR else float("nan")
        participation = dict.fromkeys(_STATE_KINDS, 0.0)
        for kind, factor in zip(kinds, factors[:, i].tolist(), strict=True):
            participation[kind] += factor
        shares = np.full(6, np.nan)
        if jacobian is not None and has_motion:
            motion_by_dof = jacobian * np.linalg.solve(jacobian, shape)
            shares = np.real(np.conj(shape) @ motion_by_dof) / float(np.sum(np.abs(shape) ** 2))
        result.append(Mode(complex(poles[i]), frequency, damping, participation, shape, shares))
    return tuple(result)


def _state_kind(label: str) -> str:
    """The kind of a state of a linearised plant, by the beginning of its name."""
    for kind, beginnings in _STATE_KINDS.items():
        if label.startswith(beginnings):
            return kind
    names = ", ".join(name for beginnings in _STATE_KINDS.values() for name in beginnings)
    allowed = f"those that begin with {names}"
    raise InputError(f"system: state {label!r} is no plant's; allowed: {allowed}")
