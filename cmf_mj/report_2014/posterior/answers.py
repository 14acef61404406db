"""What a study of the unknown says: probabilities, differences and intervals under its weights.

Every statement is made under the prior, under all evidence, and with each group of evidence left
out: what survives them all does not depend on one reading of the report.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.core.result import Field, Result, column, fields_of, groups, number, where
from cmf_mj.report_2014.posterior.evidence import observations
from cmf_mj.report_2014.posterior.run import GROUPS, Results
from cmf_mj.studies.fit.sampling import effective_size, normalised, weighted_quantiles

Array = NDArray[np.float64]

LEVELS = np.array([0.05, 0.5, 0.95])
"""Of all quantiles."""

REFERENCE = "position_error_rate"
"""The law that acceleration feedback is added to."""

_FEWEST = 5  # machines that have an interval

_ERRORS = 41
"""Errors of reading that a prediction is spread over."""

EVIDENCE = {"rows": "hardware rows", "fits": "hardware fits", "three_g": "3 g", "flown": "flown"}
"""What a reader calls each of `GROUPS`."""


def interval(span: Array, form: str = ".2f") -> str:
    """A median and a 90 % interval as text."""
    low, middle, high = (number(float(value), form) for value in span)
    return middle if middle == "-" else f"{middle} ({low} to {high})"


def percent(share: float) -> str:
    """A share as per cent, without rounding to certainty."""
    text = number(100.0 * share, ".0f %")
    if share < 1.0 and text == "100 %":
        return "over 99 %"
    return "under 1 %" if share > 0.0 and text == "0 %" else text


def chance(share: float, count: float) -> Array:
    """5 %, the share itself and 95 % of a probability seen in so many machines (Jeffreys)."""
    low, high = stats.beta.ppf((0.05, 0.95), share * count + 0.5, (1.0 - share) * count + 0.5)
    return np.array([min(low, share), share, max(high, share)])


def probability_text(span: Array) -> str:
    """A probability with its interval."""
    low, middle, high = (f"{100.0 * value:.0f}" for value in span)
    return f"{middle} % ({low} to {high})"


def _span(title: str | None = None, form: str = ".2f", name: str = "") -> Field:
    """Quantiles at `LEVELS`."""
    return Field(name, title, partial(interval, form=form))


def _without(form: Callable[[Array], str]) -> Iterator[Field]:
    """What holds with each group of evidence left out."""
    for group, title in EVIDENCE.items():
        yield Field(f"without_{group}", f"without {title}", form, of=f"without.{group}")


class Stability(NamedTuple):
    """How often a law is unstable with a cab."""

    law: str
    cab: str
    prior: Array  #: Probability before any evidence, and 90 % interval of the sampling.
    posterior: Array  #: Likewise under all evidence.
    without: dict[str, Array]  #: Likewise with each of `GROUPS` left out.
    simulated: int  #: Machines found unstable by simulation.
    machines: int  #: Machines simulated.
    agreeing: int  #: Of these, the ones with the verdict of the linear loop.


STABILITY = (
    *map(Field, ("law", "cab")),
    Field("prior", form=probability_text),
    Field("posterior", "all evidence", form=probability_text),
    *_without(probability_text),
    Field("", "simulated", of=lambda row: f"{row.simulated} of {row.machines}"),
    Field("", "same verdict", of=lambda row: f"{row.agreeing} of {row.machines}"),
    *(Field(name, printed=False) for name in ("simulated", "machines", "agreeing")),
)


class DampingChange(NamedTuple):
    """What a law changes in the damping ratio of the pair against `REFERENCE`."""

    law: str
    cab: str
    prior: Array  #: At `LEVELS`, before any evidence.
    posterior: Array  #: At `LEVELS`, under all evidence.
    same_sign: Array
    """Probability, under all evidence, that it has the sign of its median, with its interval."""
    without: dict[str, Array]  #: At `LEVELS`, with each of `GROUPS` left out.


CHANGES = (
    *map(Field, ("law", "cab")),
    _span(form="+.3f", name="prior"),
    _span("all evidence", "+.3f", "posterior"),
    Field("same_sign", form=probability_text),
    *_without(partial(interval, form="+.3f")),
)


class Span(NamedTuple):
    """Measures of a law along an axis on machines drawn from the posterior, at `LEVELS`."""

    cab: str
    law: str
    dof: str
    stable: Annotated[Array, Field(form=probability_text)]
    """Share of the machines, and its interval; the others have no measures."""
    phase_bandwidth_hz: Annotated[Array, _span("-90 deg [Hz]")]
    gain_bandwidth_hz: Annotated[Array, _span("-3 dB [Hz]")]
    peak_gain_db: Annotated[Array, _span("peak [dB]", ".1f")]
    damping_ratio: Annotated[Array, _span("zeta")]


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


class GainStep(NamedTuple):
    """One gain of acceleration behind one filter, on machines drawn from the posterior."""

    gain: Annotated[float, Field(title="gain [%/(in/s²)]", form="g")]
    corner: Annotated[
        float, Field(title="filter", form=lambda hertz: f"{hertz:.3g} Hz" if hertz else "none")
    ]  #: [Hz], 0 for no filter.
    stable: Annotated[Array, Field(title="stable with every cab", form=probability_text)]
    """Share of the machines on which it is stable with every cab, and its interval."""
    damping: Annotated[Array, _span("least damping ratio", ".3f")]
    """Least damping ratio of any cab, at `LEVELS`."""


class EvidenceCheck(NamedTuple):
    """One observation with what machines make of it, at `LEVELS`."""

    name: Annotated[str, Field(title="observation")]
    observed: Annotated[float, Field(title="printed", form=".3g")]
    deviation: Annotated[float, Field(title="s", form=".2g")]
    """Of the printed value, see `evidence`."""
    prior: Annotated[Array, _span(form=".3g")]
    posterior: Annotated[Array, _span("all evidence", ".3g")]

    @property
    def inside(self) -> bool:
        """Whether the 90 % interval holds it."""
        return bool(self.posterior[0] <= self.observed <= self.posterior[-1])


UNKNOWNS = (
    Field("unknown"),
    Field("unit", of="range.unit"),
    Field("", "prior", of=lambda row: f"{row['range'].low:g} to {row['range'].high:g}"),
    _span("all evidence", ".3g", "posterior"),
    Field("source", "source of the bounds", of="range.source"),
    Field("low", of="range.low", printed=False),
    Field("high", of="range.high", printed=False),
)


def weights(results: Results, groups: Sequence[str] = GROUPS) -> Array:
    """Weights of the machines by groups of evidence, sum 1."""
    stated = [column(results.machines, f"log_{group}") for group in groups]
    return normalised(np.sum([column(results.machines, "log_ratio"), *stated], axis=0))


def _both(results: Results, values: Array) -> list[Array]:
    """Quantiles under prior and posterior of the values of all machines."""
    return [weighted_quantiles(values, weights(results, each), LEVELS) for each in ((), GROUPS)]


def predicted(made: Array, deviation: float, weights: Array) -> Array:
    """Quantiles at `LEVELS` of what machines make of a number, read with its deviation."""
    errors = deviation * stats.norm.ppf((np.arange(_ERRORS) + 0.5) / _ERRORS)
    read = (made[:, None] + errors).ravel()
    return weighted_quantiles(read, np.repeat(weights, _ERRORS), LEVELS)


def _reduced(results: Results) -> dict[str, Array]:
    """Weights with each group of evidence left out."""
    return {g: weights(results, [one for one in GROUPS if one != g]) for g in GROUPS}


def _chance(event: Array, weights: Array) -> Array:
    """Probability of an event, and its interval."""
    return chance(float(weights @ event) / weights.sum(), effective_size(weights))


def stability(results: Results) -> Result[Stability]:
    """How often each law is unstable with each cab."""
    every, without, rows = weights(results), _reduced(results), []
    for (law, cab), machines in groups(results.damping, "law", "cab"):
        unstable, run = 1.0 - column(machines, "stable"), where(results.simulated, law=law, cab=cab)
        simulated = 1.0 - column(run, "stable")
        agreeing = int((simulated == unstable[run["machine"].to_numpy()]).sum())
        prior, posterior = _chance(unstable, weights(results, ())), _chance(unstable, every)
        reduced = {group: _chance(unstable, some) for group, some in without.items()}
        counts = (int(simulated.sum()), run.num_rows, agreeing)
        rows.append(Stability(law, cab, prior, posterior, reduced, *counts))
    drawn = f"{results.machines.num_rows} machines drawn"
    title = f"how often each law is unstable: {drawn}, effective {effective_size(every):.0f}"
    return Result(rows, STABILITY, title)


def changes(results: Results) -> Result[DampingChange]:
    """What each law changes in the pair's damping against `REFERENCE`."""
    every, without, rows = weights(results), _reduced(results), []
    pairs = {at: column(machines, "pair") for at, machines in groups(results.damping, "law", "cab")}
    for (law, cab), damping in pairs.items():
        if law == REFERENCE or (REFERENCE, cab) not in pairs:
            continue
        change = damping - pairs[REFERENCE, cab]
        prior, posterior = _both(results, change)
        same = _chance(np.sign(change) == np.sign(posterior[1]), every)
        rest = {group: weighted_quantiles(change, w, LEVELS) for group, w in without.items()}
        rows.append(DampingChange(law, cab, prior, posterior, same, rest))
    return Result(rows, CHANGES)


