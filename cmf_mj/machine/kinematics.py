"""Pose to leg extensions and back, Jacobians and the excursion envelope.

With A_j the upper gimbals in platform axes and B_j the lower gimbals in inertial axes
(Appendix A of the report), the platform centroid at p and T of Eq 2.2,

    l_j = p + T(roll, pitch, yaw) A_j - B_j,    leg_j = |l_j| - |A_j - B_j|        (Eq C.6)

Axes are the report's everywhere here: x forward, y right, z **down**; a pose is
(surge, sway, heave, roll, pitch, yaw) in m and rad, a leg is its extension from neutral in m.
Functions take gimbals (a `Geometry`) or whose they are: a machine by name, its file, or loaded.
"""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.machine import Machine, geometry_of, load_machine

MachineOrGimbals = str | Path | Machine | Geometry

_NEWTON_ITERATIONS = 50
_NEWTON_TOLERANCE = 1e-13
_CLOSE = 0.02
"""Leg change from row to row [m] up to which the solution before is a safe start."""


def about(point: ArrayLike, machine: MachineOrGimbals = models.CMF) -> Geometry:
    """The geometry for poses that count at a point of the platform instead of its centroid.

    With r from the centroid to the static centre of mass (r_cg of Eq 2.1) and c its movement from
    neutral (c_cg), Eq 2.1 turned to inertial axes reads

        l_j = c + T (A_j - r) - (B_j - r)

    so gimbals that count from the point at neutral give all that centroid ones do: legs, poses,
    Jacobians, demand. The centroid is at c + r - T r.

    Args:
        point: r in platform axes, z down [m], (3,).
        machine: whose gimbals, from the centroid.

    >>> tilt = [0, 0, 0, 0, 0.1, 0]  # the head of a pilot 2 m above stays where it is
    >>> cmf_mj.legs_to_pose(cmf_mj.pose_to_legs(tilt, about([0, 0, -2]))).round(3)[0].item()
    0.2
    """
    offset, shape = np.array(point, dtype=float), geometry_of(machine)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise InputError(f"point: {offset.tolist()} must be three finite numbers")
    return Geometry(shape.upper - offset, shape.lower - offset, shape.neutral)


@compiled
def rotate(roll, pitch, yaw, turn):  # type: ignore[no-untyped-def]
    """Write T of Eq 2.2, (3, 3): platform axes to inertial axes, Euler order yaw, pitch, roll."""
    cf, sf = np.cos(roll), np.sin(roll)
    ct, st = np.cos(pitch), np.sin(pitch)
    cp, sp = np.cos(yaw), np.sin(yaw)
    turn[0, 0], turn[0, 1], turn[0, 2] = ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp
    turn[1, 0], turn[1, 1], turn[1, 2] = ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp
    turn[2, 0], turn[2, 1], turn[2, 2] = -st, sf * ct, cf * ct


@allocating
def rotation(roll, pitch, yaw):  # type: ignore[no-untyped-def]
    """T of Eq 2.2, (3, 3), as a new array."""
    turn = np.empty((3, 3))
    rotate(roll, pitch, yaw, turn)
    return turn


@allocating
def euler_rate_matrix(pitch, yaw):  # type: ignore[no-untyped-def]
    """E, (3, 3): inertial angular velocity = E (roll rate, pitch rate, yaw rate)."""
    ct, st = np.cos(pitch), np.sin(pitch)
    cp, sp = np.cos(yaw), np.sin(yaw)
    return np.array([[ct * cp, -sp, 0.0], [ct * sp, cp, 0.0], [-st, 0.0, 1.0]])


@compiled
def _legs(geometry, pose, turn, legs):  # type: ignore[no-untyped-def]
    """Write the extensions of a pose; its rotation goes through `turn`, (3, 3)."""
    rotate(pose[3], pose[4], pose[5], turn)
    for j in range(6):
        square = 0.0
        for i in range(3):
            upper = 0.0
            for k in range(3):
                upper += turn[i, k] * geometry.upper[j, k]
            square += (pose[i] + upper - geometry.lower[j, i]) ** 2
        legs[j] = np.sqrt(square) - geometry.neutral[j]


