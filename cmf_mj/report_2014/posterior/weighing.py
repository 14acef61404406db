"""Which effects the report asks for: plants with each of them, weighed by what it prints.

A plant e has the unknowns z of the study and those of its effects. With prior p, likelihood L and
machines i drawn from a mixture q that all plants share, r = p / q, w = r L over its sum,

    Z_e = sum r_i L_e,i / sum r_i              var ln(Z_e / Z_0) = sum (w_e,i - w_0,i)^2

and a plant's share is Z_e / sum Z. Left out, a printed number y of deviation s has under the other
evidence the rank

    u = sum w_i Phi((y - m_i) / s),    w_i of all but y, or of all but its own recording.

Pairs are asked of the machines that count in a plant with one effect, those that weigh 1e-4.
Made-up reports are m + s N(0, 1) of machines drawn with L^a; each is weighed as the report is, its
machine left out.
Verdicts are of machines drawn without the evidence `flown`, with it those of them that can be.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, cast

import control
import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Checked
from scipy import stats
from scipy.special import logsumexp

from cmf_mj import signals
from cmf_mj.analysis.identification import identify
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.units import INCH
from cmf_mj.facility.unknown import Unknown
from cmf_mj.machine.cab import Cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.report_2014.posterior import effects, evidence
from cmf_mj.report_2014.posterior.run import (
    PosteriorSettings,
    PosteriorStudy,
    Task,
    check_bounded,
    force_answer,
    force_at_pressures,
    load_posterior,
    raised,
)
from cmf_mj.signals.composite import ROUNDS, seven_sines
from cmf_mj.studies.case import make_case, run_case
from cmf_mj.studies.engine import Asker, Journal, Progress, Row, Work, Workers
from cmf_mj.studies.fit import sampling

Array = NDArray[np.float64]

NONE, AVERAGE = "none", "average"  #: The plant without effects; the average over plants.
READINGS = ("simulated", "arx")  #: Effects of how results were read: shifts of what is shown.

TEMPER = 0.25  #: a of made-up machines.
_REGRESSED = 0.2  # of the machines count in the regression
_LIGHT = 1e-4  # weight of a machine in a plant from which its pairs are asked
_UNASKED = dict.fromkeys([one.name for one in evidence.observations()], np.nan) | {"flown": False}
_OF = {"rows": "simulated", "fits": "arx"}


class EffectSettings(PosteriorSettings):
    """What the study runs; `kept` machines of each plant fly the laws."""

    effects: Annotated[dict[str, Unknown], Checked(min_length=1)]
    skipped: list[str] = []  #: Of the effects, in a quick study.
    pairs: Annotated[int, Checked(ge=0)]  #: Best effects that are paired.
    made_up: Annotated[int, Checked(ge=0)]  #: Reports made up of each plant.

    @property
    def used(self) -> dict[str, Unknown]:
        """Effects that are not skipped."""
        return {name: one for name, one in self.effects.items() if name not in self.skipped}

    @property
    def reading(self) -> dict[str, str]:
        """Which of `READINGS` an effect is."""
        return {name: _kind(one) for name, one in self.used.items() if _kind(one) in READINGS}


def load_effects(source: Any, **how: Any) -> PosteriorStudy:
    """Load a study of effects, as `load_posterior`."""
    study = load_posterior(source, form=EffectSettings, **how)
    draws, size = study.settings.draws, len(study.settings.unknowns)
    if draws < 2 * (size + 1):
        least = f"at least {2 * (size + 1)}, as numbers are regressed on {size} unknowns"
        raise InputError(f"draws: {draws} is refused; allowed: {least}")
    check_bounded("effects", settings_of(study).effects)
    for name, one in settings_of(study).effects.items():
        if kind := _kind(one):
            check_name(f"effects.{name}: path: effect", kind, (*effects.EFFECTS, *READINGS))
    return study


def settings_of(study: PosteriorStudy) -> EffectSettings:
    """What a study of effects runs."""
    return cast("EffectSettings", study.settings)


def _kind(one: Unknown) -> str:
    """Name of a linear effect, nothing for a path of the machine."""
    return one.path.partition("effect.")[2]


def _parts(plant: str) -> list[str]:
    return [] if plant == NONE else plant.split("+")


def effects_of(task: Task, plant: str) -> dict[str, float]:
    """Effects that change a linear plant, by name in SI."""
    every = settings_of(task.study).effects
    kinds = {name: _kind(every[name]) for name in _parts(plant)}
    return {
        kind: float(every[name].number(1.0, task.values[name]))
        for name, kind in kinds.items()
        if kind in effects.EFFECTS
    }


def machines_of(task: Task, plant: str) -> dict[str, Linear]:
    """The machine by cab with effects that are numbers of it."""
    settings = settings_of(task.study)
    own = {name: settings.effects[name] for name in _parts(plant)}
    own = {name: one for name, one in own.items() if not _kind(one)}
    known = settings.model_copy(update={"unknowns": {**settings.unknowns, **own}})
    return replace(task, study=replace(task.study, settings=known)).machines(task.study.cabs)


def _bank(task: Task) -> list[Row]:
    """What a machine with the effects of each plant shows."""
    every, plain, rows = settings_of(task.study).effects, machines_of(task, NONE), []
    for plant in task.about.split(";"):
        own = any(not _kind(every[name]) for name in _parts(plant))
        machines = machines_of(task, plant) if own else plain
        rows.append({"plant": plant} | effects.shown(machines, effects_of(task, plant)))
    return rows


def _verdicts(task: Task) -> list[Row]:
    """Damping ratios of a machine with the effects of a plant, under all laws with all cabs."""
    present = effects_of(task, task.about)
    return [
        {"cab": cab, "law": law.name, **effects.damping(machine, present, law)}
        for cab, machine in machines_of(task, task.about).items()
        for law in task.laws
    ]


def _readings(task: Task) -> list[Row]:
    """Shifts of what the shipped machine shows, as simulation and as ARX models read it."""
    cab, oil = task.study.cabs[0], task.study.hydraulics
    linear, found = effects.shown({cab.name: Linear(Hexapod(cab, oil))}, {}), Row()
    for law in (*(law for _, law in evidence.ROWS), evidence.HELD_OUT):
        measures = run_case(make_case(law, "heave", "hexapod", cab, oil, quick=True)).measures
        found |= {f"{law}_{name}": getattr(measures, name) for name in evidence.FIELDS}
    read = {"rows": [found], "fits": [evidence.fit_features(one) for one in arx_models(cab, oil)]}
    rows = list[Row]()
    for one in evidence.observations():
        seen = float(np.mean([one.counted(row[one.name]) for row in read[one.group]]))
        shift = seen - float(one.counted(linear[one.name]))
        rows.append({"name": one.name, "reading": _OF[one.group], "shift": shift})
    return rows


def arx_models(cab: Cab, oil: HydraulicParameters) -> list[control.StateSpace]:
    """Linear models 1 to 3 of a machine's leg, made as section 4.3 made those of the hardware."""
    case = make_case("velocity", "heave", "hexapod", cab, oil)
    rounds = (
        seven_sines("heave", case.size, number, cycles=3, settle=1.0)
        for number in range(1, len(ROUNDS) + 1)
    )
    driven = [[signals.pulse("heave", INCH)], [signals.sine("heave", INCH, 1.0)], [*rounds]]
    broad: dict[str, Any] = {"stop": 16.0, "spectrum": "acceleration", "fade": 1.0}
    checked = case.run(signals.multisine("heave", case.size, **broad))
    made = (identify([*map(case.run, each), checked], "leg_1", orders=(4, 3, 1)) for each in driven)
    return [control.ss(one.continuous.velocity.to_si()) for one in made]


