"""Responses by averaged segments: Welch's method and the report's routine."""

from typing import get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from cmf_mj.analysis.response import spectra
from cmf_mj.analysis.response.spectra import SEGMENT, Complex, Estimate, Estimator, Real
from cmf_mj.core.errors import InputError, check_name


def welch_response(
    x: ArrayLike,
    y: ArrayLike,
    rate: float,
    *,
    estimator: Estimator = "h1",
    segment: float = SEGMENT,
    overlap: float = 0.75,
    band: tuple[float, float] | None = None,
    pad: bool = False,
) -> Estimate:
    """Response of y to x, (N,) each, by Welch's method of averaged, overlapping, windowed segments.

    Nothing is subtracted: take off a standing offset first. Lines below 2 / `segment` lie in the
    main lobe of a Hann window about zero and are left out. `segment` [s] is the inverse of the
    lines' spacing: take it long against the system's memory, several tens of segments for a tight
    bound. `overlap` is the share that the next segment repeats; 0.75 uses all of a Hann window's.
    `band` is the lowest and highest line [Hz].

    `pad` puts a segment of rest at both ends, for an excitation that starts and ends at rest, such
    as a sweep: every instant then has the same weight over the segments, and an output that lags
    its swept input is not weighted differently from it.

    Raises `InputError` for lengths that differ, a segment longer than the record, no input at a
    line.
    """
    check_name("estimator", estimator, get_args(Estimator))
    xs, ys = spectra.as_pair(x, y)
    if segment <= 0.0 or not 0.0 <= overlap < 1.0:
        raise InputError(
            f"segment, overlap: {segment} s, {overlap}; allowed: above 0 s, and 0 to below 1"
        )
    length = round(segment * rate)
    if xs.size < length or length < 4:
        raise InputError(f"segment: {segment} s exceeds the record's {xs.size / rate:.3f} s")
    hop, rest = max(length - int(overlap * length), 1), length if pad else 0
    both = np.pad(np.stack([xs, ys]), ((0, 0), (rest, rest)))
    measured = np.pad(np.ones(xs.size, dtype=bool), rest)
    taper = signal.get_window("hann", length)
    frequency = spectra.line_frequencies(length, rate)
    chosen = spectra.within(frequency, band, 1.5 / segment)
    lines = spectra.transform(both, taper, hop, length)[chosen]
    correlation = spectra.segment_correlation(taper, hop, measured)
    return _single(frequency[chosen], lines[:, :1], lines[:, 1:], correlation, estimator)


def report_response(
    x: ArrayLike,
    y: ArrayLike,
    rate: float,
    *,
    segments: int = 7,
    band: tuple[float, float] | None = None,
) -> Estimate:
    """The report's estimator (Appendix A, FRFunction): the mean of H1 and H2 over 7 segments.

    Half-overlapping segments of L + 1 samples, L = floor((N - 1) / ((segments - 1) / 2 + 1)), every
    L - floor(L / 2) samples until the record is used up, the last one filled up with zeros; each
    under a symmetric Hann window and padded with zeros to N, the length of the record. A straight
    line is taken off first, as by the script that calls it. Lines are therefore interpolated 1/N
    apart: they resolve no more than a segment does, and the errors of neighbours are alike. With
    noise on the output the gain is high by 20 log10((1 + 1/c) / 2): 0.23, 0.47, 1.02 dB at a
    coherence c of 0.95, 0.9, 0.8.

    Left out: the minus sign that Appendix A gives H and takes back when plotting, the sampling rate
    rounded up to a whole number, and the periodic option, a single division of spectra.

    x and y are (N,), `band` the lowest and highest line [Hz]; default all above zero. Raises
    `InputError` for lengths that differ, fewer than 2 segments, a record shorter than they are.
    """
    xs, ys = spectra.as_pair(x, y)
    if segments < 2:
        raise InputError(f"segments: {segments}; allowed: at least 2")
    size = xs.size
    length = int((size - 1) / ((segments - 1) * 0.5 + 1.0))
    if length < 4:
        raise InputError(f"segments: {size} samples are too few for {segments} segments")
    hop = length - length // 2
    count = -(-max(size - (length + 1), 0) // hop) + 1
    tail = (count - 1) * hop + length + 1 - size
    taper = signal.get_window("hann", length + 1, fftbins=False)
    both = np.pad(np.stack([signal.detrend(xs), signal.detrend(ys)]), ((0, 0), (0, tail)))
    frequency = spectra.line_frequencies(size, rate)
    chosen = spectra.within(frequency, band, 0.5 * rate / size)
    lines = spectra.transform(both, taper, hop, size)[chosen]
    correlation = spectra.segment_correlation(taper, hop, np.arange(size + tail) < size)
    return _single(frequency[chosen], lines[:, :1], lines[:, 1:], correlation, "report")


def _single(
    frequency: Real, x: Complex, y: Complex, correlation: Real, estimator: Estimator
) -> Estimate:
    response, coherence, radius, averages = spectra.least_squares(x, y, correlation)
    estimate = Estimate(frequency, response[:, 0, 0], coherence[:, 0], radius[:, 0, 0], averages)
    return from_h1(estimate, estimator)


def from_h1(estimate: Estimate, estimator: Estimator) -> Estimate:
    """Another estimator of one input and one output from H1 and its coherence; same relative bound.

    `h2` is H1 / c, `hv` H1 / sqrt(c), `report` the mean of H1 and H2. Others are refused, and
    matrices.
    """
    check_name("estimator", estimator, get_args(Estimator))
    if estimator == "h1":
        return estimate
    if estimate.response.ndim != 1:
        raise InputError(f"estimator: {estimator!r} is for one input and one output, not a matrix")
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / estimate.coherence
        factor = {"h2": inverse, "hv": np.sqrt(inverse), "report": 0.5 * (1.0 + inverse)}[estimator]
        scaled = {name: getattr(estimate, name) * factor for name in ("response", "radius")}
        return estimate._replace(**scaled)