def spans(results: Results) -> Result[Span]:
    """Measures of all laws on machines drawn from the posterior."""
    rows = []
    for (law, cab, dof), machines in groups(results.measures, "law", "cab", "dof"):
        count, stable = column(machines, "count"), column(machines, "stable")
        some = count * stable if stable.sum() >= _FEWEST else np.zeros_like(count)
        values = (column(machines, name) for name in Span._fields[4:])
        quantiles = (weighted_quantiles(each, some, LEVELS) for each in values)
        rows.append(Span(cab, law, dof, _chance(stable, count), *quantiles))
    return Result(rows, fields_of(Span))


def moved(results: Results) -> list[Moved]:
    """Least damping ratio of each law at both ends of each unknown, the others at their medians."""
    at = {(row["about"], row["law"]): row["least"] for row in results.points.to_pylist()}
    laws = [law.name for law in results.study.laws]
    return [
        Moved(name, law, *(at[key, law] for key in (f"{name} low", "median", f"{name} high")))
        for name in results.study.settings.unknowns
        for law in laws
    ]


def gain_steps(results: Results) -> Result[GainStep]:
    """All gains of acceleration tried, behind all filters."""
    steps = []
    for (corner, gain), rows in groups(results.gains, "corner", "gain"):
        cabs = [("count", "min"), ("stable", "all"), ("least", "min")]
        machines = rows.group_by("machine", use_threads=False).aggregate(cabs)
        counts, stable = column(machines, "count_min"), column(machines, "stable_all")
        least = weighted_quantiles(column(machines, "least_min"), counts, LEVELS)
        steps.append(GainStep(gain, corner, _chance(stable, counts), least))
    return Result(steps, fields_of(GainStep))


