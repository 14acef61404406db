"""Demand calculations: platform pose demand to leg demand (first block of Figure 2-6).

With the centroid at p, T of Eq 2.2, E the Euler rate matrix, r_j = T A_j and
omega = E (roll, pitch, yaw rate), one leg is (Eqs 2.1 and C.6, here in inertial axes)

    l_j = p + r_j - B_j,    n_j = l_j / |l_j|,    leg_j = |l_j| - |A_j - B_j|
    w_j = dp/dt + omega x r_j
    d leg_j/dt = n_j . w_j
    d2 leg_j/dt2 = n_j . (d2p/dt2 + domega/dt x r_j + omega x (omega x r_j))
                   + (|w_j|^2 - (n_j . w_j)^2) / |l_j|

the second derivative being J d2x/dt2 + dJ/dt dx/dt, exact.

A demand at another point of the platform, as that of Eq 2.1 at the static centre of mass, has the
geometry of `kinematics.geometry_about` that point. The platform is rigid: of dA_j of Eq
2.1, where the upper gimbal sits under load, the report gives no values.
"""

import numpy as np

from cmf_mj.core.compiled import compiled
from cmf_mj.machine import kinematics


@compiled
def _angular_motion(pose, rate, acceleration):  # type: ignore[no-untyped-def]
    """The angular velocity omega = E rates and its derivative, inertial axes."""
    ct, st = np.cos(pose[4]), np.sin(pose[4])
    cp, sp = np.cos(pose[5]), np.sin(pose[5])
    roll, pitch, yaw = rate[3], rate[4], rate[5]
    x, y, z = ct * cp * roll - sp * pitch, ct * sp * roll + cp * pitch, yaw - st * roll
    dx = ct * cp * acceleration[3] - sp * acceleration[4]
    dx += (-st * cp * pitch - ct * sp * yaw) * roll - cp * yaw * pitch
    dy = ct * sp * acceleration[3] + cp * acceleration[4]
    dy += (-st * sp * pitch + ct * cp * yaw) * roll - sp * yaw * pitch
    dz = acceleration[5] - st * acceleration[3] - ct * pitch * roll
    return x, y, z, dx, dy, dz


@compiled
def step(geometry, motion, legs):  # type: ignore[no-untyped-def]
    """Write the motion of the legs (3, 6) that a motion of the platform (3, 6) demands.

    Rows are position [m, rad], z down, velocity and acceleration.
    """
    pose, velocity, acceleration = motion[0], motion[1], motion[2]
    upper, lower, neutral = geometry
    rotation = kinematics.turn_of(pose[3], pose[4], pose[5])
    ox, oy, oz, bx, by, bz = _angular_motion(pose, velocity, acceleration)
    for j in range(6):
        rx, ry, rz = kinematics.rotated_arm(rotation, upper[j])
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
        leg_rate = lx * wx + ly * wy + lz * wz
        legs[0, j] = length - neutral[j]
        legs[1, j] = leg_rate
        centripetal_term = wx * wx + wy * wy + wz * wz - leg_rate * leg_rate
        legs[2, j] = lx * tx + ly * ty + lz * tz + centripetal_term / length
