"""What plants with effects say: their evidence, numbers left out, reports made up, verdicts."""

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
    chance,
    interval,
    percent,
    predicted,
    probability_text,
)
from cmf_mj.report_2014.posterior.evidence import observations, printed_numbers
from cmf_mj.report_2014.posterior.weighing import AVERAGE, NONE, TEMPER, Bank, settings_of
from cmf_mj.studies.fit.sampling import effective_size, normalised, quantiles, weighted_quantiles

Array = NDArray[np.float64]


class Weighed(NamedTuple):
    """A plant with effects and its evidence."""

    plant: str
    evidence: Annotated[float, Field(title="ln Z over none", form="+.2f")]
    error: Annotated[float, Field(title="+-", form=".2f")]  #: Standard error of the sampling.
    share: Annotated[float, Field(form=percent)]
    """Of the plants with no effect or one."""
    size: Annotated[float, Field(title="effective machines", form=".0f")]
    value: Annotated[Array, Field(title="effect", form=partial(interval, form=".3g"))]
    """Of a single one, in the unit of the study, at `LEVELS`."""
    edge: Annotated[float, Field(title="nearest to a bound", form=".2f")]
    """Least distance of the median of an unknown from a bound, in shares of its range."""
    at: Annotated[str, Field(title="of")]  #: This unknown.


def weighed(bank: Bank) -> Result[Weighed]:
    """All plants, the most evidence first."""
    rows, shares, alone = list[Weighed](), bank.shares(), bank.weights(NONE)
    none, unknowns = bank.log_evidence(NONE), bank.study.settings.unknowns
    for plant in bank.shown:
        weights = bank.weights(plant)
        single = plant in shares and plant != NONE
        values = bank.effect(plant) if single else np.full(weights.size, np.nan)
        ranks = quantiles(bank.points[:, : len(unknowns)]).T
        medians = [float(weighted_quantiles(one, weights, np.array(0.5))) for one in ranks]
        near, name = min((min(u, 1.0 - u), name) for u, name in zip(medians, unknowns, strict=True))
        more, error = bank.log_evidence(plant) - none, ((weights - alone) ** 2).sum()
        size, value = effective_size(weights), weighted_quantiles(values, weights, LEVELS)
        share, deviation = shares.get(plant, np.nan), float(np.sqrt(error))
        rows.append(Weighed(plant, more, deviation, share, size, value, near, name))
    return Result(sorted(rows, key=lambda row: -row.evidence), fields_of(Weighed))


class LeftOut(NamedTuple):
    """A printed number, and what the rest of the evidence predicts of it."""

    plant: str
    number: str
    printed: Annotated[float, Field(form=".3g")]
    predicted: Annotated[Array, Field(form=partial(interval, form=".3g"))]
    """With the deviation of printed numbers, at `LEVELS`."""
    rank: Annotated[float, Field(form=".3f")]  #: u, the number left out.
    recording: Annotated[float, Field(title="recording left out", form=".3f")]
    """U, all numbers of its law or of the fits left out."""


def left_out(bank: Bank) -> Result[LeftOut]:
    """All printed numbers under the plant without effects, the likeliest one, and the average."""
    shares, stated, rows = bank.shares(), observations(), list[LeftOut]()
    best = max(bank.shown, key=bank.log_evidence)
    sources = [one.name.split("_")[0] if one.group == "rows" else one.group for one in stated]
    for plant in dict.fromkeys((NONE, best, AVERAGE)):
        mixed = shares if plant == AVERAGE else {plant: 1.0}
        for k, one in enumerate(stated):
            same = [i for i, source in enumerate(sources) if source == sources[k]]
            y, ranks = float(one.counted(one.value)), list[float]()
            for out in ([k], same):
                weights = {p: share * bank.weights(p, out=out) for p, share in mixed.items()}
                made = np.concatenate([bank.shown[p][:, k] for p in mixed])
                known = np.concatenate(list(weights.values())) * np.isfinite(made)
                made = np.where(known > 0.0, made, 0.0)
                below = stats.norm.cdf((y - made) / one.deviation)
                ranks.append(float(known @ below / known.sum()))
                if out == [k]:
                    span = predicted(made, one.deviation, known)
            span = np.exp(span) if one.relative else span
            rows.append(LeftOut(plant, one.name, one.value, span, *ranks))
    return Result(rows, fields_of(LeftOut))


_THIRD, _MUCH = "of the first three", "as much as the report"


