"""Runs a study of the unknown: rounds of machines, their weights, and what some of them do.

Rounds of machines get their weights; the posterior is measured and simulated; then, in the folder:

force.parquet      acceleration under force feedback by supply pressure
machines.parquet   every machine drawn: its values, what it makes of the evidence, its weights
damping.parquet    every machine, cab and law: damping ratios of the linear loop
measures.parquet   machines drawn from the posterior: bandwidths, peaks, damping by law and axis
gains.parquet      the same machines under gains of acceleration behind filters
points.parquet     the median machine with one unknown moved
simulated.parquet  machines drawn from the posterior: verdicts of the simulation
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.control.law import Law
from cmf_mj.core.tables import read_table, write_parquet
from cmf_mj.core.units import FRAME
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.posterior import effects, evidence
from cmf_mj.report_2014.posterior.study import PosteriorStudy
from cmf_mj.studies.case import swing_after_step
from cmf_mj.studies.engine import Journal, Progress, Row, TaskRunner, Work, Workers, row_table
from cmf_mj.studies.evaluation import MEASURE_NAMES
from cmf_mj.studies.fit import sampling

GROUPS = ("rows", "fits", "three_g", "flown")
"""Groups of evidence, see `evidence`."""

TABLES = ("force", "machines", "damping", "measures", "gains", "points", "simulated")
"""What the folder holds, each as Parquet."""

_RANGE_ENDS = {"low": 0.05, "high": 0.95}  #: Quantiles that a point moves one unknown to.

Array = NDArray[np.float64]


class Case(NamedTuple):
    """A machine as it is asked about."""

    values: Mapping[str, float]  #: Of the unknowns.
    draw: int | None = None  #: Number of its mismatch; None for none.
    subject: str = ""
    """Of a point the unknown moved, of a simulation the cab, of effects the plants."""


@dataclass(frozen=True)
class Task:
    """One question about one machine; its fields are those of `Case`."""

    number: int
    kind: str  #: Which question, by the name of its function.
    values: Mapping[str, float]
    draw: int | None = None
    subject: str = ""
    study: PosteriorStudy = field(kw_only=True)

    @property
    def laws(self) -> list[Law]:
        """The study's laws with the derivative filter of the machine."""
        return [self.study.law(law, self.values) for law in self.study.laws]

    def machines(self, cabs: Sequence[Cab]) -> dict[str, Linear]:
        """The machine with each cab."""
        hydraulics = self.study.hydraulics_of(self.values, self.draw)
        return {cab.name: Linear(self.study.plant(cab, self.values, hydraulics)) for cab in cabs}


class Results(NamedTuple):
    """Tables of a finished study, read from its folder."""

    study: PosteriorStudy
    force: pa.Table
    machines: pa.Table
    damping: pa.Table
    measures: pa.Table
    gains: pa.Table
    points: pa.Table
    simulated: pa.Table


@dataclass
class _Population:
    """The machines of all rounds so far, which the sampling draws."""

    study: PosteriorStudy
    ask: TaskRunner
    oscillation_g: Array  #: Acceleration under force feedback at `PRESSURES` [g].
    machines: list[Row] = field(default_factory=list)
    damping: list[Row] = field(default_factory=list)  #: Of every machine, cab and law.

    def add_round(self, _: int, points: Array) -> Array:
        """Add machines at points in the prior's coordinates; their ln L."""
        first = len(self.machines)
        values = map(self.study.values, sampling.quantiles(points))
        cases = [Case(machine, number) for number, machine in enumerate(values, first)]
        for case, (evidence_row, *damping) in zip(cases, self.ask("drawn", cases), strict=True):
            self.machines.append(evidence_row | {"machine": case.draw})
            self.damping.extend(row | {"machine": case.draw} for row in damping)
        added = self.machines[first:]
        likelihoods = _group_likelihoods(added, self.oscillation_g)
        for group, values_of_group in likelihoods.items():
            for row, likelihood in zip(added, values_of_group.tolist(), strict=True):
                row[f"log_{group}"] = likelihood
        return np.sum([likelihoods[group] for group in GROUPS], axis=0)


