"""Full response matrices from one run, and the joining of rounds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.analysis.response import spectra
from cmf_mj.analysis.response.estimate import DRIVEN, Complex, Estimate, Real
from cmf_mj.core.errors import InputError


def matrix_response(
    inputs: Real,
    outputs: Real,
    rate: float,
    period: float,
    *,
    transient: int = 1,
    band: tuple[float, float] | None = None,
) -> Estimate:
    """Response matrix from several inputs to several outputs, H = S_yx S_xx^-1 at each line.

    `inputs` are (N, nu) of one run with interleaved lines, each driven by one input, `outputs`
    (N, ny). Spectra are taken over whole periods [s] after `transient` ones. A column is known at
    its own lines; straight lines in the complex plane join these (error up to the spacing squared
    times H''/8, which `radius` does not hold), and outside them it is NaN. A line driven by several
    inputs needs as many periods that differ.

    The response is (K, ny, nu), its radius alike, the multiple coherence (K, ny).
    """
    spectra_x, spectra_y = (
        spectra.period_spectra(x.T, rate, period, transient).transpose(2, 0, 1)
        for x in (inputs, outputs)
    )
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
        x = spectra_x[np.ix_(rows, columns)]
        fit = spectra.least_squares(x, spectra_y[rows], np.eye(x.shape[2]))
        place = np.ix_(rows, np.arange(shape[1]), columns)
        response[place], radius[place] = fit.response, fit.radius
        coherence[rows], averages[rows] = fit.coherence, fit.averages
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

    parts = (np.concatenate(part)[kept] for part in zip(*rounds, strict=True))
    return spectra.frozen(Estimate(*parts))


def _between(frequency: Real, known: Real, values: ArrayLike) -> Complex:
    parts = np.asarray(values)
    if known.size == 0:
        return np.full(frequency.size, np.nan + 0j)
    options = {"left": np.nan, "right": np.nan}
    real = np.interp(frequency, known, parts.real, **options)
    return real + 1j * np.interp(frequency, known, parts.imag, **options)