@allocating
def _twist_jacobian(geometry, pose, jacobian):  # type: ignore[no-untyped-def]
    arm = geometry.upper @ rotation(pose[3], pose[4], pose[5]).T
    for j in range(6):
        line = pose[:3] + arm[j] - geometry.lower[j]
        line /= np.sqrt(line @ line)
        jacobian[j, :3] = line
        jacobian[j, 3] = arm[j, 1] * line[2] - arm[j, 2] * line[1]
        jacobian[j, 4] = arm[j, 2] * line[0] - arm[j, 0] * line[2]
        jacobian[j, 5] = arm[j, 0] * line[1] - arm[j, 1] * line[0]


@allocating
def write_pose_jacobian(geometry, pose, jacobian):  # type: ignore[no-untyped-def]
    """Write d(legs)/d(pose), (6, 6)."""
    _twist_jacobian(geometry, pose, jacobian)
    jacobian[:, 3:] = np.ascontiguousarray(jacobian[:, 3:]) @ euler_rate_matrix(pose[4], pose[5])


@allocating
def _legs_history(geometry, poses, legs):  # type: ignore[no-untyped-def]
    turn = np.empty((3, 3))
    for row in range(poses.shape[0]):
        _legs(geometry, poses[row], turn, legs[row])


@allocating
def _newton(geometry, legs, pose):  # type: ignore[no-untyped-def]
    """Newton iteration from `pose`, in place; whether it ended on the assembly of the pose zero.

    The assemblies are separated by singular poses, so the determinant's sign tells theirs.
    """
    tried, turn = np.empty(6), np.empty((3, 3))
    jacobian = np.empty((6, 6))
    write_pose_jacobian(geometry, np.zeros(6), jacobian)
    sense = np.linalg.det(jacobian)
    error = legs.copy()
    for _ in range(_NEWTON_ITERATIONS):
        _legs(geometry, pose, turn, tried)
        error[:] = legs - tried
        if np.max(np.abs(error)) < _NEWTON_TOLERANCE:
            break
        write_pose_jacobian(geometry, pose, jacobian)
        if abs(np.linalg.det(jacobian)) < 1e-9 * abs(sense):
            return False
        pose += np.linalg.solve(jacobian, error)
    # Round-off can hold the error a little above the tolerance, never above the accuracy promised.
    write_pose_jacobian(geometry, pose, jacobian)
    turned = np.max(np.abs(pose[3:])) < 0.5 * np.pi
    return turned and np.max(np.abs(error)) < 1e-11 and np.linalg.det(jacobian) * sense > 0.0


@allocating
def _pose_history(geometry, legs, poses):  # type: ignore[no-untyped-def]
    """Solve row by row; returns the first row that fails, or -1.

    A row close to the one before starts from its solution, any other from the pose zero.
    """
    for row in range(legs.shape[0]):
        if row > 0 and np.max(np.abs(legs[row] - legs[row - 1])) < _CLOSE:
            poses[row] = poses[row - 1]
            if _newton(geometry, legs[row], poses[row]):
                continue
        poses[row] = 0.0
        if not _newton(geometry, legs[row], poses[row]):
            return row
    return -1


