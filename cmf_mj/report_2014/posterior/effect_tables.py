"""Tables of a study of effects: evidence, numbers left out, reports made up, verdicts.

A printed number y of deviation s that is left out has under the other evidence the rank

    u = sum w_i Phi((y - m_i) / s)

of machines i, with w_i of all numbers but y, or of all but those of its recording. Made-up reports
are m + s N(0, 1) of machines drawn with L^a; each is weighed as the report is, its machine left
out. The average takes plants without effects or with one, each by its share.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.core.result import Field, Result, fields_of
from cmf_mj.report_2014.posterior.answers import (
    LEVELS,
    REFERENCE,
    interval_text,
    percent_text,
    predicted_quantiles,
    probability_interval,
    probability_text,
)
from cmf_mj.report_2014.posterior.evidence import Observation, observation_arrays, observations
from cmf_mj.report_2014.posterior.study import AVERAGE, NONE, effect_settings
from cmf_mj.report_2014.posterior.weighing import Bank
from cmf_mj.studies.engine import Row
from cmf_mj.studies.fit.sampling import effective_size, normalised, quantiles, weighted_quantiles

Array = NDArray[np.float64]

_MADE_UP_POWER = 0.25  #: a of made-up reports.


class PlantEvidence(NamedTuple):
    """A plant with effects and its evidence."""

    plant: str
    evidence: Annotated[float, Field(title="ln Z over none", form="+.2f")]
    error: Annotated[float, Field(title="+-", form=".2f")]  #: Standard error of the sampling.
    share: Annotated[float, Field(form=percent_text)]
    """Of the plants with no effect or one."""
    size: Annotated[float, Field(title="effective machines", form=".0f")]
    value: Annotated[Array, Field(title="effect", form=partial(interval_text, form=".3g"))]
    """Of a single one, in the unit of the study, at `LEVELS`."""
    edge: Annotated[float, Field(title="nearest to a bound", form=".2f")]
    """Least distance of the median of an unknown from a bound, in shares of its range."""
    at: Annotated[str, Field(title="of")]  #: This unknown.


def plant_evidence(bank: Bank) -> Result[PlantEvidence]:
    """All plants, the most evidence first."""
    rows, shares, weights_of_none = list[PlantEvidence](), bank.shares(), bank.weights(NONE)
    for plant in bank.predicted:
        weights = bank.weights(plant)
        is_single = plant in shares and plant != NONE
        values = bank.effect(plant) if is_single else np.full(weights.size, np.nan)
        evidence = bank.log_evidence(plant) - bank.log_evidence(NONE)
        error = float(np.sqrt(((weights - weights_of_none) ** 2).sum()))
        value, size = weighted_quantiles(values, weights, LEVELS), effective_size(weights)
        edge, unknown = _nearest_bound(bank, weights)
        share = shares.get(plant, np.nan)
        rows.append(PlantEvidence(plant, evidence, error, share, size, value, edge, unknown))
    return Result(sorted(rows, key=lambda row: -row.evidence), fields_of(PlantEvidence))


def _nearest_bound(bank: Bank, weights: Array) -> tuple[float, str]:
    """Least distance of a median from a bound, in shares of its range, and the unknown's name."""
    unknowns = bank.study.settings.unknowns
    shares = quantiles(bank.points[:, : len(unknowns)]).T
    medians = (float(weighted_quantiles(share, weights, np.array(0.5))) for share in shares)
    return min((min(u, 1.0 - u), name) for u, name in zip(medians, unknowns, strict=True))


class LeftOut(NamedTuple):
    """A printed number, and what the rest of the evidence predicts of it."""

    plant: str
    number: str
    printed: Annotated[float, Field(form=".3g")]
    predicted: Annotated[Array, Field(form=partial(interval_text, form=".3g"))]
    """With the deviation of printed numbers, at `LEVELS`."""
    rank: Annotated[float, Field(form=".3f")]  #: u, the number left out.
    recording: Annotated[float, Field(title="recording left out", form=".3f")]
    """U, all numbers of its law or of the fits left out."""


