"""Gravity along the legs (Appendix C), and the pose of legs in motion.

With l_j the vector of leg j from lower to upper gimbal (Eq C.6, T of Eq C.7), L its length and
n = l / L, in the report's axes (z down), up = -z:

    axial gravity     g_j = g n_j . up                           0.832 g at neutral
    Eq C.3            |(I - r/L P) g|,  P = I - n n'  (Eq C.1)   g_j for r = L, g for r = 0

`track` follows the pose from leg extensions, one chord step of Newton's method a frame,

    pose += J0^-1 (legs - legs(pose)),   J0 the Jacobian at neutral.

Each step shrinks the error to at most 0.36 of it within the working strokes, so the pose lags the
legs by half a frame at most.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.compiled import allocating, assign, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine import kinematics, models
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.kinematics import MachineOrGimbals
from cmf_mj.machine.machine import geometry_of


class LegAxes(NamedTuple):
    """Compiled parameters of the tracker."""

    geometry: Geometry
    inverse: NDArray[np.float64]  #: J0^-1, (6, 6): pose change per leg change.


class LegAxesState(NamedTuple):
    """Pose and legs as tracked."""

    pose: NDArray[np.float64]  #: (6,) [m, rad].
    turn: NDArray[np.float64]  #: T at the pose, (3, 3).
    length: NDArray[np.float64]  #: Pin-to-pin lengths [m], (6,).
    direction: NDArray[np.float64]  #: n, (6, 3), report axes.


def make_leg_axes(machine: MachineOrGimbals = models.CMF) -> LegAxes:
    """Parameters of the tracker."""
    shape = geometry_of(machine)
    jacobian = kinematics.pose_jacobian(np.zeros(6), shape)
    return LegAxes(shape, np.array(np.linalg.inv(jacobian), dtype=np.float64))


def leg_axes_state(axes: LegAxes, legs: NDArray[np.float64]) -> LegAxesState:
    """State at the pose of the leg extensions (6,) [m]."""
    pose = kinematics.legs_to_pose(legs, axes.geometry)
    state = LegAxesState(pose, np.empty((3, 3)), np.empty(6), np.empty((6, 3)))
    _evaluate(axes, state)
    return state


@compiled
def _evaluate(axes, state):  # type: ignore[no-untyped-def]
    """Lengths and directions of all legs at the pose of the state, Eq C.6."""
    pose, turn = state.pose, state.turn
    kinematics.rotate(pose[3], pose[4], pose[5], turn)
    for j in range(6):
        square = 0.0
        for i in range(3):
            along = pose[i] - axes.geometry.lower[j, i]
            for k in range(3):
                along += turn[i, k] * axes.geometry.upper[j, k]
            state.direction[j, i] = along
            square += along * along
        state.length[j] = np.sqrt(square)
        for i in range(3):
            state.direction[j, i] /= state.length[j]


@compiled
def track(axes, state, legs):  # type: ignore[no-untyped-def]
    """Follow the leg extensions (6,) [m] by one chord step; the state is overwritten.

    A pose that has run away, for legs that no pose has, starts again from neutral.
    """
    for j in range(6):
        error = legs[j] + axes.geometry.neutral[j] - state.length[j]
        for i in range(6):
            state.pose[i] += axes.inverse[i, j] * error
    sound = True
    for i in range(6):  # metres and radians; written so that NaN is unsound
        sound = sound and abs(state.pose[i]) < 0.5 * np.pi
    if not sound:
        state.pose[:] = 0.0
    _evaluate(axes, state)


@compiled
def upward(state, leg):  # type: ignore[no-untyped-def]
    """Cosine between a leg and the vertical, n . up."""
    return -state.direction[leg, 2]


@allocating
def _directions(axes, state, poses, lengths, directions):  # type: ignore[no-untyped-def]
    for row in range(poses.shape[0]):
        assign(state.pose, poses[row])
        _evaluate(axes, state)
        lengths[row] = state.length
        directions[row] = state.direction


def leg_directions(
    pose: ArrayLike, machine: MachineOrGimbals = models.CMF
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lengths (..., 6) [m] and unit vectors (..., 6, 3) of the legs at poses (..., 6), Eq C.6."""
    poses = np.asarray(pose, dtype=float)
    if poses.ndim == 0 or poses.shape[-1] != 6:
        raise InputError(f"pose: shape is {poses.shape}; the last axis must have length 6")
    axes = make_leg_axes(machine)
    lengths, directions = np.empty(poses.shape), np.empty((*poses.shape, 3))
    state = leg_axes_state(axes, np.zeros(6))
    flat = np.ascontiguousarray(poses.reshape(-1, 6))
    _directions(axes, state, flat, lengths.reshape(-1, 6), directions.reshape(-1, 6, 3))
    return lengths, directions


def axial_gravity(pose: ArrayLike, machine: MachineOrGimbals = models.CMF) -> NDArray[np.float64]:
    """What accelerometers along the legs read at rest, g n . up [m/s^2], (..., 6)."""
    return -STANDARD_GRAVITY * leg_directions(pose, machine)[1][..., 2]


def projected_gravity(
    pose: ArrayLike, distance: float, machine: MachineOrGimbals = models.CMF
) -> NDArray[np.float64]:
    """Magnitude of Eq C.3, |(I - r/L P) g| [m/s^2], (..., 6).

    The distance r [m] is from the upper gimbal to the centre of mass of the leg's moving part.
    """
    length, direction = leg_directions(pose, machine)
    gravity = np.array([0.0, 0.0, STANDARD_GRAVITY])
    along = (direction @ gravity)[..., None] * direction
    across = gravity - along
    return np.linalg.norm(along + (1.0 - distance / length)[..., None] * across, axis=-1)
