"""Fits a machine to a campaign: at rest, in slow motions, then all, by Gauss and Newton.

    rest    static pressures in poses give what is carried, without simulation (`Model.weighed`)
    slow    the first `SLOW` seconds of each recording, up to `SLOW_TOP` Hz
    whole   all of them, up to the campaign's highest frequency

Derivatives are differences, each a simulation of all recordings, on threads. Steps are shortened by
Levenberg and Marquardt: of (H + mu diag H) dz = g with several mu the best is kept, and Broyden's
update carries the derivatives on while steps gain. A stage ends where they promise next to nothing.

Two lags in series can be exchanged without a trace; the fit tries it, and says so.

Numbers that are stated say less than recordings, and "flown, hence stable" is no bell curve. Of
evidence without recordings the posterior is drawn, by importance sampling (`sampling`).

The folder's journal holds every step, so that a fit that was stopped goes on where it was.
"""

import copy
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.core.errors import InputError, RunError
from cmf_mj.studies.engine import Journal, one_library_thread
from cmf_mj.studies.fit import sampling
from cmf_mj.studies.fit.campaign import Campaign, load_campaign
from cmf_mj.studies.fit.evidence import Evidence
from cmf_mj.studies.fit.likelihood import Information, information, merit, spread
from cmf_mj.studies.fit.model import Change, Model, Residuals, minus

Array = NDArray[np.float64]

SLOW, SLOW_TOP = 10.0, 6.0

Progress = Callable[[str], None]

_DAMPING = (0.0, 0.01, 0.1, 1.0)
_STEPS = {"slow": 8, "whole": 6}  #: Most steps of a stage.
_ORDER = {"slow": 4, "whole": 12}  #: Of the noise's autoregression.
_FAR = 1.5  #: Longest step of a number, in deviations of the prior.
_INNER = 6  #: Most steps on one set of derivatives.
_ENOUGH = {"slow": 20.0, "whole": 0.5}  #: Promised gain of -ln L below which a stage ends.
_CHEAP = 1e-3  #: The same where there is evidence alone.
_TWINS = (("drive_lag", "valve_lag"),)
_SAME = 2.0  #: Loss of -ln L that an exchange may cost: two deviations.
_SHIFT = -1  #: Row of the journal with what linearisation misses.
_SAMPLING = 128, 2, 1  #: Draws, rounds and seed of importance sampling.
_WIDEST = 4.0  #: Coordinates that an exchange may reach.


class Posterior(NamedTuple):
    """The numbers of a machine as recordings show them."""

    campaign: Campaign
    names: tuple[str, ...]  #: Of all numbers.
    z: Array  #: Their coordinates, see `Model`.
    covariance: Array  #: Squared scale of Student's t, (n, n).
    degrees: float  #: Of freedom of Student's t about them.
    look: "Look"  #: Residuals and derivatives there.
    twins: tuple[tuple[str, str], ...]  #: Numbers that can be exchanged.
    exchanged: Array  #: The coordinates with all twins exchanged.
    drawn: Array  #: Points of importance sampling (m, n), of evidence alone; else none.
    weights: Array  #: Theirs, (m,).
    shifts: Array = np.empty((0, 0))
    """Where else the numbers may be, by effects that the model lacks, less `z`, (m, n)."""

    @property
    def deviation(self) -> Array:
        """Standard deviations of the coordinates, before the recordings 1."""
        return np.sqrt(np.diag(self.covariance))

    def bounds(self, share: float = 0.9, *, exchange: bool = True) -> Array:
        """Coordinates (2, n) between which a share of each number lies.

        Without `exchange` twins keep their order: exchanged they make the same loop.
        """
        if self.weights.size:
            ends = np.array([0.5 - 0.5 * share, 0.5 + 0.5 * share])
            columns = [sampling.weighted_quantiles(z, self.weights, ends) for z in self.drawn.T]
            return np.stack(columns, axis=-1)
        half = stats.t.ppf(0.5 + 0.5 * share, self.degrees) * self.deviation
        low, high = self.z - half, self.z + half
        if exchange:
            other = half[self._order()]
            low = np.minimum(low, self.exchanged - other)
            high = np.maximum(high, self.exchanged + other)
        low, high = low + self._elsewhere.min(axis=0), high + self._elsewhere.max(axis=0)
        return np.clip([low, high], *stats.norm.ppf([1e-6, 1.0 - 1e-6]))

    @property
    def _elsewhere(self) -> Array:
        return np.vstack([np.zeros(self.z.size), *self.shifts])

    def _order(self) -> NDArray[np.int64]:
        """Indices of the numbers with all twins exchanged."""
        order = np.arange(self.z.size)
        for pair in self.twins:
            i, j = map(self.names.index, pair)
            order[[i, j]] = j, i
        return order

    def identified(self) -> NDArray[np.bool_]:
        """Whether the recordings show each number: at least twice as narrow as before."""
        low, high = self.bounds()
        return (high - low) < 0.5 * 2.0 * stats.norm.ppf(0.95)

    def samples(self, count: int, seed: int = 0) -> Array:
        """Coordinates of machines that the recordings allow, (count, n)."""
        if self.weights.size:
            return np.asarray(self.drawn[sampling.resampled(self.weights, count, seed)])
        generator = np.random.default_rng(seed)
        law = stats.multivariate_t(self.z, self.covariance, self.degrees, allow_singular=True)
        drawn = law.rvs(count, random_state=generator).reshape(count, -1)
        swapped = generator.random(count) < 0.5
        drawn[swapped] = self.exchanged + (drawn[swapped] - self.z)[:, self._order()]
        return drawn + generator.choice(self._elsewhere, count)


