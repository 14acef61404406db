"""Motions that make up the demand of the DCU: pose, velocity and acceleration, (3, 6).

*Between* two frames a quintic meets both in position, velocity and acceleration. With s the time
since the first, h the interval, x = s / h and b[0..5] the Bernstein points of the quintic,

    p(s) = sum c[i] x^i,    |p'| <= 5 max |b[i+1] - b[i]| / h,
                            |p''| <= 20 max |b[i+2] - 2 b[i+1] + b[i]| / h^2

*A stop* from p, v, a: the velocity falls by a cubic in Tv, the acceleration fades in Ta,

    v(s) = v g(s / Tv) + a Ta e(s / Ta),    g(x) = 1 - 3 x^2 + 2 x^3,    e(x) = x (1 - x)^2

and rests at p + v Tv / 2 + a Ta^2 / 12 from max(Tv, Ta) on.

*A gap* e between demand and host obeys, in each degree of freedom,

    e''' + 3 w e'' + 3 w^2 e' + w^3 sat(e) = 0,    sat(e) = e within +-L, L = 3 V / w

within L three poles at -w, beyond it a closing speed of V. It is integrated exactly with sat
constant over a frame, and its state is e, e' and e'' themselves: to begin again from them changes
nothing, so no pattern of arrivals makes it grow. `docs/reference/dcu.md` proves it stable. From
rest the speed is at most 1.0043 V and the acceleration 0.2331 w^2 L = 0.70 w V; a gap of velocity v
alone grows to 0.84 v / w while that is within L, v < 3.57 V, and to more beyond.

*Poses alone* u, straight lines between frames, go through a Bessel filter of fourth order with the
delay D. The integral of its |impulse response| is 1.019: its output exceeds their range by 1 %.
"""

import numpy as np

from cmf_mj.core.compiled import compiled

POSE, VELOCITY, ACCELERATION = 0, 1, 2  #: Rows of a motion.

DOF_COUNT = 6  #: Degrees of freedom of the platform.

GAP_END = 1e-6  #: Acceleration [m/s^2, rad/s^2] below which a gap, times w^2, w and 1, has ended.

GAP_OVERSHOOT = 0.84  #: What a gap of velocity v alone, below 3.57 V, grows to, in v / w.


@compiled
def copy(source, target):  # type: ignore[no-untyped-def]
    """Copy a motion; loops compile many times faster than an assignment of slices."""
    for row in range(3):
        for i in range(DOF_COUNT):
            target[row, i] = source[row, i]


@compiled
def add(first, second, total):  # type: ignore[no-untyped-def]
    """Write the sum of two motions."""
    for row in range(3):
        for i in range(DOF_COUNT):
            total[row, i] = first[row, i] + second[row, i]


@compiled
def subtract(first, second, difference):  # type: ignore[no-untyped-def]
    """Write the difference of two motions."""
    for row in range(3):
        for i in range(DOF_COUNT):
            difference[row, i] = first[row, i] - second[row, i]


@compiled
def fit_quintic(first, last, h, polynomial):  # type: ignore[no-untyped-def]
    """Write coefficients c (6, 6), power by degree of freedom, of the quintic of two motions."""
    for i in range(DOF_COUNT):
        v0, v1 = first[VELOCITY, i] * h, last[VELOCITY, i] * h
        a0, a1 = first[ACCELERATION, i] * h * h, last[ACCELERATION, i] * h * h
        d = last[POSE, i] - first[POSE, i]
        polynomial[0, i] = first[POSE, i]
        polynomial[1, i] = v0
        polynomial[2, i] = 0.5 * a0
        polynomial[3, i] = 10.0 * d - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
        polynomial[4, i] = -15.0 * d + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
        polynomial[5, i] = 6.0 * d - 3.0 * (v0 + v1) + 0.5 * (a1 - a0)


@compiled
def evaluate_quintic(polynomial, h, s, out):  # type: ignore[no-untyped-def]
    """Write the motion of the quintic at the time s, by Horner's rule."""
    x = s / h
    for i in range(DOF_COUNT):
        p, v, a = 0.0, 0.0, 0.0
        for power in range(5, -1, -1):
            a = a * x + v
            v = v * x + p
            p = p * x + polynomial[power, i]
        out[POSE, i] = p
        out[VELOCITY, i] = v / h
        out[ACCELERATION, i] = 2.0 * a / (h * h)