def left_out(bank: Bank) -> Result[LeftOut]:
    """All printed numbers under the plant without effects, the likeliest one, and the average."""
    rows, recordings = list[LeftOut](), [_recording(item) for item in observations()]
    best = max(bank.predicted, key=bank.log_evidence)
    for plant in dict.fromkeys((NONE, best, AVERAGE)):
        shares = _shares_of(bank, plant)
        for place, item in enumerate(observations()):
            alike = [i for i, name in enumerate(recordings) if name == recordings[place]]
            values, weights = _others_prediction(bank, shares, place, [place])
            span = predicted_quantiles(values, item.deviation, weights)
            span = np.exp(span) if item.is_relative else span
            rank = _rank(item, values, weights)
            without_recording = _rank(item, *_others_prediction(bank, shares, place, alike))
            rows.append(LeftOut(plant, item.name, item.value, span, rank, without_recording))
    return Result(rows, fields_of(LeftOut))


def _recording(observation: Observation) -> str:
    """What an observation was read from: the recording of a law, or the fits."""
    is_row = observation.group == "rows"
    return observation.name.split("_")[0] if is_row else observation.group


def _shares_of(bank: Bank, plant: str) -> dict[str, float]:
    """Shares of single plants in a plant or in the average."""
    return bank.shares() if plant == AVERAGE else {plant: 1.0}


def _others_prediction(
    bank: Bank, shares: dict[str, float], place: int, left_out: Sequence[int]
) -> tuple[Array, Array]:
    """What machines of plants make of the observation at a place, transformed, and their weights.

    The observations at the places `left_out` do not count as evidence.
    """
    values = np.concatenate([bank.predicted[plant][:, place] for plant in shares])
    weights = [share * bank.weights(plant, left_out=left_out) for plant, share in shares.items()]
    known_weights = np.concatenate(weights) * np.isfinite(values)
    return np.where(known_weights > 0.0, values, 0.0), known_weights


def _rank(observation: Observation, values: Array, weights: Array) -> float:
    """The rank u of an observation among predictions, transformed."""
    printed = float(observation.transformed(observation.value))
    below = stats.norm.cdf((printed - values) / observation.deviation)
    return float(weights @ below / weights.sum())


class _MadeUpReport(NamedTuple):
    """What a report made up of a plant says of the plants."""

    likeliest: str
    rank: int  #: Place from 0 of the plant that it was made of.
    gain: float  #: Ln of this plant's evidence over none.
    largest_gain: float  #: Likewise of the likeliest plant.


_IN_FIRST_THREE, _AS_LARGE = "of the first three", "as much as the report"


def made_up(bank: Bank) -> Result[dict[str, Any]]:
    """How often reports made up of each plant make it, or another, the likeliest."""
    plants, rows = bank.single_plants, list[dict[str, Any]]()
    generator = np.random.default_rng([bank.study.settings.seed, 7])
    gain_of_report = max(map(bank.log_evidence, plants)) - bank.log_evidence(NONE)
    for plant in plants:
        reports = _made_up_reports(bank, plant, generator)
        ranks = np.array([report.rank for report in reports])
        likeliest = [report.likeliest for report in reports]
        row = {
            "plant": plant,
            "right": np.mean(ranks == 0),
            _IN_FIRST_THREE: np.mean(ranks < 3),
            _AS_LARGE: np.mean([report.largest_gain >= gain_of_report for report in reports]),
            "gain": np.median([report.gain for report in reports]),
        }
        rows.append(row | {f"found {other}": likeliest.count(other) for other in plants})
    shares = (Field(name, form=percent_text) for name in ("right", _IN_FIRST_THREE, _AS_LARGE))
    gain = Field("gain", "median ln Z over none", "+.2f")
    counts = (Field(f"found {plant}") for plant in plants)
    return Result(rows, (Field("plant"), *shares, gain, *counts))


