"""Which effects the report asks for: plants with each of them, weighed by what it prints.

A plant e has the unknowns z of the study and those of its effects. With prior p, likelihood L and
machines i drawn from a mixture q that all plants share, r = p / q, w = r L over its sum,

    Z_e = sum r_i L_e,i / sum r_i              var ln(Z_e / Z_0) = sum (w_e,i - w_0,i)^2

and a plant's share is Z_e / sum Z. The numbers y of a machine are nearly linear in its z.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cmf_mj.report_2014.posterior.evidence import log_likelihoods, observation_arrays
from cmf_mj.report_2014.posterior.study import NONE, PosteriorStudy, effect_settings
from cmf_mj.studies.engine import Row
from cmf_mj.studies.fit import sampling

Array = NDArray[np.float64]

_REGRESSED_SHARE = 0.2  #: Effective share of the machines in the regression.
_IDENTITY_SHARE = 0.2  #: Of the identity in the covariance of the prior.


@dataclass(frozen=True)
class Bank:
    """Machines and what plants make of them: n machines, m observations."""

    study: PosteriorStudy
    points: Array  #: In the coordinates of the prior, unknowns and then effects, (n, k).
    ratio: Array  #: Ln r, (n,).
    three_g: Array  #: Ln of the likelihood of 3 g, (n,).
    predicted: Mapping[str, Array]  #: Observations, transformed, by plant, (n, m).
    flown: Mapping[str, NDArray[np.bool_]]  #: Whether machines can be flown, by plant, (n,).
    verdicts: list[Row]  #: Damping ratios of machines by plant, cab and law.

    @property
    def single_plants(self) -> list[str]:
        """The plant without effects and those with one."""
        return [plant for plant in self.predicted if "+" not in plant]

    def log_likelihood(
        self,
        plant: str,
        printed: Array | None = None,
        left_out: Iterable[int] = (),
        kinds: Iterable[str] = ("three_g", "flown"),
    ) -> Array:
        """Ln L of all machines; the observations `left_out`, by their place, do not count.

        `printed` (m,), transformed, stands in for the report's; `kinds` count beside observations.
        """
        by_observation = log_likelihoods(self.predicted[plant], printed)
        is_evidence = observation_arrays().is_used.copy()
        is_evidence[[*left_out]] = False
        total = by_observation[:, is_evidence].sum(axis=1)
        if "three_g" in kinds:
            total = total + self.three_g
        return np.where(self.flown[plant] | ("flown" not in kinds), total, -np.inf)

    def log_evidence(self, plant: str, **options: Any) -> float:
        """Ln Z; options as of `log_likelihood`."""
        total = logsumexp(self.ratio + self.log_likelihood(plant, **options))
        return float(total - logsumexp(self.ratio))

    def weights(self, plant: str, **options: Any) -> Array:
        """Weights of the posterior, sum 1; options as of `log_likelihood`."""
        return sampling.normalised(self.ratio + self.log_likelihood(plant, **options))

    def shares(self) -> dict[str, float]:
        """Shares of the plants with no effect or one, all as probable before."""
        evidence = np.array([self.log_evidence(plant) for plant in self.single_plants])
        shares = sampling.normalised(evidence).tolist()
        return dict(zip(self.single_plants, shares, strict=True))

    def effect(self, name: str) -> Array:
        """Values of an effect in the unit of the study, (n,)."""
        used = effect_settings(self.study).used
        column = len(self.study.settings.unknowns) + list(used).index(name)
        return used[name].at(sampling.quantiles(self.points[:, column]))

    def moments(self) -> tuple[Array, Array]:
        """Mean and covariance of the unknowns without effects, observations linear in them.

        Their prior is the Gaussian of machines that can be flown and swing at 3 g; the mean square
        error of the linear observations is added to s^2.
        """
        points = self.points[:, : len(self.study.settings.unknowns)]
        report = observation_arrays()
        printed, deviations = report.values[report.is_used], report.deviations[report.is_used]
        slopes, middle, square_error = self._regression(points)
        variance = deviations**2 + square_error
        weights = self.ratio + np.where(self.flown[NONE], self.three_g, -np.inf)
        mean, spread = sampling.moments(points, sampling.normalised(weights))
        identity = np.eye(points.shape[1])
        prior = np.linalg.inv((1.0 - _IDENTITY_SHARE) * spread + _IDENTITY_SHARE * identity)
        covariance: Array = np.asarray(np.linalg.inv(prior + slopes @ (slopes / variance).T))
        pull = slopes @ ((printed - middle) / variance)
        return covariance @ (prior @ mean + pull), covariance

    def _regression(self, points: Array) -> tuple[Array, Array, Array]:
        """Slopes (k, m), values at z = 0 and mean squared errors (m,) of y without effects."""
        y = np.compress(observation_arrays().is_used, self.predicted[NONE], axis=1)
        weights = self.ratio + self.log_likelihood(NONE, kinds=())
        weights = sampling.tempered(weights, _REGRESSED_SHARE * len(self.ratio))
        weights = np.where(np.isfinite(y).all(axis=1), weights, 0.0)
        y = np.where(weights[:, None] > 0.0, y, 0.0)
        root = np.sqrt(weights / weights.sum())[:, None]
        inputs = np.hstack([np.ones_like(root), points])
        coefficients = np.linalg.lstsq(root * inputs, root * y, rcond=None)[0]
        square_error = ((root * (y - inputs @ coefficients)) ** 2).sum(axis=0)
        middle, slopes = coefficients[0], coefficients[1:]
        return slopes, middle, square_error
