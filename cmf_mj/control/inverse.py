"""From a planned motion to the command that makes it: machine, oil and valves turned round.

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
`NEAR_STALL`. For a flow Z cos and a load X F_s sin the fundamental of z / g is Z cos + 2 X / (3 pi)
Z sin: a turn of the phase by 12 deg per X, which is lost without it.
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
    rotate,
    write_legs,
    write_twist_jacobian,
)
from cmf_mj.machine.machine import Machine

NEAR_STALL = 0.8  #: Share of the stall to which loads are bent for a valve's opening.

SMALL_FLOW = 2.0 * units.INCH
"""Flow, as speed of a leg, about which a change of direction is rounded [m/s]."""


class Valves(NamedTuple):
    """What is to be known of a leg's valves, SI."""

    speed: float  #: k [m/s per full command].
    corners: tuple[float, float]  #: a and b [rad/s].
    leak_rate: float = 0.0  #: lambda [1/s].
    stall: float = np.inf  #: F_s [N].


class Inverse(NamedTuple):
    """Compiled parameters, SI, and workspace."""

    speed: float  #: k [m/s per full command].
    leak_rate: float  #: lambda [1/s].
    lags: float  #: 1/a + 1/b [s].
    lags_product: float  #: 1/(a b) [s^2].
    stall: float  #: F_s [N].
    compliance: NDArray[np.float64]  #: 1/w^2, (n,) [s^2].
    spring: float  #: Oil spring of a leg at neutral [N/m]; 1 where masses are not known.
    follows: bool  #: Whether masses and springs follow the pose.
    geometry: Geometry
    half_stroke: float  #: [m].
    cap_share: float  #: Cap area over that of cap and rod side.
    chord: NDArray[np.float64]  #: Pose per leg motion at neutral, (6, 6).
    inertia: NDArray[np.float64]  #: Of the platform with its legs, platform axes, (6, 6).
    mean: NDArray[np.float64]
    """Mean of the planned motion over the next frame, position to fifth derivative, (6, n)."""
    legs: NDArray[np.float64]  #: The same of legs, (6, n).
    force: NDArray[np.float64]  #: Planned force of legs and three derivatives, (4, n) [N, ..].
    coordinates: NDArray[np.float64]  #: Quantities on their way, (2, n).
    turn: NDArray[np.float64]  #: Rotation of the platform, (3, 3).
    jacobian: NDArray[np.float64]  #: Legs of the twist in platform axes, (6, 6).
    reciprocal: NDArray[np.float64]  #: Its inverse, (6, 6).


def make_inverse(
    valves: Valves, omega: NDArray[np.float64], modes: Modes | None, machine: Machine
) -> Inverse:
    """Compile the inverse for legs of these frequencies [rad/s], (n,), or the modes of a cab."""
    legs, geometry, inertia, spring = omega.size, machine.geometry, np.zeros((MODES, MODES)), 1.0
    if modes is not None:
        mass = mode_mass(modes)
        reach = make_shape(modes, legs) @ leg_jacobian(np.zeros(MODES), geometry)
        inertia, spring = reach.T @ np.diag(mass) @ reach, float((mass * omega**2).mean())
    return Inverse(
        speed=valves.speed,
        leak_rate=valves.leak_rate,
        lags=sum(1.0 / a for a in valves.corners),
        lags_product=1.0 / float(np.prod(valves.corners)),
        stall=valves.stall if modes is not None else np.inf,
        compliance=omega**-2.0,
        spring=spring,
        follows=modes is not None and modes.follow_pose,
        geometry=geometry,
        half_stroke=machine.half_stroke,
        cap_share=machine.leg_sizes.cap_share,
        chord=np.ascontiguousarray(np.linalg.inv(pose_jacobian(np.zeros(MODES), geometry))),
        inertia=np.ascontiguousarray(inertia),
        mean=np.zeros((6, legs)),
        legs=np.zeros((6, legs)),
        force=np.zeros((4, legs)),
        coordinates=np.zeros((2, legs)),
        turn=np.zeros((3, 3)),
        jacobian=np.zeros((MODES, MODES)),
        reciprocal=np.zeros((MODES, MODES)),
    )


@compiled
def follow(inverse, pose):  # type: ignore[no-untyped-def]
    """Write the Jacobian's inverse at a pose, which moves a chord's step towards `legs[0]`.

    Where legs carry no platform the pose stays.
    """
    if not inverse.follows:
        return
    errors, jacobian, turn = inverse.coordinates[0], inverse.jacobian, inverse.turn
    write_legs(inverse.geometry, pose, errors)
    write_twist_jacobian(inverse.geometry, pose, jacobian)
    rotate(pose[3], pose[4], pose[5], turn)
    for j in range(6):
        for first in range(0, 6, 3):  # of translation, then of rotation, to axes of the platform
            x, y, z = jacobian[j, first], jacobian[j, first + 1], jacobian[j, first + 2]
            for k in range(3):
                jacobian[j, first + k] = turn[0, k] * x + turn[1, k] * y + turn[2, k] * z
    sound = True
    for i in range(6):  # metres and radians; written so that NaN is unsound
        for j in range(6):
            pose[i] += inverse.chord[i, j] * (inverse.legs[0, j] - errors[j])
        sound = sound and abs(pose[i]) < 0.5 * np.pi
    if not sound:
        for i in range(6):
            pose[i] = 0.0
    invert(jacobian, inverse.reciprocal)


