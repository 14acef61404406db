"""Uncertainty of what a study of drawn machines finds.

    share of machines        Wilson's score interval (or Clopper and Pearson's exact one)
    difference of two laws   mean over the machines both ran on, with Student's t interval

Machines are drawn once and run with every law, so differences are taken machine by machine.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

LEVEL = 0.95
"""Confidence of all intervals."""


class Interval(NamedTuple):
    """A value with its confidence interval; NaN where there is nothing to estimate from."""

    value: float
    low: float
    high: float
    machines: int  #: How many it rests on.


def share(outcomes: ArrayLike, method: Literal["wilson", "exact"] = "wilson") -> Interval:
    """Share of true outcomes, (n,), with its interval."""
    flags = np.asarray(outcomes, dtype=bool)
    if flags.size == 0:
        return Interval(float("nan"), 0.0, 1.0, 0)
    bounds = stats.binomtest(int(flags.sum()), flags.size).proportion_ci(LEVEL, method=method)
    return Interval(float(flags.mean()), float(bounds.low), float(bounds.high), flags.size)


def mean(values: ArrayLike) -> Interval:
    """Mean of values (n,), those that are NaN left out; no interval from fewer than two."""
    known = np.asarray(values, dtype=float)
    known = known[~np.isnan(known)]
    nan, size = float("nan"), known.size
    if size == 0:
        return Interval(nan, nan, nan, 0)
    middle = float(known.mean())
    if size < 2:
        return Interval(middle, nan, nan, size)
    if np.ptp(known) == 0.0:
        return Interval(middle, middle, middle, size)
    low, high = stats.t.interval(LEVEL, size - 1, loc=middle, scale=float(stats.sem(known)))
    return Interval(middle, float(low), float(high), size)