@compiled
def quintic_keeps_limits(dcu, first, last, h):  # type: ignore[no-untyped-def]
    """Whether the quintic between two motions keeps velocity and acceleration limits."""
    for i in range(DOF_COUNT):
        v0, v1 = first[VELOCITY, i] * h, last[VELOCITY, i] * h
        a0, a1 = first[ACCELERATION, i] * h * h, last[ACCELERATION, i] * h * h
        # Bernstein points from the first pose on.
        b1, b2 = v0 / 5.0, 0.4 * v0 + a0 / 20.0
        b5 = last[POSE, i] - first[POSE, i]
        b4, b3 = b5 - v1 / 5.0, b5 - 0.4 * v1 + a1 / 20.0
        largest_change = dcu.velocity[i] * h
        for difference in (b2 - b1, b3 - b2, b4 - b3):
            if not 5.0 * abs(difference) <= largest_change:
                return False
        largest_change = dcu.acceleration[i] * h * h
        for second_difference in (b3 - 2.0 * b2 + b1, b4 - 2.0 * b3 + b2):
            if not 20.0 * abs(second_difference) <= largest_change:
                return False
    return True


@compiled
def evaluate_stop(dcu, first, s, out):  # type: ignore[no-untyped-def]
    """Write the motion of a stop from the motion `first`, at the time s after it."""
    tv, ta = dcu.stop_time, dcu.fade_time
    x, y = min(s / tv, 1.0), min(s / ta, 1.0)
    g, slope_of_g = 1.0 + x * x * (2.0 * x - 3.0), 6.0 * x * (x - 1.0)
    integral_of_g = x - x**3 + 0.5 * x**4
    e, slope_of_e = y * (1.0 - y) ** 2, (1.0 - y) * (1.0 - 3.0 * y)
    integral_of_e = y * y * (0.5 + y * (0.25 * y - 2.0 / 3.0))
    for i in range(DOF_COUNT):
        v, a = first[VELOCITY, i], first[ACCELERATION, i]
        out[POSE, i] = first[POSE, i] + v * tv * integral_of_g + a * ta * ta * integral_of_e
        out[VELOCITY, i] = v * g + a * ta * e
        out[ACCELERATION, i] = v / tv * slope_of_g + a * slope_of_e


@compiled
def close_gap(dcu, gap):  # type: ignore[no-untyped-def]
    """Advance a gap by a frame; one too small to be felt has ended."""
    has_ended = True
    for i in range(DOF_COUNT):
        p, v, a = gap[POSE, i], gap[VELOCITY, i], gap[ACCELERATION, i]
        saturated = min(max(p, -dcu.gap_range[i]), dcu.gap_range[i])
        for row in range(3):
            c = dcu.closing[row]
            gap[row, i] = c[0] * p + c[1] * v + c[2] * a + c[3] * saturated
            has_ended = has_ended and abs(gap[row, i]) * dcu.gap_rate ** (2 - row) < GAP_END
    if has_ended:
        gap[:] = 0.0


@compiled
def smooth_poses(dcu, poses, filtered):  # type: ignore[no-untyped-def]
    """Advance the Bessel filter by a frame: `filtered` (4, 6) is pose and three derivatives."""
    for i in range(DOF_COUNT):
        x0, x1, x2, x3 = filtered[0, i], filtered[1, i], filtered[2, i], filtered[3, i]
        for row in range(4):
            c = dcu.smoothing[row]
            filtered[row, i] = c[0] * x0 + c[1] * x1 + c[2] * x2 + c[3] * x3 + c[4] * poses[i]


@compiled
def line_keeps_limits(dcu, first, last, h):  # type: ignore[no-untyped-def]
    """Whether the straight line between two poses keeps the velocity limits."""
    for i in range(DOF_COUNT):
        if not abs(last[POSE, i] - first[POSE, i]) <= dcu.velocity[i] * h:
            return False
    return True


@compiled
def bound_pose(dcu, motion, out):  # type: ignore[no-untyped-def]
    """Bring a pose beyond the limit P to rest at P + m, m the overtravel, smoothly.

    With u = (|p| - P) / m the pose becomes P + m tanh u: value, slope and curvature go over at P.
    """
    for i in range(DOF_COUNT):
        p, v, a = motion[POSE, i], motion[VELOCITY, i], motion[ACCELERATION, i]
        if abs(p) > dcu.pose[i]:
            sign = 1.0 if p > 0.0 else -1.0
            share = np.tanh((abs(p) - dcu.pose[i]) / dcu.overtravel[i])
            slope = 1.0 - share * share
            p = sign * (dcu.pose[i] + dcu.overtravel[i] * share)
            a = slope * a - 2.0 * sign * share * slope * v * v / dcu.overtravel[i]
            v = slope * v
        out[POSE, i] = p
        out[VELOCITY, i] = v
        out[ACCELERATION, i] = a
