"""Fits a machine to a campaign: at rest, in slow motions, then all, by iterations (`iteration`).

    rest    static pressures in poses give what is carried, without simulation (`Model.weigh`)
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
from cmf_mj.studies.fit.iteration import LARGEST_WIDTH, STAGES, Fitter, Linearised, improve
from cmf_mj.studies.fit.likelihood import spread
from cmf_mj.studies.fit.model import Model

Array = NDArray[np.float64]

Progress = Callable[[str], None]

_TWINS = (("drive_lag", "valve_lag"),)  #: Pairs of unknowns that may be exchanged.
_TWIN_LOSS = 2.0  #: What an exchange may add to the cost: two deviations.
_TWIN_REACH = 4.0  #: Largest coordinate that an exchange may lead to, either way.
_SHIFT_ROW = -1  #: Row of the journal with what linearisation misses.
_DRAWS, _ROUNDS, _SEED = 128, 2, 1  #: Of importance sampling.


class Posterior(NamedTuple):
    """The numbers of a machine as recordings show them."""

    campaign: Campaign
    names: tuple[str, ...]  #: Of all numbers.
    z: Array  #: Their coordinates, see `Model`.
    covariance: Array  #: Squared scale of Student's t, (n, n).
    degrees: float  #: Of freedom of Student's t about them.
    linearised: Linearised  #: Residuals and derivatives there.
    twins: tuple[tuple[str, str], ...]  #: Numbers that can be exchanged.
    exchanged_z: Array  #: The coordinates with all twins exchanged.
    points: Array  #: Of importance sampling (m, n), of evidence alone; else none.
    weights: Array  #: Of these points, (m,).
    shifts: Array = np.empty((0, 0))
    """Shifts of `z` that effects which the model lacks would cause, (m, n)."""

    def applied(self, part: Part) -> Part:
        """A plant, or another part of the machine, with the fitted numbers."""
        unknowns = self.campaign.unknowns
        return unknowns.apply(unknowns.at(stats.norm.cdf(self.z)), part)

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
            columns = [sampling.weighted_quantiles(z, self.weights, ends) for z in self.points.T]
            return np.stack(columns, axis=-1)
        half_width = stats.t.ppf(0.5 + 0.5 * share, self.degrees) * self.deviation
        low, high = self.z - half_width, self.z + half_width
        if exchange:
            exchanged_half_width = half_width[self._exchanged_order()]
            low = np.minimum(low, self.exchanged_z - exchanged_half_width)
            high = np.maximum(high, self.exchanged_z + exchanged_half_width)
        low, high = low + self._all_shifts.min(axis=0), high + self._all_shifts.max(axis=0)
        return np.clip([low, high], *stats.norm.ppf([1e-6, 1.0 - 1e-6]))

    @property
    def _all_shifts(self) -> Array:
        """No shift and `shifts`, (1 + m, n)."""
        return np.vstack([np.zeros(self.z.size), *self.shifts])

    def _exchanged_order(self) -> NDArray[np.int64]:
        """Indices of the numbers with all twins exchanged."""
        order = np.arange(self.z.size)
        for first, second in self.twins:
            i, j = self.names.index(first), self.names.index(second)
            order[[i, j]] = j, i
        return order

    def identified(self) -> NDArray[np.bool_]:
        """Whether the recordings show each number: at least twice as narrow as before."""
        low, high = self.bounds()
        return (high - low) < 0.5 * 2.0 * stats.norm.ppf(0.95)

    def samples(self, count: int, seed: int = 0) -> Array:
        """Coordinates of machines that the recordings allow, (count, n)."""
        if self.weights.size:
            return np.asarray(self.points[sampling.resampled(self.weights, count, seed)])
        generator = np.random.default_rng(seed)
        student_t = stats.multivariate_t(self.z, self.covariance, self.degrees, allow_singular=True)
        samples = student_t.rvs(count, random_state=generator).reshape(count, -1)
        is_exchanged = generator.random(count) < 0.5
        distances = samples[is_exchanged] - self.z
        samples[is_exchanged] = self.exchanged_z + distances[:, self._exchanged_order()]
        return samples + generator.choice(self._all_shifts, count)


@one_library_thread()
def fit(
    campaign: str | Path | Campaign,
    folder: str | Path,
    *,
    jobs: int = 2,
    progress: Progress | None = None,
    announce: Progress | None = None,
) -> Posterior:
    """Fit the unknowns of a campaign; finished steps in `folder` are not computed again.

    Args:
        campaign: its folder, or a loaded one.
        folder: of the journal of steps.
        jobs: threads that simulate.
        progress: called with a line after each step.
        announce: called with what comes next, before it.

    Raises `InputError` for a campaign that cannot be read, and where the machine to begin with
    cannot follow what was demanded; `OutOfBounds` where it leaves its physical bounds.

    >>> import tempfile
    >>> from pathlib import Path
    >>> folder = Path(tempfile.mkdtemp())
    >>> heavy = cmf_mj.load_cab(None, "lab").changed("heavy", mass=330.0)
    >>> command = cmf_mj.signals.sine("surge", 0.01, frequency=1.0, cycles=8)
    >>> settings = {"electronics": "noisy", "record_every": 16}
    >>> record = cmf_mj.simulate(cmf_mj.Hexapod(heavy), "original", command, **settings)
    >>> file = record.save(folder / "surge.parquet")
    >>> table = '''machine = "lab"
    ... law = "original"
    ... [recordings.surge]
    ... file = "surge.parquet"
    ... kind = "multisine"
    ... [unknowns.mass]
    ... path = "cab.mass"
    ... deviation = 30.0
    ... source = "a guess"'''
    >>> written = (folder / "campaign.toml").write_text(table)
    >>> posterior = cmf_mj.fit(folder, folder / "out")
    >>> from cmf_mj.studies.fit.results import physical
    >>> print(f"{physical(posterior, posterior.z)[0]:.0f} kg")
    330 kg
    """
    campaign = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
    report, announce = progress or (lambda text: None), announce or (lambda text: None)
    digests = {recording.name: recording.record.digest for recording in campaign.recordings}
    settings = campaign.settings.model_dump(mode="json", exclude_defaults=True)
    identity = {"campaign": settings, "recordings": digests}
    journal = Journal(Path(folder) / "steps", identity)
    names = tuple(name for name, *_ in campaign.unknowns.numbers())
    recording_count = len(campaign.recordings_where(held_back=False))
    model = Model(campaign)
    announce("weighing at rest")
    x = np.append(model.weigh(), np.zeros(model.clocks))
    step_number, width = 0, np.full(x.size, LARGEST_WIDTH)
    if campaign.settings.simulated:
        report("the data sheet's machine, simulated")
        campaign = campaign._replace(evidence=_evidence_with_shift(campaign, journal, jobs))
    for stage in STAGES if recording_count else ("whole",):
        fitter = Fitter(campaign, stage, jobs)
        for step in range(fitter.stage.steps):
            note = ", compiling first if new" if step_number == 0 else ""
            machines = f"{x.size + 1} machines, {recording_count} recordings each"
            announce(f"{stage} {step + 1}: {machines}{note}")
            if step_number not in journal.results:
                journal.add(step_number, [improve(fitter, x, width)])
            (row,) = journal.results[step_number]
            step_number += 1
            report(f"{stage} {step + 1}: -ln L {row['merit']:.1f}, {row['gain']:.1f} gained")
            x, width = np.array(row["x"]), np.array(row["width"])
            if row["done"]:
                break
    best = fitter.linearised_at(x, width)
    covariance = spread(best.information, x)
    twins, exchanged = _find_twins(fitter, names, best)
    points, weights = np.empty((0, len(names))), np.empty(0)
    if not recording_count:
        points, weights = _draw(fitter, journal, report)
    numbers = slice(len(names))  # without clocks
    return Posterior(
        campaign=campaign,
        names=names,
        z=x[numbers],
        covariance=covariance[numbers, numbers],
        degrees=max(3.0, recording_count - 1.0),
        linearised=best,
        twins=twins,
        exchanged_z=exchanged[numbers],
        points=points,
        weights=weights,
    )


def _draw(fitter: Fitter, journal: Journal, report: Progress) -> tuple[Array, Array]:
    """Draw points of importance sampling with their weights; the journal keeps its rounds."""

    def log_likelihoods(round_number: int, points: Array) -> Array:
        row_number = _SHIFT_ROW - 1 - round_number
        if row_number not in journal.results:
            costs = map(fitter.cost, points, fitter.residuals_at(list(points)))
            journal.add(row_number, [{"merit": list(costs)}])
        (result,) = journal.results[row_number]
        return np.asarray(0.5 * (points**2).sum(axis=1) - result["merit"])

    draws = sampling.importance(log_likelihoods, fitter.model.size, _DRAWS, _ROUNDS, _SEED)
    size = sampling.effective_size(draws.weights)
    report(f"{len(draws.points)} machines drawn, effective sample size {size:.0f}")
    return draws.points, draws.weights


def _evidence_with_shift(campaign: Campaign, journal: Journal, jobs: int) -> Evidence:
    """The evidence with what linearisation misses, which the journal keeps."""
    if _SHIFT_ROW not in journal.results:
        shift = campaign.evidence.with_shift(jobs).shift
        journal.add(_SHIFT_ROW, [{"shift": shift.tolist()}])
    (row,) = journal.results[_SHIFT_ROW]
    return campaign.evidence._replace(shift=np.array(row["shift"]))


def _find_twins(
    fitter: Fitter, names: tuple[str, ...], best: Linearised
) -> tuple[tuple[tuple[str, str], ...], Array]:
    """Find pairs whose exchange costs next to nothing, and the coordinates with them exchanged."""
    twins, x = [], best.x
    fitted, sheet = fitter.model.plant_at(x).parameters, fitter.model.plant.parameters
    for first, second in _TWINS:
        if not {first, second} <= set(names):
            continue
        exchanged = x.copy()
        for name, twin in ((first, second), (second, first)):
            unknown = fitter.model.unknowns[name]
            grid = np.linspace(-_TWIN_REACH, _TWIN_REACH, 2001)
            values = unknown.number(getattr(sheet, name).si, unknown.at(stats.norm.cdf(grid)))
            exchanged[names.index(name)] = np.interp(getattr(fitted, twin).si, values, grid)
        if fitter.cost(exchanged, fitter.residuals(exchanged)) - best.cost < _TWIN_LOSS:
            twins.append((first, second))
            x = exchanged
    return tuple(twins), x