_ANSWERS = {"force": force_answer, "readings": _readings, "bank": _bank, "verdict": _verdicts}
_WORK = Work(lambda task, _: _ANSWERS[task.kind](task), raised, lambda task: task.number)


@dataclass(frozen=True)
class Bank:
    """Machines with what plants make of them, (n,) and (n, m) by plant, m numbers as counted."""

    study: PosteriorStudy
    points: Array  #: In the coordinates of the prior, unknowns and then effects, (n, k).
    ratio: Array  #: Ln r.
    three_g: Array  #: Ln of the likelihood of 3 g.
    shown: Mapping[str, Array]
    flown: Mapping[str, NDArray[np.bool_]]
    verdicts: list[Row]  #: Damping ratios of machines by plant, cab and law.

    @property
    def alone(self) -> list[str]:
        """The plant without effects and those with one."""
        return [plant for plant in self.shown if "+" not in plant]

    def log_likelihood(
        self,
        plant: str,
        printed: Array | None = None,
        out: Iterable[int] = (),
        kinds: Iterable[str] = ("three_g", "flown"),
    ) -> Array:
        """Ln L of all machines but for numbers left `out`, default none.

        `printed` (m,) stands in for the report's, `kinds` count beside numbers.
        """
        numbers = evidence.log_likelihoods(self.shown[plant], printed)
        counts = np.ones(numbers.shape[1], dtype=bool)
        counts[[*out, -1]] = False  # the last is held out always
        total = numbers[:, counts].sum(axis=1)
        total = total + self.three_g if "three_g" in kinds else total
        return np.where(self.flown[plant] | ("flown" not in kinds), total, -np.inf)

    def log_evidence(self, plant: str, **how: Any) -> float:
        """Ln Z."""
        total = logsumexp(self.ratio + self.log_likelihood(plant, **how))
        return float(total - logsumexp(self.ratio))

    def weights(self, plant: str, **how: Any) -> Array:
        """Of the posterior, sum 1."""
        return sampling.normalised(self.ratio + self.log_likelihood(plant, **how))

    def effect(self, name: str) -> Array:
        """Values of an effect in the unit of the study, (n,)."""
        used = settings_of(self.study).used
        column = len(self.study.settings.unknowns) + list(used).index(name)
        return used[name].at(sampling.quantiles(self.points[:, column]))

    def guess(self) -> tuple[Array, Array]:
        """Mean and covariance of the unknowns without effects, numbers linear in them.

        Their prior is the Gaussian of machines that can be flown and swing at 3 g; the error of
        the linear numbers is added to s^2.
        """
        size, made = len(self.study.settings.unknowns), self.shown[NONE][:, :-1]
        one, points = np.eye(size), self.points[:, :size]
        printed, s = (each[:-1] for each in evidence.printed_numbers())
        weights = self.ratio + self.log_likelihood(NONE, kinds=())
        weights = sampling.tempered(weights, _REGRESSED * len(self.ratio))
        weights = np.where(np.isfinite(made).all(axis=1), weights, 0.0)
        root = np.sqrt(weights / weights.sum())[:, None]
        inputs = np.hstack([np.ones_like(root), points])
        made = np.where(weights[:, None] > 0.0, made, 0.0)
        slopes = np.linalg.lstsq(root * inputs, root * made, rcond=None)[0]
        error = s**2 + ((root * (made - inputs @ slopes)) ** 2).sum(axis=0)
        middle, slopes = slopes[0], slopes[1:]
        weights = self.ratio + np.where(self.flown[NONE], self.three_g, -np.inf)
        mean, spread = sampling.moments(points, sampling.normalised(weights))
        before = np.linalg.inv(0.8 * spread + 0.2 * one)
        after: Array = np.asarray(np.linalg.inv(before + slopes @ (slopes / error).T))
        return after @ (before @ mean + slopes @ ((printed - middle) / error)), after

    def shares(self) -> dict[str, float]:
        """Of the plants with no effect or one, all as probable before."""
        every = sampling.normalised(np.array([self.log_evidence(one) for one in self.alone]))
        return dict(zip(self.alone, every.tolist(), strict=True))