class Fitter:
    """Steps of one stage."""

    def __init__(self, campaign: Campaign, stage: str, jobs: int) -> None:
        """Make the model of a stage, `slow` or `whole`."""
        slow = stage == "slow"
        self.model = Model(campaign, top=SLOW_TOP if slow else None, seconds=SLOW if slow else None)
        self.order, self.jobs = _ORDER[stage], jobs
        self.spacing = {one.name: self.model.spacing(one) for one in self.model.pieces}
        self._latest: Look | None = None

    def having(self, change: Change) -> "Fitter":
        """The same of the machine with an effect, whose numbers follow the others."""
        made = copy.copy(self)
        made.model, made._latest = copy.copy(self.model), None
        made.model.change = change
        return made

    def tried(self, x: Array) -> Residuals | None:
        """Residuals; None where there is no such machine, or it leaves its bounds."""
        try:
            return self.model.residuals(x)
        except (InputError, RunError):
            return None

    def merit(self, x: Array, residuals: Residuals | None) -> float:
        """-ln L; infinite where the machine cannot do it."""
        return np.inf if residuals is None else merit(residuals, self.order) + 0.5 * float(x @ x)

    def all(self, points: Sequence[Array]) -> list[Residuals | None]:
        """Residuals at several points, on threads."""
        with ThreadPoolExecutor(self.jobs) as pool:
            return list(pool.map(self.tried, points))

    def slopes(self, x: Array, here: Residuals, width: Array) -> Sequence[Residuals]:
        """Derivatives of the residuals by each coordinate, differences over `width`."""
        moves = np.diag(width)
        found = []
        for number, there in enumerate(self.all([x + move for move in moves])):
            step = width[number]
            if there is None:
                there, step = self.tried(x - moves[number]), -step
            if there is None:
                raise InputError(f"number {number}: the machine leaves its bounds on either side")
            found.append(minus(there, here, step))
        return found

    def look(self, x: Array, width: Array) -> "Look":
        """What the recordings say about a point."""
        if self._latest is None or not np.array_equal(self._latest.x, x):
            here = self.model.residuals(x)
            slopes = self.slopes(x, here, width)
            self._latest = self.seen(x, here, slopes)
        return self._latest

    def seen(self, x: Array, here: Residuals, slopes: Sequence[Residuals]) -> "Look":
        """The same of residuals and their derivatives."""
        found = information(here, slopes, self.order, self.spacing)
        return Look(x, here, slopes, found, self.merit(x, here))


