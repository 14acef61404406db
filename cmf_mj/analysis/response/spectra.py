"""Spectra, fits, variances and checks that the estimators share."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cmf_mj.analysis.response.estimate import CONFIDENCE, Complex, Estimate, Real
from cmf_mj.core.errors import InputError


def transform(x: Real, window: Real, hop: int, size: int) -> Complex:
    """Spectra (F, channels, S) of the segments of x (channels, N), phases from the first sample."""
    stft = signal.ShortTimeFFT(window, hop, 1.0, fft_mode="onesided", mfft=size, phase_shift=None)
    count = (x.shape[-1] - window.size) // hop + 1
    spectra = stft.stft(x, p0=0, p1=count, k_offset=stft.m_num_mid)
    turn = np.exp(-2j * np.pi * np.outer(stft.f, hop * np.arange(count)))
    return np.asarray(np.swapaxes(spectra, 0, 1) * turn[:, None, :])


def segment_correlation(window: Real, hop: int, measured: NDArray[np.bool_]) -> Real:
    """Correlation (S, S) between segments of white noise that is there where `measured`."""
    frames = np.lib.stride_tricks.sliding_window_view(measured, window.size)[::hop]
    count = frames.shape[0]
    correlation = np.zeros((count, count))
    for m in range(min(count, -(-window.size // hop))):
        product = np.zeros(window.size)
        product[m * hop :] = window[m * hop :] * window[: window.size - m * hop]
        k = np.arange(count - m)
        correlation[k, k + m] = correlation[k + m, k] = frames[: count - m] @ product
    return correlation / np.sum(window**2)


def period_spectra(x: Real, rate: float, period: float, transient: int) -> Complex:
    """Spectra (..., P, F) of the whole periods of x (..., N) after the transient ones."""
    size = round(period * rate)
    if size < 3 or abs(size - period * rate) > 1e-6:
        raise InputError(f"period: {period} s is not a whole number of samples at {rate} Hz")
    count = x.shape[-1] // size
    if not 0 <= transient < count:
        raise InputError(
            f"transient: {transient} of the record's {count} periods leave none; allowed: 0 to "
            f"{count - 1}"
        )
    whole = x[..., transient * size : count * size]
    return np.asarray(np.fft.rfft(whole.reshape(*whole.shape[:-1], -1, size), axis=-1))


class Fit(NamedTuple):
    """Responses by least squares."""

    response: Complex  # (K, ny, nu)
    coherence: Real  # (K, ny)
    radius: Real  # (K, ny, nu)
    averages: Real  # (K,)


def least_squares(x: Complex, y: Complex, correlation: Real) -> Fit:
    """Y = H X by least squares on each line; x (K, nu, S), y (K, ny, S), correlation (S, S)."""
    inputs, count = x.shape[1:]
    if count < inputs:
        raise InputError(f"inputs: {count} averages cannot tell {inputs} inputs apart")
    size = np.linalg.norm(x, axis=2, keepdims=True)
    if not np.all(size > 0.0):
        raise InputError(f"inputs: input {np.argwhere(size <= 0.0)[0][1] + 1} is zero at a line")
    basis, triangle = np.linalg.qr(_adjoint(x / size))  # (K, S, nu), (K, nu, nu)
    if np.abs(np.diagonal(triangle, axis1=1, axis2=2)).min() < 1e-6:
        raise InputError("inputs: not independent of each other; drive them in as many runs")
    inverse = np.linalg.inv(triangle)
    response = y @ basis @ _adjoint(inverse) / np.swapaxes(size, 1, 2)
    unexplained = np.sum(np.abs(y - response @ x) ** 2, axis=2)  # (K, ny)
    total = np.sum(np.abs(y) ** 2, axis=2)
    spread = np.tensordot(correlation, basis, axes=(1, 1)).transpose(1, 0, 2)  # R e
    inner = _adjoint(basis) @ spread
    left = np.trace(correlation) - np.trace(inner, axis1=1, axis2=2).real
    square = np.sum(correlation**2) - 2.0 * np.sum(np.abs(spread) ** 2, axis=(1, 2))
    square += np.sum(np.abs(inner) ** 2, axis=(1, 2))
    known = (left > 1e-9 * count) & (count > inputs)
    n = np.where(known, left**2 / np.where(known, square, 1.0), 0.0)
    noise = unexplained / np.where(known, left, 1.0)[:, None]
    gain = np.einsum("kij,kjl,kil->ki", inverse, inner, np.conj(inverse)).real / size[:, :, 0] ** 2
    radius = confidence_radius(noise[:, :, None] * gain[:, None, :], n[:, None, None])
    return Fit(response, 1.0 - share_of(unexplained, total, 1.0), radius, n + 1.0)


def _adjoint(a: Complex) -> Complex:
    return np.conj(np.swapaxes(a, -1, -2))


def confidence_radius(variance: Real, averages: ArrayLike) -> Real:
    """95 % radius of a complex mean of this variance, itself known from n averages; n = 0: inf."""
    n = np.broadcast_to(np.asarray(averages, dtype=float), variance.shape)
    known = n > 0.0
    safe = np.where(known, n, 1.0)
    with np.errstate(over="ignore"):
        fisher = safe * np.expm1(-np.log(1.0 - CONFIDENCE) / safe)
    return np.where(known, np.sqrt(fisher * np.where(known, variance, 0.0)), np.inf)


def as_pair(x: ArrayLike, y: ArrayLike) -> tuple[Real, Real]:
    """Input and output as arrays (N,) of one length."""
    xs, ys = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if xs.ndim != 1 or xs.shape != ys.shape:
        raise InputError(f"x, y: shapes are {xs.shape}, {ys.shape}; both must be (N,)")
    return xs, ys


def line_frequencies(size: int, rate: float) -> Real:
    """Frequencies of the real transform of `size` samples [Hz], (size // 2 + 1,)."""
    return np.asarray(np.arange(size // 2 + 1) * (rate / size), dtype=np.float64)


def within(frequency: Real, band: tuple[float, float] | None, above: float) -> NDArray[np.bool_]:
    """Lines that lie in the band and above a frequency [Hz]."""
    low, high = band if band is not None else (0.0, np.inf)
    slack = 1e-9 * frequency[-1]
    return (frequency > above) & (frequency >= low - slack) & (frequency <= high + slack)


def share_of(part: Real, whole: Real, empty: float = 0.0) -> Real:
    """Part over whole, 0 to 1, and `empty` where there is nothing."""
    some = whole > 0.0
    return np.where(some, np.clip(part / np.where(some, whole, 1.0), 0.0, 1.0), empty)


def frozen(estimate: Estimate) -> Estimate:
    """The estimate, its arrays made read-only."""
    for values in estimate:
        if isinstance(values, np.ndarray):
            values.setflags(write=False)
    return estimate
