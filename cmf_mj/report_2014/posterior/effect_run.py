"""Runs a study of effects: machines drawn once, and what they do with the effects of each plant.

Every machine is asked what it shows with each effect alone. Pairs of the best effects are asked of
the machines that count in a plant with one effect: their weight there is above 1e-4. Readings, such
as `arx`, shift what the plain machine shows by what they shift of the shipped one. Verdicts are of
machines drawn without the evidence `flown`; with it they are of those of them that can be flown.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import logsumexp

from cmf_mj import signals
from cmf_mj.analysis.identification import identify
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.core.units import INCH
from cmf_mj.machine.cab import Cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.report_2014.posterior import effects, evidence
from cmf_mj.report_2014.posterior.run import Case, Task, answer_force, ask_oscillation, work_of
from cmf_mj.report_2014.posterior.study import (
    NONE,
    EffectSettings,
    PosteriorStudy,
    effect_kind,
    effect_names,
    effect_settings,
)
from cmf_mj.report_2014.posterior.weighing import Bank
from cmf_mj.signals.composite import ROUNDS, seven_sines
from cmf_mj.studies.case import make_case, run_case
from cmf_mj.studies.engine import Journal, Progress, Row, TaskRunner, Workers
from cmf_mj.studies.fit import sampling

Array = NDArray[np.float64]

_LEAST_WEIGHT = 1e-4  #: Weight in a plant with one effect, above which a machine has its pairs.
_UNKNOWN_ROW: Row = {item.name: np.nan for item in evidence.observations()} | {"flown": False}
_READING_OF_GROUP = {"rows": "simulated", "fits": "arx"}
_SEPARATOR = ";"  #: Between the plants of a task.


def effects_of(task: Task, plant: str) -> dict[str, float]:
    """Effects that change a linear plant, by name in SI."""
    known = effect_settings(task.study).effects
    kinds = {name: effect_kind(known[name]) for name in effect_names(plant)}
    return {
        kind: float(known[name].number(1.0, task.values[name]))
        for name, kind in kinds.items()
        if kind in effects.EFFECTS
    }


def machines_of(task: Task, plant: str) -> dict[str, Linear]:
    """The machine by cab with effects that are numbers of it."""
    settings = effect_settings(task.study)
    present = {name: settings.effects[name] for name in effect_names(plant)}
    numbers = {name: effect for name, effect in present.items() if not effect_kind(effect)}
    settings = settings.model_copy(update={"unknowns": {**settings.unknowns, **numbers}})
    changed = replace(task, study=replace(task.study, settings=settings))
    return changed.machines(task.study.cabs)


def _bank(task: Task) -> list[Row]:
    """What a machine with the effects of each plant shows."""
    known, plain_machines, rows = effect_settings(task.study).effects, machines_of(task, NONE), []
    for plant in task.subject.split(_SEPARATOR):
        has_numbers = any(not effect_kind(known[name]) for name in effect_names(plant))
        machines = machines_of(task, plant) if has_numbers else plain_machines
        rows.append({"plant": plant} | effects.predictions(machines, effects_of(task, plant)))
    return rows


def _verdicts(task: Task) -> list[Row]:
    """Damping ratios of a machine with the effects of a plant, under all laws with all cabs."""
    present = effects_of(task, task.subject)
    return [
        {"cab": cab, "law": law.name, **effects.damping(machine, present, law)}
        for cab, machine in machines_of(task, task.subject).items()
        for law in task.laws
    ]


def _readings(task: Task) -> list[Row]:
    """Shifts of what the shipped machine shows, as simulation and as ARX models read it."""
    cab, hydraulics = task.study.cabs[0], task.study.hydraulics
    linear = effects.predictions({cab.name: Linear(Hexapod(cab, hydraulics))}, {})
    simulated = Row()
    for law in (*evidence.ROW_TABLES, evidence.HELD_OUT_LAW):
        case = make_case(law, "heave", "hexapod", cab, hydraulics, quick=True)
        measures = run_case(case).measures
        simulated |= {f"{law}_{name}": getattr(measures, name) for name in evidence.ROW_FIELDS}
    fits = [evidence.fit_features(model) for model in arx_models(cab, hydraulics)]
    readings = {"rows": [simulated], "fits": fits}
    rows = list[Row]()
    for item in evidence.observations():
        values = [item.transformed(row[item.name]) for row in readings[item.group]]
        shift = float(np.mean(values)) - float(item.transformed(linear[item.name]))
        reading = _READING_OF_GROUP[item.group]
        rows.append({"name": item.name, "reading": reading, "shift": shift})
    return rows


def arx_models(cab: Cab, hydraulics: HydraulicParameters) -> list[control.StateSpace]:
    """Linear models 1 to 3 of a machine's leg, made as section 4.3 made those of the hardware."""
    case = make_case("velocity", "heave", "hexapod", cab, hydraulics)
    rounds = [
        seven_sines("heave", case.size, number, cycles=3, settle=1.0)
        for number in range(1, len(ROUNDS) + 1)
    ]
    experiments = [[signals.pulse("heave", INCH)], [signals.sine("heave", INCH, 1.0)], rounds]
    broad: dict[str, Any] = {"stop": 16.0, "spectrum": "acceleration", "fade": 1.0}
    check = case.run(signals.multisine("heave", case.size, **broad))
    fits = [
        identify([*map(case.run, commands), check], "leg_1", orders=(4, 3, 1))
        for commands in experiments
    ]
    return [control.ss(fit.continuous.velocity.to_si()) for fit in fits]


