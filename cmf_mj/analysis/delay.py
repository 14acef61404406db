"""Delays between two signals: of stationary ones, of transients, of one frequency.

correlation_delay   lag of the largest cross-correlation: the mean delay over the band of a
stationary signal
transient_delay     shift of the largest correlation coefficient: a slow transient, unlike a
stationary signal, pulls the peak of a cross-correlation towards where more
of it overlaps
phase_delay         -arg(after / before) / w of complex amplitudes at w; adds up along a chain
"""

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, optimize, signal

Signal = NDArray[np.float64]


def correlation_delay(
    demand: Signal, response: Signal, rate: float, *, longest: float = 2.0
) -> float:
    """Delay of the response [s]: lag of the largest cross-correlation, parabola through the peak.

    Means are removed. `longest` is the largest delay looked for [s], less than the period of a
    periodic demand.
    """
    x, y = demand - demand.mean(), response - response.mean()
    correlation = signal.correlate(y, x, method="fft")
    lags = signal.correlation_lags(y.size, x.size)
    near = np.abs(lags) <= min(round(longest * rate), x.size // 2)
    # Over the samples that overlap: the sum alone would pull the peak towards no lag.
    values = correlation[near] / (x.size - np.abs(lags[near]))
    peak = int(values.argmax())
    shift = 0.0
    if 0 < peak < values.size - 1:
        before, top, after = values[peak - 1 : peak + 2]
        bend = before - 2.0 * top + after
        shift = 0.5 * (before - after) / bend if bend != 0.0 else 0.0
    return float((lags[near][peak] + shift) / rate)


def transient_delay(
    demand: Signal, response: Signal, rate: float, *, longest: float = 0.5
) -> float:
    """Delay that brings a demand closest to its response, offset and gain left free [s].

    The demand is at rest at the start; `longest` is the largest delay looked for [s].
    """
    time = np.arange(demand.size) / rate
    spline = interpolate.make_interp_spline(time, demand, k=3)

    def unlike(delay: float) -> float:
        shifted = spline(np.maximum(time - delay, 0.0))
        return -float(np.corrcoef(shifted, response)[0, 1])

    tried = np.linspace(0.0, longest, 26)
    near = tried[int(np.argmin([unlike(delay) for delay in tried]))]
    step = tried[1]
    bounds = (max(near - step, 0.0), near + step)
    return float(optimize.minimize_scalar(unlike, bounds=bounds, method="bounded").x)


def phase_delay(before: complex, after: complex, frequency: float) -> float:
    """Delay [s] between complex amplitudes at a frequency [Hz]; negative where it leads."""
    return float(-np.angle(after / before) / (2.0 * np.pi * frequency))
