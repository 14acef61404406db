"""Demand calculations: platform pose demand to leg demand (first block of Figure 2-6).

With the centroid at p, T of Eq 2.2, E the Euler rate matrix, r_j = T (A_j + dA_j) and
omega = E (roll, pitch, yaw rate), one leg is (Eqs 2.1 and C.6, here in inertial axes)

    l_j = p + r_j - B_j,    n_j = l_j / |l_j|,    leg_j = |l_j| - |A_j - B_j|
    w_j = dp/dt + omega x r_j
    d leg_j/dt = n_j . w_j
    d2 leg_j/dt2 = n_j . (d2p/dt2 + domega/dt x r_j + omega x (omega x r_j))
                   + (|w_j|^2 - (n_j . w_j)^2) / |l_j|

the second derivative being J d2x/dt2 + dJ/dt dx/dt, exact.

A demand that counts at another point of the platform, as Eq 2.1 does at the static centre of mass,
has the geometry of `kinematics.about` that point.

**Flexible body.** dA_j of Eq 2.1 is where the upper gimbal sits under load, in platform axes. The
report gives no values; it is off by default. Here

    dA_j = deflection_j + C_j f,    f = T' (d2p/dt2 - g),    g = (0, 0, 9.80665) m/s^2, z down

with f the specific force where the demand counts, (0, 0, -9.80665) m/s^2 level and at rest, and
C_j a compliance in m per m/s^2. The deflection is quasi-static: its own rates, C_j df/dt and on,
are left out of leg velocity and acceleration (they would need the jerk, which no host sends).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core import units
from cmf_mj.core.arrays import shaped
from cmf_mj.core.compiled import compiled
from cmf_mj.machine import kinematics, models
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.machine import geometry_of


class Demand(NamedTuple):
    """Compiled parameters of the demand block."""

    geometry: Geometry  #: Gimbals and neutral lengths of the unloaded platform.
    deflection: NDArray[np.float64]  #: Constant part of dA, platform axes [m], (6, 3).
    compliance: NDArray[np.float64]  #: dA per specific force, platform axes [m/(m/s^2)], (6, 3, 3).


def make_demand(
    machine: kinematics.MachineOrGimbals = models.CMF,
    deflection: ArrayLike | None = None,
    compliance: ArrayLike | None = None,
) -> Demand:
    """Parameters of the demand block; default a rigid platform.

    The constant displacement of the upper gimbals is (6, 3) [m], their displacement per specific
    force (6, 3, 3) [m/(m/s^2)], both in platform axes.
    """
    return Demand(
        geometry_of(machine),
        shaped("deflection", np.zeros((6, 3)) if deflection is None else deflection, 6, 3),
        shaped("compliance", np.zeros((6, 3, 3)) if compliance is None else compliance, 6, 3, 3),
    )


@compiled
def _turning(pose, rates, changes):  # type: ignore[no-untyped-def]
    """The angular velocity omega = E rates and its derivative, inertial axes."""
    ct, st = np.cos(pose[4]), np.sin(pose[4])
    cp, sp = np.cos(pose[5]), np.sin(pose[5])
    roll, pitch, yaw = rates[3], rates[4], rates[5]
    x, y, z = ct * cp * roll - sp * pitch, ct * sp * roll + cp * pitch, yaw - st * roll
    dx = ct * cp * changes[3] - sp * changes[4]
    dx += (-st * cp * pitch - ct * sp * yaw) * roll - cp * yaw * pitch
    dy = ct * sp * changes[3] + cp * changes[4]
    dy += (-st * sp * pitch + ct * cp * yaw) * roll - sp * yaw * pitch
    dz = changes[5] - st * changes[3] - ct * pitch * roll
    return x, y, z, dx, dy, dz


@compiled
def _under_load(demand, j, fx, fy, fz):  # type: ignore[no-untyped-def]
    """Upper gimbal of a leg under a specific force, platform axes."""
    rest, bend, give = demand.geometry.upper[j], demand.deflection[j], demand.compliance[j]
    return (
        rest[0] + bend[0] + give[0, 0] * fx + give[0, 1] * fy + give[0, 2] * fz,
        rest[1] + bend[1] + give[1, 0] * fx + give[1, 1] * fy + give[1, 2] * fz,
        rest[2] + bend[2] + give[2, 0] * fx + give[2, 1] * fy + give[2, 2] * fz,
    )


@compiled
def step(demand, motion, legs):  # type: ignore[no-untyped-def]
    """Write the motion of the legs (3, 6) that a motion of the platform (3, 6) demands.

    Rows are position [m, rad], z down, velocity and acceleration.
    """
    pose, velocity, acceleration = motion[0], motion[1], motion[2]
    _, lower, neutral = demand.geometry
    turn = kinematics.turn_of(pose[3], pose[4], pose[5])
    ox, oy, oz, bx, by, bz = _turning(pose, velocity, acceleration)
    # Specific force where the demand counts, platform axes.
    down = acceleration[2] - units.STANDARD_GRAVITY
    fx, fy, fz = kinematics.turned_back(turn, acceleration[0], acceleration[1], down)
    for j in range(6):
        rx, ry, rz = kinematics.turned(turn, _under_load(demand, j, fx, fy, fz))
        lx = pose[0] + rx - lower[j, 0]
        ly = pose[1] + ry - lower[j, 1]
        lz = pose[2] + rz - lower[j, 2]
        length = np.sqrt(lx * lx + ly * ly + lz * lz)
        lx, ly, lz = lx / length, ly / length, lz / length
        # omega x r, then omega x (omega x r) + domega/dt x r.
        sx, sy, sz = oy * rz - oz * ry, oz * rx - ox * rz, ox * ry - oy * rx
        tx = oy * sz - oz * sy + by * rz - bz * ry + acceleration[0]
        ty = oz * sx - ox * sz + bz * rx - bx * rz + acceleration[1]
        tz = ox * sy - oy * sx + bx * ry - by * rx + acceleration[2]
        wx, wy, wz = velocity[0] + sx, velocity[1] + sy, velocity[2] + sz
        along = lx * wx + ly * wy + lz * wz
        legs[0, j] = length - neutral[j]
        legs[1, j] = along
        across = wx * wx + wy * wy + wz * wz - along * along
        legs[2, j] = lx * tx + ly * ty + lz * tz + across / length
