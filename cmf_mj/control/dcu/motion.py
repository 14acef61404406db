"""Motions the DCU is put together from; each holds pose, velocity and acceleration, (3, 6).

*Between* two frames a quintic meets both in position, velocity and acceleration. With s the time
since the first, h the interval, x = s / h and b[0..5] the Bernstein points of the quintic,

    p(s) = sum c[i] x^i,    |p'| <= 5 max |b[i+1] - b[i]| / h,
                            |p''| <= 20 max |b[i+2] - 2 b[i+1] + b[i]| / h^2

*A stop* from p, v, a: the velocity falls by a cubic in Tv, the acceleration fades in Ta,

    v(s) = v g(s / Tv) + a Ta e(s / Ta),    g(x) = 1 - 3 x^2 + 2 x^3,    e(x) = x (1 - x)^2

and rests at p + v Tv / 2 + a Ta^2 / 12 from max(Tv, Ta) on.

*A correction* takes a gap P, V, A between demand and host to nothing, each in a time of its own,

    P B(s / Tp) + V Tv C(s / Tv) + A Ta^2 D(s / Ta)

with the quintic Hermite functions B, C, D of a value, slope and curvature at 0. All are twice
continuously differentiable from start to rest.
"""

import numpy as np

from cmf_mj.core.compiled import compiled

POSE, VELOCITY, ACCELERATION = 0, 1, 2
"""Rows of a motion."""

DOFS = 6

GAP_PEAK_VELOCITY, GAP_PEAK_ACCELERATION = 1.875, 10.0 / np.sqrt(3.0)
"""Largest |B'| and |B''|."""


@compiled
def copy(source, target):  # type: ignore[no-untyped-def]
    """Copy a motion; loops compile many times faster than an assignment of slices."""
    for row in range(3):
        for i in range(DOFS):
            target[row, i] = source[row, i]


@compiled
def between(first, last, h, polynomial):  # type: ignore[no-untyped-def]
    """Coefficients c (6, 6), power by degree of freedom, of the quintic between two motions."""
    for i in range(DOFS):
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
def evaluate(polynomial, h, s, out):  # type: ignore[no-untyped-def]
    """The quintic at the time s, by Horner's rule."""
    x = s / h
    for i in range(DOFS):
        p, v, a = 0.0, 0.0, 0.0
        for power in range(5, -1, -1):
            a = a * x + v
            v = v * x + p
            p = p * x + polynomial[power, i]
        out[POSE, i] = p
        out[VELOCITY, i] = v / h
        out[ACCELERATION, i] = 2.0 * a / (h * h)


@compiled
def joins(dcu, first, last, h):  # type: ignore[no-untyped-def]
    """Whether the quintic between two motions keeps velocity and acceleration limits."""
    for i in range(DOFS):
        v0, v1 = first[VELOCITY, i] * h, last[VELOCITY, i] * h
        a0, a1 = first[ACCELERATION, i] * h * h, last[ACCELERATION, i] * h * h
        # Bernstein points from the first pose on.
        b1, b2 = v0 / 5.0, 0.4 * v0 + a0 / 20.0
        b5 = last[POSE, i] - first[POSE, i]
        b4, b3 = b5 - v1 / 5.0, b5 - 0.4 * v1 + a1 / 20.0
        most = dcu.velocity[i] * h
        for rate in (b2 - b1, b3 - b2, b4 - b3):
            if not 5.0 * abs(rate) <= most:
                return False
        most = dcu.acceleration[i] * h * h
        for bend in (b3 - 2.0 * b2 + b1, b4 - 2.0 * b3 + b2):
            if not 20.0 * abs(bend) <= most:
                return False
    return True


@compiled
def stop(dcu, first, s, out):  # type: ignore[no-untyped-def]
    """The stop from a motion, s after it began."""
    tv, ta = dcu.stop_time, dcu.fade_time
    x, y = min(s / tv, 1.0), min(s / ta, 1.0)
    g, slope, way = 1.0 + x * x * (2.0 * x - 3.0), 6.0 * x * (x - 1.0), x - x**3 + 0.5 * x**4
    e, bend = y * (1.0 - y) ** 2, (1.0 - y) * (1.0 - 3.0 * y)
    path = y * y * (0.5 + y * (0.25 * y - 2.0 / 3.0))
    for i in range(DOFS):
        v, a = first[VELOCITY, i], first[ACCELERATION, i]
        out[POSE, i] = first[POSE, i] + v * tv * way + a * ta * ta * path
        out[VELOCITY, i] = v * g + a * ta * e
        out[ACCELERATION, i] = v / tv * slope + a * bend


@compiled
def closing_time(dcu, gap):  # type: ignore[no-untyped-def]
    """Tp, the shortest time in which the gap of position closes within the rejoin limits."""
    time = dcu.rejoin_time
    for i in range(DOFS):
        size = abs(gap[POSE, i])
        time = max(time, GAP_PEAK_VELOCITY * size / dcu.rejoin_velocity[i])
        time = max(time, np.sqrt(GAP_PEAK_ACCELERATION * size / dcu.rejoin_acceleration[i]))
    return time


@compiled
def add_correction(dcu, gap, closing, s, out):  # type: ignore[no-untyped-def]
    """Add what is left of a gap, s after it was found, to a motion."""
    tp, tv, ta = closing, dcu.stop_time, dcu.fade_time
    x, y, z = min(s / tp, 1.0), min(s / tv, 1.0), min(s / ta, 1.0)
    b0 = 1.0 + x**3 * (x * (15.0 - 6.0 * x) - 10.0)
    b1 = -30.0 * (x * (1.0 - x)) ** 2 / tp
    b2 = -60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (tp * tp)
    c0 = (y + y**3 * (y * (8.0 - 3.0 * y) - 6.0)) * tv
    c1 = 1.0 + y * y * (y * (32.0 - 15.0 * y) - 18.0)
    c2 = y * (y * (96.0 - 60.0 * y) - 36.0) / tv
    d0 = z * z * 0.5 * (1.0 - z) ** 3 * ta * ta
    d1 = z * (1.0 - z) ** 2 * (1.0 - 2.5 * z) * ta
    d2 = 1.0 + z * (z * (18.0 - 10.0 * z) - 9.0)
    for i in range(DOFS):
        p, v, a = gap[POSE, i], gap[VELOCITY, i], gap[ACCELERATION, i]
        out[POSE, i] += p * b0 + v * c0 + a * d0
        out[VELOCITY, i] += p * b1 + v * c1 + a * d1
        out[ACCELERATION, i] += p * b2 + v * c2 + a * d2


@compiled
def hold_within(dcu, motion, out):  # type: ignore[no-untyped-def]
    """Bring a pose beyond the limit P to rest at P + m, m the overtravel, smoothly.

    With u = (|p| - P) / m the pose becomes P + m tanh u: value, slope and curvature go over at P.
    """
    for i in range(DOFS):
        p, v, a = motion[POSE, i], motion[VELOCITY, i], motion[ACCELERATION, i]
        if abs(p) > dcu.pose[i]:
            sign = 1.0 if p > 0.0 else -1.0
            reached = np.tanh((abs(p) - dcu.pose[i]) / dcu.overtravel[i])
            slope = 1.0 - reached * reached
            p = sign * (dcu.pose[i] + dcu.overtravel[i] * reached)
            a = slope * a - 2.0 * sign * reached * slope * v * v / dcu.overtravel[i]
            v = slope * v
        out[POSE, i] = p
        out[VELOCITY, i] = v
        out[ACCELERATION, i] = a
