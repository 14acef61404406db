"""Frequency responses from sampled inputs and outputs: the arithmetic, without records.

All estimators weigh spectra X_k of the input and Y_k of the output over segments, periods or runs
k = 1..S. With S_xy = mean(conj(X_k) Y_k), and so on,

    H1 = S_xy / S_xx    H2 = S_yy / S_yx = H1 / c    report = (H1 + H2) / 2
    c = |S_xy|^2 / (S_xx S_yy)    (coherence)

H1 is free of bias under noise on the output. The demand of a simulator is free of noise: H1.

The bound is the radius r of the circle in the complex plane that holds the true response with
95 % probability, for noise on the output that is Gaussian and flat across a line,

    r^2 = F(2, 2 n) var,    F = n (0.05^(-1/n) - 1),
    var = e^H R e / |X|^2 sum |Y_k - H X_k|^2 / (tr R - e^H R e),    e = X / |X|

where F is the 95 % point of Fisher's distribution, R the correlation between segments that share
samples, and n = (tr (I-P)R)^2 / tr ((I-P)R)^2 with P = e e^H (Satterthwaite) the averages that the
noise has. Without overlap R = I, n = S - 1, and this is the bound of Bendat and Piersol, Random
Data. It covers random error only, neither leakage nor the bias of the report's estimator.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cmf_mj.core.arrays import shaped
from cmf_mj.core.errors import InputError

Estimator = Literal["h1", "report"]
Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Band = tuple[float, float]  #: Lowest and highest frequency [Hz].
SEGMENT = 20.0  #: Length of Welch's segments [s]: lines every 0.05 Hz.
CONFIDENCE = 0.95  #: Probability that the true response lies within the bound.


class Estimate(NamedTuple):
    """A frequency response with what is known about its error."""

    frequency: Real  #: Lines [Hz], (K,), ascending.
    response: Complex  #: (K,).
    coherence: Real  #: Share of the output's power that the input explains, 0 to 1, (K,).
    radius: Real  #: Of the 95 % circle about `response`, (K,); infinite where nothing is known.
    averages: Real  #: Effective number of averages behind the noise estimate, n + 1, (K,).


def segment_spectra(x: Real, window: Real, hop: int, size: int) -> Complex:
    """Spectra (F, channels, S) of the segments of x (channels, N), phases from the first sample."""
    stft = signal.ShortTimeFFT(window, hop, 1.0, fft_mode="onesided", mfft=size, phase_shift=None)
    count = (x.shape[-1] - window.size) // hop + 1
    spectra = stft.stft(x, p0=0, p1=count, k_offset=stft.m_num_mid)
    segment_phase = np.exp(-2j * np.pi * np.outer(stft.f, hop * np.arange(count)))
    return np.asarray(np.swapaxes(spectra, 0, 1) * segment_phase[:, None, :])


def segment_correlation(window: Real, hop: int, measured: NDArray[np.bool_]) -> Real:
    """Correlation (S, S) between segments of white noise on the samples that are `measured`."""
    segments = np.lib.stride_tricks.sliding_window_view(measured, window.size)[::hop]
    count = segments.shape[0]
    correlation = np.zeros((count, count))
    for distance in range(min(count, math.ceil(window.size / hop))):
        shift = distance * hop
        product = np.zeros(window.size)
        product[shift:] = window[shift:] * window[: window.size - shift]
        first = np.arange(count - distance)
        second = first + distance
        correlation[first, second] = segments[: count - distance] @ product
        correlation[second, first] = correlation[first, second]
    return correlation / np.sum(window**2)


def period_spectra(x: Real, rate: float, period: float) -> Complex:
    """Spectra (..., P, F) of the whole periods of x (..., N) after the first, the transient."""
    size = round(period * rate)
    if size < 3 or abs(size - period * rate) > 1e-6:
        raise InputError(f"period: {period} s is not a whole number of samples at {rate} Hz")
    count = x.shape[-1] // size
    if count < 2:
        raise InputError(f"period: the record has {count} of {period} s; allowed: at least 2")
    whole = x[..., size : count * size]
    return np.asarray(np.fft.rfft(whole.reshape(*whole.shape[:-1], -1, size), axis=-1))


def _least_squares(frequency: Real, x: Complex, y: Complex, correlation: Real) -> Estimate:
    """Y = H X on each line; spectra x and y (K, S), correlation of segments (S, S)."""
    norm = np.linalg.norm(x, axis=1)
    if not np.all(norm > 0.0):
        raise InputError(f"x: is zero at {frequency[np.argmin(norm)]} Hz")
    e = np.conj(x) / norm[:, None]
    response = np.sum(e * y, axis=1) / norm
    unexplained = np.sum(np.abs(y - response[:, None] * x) ** 2, axis=1)
    r_e = e @ correlation
    e_r_e = np.sum(np.conj(e) * r_e, axis=1).real
    freedom = np.trace(correlation) - e_r_e  # tr (I - P) R
    square = np.sum(correlation**2) - 2.0 * np.sum(np.abs(r_e) ** 2, axis=1) + e_r_e**2
    has_noise = freedom > 1e-9 * e.shape[1]
    n = np.where(has_noise, freedom**2 / np.where(has_noise, square, 1.0), 0.0)
    variance = unexplained / np.where(has_noise, freedom, 1.0) * e_r_e / norm**2
    coherence = 1.0 - share_of(unexplained, np.sum(np.abs(y) ** 2, axis=1), 1.0)
    return Estimate(frequency, response, coherence, confidence_radius(variance, n), n + 1.0)


def confidence_radius(variance: Real, averages: ArrayLike) -> Real:
    """95 % radius of a complex mean of this variance, estimated from n averages; n = 0: inf."""
    n = np.broadcast_to(np.asarray(averages, dtype=float), variance.shape)
    is_known = n > 0.0
    divisor = np.where(is_known, n, 1.0)
    with np.errstate(over="ignore"):
        fisher = divisor * np.expm1(-np.log(1.0 - CONFIDENCE) / divisor)
    return np.where(is_known, np.sqrt(fisher * np.where(is_known, variance, 0.0)), np.inf)


def as_pair(x: ArrayLike, y: ArrayLike) -> tuple[Real, Real]:
    """Input and output as arrays (N,) of one length, of finite numbers."""
    xs = shaped("x", x, None)
    return xs, shaped("y", y, xs.size)


def line_frequencies(size: int, rate: float) -> Real:
    """Frequencies of the real transform of `size` samples [Hz], (size // 2 + 1,)."""
    return np.asarray(np.arange(size // 2 + 1) * (rate / size), dtype=np.float64)


def lines_within(frequency: Real, band: Band | None, above: float) -> NDArray[np.bool_]:
    """Lines that lie in the band and above a frequency [Hz]."""
    low, high = band if band is not None else (0.0, np.inf)
    rounding = 1e-9 * frequency[-1]
    return (frequency > above) & (frequency >= low - rounding) & (frequency <= high + rounding)


def share_of(part: Real, whole: Real, of_nothing: float = 0.0) -> Real:
    """Part over whole, 0 to 1, and `of_nothing` where the whole is 0."""
    is_positive = whole > 0.0
    share = np.clip(part / np.where(is_positive, whole, 1.0), 0.0, 1.0)
    return np.where(is_positive, share, of_nothing)


def welch_response(
    x: ArrayLike,
    y: ArrayLike,
    rate: float,
    *,
    segment: float = SEGMENT,
    overlap: float = 0.75,
    band: Band | None = None,
    pad: bool = False,
) -> Estimate:
    """H1 of y to x, (N,) each, by Welch's method of averaged, overlapping, windowed segments.

    Nothing is subtracted: take off a standing offset first. Lines below 2 / `segment` lie in the
    main lobe of a Hann window about zero and are left out. `segment` [s] is the inverse of the
    lines' spacing: take it long against the system's memory. `overlap` is the share that the next
    segment repeats, `band` the lowest and highest line [Hz]. `pad` puts a segment of rest at both
    ends, for an excitation that starts and ends at rest, such as a sweep: every instant then has
    the same weight. Raises `InputError` for lengths that differ, numbers that are not finite, a
    segment longer than the record or below 4 samples, no input at a line.
    """
    xs, ys = as_pair(x, y)
    if segment <= 0.0 or not 0.0 <= overlap < 1.0:
        allowed = "above 0 s, and 0 to below 1"
        raise InputError(f"segment, overlap: {segment} s, {overlap}; allowed: {allowed}")
    length = round(segment * rate)
    if xs.size < length:
        raise InputError(f"segment: {segment} s exceeds the record's {xs.size / rate:.3f} s")
    if length < 4:
        raise InputError(f"segment: {segment} s is less than 4 samples, {4.0 / rate} s")
    hop, rest = max(length - int(overlap * length), 1), length if pad else 0
    channels = np.pad(np.stack([xs, ys]), ((0, 0), (rest, rest)))
    measured = np.pad(np.ones(xs.size, dtype=bool), rest)
    taper = signal.get_window("hann", length)
    frequency = line_frequencies(length, rate)
    in_band = lines_within(frequency, band, 1.5 / segment)
    lines = segment_spectra(channels, taper, hop, length)[in_band]
    correlation = segment_correlation(taper, hop, measured)
    return _least_squares(frequency[in_band], lines[:, 0], lines[:, 1], correlation)


def report_response(
    x: ArrayLike, y: ArrayLike, rate: float, *, band: Band | None = None
) -> Estimate:
    """The report's estimator (Appendix A, FRFunction): the mean of H1 and H2 over 7 or 8 segments.

    Half-overlapping segments of L + 1 samples, L = floor((N - 1) / 4), every L - floor(L / 2)
    samples, the last one filled up with zeros; each under a symmetric Hann window and padded with
    zeros to N, the length of the record, less a straight line. Lines are therefore interpolated 1/N
    apart: they resolve no more than a segment does, and the errors of neighbours are alike. With
    noise on the output the gain is high by 20 log10((1 + 1/c) / 2): 0.23, 0.47, 1.02 dB at a
    coherence c of 0.95, 0.9, 0.8.

    x and y are (N,), `band` the lowest and highest line [Hz]; default all above zero. Raises
    `InputError` for lengths that differ, and a record shorter than the segments.
    """
    xs, ys = as_pair(x, y)
    size = xs.size
    length = (size - 1) // 4
    if length < 4:
        raise InputError(f"segments: {size} samples are too few; allowed: 17 or more")
    hop = length - length // 2
    count = math.ceil(max(size - (length + 1), 0) / hop) + 1
    tail = (count - 1) * hop + length + 1 - size
    taper = signal.get_window("hann", length + 1, fftbins=False)
    channels = np.pad(np.stack([signal.detrend(xs), signal.detrend(ys)]), ((0, 0), (0, tail)))
    frequency = line_frequencies(size, rate)
    in_band = lines_within(frequency, band, 0.5 * rate / size)
    lines = segment_spectra(channels, taper, hop, size)[in_band]
    correlation = segment_correlation(taper, hop, np.arange(size + tail) < size)
    h1 = _least_squares(frequency[in_band], lines[:, 0], lines[:, 1], correlation)
    return mean_of_h1_and_h2(h1)


def mean_of_h1_and_h2(h1: Estimate) -> Estimate:
    """The mean of H1 and H2 from H1 and its coherence; same relative bound."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / h1.coherence
        factor = 0.5 * (1.0 + inverse)
        return h1._replace(response=h1.response * factor, radius=h1.radius * factor)
