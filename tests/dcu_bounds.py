"""Bounds of the DCU's demand, from the motions it is put together from."""

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.motion import ACCELERATION, POSE, VELOCITY
from cmf_mj.control.dcu.settings import Dcu

SLOPE_PEAK_ACCELERATION = 3.95  # largest |C''|, 3.9406 at x = 0.243, rounded up; |C'| is 1 at most
CURVE_PEAK_VELOCITY = 0.0678  # largest |D'|, 0.06779 at x = 0.155, rounded up; |D''| is 1 at most
FADE_PEAK_VELOCITY = 4.0 / 27.0  # largest e, at x = 1/3; |e'| is 1 at most and |g'| 1.5


def output_bounds(dcu: Dcu) -> NDArray[np.float64]:
    """Bounds of the demand whatever arrives, (3, 6): |pose|, |velocity|, |acceleration|.

    With V, A the limits of a frame, r the rejoin limits, Tv, Ta stop time and fade time, s the
    largest slew of the play clock, Ts its smoothing and m the overtravel:

        pose          P + m
        velocity      (1 + s) (V + 4/27 A Ta)  +  V + 0.0678 A Ta + Vr
        acceleration  (1 + s)^2 (1.5 V / Tv + A) + 2 s / Ts (V + 4/27 A Ta)
                      +  A + 3.95 V / Tv + Ar,  and 0.77 / m velocity^2 beyond P

    base first, correction after it. Every quintic between frames keeps V and A, every gap that is
    closed begins within V and A, so that the sums hold at any time.
    """
    fast = 1.0 + dcu.clock_rate
    base = dcu.velocity + FADE_PEAK_VELOCITY * dcu.acceleration * dcu.fade_time
    velocity = (
        fast * base
        + dcu.velocity
        + CURVE_PEAK_VELOCITY * dcu.acceleration * dcu.fade_time
        + dcu.rejoin_velocity
    )
    acceleration = (
        fast**2 * (1.5 * dcu.velocity / dcu.stop_time + dcu.acceleration)
        + 2.0 * dcu.clock_rate / dcu.slew_time * base
        + dcu.acceleration
        + SLOPE_PEAK_ACCELERATION * dcu.velocity / dcu.stop_time
        + dcu.rejoin_acceleration
    )
    bounds = np.empty((3, 6))
    bounds[POSE] = dcu.pose + dcu.overtravel
    bounds[VELOCITY] = velocity
    # tanh has the largest curvature 4 / (3 sqrt 3).
    bounds[ACCELERATION] = acceleration + 4.0 / np.sqrt(27.0) * velocity**2 / dcu.overtravel
    return bounds
