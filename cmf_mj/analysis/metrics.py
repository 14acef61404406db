"""Motion-base measures in the terms of AGARD-AR-144, on plain signals.

The names are AGARD's; the report that defines its procedures could not be read, so each measure is
what its docstring says and no more. No acceptance limit is applied. Amplitudes are peak values.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, optimize

from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.core.errors import InputError

Array = NDArray[np.float64]


class Harmonics(NamedTuple):
    """Least-squares fit of a sine and its harmonics."""

    amplitude: Array  #: Peak of each harmonic, the fundamental first, (n,).
    phase: Array  #: Phase of each harmonic at the first sample [rad], sine convention, (n,).
    offset: float  #: Mean.
    remainder: Array  #: What no harmonic explains, (N,).


class MotionNoise(NamedTuple):
    """Acceleration noise of a sinusoidal motion, as shares of the fundamental.

    With A1 the peak of the fundamental, each share is sqrt(2) rms / A1: a signal whose only fault
    is a third harmonic of 3 % has a `low_harmonics` of 0.03.
    """

    fundamental: float  #: A1 [unit of the signal].
    low_harmonics: float  #: Harmonics 2 and 3.
    high_harmonics: float  #: Harmonics 4 to 20, or to the highest below half the sampling rate.
    stochastic: float  #: What is left.
    total: float  #: Root sum of squares of the three shares.
    peak: float  #: Largest deviation from the fundamental over A1.


def harmonics(samples: Array, rate: float, frequency: float, count: int) -> Harmonics:
    """Fit offset + sum a_k sin(2 pi k f t + phi_k), k = 1..count, by least squares.

    The samples (N,) at `rate` [Hz] hold at least one cycle of `frequency` [Hz].
    """
    if frequency <= 0.0 or samples.size < rate / frequency:
        raise InputError(
            f"frequency: {frequency} Hz needs a cycle of {rate / max(frequency, 1e-300):.0f} "
            f"samples; there are {samples.size}"
        )
    if count < 1 or count * frequency >= rate / 2:
        raise InputError(
            f"count: harmonic {count} of {frequency} Hz must be at least 1 and below {rate / 2} Hz"
        )
    angle = 2.0 * np.pi * frequency / rate * np.arange(samples.size)
    orders = np.arange(1, count + 1)
    fit = fit_sines(samples, np.outer(angle, orders))
    phase = np.arctan2(fit.amplitude.real, -fit.amplitude.imag)
    return Harmonics(np.abs(fit.amplitude), phase, float(fit.offset), fit.remainder)


def acceleration_noise(acceleration: Array, rate: float, frequency: float) -> MotionNoise:
    """Split the acceleration of a sinusoidal motion into fundamental, harmonics and noise.

    Cut to whole cycles of `frequency` [Hz] from the end. Half-hertz noise is this at 0.5 Hz over
    amplitude. Harmonics count to the twentieth, less far where the sampling rate allows less; it
    must allow the third.
    """
    cycles = int(np.floor(acceleration.size * frequency / rate + 1e-9))
    if cycles < 1:
        samples = acceleration.size
        raise InputError(f"frequency: {frequency} Hz has no whole cycle in {samples} samples")
    whole_cycles = acceleration[-round(cycles * rate / frequency) :]
    count = min(20, int(np.ceil(rate / 2 / frequency)) - 1)
    if count < 3:
        raise InputError(f"rate: {rate} Hz must exceed {6.0 * frequency} Hz to show harmonic 3")
    fit = harmonics(whole_cycles, rate, frequency, count)
    fundamental = float(fit.amplitude[0])
    low = float(np.linalg.norm(fit.amplitude[1:3]) / fundamental)
    high = float(np.linalg.norm(fit.amplitude[3:]) / fundamental)
    stochastic = float(np.sqrt(2.0 * np.mean(fit.remainder**2)) / fundamental)
    angle = 2.0 * np.pi * frequency / rate * np.arange(whole_cycles.size)
    deviation = whole_cycles - fit.offset - fundamental * np.sin(angle + fit.phase[0])
    total = float(np.sqrt(low**2 + high**2 + stochastic**2))
    peak = float(np.abs(deviation).max() / fundamental)
    return MotionNoise(fundamental, low, high, stochastic, total, peak)


def describing_function(demand: Array, response: Array, rate: float, frequency: float) -> complex:
    """Fundamental of a sinusoidal response over that of its demand, complex."""
    demand_fit, response_fit = (harmonics(x, rate, frequency, 1) for x in (demand, response))
    phase_factor = np.exp(1j * (response_fit.phase[0] - demand_fit.phase[0]))
    return response_fit.amplitude[0] / demand_fit.amplitude[0] * phase_factor


def hysteresis(demand: Array, response: Array, rate: float, frequency: float) -> float:
    """Width of the response-over-demand loop of a very slow sine, over the demand's peak-to-peak.

    The response is folded on one cycle by its harmonics and the widest gap between the rising and
    the falling branch taken. A linear delay d opens the loop too, by sin(2 pi f d): take a
    frequency at which that is negligible. Demand and response are (N,), of at least one cycle.
    """
    count = min(40, int(np.ceil(rate / 2 / frequency)) - 1)
    demand_fit = harmonics(demand, rate, frequency, 1)
    response_fit = harmonics(response, rate, frequency, count)
    # On the angle a of the demand, rising and falling branch meet at a and pi - a.
    angle = np.linspace(-np.pi / 2, np.pi / 2, 721)
    orders = np.arange(1, count + 1)
    phase = response_fit.phase - orders * demand_fit.phase[0]

    def branch(angles: Array) -> Array:
        return np.asarray(np.sin(np.outer(angles, orders) + phase) @ response_fit.amplitude)

    gap = np.abs(branch(angle) - branch(np.pi - angle)).max()
    return float(gap / (2.0 * demand_fit.amplitude[0]))


def dynamic_threshold(acceleration: Array, rate: float, size: float, at: float) -> float:
    """Time from an acceleration step of `size` at the time `at` to 63 % of it [s]; NaN if never."""
    start = round(at * rate)
    share = (acceleration[start:] - acceleration[max(start - 1, 0)]) / size
    rows_beyond = np.flatnonzero(share >= 1.0 - np.exp(-1.0))
    if rows_beyond.size == 0:
        return float("nan")
    row = int(rows_beyond[0])
    if row == 0:
        return 0.0
    fraction = (1.0 - np.exp(-1.0) - share[row - 1]) / (share[row] - share[row - 1])
    return float((row - 1 + fraction) / rate)


def transient_delay(demand: Array, response: Array, rate: float) -> float:
    """Delay up to 0.5 s of the largest correlation coefficient of a demand with its response [s].

    The demand is at rest at the start. (A slow transient pulls the peak of a cross-correlation
    towards where more of it overlaps.)
    """
    time = np.arange(demand.size) / rate
    spline = interpolate.make_interp_spline(time, demand, k=3)

    def negative_correlation(delay: float) -> float:
        shifted = spline(np.maximum(time - delay, 0.0))
        return -float(np.corrcoef(shifted, response)[0, 1])

    grid = np.linspace(0.0, 0.5, 26)
    best = grid[int(np.argmin([negative_correlation(delay) for delay in grid]))]
    step = grid[1]
    bounds = (max(best - step, 0.0), best + step)
    return float(optimize.minimize_scalar(negative_correlation, bounds=bounds, method="bounded").x)
