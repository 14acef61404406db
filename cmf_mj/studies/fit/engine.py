"""Fits a machine to a campaign: slow motions first, then all, by Gauss-Newton through simulation.

    slow    the first `SLOW` seconds of each recording, up to `SLOW_TOP` Hz
    whole   all of them, up to the campaign's highest frequency

A step is found from derivatives by differences, each a simulation of all recordings, on threads,
and shortened by Levenberg and Marquardt: of (H + mu diag H) dz = g with several mu the best is
kept. A stage ends where no step gains, or where a step is small beside the deviations.

Two lags in series can be exchanged without a trace; the fit tries it, and says so.

The folder's journal holds every step, so that a fit that was stopped goes on where it was.
"""

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.core.errors import InputError
from cmf_mj.studies.engine import Journal
from cmf_mj.studies.fit.campaign import Campaign
from cmf_mj.studies.fit.likelihood import Information, information, merit, spread
from cmf_mj.studies.fit.model import Model, Residuals, names_of

Array = NDArray[np.float64]

SLOW, SLOW_TOP = 10.0, 6.0

Progress = Callable[[str], None]

_DAMPING = (0.0, 0.01, 0.1, 1.0)
_STEPS = {"slow": 10, "whole": 6}  #: Most steps of a stage.
_ORDER = {"slow": 4, "whole": 12}  #: Of the noise's autoregression.
_FAR = 1.5  #: Longest step of a number, in deviations of the prior.
_GAIN = 0.5  #: Gain of -ln L below which a stage ends.
_TWINS = (("drive_lag", "valve_lag"),)
_SAME = 2.0  #: Loss of -ln L that an exchange may cost: two deviations.
_WIDEST = 4.0  #: Coordinates that an exchange may reach.


class Posterior(NamedTuple):
    """The numbers of a machine as recordings tell them."""

    campaign: Campaign
    names: tuple[str, ...]  #: Of all numbers.
    z: Array  #: Their coordinates, see `Model`.
    covariance: Array  #: Of the coordinates.
    degrees: float  #: Of freedom of Student's t about them.
    information: Information
    residuals: Residuals
    merit: float  #: -ln L.
    twins: tuple[tuple[str, str], ...]  #: Numbers that can be exchanged.
    exchanged: Array  #: The coordinates with all twins exchanged.

    @property
    def deviation(self) -> Array:
        """Standard deviations of the coordinates, before the recordings 1."""
        return np.sqrt(np.diag(self.covariance))

    def bounds(self, share: float = 0.9) -> Array:
        """Coordinates (2, n) between which a share of each number lies."""
        half = stats.t.ppf(0.5 + 0.5 * share, self.degrees) * self.deviation
        other = half[self._order()]
        low = np.minimum(self.z - half, self.exchanged - other)
        high = np.maximum(self.z + half, self.exchanged + other)
        return np.clip([low, high], *stats.norm.ppf([1e-6, 1.0 - 1e-6]))

    def _order(self) -> NDArray[np.int64]:
        """Indices of the numbers with all twins exchanged."""
        order = np.arange(self.z.size)
        for pair in self.twins:
            i, j = map(self.names.index, pair)
            order[[i, j]] = j, i
        return order

    def identified(self) -> NDArray[np.bool_]:
        """Whether the recordings tell each number: twice as narrow as before, and no twin."""
        paired = {name for pair in self.twins for name in pair}
        return (self.deviation < 0.5) & ~np.isin(self.names, sorted(paired))

    def samples(self, count: int, seed: int = 0) -> Array:
        """Coordinates of machines that the recordings allow, (count, n)."""
        generator = np.random.default_rng(seed)
        spread_ = self.covariance * (self.degrees - 2.0) / self.degrees
        law = stats.multivariate_t(self.z, spread_, df=self.degrees, allow_singular=True)
        drawn = np.atleast_2d(law.rvs(count, random_state=generator))
        swapped = generator.random(count) < 0.5
        drawn[swapped] = self.exchanged + (drawn[swapped] - self.z)[:, self._order()]
        return drawn


class Fitter:
    """Steps of one stage."""

    def __init__(self, campaign: Campaign, stage: str, jobs: int) -> None:
        """Make the model of a stage, `slow` or `whole`."""
        slow = stage == "slow"
        self.model = Model(campaign, top=SLOW_TOP if slow else None, seconds=SLOW if slow else None)
        self.order, self.jobs = _ORDER[stage], jobs
        self.clocks = campaign.settings.clocks
        self.spacing = {one.name: self.model.spacing(one) for one in self.model.pieces}
        self.size = len(names_of(campaign.unknowns))

    def residuals(self, x: Array) -> Residuals | None:
        """Residuals at numbers, and clocks where they are fitted."""
        clocks = None
        if self.clocks:
            clocks = x[self.size :].reshape(-1, 2) * _CLOCK
        return self.model.residuals(x[: self.size], clocks)

    def merit(self, x: Array, residuals: Residuals | None) -> float:
        """-ln L; infinite where the machine cannot do it."""
        return np.inf if residuals is None else merit(residuals, self.order) + 0.5 * float(x @ x)

    def all(self, points: Sequence[Array]) -> list[Residuals | None]:
        """Residuals at several points, on threads."""
        with ThreadPoolExecutor(self.jobs) as pool:
            return list(pool.map(self.residuals, points))

    def slopes(self, x: Array, here: Residuals, width: Array) -> Sequence[Residuals]:
        """Derivatives of the residuals by each coordinate, differences over `width`."""
        moves = np.diag(width)
        found = []
        for number, there in enumerate(self.all([x + move for move in moves])):
            step = width[number]
            if there is None:
                there, step = self.residuals(x - moves[number]), -step
            if there is None:
                raise InputError(f"number {number}: the machine leaves its bounds on either side")
            found.append(
                {
                    name: {c: (there[name][c] - here[name][c]) / step for c in channels}
                    for name, channels in here.items()
                }
            )
        return found

    def look(self, x: Array, width: Array) -> tuple[Information, Residuals]:
        """What the recordings say about a point."""
        here = self.residuals(x)
        if here is None:
            raise InputError("fit: the machine to begin with cannot follow the recorded demand")
        return information(here, self.slopes(x, here, width), self.order, self.spacing), here


