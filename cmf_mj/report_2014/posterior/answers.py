"""Tables of a study of the unknown: probabilities, differences and intervals under its weights.

Every statement is made under the prior, under all evidence, and with each group of evidence left
out: a statement that holds under all of them does not depend on one reading of the report.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
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
"""Levels of all quantiles: the ends of the 90 % interval about the median."""

REFERENCE = "position_error_rate"
"""The law that acceleration feedback is added to."""

_FEWEST_MACHINES = 5  #: That measures have an interval of.
_ERROR_COUNT = 41  #: Errors of reading that a prediction is spread over.

_TITLES = {"rows": "hardware rows", "fits": "hardware fits", "three_g": "3 g", "flown": "flown"}
"""Titles of `GROUPS`."""


def interval_text(span: Array, form: str = ".2f") -> str:
    """A median and a 90 % interval as text."""
    low, middle, high = (number(float(value), form) for value in span)
    return middle if middle == "-" else f"{middle} ({low} to {high})"


def percent_text(share: float) -> str:
    """A share as per cent, without rounding to certainty."""
    text = number(100.0 * share, ".0f %")
    if share < 1.0 and text == "100 %":
        return "over 99 %"
    return "under 1 %" if share > 0.0 and text == "0 %" else text


def probability_interval(share: float, count: float) -> Array:
    """5 %, the share itself and 95 % of a probability seen in so many machines (Jeffreys)."""
    low, high = stats.beta.ppf((0.05, 0.95), share * count + 0.5, (1.0 - share) * count + 0.5)
    return np.array([min(low, share), share, max(high, share)])


def probability_text(span: Array) -> str:
    """A probability with its interval."""
    low, middle, high = (f"{100.0 * value:.0f}" for value in span)
    return f"{middle} % ({low} to {high})"


def _interval_field(name: str = "", title: str | None = None, form: str = ".2f") -> Field:
    """A field of quantiles at `LEVELS`."""
    return Field(name, title, partial(interval_text, form=form))


def _fields_without(form: Callable[[Array], str]) -> Iterator[Field]:
    """Fields of a statement with each group of evidence left out."""
    for group, title in _TITLES.items():
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
    agreeing: int  #: Simulated machines with the verdict of the linear loop.


STABILITY_FIELDS = (
    *map(Field, ("law", "cab")),
    Field("prior", form=probability_text),
    Field("posterior", "all evidence", form=probability_text),
    *_fields_without(probability_text),
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


CHANGE_FIELDS = (
    *map(Field, ("law", "cab")),
    _interval_field("prior", form="+.3f"),
    _interval_field("posterior", "all evidence", "+.3f"),
    Field("same_sign", form=probability_text),
    *_fields_without(partial(interval_text, form="+.3f")),
)


class LawMeasures(NamedTuple):
    """Measures of a law along an axis on machines drawn from the posterior, at `LEVELS`."""

    cab: str
    law: str
    dof: str
    stable: Annotated[Array, Field(form=probability_text)]
    """Share of the machines, and its interval; the others have no measures."""
    phase_bandwidth_hz: Annotated[Array, _interval_field(title="-90 deg [Hz]")]
    gain_bandwidth_hz: Annotated[Array, _interval_field(title="-3 dB [Hz]")]
    peak_gain_db: Annotated[Array, _interval_field(title="peak [dB]", form=".1f")]
    damping_ratio: Annotated[Array, _interval_field(title="zeta")]


_MEASURE_NAMES = ("phase_bandwidth_hz", "gain_bandwidth_hz", "peak_gain_db", "damping_ratio")


class Sensitivity(NamedTuple):
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
    damping: Annotated[Array, _interval_field(title="least damping ratio", form=".3f")]
    """Least damping ratio of any cab, at `LEVELS`."""


class EvidenceCheck(NamedTuple):
    """One observation with what machines make of it, at `LEVELS`."""

    name: Annotated[str, Field(title="observation")]
    observed: Annotated[float, Field(title="printed", form=".3g")]
    deviation: Annotated[float, Field(title="s", form=".2g")]
    """Of the printed value, see `evidence`."""
    prior: Annotated[Array, _interval_field(form=".3g")]
    posterior: Annotated[Array, _interval_field(title="all evidence", form=".3g")]

    @property
    def inside(self) -> bool:
        """Whether the printed value lies in the 90 % interval under all evidence."""
        low, _, high = self.posterior
        return bool(low <= self.observed <= high)


UNKNOWN_FIELDS = (
    Field("unknown"),
    Field("unit", of="range.unit"),
    Field("", "prior", of=lambda row: f"{row['range'].low:g} to {row['range'].high:g}"),
    _interval_field("posterior", "all evidence", ".3g"),
    Field("source", "source of the bounds", of="range.source"),
    Field("low", of="range.low", printed=False),
    Field("high", of="range.high", printed=False),
)


def weights(results: Results, groups: Sequence[str] = GROUPS) -> Array:
    """Weights of the machines by groups of evidence, sum 1."""
    likelihoods = [column(results.machines, f"log_{group}") for group in groups]
    return normalised(np.sum([column(results.machines, "log_ratio"), *likelihoods], axis=0))


def _weights_without(results: Results) -> dict[str, Array]:
    """Weights with each group of evidence left out."""
    rest = {left_out: [group for group in GROUPS if group != left_out] for left_out in GROUPS}
    return {left_out: weights(results, groups) for left_out, groups in rest.items()}


def predicted_quantiles(values: Array, deviation: float, weights: Array) -> Array:
    """Quantiles at `LEVELS` of what machines make of an observation, with its deviation."""
    errors = deviation * stats.norm.ppf((np.arange(_ERROR_COUNT) + 0.5) / _ERROR_COUNT)
    readings = (values[:, None] + errors).ravel()
    return weighted_quantiles(readings, np.repeat(weights, _ERROR_COUNT), LEVELS)


def _probability(event: Array, weights: Array) -> Array:
    """Probability of an event, and its interval."""
    return probability_interval(float(weights @ event) / weights.sum(), effective_size(weights))


def stability(results: Results) -> Result[Stability]:
    """How often each law is unstable with each cab."""
    prior, posterior, rows = weights(results, ()), weights(results), []
    reduced = _weights_without(results)
    for (law, cab), machines in groups(results.damping, "law", "cab"):
        unstable = 1.0 - column(machines, "stable")
        simulated = where(results.simulated, law=law, cab=cab)
        simulated_unstable = 1.0 - column(simulated, "stable")
        linear_unstable = unstable[simulated["machine"].to_numpy()]
        row = Stability(
            law=law,
            cab=cab,
            prior=_probability(unstable, prior),
            posterior=_probability(unstable, posterior),
            without={group: _probability(unstable, w) for group, w in reduced.items()},
            simulated=int(simulated_unstable.sum()),
            machines=simulated.num_rows,
            agreeing=int((simulated_unstable == linear_unstable).sum()),
        )
        rows.append(row)
    count, size = results.machines.num_rows, effective_size(posterior)
    title = f"how often each law is unstable: {count} machines drawn, effective {size:.0f}"
    return Result(rows, STABILITY_FIELDS, title)


def damping_changes(results: Results) -> Result[DampingChange]:
    """What each law changes in the pair's damping against `REFERENCE`."""
    prior, posterior, rows = weights(results, ()), weights(results), []
    reduced = _weights_without(results)
    pairs = {at: column(machines, "pair") for at, machines in groups(results.damping, "law", "cab")}
    for (law, cab), damping in pairs.items():
        if law == REFERENCE or (REFERENCE, cab) not in pairs:
            continue
        change = damping - pairs[REFERENCE, cab]
        quantiles = weighted_quantiles(change, posterior, LEVELS)
        row = DampingChange(
            law=law,
            cab=cab,
            prior=weighted_quantiles(change, prior, LEVELS),
            posterior=quantiles,
            same_sign=_probability(np.sign(change) == np.sign(quantiles[1]), posterior),
            without={g: weighted_quantiles(change, w, LEVELS) for g, w in reduced.items()},
        )
        rows.append(row)
    return Result(rows, CHANGE_FIELDS)


