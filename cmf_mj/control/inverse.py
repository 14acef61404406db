"""From a planned motion to the command that makes it: the inverse of machine, oil and valves.

Legs l = V p of a platform with the reflected mass M_leg, on oil springs K, behind valves of speed k
with the drive lag a, the spool lag b and the leak rate lambda, ask for

    F = M_leg l'',    z = l' + K^-1 (F' + lambda F),    k u = (1 + d/dt / a) (1 + d/dt / b) z,

which takes five derivatives of l. M_leg = J^-T M J^-1, K and lambda follow the planned pose: J is
its own, tracked by one chord step a frame, M is V^-T diag(m) V^-1 at neutral, seen from the
platform. For legs alone, or modes of legs that carry no platform, M_leg is diag(m). At neutral and
for a mode of frequency w this is D p / k with

    D(s) = s (1 + s/a) (1 + s/b) (1 + lambda s/w^2 + s^2/w^2).

**Oil.** At the extension x, over half the stroke, the volumes at cap and rod are 1 + x and 1 - x of
those at neutral. With the share s of the cap's area in both areas K is k(x) = s / (1 + x) +
(1 - s) / (1 - x) times that at neutral. A compressing force F makes the pressure difference
F (A_c / V_c + A_r / V_r) / K, whose leak takes off the force by the same factor again:

    lambda(x) = lambda(0) / (k(x) (1 - x^2)^2).

**Load.** Ports that are matched pass g times as much with the load swing F that they open against,

    g = sqrt(1 - F sgn(z) / F_s),    F_s = (Ps - Pt) (A_cap + A_rod) / 2    (the `stall`)

so z / g is asked for z. Its kink at z = 0 is rounded over `SMALL_FLOW`, F is bent below
`NEAR_STALL`. A load X F_s sin turns the phase of a flow cos by 12 deg per X.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.coordinates import MODES, Modes, make_shape, mode_mass
from cmf_mj.core import units
from cmf_mj.core.compiled import assign, compiled, multiply, multiply_transposed
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.kinematics import (
    leg_jacobian,
    pose_jacobian,
    write_legs,
    write_rotation,
    write_twist_jacobian,
)
from cmf_mj.machine.machine import Machine

NEAR_STALL = 0.8  #: Share of the stall to which loads are bent for a valve's opening.

SMALL_FLOW = 2.0 * units.INCH  #: Flow about which a change of direction is rounded [m/s of a leg].


class Valves(NamedTuple):
    """Numbers of a leg's valves that the inverse needs, SI."""

    speed: float  #: k [m/s per full command].
    corners: tuple[float, float]  #: a and b [rad/s].
    leak_rate: float = 0.0  #: lambda [1/s].
    stall: float = np.inf  #: F_s [N].


class Inverse(NamedTuple):
    """Compiled parameters, SI, and workspace."""

    speed: float  #: k [m/s per full command].
    leak_rate: float  #: lambda [1/s].
    lag_sum: float  #: 1/a + 1/b [s].
    lag_product: float  #: 1/(a b) [s^2].
    stall: float  #: F_s [N].
    mass_per_spring: NDArray[np.float64]  #: Of each mode or leg, 1/w^2, (n,) [s^2].
    spring: float  #: Oil spring of a leg at neutral [N/m]; 1 where masses are not known.
    follows_pose: bool  #: Whether masses and springs follow the pose.
    geometry: Geometry
    half_stroke: float  #: [m].
    cap_share: float  #: Cap area over that of cap and rod side.
    chord: NDArray[np.float64]  #: Pose per leg motion at neutral, (6, 6).
    inertia: NDArray[np.float64]  #: Of the platform with its legs, platform axes, (6, 6).
    mean_motion: NDArray[np.float64]
    """Mean of the planned motion over the next frame, position to fifth derivative, (6, n)."""
    leg_motion: NDArray[np.float64]  #: The same of legs, (6, n).
    leg_force: NDArray[np.float64]  #: Planned force of legs and three derivatives, (4, n) [N, ..].
    scratch: NDArray[np.float64]  #: Workspace for one quantity of all coordinates, (n,).
    rotation: NDArray[np.float64]  #: Rotation of the platform, (3, 3).
    jacobian: NDArray[np.float64]  #: Legs of the twist in platform axes, (6, 6).
    inverse_jacobian: NDArray[np.float64]  #: Twist in platform axes of the legs, (6, 6).