def _group_likelihoods(machines: Sequence[Row], oscillation_g: Array) -> dict[str, Array]:
    """Ln L of machines by group of evidence; `oscillation_g` [g] is that at `PRESSURES`."""
    is_used = evidence.observation_arrays().is_used
    group = np.array([observation.group for observation in evidence.observations()])
    by_observation = evidence.log_likelihoods(evidence.transformed_predictions(machines))
    supply_psi = np.array([machine["supply_pressure"] for machine in machines])
    return {
        "rows": by_observation[:, is_used & (group == "rows")].sum(axis=1),
        "fits": by_observation[:, is_used & (group == "fits")].sum(axis=1),
        "three_g": evidence.oscillation_log_likelihood(supply_psi, oscillation_g),
        "flown": np.where([machine["flown"] for machine in machines], 0.0, -np.inf),
    }


def run_posterior(
    study: PosteriorStudy, folder: str | Path, *, progress: Progress | None = None, **workers: Any
) -> Results:
    """Run what is left of a study; `workers` as for `Workers`."""
    settings, pool = study.settings, Workers(**workers)
    journal = Journal(Path(folder), study.identity())
    task_count = settings.rounds * settings.draws + settings.kept + 1 + 2 * len(settings.unknowns)
    task_count += len(evidence.PRESSURES) + settings.simulated * len(study.cabs)
    ask = TaskRunner(journal, partial(Task, study=study), _WORK, pool, progress, task_count)
    tables: dict[str, list[Row]] = {name: [] for name in TABLES}
    oscillation_g = ask_oscillation(ask)
    tables["force"] = [
        {"supply_pressure": psi, "g": acceleration}
        for psi, acceleration in zip(evidence.PRESSURES, oscillation_g, strict=True)
    ]
    population = _sample_machines(study, ask, np.array(oscillation_g))
    machines = population.machines
    tables |= {"machines": machines, "damping": population.damping}
    weights = np.array([machine["weight"] for machine in machines])
    sample = sampling.resampled(weights, settings.kept, settings.seed)
    numbers, counts = (column.tolist() for column in np.unique(sample, return_counts=True))
    ask.task_count -= settings.kept - len(numbers)
    unknowns = Unknowns(settings.unknowns)
    kept_cases = [Case(unknowns.of(machines[number]), number) for number in numbers]
    for case, count, rows in zip(kept_cases, counts, ask("kept", kept_cases), strict=True):
        for row in rows:
            counted_row = row | {"machine": case.draw, "count": count}
            tables[counted_row.pop("table")].append(counted_row)
    point_cases = _point_cases(study, machines, weights)
    for case, rows in zip(point_cases, ask("point", point_cases), strict=True):
        tables["points"] += [row | {"about": case.subject} for row in rows]
    simulation_cases = _simulation_cases(study, kept_cases)
    for case, rows in zip(simulation_cases, ask("simulated", simulation_cases), strict=True):
        tables["simulated"] += [row | {"machine": case.draw} for row in rows]
    paths = {
        name: write_parquet(row_table(rows), journal.folder / f"{name}.parquet")
        for name, rows in tables.items()
    }
    return Results(study, **{name: read_table(path) for name, path in paths.items()})


def _sample_machines(study: PosteriorStudy, ask: TaskRunner, oscillation_g: Array) -> _Population:
    """Draw machines in rounds and weigh them; `oscillation_g` [g] is that at `PRESSURES`."""
    settings, population = study.settings, _Population(study, ask, oscillation_g)
    draws = sampling.importance(
        population.add_round, len(settings.unknowns), settings.draws, settings.rounds, settings.seed
    )
    for row, ratio, weight in zip(population.machines, draws.ratio, draws.weights, strict=True):
        row |= {"log_ratio": ratio, "weight": weight}
    return population


def _simulation_cases(study: PosteriorStudy, kept: Sequence[Case]) -> list[Case]:
    """Some machines with each cab, to be simulated."""
    order = np.random.default_rng([study.settings.seed, 4]).permutation(len(kept))
    chosen_cases = [kept[index] for index in order[: study.settings.simulated]]
    return [case._replace(subject=cab.name) for case in chosen_cases for cab in study.cabs]


def ask_oscillation(ask: TaskRunner) -> list[float]:
    """Ask the acceleration under force feedback [g] at `PRESSURES`."""
    answers = ask("force", [Case({"psi": psi}) for psi in evidence.PRESSURES])
    return [row["g"] for (row,) in answers]


