"""The time base of recordings that others made: found, refused where it is not even, resampled."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError

Array = NDArray[np.float64]

_OFF, _STEP = 0.4, 0.6
"""How far a stamp may lie from its sample, and an interval from the usual, in samples."""

_GAP = 3.0  #: Intervals, in usual ones, from which on a resampled recording has a gap.


class Clock(NamedTuple):
    """Even times: sample k is at start + k / rate."""

    start: float  #: [s]
    rate: float  #: [Hz]
    off: float  #: Largest distance of a stamp from its sample [s].

    def times(self, count: int) -> Array:
        """Times of so many samples [s]."""
        return self.start + np.arange(count) / self.rate


def rising(time: Array) -> Array:
    """Time stamps [s], (N,), refused with the row where they do not rise."""
    if time.size < 2:
        raise InputError(f"time: has {time.size} samples; allowed: at least 2")
    bad = ~(np.diff(time, prepend=time[0] - 1.0) > 0.0)
    if bad.any():
        row = int(bad.argmax())
        raise InputError(
            f"time: row {row + 1} is at {time[row]:.9g} s after {time[max(row - 1, 0)]:.9g} s; "
            "allowed: times that rise"
        )
    return time


def even_clock(time: Array) -> Clock:
    """The even clock of time stamps [s], (N,); refused with the place where they have none.

    Its rate is the one with the fewest digits that is as close to the stamps as a straight line.
    """
    steps, count = np.diff(rising(time)), np.arange(time.size)
    usual = float(np.median(steps))
    slope, start = np.polyfit(count, time - time[0], 1) if time.size > 2 else (usual, 0.0)
    best = float(np.abs(time - time[0] - start - slope * count).max())
    for digits in range(1, 17):
        rate = float(f"{1.0 / slope:.{digits}g}")
        off = time - time[0] - count / rate
        middle = 0.5 * (off.max() + off.min())
        if np.abs(off - middle).max() <= max(1.2 * best, 1e-9 * time.size / rate):
            break
    worst = float(np.abs(off - middle).max())
    row = int(np.abs(steps - usual).argmax()) + 1
    if worst > _OFF / rate or abs(steps[row - 1] - 1.0 / rate) > _STEP / rate:
        raise InputError(
            f"time: row {row + 1}, {time[row]:.9g} s, is {steps[row - 1]:.6g} s after the row "
            f"before, others are {usual:.6g} s apart; allowed: even times, or `resample` [Hz]"
        )
    # A first stamp in the middle of its rounding is as good as any other.
    return Clock(float(time[0] + (middle if worst > 1e-9 else 0.0)), rate, worst)


def resampled(
    time: Array, columns: Mapping[str, Array], rate: float, bridge: float
) -> tuple[Array, dict[str, Array]]:
    """Times and columns at even times, on straight lines, without a filter.

    Where stamps are farther apart than `bridge` [s] and three usual intervals, there is NaN.
    """
    steps = np.diff(rising(time))
    count = int(np.floor((time[-1] - time[0]) * rate * (1.0 + 1e-12))) + 1
    even = time[0] + np.arange(count) / rate
    widest = max(bridge, _GAP * float(np.median(steps)))
    after = np.clip(np.searchsorted(time, even, side="left"), 1, time.size - 1)
    lost = (
        (time[after] - time[after - 1] > widest) & (even > time[after - 1]) & (even < time[after])
    )
    made = {name: np.interp(even, time, values) for name, values in columns.items()}
    for values in made.values():
        values[lost] = np.nan
    return even, made


def bridged(values: Array, most: int) -> tuple[Array, int]:
    """A column with gaps of at most so many samples filled by straight lines, and their samples."""
    missing = np.isnan(values)
    if not missing.any() or missing.all():
        return values, 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(np.int8), [0]])))
    filled, where = values.copy(), np.arange(values.size)
    inside = np.interp(where, where[~missing], values[~missing])
    total = 0
    for first, end in edges.reshape(-1, 2):
        if end - first <= most and first > 0 and end < values.size:
            filled[first:end] = inside[first:end]
            total += int(end - first)
    return filled, total
