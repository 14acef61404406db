"""What a study of the unknown says: probabilities, differences and intervals under its weights.

Every statement is made under the prior, under all evidence, and with each group of evidence left
out: what survives them all does not depend on one reading of the report.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.analysis.published import published_results
from cmf_mj.report_2014.posterior.evidence import HELD_OUT, observations, scatter
from cmf_mj.report_2014.posterior.run import GROUPS, Results, column
from cmf_mj.report_2014.posterior.sampling import normalised, weighted_quantiles

Array = NDArray[np.float64]

LEVELS = np.array([0.05, 0.5, 0.95])
"""Of all quantiles."""

REFERENCE = "position_error_rate"
"""The law that acceleration feedback is added to."""

_ERRORS = 41
"""Errors of reading that a prediction is spread over."""

ROBUST = 0.05
"""Largest distance of a probability from 0 or 1 that counts as robust."""


class Stability(NamedTuple):
    """How often a law is unstable with a cab."""

    law: str
    cab: str
    prior: float  #: Probability before any evidence.
    posterior: float  #: Probability under all evidence.
    error: float  #: Standard error of the sampling.
    without: tuple[float, ...]  #: Probability with each of `GROUPS` left out.
    simulated: int  #: Machines found unstable by simulation.
    machines: int  #: Machines simulated.
    agreeing: int  #: Of these, the ones with the verdict of the linear loop.

    @property
    def robust(self) -> bool:
        """Whether prior, posterior and all between agree that it is, or is not."""
        every = np.array([self.prior, self.posterior, *self.without])
        return bool((every < ROBUST).all() or (every > 1.0 - ROBUST).all())


class DampingChange(NamedTuple):
    """What a law changes in the damping ratio of the pair against `REFERENCE`."""

    law: str
    cab: str
    prior: Array  #: At `LEVELS`, before any evidence.
    posterior: Array  #: At `LEVELS`.
    same_sign: float  #: Probability, under all evidence, that it has the sign of its median.


class Span(NamedTuple):
    """Measures of a law along an axis on machines drawn from the posterior, at `LEVELS`."""

    law: str
    cab: str
    dof: str
    stable: float  #: Share of the machines; the others have no measures.
    phase_bandwidth_hz: Array
    gain_bandwidth_hz: Array
    peak_gain_db: Array
    damping_ratio: Array


class Moved(NamedTuple):
    """Least damping ratio of a law at both ends of the range of an unknown."""

    unknown: str
    law: str
    low: float
    median: float  #: With all unknowns at their medians.
    high: float

    @property
    def swing(self) -> float:
        """Largest change either way."""
        return max(abs(self.low - self.median), abs(self.high - self.median))

    @property
    def turns(self) -> bool:
        """Whether either end has another verdict than the median."""
        return min(self.low * self.median, self.high * self.median) < 0.0


class GainStep(NamedTuple):
    """One gain of acceleration behind one filter, on machines drawn from the posterior."""

    corner: float  #: [Hz], 0 for no filter.
    gain: float  #: [%/(in/s^2)].
    stable: float  #: Share of the machines on which it is stable with every cab.
    damping: Array  #: Least damping ratio of any cab, at `LEVELS`.


class EvidenceCheck(NamedTuple):
    """One observation with what machines make of it, at `LEVELS`."""

    name: str
    observed: float
    deviation: float  #: Of the printed value, see `evidence`.
    prior: Array
    posterior: Array

    @property
    def inside(self) -> bool:
        """Whether the 90 % interval holds it."""
        return bool(self.posterior[0] <= self.observed <= self.posterior[-1])


def weights(results: Results, groups: Sequence[str] = GROUPS) -> Array:
    """Weights of the machines by groups of evidence, sum 1."""
    stated = [column(results.machines, f"log_{group}") for group in groups]
    return normalised(np.sum([column(results.machines, "log_ratio"), *stated], axis=0))


def _both(results: Results, values: Array, times: int = 1) -> list[Array]:
    """Quantiles under prior and posterior of values that each machine has `times`."""
    every = weights(results, ()), weights(results)
    return [weighted_quantiles(values, np.repeat(each, times), LEVELS) for each in every]


def _by_machine(results: Results, name: str) -> dict[tuple[str, str], Array]:
    """A column of the damping ratios by law and cab, machines in order."""
    found: dict[tuple[str, str], list[float]] = {}
    for row in results.damping.to_pylist():
        found.setdefault((row["law"], row["cab"]), []).append(float(row[name]))
    return {key: np.array(values) for key, values in found.items()}


def stability(results: Results) -> list[Stability]:
    """How often each law is unstable with each cab."""
    every, prior, rows = weights(results), weights(results, ()), []
    without = [weights(results, [one for one in GROUPS if one != left]) for left in GROUPS]
    verdicts = results.simulated.to_pylist()
    for (law, cab), stable in _by_machine(results, "stable").items():
        unstable = 1.0 - stable
        share = float(every @ unstable)
        run = [row for row in verdicts if (row["law"], row["cab"]) == (law, cab)]
        same = [row["stable"] == bool(stable[row["machine"]]) for row in run]
        rows.append(
            Stability(
                *(law, cab, float(prior @ unstable), share),
                float(np.sqrt(np.sum(every**2 * (unstable - share) ** 2))),
                tuple(float(some @ unstable) for some in without),
                *(sum(not row["stable"] for row in run), len(run), sum(same)),
            )
        )
    return rows


def changes(results: Results) -> list[DampingChange]:
    """What each law changes in the pair's damping against `REFERENCE`."""
    every, pairs, rows = weights(results), _by_machine(results, "pair"), []
    for (law, cab), damping in pairs.items():
        if law == REFERENCE or (REFERENCE, cab) not in pairs:
            continue
        change = damping - pairs[REFERENCE, cab]
        prior, posterior = _both(results, change)
        same = float(every @ (np.sign(change) == np.sign(posterior[1])))
        rows.append(DampingChange(law, cab, prior, posterior, same))
    return rows