@compiled
def invert(matrix, inverse):  # type: ignore[no-untyped-def]
    """Write the inverse of a matrix (n, n), which is overwritten: Gauss and Jordan, row pivots."""
    count = matrix.shape[0]
    for i in range(count):
        for j in range(count):
            inverse[i, j] = 1.0 if i == j else 0.0
    for column in range(count):
        best = column
        for i in range(column + 1, count):
            if abs(matrix[i, column]) > abs(matrix[best, column]):
                best = i
        if best != column:
            for j in range(count):
                matrix[best, j], matrix[column, j] = matrix[column, j], matrix[best, j]
                inverse[best, j], inverse[column, j] = inverse[column, j], inverse[best, j]
        scale = 1.0 / matrix[column, column]
        for j in range(count):
            matrix[column, j] *= scale
            inverse[column, j] *= scale
        for i in range(count):
            factor = matrix[i, column]
            if i != column and factor != 0.0:
                for j in range(count):
                    matrix[i, j] -= factor * matrix[column, j]
                    inverse[i, j] -= factor * inverse[column, j]


@compiled
def _write_forces(inverse, pose, shape, modal):  # type: ignore[no-untyped-def]
    """Write planned forces of legs and their derivatives: M_leg l'' at the planned pose."""
    count = inverse.mean.shape[1]
    follow(inverse, pose)
    for row in range(4):
        force, on_way = inverse.force[row], inverse.coordinates[0]
        if inverse.follows:
            multiply(inverse.reciprocal, inverse.legs[row + 2], force)
            multiply(inverse.inertia, force, on_way)
            multiply_transposed(inverse.reciprocal, on_way, force)
        else:
            for mode in range(count):
                on_way[mode] = (
                    inverse.spring * inverse.compliance[mode] * inverse.mean[row + 2, mode]
                )
            if modal:
                multiply_transposed(shape, on_way, force)
            else:
                assign(force, on_way)


@compiled
def opened(inverse, flow, flow_rate, load, load_rate):  # type: ignore[no-untyped-def]
    """What a valve has to open beyond the flow asked of it, for its load, and the rate of that."""
    share = load / inverse.stall
    bend = 1.0 / (1.0 + (share / NEAR_STALL) ** 2)
    change = bend * np.sqrt(bend) * load_rate / inverse.stall
    share *= np.sqrt(bend)
    out, back = 1.0 / np.sqrt(1.0 - share), 1.0 / np.sqrt(1.0 + share)
    mean, half = 0.5 * (out + back) - 1.0, 0.5 * (out - back)
    root = np.sqrt(flow * flow + SMALL_FLOW * SMALL_FLOW)
    size = flow * flow / root
    slope = flow * (flow * flow + 2.0 * SMALL_FLOW * SMALL_FLOW) / (root * root * root)
    up, down = 0.5 * out * out * out, 0.5 * back * back * back
    rate = (mean + half * slope) * flow_rate
    rate += 0.5 * ((up - down) * flow + (up + down) * size) * change
    return mean * flow + half * size, rate


@compiled
def command(inverse, pose, shape, modal, commands):  # type: ignore[no-untyped-def]
    """Write the commands of the planned motion (n,), in coordinates of the law, fractions.

    Modes have the shape V^T if `modal`.
    """
    count, legs = commands.shape[0], inverse.legs
    for row in range(6):
        if modal:
            multiply_transposed(shape, inverse.mean[row], legs[row])
        else:
            assign(legs[row], inverse.mean[row])
    _write_forces(inverse, pose, shape, modal)
    asked = inverse.coordinates[0]
    for leg in range(count):
        spring, leak = inverse.spring, inverse.leak_rate
        if inverse.follows:
            more_spring, more_leak = _oil(legs[0, leg] / inverse.half_stroke, inverse.cap_share)
            spring *= more_spring
            leak *= more_leak
        force = inverse.force
        y2, y3 = force[0, leg] / spring, force[1, leg] / spring
        y4, y5 = force[2, leg] / spring, force[3, leg] / spring
        flow = legs[1, leg] + y3 + leak * y2
        first = legs[2, leg] + y4 + leak * y3
        second = legs[3, leg] + y5 + leak * y4
        more, rate = opened(inverse, flow, first, force[0, leg], force[1, leg])
        total = flow + more + inverse.lags * (first + rate) + inverse.lags_product * second
        asked[leg] = total / inverse.speed
    if modal:
        multiply(shape, asked, commands)
    else:
        assign(commands, asked)


@compiled
def _oil(stroke, share):  # type: ignore[no-untyped-def]
    """Oil spring k and leak rate of a leg over those at neutral, at extension over half stroke."""
    cap, rod = 1.0 + stroke, 1.0 - stroke
    if abs(stroke) >= 1.0:
        return 1.0, 1.0
    spring = share / cap + (1.0 - share) / rod
    return spring, 1.0 / (spring * (cap * rod) ** 2)
