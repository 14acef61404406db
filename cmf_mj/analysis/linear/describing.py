"""Describing function of a closed valve: which share of the two slopes of its flow counts.

The flow into a chamber has a kink at the closed valve, q = s+ e for e > 0 and s- e for e < 0, which
no amplitude is too small for. To a signal e of mean m it answers with the gain

    f s+ + (1 - f) s-,    f = P(e > 0)                                     Gaussian e
                          f = 1/2 + (asin r + r sqrt(1 - r^2)) / pi        e = U (r + sin)

(Bussgang's theorem; the fundamental). The mean is not free. A leg that goes nowhere must neither
gather nor lose oil on average; with S the slope of the flows into both chambers together,

    S+ <e+> = S- <e->

so that the valve is open longer, or further, to the side where it changes the oil less. A mean of
the slopes with f = 1/2 would have the leg drift; at 610 psi of 1500 the share is 0.41.
"""

from typing import Literal, get_args

import numpy as np
from scipy import optimize, special

from cmf_mj.core.errors import InputError, check_name

Excitation = Literal["noise", "sine", "mean"]
"""What moves the valves: Gaussian, as a multisine of many lines nearly is, or one sine; `mean` is
f = 1/2, the plain mean of both slopes that numerical differences give."""

_FARTHEST = 8.0
"""Largest mean over standard deviation that is looked for."""


def outward_share(ratio: float, excitation: Excitation = "noise") -> float:
    """Share f of the slopes to e > 0, for `ratio` = <e+> / <e-> = S- / S+, greater than 0.

    It is 0 or 1 for ratios that a mean of `_FARTHEST` deviations does not reach.
    """
    if not 0.0 < ratio < np.inf:
        raise InputError(f"ratio: {ratio} must be greater than 0 and finite")
    check_name("excitation", excitation, get_args(Excitation))
    if excitation == "mean":
        return 0.5
    if excitation == "sine":
        mean = optimize.brentq(lambda r: _sine_part(r) - ratio * _sine_part(-r), -1.0, 1.0)
        return float(0.5 + (np.arcsin(mean) + mean * np.sqrt(1.0 - mean**2)) / np.pi)

    def surplus(mean: float) -> float:
        return _normal_part(mean) - ratio * _normal_part(-mean)

    if surplus(-_FARTHEST) > 0.0 or surplus(_FARTHEST) < 0.0:
        return float(ratio > 1.0)
    return float(special.ndtr(optimize.brentq(surplus, -_FARTHEST, _FARTHEST)))


def _normal_part(mean: float) -> float:
    """<max(e, 0)> of a Gaussian e of unit variance."""
    return float(np.exp(-0.5 * mean**2) / np.sqrt(2.0 * np.pi) + mean * special.ndtr(mean))


def _sine_part(mean: float) -> float:
    """Pi <max(e, 0)> of e = mean + sin."""
    return float(np.sqrt(1.0 - mean**2) + mean * (0.5 * np.pi + np.arcsin(mean)))