def spans(results: Results) -> list[Span]:
    """Measures of all laws on machines drawn from the posterior."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in results.measures.to_pylist():
        groups.setdefault((row["law"], row["cab"], row["dof"]), []).append(row)
    every = []
    for key, rows in groups.items():
        count, stable = _of(rows, "count"), _of(rows, "stable")
        values = (_of(rows, name) for name in Span._fields[4:])
        quantiles = (weighted_quantiles(each, count * stable, LEVELS) for each in values)
        every.append(Span(*key, float(np.average(stable, weights=count)), *quantiles))
    return every


def _of(rows: Sequence[dict[str, Any]], name: str) -> Array:
    return np.array([row[name] for row in rows], dtype=float)


def moved(results: Results) -> list[Moved]:
    """Least damping ratio of each law at both ends of each unknown, the others at their medians."""
    at = {(row["about"], row["law"]): row["least"] for row in results.points.to_pylist()}
    laws = [law.name for law in results.study.laws]
    return [
        Moved(name, law, *(at[key, law] for key in (f"{name} low", "median", f"{name} high")))
        for name in results.study.settings.unknowns
        for law in laws
    ]


def stability_map(results: Results, x: str, y: str, law: str, name: str) -> tuple[Array, ...]:
    """Damping ratio over two unknowns: the values of x (n,) and y (n,), and the map (n, n)."""
    rows = [r for r in results.points.to_pylist() if (r["about"], r["law"]) == (f"{x} {y}", law)]
    side = results.study.settings.grid
    grids = [np.array([row[key] for row in rows]).reshape(side, side) for key in (x, y, name)]
    return grids[0][:, 0], grids[1][0], grids[2]


def gain_steps(results: Results) -> list[GainStep]:
    """All gains of acceleration tried, behind all filters."""
    found: dict[tuple[float, float], dict[int, list[dict[str, Any]]]] = {}
    for row in results.gains.to_pylist():
        by_machine = found.setdefault((row["corner"], row["gain"]), {})
        by_machine.setdefault(row["machine"], []).append(row)
    steps = []
    for (corner, gain), machines in found.items():
        counts = np.array([rows[0]["count"] for rows in machines.values()], dtype=float)
        stable = np.array([_of(rows, "stable").all() for rows in machines.values()])
        least = np.array([_of(rows, "least").min() for rows in machines.values()])
        share = float(counts @ stable / counts.sum())
        steps.append(GainStep(corner, gain, share, weighted_quantiles(least, counts, LEVELS)))
    return steps


def checks(results: Results) -> list[EvidenceCheck]:
    """All observations, and last the one held out: the damping ratio with the integral.

    What is predicted of that one includes the scatter of printed damping ratios.
    """
    rows = [
        EvidenceCheck(
            o.name, o.value, o.deviation, *_both(results, column(results.machines, o.name))
        )
        for o in observations()
    ]
    name, error = f"{HELD_OUT}_damping_ratio", float(scatter()[2])
    errors = error * stats.norm.ppf((np.arange(_ERRORS) + 0.5) / _ERRORS)
    read = (column(results.machines, name)[:, None] + errors).ravel()
    (stated,) = (r for r in published_results() if (r.law, r.of) == (HELD_OUT, "hardware"))
    assert stated.damping_ratio is not None
    return [*rows, EvidenceCheck(name, stated.damping_ratio, error, *_both(results, read, _ERRORS))]


def ranges(results: Results) -> dict[str, Array]:
    """Posterior of each unknown at `LEVELS`."""
    return {
        name: _both(results, column(results.machines, name))[1]
        for name in results.study.settings.unknowns
    }