def make_inverse(
    valves: Valves, omega: NDArray[np.float64], modes: Modes | None, machine: Machine
) -> Inverse:
    """Compile the inverse for legs of these frequencies [rad/s], (n,), or the modes of a cab."""
    legs, geometry, inertia, spring = omega.size, machine.geometry, np.zeros((MODES, MODES)), 1.0
    if modes is not None:
        mass = mode_mass(modes)
        mode_jacobian = make_shape(modes, legs) @ leg_jacobian(np.zeros(MODES), geometry)
        inertia = mode_jacobian.T @ np.diag(mass) @ mode_jacobian
        spring = float((mass * omega**2).mean())
    return Inverse(
        speed=valves.speed,
        leak_rate=valves.leak_rate,
        lag_sum=sum(1.0 / a for a in valves.corners),
        lag_product=1.0 / float(np.prod(valves.corners)),
        stall=valves.stall if modes is not None else np.inf,
        mass_per_spring=omega**-2.0,
        spring=spring,
        follows_pose=modes is not None and modes.follow_pose,
        geometry=geometry,
        half_stroke=machine.half_stroke,
        cap_share=machine.leg_sizes.cap_share,
        chord=np.ascontiguousarray(np.linalg.inv(pose_jacobian(np.zeros(MODES), geometry))),
        inertia=np.ascontiguousarray(inertia),
        mean_motion=np.zeros((6, legs)),
        leg_motion=np.zeros((6, legs)),
        leg_force=np.zeros((4, legs)),
        scratch=np.zeros(legs),
        rotation=np.zeros((3, 3)),
        jacobian=np.zeros((MODES, MODES)),
        inverse_jacobian=np.zeros((MODES, MODES)),
    )


@compiled
def follow_pose(inverse, pose):  # type: ignore[no-untyped-def]
    """Write the Jacobian's inverse at a pose, which moves a chord's step to `leg_motion[0]`.

    Where legs carry no platform the pose stays.
    """
    if not inverse.follows_pose:
        return
    legs, jacobian, rotation = inverse.scratch, inverse.jacobian, inverse.rotation
    write_legs(inverse.geometry, pose, legs)
    write_twist_jacobian(inverse.geometry, pose, jacobian)
    write_rotation(pose[3], pose[4], pose[5], rotation)
    for j in range(6):
        for column in range(0, 6, 3):  # of translation, then of rotation, to axes of the platform
            x, y, z = jacobian[j, column], jacobian[j, column + 1], jacobian[j, column + 2]
            for k in range(3):
                jacobian[j, column + k] = (
                    rotation[0, k] * x + rotation[1, k] * y + rotation[2, k] * z
                )
    is_sound = True
    for i in range(6):  # metres and radians; written so that NaN counts as unsound
        for j in range(6):
            pose[i] += inverse.chord[i, j] * (inverse.leg_motion[0, j] - legs[j])
        is_sound = is_sound and abs(pose[i]) < 0.5 * np.pi
    if not is_sound:
        for i in range(6):
            pose[i] = 0.0
    write_inverse(jacobian, inverse.inverse_jacobian)


@compiled
def write_inverse(matrix, inverse):  # type: ignore[no-untyped-def]
    """Write the inverse of a matrix (n, n), which is overwritten: Gauss and Jordan, row pivots."""
    count = matrix.shape[0]
    for i in range(count):
        for j in range(count):
            inverse[i, j] = 1.0 if i == j else 0.0
    for column in range(count):
        pivot = column
        for i in range(column + 1, count):
            if abs(matrix[i, column]) > abs(matrix[pivot, column]):
                pivot = i
        if pivot != column:
            for j in range(count):
                matrix[pivot, j], matrix[column, j] = matrix[column, j], matrix[pivot, j]
                inverse[pivot, j], inverse[column, j] = inverse[column, j], inverse[pivot, j]
        scale = 1.0 / matrix[column, column]
        for j in range(count):
            matrix[column, j] *= scale
            inverse[column, j] *= scale
        for i in range(count):
            multiple = matrix[i, column]
            if i != column and multiple != 0.0:
                for j in range(count):
                    matrix[i, j] -= multiple * matrix[column, j]
                    inverse[i, j] -= multiple * inverse[column, j]