_WORK = work_of({"force": answer_force, "readings": _readings, "bank": _bank, "verdict": _verdicts})


@dataclass
class _Population:
    """The machines of all rounds so far, which the sampling draws, and what plants make of them."""

    study: PosteriorStudy
    ask: TaskRunner
    oscillation_g: Array  #: Acceleration under force feedback at `PRESSURES` [g].
    shifts: list[Row]  #: By `name` and `reading`.
    machines: list[Row] = field(default_factory=list)
    predictions: dict[str, list[Row]] = field(default_factory=dict)
    """What the machines make of the observations by plant, of plants that were asked."""

    def add_round(self, _: int, points: Array) -> Array:
        """Add machines at points in the prior's coordinates; ln of the sum of L of all plants."""
        first, settings = len(self.machines), effect_settings(self.study)
        of_effects = effect_points(settings, first, len(points))
        for quantiles, effect_quantiles in zip(sampling.quantiles(points), of_effects, strict=True):
            machine = self.study.values(quantiles)
            for name, quantile in zip(settings.used, effect_quantiles, strict=True):
                machine[name] = float(settings.used[name].at(quantile))
            self.machines.append(machine)
        plants = [NONE, *(name for name in settings.used if name not in settings.readings)]
        for answer in self.ask_plants(plants, range(first, len(self.machines))):
            for row in answer:
                self.predictions.setdefault(row["plant"], []).append(row)
        bank = self.bank(points, np.zeros(len(self.machines)))
        by_plant = [bank.log_likelihood(plant)[first:] for plant in bank.predicted]
        return np.asarray(logsumexp(by_plant, axis=0))

    def ask_plants(self, plants: Sequence[str], numbers: Sequence[int]) -> list[list[Row]]:
        """Ask what machines of these numbers show with the effects of plants, a row a plant."""
        subject = _SEPARATOR.join(plants)
        return self.ask("bank", [Case(self.machines[i], i, subject) for i in numbers])

    def bank(self, points: Array, ratio: Array, pairs: Sequence[str] = ()) -> Bank:
        """The machines with the plants that were asked, readings and pairs of both."""
        readings = effect_settings(self.study).readings
        supply_psi = np.array([machine["supply_pressure"] for machine in self.machines])
        three_g = evidence.oscillation_log_likelihood(supply_psi, self.oscillation_g)
        predicted, flown = dict[str, Array](), dict[str, NDArray[np.bool_]]()
        for plant in dict.fromkeys((*self.predictions, *readings, *pairs)):
            names = effect_names(plant)
            rows = self.predictions["+".join(n for n in names if n not in readings) or NONE]
            values = evidence.transformed_predictions(rows)
            for name in names:
                if name in readings:
                    share = np.array([machine[name] for machine in self.machines])
                    values = values + share[:, None] * self._shift(readings[name])
            predicted[plant], flown[plant] = values, np.array([row["flown"] for row in rows])
        return Bank(self.study, points, ratio, three_g, predicted, flown, [])

    def _shift(self, reading: str) -> Array:
        """Shift of every observation by a reading, (m,)."""
        shift = {row["name"]: row["shift"] for row in self.shifts if row["reading"] == reading}
        return np.array([shift.get(item.name, 0.0) for item in evidence.observations()])

    def add_pairs(self, pairs: Sequence[str], singles: Bank) -> None:
        """Ask pairs of effects of the machines that count; those of the others are unknown."""
        machine_count = len(self.machines)
        largest = np.max([singles.weights(plant) for plant in singles.single_plants], axis=0)
        numbers = np.flatnonzero((largest > _LEAST_WEIGHT) & bool(pairs)).tolist()
        self.ask.task_count += len(numbers) - machine_count
        by_pair = [{row["plant"]: row for row in rows} for rows in self.ask_plants(pairs, numbers)]
        answers = dict(zip(numbers, by_pair, strict=True))
        for pair in pairs:
            self.predictions[pair] = [
                answers[number][pair] if number in answers else _UNKNOWN_ROW
                for number in range(machine_count)
            ]