def rows_of(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Copy of finite values whose last axis has length 6; refused under their name otherwise."""
    array = np.array(values, dtype=float, order="C")
    if array.ndim == 0 or array.shape[-1] != 6:
        raise InputError(f"{name}: shape is {array.shape}; the last axis must have length 6")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name}{list(where)}: {array[where]} is not a finite number")
    return array


def one_pose(values: ArrayLike) -> NDArray[np.float64]:
    """A single pose (6,), checked."""
    pose = rows_of("pose", values)
    if pose.ndim != 1:
        raise InputError(f"pose: shape is {pose.shape}; one pose of shape (6,) is needed")
    return pose


def pose_to_legs(pose: ArrayLike, machine: MachineOrGimbals = models.CMF) -> NDArray[np.float64]:
    """Leg extensions from neutral [m] of platform poses, Eq C.6.

    Args:
        pose: (..., 6): surge, sway, heave [m], roll, pitch, yaw [rad], z down.
        machine: machine or gimbals.

    Returns:
        (..., 6) extensions [m]; zero at the pose zero.

    >>> cmf_mj.pose_to_legs([0, 0, -0.1, 0, 0, 0]).round(3).tolist()
    [0.084, 0.084, 0.084, 0.084, 0.084, 0.084]
    """
    poses = rows_of("pose", pose)
    legs = np.empty(poses.shape)
    _legs_history(geometry_of(machine), poses.reshape(-1, 6), legs.reshape(-1, 6))
    return legs


def legs_to_pose(legs: ArrayLike, machine: MachineOrGimbals = models.CMF) -> NDArray[np.float64]:
    """Platform poses of leg extensions: Newton iteration on Eq C.6 with the exact Jacobian.

    Of the several assemblies a Stewart platform has, the solution is the one that holds the pose
    zero; its angles lie within +-90 deg.

    Args:
        legs: (..., 6) extensions from neutral [m].
        machine: machine or gimbals.

    Returns:
        (..., 6) poses: m and rad, z down. `pose_to_legs` gives the legs back within 1e-11 m.

    Raises:
        InputError: no pose has these legs; the message names the row and its legs.

    >>> legs = cmf_mj.pose_to_legs([0, 0, -0.1, 0, 0, 0])
    >>> cmf_mj.legs_to_pose(legs).round(6)[2].item()
    -0.1
    """
    rows = rows_of("legs", legs)
    poses = np.empty(rows.shape)
    flat = rows.reshape(-1, 6)
    failed = _pose_history(geometry_of(machine), flat, poses.reshape(-1, 6))
    if failed >= 0:
        where = [int(i) for i in np.unravel_index(failed, rows.shape[:-1])]
        raise InputError(
            f"legs{where or ''}: no platform pose has the leg extensions "
            f"{np.array2string(flat[failed], precision=4)} m"
        )
    return poses


def leg_jacobian(pose: ArrayLike, machine: MachineOrGimbals = models.CMF) -> NDArray[np.float64]:
    """J of l_dot = J (v, w), (6, 6): centroid velocity and angular velocity in inertial axes.

    Row j is (n_j, T A_j x n_j) with n_j the unit vector along leg j; its last three columns are
    in m. J^-T M J^-1 turns a mass matrix of the platform into the reflected mass of the legs.
    """
    jacobian = np.empty((6, 6))
    _twist_jacobian(geometry_of(machine), one_pose(pose), jacobian)
    return jacobian


def pose_jacobian(pose: ArrayLike, machine: MachineOrGimbals = models.CMF) -> NDArray[np.float64]:
    """d(legs)/d(pose), (6, 6): as `leg_jacobian`, but for the rates of the Euler angles."""
    jacobian = np.empty((6, 6))
    write_pose_jacobian(geometry_of(machine), one_pose(pose), jacobian)
    return jacobian


def excursion_envelope(
    travel: float | None = None, machine: MachineOrGimbals = models.CMF
) -> NDArray[np.float64]:
    """Single-axis excursions at which the first leg reaches its travel [m] from neutral, (6, 2).

    Per degree of freedom the negative and the positive limit, m and rad, z down; a rotation ends at
    90 deg at the latest. Default travel is the working stroke.
    """
    if travel is None:
        if isinstance(machine, Geometry):
            raise InputError("travel: is missing; gimbals alone have none")
        travel = load_machine(machine).working_stroke
    if not travel > 0.0:
        raise InputError(f"travel: {travel} m must be greater than 0")
    shape = geometry_of(machine)

    def reserve(excursion: float, dof: int) -> float:
        pose = np.zeros(6)
        pose[dof] = excursion
        return travel - float(np.abs(pose_to_legs(pose, shape)).max())

    limits = np.empty((6, 2))
    for dof in range(6):
        for side, sign in enumerate((-1.0, 1.0)):
            inner, outer = 0.0, sign * 0.01
            while reserve(outer, dof) > 0.0 and (dof < 3 or abs(outer) < 0.5 * np.pi):
                inner, outer = outer, outer + sign * 0.01
            if reserve(outer, dof) > 0.0:
                limits[dof, side] = sign * 0.5 * np.pi
                continue
            limits[dof, side] = brentq(reserve, inner, outer, args=(dof,), xtol=1e-12)
    return limits
