"""Motion and gravity along the legs, and the pose of legs in motion.

Velocities and accelerations between platform and legs are exact with the Jacobian's change,

    dl/dt = J dx/dt,    d2l/dt2 = J d2x/dt2 + c(x, dx/dt)

with x the pose, J of `kinematics.pose_jacobian`, and c the centripetal and Euler terms.

**Gravity** (Appendix C). With l_j the vector of leg j from lower to upper gimbal (Eq C.6, T of
Eq C.7), L its length and n = l / L, in the report's axes (z down), up = -z:

    axial gravity     g_j = g n_j . up                           0.832 g at neutral
    Eq C.3            |(I - r/L P) g|,  P = I - n n'  (Eq C.1)   g_j for r = L, g for r = 0

`track` follows the pose from leg extensions, one chord step of Newton's method a frame, pose +=
J0^-1 (legs - legs(pose)) with J0 the Jacobian at neutral. Each step shrinks the error to at most
0.36 of it within the working strokes, so the pose lags the legs by half a frame at most.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.arrays import shaped
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.machine import kinematics, models
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.kinematics import (
    MachineOrGimbals,
    euler_rate_matrix,
    rotation,
    write_pose_jacobian,
)
from cmf_mj.machine.machine import geometry_of


@allocating
def _leg_motion(geometry, pose, rate, turning, legs):  # type: ignore[no-untyped-def]
    """Leg velocities and the velocity part of leg accelerations (centripetal and Euler terms).

    With w_j = v + omega x r_j the velocity of upper gimbal j, n_j along the leg, L_j its length,
    d2l/dt2 = n . (dv/dt + domega/dt x r + omega x (omega x r)) + (|w|^2 - (dl/dt)^2) / L.
    """
    arm = geometry.upper @ rotation(pose[3], pose[4], pose[5]).T
    ct, st = np.cos(pose[4]), np.sin(pose[4])
    cp, sp = np.cos(pose[5]), np.sin(pose[5])
    omega = euler_rate_matrix(pose[4], pose[5]) @ rate[3:]
    roll, pitch, yaw = rate[3], rate[4], rate[5]
    euler = np.array(
        [
            (-st * cp * pitch - ct * sp * yaw) * roll - cp * yaw * pitch,
            (-st * sp * pitch + ct * cp * yaw) * roll - sp * yaw * pitch,
            -ct * pitch * roll,
        ]
    )
    for j in range(6):
        line = pose[:3] + arm[j] - geometry.lower[j]
        length = np.sqrt(line @ line)
        line /= length
        swing = np.cross(omega, arm[j])
        gimbal = rate[:3] + swing
        legs[j] = line @ gimbal
        inward = np.cross(euler, arm[j]) + np.cross(omega, swing)
        turning[j] = line @ inward + (gimbal @ gimbal - legs[j] ** 2) / length


@allocating
def _motion_to_legs(geometry, poses, rates, accelerations, leg_rates, leg_accelerations):  # type: ignore[no-untyped-def]
    jacobian = np.empty((6, 6))
    for row in range(poses.shape[0]):
        _leg_motion(geometry, poses[row], rates[row], leg_accelerations[row], leg_rates[row])
        write_pose_jacobian(geometry, poses[row], jacobian)
        leg_accelerations[row] += jacobian @ accelerations[row]


@allocating
def _legs_to_motion(geometry, poses, leg_rates, leg_accelerations, rates, accelerations):  # type: ignore[no-untyped-def]
    jacobian = np.empty((6, 6))
    turning = np.empty(6)
    computed_leg_rates = np.empty(6)  # once more the rates that are known
    for row in range(poses.shape[0]):
        write_pose_jacobian(geometry, poses[row], jacobian)
        rates[row] = np.linalg.solve(jacobian, leg_rates[row])
        _leg_motion(geometry, poses[row], rates[row], turning, computed_leg_rates)
        accelerations[row] = np.linalg.solve(jacobian, leg_accelerations[row] - turning)


class Motion(NamedTuple):
    """First and second time derivatives, of poses or of legs."""

    velocity: NDArray[np.float64]  #: (..., 6): m/s, and rad/s of the Euler angles.
    acceleration: NDArray[np.float64]  #: (..., 6): m/s^2, and rad/s^2 of the Euler angles.


def _convert(kernel: Any, machine: MachineOrGimbals, known: dict[str, ArrayLike]) -> Motion:
    """Motion that a kernel makes of a pose and two derivatives, all of the pose's shape."""
    inputs = {name: shaped(name, values, 6, leading=True) for name, values in known.items()}
    shape = inputs["pose"].shape
    for name, values in inputs.items():
        if values.shape != shape:
            raise InputError(f"{name}: shape is {values.shape}; pose has {shape}")
    motion = Motion(np.empty(shape), np.empty(shape))
    rows = (array.reshape(-1, 6) for array in (*inputs.values(), *motion))
    kernel(geometry_of(machine), *rows)
    return motion


def pose_motion_to_legs(
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    machine: MachineOrGimbals = models.CMF,
) -> Motion:
    """Leg velocities and accelerations of poses (..., 6) and their derivatives, exact."""
    known = {"pose": pose, "velocity": velocity, "acceleration": acceleration}
    return _convert(_motion_to_legs, machine, known)


def leg_motion_to_pose(
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    machine: MachineOrGimbals = models.CMF,
) -> Motion:
    """Platform motion of leg velocities and accelerations (..., 6) at known poses (..., 6)."""
    known = {"pose": pose, "velocity": velocity, "acceleration": acceleration}
    return _convert(_legs_to_motion, machine, known)


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
    gimbals = geometry_of(machine)
    jacobian = kinematics.pose_jacobian(np.zeros(6), gimbals)
    return LegAxes(gimbals, np.array(np.linalg.inv(jacobian), dtype=np.float64))


def leg_axes_state(axes: LegAxes, legs: NDArray[np.float64]) -> LegAxesState:
    """State at the pose of the leg extensions (6,) [m]."""
    pose = kinematics.legs_to_pose(legs, axes.geometry)
    state = LegAxesState(pose, np.empty((3, 3)), np.empty(6), np.empty((6, 3)))
    _update_legs(axes, state)
    return state


@compiled
def _update_legs(axes, state):  # type: ignore[no-untyped-def]
    """Lengths and directions of all legs at the pose of the state, Eq C.6."""
    pose, turn = state.pose, state.turn
    kinematics.rotate(pose[3], pose[4], pose[5], turn)
    for j in range(6):
        square = 0.0
        for i in range(3):
            component = pose[i] - axes.geometry.lower[j, i]
            for k in range(3):
                component += turn[i, k] * axes.geometry.upper[j, k]
            state.direction[j, i] = component
            square += component * component
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
    is_sound = True
    for i in range(6):  # metres and radians; written so that NaN is unsound
        is_sound = is_sound and abs(state.pose[i]) < 0.5 * np.pi
    if not is_sound:
        state.pose[:] = 0.0
    _update_legs(axes, state)


@compiled
def upward(state, leg):  # type: ignore[no-untyped-def]
    """Cosine between a leg and the vertical, n . up."""
    return -state.direction[leg, 2]
