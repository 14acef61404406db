"""Full response matrices from one run or several, and the joining of rounds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.analysis.response import spectra
from cmf_mj.analysis.response.estimate import DRIVEN, SEGMENT, Complex, Estimate, Real
from cmf_mj.core.errors import InputError


def matrix_response(
    inputs: ArrayLike,
    outputs: ArrayLike,
    rate: float,
    *,
    period: float | None = None,
    segment: float = SEGMENT,
    transient: int = 1,
    band: tuple[float, float] | None = None,
    interpolate: bool = False,
) -> Estimate:
    """Response matrix from several inputs to several outputs, H = S_yx S_xx^-1 at each line.

    From several runs, such as one an axis, or six with orthogonal multisines, every line gives the
    whole matrix. From a single run with interleaved lines, each driven by one input, a column is
    known at its lines only and is NaN at the others; `interpolate` draws straight lines in the
    complex plane between a column's lines (error up to the spacing squared times H''/8, which
    `radius` does not hold) and leaves NaN outside them. A line driven by several inputs needs as
    many independent periods, segments or runs.

    `inputs` are (N, nu) of one run or (E, N, nu) of several, `outputs` (N, ny) or (E, N, ny).
    With a `period` [s] spectra are taken over whole periods after `transient` ones, else by
    Welch's method as by `welch_response`, and every input counts as driven. The response is
    (K, ny, nu), its radius alike, the multiple coherence (K, ny).
    """
    xs, ys = _runs("inputs", inputs), _runs("outputs", outputs)
    if xs.shape[:2] != ys.shape[:2]:
        raise InputError(f"inputs, outputs: {xs.shape}, {ys.shape}; runs and samples must agree")
    if period is None:
        windowing = spectra.Windowing(rate, segment, band=band)
        runs = [spectra.segment_spectra(x.T, y.T, windowing) for x, y in zip(xs, ys, strict=True)]
        frequency = runs[0][0]
        spectra_x, spectra_y = (np.concatenate([r[i] for r in runs], axis=2) for i in (1, 2))
        correlation: Real = np.asarray(np.kron(np.eye(len(runs)), runs[0][3]), dtype=np.float64)
        driven = np.ones(spectra_x.shape[:2], dtype=bool)
    else:
        spectra_x = _stacked(
            spectra.period_spectra("inputs", np.swapaxes(xs, 1, 2), rate, period, transient)
        )
        spectra_y = _stacked(
            spectra.period_spectra("outputs", np.swapaxes(ys, 1, 2), rate, period, transient)
        )
        correlation = np.eye(spectra_x.shape[2])
        power = np.sum(np.abs(spectra_x) ** 2, axis=2)
        power[0] = 0.0
        driven = power > DRIVEN**2 * power.max(axis=0)
        frequency = np.arange(power.shape[0]) / period
        chosen = spectra.within(frequency, band, 0.5 / period) & driven.any(axis=1)
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
        fit = spectra.least_squares(spectra_x[np.ix_(rows, columns)], spectra_y[rows], correlation)
        place = np.ix_(rows, np.arange(shape[1]), columns)
        response[place], radius[place] = fit.response, fit.radius
        coherence[rows], averages[rows] = fit.coherence, fit.averages
    if interpolate:
        for i, j in np.ndindex(shape[1:]):
            known = driven[:, j]
            response[:, i, j] = _between(frequency, frequency[known], response[known, i, j])
            radius[:, i, j] = _between(frequency, frequency[known], radius[known, i, j]).real
    return spectra.frozen(Estimate(frequency, response, coherence, radius, averages))


def stitch(estimates: Sequence[Estimate]) -> Estimate:
    """Join the lines of several rounds in order of frequency.

    Of a line that several rounds measured, that of the highest coherence stays, in a matrix the
    highest mean coherence. Rounds of different shapes are refused.
    """
    rounds = list(estimates)
    if not rounds:
        raise InputError("estimates: none given; at least one is needed")
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

    return spectra.frozen(Estimate(*(joined(name) for name in Estimate._fields)))


def _runs(name: str, values: ArrayLike) -> Real:
    history = np.asarray(values, dtype=float)
    if history.ndim not in (2, 3):
        raise InputError(f"{name}: shape is {history.shape}; allowed: (N, n) or (runs, N, n)")
    return history if history.ndim == 3 else history[None]


def _stacked(spectra: Complex) -> Complex:
    """Runs' spectra (E, channels, P, F) as (F, channels, E P)."""
    runs, channels, periods, lines = spectra.shape
    return spectra.transpose(3, 1, 0, 2).reshape(lines, channels, runs * periods)


def _between(frequency: Real, known: Real, values: ArrayLike) -> Complex:
    parts = np.asarray(values)
    if known.size == 0:
        return np.full(frequency.size, np.nan + 0j)
    options = {"left": np.nan, "right": np.nan}
    real = np.interp(frequency, known, parts.real, **options)
    return real + 1j * np.interp(frequency, known, parts.imag, **options)
