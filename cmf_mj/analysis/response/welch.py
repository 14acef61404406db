"""Responses by averaged segments: Welch's method and the report's routine."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from cmf_mj.analysis.response.estimate import SEGMENT, Estimate, Estimator
from cmf_mj.analysis.response.spectra import (
    _correlation,
    _fit,
    _frozen,
    _known,
    _lines,
    _pair,
    _scaled,
    _segments,
    _single,
    _spectra,
    _Windowing,
    _within,
)
from cmf_mj.core.errors import InputError


def welch_response(
    x: ArrayLike,
    y: ArrayLike,
    rate: float,
    *,
    estimator: Estimator = "h1",
    segment: float = SEGMENT,
    overlap: float = 0.75,
    window: Any = "hann",
    band: tuple[float, float] | None = None,
    pad: bool = False,
) -> Estimate:
    """Response by Welch's method of averaged, overlapping, windowed segments.

    Nothing is subtracted: take off a standing offset first. Lines below 2 / `segment` lie in the
    main lobe of a Hann window about zero and are left out.

    Args:
        x: input, (N,).
        y: output, (N,).
        rate: samples a second [Hz].
        estimator: `h1`, `h2`, `hv`, or `report`, the mean of H1 and H2.
        segment: length of a segment [s]: the lines' spacing is its inverse. Take it long against
            the system's memory; several tens of segments for a tight bound.
        overlap: share of a segment that the next one repeats; 0.75 uses all of a Hann window's.
        window: any window of `scipy.signal.get_window`.
        band: lowest and highest line [Hz]; default all.
        pad: put a segment of rest at both ends. For an excitation that starts and ends at rest,
            such as a sweep: every instant then has the same weight over the segments, and an output
            that lags its swept input is not weighted differently from it.

    Raises:
        InputError: lengths that differ, a segment longer than the record, no input at a line.
    """
    xs, ys = _pair(x, y)
    _known(estimator)
    windowing = _Windowing(rate, segment, overlap, window, band, pad)
    frequency, spectra_x, spectra_y, correlation = _segments(xs[None], ys[None], windowing)
    return from_h1(_single(frequency, _fit(spectra_x, spectra_y, correlation)), estimator)


def report_response(
    x: ArrayLike,
    y: ArrayLike,
    rate: float,
    *,
    segments: int = 7,
    overlap: float = 50.0,
    window: Any = "hann",
    band: tuple[float, float] | None = None,
    detrend: bool = True,
) -> Estimate:
    """The report's estimator (Appendix A, FRFunction): the mean of H1 and H2 over 7 segments.

    Segments of L + 1 samples, L = floor((N - 1) / ((segments - 1) (1 - overlap) + 1)), every
    L - floor(overlap L) samples until the record is used up, the last one filled up with zeros;
    each under a symmetric window and padded with zeros to N, the length of the record. Lines are
    therefore interpolated 1/N apart: they resolve no more than a segment does, and the errors of
    neighbours are alike. With noise on the output the gain is high by 20 log10((1 + 1/c) / 2):
    0.23, 0.47, 1.02 dB at a coherence c of 0.95, 0.9, 0.8.

    Left out: the minus sign that Appendix A gives H and takes back when plotting, the sampling rate
    rounded up to a whole number, and the periodic option, a single division of spectra.

    Args:
        x: input, (N,).
        y: output, (N,).
        rate: samples a second [Hz].
        segments: number of segments, at least 2.
        overlap: of neighbouring segments [%].
        window: any window of `scipy.signal.get_window`; Appendix A has hann, hamming, blackman.
        band: lowest and highest line [Hz]; default all above zero.
        detrend: take a straight line off input and output first, as the script that calls it does.

    Raises:
        InputError: lengths that differ, options out of range, a record shorter than its segments.
    """
    xs, ys = _pair(x, y)
    if segments < 2 or not 0.0 <= overlap < 100.0:
        raise InputError(
            f"segments, overlap: {segments}, {overlap} %; allowed: at least 2, and 0 to below 100 %"
        )
    size = xs.size
    share = overlap / 100.0
    length = int((size - 1) / ((segments - 1) * (1.0 - share) + 1.0))
    if length < 4:
        raise InputError(f"segments: {size} samples are too few for {segments} segments")
    hop = length - int(length * share)
    count = -(-max(size - (length + 1), 0) // hop) + 1
    tail = (count - 1) * hop + length + 1 - size
    if detrend:
        xs, ys = signal.detrend(xs), signal.detrend(ys)
    taper = signal.get_window(window, length + 1, fftbins=False)
    both = np.pad(np.stack([xs, ys]), ((0, 0), (0, tail)))
    frequency = _lines(size, rate)
    chosen = _within(frequency, band, 0.5 * rate / size)
    spectra = _spectra(both, taper, hop, size)[chosen]
    correlation = _correlation(taper, hop, np.arange(size + tail) < size)
    fit = _fit(spectra[:, :1], spectra[:, 1:], correlation)
    return from_h1(_single(frequency[chosen], fit), "report")


def from_h1(estimate: Estimate, estimator: Estimator) -> Estimate:
    """Another estimator of one input and one output from H1 and its coherence; same relative bound.

    `h2` is H1 / c, `hv` H1 / sqrt(c), `report` the mean of H1 and H2.

    Raises:
        InputError: no such estimator, or a matrix.
    """
    _known(estimator)
    if estimator == "h1":
        return estimate
    if estimate.response.ndim != 1:
        raise InputError(f"estimator: {estimator!r} is for one input and one output, not a matrix")
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / estimate.coherence
        factor = {"h2": inverse, "hv": np.sqrt(inverse), "report": 0.5 * (1.0 + inverse)}[estimator]
        return _frozen(
            estimate._replace(
                response=estimate.response * factor,
                radius=estimate.radius * factor,
                noise_variance=_scaled(estimate.noise_variance, factor),
                distortion_variance=_scaled(estimate.distortion_variance, factor),
            )
        )
