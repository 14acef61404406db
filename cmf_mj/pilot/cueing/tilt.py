"""Tilt coordination: specific force from gravity, at a limited rate.

Tilt by the angle A turns gravity into the specific force g sin A, so the demand is

    A_d = asin(f / g),    A_d' = f' / (g cos A_d),    A_d'' = (f'' / g + A_d'^2 sin A_d) / cos A_d

with f, f', f'' of the low-pass, which knows its own derivatives. The tilt follows at the rate

    A' = sat(A_d' + (A_d - A) / tau),    |A'| <= R

While sat does not bind, A stays on A_d without lag; a tilt that was held back closes in at the
rate R and joins with the time constant tau. A and A' are continuous; A'' jumps where sat begins or
ends to bind. Over a sample without saturation A comes out exact, e[k+1] = e[k] exp(-T / tau) with
e = A_d - A; with saturation sat's argument is taken as a straight line, an error of the order T^3.
"""

import numpy as np

from cmf_mj.core.compiled import compiled
from cmf_mj.core.units import STANDARD_GRAVITY

_ITERATIONS = 8
"""Of the implicit step, which contracts by at most T / (2 tau) each."""


@compiled
def tilt_demand(force, out):  # type: ignore[no-untyped-def]
    """Write A_d, A_d', A_d'' (3,) of f, f', f'' (3,) [m/s^2, m/s^3, m/s^4]; |f| below 1 g."""
    sine = force[0] / STANDARD_GRAVITY
    cosine = np.sqrt(1.0 - sine * sine)
    out[0] = np.arcsin(sine)
    out[1] = force[1] / (STANDARD_GRAVITY * cosine)
    out[2] = (force[2] / STANDARD_GRAVITY + out[1] * out[1] * sine) / cosine


@compiled
def _area(value, limit):  # type: ignore[no-untyped-def]
    """Integral of sat from 0 to `value`."""
    size = abs(value)
    return 0.5 * value * value if size <= limit else limit * size - 0.5 * limit * limit


@compiled
def _mean(first, last, limit):  # type: ignore[no-untyped-def]
    """Mean of sat along the straight line from `first` to `last`."""
    if abs(last - first) <= 1e-9 * limit:
        return min(max(0.5 * (first + last), -limit), limit)
    return (_area(last, limit) - _area(first, limit)) / (last - first)


@compiled
def follow(tilt, demand, new_demand, limit, recovery, interval):  # type: ignore[no-untyped-def]
    """Move the tilt A, A', A'' (3,) in place by one sample.

    Args:
        tilt: (3,), overwritten [rad, rad/s, rad/s^2].
        demand: (3,) A_d and derivatives at the sample before.
        new_demand: (3,) at the new sample.
        limit: R [rad/s].
        recovery: tau [s].
        interval: T [s].
    """
    error = demand[0] - tilt[0]
    wish = demand[1] + error / recovery
    angle = new_demand[0] - error * np.exp(-interval / recovery)
    left = new_demand[0] - angle
    new_wish = new_demand[1] + left / recovery
    if max(abs(wish), abs(new_wish)) > limit:
        for _ in range(_ITERATIONS):
            angle = tilt[0] + interval * _mean(wish, new_wish, limit)
            left = new_demand[0] - angle
            new_wish = new_demand[1] + left / recovery
    tilt[0] = angle
    if abs(new_wish) > limit:
        tilt[1], tilt[2] = np.copysign(limit, new_wish), 0.0
    else:
        tilt[1], tilt[2] = new_wish, new_demand[2] - left / recovery**2
