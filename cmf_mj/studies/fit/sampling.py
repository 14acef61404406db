"""Importance sampling: machines drawn from the prior, weighted by the evidence, and drawn again.

In the coordinates z = Phi^-1(u) of the unit cube the prior is a standard normal distribution p. The
first round draws from it. Every later one draws from

    q(z) = 0.5 t(z; m, S, 5) + 0.3 t(z; m, (S + 1) / 2, 5) + 0.2 p(z)

with Student's t for its heavy tails. Mean and covariance are those of all machines so far under
weights w^a, a so small that their effective sample size is `_TEMPERED_SIZE` of a round; so few show
too little spread, which the second part makes up for. With as many machines in each round all are
weighted by the mixture of the rounds (balance heuristic),

    w = p(z) L(z) / mean(q1(z), q2(z), ...),        effective sample size = (sum w)^2 / sum w^2
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from cmf_mj.core.errors import InputError
from cmf_mj.facility.unknowns import cube

Array = NDArray[np.float64]

_TAILS = 5.0  #: Degrees of freedom of every later round's distributions.
_SHARES = (0.5, 0.3)
"""Shares of a later round that are drawn from its two distributions; the rest is of the prior."""
_TEMPERED_SIZE = 0.08  #: Effective size of mean and covariance, over the machines of a round.
_ADDED_VARIANCE = 0.05  #: Variance added to the covariance.
_EDGE = 1e-6  #: Least distance of a quantile from 0 and 1.


def quantiles(points: Array) -> Array:
    """Quantiles of points: where they are in the unit cube."""
    return np.asarray(stats.norm.cdf(points))


class _Round(NamedTuple):
    """What a later round is drawn from."""

    mean: Array  #: (k,).
    spreads: tuple[Array, Array]  #: Covariances (k, k) of its two distributions.

    def draw(self, count: int, seed: list[int]) -> Array:
        """Its points, (count, k)."""
        generator = np.random.default_rng(seed)
        uniform = cube("sobol", count, self.mean.size + 1, generator)
        points = _normal(uniform[:, :-1])
        chi = stats.chi2.ppf(np.clip(uniform[:, -1], _EDGE, 1.0 - _EDGE), _TAILS) / (_TAILS - 2.0)
        component, limit, low = generator.random(count), stats.norm.ppf(1.0 - _EDGE), 0.0
        for share, spread in zip(_SHARES, self.spreads, strict=True):
            rows = (component >= low) & (component < low + share)
            distances = points[rows] @ np.linalg.cholesky(spread).T / np.sqrt(chi[rows])[:, None]
            points[rows] = np.clip(self.mean + distances, -limit, limit)
            low += share
        return points

    def log_density(self, points: Array, prior: Array) -> Array:
        """Ln q at points, `prior` being ln p."""
        parts = [np.log(1.0 - sum(_SHARES)) + prior]
        for share, spread in zip(_SHARES, self.spreads, strict=True):
            local = stats.multivariate_t(self.mean, spread * (_TAILS - 2.0) / _TAILS, df=_TAILS)
            parts.append(np.log(share) + local.logpdf(points))
        return np.asarray(np.logaddexp.reduce(parts, axis=0))


def moments(points: Array, weights: Array) -> tuple[Array, Array]:
    """Mean and covariance of points (n, k) with weights (n,) of sum 1."""
    mean = weights @ points
    centred = points - mean
    return mean, centred.T @ (centred * weights[:, None])


class Draws(NamedTuple):
    """Machines that were drawn."""

    points: Array  #: (n, k).
    likelihood: Array  #: Ln L, (n,).
    ratio: Array  #: Ln of prior over what they were drawn from, (n,).

    @property
    def weights(self) -> Array:
        """Of the posterior, (n,), sum 1."""
        return normalised(self.likelihood + self.ratio)


def importance(
    log_likelihoods: Callable[[int, Array], Array],
    size: int,
    count: int,
    rounds: int,
    seed: int,
    moments_of: Callable[[Array, Array], tuple[Array, Array]] | None = None,
) -> Draws:
    """Draw so many rounds of `count` points in `size` dimensions.

    `log_likelihoods` gives ln L of the points of a round by its number, (count,); `moments_of` the
    posterior's mean and covariance from all points and their `ratio`, default by the weights.
    Raises `InputError` for no rounds, and for a count that is no power of 2, as Sobol asks for.
    """
    if rounds < 1 or count < 1 or count & (count - 1):
        raise InputError(f"{rounds} rounds of {count}: allowed: at least 1, of a power of 2")
    points, likelihood = _normal(cube("sobol", count, size, seed)), np.empty(0)
    later_rounds, identity = list[_Round](), np.eye(size)
    while True:
        number = len(later_rounds)
        likelihood = np.append(likelihood, log_likelihoods(number, points[likelihood.size :]))
        prior = stats.norm.logpdf(points).sum(axis=1)
        densities = [prior, *(each.log_density(points, prior) for each in later_rounds)]
        ratio = prior - (np.logaddexp.reduce(densities, axis=0) - np.log(len(densities)))
        if number == rounds - 1:
            return Draws(points, likelihood, ratio)
        if moments_of is None:
            mean, spread = moments(points, tempered(likelihood + ratio, _TEMPERED_SIZE * count))
        else:
            mean, spread = moments_of(points, ratio)
        spread = spread + _ADDED_VARIANCE * identity
        later_rounds.append(_Round(mean, (spread, 0.5 * (spread + identity))))
        points = np.vstack([points, later_rounds[-1].draw(count, [seed, 2, number])])


def normalised(log_weights: Array) -> Array:
    """Weights of sum 1; those of minus infinity are 0.

    Raises `InputError` where all are, or one is no number.
    """
    largest = log_weights.max()
    if not np.isfinite(largest):
        raise InputError(f"no machine fits: the largest ln of the weights is {largest}")
    weights = np.exp(log_weights - largest)
    return np.asarray(weights / weights.sum())


def tempered(log_weights: Array, count: float) -> Array:
    """Weights w^a of sum 1, a at most 1 and so small that the effective size is `count`.

    Those of minus infinity stay 0; where no more than `count` are others, these count alike.
    """
    weights, is_possible = normalised(log_weights), np.isfinite(log_weights)
    if effective_size(weights) >= count:
        return weights
    relative = log_weights - log_weights.max()

    def surplus(scaled: Array) -> float:
        return effective_size(normalised(scaled)) - count

    floored = np.where(is_possible, log_weights, -1e6)
    floored -= floored.max()
    if surplus(1e-6 * floored) > 0.0:
        power = optimize.brentq(lambda power: surplus(power * floored), 1e-6, 1.0)
        if power > 1e-3:  # where the floor counts as 0
            return normalised(power * relative)
    least = np.log(1e-9 / max(1.0, -relative[is_possible].min()))
    if surplus(np.exp(least) * relative) <= 0.0:
        return np.asarray(is_possible / is_possible.sum())
    log_power = optimize.brentq(lambda log: surplus(np.exp(log) * relative), least, 0.0)
    return normalised(np.exp(log_power) * relative)


def effective_size(weights: Array) -> float:
    """Effective sample size of weights, (n,)."""
    return float(weights.sum() ** 2 / (weights**2).sum())


def resampled(weights: Array, count: int, seed: int) -> NDArray[np.int64]:
    """Indices of so many machines drawn by their weights, systematically, in order."""
    start = np.random.default_rng([seed, 3]).random()
    indices = np.searchsorted(np.cumsum(weights), (start + np.arange(count)) / count)
    return np.minimum(indices, np.flatnonzero(weights)[-1]).astype(np.int64)


def weighted_quantiles(values: Array, weights: Array, shares: Array) -> Array:
    """Quantiles of weighted values that are no NaN; NaN where there are none."""
    is_counted = ~np.isnan(values) & (weights > 0.0)
    if not is_counted.any():
        return np.full(np.shape(shares), np.nan)
    order = np.argsort(values[is_counted], kind="stable")
    sorted_values, sorted_weights = values[is_counted][order], weights[is_counted][order]
    middle = np.cumsum(sorted_weights) - 0.5 * sorted_weights
    return np.asarray(np.interp(shares, middle / sorted_weights.sum(), sorted_values))


def _normal(uniform: Array) -> Array:
    return np.asarray(stats.norm.ppf(np.clip(uniform, _EDGE, 1.0 - _EDGE)))