_CLOCK = np.array([0.02, 1e-4])
"""Deviations of the clocks' offset [s] and skew [s/s] before the recordings."""


def fit(
    campaign: Campaign,
    folder: str | Path,
    *,
    jobs: int = 2,
    progress: Progress | None = None,
    start: Array | None = None,
) -> Posterior:
    """Fit the unknowns of a campaign; finished steps in `folder` are not computed again.

    `start` are coordinates to begin at, by default those of the data sheet, 0.
    """
    say = progress or (lambda text: None)
    identity = {
        "campaign": campaign.settings.model_dump(mode="json", exclude_defaults=True),
        "recordings": {one.name: _digest(one.record) for one in campaign.recordings},
        "start": None if start is None else list(start),
    }
    journal = Journal(Path(folder) / "steps", identity)
    names = names_of(campaign.unknowns)
    pieces = len(campaign.of(held_back=False))
    x = np.zeros(len(names) + (2 * pieces if campaign.settings.clocks else 0))
    if start is not None:
        x[: len(names)] = start
    number, width = 0, np.full(x.size, 0.03)
    for stage in _STEPS:
        fitter = Fitter(campaign, stage, jobs)
        for step in range(_STEPS[stage]):
            if number not in journal.results:
                journal.add(number, [_step(fitter, x, width)])
            row = journal.results[number][0]
            number += 1
            x, width = np.array(row["x"]), np.array(row["width"])
            say(f"{stage} {step + 1}: -ln L {row['merit']:.1f}, {row['gain']:.1f} gained")
            if row["done"]:
                break
    found, here = fitter.look(x, width)
    covariance = spread(found, x)[: len(names), : len(names)]
    best = fitter.merit(x, here)
    twins, exchanged = _twins(fitter, names, x, best)
    how = max(3.0, pieces - 1.0), found, here, best, twins, exchanged[: len(names)]
    return Posterior(campaign, names, x[: len(names)], covariance, *how)


def _step(fitter: Fitter, x: Array, width: Array) -> dict[str, Any]:
    """The best of several steps from a point, as a row of the journal."""
    found, here = fitter.look(x, width)
    before = fitter.merit(x, here)
    gradient, one = found.gradient - x, np.eye(x.size)
    moves = []
    for damping in _DAMPING:
        matrix = found.matrix + one + damping * np.diag(np.diag(found.matrix))
        move = np.linalg.solve(matrix, gradient)
        moves.append(move * min(1.0, _FAR / max(float(np.abs(move).max()), 1e-12)))
    tried = [
        fitter.merit(x + m, r)
        for m, r in zip(moves, fitter.all([x + m for m in moves]), strict=True)
    ]
    best = int(np.argmin(tried))
    gain = before - tried[best]
    deviation = np.sqrt(np.diag(np.linalg.inv(found.matrix + one)))
    if gain > 0.0:
        x = x + moves[best]
    return {
        "x": x.tolist(),
        "width": np.clip(deviation, 2e-3, 0.03).tolist(),
        "merit": min(before, tried[best]),
        "gain": max(gain, 0.0),
        "damping": _DAMPING[best],
        "done": bool(gain < _GAIN),
    }


def _twins(
    fitter: Fitter, names: tuple[str, ...], x: Array, best: float
) -> tuple[tuple[tuple[str, str], ...], Array]:
    """Pairs of lags whose exchange costs next to nothing, and the coordinates after it."""
    found, x = [], x.copy()
    oil = fitter.model.machine(x[: fitter.size]).parameters
    for pair in _TWINS:
        if not set(pair) <= set(names):
            continue
        moved = x.copy()
        for one, other in (pair, pair[::-1]):
            unknown, nominal = (
                fitter.model.unknowns[one],
                getattr(fitter.model.plant.parameters, one),
            )
            grid = np.linspace(-_WIDEST, _WIDEST, 2001)
            values = unknown.number(nominal.si, unknown.at(stats.norm.cdf(grid)))
            moved[names.index(one)] = np.interp(getattr(oil, other).si, values, grid)
        if fitter.merit(moved, fitter.residuals(moved)) - best < _SAME:
            found.append(pair)
            x = moved
    return tuple(found), x


def _digest(record: Any) -> str:
    """What tells a recording from another."""
    digest = hashlib.sha256(np.ascontiguousarray(record.time).tobytes())
    for name in sorted(record.channels):
        digest.update(name.encode() + np.ascontiguousarray(record[name]).tobytes())
    return digest.hexdigest()[:16]
