"""Velocities and accelerations between platform and legs, exact with the Jacobian's change.

    dl/dt = J dx/dt,    d2l/dt2 = J d2x/dt2 + c(x, dx/dt)

with x the pose, J of `kinematics.pose_jacobian`, and c the centripetal and Euler terms.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.compiled import allocating
from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.machine.kinematics import (
    MachineOrGimbals,
    euler_rate_matrix,
    rotation,
    rows_of,
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
    again = np.empty(6)
    for row in range(poses.shape[0]):
        write_pose_jacobian(geometry, poses[row], jacobian)
        rates[row] = np.linalg.solve(jacobian, leg_rates[row])
        _leg_motion(geometry, poses[row], rates[row], turning, again)
        accelerations[row] = np.linalg.solve(jacobian, leg_accelerations[row] - turning)


class Motion(NamedTuple):
    """First and second time derivatives, of poses or of legs."""

    velocity: NDArray[np.float64]  #: (..., 6): m/s, and rad/s of the Euler angles.
    acceleration: NDArray[np.float64]  #: (..., 6): m/s^2, and rad/s^2 of the Euler angles.


def _converted(kernel: Any, machine: MachineOrGimbals, **arrays: ArrayLike) -> Motion:
    """What a kernel makes of a pose and two derivatives, all of the pose's shape."""
    rows = {name: rows_of(name, values) for name, values in arrays.items()}
    for name, values in rows.items():
        if values.shape != rows["pose"].shape:
            raise InputError(f"{name}: shape is {values.shape}; pose has {rows['pose'].shape}")
    motion = Motion(np.empty(rows["pose"].shape), np.empty(rows["pose"].shape))
    kernel(geometry_of(machine), *(a.reshape(-1, 6) for a in (*rows.values(), *motion)))
    return motion


def pose_motion_to_legs(
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    machine: MachineOrGimbals = models.CMF,
) -> Motion:
    """Leg velocities and accelerations of poses (..., 6) and their derivatives, exact.

    Poses are in m and rad, z down.
    """
    return _converted(
        _motion_to_legs, machine, pose=pose, velocity=velocity, acceleration=acceleration
    )


def leg_motion_to_pose(
    pose: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    machine: MachineOrGimbals = models.CMF,
) -> Motion:
    """Platform motion of leg velocities and accelerations (..., 6) at known poses (..., 6)."""
    return _converted(
        _legs_to_motion, machine, pose=pose, velocity=velocity, acceleration=acceleration
    )
