"""Fits a machine to a campaign: at rest, in slow motions, then all, by iterations (`iteration`).

    rest    static pressures in poses give what is carried, without simulation (`Model.weighed`)
    slow    the first seconds of each recording, at low frequencies (`iteration.STAGES`)
    whole   all of them, up to the campaign's highest frequency

Two lags in series can be exchanged without a trace; the fit tries it, and says so.

Without recordings the posterior is not Gaussian; it is sampled (`sampling`).

The folder's journal holds every step, so that a fit that was stopped goes on where it was: rows
from 0 on are steps, -1 is what linearisation misses, and those below are rounds of sampling.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.facility.unknowns import Part
from cmf_mj.studies.engine import Journal, one_library_thread
from cmf_mj.studies.fit import sampling
from cmf_mj.studies.fit.campaign import Campaign, load_campaign
from cmf_mj.studies.fit.evidence import Evidence
from cmf_mj.studies.fit.iteration import STAGES, WIDTH, Fitter, Linearised, improved
from cmf_mj.studies.fit.likelihood import spread
from cmf_mj.studies.fit.model import Model

Array = NDArray[np.float64]

Progress = Callable[[str], None]

_TWINS = (("drive_lag", "valve_lag"),)  #: Pairs of unknowns that may be exchanged.
_TWIN_LOSS = 2.0  #: What an exchange may add to the cost: two deviations.
_TWIN_REACH = 4.0  #: Largest coordinate that an exchange may lead to, either way.
_SHIFT_ROW = -1  #: Row of the journal with what linearisation misses.
_SAMPLING = 128, 2, 1  #: Draws, rounds and seed of importance sampling.


class Posterior(NamedTuple):
    """The numbers of a machine as recordings show them."""

    campaign: Campaign
    names: tuple[str, ...]  #: Of all numbers.
    z: Array  #: Their coordinates, see `Model`.
    covariance: Array  #: Squared scale of Student's t, (n, n).
    degrees: float  #: Of freedom of Student's t about them.
    linearised: Linearised  #: Residuals and derivatives there.
    twins: tuple[tuple[str, str], ...]  #: Numbers that can be exchanged.
    exchanged: Array  #: The coordinates with all twins exchanged.
    drawn: Array  #: Points of importance sampling (m, n), of evidence alone; else none.
    weights: Array  #: Theirs, (m,).
    shifts: Array = np.empty((0, 0))
    """Shifts of `z` that effects which the model lacks would cause, (m, n)."""

    def applied(self, part: Part) -> Part:
        """A plant, or another part of the machine, with the fitted numbers."""
        known = self.campaign.unknowns
        return known.apply(known.at(stats.norm.cdf(self.z)), part)

    @property
    def deviation(self) -> Array:
        """Scales of the coordinates, before the recordings 1."""
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
        low, high = low + self._all_shifts.min(axis=0), high + self._all_shifts.max(axis=0)
        return np.clip([low, high], *stats.norm.ppf([1e-6, 1.0 - 1e-6]))

    @property
    def _all_shifts(self) -> Array:
        """None and `shifts`, (1 + m, n)."""
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
        return drawn + generator.choice(self._all_shifts, count)


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
    number, width = 0, np.full(x.size, WIDTH[1])
    if campaign.settings.simulated:
        say("the data sheet's machine, simulated")
        campaign = campaign._replace(evidence=_shifted(campaign, journal, jobs))
    for stage in STAGES if pieces else ("whole",):
        fitter = Fitter(campaign, stage, jobs)
        for step in range(fitter.stage.steps):
            new = ", compiling first if new" * (number == 0)
            doing(f"{stage} {step + 1}: {x.size + 1} machines, {pieces} recordings each{new}")
            if number not in journal.results:
                journal.add(number, [improved(fitter, x, width)])
            row = journal.results[number][0]
            number += 1
            say(f"{stage} {step + 1}: -ln L {row['merit']:.1f}, {row['gain']:.1f} gained")
            x, width = np.array(row["x"]), np.array(row["width"])
            if row["done"]:
                break
    best = fitter.linearised_at(x, width)
    covariance, (twins, exchanged) = spread(best.information, x), _twins(fitter, names, best)
    drawn = (np.empty((0, len(names))), np.empty(0)) if pieces else _drawn(fitter, journal, say)
    mine = slice(len(names))  # without clocks
    return Posterior(
        campaign=campaign,
        names=names,
        z=x[mine],
        covariance=covariance[mine, mine],
        degrees=max(3.0, pieces - 1.0),
        linearised=best,
        twins=twins,
        exchanged=exchanged[mine],
        drawn=drawn[0],
        weights=drawn[1],
    )


def _drawn(fitter: Fitter, journal: Journal, say: Progress) -> tuple[Array, Array]:
    """Points of importance sampling and their weights, rounds from the journal where they are."""

    def likelihoods(number: int, points: Array) -> Array:
        row = _SHIFT_ROW - 1 - number
        if row not in journal.results:
            there = fitter.all(list(points))
            costs = [fitter.cost(*one) for one in zip(points, there, strict=True)]
            journal.add(row, [{"merit": costs}])
        return np.asarray(0.5 * (points**2).sum(axis=1) - journal.results[row][0]["merit"])

    drawn = sampling.importance(likelihoods, fitter.model.size, *_SAMPLING)
    size = sampling.effective_size(drawn.weights)
    say(f"{len(drawn.points)} machines drawn, effective sample size {size:.0f}")
    return drawn.points, drawn.weights


def _shifted(campaign: Campaign, journal: Journal, jobs: int) -> Evidence:
    """The evidence with what linearisation misses, from the journal where it is there."""
    if _SHIFT_ROW not in journal.results:
        shift = campaign.evidence.shifted(jobs).shift
        journal.add(_SHIFT_ROW, [{"shift": shift.tolist()}])
    return campaign.evidence._replace(shift=np.array(journal.results[_SHIFT_ROW][0]["shift"]))


def _twins(
    fitter: Fitter, names: tuple[str, ...], best: Linearised
) -> tuple[tuple[tuple[str, str], ...], Array]:
    """Pairs whose exchange costs next to nothing, and the coordinates with those exchanged."""
    found, x = [], best.x
    hydraulics = fitter.model.machine(x).parameters
    for pair in _TWINS:
        if not set(pair) <= set(names):
            continue
        moved = x.copy()
        for one, other in (pair, pair[::-1]):
            unknown = fitter.model.unknowns[one]
            nominal = getattr(fitter.model.plant.parameters, one)
            grid = np.linspace(-_TWIN_REACH, _TWIN_REACH, 2001)
            values = unknown.number(nominal.si, unknown.at(stats.norm.cdf(grid)))
            moved[names.index(one)] = np.interp(getattr(hydraulics, other).si, values, grid)
        if fitter.cost(moved, fitter.tried(moved)) - best.cost < _TWIN_LOSS:
            found.append(pair)
            x = moved
    return tuple(found), x
