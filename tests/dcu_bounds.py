"""Bounds of the DCU's demand, from the motions it is put together from."""

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.motion import ACCELERATION, POSE, VELOCITY
from cmf_mj.control.dcu.state import Dcu

FADE_PEAK_VELOCITY = 4.0 / 27.0  # largest e, at x = 1/3; |e'| is 1 at most and |g'| 1.5
GAP_IMPULSE = 0.2332  # largest impulse response of 1 / (s^2 + 3 s + 3), at 0.605, rounded up
GAP_SPEED = 1.0088  # 3 times the integral of its absolute value, rounded up


def smoothing_norms(dcu: Dcu) -> NDArray[np.float64]:
    """Integrals of the absolute impulse response of the filter of poses and two derivatives."""
    now, norms = dcu.smoothing[:, 4].copy(), np.zeros(3)
    for _ in range(round(1.0 / dcu.frame)):
        norms += np.abs(now[:3])
        now = dcu.smoothing[:, :4] @ now
    return norms


def output_bounds(dcu: Dcu) -> NDArray[np.float64]:
    """Bounds of the demand whatever arrives, (3, 6): |pose|, |velocity|, |acceleration|.

    With V, A the limits of a frame, Tv, Ta stop time and fade time, s the largest slew of the play
    clock, Ts its smoothing, m the overtravel, n, n', n'' the norms of the filter of poses and H the
    hold, over which its input may stand still and then jump:

        pose          P + m
        base, v       (1 + s) times the larger of V + 4/27 A Ta and V (n + n' H)
        base, a       the larger of (1 + s)^2 (1.5 V / Tv + A) + 2 s / Ts (V + 4/27 A Ta)
                      and (1 + s) V (n' + n'' H)

    A gap begins within V and A. With z = e' it obeys z'' + 3 w z' + 3 w^2 z = -w^3 sat(e), whose
    right side is at most 3 w^2 Vr:

        |z| <= V + 0.2332 A / w + 1.0088 Vr,    |z'| <= A + 0.70 w V + 1.40 w Vr

    The demand's acceleration has 0.77 / m velocity^2 more beyond P.
    """
    fast, w = 1.0 + dcu.clock_rate, dcu.gap_rate
    closing = dcu.gap_range * w / 3.0
    kept, first, second = smoothing_norms(dcu)
    motion = dcu.velocity + FADE_PEAK_VELOCITY * dcu.acceleration * dcu.fade_time
    poses = fast * dcu.velocity * (kept + first * dcu.hold)
    velocity = np.maximum(fast * motion, poses)
    velocity += dcu.velocity + GAP_IMPULSE * dcu.acceleration / w + GAP_SPEED * closing
    acceleration = np.maximum(
        fast**2 * (1.5 * dcu.velocity / dcu.stop_time + dcu.acceleration)
        + 2.0 * dcu.clock_rate / dcu.slew_time * motion,
        fast * dcu.velocity * (first + second * dcu.hold),
    )
    acceleration += dcu.acceleration + GAP_IMPULSE * 3.0 * w * (dcu.velocity + 2.0 * closing)
    bounds = np.empty((3, 6))
    bounds[POSE] = dcu.pose + dcu.overtravel
    bounds[VELOCITY] = velocity
    # tanh has the largest curvature 4 / (3 sqrt 3).
    bounds[ACCELERATION] = acceleration + 4.0 / np.sqrt(27.0) * velocity**2 / dcu.overtravel
    return bounds
