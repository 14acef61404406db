"""Motion and gravity along the legs, and the pose of legs in motion.

Velocities and accelerations between platform and legs are exact with the Jacobian's change,

    dl/dt = J dx/dt,    d2l/dt2 = J d2x/dt2 + c(x, dx/dt)

with x the pose, J of `kinematics.pose_jacobian`, and c the centripetal and Euler terms.

**Gravity** (Appendix C). With l_j the vector of leg j from lower to upper gimbal (Eq C.6, T of
Eq C.7), L its length and n = l / L, in the report's axes (z down), up = -z:

    axial gravity     g_j = g n_j . up,    0.832 g at neutral

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
def _leg_motion(geometry, pose, pose_rate, velocity_part, leg_rates):  # type: ignore[no-untyped-def]
    """Write leg rates and the part of leg accelerations that velocity makes, c of the module.

    With w_j = v + omega x r_j the velocity of upper gimbal j, n_j along the leg, L_j its length,
    d2l/dt2 = n . (dv/dt + domega/dt x r + omega x (omega x r)) + (|w|^2 - (dl/dt)^2) / L.
    """
    arm = geometry.upper @ rotation(pose[3], pose[4], pose[5]).T
    cp, sp = np.cos(pose[4]), np.sin(pose[4])
    cy, sy = np.cos(pose[5]), np.sin(pose[5])
    omega = euler_rate_matrix(pose[4], pose[5]) @ pose_rate[3:]
    roll_rate, pitch_rate, yaw_rate = pose_rate[3], pose_rate[4], pose_rate[5]
    euler_term = np.array(
        [
            (-sp * cy * pitch_rate - cp * sy * yaw_rate) * roll_rate - cy * yaw_rate * pitch_rate,
            (-sp * sy * pitch_rate + cp * cy * yaw_rate) * roll_rate - sy * yaw_rate * pitch_rate,
            -cp * pitch_rate * roll_rate,
        ]
    )
    for j in range(6):
        line = pose[:3] + arm[j] - geometry.lower[j]
        length = np.sqrt(line @ line)
        line /= length
        relative_velocity = np.cross(omega, arm[j])
        gimbal_velocity = pose_rate[:3] + relative_velocity
        leg_rates[j] = line @ gimbal_velocity
        gimbal_acceleration = np.cross(euler_term, arm[j]) + np.cross(omega, relative_velocity)
        across_squared = gimbal_velocity @ gimbal_velocity - leg_rates[j] ** 2
        velocity_part[j] = line @ gimbal_acceleration + across_squared / length


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
    velocity_part = np.empty(6)
    computed_leg_rates = np.empty(6)  # once more the rates that are known
    for row in range(poses.shape[0]):
        write_pose_jacobian(geometry, poses[row], jacobian)
        rates[row] = np.linalg.solve(jacobian, leg_rates[row])
        _leg_motion(geometry, poses[row], rates[row], velocity_part, computed_leg_rates)
        accelerations[row] = np.linalg.solve(jacobian, leg_accelerations[row] - velocity_part)


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


class PoseTracker(NamedTuple):
    """Parameters with which compiled code follows a pose from leg extensions."""

    geometry: Geometry
    inverse: NDArray[np.float64]  #: J0^-1, (6, 6): pose change per leg change.


class TrackedPose(NamedTuple):
    """A pose as tracked, and where its legs lie."""

    pose: NDArray[np.float64]  #: (6,) [m, rad].
    rotation_matrix: NDArray[np.float64]  #: T at the pose, (3, 3).
    length: NDArray[np.float64]  #: Pin-to-pin lengths [m], (6,).
    direction: NDArray[np.float64]  #: n, (6, 3), report tracker.


def make_pose_tracker(machine: MachineOrGimbals = models.CMF) -> PoseTracker:
    """The tracker of a machine's pose."""
    gimbals = geometry_of(machine)
    jacobian = kinematics.pose_jacobian(np.zeros(6), gimbals)
    return PoseTracker(gimbals, np.array(np.linalg.inv(jacobian), dtype=np.float64))


def tracked_pose(tracker: PoseTracker, legs: NDArray[np.float64]) -> TrackedPose:
    """The tracked pose that has the leg extensions (6,) [m], to start from."""
    pose = kinematics.legs_to_pose(legs, tracker.geometry)
    tracked = TrackedPose(pose, np.empty((3, 3)), np.empty(6), np.empty((6, 3)))
    _write_legs_of_pose(tracker, tracked)
    return tracked


@compiled
def _write_legs_of_pose(tracker, tracked):  # type: ignore[no-untyped-def]
    """Write rotation, lengths and directions of all legs at the tracked pose, Eq C.6."""
    pose, rotation_matrix = tracked.pose, tracked.rotation_matrix
    kinematics.write_rotation(pose[3], pose[4], pose[5], rotation_matrix)
    for j in range(6):
        squared_length = 0.0
        for i in range(3):
            component = pose[i] - tracker.geometry.lower[j, i]
            for k in range(3):
                component += rotation_matrix[i, k] * tracker.geometry.upper[j, k]
            tracked.direction[j, i] = component
            squared_length += component * component
        tracked.length[j] = np.sqrt(squared_length)
        for i in range(3):
            tracked.direction[j, i] /= tracked.length[j]


@compiled
def track(tracker, tracked, legs):  # type: ignore[no-untyped-def]
    """Follow the leg extensions (6,) [m] by one chord step; `tracked` is overwritten.

    A pose that has run away, for legs that no pose has, starts again from neutral.
    """
    for j in range(6):
        error = legs[j] + tracker.geometry.neutral[j] - tracked.length[j]
        for i in range(6):
            tracked.pose[i] += tracker.inverse[i, j] * error
    is_sound = True
    for i in range(6):  # metres and radians; written so that NaN is unsound
        is_sound = is_sound and abs(tracked.pose[i]) < 0.5 * np.pi
    if not is_sound:
        tracked.pose[:] = 0.0
    _write_legs_of_pose(tracker, tracked)


@compiled
def cosine_to_vertical(tracked, leg):  # type: ignore[no-untyped-def]
    """Cosine between a leg and the vertical, n . up."""
    return -tracked.direction[leg, 2]