def _point_cases(study: PosteriorStudy, machines: Sequence[Row], weights: Array) -> list[Case]:
    """The median machine, and it with one unknown at the ends of its range."""
    unknowns, median = study.settings.unknowns, dict[str, float]()
    for name in unknowns:
        values = np.array([machine[name] for machine in machines])
        median[name] = float(sampling.weighted_quantiles(values, weights, np.array(0.5)))
    ends = [
        Case(median | {name: float(unknown.at(quantile))}, subject=f"{name} {end}")
        for name, unknown in unknowns.items()
        for end, quantile in _RANGE_ENDS.items()
    ]
    return [Case(median, subject="median"), *ends]


def _answer_drawn(task: Task) -> list[Row]:
    """What a machine makes of the evidence, and damping ratios of all laws with all cabs."""
    machines = task.machines(task.study.cabs)
    return [{**task.values, **effects.predictions(machines, {})}, *_dampings(machines, task.laws)]


def _dampings(machines: Mapping[str, Linear], laws: Sequence[Law]) -> list[Row]:
    return [
        {"cab": cab, "law": law.name, **machine.damping(law)}
        for cab, machine in machines.items()
        for law in laws
    ]


def _answer_kept(task: Task) -> list[Row]:
    """Measures of all laws with all cabs, and damping ratios under gains of acceleration."""
    machines = task.machines(task.study.cabs)
    rows: list[Row] = []
    for cab, machine in machines.items():
        for law in task.laws:
            for dof, measures in zip(DOFS, machine.measures(law), strict=True):
                loop = {"table": "measures", "cab": cab, "law": law.name, "dof": dof}
                rows.append(loop | {name: getattr(measures, name) for name in MEASURE_NAMES})
    settings = task.study.settings
    for corner in settings.corners:
        for gain in settings.gains:
            law = task.study.law(acceleration_law(gain, corner), task.values)
            candidate = {"table": "gains", "gain": gain, "corner": corner}
            rows += [candidate | row for row in _dampings(machines, [law])]
    return rows


def acceleration_law(gain: float, corner: float) -> Law:
    """Position error rate feedback with a gain of acceleration [%/(in/s^2)] behind a filter.

    The filter has one pole at `corner` [Hz], 0 for none: z = e^(-2 pi corner T).
    """
    law = effects.shipped_law("acceleration")
    pole = float(np.exp(-2.0 * np.pi * corner * FRAME)) if corner > 0.0 else 0.0
    gains = law.direct_gain.model_copy(update={"acceleration": gain})
    update = {"accelerometer_pole": pole, "accelerometer_gain": 1.0 - pole, "direct_gain": gains}
    name = f"acceleration {gain:g} behind {corner:g} Hz"
    return law.model_copy(update={"name": name, **update})


def _answer_point(task: Task) -> list[Row]:
    rows = _dampings(task.machines(task.study.cabs[:1]), task.laws)
    return [dict(task.values) | row for row in rows]


def _answer_simulated(task: Task) -> list[Row]:
    """Whether the machine with a cab swings after a step of each law."""
    study, rows = task.study, list[Row]()
    (cab,) = (cab for cab in study.cabs if cab.name == task.subject)
    hydraulics = study.hydraulics_of(task.values, task.draw)
    for law in task.laws:
        swing = swing_after_step(study.plant(cab, task.values, hydraulics), law)
        rows.append({"cab": cab.name, "law": law.name} | swing)
    return rows


def answer_force(task: Task) -> list[Row]:
    """Acceleration under force feedback [g]."""
    return [{"g": evidence.oscillation_g(task.values["psi"])}]


def work_of(answers: Mapping[str, Callable[[Task], list[Row]]]) -> Work:
    """The work of a study, by the kind of its tasks; a machine without an answer ends the study."""

    def end_study(error: BaseException) -> list[Row]:
        raise error

    return Work(lambda task, _: answers[task.kind](task), end_study, lambda task: task.number)


_WORK = work_of(
    {
        "force": answer_force,
        "drawn": _answer_drawn,
        "kept": _answer_kept,
        "point": _answer_point,
        "simulated": _answer_simulated,
    }
)
