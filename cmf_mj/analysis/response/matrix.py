"""Full response matrices from one run or several, and the joining of rounds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.analysis.response.estimate import DRIVEN, SEGMENT, Estimate, Real
from cmf_mj.analysis.response.spectra import (
    _between,
    _fit,
    _frozen,
    _periods,
    _runs,
    _segments,
    _stacked,
    _Windowing,
    _within,
)
from cmf_mj.core.errors import InputError


def matrix_response(
    inputs: ArrayLike,
    outputs: ArrayLike,
    rate: float,
    *,
    period: float | None = None,
    segment: float = SEGMENT,
    transient: int = 1,
    overlap: float = 0.75,
    window: Any = "hann",
    band: tuple[float, float] | None = None,
    pad: bool = False,
    interpolate: bool = False,
) -> Estimate:
    """Response matrix from several inputs to several outputs, H = S_yx S_xx^-1 at each line.

    From several runs, such as one an axis, or six with orthogonal multisines, every line gives the
    whole matrix. From a single run with interleaved lines, each driven by one input, a column is
    known at its lines only and is NaN at the others; `interpolate` draws straight lines in the
    complex plane between a column's lines (error up to the spacing squared times H''/8, which
    `radius` does not hold) and leaves NaN outside them. A line driven by several inputs needs as
    many independent periods, segments or runs.

    Args:
        inputs: (N, nu) of one run, or (E, N, nu) of several.
        outputs: (N, ny) or (E, N, ny).
        rate: samples a second [Hz].
        period: of periodic inputs [s]; spectra are then taken over whole periods, else by Welch's
            method with the options of `welch_response`, and every input counts as driven.
        segment: see `welch_response`.
        transient: first periods to drop.
        overlap: see `welch_response`.
        window: see `welch_response`.
        band: see `welch_response`.
        pad: see `welch_response`.
        interpolate: fill columns between their lines.

    Returns:
        Response (K, ny, nu), radius alike, multiple coherence (K, ny).

    Raises:
        InputError: shapes that do not match, inputs that are not independent at a line.
    """
    xs, ys = _runs("inputs", inputs), _runs("outputs", outputs)
    if xs.shape[:2] != ys.shape[:2]:
        raise InputError(f"inputs, outputs: {xs.shape}, {ys.shape}; runs and samples must agree")
    if period is None:
        windowing = _Windowing(rate, segment, overlap, window, band, pad)
        runs = [_segments(x.T, y.T, windowing) for x, y in zip(xs, ys, strict=True)]
        frequency = runs[0][0]
        spectra_x, spectra_y = (np.concatenate([r[i] for r in runs], axis=2) for i in (1, 2))
        correlation: Real = np.asarray(np.kron(np.eye(len(runs)), runs[0][3]), dtype=np.float64)
        driven = np.ones(spectra_x.shape[:2], dtype=bool)
    else:
        spectra_x = _stacked(_periods("inputs", np.swapaxes(xs, 1, 2), rate, period, transient))
        spectra_y = _stacked(_periods("outputs", np.swapaxes(ys, 1, 2), rate, period, transient))
        correlation = np.eye(spectra_x.shape[2])
        power = np.sum(np.abs(spectra_x) ** 2, axis=2)
        power[0] = 0.0
        driven = power > DRIVEN**2 * power.max(axis=0)
        frequency = np.arange(power.shape[0]) / period
        chosen = _within(frequency, band, 0.5 / period) & driven.any(axis=1)
        frequency, driven = frequency[chosen], driven[chosen]
        spectra_x, spectra_y = spectra_x[chosen], spectra_y[chosen]
    if frequency.size == 0:
        raise InputError("inputs: no line is driven within the band")
    shape = (frequency.size, spectra_y.shape[1], spectra_x.shape[1])
    response, radius = np.full(shape, np.nan + 0j), np.full(shape, np.nan)
    coherence, averages = np.empty(shape[:2]), np.empty(shape[0])
    for pattern in np.unique(driven, axis=0):
        rows = np.flatnonzero((driven == pattern).all(axis=1))
        columns = np.flatnonzero(pattern)
        fit = _fit(spectra_x[np.ix_(rows, columns)], spectra_y[rows], correlation)
        place = np.ix_(rows, np.arange(shape[1]), columns)
        response[place], radius[place] = fit.response, fit.radius
        coherence[rows], averages[rows] = fit.coherence, fit.averages
    if interpolate:
        for i, j in np.ndindex(shape[1:]):
            known = driven[:, j]
            response[:, i, j] = _between(frequency, frequency[known], response[known, i, j])
            radius[:, i, j] = _between(frequency, frequency[known], radius[known, i, j]).real
    return _frozen(Estimate(frequency, response, coherence, radius, averages))


def stitch(estimates: Sequence[Estimate]) -> Estimate:
    """Join the lines of several rounds in order of frequency.

    Of a line that several rounds measured, that of the highest coherence stays, in a matrix the
    highest mean coherence.

    Raises:
        InputError: no rounds, or rounds of different units or shapes.
    """
    rounds = list(estimates)
    if not rounds:
        raise InputError("estimates: none given; at least one is needed")
    units = sorted({estimate.unit for estimate in rounds})
    if len(units) > 1:
        raise InputError(f"estimates: units {', '.join(map(repr, units))} have nothing in common")
    shapes = {estimate.response.shape[1:] for estimate in rounds}
    if len(shapes) > 1:
        raise InputError(f"estimates: shapes a line {sorted(shapes)}; must be the same")
    frequency = np.concatenate([estimate.frequency for estimate in rounds])
    coherence = np.concatenate([estimate.coherence for estimate in rounds])
    rank = coherence.reshape(frequency.size, -1).mean(axis=1)
    kept: list[int] = []
    for i in np.argsort(frequency, kind="stable"):
        if kept and np.isclose(frequency[i], frequency[kept[-1]], rtol=1e-6, atol=0.0):
            kept[-1] = int(i) if rank[i] > rank[kept[-1]] else kept[-1]
        else:
            kept.append(int(i))

    def joined(name: str) -> Any:
        parts = [getattr(estimate, name) for estimate in rounds]
        if any(part is None for part in parts):
            return None
        return np.concatenate(parts)[kept]

    arrays = {name: joined(name) for name in Estimate._fields if name != "unit"}
    return _frozen(Estimate(**arrays, unit=units[0]))