def _made_up_reports(bank: Bank, plant: str, generator: np.random.Generator) -> list[_MadeUpReport]:
    """Reports made up of a plant, each weighed without the machine it is of."""
    weights = bank.ratio + _MADE_UP_POWER * bank.log_likelihood(plant)
    weights[~np.isfinite(bank.predicted[plant]).all(axis=1)] = -np.inf
    chances, deviations = normalised(weights), observation_arrays().deviations
    reports = list[_MadeUpReport]()
    for _ in range(effect_settings(bank.study).made_up):
        machine = int(generator.choice(chances.size, p=chances))
        noise = deviations * generator.normal(size=deviations.size)
        printed = bank.predicted[plant][machine] + noise
        ratio = bank.ratio.copy()
        ratio[machine] = -np.inf  # a machine must not find itself
        others = replace(bank, ratio=ratio)
        evidence = {p: others.log_evidence(p, printed=printed) for p in bank.single_plants}
        order = sorted(evidence, key=lambda p: -evidence[p])
        gain, largest = (evidence[p] - evidence[NONE] for p in (plant, order[0]))
        reports.append(_MadeUpReport(order[0], order.index(plant), gain, largest))
    return reports


class Verdict(NamedTuple):
    """What a law does with a cab on machines of a plant."""

    plant: str
    law: str
    cab: str
    unstable: Annotated[Array, Field(form=probability_text)]
    """Probability, and 90 % interval of the sampling."""
    without: Annotated[
        Array, Field(title="not as flown", form=probability_text)
    ]  #: Without `flown`.
    change: Annotated[
        Array, Field(title="pair against " + REFERENCE, form=partial(interval_text, form="+.3f"))
    ]
    """Of the damping ratio, at `LEVELS`."""
    same_sign: Annotated[Array, Field(form=probability_text)]  #: Probability of its median's sign.


def verdicts(bank: Bank) -> Result[Verdict]:
    """All laws with all cabs on all plants, last the average weighted by evidence."""
    shares, rows = bank.shares(), list[Verdict]()
    sizes = {plant: effective_size(bank.weights(plant)) for plant in shares}
    laws, cabs = [law.name for law in bank.study.laws], [cab.name for cab in bank.study.cabs]
    for plant, law, cab in product((*shares, AVERAGE), laws, cabs):
        mixture = _shares_of(bank, plant)
        machines = [r for r in bank.verdicts if r["plant"] in mixture and r["cab"] == cab]
        size = sum(share * sizes[name] for name, share in mixture.items())
        rows.append(_verdict(plant, law, cab, machines, mixture, size))
    return Result(rows, fields_of(Verdict))


def _verdict(
    plant: str, law: str, cab: str, machines: list[Row], shares: dict[str, float], size: float
) -> Verdict:
    """Of a law on machines with a cab, of plants in these shares; `size` is their effective one."""
    reference = {
        (row["plant"], row["machine"]): row["pair"] for row in machines if row["law"] == REFERENCE
    }
    rows = [row for row in machines if row["law"] == law]
    is_unstable = np.array([not row["stable"] for row in rows])
    change = np.array([row["pair"] - reference[row["plant"], row["machine"]] for row in rows])
    count, flown = (np.array([row[name] for row in rows], float) for name in ("count", "flown"))
    plants = np.array([row["plant"] for row in rows])

    def probability(event: NDArray[np.bool_], weights: Array) -> Array:
        return probability_interval(float(weights @ event), min(effective_size(weights), size))

    all_weights = _mixed_weights(count, plants, shares)
    flown_weights = _mixed_weights(count * flown, plants, shares)
    quantiles_of_change = weighted_quantiles(change, flown_weights, LEVELS)
    median_sign = np.sign(quantiles_of_change[1])
    return Verdict(
        plant=plant,
        law=law,
        cab=cab,
        unstable=probability(is_unstable, flown_weights),
        without=probability(is_unstable, all_weights),
        change=quantiles_of_change,
        same_sign=probability(np.sign(change) == median_sign, flown_weights),
    )


def _mixed_weights(weights: Array, plants: NDArray[np.str_], shares: dict[str, float]) -> Array:
    """Weights of machines with the plants in these shares; sum 1, or NaN of none."""
    mixed = np.zeros(len(weights))
    for plant, share in shares.items():
        is_of_plant = plants == plant
        if weights[is_of_plant].any():
            mixed += share * weights * is_of_plant / weights[is_of_plant].sum()
    return np.asarray(mixed / (mixed.sum() or np.nan))


def effect_tables(bank: Bank) -> dict[str, Result[Any]]:
    """All tables by the name of their file."""
    return {
        "effects": plant_evidence(bank),
        "left_out": left_out(bank),
        "verdicts": verdicts(bank),
        "made_up": made_up(bank),
    }
