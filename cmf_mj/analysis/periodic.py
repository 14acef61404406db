"""Responses of periodic excitations, of one input or several, and of sines; fits of sines."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis import spectra
from cmf_mj.analysis.spectra import Complex, Estimate, Real
from cmf_mj.core.errors import InputError

_DRIVEN_AMPLITUDE = 1e-6  #: Over the largest, from which a line of a periodic input counts.
_NEIGHBOURS = 16  #: Lines about a sine from which its noise is taken.


class SineFit(NamedTuple):
    """Sines with an offset, and what is left."""

    amplitude: NDArray[np.complex128]  #: Complex amplitudes a of Re(a e^(j angle)), (K,) or (K, n).
    offset: NDArray[np.float64]  #: Mean without the sines, () or (n,).
    remainder: NDArray[np.float64]  #: Values less the fit, (N,) or (N, n).


def fit_sines(values: ArrayLike, angle: ArrayLike, *, drift: bool = False) -> SineFit:
    """Fit offset + sum_k Re(a_k e^(j angle_k)) by least squares.

    `values` are one signal (N,), or several (N, n), `angle` 2 pi f t of each sine [rad], (N,) or
    (N, K); `drift` fits a straight line too.
    """
    y = np.asarray(values, dtype=np.float64)
    angles = np.asarray(angle, dtype=np.float64).reshape(y.shape[0], -1)
    count = angles.shape[1]
    columns = [np.cos(angles), np.sin(angles), np.ones((y.shape[0], 1))]
    if drift:
        columns.append(np.linspace(-1.0, 1.0, y.shape[0])[:, None])
    design = np.hstack(columns)
    fit = np.linalg.lstsq(design, y, rcond=None)[0]
    amplitude = np.asarray(fit[:count] - 1j * fit[count : 2 * count], dtype=np.complex128)
    return SineFit(amplitude, np.asarray(fit[2 * count]), y - design @ fit)


def periodic_response(
    x: ArrayLike, y: ArrayLike, rate: float, period: float, lines: NDArray[np.int64]
) -> Estimate:
    """Response to a periodic input, averaged over whole periods but the first: no leakage.

    The scatter from period to period is noise (Pintelon and Schoukens, System Identification, 2nd
    ed., chapter 4). With G_p of period p, var = sum_p |G_p - G|^2 / (P (P - 1)). x and y are (N,),
    `period` [s] is a whole number of samples, `lines` its driven harmonics, (K,), ascending.
    """
    channels = spectra.as_pair(x, y)
    spectra_x, spectra_y = (spectra.period_spectra(values, rate, period) for values in channels)
    power = np.mean(np.abs(spectra_x) ** 2, axis=0)
    x_lines, y_lines = spectra_x[:, lines], spectra_y[:, lines]
    if not np.all(power[lines] > 0.0):
        raise InputError(f"lines: {lines[power[lines] == 0.0][0]} holds no input")
    periods = x_lines.shape[0]
    power_x = np.mean(np.abs(x_lines) ** 2, axis=0)
    cross = np.mean(np.conj(x_lines) * y_lines, axis=0)
    response = cross / power_x
    squares = np.sum(np.abs(y_lines - response * x_lines) ** 2, axis=0) / power_x
    noise = squares / (periods * (periods - 1)) if periods > 1 else np.full_like(squares, np.nan)
    power_y = np.mean(np.abs(y_lines) ** 2, axis=0)
    coherence = spectra.share_of(np.abs(cross) ** 2, power[lines] * power_y)
    radius = spectra.confidence_radius(noise, periods - 1.0)
    averages = np.full(lines.size, float(periods))
    return Estimate(lines / period, response, coherence, radius, averages)


def sine_response(x: ArrayLike, y: ArrayLike, rate: float, frequency: ArrayLike) -> Estimate:
    """Response at the frequency of a sine, or of several in one run, by least squares.

    A constant, the sines and their harmonics up to the third are fitted at once to whole cycles of
    the lowest. The noise at a line is the mean power of the residual on the 16 lines nearest to it.
    x and y are (N,) in steady state, `frequency` [Hz] a number or (K,). Raises `InputError` for
    frequencies out of range or too close, no whole cycle, no input at one of them.
    """
    xs, ys = spectra.as_pair(x, y)
    sines = np.sort(np.atleast_1d(np.asarray(frequency, dtype=float)))
    if sines.size == 0 or not (sines[0] > 0.0 and sines[-1] < 0.5 * rate):
        raise InputError(f"frequency: {sines} Hz; allowed: above 0 and below {0.5 * rate} Hz")
    cycles = int(xs.size * sines[0] / rate + 1e-9)
    if cycles < 1:
        raise InputError(f"frequency: no whole cycle of {sines[0]} Hz in {xs.size} samples")
    size = round(cycles * rate / sines[0])
    resolution = rate / size
    if sines.size > 1 and np.diff(sines).min() < 0.9 * resolution:
        limit = f"the {resolution:.3g} Hz the record resolves"
        raise InputError(f"frequency: {sines} Hz are closer than {limit}")
    fitted = _with_harmonics(sines, resolution, 0.5 * rate)
    angle = 2.0 * np.pi * np.outer(np.arange(size) / rate, fitted)
    channels = np.column_stack([xs, ys])[:size]
    fit = fit_sines(channels, angle)
    tones = fit.amplitude[: sines.size]
    amplitude = np.abs(tones[:, 0])
    if np.any(amplitude <= 1e-12 * np.ptp(channels[:, 0])):
        raise InputError(f"x: holds no sine at {sines[amplitude.argmin()]} Hz")
    response = tones[:, 1] / tones[:, 0]
    residual = np.abs(np.fft.rfft(fit.remainder[:, 1])) ** 2
    power, count = _noise_power(residual, sines / resolution, fitted / resolution)
    noise = power / (0.5 * size * amplitude) ** 2
    explained = np.abs(response) ** 2
    coherence = spectra.share_of(explained, explained + np.nan_to_num(noise))
    radius = spectra.confidence_radius(noise, count)
    return Estimate(sines, response, coherence, radius, count + 1.0)


def _noise_power(power: Real, sines: Real, fitted: Real) -> tuple[Real, Real]:
    """Mean of `power` over the lines next to each sine that no fitted one lies on; their number."""
    order = np.arange(power.size)
    free = order[(np.abs(order[:, None] - fitted) > 0.75).all(axis=1) & (order > 0)]
    nearest = [np.argsort(np.abs(free - sine), kind="stable")[:_NEIGHBOURS] for sine in sines]
    neighbours = [free[rows] for rows in nearest]
    means = [float(power[lines].mean()) if lines.size else np.nan for lines in neighbours]
    return np.array(means), np.array([float(lines.size) for lines in neighbours])


def _with_harmonics(sines: Real, resolution: float, highest: float) -> Real:
    """The frequencies of sines, then those of their harmonics that are clear of all others."""
    frequencies = list(sines)
    for harmonic in np.outer([2, 3], sines).ravel():
        is_clear = min(abs(harmonic - other) for other in frequencies) > 0.5 * resolution
        if is_clear and harmonic < highest - 0.5 * resolution:
            frequencies.append(harmonic)
    return np.array(frequencies)


def matrix_response(
    inputs: Real,
    outputs: Real,
    rate: float,
    period: float,
    *,
    band: tuple[float, float] | None = None,
) -> tuple[Real, Complex]:
    """Lines [Hz], (K,), and response matrix (K, ny, nu) from several inputs to several outputs.

    `inputs` are (N, nu) of one run with interleaved lines, each of the input that is strongest
    there, `outputs` (N, ny). Each column is that of `periodic_response` at its own lines; straight
    lines in the complex plane join these (error up to the spacing squared times H''/8), and outside
    them it is NaN.
    """
    power = np.mean(np.abs(spectra.period_spectra(inputs.T, rate, period)) ** 2, axis=1).T
    power[0] = 0.0
    share = power / power.max(axis=0)
    frequency = np.arange(share.shape[0]) / period
    is_driven = (share > _DRIVEN_AMPLITUDE**2).any(axis=1)
    lines = np.flatnonzero(spectra.lines_within(frequency, band, 0.5 / period) & is_driven)
    owner = np.argmax(share, axis=1)
    if lines.size == 0:
        raise InputError("inputs: no line is driven within the band")
    response = np.empty((lines.size, outputs.shape[1], inputs.shape[1]), dtype=complex)
    for i, j in np.ndindex(response.shape[1:]):
        own_lines = lines[owner[lines] == j]
        column = periodic_response(inputs[:, j], outputs[:, i], rate, period, own_lines)
        response[:, i, j] = _interpolated(frequency[lines], column.frequency, column.response)
    return frequency[lines], response


def stitch(estimates: Sequence[Estimate]) -> Estimate:
    """Join the lines of several rounds in order of frequency.

    Of a line that several rounds measured, that of the highest coherence stays.
    """
    fields = [np.concatenate(field) for field in zip(*estimates, strict=True)]
    frequency = np.concatenate([estimate.frequency for estimate in estimates])
    coherence = np.concatenate([estimate.coherence for estimate in estimates])
    best_rows: list[int] = []
    for row in np.argsort(frequency, kind="stable"):
        if best_rows and np.isclose(frequency[row], frequency[best_rows[-1]], rtol=1e-6, atol=0.0):
            if coherence[row] > coherence[best_rows[-1]]:
                best_rows[-1] = int(row)
        else:
            best_rows.append(int(row))
    return Estimate(*(field[best_rows] for field in fields))


def _interpolated(frequency: Real, lines: Real, response: Complex) -> Complex:
    """A response at its lines [Hz] joined by straight lines; NaN outside them."""
    if lines.size == 0:
        return np.full(frequency.size, np.nan + 0j)
    options = {"left": np.nan, "right": np.nan}
    real = np.interp(frequency, lines, response.real, **options)
    return real + 1j * np.interp(frequency, lines, response.imag, **options)