class Look(NamedTuple):
    """Residuals and derivatives at a point, and what they say."""

    x: Array
    here: Residuals
    slopes: Sequence[Residuals]
    found: Information
    merit: float

    @property
    def gradient(self) -> Array:
        """Of ln L with the prior, (n,)."""
        return self.found.gradient - self.x

    @property
    def promise(self) -> float:
        """Gain of -ln L if all were linear."""
        full = self.found.matrix + np.eye(self.x.size)
        return 0.5 * float(self.gradient @ np.linalg.solve(full, self.gradient))

    def moves(self) -> list[Any]:
        """Steps of several dampings, none longer than `_FAR`."""
        found = []
        for damping in _DAMPING:
            matrix = self.found.matrix + np.eye(self.x.size)
            matrix += damping * np.diag(np.diag(self.found.matrix))
            move = np.linalg.solve(matrix, self.gradient)
            found.append(move * min(1.0, _FAR / max(float(np.abs(move).max()), 1e-12)))
        return found

    def after(self, move: Array, there: Residuals) -> list[Residuals]:
        """Broyden's derivatives after a step: they give the change of residuals along it."""
        share = move / float(move @ move)
        missing = {
            key: there[key]
            - value
            - sum(x * one[key] for x, one in zip(move, self.slopes, strict=True))
            for key, value in self.here.items()
        }
        return [
            {key: value + x * missing[key] for key, value in one.items()}
            for x, one in zip(share, self.slopes, strict=True)
        ]


@one_library_thread()
def fit(
    campaign: str | Path | Campaign,
    folder: str | Path,
    *,
    jobs: int = 2,
    progress: Progress | None = None,
    doing: Progress | None = None,
) -> Posterior:
    """Fit the unknowns of a campaign; finished steps in `folder` are not computed again.

    Args:
        campaign: its folder, or a loaded one.
        folder: of the journal of steps.
        jobs: threads that simulate.
        progress: called with a line after each step.
        doing: called with what comes next, before it.

    Raises `InputError` for a campaign that cannot be read, and where the machine to begin with
    cannot follow what was demanded; `OutOfBounds` where it leaves its physical bounds.

    >>> import tempfile
    >>> from pathlib import Path
    >>> folder = Path(tempfile.mkdtemp())
    >>> heavy = cmf_mj.load_cab(None, "lab").changed("heavy", mass=330.0)
    >>> command = cmf_mj.signals.sine("surge", 0.01, frequency=1.0, cycles=8)
    >>> how = {"electronics": "noisy", "record_every": 16}
    >>> record = cmf_mj.simulate(cmf_mj.Hexapod(heavy), "original", command, **how)
    >>> file = record.save(folder / "surge.parquet")
    >>> said = '''machine = "lab"
    ... law = "original"
    ... [recordings.surge]
    ... file = "surge.parquet"
    ... kind = "multisine"
    ... [unknowns.mass]
    ... path = "cab.mass"
    ... deviation = 30.0
    ... source = "a guess"'''
    >>> written = (folder / "campaign.toml").write_text(said)
    >>> mine = cmf_mj.fit(folder, folder / "out")
    >>> from cmf_mj.studies.fit.results import physical
    >>> print(f"{physical(mine, mine.z)[0]:.0f} kg")
    330 kg
    """
    campaign = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
    say, doing = progress or (lambda text: None), doing or (lambda text: None)
    identity = {
        "campaign": campaign.settings.model_dump(mode="json", exclude_defaults=True),
        "recordings": {one.name: one.record.digest for one in campaign.recordings},
    }
    journal = Journal(Path(folder) / "steps", identity)
    names = tuple(name for name, *_ in campaign.unknowns.numbers())
    pieces = len(campaign.of(held_back=False))
    model = Model(campaign)
    doing("weighing at rest")
    x = np.append(model.weighed(), np.zeros(model.clocks))
    number, width = 0, np.full(x.size, 0.03)
    if campaign.settings.simulated:
        say("the data sheet's machine, simulated")
        campaign = campaign._replace(evidence=_shifted(campaign, journal, jobs))
    for stage in _STEPS if pieces else ("whole",):
        fitter = Fitter(campaign, stage, jobs)
        for step in range(_STEPS[stage]):
            new = ", compiling first if new" * (number == 0)
            doing(f"{stage} {step + 1}: {x.size + 1} machines, {pieces} recordings each{new}")
            if number not in journal.results:
                journal.add(number, [improved(fitter, x, width, stage)])
            row = journal.results[number][0]
            number += 1
            say(f"{stage} {step + 1}: -ln L {row['merit']:.1f}, {row['gain']:.1f} gained")
            x, width = np.array(row["x"]), np.array(row["width"])
            if row["done"]:
                break
    look = fitter.look(x, width)
    covariance, (twins, exchanged) = spread(look.found, x), _twins(fitter, names, look)
    drawn = (np.empty((0, len(names))), np.empty(0)) if pieces else _drawn(fitter, journal, say)
    mine = slice(len(names))  # without clocks
    how = max(3.0, pieces - 1.0), look, twins, exchanged[mine]
    return Posterior(campaign, names, x[mine], covariance[mine, mine], *how, *drawn)


