"""What plants with effects say: their evidence, numbers left out, reports made up, verdicts."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, fields_of
from cmf_mj.report_2014.posterior.answers import (
    LEVELS,
    REFERENCE,
    chance,
    interval,
    percent,
    probability_text,
)
from cmf_mj.report_2014.posterior.evidence import every_number
from cmf_mj.report_2014.posterior.weighing import AVERAGE, DISCREPANCIES, NONE, TEMPER, Bank
from cmf_mj.show.look import save_files
from cmf_mj.studies.fit.sampling import effective_size, normalised, quantiles, weighted_quantiles

Array = NDArray[np.float64]

_ERRORS = 41  # of reading, that a prediction is spread over


def _share(value: float | None) -> str:
    return "-" if value is None else percent(value)


class Weighed(NamedTuple):
    """A plant with effects: its evidence, and what it shows where others miss."""

    plant: str
    evidence: Annotated[float, Field(title="ln Z over none", form="+.2f")]
    error: Annotated[float, Field(title="+-", form=".2f")]  #: Standard error of the sampling.
    numbers: Annotated[float, Field(title="of numbers alone", form="+.2f")]
    """Without 3 g and flown."""
    laplace: Annotated[float, Field(title="of these by Laplace", form="+.2f")]
    not_flown: Annotated[float, Field(title="not as flown", form="+.2f")]  #: Without `flown`.
    wide: Annotated[float, Field(title="10 % wider", form="+.2f")]
    """With a discrepancy of 0.1."""
    share: Annotated[float | None, Field(form=_share)]
    """Of the plants with no effect or one."""
    size: Annotated[float, Field(title="effective machines", form=".0f")]
    value: Annotated[Array, Field(title="effect", form=partial(interval, form=".3g"))]
    """Of a single one, in the unit of the study, at `LEVELS`."""
    edge: Annotated[float, Field(title="nearest to a bound", form=".2f")]
    """Least distance of the median of an unknown from a bound, in shares of its range."""
    at: Annotated[str, Field(title="of")]  #: This unknown.
    velocity_phase: Annotated[Array, Field(title="velocity -90 deg [Hz]", form=interval)]
    original_phase: Annotated[Array, Field(title="original -90 deg [Hz]", form=interval)]
    velocity_damping: Annotated[Array, Field(title="velocity zeta", form=interval)]
    pair: Annotated[Array, Field(title="pair in heave [Hz]", form=partial(interval, form=".1f"))]
    pair_damping: Annotated[Array, Field(title="its damping", form=interval)]


_SEEN = (
    *("velocity_phase_bandwidth_hz", "original_phase_bandwidth_hz", "velocity_damping_ratio"),
    *("pair_hz", "pair_damping"),
)


_UNFLOWN, _WIDE = ("three_g",), 0.1  # evidence without flown; a discrepancy


def weighed(bank: Bank) -> Result[Weighed]:
    """All plants, the most evidence first."""
    rows, shares, alone = list[Weighed](), bank.shares(), bank.weights(NONE)
    none, few = bank.log_evidence(NONE), bank.log_evidence(NONE, kinds=())
    close, unknowns = bank.laplace(NONE), bank.study.settings.unknowns
    unflown = bank.log_evidence(NONE, kinds=_UNFLOWN)
    wide = bank.log_evidence(NONE, more=_WIDE)
    for plant in bank.shown:
        weights = bank.weights(plant)
        single = plant in shares and plant != NONE
        values = bank.effect(plant) if single else np.full(weights.size, np.nan)
        seen = (bank.number(plant, name) for name in _SEEN)
        ranks = quantiles(bank.points[:, : len(unknowns)]).T
        medians = [float(weighted_quantiles(one, weights, np.array(0.5))) for one in ranks]
        near, name = min((min(u, 1.0 - u), name) for u, name in zip(medians, unknowns, strict=True))
        rows.append(
            Weighed(
                plant,
                bank.log_evidence(plant) - none,
                float(np.sqrt(((weights - alone) ** 2).sum())),
                bank.log_evidence(plant, kinds=()) - few,
                bank.laplace(plant) - close,
                bank.log_evidence(plant, kinds=_UNFLOWN) - unflown,
                bank.log_evidence(plant, more=_WIDE) - wide,
                shares.get(plant),
                effective_size(weights),
                weighted_quantiles(values, weights, LEVELS),
                near,
                name,
                *(weighted_quantiles(one, weights, LEVELS) for one in seen),
            )
        )
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

    def inside(self, edge: float = 0.05) -> bool:
        """Whether the rank lies between an edge and 1 less that."""
        return edge <= self.rank <= 1.0 - edge


def left_out(bank: Bank) -> Result[LeftOut]:
    """All printed numbers under the plant without effects, the likeliest one, and the average."""
    shares, stated, rows = bank.shares(), every_number(), list[LeftOut]()
    best = max(bank.shown, key=bank.log_evidence)
    sources = [one.name.split("_")[0] if one.group == "rows" else one.group for one in stated]
    errors = stats.norm.ppf((np.arange(_ERRORS) + 0.5) / _ERRORS)
    for plant in (NONE, best, AVERAGE):
        mixed = shares if plant == AVERAGE else {plant: 1.0}
        for k, one in enumerate(stated):
            same = [i for i, source in enumerate(sources) if source == sources[k]]
            y, ranks = float(one.counted(one.value)), list[float]()
            for out in ([k], same):
                weights = {p: share * bank.weights(p, out=out) for p, share in mixed.items()}
                made = np.concatenate([bank.shown[p][:, k] for p in mixed])
                known = np.concatenate(list(weights.values())) * np.isfinite(made)
                made = np.where(known > 0.0, made, 0.0)
                ranks.append(
                    float(known @ stats.norm.cdf((y - made) / one.deviation) / known.sum())
                )
                if out == [k]:
                    each = (made[:, None] + one.deviation * errors).ravel()
                    span = weighted_quantiles(each, np.repeat(known, _ERRORS), LEVELS)
            span = np.exp(span) if one.relative else span
            rows.append(LeftOut(plant, one.name, one.value, span, *ranks))
    return Result(rows, fields_of(LeftOut))


_THIRD, _MUCH = "of the first three", "as much as the report"


def made_up(bank: Bank) -> Result[dict[str, Any]]:
    """How often reports made up of each plant make it, or another, the likeliest."""
    stated, rows = every_number(), list[dict[str, Any]]()
    s = np.array([one.deviation for one in stated])
    generator = np.random.default_rng([bank.study.settings.seed, 7])
    most = max(map(bank.log_evidence, bank.alone)) - bank.log_evidence(NONE)
    for plant in bank.alone:
        weights = bank.ratio + TEMPER * bank.log_likelihood(plant)
        weights[~np.isfinite(bank.shown[plant]).all(axis=1)] = -np.inf
        chances, found = normalised(weights), dict.fromkeys(bank.alone, 0)
        ranks, gains, much = list[int](), list[float](), list[bool]()
        for _ in range(bank.settings.made_up):
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
        rows.append(
            {"plant": plant, "right": np.mean(np.array(ranks) == 0)}
            | {_THIRD: np.mean(np.array(ranks) < 3), _MUCH: np.mean(much)}
            | {"gain": np.median(gains)}
            | {f"found {p}": n for p, n in found.items()}
        )
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
        spans = []
        for weights in (count, count * flown):
            known = np.zeros(len(mine))
            for p, share in mixed.items():
                if weights[own[p]].any():
                    known += share * weights * own[p] / weights[own[p]].sum()
            most = sum(share * size[p] for p, share in mixed.items())
            total = known.sum() or np.nan
            machines = min(effective_size(known / total), most)
            spans.append(chance(float(known @ unstable) / total, machines))
        change = weighted_quantiles(moved, known, LEVELS)
        same = float(known @ (np.sign(moved) == np.sign(change[1]))) / total
        rows.append(Verdict(plant, law, cab, spans[1], spans[0], change, chance(same, machines)))
    return Result(rows, fields_of(Verdict))


def effect_tables(bank: Bank) -> dict[str, Result[Any]]:
    """All tables by the name of their file."""
    tables: dict[str, Result[Any]] = {"effects": weighed(bank), "left_out": left_out(bank)}
    return tables | {"verdicts": verdicts(bank), "made_up": made_up(bank)}


def effects_text(bank: Bank, tables: Mapping[str, Result[Any]]) -> str:
    """What the weighing says, as a Markdown list."""
    plants, stated, said, reports = tables.values()
    best, alone = plants[0], [one for one in plants if one.share is not None]
    (none,) = (one for one in plants if one.plant == NONE)
    lines = [
        f"Of {len(plants) - 1} plants with one effect or two, `{best.plant}` has the most "
        f"evidence: {np.exp(best.evidence):.1f} times that of none (ln {best.evidence:+.2f} +- "
        f"{best.error:.2f}); of single ones `{alone[0].plant}` with a share of "
        f"{percent(alone[0].share or 0.0)}, none {percent(none.share or 0.0)}. It is sampled by "
        f"{none.size:.0f} effective machines with none."
    ]
    for plant in dict.fromkeys(one.plant for one in stated):
        mine = [one for one in stated if one.plant == plant]
        inside, far = (sum(one.inside(edge) for one in mine) for edge in (0.05, 0.0025))
        lines.append(
            f"`{plant}`: of {len(mine)} printed numbers of the hardware {inside} lie in the 90 % "
            f"interval that the others predict, {len(mine) - far} beyond 99.5 %."
        )
    lines.append(
        f"Nearest to a bound is the median of `{none.at}` with none ({none.edge:.2f} of its "
        f"range), of `{best.at}` with `{best.plant}` ({best.edge:.2f})."
    )
    wider = {d: bank.log_evidence(NONE, more=d) - bank.log_evidence(NONE) for d in DISCREPANCIES}
    lines.append(
        "A discrepancy of every number changes the evidence of none by "
        + " and ".join(f"ln {gain:+.2f} (of {100.0 * d:.0f} %)" for d, gain in wider.items())
        + "."
    )
    if bank.settings.made_up:
        right, three = (float(np.mean([r[name] for r in reports])) for name in ("right", _THIRD))
        (idle,) = (r[_MUCH] for r in reports if r["plant"] == NONE)
        lines.append(
            f"Of {bank.settings.made_up * len(reports)} reports made up with one effect or none "
            f"the right one wins in {percent(right)} and is among the first three in "
            f"{percent(three)}, by chance in {percent(1.0 / len(reports))} and "
            f"{percent(3.0 / len(reports))}. Of those of none {percent(float(idle))} give "
            f"some effect as much evidence as the report gives `{alone[0].plant}`."
        )
    by = {(one.plant, one.law, one.cab): one for one in said}
    signs = {
        law: {one.change[1] > 0.0 for one in said if one.law == law and np.isfinite(one.change[1])}
        for law in dict.fromkeys(one.law for one in said if one.law != REFERENCE)
    }
    turned = ", ".join(f"`{law}`" for law, found in signs.items() if len(found) > 1)
    lines.append(
        "What a law changes in the pair's damping has one sign on all plants with all cabs"
        + (f", but for {turned}." if turned else ".")
    )
    for (plant, law, cab), one in by.items():
        other = by[NONE, law, cab]
        flipped = (one.unstable[1] - 0.5) * (other.unstable[1] - 0.5) < 0.0
        sure = one.unstable[0] > 0.5 or one.unstable[2] < 0.5
        if law != REFERENCE and flipped and sure:
            lines.append(
                f"`{plant}` turns `{law}` with the {cab.upper()}: unstable on "
                f"{probability_text(one.unstable)}, with none on "
                f"{probability_text(other.unstable)}."
            )
    return "".join(f"- {line}\n" for line in lines)


def summary(text: str, tables: Mapping[str, Result[Any]]) -> tuple[Any, ...]:
    """What the command prints: sentences, and the columns of the first table that fit."""
    fields = [one for one in fields_of(Weighed) if one.name in _PRINTED]
    return text, Result(list(tables["effects"]), fields)


_PRINTED = ("plant", "evidence", "error", "share", "size")


def save_effects(tables: Mapping[str, Result[Any]], text: str, folder: Path) -> list[Path]:
    """Write tables and sentences of a study of effects."""
    files = {
        f"{name}.{kind}": result.table.save
        for name, result in tables.items()
        for kind in ("md", "csv")
    }
    return save_files(files | {"text.md": lambda path: write_text(path, text)}, folder, 90)