def checks(results: Results) -> Result[EvidenceCheck]:
    """All observations, and last the one held out: the damping ratio with the integral.

    What is predicted includes the error of what is printed.
    """
    rows = []
    for one in observations():
        made = one.counted(column(results.machines, one.name))
        both = [predicted(made, one.deviation, weights(results, each)) for each in ((), GROUPS)]
        both = [np.exp(span) if one.relative else span for span in both]
        rows.append(EvidenceCheck(one.name, one.value, one.deviation, *both))
    inside = Field("inside", form=lambda inside: "yes" if inside else "no")
    return Result(rows, (*fields_of(EvidenceCheck), inside))


def unknowns(results: Results) -> Result[dict[str, Any]]:
    """Range and posterior of each unknown."""
    rows = []
    for name, one in results.study.settings.unknowns.items():
        posterior = _both(results, column(results.machines, name))[1]
        rows.append({"unknown": name, "range": one, "posterior": posterior})
    return Result(rows, UNKNOWNS)


def posterior_tables(results: Results) -> dict[str, Result[Any]]:
    """All tables by the name of their file."""
    tables: dict[str, Result[Any]] = {"stability": stability(results), "changes": changes(results)}
    tables |= {"spans": spans(results), "gains": gain_steps(results)}
    return tables | {"unknowns": unknowns(results), "evidence": checks(results)}