def run_effects(
    study: PosteriorStudy, folder: str | Path, *, progress: Progress | None = None, **workers: Any
) -> Bank:
    """Run what is left of a study of effects; `workers` as for `Workers`."""
    settings, pool = effect_settings(study), Workers(**workers)
    machine_count, readings = settings.rounds * settings.draws, settings.readings
    task_count = 2 * machine_count + settings.kept * (1 + len(settings.used))
    task_count += len(evidence.PRESSURES) + bool(readings)
    journal = Journal(Path(folder), study.identity())
    ask = TaskRunner(journal, partial(Task, study=study), _WORK, pool, progress, task_count)
    oscillation_g = np.array(ask_oscillation(ask))
    shifts = ask("readings", [Case({})])[0] if readings else []
    population = _Population(study, ask, oscillation_g, shifts)
    draws = sampling.importance(
        population.add_round,
        len(settings.unknowns),
        settings.draws,
        settings.rounds,
        settings.seed,
        moments_of=lambda points, ratio: population.bank(points, ratio).moments(),
    )
    points = np.hstack([draws.points, stats.norm.ppf(effect_points(settings, 0, machine_count))])
    singles = population.bank(points, draws.ratio)
    pairs = _best_pairs(settings, singles)
    linear_pairs = [pair for pair in pairs if not readings.keys() & effect_names(pair)]
    population.add_pairs(linear_pairs, singles)
    bank = population.bank(points, draws.ratio, pairs)
    return replace(bank, verdicts=_posterior_verdicts(bank, population))


def _best_pairs(settings: EffectSettings, bank: Bank) -> list[str]:
    """All pairs of the effects with the most evidence."""
    names = [plant for plant in bank.single_plants if plant != NONE]
    best = sorted(names, key=bank.log_evidence, reverse=True)[: settings.pairs]
    return ["+".join(pair) for pair in combinations([n for n in settings.used if n in best], 2)]


def effect_points(settings: EffectSettings, first: int, count: int) -> Array:
    """Quantiles of the effects of machines, (count, effects), each effect a stream of its own."""
    places = [list(settings.effects).index(name) for name in settings.used]
    streams = (np.random.default_rng([settings.seed, 5, place]) for place in places)
    return np.array([stream.random(first + count)[first:] for stream in streams]).T


def _posterior_verdicts(bank: Bank, population: _Population) -> list[Row]:
    """Damping ratios of machines drawn from each plant's posterior without `flown`."""
    settings, ask = bank.study.settings, population.ask
    cases, draw_counts = list[Case](), list[int]()
    for plant in bank.single_plants:
        weights = bank.weights(plant, kinds=("three_g",))
        sample = sampling.resampled(weights, settings.kept, settings.seed)
        numbers, counts = np.unique(sample, return_counts=True)
        cases += [Case(population.machines[i], i, plant) for i in numbers.tolist()]
        draw_counts += counts.tolist()
    ask.task_count += len(cases) - settings.kept * len(bank.single_plants)
    verdicts = list[Row]()
    for case, count, answer in zip(cases, draw_counts, ask("verdict", cases), strict=True):
        plant, number = case.subject, case.draw
        about = {"plant": plant, "machine": number, "count": count}
        verdicts += [row | about | {"flown": bool(bank.flown[plant][number])} for row in answer]
    return verdicts