def law_measures(results: Results) -> Result[LawMeasures]:
    """Measures of all laws on machines drawn from the posterior."""
    rows = []
    for (law, cab, dof), machines in groups(results.measures, "law", "cab", "dof"):
        count, stable = column(machines, "count"), column(machines, "stable")
        is_enough = stable.sum() >= _FEWEST_MACHINES
        stable_count = count * stable if is_enough else np.zeros_like(count)
        quantiles = {
            name: weighted_quantiles(column(machines, name), stable_count, LEVELS)
            for name in _MEASURE_NAMES
        }
        rows.append(LawMeasures(cab, law, dof, _probability(stable, count), **quantiles))
    return Result(rows, fields_of(LawMeasures))


def sensitivities(results: Results) -> list[Sensitivity]:
    """Least damping ratio of each law at both ends of each unknown, the others at their medians."""
    damping = {(row["about"], row["law"]): row["least"] for row in results.points.to_pylist()}
    laws = [law.name for law in results.study.laws]
    rows = []
    for name, law in product(results.study.settings.unknowns, laws):
        low, median, high = (damping[key, law] for key in (f"{name} low", "median", f"{name} high"))
        rows.append(Sensitivity(name, law, low, median, high))
    return rows


def gain_steps(results: Results) -> Result[GainStep]:
    """All gains of acceleration tried, behind all filters."""
    steps = []
    for (corner, gain), rows in groups(results.gains, "corner", "gain"):
        of_all_cabs = [("count", "min"), ("stable", "all"), ("least", "min")]
        machines = rows.group_by("machine", use_threads=False).aggregate(of_all_cabs)
        counts, stable = column(machines, "count_min"), column(machines, "stable_all")
        damping = weighted_quantiles(column(machines, "least_min"), counts, LEVELS)
        steps.append(GainStep(gain, corner, _probability(stable, counts), damping))
    return Result(steps, fields_of(GainStep))


