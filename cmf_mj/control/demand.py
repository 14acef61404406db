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
def _angular_motion(pose, rates, accelerations):  # type: ignore[no-untyped-def]
    """The angular velocity omega = E rates and its derivative, inertial axes, x, y, z each."""
    cos_pitch, sin_pitch = np.cos(pose[4]), np.sin(pose[4])
    cos_yaw, sin_yaw = np.cos(pose[5]), np.sin(pose[5])
    roll_rate, pitch_rate, yaw_rate = rates[3], rates[4], rates[5]
    x = cos_pitch * cos_yaw * roll_rate - sin_yaw * pitch_rate
    y = cos_pitch * sin_yaw * roll_rate + cos_yaw * pitch_rate
    z = yaw_rate - sin_pitch * roll_rate
    dx = cos_pitch * cos_yaw * accelerations[3] - sin_yaw * accelerations[4]
    slope = -sin_pitch * cos_yaw * pitch_rate - cos_pitch * sin_yaw * yaw_rate
    dx += slope * roll_rate - cos_yaw * yaw_rate * pitch_rate
    dy = cos_pitch * sin_yaw * accelerations[3] + cos_yaw * accelerations[4]
    slope = -sin_pitch * sin_yaw * pitch_rate + cos_pitch * cos_yaw * yaw_rate
    dy += slope * roll_rate - sin_yaw * yaw_rate * pitch_rate
    dz = accelerations[5] - sin_pitch * accelerations[3] - cos_pitch * pitch_rate * roll_rate
    return x, y, z, dx, dy, dz


@compiled
def step(geometry, motion, legs):  # type: ignore[no-untyped-def]
    """Write the motion of the legs (3, 6) that a motion of the platform (3, 6) demands.

    Rows are position [m, rad], z down, velocity and acceleration.
    """
    pose, velocity, acceleration = motion[0], motion[1], motion[2]
    upper, lower, neutral = geometry
    rotation = kinematics.rotation_entries(pose[3], pose[4], pose[5])
    # omega and its derivative alpha.
    ox, oy, oz, ax, ay, az = _angular_motion(pose, velocity, acceleration)
    for j in range(6):
        rx, ry, rz = kinematics.rotated_arm(rotation, upper[j])
        lx = pose[0] + rx - lower[j, 0]
        ly = pose[1] + ry - lower[j, 1]
        lz = pose[2] + rz - lower[j, 2]
        length = np.sqrt(lx * lx + ly * ly + lz * lz)
        nx, ny, nz = lx / length, ly / length, lz / length
        # s = omega x r, velocity w and acceleration q of the upper gimbal.
        sx, sy, sz = oy * rz - oz * ry, oz * rx - ox * rz, ox * ry - oy * rx
        qx = oy * sz - oz * sy + ay * rz - az * ry + acceleration[0]
        qy = oz * sx - ox * sz + az * rx - ax * rz + acceleration[1]
        qz = ox * sy - oy * sx + ax * ry - ay * rx + acceleration[2]
        wx, wy, wz = velocity[0] + sx, velocity[1] + sy, velocity[2] + sz
        leg_rate = nx * wx + ny * wy + nz * wz
        legs[0, j] = length - neutral[j]
        legs[1, j] = leg_rate
        centripetal_term = wx * wx + wy * wy + wz * wz - leg_rate * leg_rate
        legs[2, j] = nx * qx + ny * qy + nz * qz + centripetal_term / length