def made_up(bank: Bank) -> Result[dict[str, Any]]:
    """How often reports made up of each plant make it, or another, the likeliest."""
    rows, (_, s) = list[dict[str, Any]](), printed_numbers()
    generator = np.random.default_rng([bank.study.settings.seed, 7])
    most = max(map(bank.log_evidence, bank.alone)) - bank.log_evidence(NONE)
    for plant in bank.alone:
        weights = bank.ratio + TEMPER * bank.log_likelihood(plant)
        weights[~np.isfinite(bank.shown[plant]).all(axis=1)] = -np.inf
        chances, found = normalised(weights), dict.fromkeys(bank.alone, 0)
        ranks, gains, much = list[int](), list[float](), list[bool]()
        for _ in range(settings_of(bank.study).made_up):
            machine = int(generator.choice(chances.size, p=chances))
            report = bank.shown[plant][machine] + s * generator.normal(size=s.size)
            ratio = bank.ratio.copy()
            ratio[machine] = -np.inf  # a machine must not find itself
            other = replace(bank, ratio=ratio)
            every = {p: other.log_evidence(p, printed=report) for p in bank.alone}
            order = sorted(every, key=lambda p: -every[p])
            found[order[0]] += 1
            ranks.append(order.index(plant))
            gains.append(every[plant] - every[NONE])
            much.append(every[order[0]] - every[NONE] >= most)
        places = np.array(ranks)
        row = {"plant": plant, "right": np.mean(places == 0), _THIRD: np.mean(places < 3)}
        row |= {_MUCH: np.mean(much), "gain": np.median(gains)}
        rows.append(row | {f"found {p}": n for p, n in found.items()})
    shown = Field("plant"), *(Field(name, form=percent) for name in ("right", _THIRD, _MUCH))
    gain = Field("gain", "median ln Z over none", "+.2f")
    return Result(rows, (*shown, gain, *(Field(f"found {p}") for p in bank.alone)))


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
        Array, Field(title="pair against " + REFERENCE, form=partial(interval, form="+.3f"))
    ]
    """Of the damping ratio, at `LEVELS`."""
    same_sign: Annotated[Array, Field(form=probability_text)]  #: Probability of its median's sign.


def _mixed(weights: Array, own: dict[str, NDArray[np.bool]], shares: dict[str, float]) -> Array:
    """Weights of machines of several plants, `own` which are of each; sum 1, or NaN of none."""
    known = np.zeros(len(weights))
    for plant, share in shares.items():
        if weights[own[plant]].any():
            known += share * weights * own[plant] / weights[own[plant]].sum()
    return np.asarray(known / (known.sum() or np.nan))


def verdicts(bank: Bank) -> Result[Verdict]:
    """All laws with all cabs on all plants, last the average weighted by evidence."""
    shares, every = bank.shares(), bank.verdicts
    laws, cabs = ([law.name for law in bank.study.laws], [cab.name for cab in bank.study.cabs])
    size = {p: effective_size(bank.weights(p)) for p in shares}
    rows = list[Verdict]()
    for plant, law, cab in product((*shares, AVERAGE), laws, cabs):
        mixed = shares if plant == AVERAGE else {plant: 1.0}
        said = [r for r in every if r["plant"] in mixed and r["cab"] == cab]
        base = {(r["plant"], r["machine"]): r["pair"] for r in said if r["law"] == REFERENCE}
        mine = [r for r in said if r["law"] == law]
        unstable = np.array([not r["stable"] for r in mine])
        moved = np.array([r["pair"] - base[r["plant"], r["machine"]] for r in mine])
        count, flown = (np.array([r[name] for r in mine], float) for name in ("count", "flown"))
        own = {p: np.array([r["plant"] == p for r in mine]) for p in mixed}
        most = sum(share * size[p] for p, share in mixed.items())

        known = _mixed(count, own, mixed)
        any_machine = chance(float(known @ unstable), min(effective_size(known), most))
        known = _mixed(count * flown, own, mixed)  # those on which the law as flown is stable
        machines = min(effective_size(known), most)
        if_flown = chance(float(known @ unstable), machines)
        change = weighted_quantiles(moved, known, LEVELS)
        same = chance(float(known @ (np.sign(moved) == np.sign(change[1]))), machines)
        rows.append(Verdict(plant, law, cab, if_flown, any_machine, change, same))
    return Result(rows, fields_of(Verdict))


def effect_tables(bank: Bank) -> dict[str, Result[Any]]:
    """All tables by the name of their file."""
    tables: dict[str, Result[Any]] = {"effects": weighed(bank), "left_out": left_out(bank)}
    return tables | {"verdicts": verdicts(bank), "made_up": made_up(bank)}
