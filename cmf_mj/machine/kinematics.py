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

from cmf_mj.core.arrays import shaped
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError, NoPoseError
from cmf_mj.machine import models
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.machine import Machine, geometry_of, load_machine

MachineOrGimbals = str | Path | Machine | Geometry

_NEWTON_ITERATIONS = 50
_NEWTON_TOLERANCE = 1e-13
_SMALL_CHANGE = 0.02  #: Leg change [m] up to which the pose of the row before is a safe start.


def geometry_about(point: ArrayLike, machine: MachineOrGimbals = models.CMF) -> Geometry:
    """The geometry for poses that count at a point of the platform instead of its centroid.

    With r from the centroid to the static centre of mass (r_cg of Eq 2.1) and c its movement from
    neutral (c_cg), Eq 2.1 turned to inertial axes reads

        l_j = c + T (A_j - r) - (B_j - r)

    so gimbals that count from the point r, in platform axes, z down [m], (3,), give legs, poses,
    Jacobians and demand as those from the centroid do. The centroid is at c + r - T r.

    >>> tilt = [0, 0, 0, 0, 0.1, 0]  # the head of a pilot 2 m above stays where it is
    >>> legs = cmf_mj.pose_to_legs(tilt, geometry_about([0, 0, -2]))
    >>> cmf_mj.legs_to_pose(legs).round(3)[0].item()
    0.2
    """
    offset, gimbals = shaped("point", point, 3), geometry_of(machine)
    return Geometry(gimbals.upper - offset, gimbals.lower - offset, gimbals.neutral)


@compiled
def rotation_entries(roll, pitch, yaw):  # type: ignore[no-untyped-def]
    """Nine entries of T, Eq 2.2, by rows: platform to inertial axes, turned by yaw, pitch, roll."""
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    forward = cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy
    right = cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy
    return *forward, *right, -sp, sr * cp, cr * cp


@compiled
def rotated_arm(entries, arm):  # type: ignore[no-untyped-def]
    """T, by its nine entries, times an arm (3,): three numbers."""
    x, y, z = arm[0], arm[1], arm[2]
    return (
        entries[0] * x + entries[1] * y + entries[2] * z,
        entries[3] * x + entries[4] * y + entries[5] * z,
        entries[6] * x + entries[7] * y + entries[8] * z,
    )