@compiled
def _write_forces(inverse, pose, shape, is_modal):  # type: ignore[no-untyped-def]
    """Write planned forces M_leg l'' of legs at the planned pose, and three derivatives."""
    count = inverse.mean_motion.shape[1]
    follow_pose(inverse, pose)
    for row in range(4):
        force, scratch = inverse.leg_force[row], inverse.scratch
        if inverse.follows_pose:
            multiply(inverse.inverse_jacobian, inverse.leg_motion[row + 2], force)
            multiply(inverse.inertia, force, scratch)
            multiply_transposed(inverse.inverse_jacobian, scratch, force)
        else:
            for mode in range(count):
                mass = inverse.spring * inverse.mass_per_spring[mode]
                scratch[mode] = mass * inverse.mean_motion[row + 2, mode]
            if is_modal:
                multiply_transposed(shape, scratch, force)
            else:
                assign(force, scratch)


@compiled
def load_opening(inverse, flow, flow_rate, load, load_rate):  # type: ignore[no-untyped-def]
    """What a valve opens for its load, z / g - z of a flow z, as leg speed; and the rate of it."""
    load_share = load / inverse.stall
    bending = 1.0 / (1.0 + (load_share / NEAR_STALL) ** 2)
    load_share_rate = bending * np.sqrt(bending) * load_rate / inverse.stall
    load_share *= np.sqrt(bending)
    outward, inward = 1.0 / np.sqrt(1.0 - load_share), 1.0 / np.sqrt(1.0 + load_share)
    mean, half_gap = 0.5 * (outward + inward) - 1.0, 0.5 * (outward - inward)
    root = np.sqrt(flow * flow + SMALL_FLOW * SMALL_FLOW)
    size = flow * flow / root
    size_slope = flow * (flow * flow + 2.0 * SMALL_FLOW * SMALL_FLOW) / (root * root * root)
    outward_slope, inward_slope = 0.5 * outward * outward * outward, 0.5 * inward * inward * inward
    slope = (outward_slope - inward_slope) * flow + (outward_slope + inward_slope) * size
    rate = (mean + half_gap * size_slope) * flow_rate
    rate += 0.5 * slope * load_share_rate
    return mean * flow + half_gap * size, rate


@compiled
def write_commands(inverse, pose, shape, is_modal, commands):  # type: ignore[no-untyped-def]
    """Write the commands of the planned motion (n,), in coordinates of the law, fractions."""
    count, leg_motion = commands.shape[0], inverse.leg_motion
    for row in range(6):
        if is_modal:
            multiply_transposed(shape, inverse.mean_motion[row], leg_motion[row])
        else:
            assign(leg_motion[row], inverse.mean_motion[row])
    _write_forces(inverse, pose, shape, is_modal)
    leg_commands = inverse.scratch
    for leg in range(count):
        spring, leak = inverse.spring, inverse.leak_rate
        if inverse.follows_pose:
            extension = leg_motion[0, leg] / inverse.half_stroke
            spring_ratio, leak_ratio = _oil_ratios(extension, inverse.cap_share)
            spring *= spring_ratio
            leak *= leak_ratio
        force = inverse.leg_force
        deflection, deflection_rate = force[0, leg] / spring, force[1, leg] / spring
        deflection_acceleration, deflection_jerk = force[2, leg] / spring, force[3, leg] / spring
        flow = leg_motion[1, leg] + deflection_rate + leak * deflection
        flow_rate = leg_motion[2, leg] + deflection_acceleration + leak * deflection_rate
        flow_acceleration = leg_motion[3, leg] + deflection_jerk + leak * deflection_acceleration
        opening, opening_rate = load_opening(inverse, flow, flow_rate, force[0, leg], force[1, leg])
        speed = flow + opening + inverse.lag_sum * (flow_rate + opening_rate)
        leg_commands[leg] = (speed + inverse.lag_product * flow_acceleration) / inverse.speed
    if is_modal:
        multiply(shape, leg_commands, commands)
    else:
        assign(commands, leg_commands)


@compiled
def _oil_ratios(extension, cap_share):  # type: ignore[no-untyped-def]
    """Oil spring and leak rate of a leg over those at neutral, at extension over half stroke."""
    cap_length, rod_length = 1.0 + extension, 1.0 - extension
    if abs(extension) >= 1.0:
        return 1.0, 1.0
    spring_ratio = cap_share / cap_length + (1.0 - cap_share) / rod_length
    return spring_ratio, 1.0 / (spring_ratio * (cap_length * rod_length) ** 2)
