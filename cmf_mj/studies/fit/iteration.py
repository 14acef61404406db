"""One iteration of a fit, by Levenberg and Marquardt with Broyden's update between its steps.

The cost is -ln L with the prior (`likelihood`); less is better. Derivatives are differences, each a
simulation of all recordings, on threads. Of the steps (H + 1 + mu diag H) dx = g with several mu
the best is kept, and Broyden's update carries the derivatives on while steps gain. A stage ends
where the linearised model predicts next to no gain.
"""

import copy
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.threads import on_threads
from cmf_mj.studies.fit.campaign import Campaign
from cmf_mj.studies.fit.likelihood import Information, cost, information
from cmf_mj.studies.fit.model import Change, Model, Residuals, difference

Array = NDArray[np.float64]

LEAST_WIDTH, LARGEST_WIDTH = 2e-3, 0.03  #: Steps of differences, in deviations of the prior.
_DAMPING = (0.0, 0.01, 0.1, 1.0)  #: The values of mu.
_LONGEST_STEP = 1.5  #: Of a coordinate, in deviations of the prior.
_INNER_STEPS = 6  #: Most steps on one set of derivatives.
_ENOUGH_STATED = 1e-3  #: Takes the place of `Stage.enough` where there is evidence alone.


class Stage(NamedTuple):
    """What a stage takes of the recordings, and when it ends."""

    seconds: float | None  #: Of each recording, from its beginning [s]; None takes all.
    top: float | None  #: Highest frequency [Hz]; None for the campaign's.
    steps: int  #: Most iterations.
    order: int  #: Of the noise's autoregression.
    enough: float  #: Predicted gain of ln L below which it ends.


STAGES = {
    "slow": Stage(seconds=10.0, top=6.0, steps=8, order=4, enough=20.0),
    "whole": Stage(seconds=None, top=None, steps=6, order=12, enough=0.5),
}


class Fitter:
    """Simulations of one stage, linearised.

    A point x (n,) is z of all numbers, then the sizes of an effect, if there is one, and the clocks
    of all recordings, as `Model` takes it.
    """

    def __init__(self, campaign: Campaign, stage: str, jobs: int) -> None:
        """Make the model of a stage, one of `STAGES`."""
        self.stage, self.jobs = STAGES[stage], jobs
        self.model = Model(campaign, top=self.stage.top, seconds=self.stage.seconds)
        self.spacing = {piece.name: self.model.spacing(piece) for piece in self.model.pieces}
        self._latest: Linearised | None = None

    def with_effect(self, change: Change) -> "Fitter":
        """This fitter with an effect added to the machine."""
        fitter = copy.copy(self)
        fitter.model, fitter._latest = copy.copy(self.model), None
        fitter.model.change = change
        return fitter

    def residuals(self, x: Array) -> Residuals | None:
        """Residuals; None where there is no such machine, or it leaves its bounds."""
        try:
            return self.model.residuals(x)
        except (InputError, RunError):
            return None

    def cost(self, x: Array, residuals: Residuals | None) -> float:
        """-ln L with the prior; infinite where the machine cannot do it."""
        prior = 0.5 * float(x @ x)
        return np.inf if residuals is None else cost(residuals, self.stage.order) + prior

    def residuals_at(self, points: Sequence[Array]) -> list[Residuals | None]:
        """Residuals at several points, on threads."""
        return on_threads(self.residuals, points, self.jobs)

    def derivatives(self, x: Array, start: Residuals, width: Array) -> list[Residuals]:
        """By each coordinate, from `start` at `x`: differences over `width`, forward if it can."""
        moves, derivatives = np.diag(width), []
        for number, end in enumerate(self.residuals_at([x + move for move in moves])):
            step = width[number]
            if end is None:
                end, step = self.residuals(x - moves[number]), -step
            if end is None:
                names = [name for name, *_ in self.model.unknowns.numbers()]
                name = names[number] if number < len(names) else "effect or clock"
                raise InputError(f"{name}: the machine leaves its bounds on either side")
            derivatives.append(difference(end, start, step))
        return derivatives

    def linearised_at(self, x: Array, width: Array) -> "Linearised":
        """Simulated at and about `x`; kept for the last `x`: a new `width` alone is not taken."""
        if self._latest is None or not np.array_equal(self._latest.x, x):
            residuals = self.model.residuals(x)
            self._latest = self.linearised(x, residuals, self.derivatives(x, residuals, width))
        return self._latest

    def linearised(
        self, x: Array, residuals: Residuals, derivatives: Sequence[Residuals]
    ) -> "Linearised":
        """Linearised at `x` with known residuals and derivatives."""
        about_x = information(residuals, derivatives, self.stage.order, self.spacing)
        return Linearised(x, residuals, derivatives, about_x, self.cost(x, residuals))