def run_effects(
    study: PosteriorStudy, folder: str | Path, *, progress: Progress | None = None, **workers: Any
) -> Bank:
    """Run what is left of a study of effects; `workers` as for `Workers`."""
    settings, how = settings_of(study), Workers(**workers)
    count, used = settings.rounds * settings.draws, settings.used
    reading = settings.reading
    plain = [NONE, *(name for name in used if name not in reading)]
    every = 2 * count + settings.kept * (1 + len(used)) + len(evidence.PRESSURES) + bool(reading)
    journal = Journal(Path(folder), study.identity())
    ask = Asker(journal, partial(Task, study=study), _WORK, how, progress, every)
    force = np.array(force_at_pressures(ask))
    shifts = ask("readings", [({},)])[0] if reading else []
    machines, rows = list[Row](), dict[str, list[Row]]()

    def bank(points: Array, ratio: Array, pairs: Iterable[str] = ()) -> Bank:
        supply = np.array([machine["supply_pressure"] for machine in machines])
        three_g = evidence.oscillation_likelihood(supply, force)
        return Bank(study, points, ratio, three_g, *_made(study, rows, machines, shifts, pairs), [])

    def likelihoods(_: int, points: Array) -> Array:
        first = len(machines)
        shares = effect_points(settings, first, len(points))
        for z, share in zip(sampling.quantiles(points), shares, strict=True):
            effect = zip(used.items(), share, strict=True)
            machines.append(study.values(z) | {name: float(one.at(u)) for (name, one), u in effect})
        asked = enumerate(machines[first:], first)
        for answer in ask("bank", [(m, i, ";".join(plain)) for i, m in asked]):
            for row in answer:
                rows.setdefault(row["plant"], []).append(row)
        part = bank(points, np.zeros(len(machines)))
        total = [part.log_likelihood(plant)[first:] for plant in part.shown]
        return np.asarray(logsumexp(total, axis=0))

    how_many = len(settings.unknowns), settings.draws, settings.rounds, settings.seed
    drawn = sampling.importance(likelihoods, *how_many, lambda *at: bank(*at).guess())
    points = np.hstack([drawn.points, stats.norm.ppf(effect_points(settings, 0, count))])
    alone = bank(points, drawn.ratio)
    best = sorted(alone.alone[1:], key=lambda one: -alone.log_evidence(one))[: settings.pairs]
    pairs = ["+".join(two) for two in combinations([n for n in used if n in best], 2)]
    asked = [p for p in pairs if not set(_parts(p)) & reading.keys()]
    largest = np.max([alone.weights(plant) for plant in alone.alone], axis=0)
    heavy = np.flatnonzero((largest > _LIGHT) & bool(asked)).tolist()
    ask.every += len(heavy) - count
    answers = ask("bank", [(machines[i], i, ";".join(asked)) for i in heavy])
    answered = dict(zip(heavy, answers, strict=True))
    for k, pair in enumerate(asked):
        rows[pair] = [answered[i][k] if i in answered else _UNASKED for i in range(count)]
    whole = bank(points, drawn.ratio, pairs)
    return replace(whole, verdicts=_asked_verdicts(whole, ask, machines))