def evidence_checks(results: Results) -> Result[EvidenceCheck]:
    """All observations, and last the one held out: the damping ratio with the integral.

    Predictions include the error of the printed value.
    """
    before, after, rows = weights(results, ()), weights(results), list[EvidenceCheck]()
    for item in observations():
        values = item.transformed(column(results.machines, item.name))
        prior = predicted_quantiles(values, item.deviation, before)
        posterior = predicted_quantiles(values, item.deviation, after)
        if item.is_relative:
            prior, posterior = np.exp(prior), np.exp(posterior)
        rows.append(EvidenceCheck(item.name, item.value, item.deviation, prior, posterior))
    inside = Field("inside", form=lambda inside: "yes" if inside else "no")
    return Result(rows, (*fields_of(EvidenceCheck), inside))


def unknown_ranges(results: Results) -> Result[dict[str, Any]]:
    """Range and posterior of each unknown."""
    rows = []
    for name, unknown in results.study.settings.unknowns.items():
        values = column(results.machines, name)
        quantiles = weighted_quantiles(values, weights(results), LEVELS)
        rows.append({"unknown": name, "range": unknown, "posterior": quantiles})
    return Result(rows, UNKNOWN_FIELDS)


def posterior_tables(results: Results) -> dict[str, Result[Any]]:
    """All tables by the name of their file."""
    return {
        "stability": stability(results),
        "changes": damping_changes(results),
        "spans": law_measures(results),
        "gains": gain_steps(results),
        "unknowns": unknown_ranges(results),
        "evidence": evidence_checks(results),
    }
