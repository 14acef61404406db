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

Residuals of a complete model do not depend on the demand, the sign of its speed, or how fast it
moves. With both whitened, of K lags of independent ones the largest correlation is below

    Phi^-1(1 - 0.005 / K) / sqrt(N)           in 99 of 100 cases, K all that are looked at.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal, stats

from cmf_mj.core.result import Field
from cmf_mj.studies.fit.model import STATED, Residuals

Array = NDArray[np.float64]

BLOCK = 1.0  #: Length of a block whose scores count as independent [s].
_LAGS = 20  #: Largest lag at which residuals are compared with the demand, in samples.
_CORRELATIONS = 18  #: Correlations of a channel: three of each leg.
_DEMAND_ORDER = 12  #: Of the autoregressions that whiten both.


def autoregression(residual: Array, order: int) -> Array:
    """Coefficients [1, -a1, ... -ap] of residuals (samples, legs), by Yule and Walker."""
    size = residual.shape[0]
    order = min(order, size // 4)
    centred = residual - residual.mean(axis=0)
    lags = np.array([(centred[k:] * centred[: size - k]).sum() for k in range(order + 1)])
    if lags[0] <= 0.0:
        return np.ones(1)
    lags[0] *= 1.0 + 1e-9
    return np.concatenate([[1.0], -linalg.solve_toeplitz(lags[:-1], lags[1:])])


def cost(residuals: Residuals, order: int) -> float:
    """Residuals' part of -ln L, each coloured as it is itself; constants taken out."""
    total = 0.0
    for key, residual in residuals.items():
        if key == STATED:
            total += 0.5 * float((residual**2).sum())
            continue
        white = _whitened(residual - residual.mean(axis=0), autoregression(residual, order))
        total += 0.5 * white.size * np.log(np.mean(white**2))
    return total


class Information(NamedTuple):
    """What residuals say of the numbers about a point."""

    matrix: Array  #: H without the prior's 1, constants taken out, (n, n).
    gradient: Array  #: J' W e, (n,).
    blocks: Array  #: Scores whose scatter is that of the gradient, (blocks, n).
    by_recording: Mapping[str, tuple[Array, Array]]  #: Matrix and gradient of each.


class _WhiteHistory(NamedTuple):
    """Residuals of a channel in a recording, whitened."""

    recording: str
    weight: float  #: W.
    residual: Array  #: e, (samples, legs).
    slopes: Array  #: -J by the numbers, then by the constant errors, (samples, legs, all).


def _whiten_histories(
    recorded: Residuals, derivatives: Sequence[Residuals], order: int
) -> list[_WhiteHistory]:
    """Whiten the residuals of each channel in each recording, and their slopes."""
    legs = max((residual.shape[1] for residual in recorded.values()), default=0)
    channels = sorted({channel for _, channel in recorded})
    n, histories = len(derivatives), []
    for (name, channel), residual in recorded.items():
        colour = autoregression(residual, order)
        about_mean = _whitened(residual - residual.mean(axis=0), colour)
        weight = 1.0 / max(float(np.mean(about_mean**2)), 1e-300)
        e = _whitened(residual, colour)
        slopes = np.zeros((*e.shape, n + len(channels) * legs))
        slopes[..., :n] = np.stack(
            [-_whitened(derivative[name, channel], colour) for derivative in derivatives], axis=-1
        )
        first_error = n + channels.index(channel) * legs
        for leg in range(legs):
            slopes[:, leg, first_error + leg] = colour.sum()
        histories.append(_WhiteHistory(name, weight, e, slopes))
    return histories


def information(
    residuals: Residuals, derivatives: Sequence[Residuals], order: int, spacing: Mapping[str, float]
) -> Information:
    """Information of residuals with derivatives by each number; `spacing` of the samples [s]."""
    recorded = {key: residual for key, residual in residuals.items() if key != STATED}
    histories, n = _whiten_histories(recorded, derivatives, order), len(derivatives)
    size = histories[0].slopes.shape[-1] if histories else n  # with the constant errors
    bordered, score = np.zeros((size, size)), np.zeros(size)
    for history in histories:
        slopes, weight = history.slopes, history.weight
        bordered += weight * np.einsum("tlp,tlq->pq", slopes, slopes, optimize=True)
        score += weight * np.einsum("tlp,tl->p", slopes, history.residual)
    nuisance, cross = bordered[n:, n:], bordered[:n, n:]
    nuisance = nuisance + 1e-9 * np.diag(np.diag(nuisance))
    shift, projection = np.linalg.solve(nuisance, score[n:]), np.linalg.solve(nuisance, cross.T)
    block_scores: list[Array] = []
    by_recording: dict[str, tuple[Array, Array]] = {}
    for history in histories:
        by_numbers, by_errors = history.slopes[..., :n], history.slopes[..., n:]
        free_slopes = by_numbers - by_errors @ projection
        e = history.residual - by_errors @ shift
        scores = history.weight * np.einsum("tlp,tl->tp", free_slopes, e)
        block = max(1, round(BLOCK / spacing[history.recording]))
        begins = range(0, scores.shape[0], block)
        block_scores += [scores[i : i + block].sum(axis=0) for i in begins]
        zero = np.zeros((n, n)), np.zeros(n)
        matrix, gradient = by_recording.get(history.recording, zero)
        square = np.einsum("tlp,tlq->pq", free_slopes, free_slopes, optimize=True)
        matrix = matrix + history.weight * square
        by_recording[history.recording] = matrix, gradient + scores.sum(axis=0)
    whole_matrix, whole_gradient = np.zeros((n, n)), np.zeros(n)
    for matrix, gradient in by_recording.values():
        whole_matrix, whole_gradient = whole_matrix + matrix, whole_gradient + gradient
    if STATED in residuals:
        stated_slopes = np.stack([-derivative[STATED][:, 0] for derivative in derivatives], axis=-1)
        whole_matrix = whole_matrix + stated_slopes.T @ stated_slopes
        whole_gradient = whole_gradient + stated_slopes.T @ residuals[STATED][:, 0]
        block_scores += list(stated_slopes)
    blocks = np.reshape(block_scores, (-1, n))
    return Information(whole_matrix, whole_gradient, blocks, by_recording)


def spread(information: Information, z: Array) -> Array:
    """Covariance of the numbers about their best values, (n, n)."""
    whole, identity = information.matrix, np.eye(z.size)
    inverse = np.linalg.inv(whole + identity)
    robust = inverse @ (identity + information.blocks.T @ information.blocks) @ inverse
    deviation = np.sqrt(np.diag(robust))
    if (count := len(information.by_recording)) > 2:
        steps_without_one = [
            np.linalg.solve(whole - matrix + identity, information.gradient - gradient - z)
            for matrix, gradient in information.by_recording.values()
        ]
        differences = np.array(steps_without_one) - np.mean(steps_without_one, axis=0)
        jackknife = np.sqrt((count - 1) / count * (differences**2).sum(axis=0))
        larger = np.maximum(deviation, jackknife) / deviation
        robust = robust * np.outer(larger, larger)
    return np.asarray(robust)


def _whitened(residual: Array, colour: Array) -> Array:
    """Prediction errors of an autoregression, without the samples that have no past."""
    return np.asarray(signal.lfilter(colour, [1.0], residual, axis=0)[colour.size - 1 :])


class OpenDirection(NamedTuple):
    """A direction that the recordings leave open."""

    deviation: Annotated[float, Field(title="deviation over that before", form=".2f")]
    numbers: str  #: What changes together, with signs.


def open_directions(covariance: Array, names: Sequence[str]) -> list[OpenDirection]:
    """Eigenvectors along which more than half of the prior's width remains."""
    variances, vectors = np.linalg.eigh(covariance)
    directions = []
    for i in sorted(range(variances.size), key=lambda i: -variances[i]):
        deviation, vector = float(np.sqrt(variances[i])), vectors[:, i]
        if deviation > 0.5:
            vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
            largest = [j for j in np.argsort(-np.abs(vector)) if abs(vector[j]) > 0.3]
            changes = [f"{names[j]} {'up' if vector[j] > 0 else 'down'}" for j in largest]
            directions.append(OpenDirection(deviation, ", ".join(changes)))
    return directions


def demand_correlation(residual: Array, demand: Array) -> float:
    """Largest correlation of a residual's history with its leg's demand, over its bound.

    Linear effects go with the demand, friction and dead zones with the sign of its speed, and what
    is neither, with how fast it moves: e^2 against the speed squared.
    """
    e, speed = _white(residual), np.gradient(demand)
    power = speed**2 / max(float(np.mean(speed**2)), 1e-300)
    pairs = [(e, _white(demand)), (e, _white(np.sign(speed))), (_white(e**2), _white(power))]
    return max(_correlation_over_chance(x, y) for x, y in pairs)


def _correlation_over_chance(e: Array, u: Array) -> float:
    """Largest correlation of two white histories over what chance reaches once in 100 times."""
    count = min(e.size, u.size)
    e, u = e[-count:], u[-count:]
    if not e.any() or not u.any():
        return 0.0
    e, u = (x / np.sqrt(np.mean(x**2)) for x in (e, u))
    lags = range(-_LAGS // 4, _LAGS)
    correlations = [
        float(np.dot(e[max(k, 0) : count + min(k, 0)], u[max(-k, 0) : count - max(k, 0)])) / count
        for k in lags
    ]
    bound = stats.norm.ppf(1.0 - 0.005 / (_CORRELATIONS * len(lags))) / np.sqrt(count)
    return float(np.abs(correlations).max() / bound)


def _white(history: Array) -> Array:
    column = (history - history.mean())[:, None]
    return _whitened(column, autoregression(column, _DEMAND_ORDER))[:, 0]