def effect_points(settings: EffectSettings, first: int, count: int) -> Array:
    """Quantiles of the effects of machines, (count, effects), each effect a stream of its own."""
    places = [list(settings.effects).index(name) for name in settings.used]
    streams = (np.random.default_rng([settings.seed, 5, place]) for place in places)
    return np.array([stream.random(first + count)[first:] for stream in streams]).T


def _made(
    study: PosteriorStudy,
    rows: Mapping[str, list[Row]],
    machines: list[Row],
    shifts: list[Row],
    pairs: Iterable[str] = (),
) -> tuple[dict[str, Array], dict[str, NDArray[np.bool_]]]:
    """Numbers as counted of all plants, those that only read otherwise too, and what can fly."""
    reading, stated = settings_of(study).reading, evidence.observations()
    shown, flown = dict[str, Array](), dict[str, NDArray[np.bool_]]()
    for plant in dict.fromkeys((*rows, *reading, *pairs)):
        shifted = [name for name in _parts(plant) if name in reading]
        source = rows["+".join(n for n in _parts(plant) if n not in reading) or NONE]
        made = evidence.counted(source)
        for name in shifted:
            by = {row["name"]: row["shift"] for row in shifts if row["reading"] == reading[name]}
            share = np.array([machine[name] for machine in machines])
            made = made + share[:, None] * np.array([by.get(one.name, 0.0) for one in stated])
        shown[plant], flown[plant] = made, np.array([row["flown"] for row in source])
    return shown, flown


def _asked_verdicts(bank: Bank, ask: Asker, machines: list[Row]) -> list[Row]:
    """Damping ratios of machines drawn from each plant's posterior without `flown`."""
    settings, chosen = settings_of(bank.study), list[tuple[str, int, int]]()
    for plant in bank.alone:
        weights = bank.weights(plant, kinds=("three_g",))
        drawn = sampling.resampled(weights, settings.kept, settings.seed)
        chosen += [
            (plant, int(i), int(n))
            for i, n in zip(*np.unique(drawn, return_counts=True), strict=True)
        ]
    ask.every += len(chosen) - settings.kept * len(bank.alone)
    answers = ask("verdict", [(machines[i], i, plant) for plant, i, _ in chosen])
    return [
        row | {"plant": plant, "machine": i, "count": n, "flown": bool(bank.flown[plant][i])}
        for (plant, i, n), answer in zip(chosen, answers, strict=True)
        for row in answer
    ]