def _drawn(fitter: Fitter, journal: Journal, say: Progress) -> tuple[Array, Array]:
    """Points of importance sampling and their weights, rounds from the journal where they are."""

    def likelihoods(number: int, points: Array) -> Array:
        if _SHIFT - 1 - number not in journal.results:
            there = fitter.all(list(points))
            merits = [fitter.merit(*one) for one in zip(points, there, strict=True)]
            journal.add(_SHIFT - 1 - number, [{"merit": merits}])
        merit_ = np.array(journal.results[_SHIFT - 1 - number][0]["merit"])
        return np.asarray(0.5 * (points**2).sum(axis=1) - merit_)

    drawn = sampling.importance(likelihoods, fitter.model.size, *_SAMPLING)
    size = sampling.effective_size(drawn.weights)
    say(f"{len(drawn.points)} machines drawn, effective sample size {size:.0f}")
    return drawn.points, drawn.weights


def _shifted(campaign: Campaign, journal: Journal, jobs: int) -> Evidence:
    """The evidence with what linearisation misses, from the journal where it is there."""
    if _SHIFT not in journal.results:
        shift = campaign.evidence.shifted(jobs).shift
        journal.add(_SHIFT, [{"shift": shift.tolist()}])
    return campaign.evidence._replace(shift=np.array(journal.results[_SHIFT][0]["shift"]))


def improved(fitter: Fitter, x: Array, width: Array, stage: str) -> dict[str, Any]:
    """Steps on one set of derivatives, as a row of the journal; none where they promise little."""
    enough, look = _ENOUGH[stage] if fitter.model.pieces else _CHEAP, fitter.look(x, width)
    first = look
    ended = first.promise < enough
    for _ in range(0 if ended else _INNER):
        moves = look.moves()
        there = fitter.all([look.x + move for move in moves])
        merits = [fitter.merit(look.x + move, one) for move, one in zip(moves, there, strict=True)]
        best = int(np.argmin(merits))
        gain, here = look.merit - merits[best], there[best]
        if here is None or gain <= 0.0:
            break
        promised = look.promise
        look = fitter.seen(look.x + moves[best], here, look.after(moves[best], here))
        if gain < max(enough, 0.1 * promised):
            break
    deviation = np.sqrt(np.diag(np.linalg.inv(first.found.matrix + np.eye(x.size))))
    gained = first.merit - look.merit
    over = ended or gained < enough or (stage == "slow" and look.promise < enough)
    return {
        "x": look.x.tolist(),
        "width": (np.clip(deviation, 2e-3, 0.03) if gained > 0.0 else width).tolist(),
        "merit": look.merit,
        "gain": gained,
        "done": bool(over),
    }


def _twins(
    fitter: Fitter, names: tuple[str, ...], look: Look
) -> tuple[tuple[tuple[str, str], ...], Array]:
    """Pairs of lags whose exchange costs next to nothing, and the coordinates after it."""
    found, x, best = [], look.x, look.merit
    oil = fitter.model.machine(x).parameters
    for pair in _TWINS:
        if not set(pair) <= set(names):
            continue
        moved = x.copy()
        for one, other in (pair, pair[::-1]):
            unknown = fitter.model.unknowns[one]
            nominal = getattr(fitter.model.plant.parameters, one)
            grid = np.linspace(-_WIDEST, _WIDEST, 2001)
            values = unknown.number(nominal.si, unknown.at(stats.norm.cdf(grid)))
            moved[names.index(one)] = np.interp(getattr(oil, other).si, values, grid)
        if fitter.merit(moved, fitter.tried(moved)) - best < _SAME:
            found.append(pair)
            x = moved
    return tuple(found), x
