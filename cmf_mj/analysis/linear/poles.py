"""Modes of a linearised plant: poles, damping, and what takes part in them.

With right and left eigenvectors R and L = R^-1 the share of state k in mode i is the participation
factor |R_ki L_ik|, scaled to a sum of 1. The leg motion of a mode is the part of R at the
extensions; a degree of freedom's share in it is

    Re(phi* J_j x_j) / |phi|^2,    phi = J x

so that all six add to 1; one may be negative where two degrees of freedom work against each other.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from cmf_mj.analysis.linear.law import labels
from cmf_mj.analysis.linear.reduction import jacobian_of
from cmf_mj.core.errors import InputError
from cmf_mj.plant.plant import Plant

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
        result.append(
            Mode(
                complex(poles[i]),
                size,
                float(-poles[i].real / size) if size > _STILL else float("nan"),
                {name: float(sum(f for f, kind in parts if kind == name)) for name in _FAMILIES},
                shape,
                _dof_shares(shape, jacobian),
            )
        )
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