@compiled
def write_rotation(roll, pitch, yaw, matrix):  # type: ignore[no-untyped-def]
    """Write T of Eq 2.2, (3, 3)."""
    entries = rotation_entries(roll, pitch, yaw)
    for i in range(9):
        matrix[i // 3, i % 3] = entries[i]


@allocating
def rotation(roll, pitch, yaw):  # type: ignore[no-untyped-def]
    """T of Eq 2.2, (3, 3), as a new array."""
    matrix = np.empty((3, 3))
    write_rotation(roll, pitch, yaw, matrix)
    return matrix


@allocating
def euler_rate_matrix(pitch, yaw):  # type: ignore[no-untyped-def]
    """E, (3, 3): inertial angular velocity = E (roll rate, pitch rate, yaw rate)."""
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array([[cp * cy, -sy, 0.0], [cp * sy, cy, 0.0], [-sp, 0.0, 1.0]])


@compiled
def _leg(geometry, pose, entries, j):  # type: ignore[no-untyped-def]
    """Arm of a leg's upper gimbal, and the leg from lower to upper gimbal, inertial axes."""
    a, b, c = rotated_arm(entries, geometry.upper[j])
    x = pose[0] + a - geometry.lower[j, 0]
    y = pose[1] + b - geometry.lower[j, 1]
    z = pose[2] + c - geometry.lower[j, 2]
    return (a, b, c), (x, y, z)


@compiled
def write_legs(geometry, pose, legs):  # type: ignore[no-untyped-def]
    """Write the extensions of a pose, (6,)."""
    entries = rotation_entries(pose[3], pose[4], pose[5])
    for j in range(6):
        _, (x, y, z) = _leg(geometry, pose, entries, j)
        legs[j] = np.sqrt(x * x + y * y + z * z) - geometry.neutral[j]


@compiled
def write_twist_jacobian(geometry, pose, jacobian):  # type: ignore[no-untyped-def]
    """Write leg speeds of the twist, velocity and inertial angular velocity, (6, 6)."""
    entries = rotation_entries(pose[3], pose[4], pose[5])
    for j in range(6):
        (a, b, c), (x, y, z) = _leg(geometry, pose, entries, j)
        length = np.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        jacobian[j, 0], jacobian[j, 1], jacobian[j, 2] = x, y, z
        jacobian[j, 3], jacobian[j, 4], jacobian[j, 5] = b * z - c * y, c * x - a * z, a * y - b * x


@compiled
def write_pose_jacobian(geometry, pose, jacobian):  # type: ignore[no-untyped-def]
    """Write d(legs)/d(pose), (6, 6)."""
    write_twist_jacobian(geometry, pose, jacobian)
    cp, sp = np.cos(pose[4]), np.sin(pose[4])
    cy, sy = np.cos(pose[5]), np.sin(pose[5])
    for j in range(6):
        x, y, z = jacobian[j, 3], jacobian[j, 4], jacobian[j, 5]
        jacobian[j, 3], jacobian[j, 4] = cp * cy * x + cp * sy * y - sp * z, cy * y - sy * x


@allocating
def _legs_history(geometry, poses, legs):  # type: ignore[no-untyped-def]
    for row in range(poses.shape[0]):
        write_legs(geometry, poses[row], legs[row])


@compiled
def solve(matrix, vector):  # type: ignore[no-untyped-def]
    """Put x of `matrix` x = `vector` into the vector, by elimination; returns the determinant.

    The matrix is overwritten; where it is singular the vector is left half-way.
    """
    count, determinant = vector.shape[0], 1.0
    for k in range(count):
        pivot = k
        for i in range(k + 1, count):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            determinant = -determinant
            vector[k], vector[pivot] = vector[pivot], vector[k]
            for j in range(k, count):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        determinant *= matrix[k, k]
        if matrix[k, k] == 0.0:
            return 0.0
        for i in range(k + 1, count):
            share = matrix[i, k] / matrix[k, k]
            vector[i] -= share * vector[k]
            for j in range(k + 1, count):
                matrix[i, j] -= share * matrix[k, j]
    for k in range(count - 1, -1, -1):
        for j in range(k + 1, count):
            vector[k] -= matrix[k, j] * vector[j]
        vector[k] /= matrix[k, k]
    return determinant


@compiled
def _all_below(values, bound):  # type: ignore[no-untyped-def]
    """Whether all values are smaller than the bound; NaN is not."""
    for value in values:
        if not abs(value) < bound:
            return False
    return True


@compiled
def _newton(geometry, sense, legs, pose, error, change, jacobian):  # type: ignore[no-untyped-def]
    """Newton iteration from `pose`, in place; whether it ended on the assembly of the pose zero.

    Singular poses separate the assemblies, so each has one sign of the determinant: `sense` is the
    determinant at the pose zero. `error`, `change`, (6,), and `jacobian`, (6, 6), are work space.
    """
    for _ in range(_NEWTON_ITERATIONS):
        write_legs(geometry, pose, error)
        for j in range(6):
            error[j] = legs[j] - error[j]
            change[j] = error[j]
        if _all_below(error, _NEWTON_TOLERANCE):
            break
        write_pose_jacobian(geometry, pose, jacobian)
        if abs(solve(jacobian, change)) < 1e-9 * abs(sense):
            return False
        for j in range(6):
            pose[j] += change[j]
    # Round-off can hold the error a little above the tolerance, never above the accuracy promised.
    write_pose_jacobian(geometry, pose, jacobian)
    is_upright = _all_below(pose[3:], 0.5 * np.pi)
    return is_upright and _all_below(error, 1e-11) and solve(jacobian, change) * sense > 0.0


@allocating
def _pose_history(geometry, legs, poses):  # type: ignore[no-untyped-def]
    """Solve row by row; returns the first row that fails, or -1.

    A row close to the one before starts from its solution, any other from the pose zero.
    """
    error, change, jacobian = np.zeros(6), np.zeros(6), np.empty((6, 6))
    write_pose_jacobian(geometry, error, jacobian)
    sense = solve(jacobian, change)
    for row in range(legs.shape[0]):
        if row > 0:
            for j in range(6):
                error[j] = legs[row, j] - legs[row - 1, j]
                poses[row, j] = poses[row - 1, j]
            if _all_below(error, _SMALL_CHANGE) and _newton(
                geometry, sense, legs[row], poses[row], error, change, jacobian
            ):
                continue
        poses[row] = 0.0
        if not _newton(geometry, sense, legs[row], poses[row], error, change, jacobian):
            return row
    return -1


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
    poses = shaped("pose", pose, 6, leading=True)
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
        NoPoseError: no pose has these legs, named by their row, or a leg is beyond what a cylinder
            of one stage can do, a third of its neutral length either way.

    >>> legs = cmf_mj.pose_to_legs([0, 0, -0.1, 0, 0, 0])
    >>> cmf_mj.legs_to_pose(legs).round(6)[2].item()
    -0.1
    """
    extensions, gimbals = shaped("legs", legs, 6, leading=True), geometry_of(machine)
    poses = np.empty(extensions.shape)
    rows = extensions.reshape(-1, 6)
    too_long = np.argwhere(np.abs(rows) > gimbals.neutral / 3.0)
    if too_long.size:
        failed_row = too_long[0, 0]
        longest = gimbals.neutral.min() / 3.0
        allowed = f"; allowed: within +-{longest:.4g} m, a third of the neutral length"
    else:
        failed_row, allowed = _pose_history(gimbals, rows, poses.reshape(-1, 6)), ""
    if failed_row >= 0:
        index = [int(i) for i in np.unravel_index(failed_row, extensions.shape[:-1])]
        raise NoPoseError(
            f"legs{index or ''}: no platform pose has the leg extensions "
            f"{np.array2string(rows[failed_row], precision=4)} m{allowed}"
        )
    return poses


def leg_jacobian(pose: ArrayLike, machine: MachineOrGimbals = models.CMF) -> NDArray[np.float64]:
    """J of l_dot = J (v, w), (6, 6): centroid velocity and angular velocity in inertial axes.

    Row j is (n_j, T A_j x n_j) with n_j the unit vector along leg j; its last three columns are
    in m. J^-T M J^-1 turns a mass matrix of the platform into the reflected mass of the legs.
    """
    jacobian = np.empty((6, 6))
    write_twist_jacobian(geometry_of(machine), shaped("pose", pose, 6), jacobian)
    return jacobian


def pose_jacobian(pose: ArrayLike, machine: MachineOrGimbals = models.CMF) -> NDArray[np.float64]:
    """d(legs)/d(pose), (6, 6): as `leg_jacobian`, but for the rates of the Euler angles."""
    jacobian = np.empty((6, 6))
    write_pose_jacobian(geometry_of(machine), shaped("pose", pose, 6), jacobian)
    return jacobian


def excursion_envelope(
    travel: float | None = None, machine: MachineOrGimbals = models.CMF
) -> NDArray[np.float64]:
    """Single-axis excursions at which the first leg reaches its travel [m] from neutral, (6, 2).

    The negative and the positive limit [m, rad]; a rotation ends at 90 deg at the latest. Default
    travel is the working stroke.
    """
    if travel is None:
        if isinstance(machine, Geometry):
            raise InputError("travel: is missing; gimbals alone have none")
        travel = load_machine(machine).working_stroke
    if not travel > 0.0:
        raise InputError(f"travel: {travel} m must be greater than 0")
    gimbals = geometry_of(machine)

    def reserve(excursion: float, dof: int) -> float:
        pose = np.zeros(6)
        pose[dof] = excursion
        return travel - float(np.abs(pose_to_legs(pose, gimbals)).max())

    def limit(dof: int, step: float) -> float:
        """The excursion without reserve, searched from 0 in steps."""
        inner, outer = 0.0, step
        while reserve(outer, dof) > 0.0 and (dof < 3 or abs(outer) < 0.5 * np.pi):
            inner, outer = outer, outer + step
        if reserve(outer, dof) > 0.0:
            return float(np.copysign(0.5 * np.pi, step))
        return float(brentq(reserve, inner, outer, args=(dof,), xtol=1e-12))

    return np.array([[limit(dof, -0.01), limit(dof, 0.01)] for dof in range(6)])