class Linearised(NamedTuple):
    """Residuals and derivatives at a point, and what they say of the cost."""

    x: Array
    residuals: Residuals
    derivatives: Sequence[Residuals]  #: By each coordinate.
    information: Information
    cost: float

    @property
    def gradient(self) -> Array:
        """Of ln L with the prior, (n,)."""
        return self.information.gradient - self.x

    @property
    def hessian(self) -> Array:
        """Of the cost, by Gauss and Newton: H + 1, (n, n)."""
        return self.information.matrix + np.eye(self.x.size)

    @property
    def predicted_gain(self) -> float:
        """Cost less that of the best point, if all were linear."""
        return 0.5 * float(self.gradient @ np.linalg.solve(self.hessian, self.gradient))

    def damped_steps(self) -> list[Array]:
        """Steps of several dampings, none longer than `_LONGEST_STEP`."""
        steps = []
        for damping in _DAMPING:
            matrix = self.hessian + damping * np.diag(np.diag(self.information.matrix))
            step = np.linalg.solve(matrix, self.gradient)
            longest = max(float(np.abs(step).max()), 1e-12)
            steps.append(np.asarray(step * min(1.0, _LONGEST_STEP / longest)))
        return steps

    def derivatives_after(self, step: Array, residuals: Residuals) -> list[Residuals]:
        """Broyden's derivatives after a step: they give the change of residuals along it."""
        unexpected = {}
        for key, before in self.residuals.items():
            slopes = (derivative[key] for derivative in self.derivatives)
            expected = sum(x * slope for x, slope in zip(step, slopes, strict=True))
            unexpected[key] = residuals[key] - before - expected
        shares = step / float(step @ step)
        return [
            {key: slope + share * unexpected[key] for key, slope in derivative.items()}
            for share, derivative in zip(shares, self.derivatives, strict=True)
        ]


def improve(fitter: Fitter, x: Array, width: Array) -> dict[str, Any]:
    """One iteration of Levenberg and Marquardt from `x`, as a row of the journal.

    Up to `_INNER_STEPS` steps on one set of derivatives, which Broyden's update carries on; no step
    where the predicted gain is below the stage's `enough`. The row has the new `x`, the `width` of
    differences there, the cost `merit` there, the `gain` of it, and whether the stage is `done`.
    """
    threshold = fitter.stage.enough if fitter.model.pieces else _ENOUGH_STATED
    start = point = fitter.linearised_at(x, width)
    converged = start.predicted_gain < threshold
    for _ in range(0 if converged else _INNER_STEPS):
        steps = point.damped_steps()
        points = [point.x + step for step in steps]
        trials = fitter.residuals_at(points)
        costs = list(map(fitter.cost, points, trials))
        best = int(np.argmin(costs))
        trial, step, gain = trials[best], steps[best], point.cost - costs[best]
        if trial is None or gain <= 0.0:
            break
        predicted_gain = point.predicted_gain
        point = fitter.linearised(point.x + step, trial, point.derivatives_after(step, trial))
        if gain < max(threshold, 0.1 * predicted_gain):
            break
    deviation = np.sqrt(np.diag(np.linalg.inv(start.hessian)))
    gain = start.cost - point.cost
    is_slow = fitter.stage is STAGES["slow"]  # the next stage begins where this one ends
    done = converged or gain < threshold or (is_slow and point.predicted_gain < threshold)
    return {
        "x": point.x.tolist(),
        "width": (np.clip(deviation, LEAST_WIDTH, LARGEST_WIDTH) if gain > 0.0 else width).tolist(),
        "merit": point.cost,
        "gain": gain,
        "done": bool(done),
    }
