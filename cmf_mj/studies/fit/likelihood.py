"""How probable residuals are, and what they say of the numbers.

Of a channel in a recording the residuals of all legs are noise of one colour and size, an
autoregression of order p, whose variance s^2 of the whitened residuals e is that of them:

    e[k] = r[k] - a1 r[k-1] - ... - ap r[k-p],      -ln L = sum over channels n ln(s) + z'z / 2

the last of the prior. What is stated as a number (`evidence`) counts e^2 / 2 more. A channel of a
leg has a constant error, the same in all recordings, which is found with the numbers. With e linear
in both, J by the numbers, W = 1 / s^2,

    step = H^-1 g,        H = J' W J + 1,       g = J' W e - z

What the model does not explain is no white noise, and H^-1 then is too narrow. So the scatter
of g is measured: over blocks of `BLOCK` seconds, cov = H^-1 (1 + sum g_b g_b') H^-1, and by leaving
out one recording after the other (jackknife); of each number the larger deviation counts, with the
correlations of the first. The deviations of what is stated are believed.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

from cmf_mj.studies.fit.model import STATED, Residuals

Array = NDArray[np.float64]

BLOCK = 1.0  #: Length of a block whose scores count as independent [s].


def coefficients(residual: Array, order: int) -> Array:
    """Autoregression [1, -a1, ... -ap] of residuals (samples, legs), by Yule and Walker."""
    size = residual.shape[0]
    order = min(order, size // 4)
    centred = residual - residual.mean(axis=0)
    lags = np.array([(centred[k:] * centred[: size - k]).sum() for k in range(order + 1)])
    if lags[0] <= 0.0:
        return np.ones(1)
    lags[0] *= 1.0 + 1e-9
    return np.concatenate([[1.0], -linalg.solve_toeplitz(lags[:-1], lags[1:])])


def cost(residuals: Residuals, order: int) -> float:
    """Their part of -ln L, less is better, each coloured as it is itself; constants taken out."""
    total = 0.0
    for key, residual in residuals.items():
        if key == STATED:
            total += 0.5 * float((residual**2).sum())
            continue
        white = _whitened(residual - residual.mean(axis=0), coefficients(residual, order))
        total += 0.5 * white.size * np.log(np.mean(white**2))
    return total


class Information(NamedTuple):
    """What residuals say of the numbers about a point."""

    matrix: Array  #: H without the prior's 1, constants taken out, (n, n).
    gradient: Array  #: J' W e, (n,).
    blocks: Array  #: Scores whose scatter is that of the gradient, (blocks, n).
    by_recording: Mapping[str, tuple[Array, Array]]  #: Matrix and gradient of each.


def information(
    residuals: Residuals, derivatives: Sequence[Residuals], order: int, spacing: Mapping[str, float]
) -> Information:
    """From residuals and their derivatives by each number; `spacing` of the samples [s]."""
    recorded = {key: one for key, one in residuals.items() if key != STATED}
    legs = max((e.shape[1] for e in recorded.values()), default=0)
    channels = sorted({channel for _, channel in recorded})
    n, extra = len(derivatives), len(channels) * legs
    bordered, score = np.zeros((n + extra, n + extra)), np.zeros(n + extra)
    rows = []
    for (name, channel), residual in recorded.items():
        block = max(1, round(BLOCK / spacing[name]))
        colour = coefficients(residual, order)
        e = _whitened(residual - residual.mean(axis=0), colour)
        weight = 1.0 / max(float(np.mean(e**2)), 1e-300)
        e = _whitened(residual, colour)
        full = np.zeros((*e.shape, n + extra))
        full[..., :n] = np.stack(
            [-_whitened(one[name, channel], colour) for one in derivatives], axis=-1
        )
        at = n + channels.index(channel) * legs
        for leg in range(legs):
            full[:, leg, at + leg] = colour.sum()
        rows.append((name, block, weight, e, full))
        bordered += weight * np.einsum("tlp,tlq->pq", full, full, optimize=True)
        score += weight * np.einsum("tlp,tl->p", full, e)
    nuisance, cross = bordered[n:, n:], bordered[:n, n:]
    nuisance = nuisance + 1e-9 * np.diag(np.diag(nuisance))
    shift, onto = np.linalg.solve(nuisance, score[n:]), np.linalg.solve(nuisance, cross.T)
    parts: list[Array] = []
    by_recording: dict[str, tuple[Array, Array]] = {}
    for name, block, weight, e, full in rows:
        clean = full[..., :n] - full[..., n:] @ onto
        rest = e - full[..., n:] @ shift
        scores = weight * np.einsum("tlp,tl->tp", clean, rest)
        parts += [scores[i : i + block].sum(axis=0) for i in range(0, scores.shape[0], block)]
        before = by_recording.get(name, (np.zeros((n, n)), np.zeros(n)))
        matrix = weight * np.einsum("tlp,tlq->pq", clean, clean, optimize=True)
        by_recording[name] = (before[0] + matrix, before[1] + scores.sum(axis=0))
    whole = sum((one[0] for one in by_recording.values()), np.zeros((n, n)))
    gradient = sum((one[1] for one in by_recording.values()), np.zeros(n))
    if STATED in residuals:
        j = np.stack([-one[STATED][:, 0] for one in derivatives], axis=-1)
        whole, gradient = whole + j.T @ j, gradient + j.T @ residuals[STATED][:, 0]
        parts += list(j)
    return Information(whole, gradient, np.reshape(parts, (-1, n)), by_recording)


def spread(found: Information, z: Array) -> Array:
    """Covariance of the numbers about their best values, (n, n)."""
    one = np.eye(z.size)
    inverse = np.linalg.inv(found.matrix + one)
    robust = inverse @ (one + found.blocks.T @ found.blocks) @ inverse
    deviation = np.sqrt(np.diag(robust))
    if (count := len(found.by_recording)) > 2:
        left = [
            np.linalg.solve(found.matrix - matrix + one, found.gradient - gradient - z)
            for matrix, gradient in found.by_recording.values()
        ]
        apart = np.array(left) - np.mean(left, axis=0)
        jackknife = np.sqrt((count - 1) / count * (apart**2).sum(axis=0))
        larger = np.maximum(deviation, jackknife) / deviation
        robust = robust * np.outer(larger, larger)
    return np.asarray(robust)


def _whitened(residual: Array, colour: Array) -> Array:
    """Prediction errors of an autoregression, without the samples that have no past."""
    return np.asarray(signal.lfilter(colour, [1.0], residual, axis=0)[colour.size - 1 :])
