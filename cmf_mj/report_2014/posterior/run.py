"""A study of the unknown: ranges of numbers nobody published, and what machines within them do.

It is a TOML file with ranges, laws and cabs. A machine is a value of each unknown, drawn between
its bounds, and valves and leaks that differ from leg to leg. `values` are in the units of the file;
factors and shifts change a shipped cab. Rounds of machines get their weights; then, in the folder:

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
from typing import Annotated, Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, within
from cmf_mj.core.files import read_table, write_parquet
from cmf_mj.core.settings import Settings, check_distinct, validated
from cmf_mj.core.units import FRAME
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import Cab, load_cabs
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.machine import load_machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.report_2014.posterior import effects, evidence
from cmf_mj.studies.case import swing_after_step
from cmf_mj.studies.engine import Asker, Journal, Progress, Row, Work, Workers, row_table
from cmf_mj.studies.evaluation import MEASURED
from cmf_mj.studies.fit import sampling
from cmf_mj.studies.settings import study_table

GROUPS = ("rows", "fits", "three_g", "flown")
"""Groups of evidence, see `evidence`."""

TABLES = ("force", "machines", "damping", "measures", "gains", "points", "simulated")
"""What the folder holds, each as Parquet."""

Array = NDArray[np.float64]


class PosteriorSettings(Settings):
    """What the study runs."""

    title: Annotated[str, Field(min_length=1)]
    laws: Annotated[list[str], Field(min_length=1)]  #: Names or TOML files.
    cabs: Annotated[list[str], Field(min_length=1)]  #: Shipped ones or TOML files.
    hydraulics: str = "hardware"  #: What is not unknown comes from this set.
    seed: Annotated[int, Field(ge=0)]
    rounds: Annotated[int, Field(ge=2)]  #: Rounds of drawing, see `sampling`.
    draws: Annotated[int, Field(ge=8)]  #: Machines of each round, a power of 2.
    kept: Annotated[int, Field(ge=1)]  #: Machines drawn from the posterior and measured.
    simulated: Annotated[int, Field(ge=0)]  #: Of these, simulated.
    gains: list[float]  #: Of acceleration that are tried [%/(in/s^2)].
    corners: list[Annotated[float, Field(ge=0.0)]]
    """Corners of the accelerometer's filter that they are tried behind [Hz]; 0 for no filter."""
    unknowns: Annotated[dict[str, Unknown], Field(min_length=1)]
    mismatch: dict[str, Unknown]  #: What scatters from leg to leg, by `draw`.


@dataclass(frozen=True)
class PosteriorStudy:
    """A study with everything it refers to loaded."""

    settings: PosteriorSettings
    laws: tuple[Law, ...]
    cabs: tuple[Cab, ...]
    hydraulics: HydraulicParameters

    def identity(self) -> dict[str, Any]:
        """What the study runs, as JSON values, see `Journal`."""
        return {
            "settings": self.settings.model_dump(mode="json"),
            "laws": [law.model_dump(mode="json") for law in self.laws],
            "cabs": [cab.model_dump(mode="json") for cab in self.cabs],
            "hydraulics": self.hydraulics.model_dump(mode="json", exclude_none=True),
        }

    def values(self, quantiles: NDArray[np.float64]) -> dict[str, float]:
        """Values of the unknowns at a point of the unit cube, (n,)."""
        return Unknowns(self.settings.unknowns).at(quantiles)

    def hydraulics_of(self, values: Mapping[str, float], draw: int | None) -> HydraulicParameters:
        """The hydraulic set of a machine; `draw` numbers its mismatch, None has none."""
        made = Unknowns(self.settings.unknowns).apply(values, self.hydraulics)
        mismatch = Unknowns(self.settings.mismatch)
        scatter = {} if draw is None else mismatch.streams(self.settings.seed, draw)
        return mismatch.apply(scatter, made)

    def plant(self, cab: Cab, values: Mapping[str, float], oil: HydraulicParameters) -> Hexapod:
        """The machine with a cab and its hydraulic set; laws take the cab for the shipped one."""
        return Hexapod(Unknowns(self.settings.unknowns).apply(values, cab), oil)

    def law(self, law: Law, values: Mapping[str, float]) -> Law:
        """A law with the derivative filter of a machine."""
        return Unknowns(self.settings.unknowns).apply(values, law)


def load_posterior(
    source: str | Path | dict[str, Any],
    *,
    laws: Sequence[str | Law] | None = None,
    changes: Mapping[str, Any] | None = None,
    quick: bool = False,
    form: type[PosteriorSettings] = PosteriorSettings,
) -> PosteriorStudy:
    """Load a study of the unknown, its settings of a `form`.

    `source` is the name of a shipped specification, a TOML file or a table; `laws` stand in for its
    laws, `changes` replace its fields; a `quick` study has the fields of its table `quick`.
    """
    table, where = study_table(source)
    fewer = table.pop("quick", {})
    table |= (fewer if quick else {}) | dict(changes or {})
    if laws is not None:
        table["laws"] = [load_law(law).name for law in laws]
    settings = validated(form, table, where)
    with within(where):
        return _checked(settings, laws)


def check_bounded(field: str, unknowns: Mapping[str, Unknown]) -> None:
    """Refuse by name what is not one number between bounds."""
    for name, one in unknowns.items():
        if one.shape() or one.low is None:
            raise InputError(f"{field}.{name}: allowed: one number between bounds, low and high")


def _checked(settings: PosteriorSettings, laws: Sequence[str | Law] | None) -> PosteriorStudy:
    check_bounded("unknowns", settings.unknowns)
    if settings.draws & (settings.draws - 1):
        raise InputError(f"draws: {settings.draws} must be a power of 2, for Sobol's sequence")
    if settings.simulated > settings.kept:
        raise InputError(f"simulated: {settings.simulated} must be at most kept, {settings.kept}")
    chosen = tuple(load_law(law) for law in (settings.laws if laws is None else laws))
    check_distinct("laws", [law.name for law in chosen])
    cabs = load_cabs(settings.cabs, load_machine())
    study = PosteriorStudy(settings, chosen, cabs, load_hydraulics(settings.hydraulics))
    for end in (0.0, 1.0):  # bounds that no machine can have are refused here
        values = study.values(np.full(len(settings.unknowns), end))
        for cab in cabs:
            study.plant(cab, values, study.hydraulics_of(values, None))
    return study


@dataclass(frozen=True)
class Task:
    """One machine and what is asked of it."""

    number: int
    kind: str  #: One of `_ANSWERS`.
    values: Mapping[str, float]  #: Of the unknowns.
    draw: int | None = None  #: Of the mismatch; None for none.
    about: str = ""  #: Of a point: what is moved. Of a simulated machine: its cab.
    study: PosteriorStudy = field(kw_only=True)

    @property
    def laws(self) -> list[Law]:
        """The study's laws with the derivative filter of the machine."""
        return [self.study.law(law, self.values) for law in self.study.laws]

    def machines(self, cabs: Sequence[Cab]) -> dict[str, Linear]:
        """The machine with each cab."""
        oil = self.study.hydraulics_of(self.values, self.draw)
        return {cab.name: Linear(self.study.plant(cab, self.values, oil)) for cab in cabs}


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


def run_posterior(
    study: PosteriorStudy, folder: str | Path, *, progress: Progress | None = None, **workers: Any
) -> Results:
    """Run what is left of a study; `workers` as for `Workers`."""
    settings, how = study.settings, Workers(**workers)
    journal = Journal(Path(folder), study.identity())
    every = settings.rounds * settings.draws + settings.kept + 1 + 2 * len(settings.unknowns)
    every += len(evidence.PRESSURES) + settings.simulated * len(study.cabs)
    ask = Asker(journal, partial(Task, study=study), _WORK, how, progress, every)
    tables: dict[str, list[Row]] = {name: [] for name in TABLES}
    force = force_at_pressures(ask)
    tables["force"] = [
        {"supply_pressure": p, "g": g} for p, g in zip(evidence.PRESSURES, force, strict=True)
    ]
    drawn, tables["damping"], posterior = _weighted(study, ask, np.array(force))
    tables["machines"] = drawn
    kept, counts = np.unique(
        sampling.resampled(posterior, settings.kept, settings.seed), return_counts=True
    )
    ask.every -= settings.kept - len(kept)
    chosen = [(Unknowns(settings.unknowns).of(drawn[i]), int(i)) for i in kept]
    for (_, number), count, rows in zip(chosen, counts, ask("kept", chosen), strict=True):
        for row in rows:
            tables[row.pop("table")].append(row | {"machine": number, "count": int(count)})
    moved = _points(settings.unknowns, drawn, posterior)
    for (_, _, about), rows in zip(moved, ask("point", moved), strict=True):
        tables["points"] += [row | {"about": about} for row in rows]
    order = np.random.default_rng([settings.seed, 4]).permutation(len(chosen))
    some = [chosen[i] for i in order[: settings.simulated]]
    flights = [(*machine, cab.name) for machine in some for cab in study.cabs]
    for (_, number, _), rows in zip(flights, ask("simulated", flights), strict=True):
        tables["simulated"] += [row | {"machine": number} for row in rows]
    paths = (
        write_parquet(row_table(rows), journal.folder / f"{name}.parquet")
        for name, rows in tables.items()
    )
    return Results(study, *map(read_table, paths))


def force_at_pressures(ask: Asker) -> list[float]:
    """Acceleration under force feedback [g] at `PRESSURES`."""
    return [rows[0]["g"] for rows in ask("force", [({"psi": p},) for p in evidence.PRESSURES])]


def _weighted(
    study: PosteriorStudy, ask: Asker, force: Array
) -> tuple[list[Row], list[Row], Array]:
    """Rounds of machines with their weights, damping ratios of all, and the posterior's weights."""
    settings, drawn, damping = study.settings, list[Row](), list[Row]()
    of = np.array([one.group for one in evidence.observations()[:-1]])

    def likelihoods(_: int, points: Array) -> Array:
        first = len(drawn)
        values = [study.values(q) for q in sampling.quantiles(points)]
        for rows in ask("drawn", [(v, first + i) for i, v in enumerate(values)]):
            number = len(drawn)
            drawn.append(rows[0] | {"machine": number})
            damping.extend(row | {"machine": number} for row in rows[1:])
        new = drawn[first:]
        numbers = evidence.log_likelihoods(evidence.counted(new))[:, :-1]  # the last is held out
        psi = np.array([row["supply_pressure"] for row in new])
        likelihood_by_group = {
            **{name: numbers[:, of == name].sum(axis=1) for name in ("rows", "fits")},
            "three_g": evidence.oscillation_likelihood(psi, force),
            "flown": np.where([row["flown"] for row in new], 0.0, -np.inf),
        }
        for name, values_of in likelihood_by_group.items():
            for row, value in zip(new, values_of.tolist(), strict=True):
                row[f"log_{name}"] = value
        return np.sum([likelihood_by_group[group] for group in GROUPS], axis=0)

    size = len(settings.unknowns)
    made = sampling.importance(likelihoods, size, settings.draws, settings.rounds, settings.seed)
    for row, ratio, weight in zip(drawn, made.ratio, made.weights, strict=True):
        row |= {"log_ratio": ratio, "weight": weight}
    return drawn, damping, made.weights


def _points(
    unknowns: Mapping[str, Unknown], drawn: Sequence[Row], weights: Array
) -> list[tuple[dict[str, float], None, str]]:
    """The median machine, and it with one unknown at the ends of its range."""
    median = {}
    for name in unknowns:
        values = np.array([row[name] for row in drawn])
        median[name] = float(sampling.weighted_quantiles(values, weights, np.array(0.5)))
    ends = [
        (median | {name: float(one.at(q))}, None, f"{name} {end}")
        for name, one in unknowns.items()
        for end, q in (("low", 0.05), ("high", 0.95))
    ]
    return [(median, None, "median"), *ends]


def _drawn(task: Task) -> list[Row]:
    """What a machine makes of the evidence, and damping ratios of all laws with all cabs."""
    machines = task.machines(task.study.cabs)
    return [{**task.values, **effects.shown(machines, {})}, *_dampings(machines, task.laws)]


def _dampings(machines: Mapping[str, Linear], laws: Sequence[Law]) -> list[Row]:
    return [
        {"cab": cab, "law": law.name, **machine.damping(law)}
        for cab, machine in machines.items()
        for law in laws
    ]


def _kept(task: Task) -> list[Row]:
    """Measures of all laws with all cabs, and damping ratios under gains of acceleration."""
    machines = task.machines(task.study.cabs)
    rows: list[Row] = []
    for cab, machine in machines.items():
        for law in task.laws:
            about = {"table": "measures", "cab": cab, "law": law.name}
            for dof, one in zip(DOFS, machine.measures(law), strict=True):
                rows.append(about | {"dof": dof} | {name: getattr(one, name) for name in MEASURED})
    settings = task.study.settings
    for corner in settings.corners:
        for gain in settings.gains:
            law = task.study.law(acceleration_law(gain, corner), task.values)
            tried = {"table": "gains", "gain": gain, "corner": corner}
            rows += [tried | row for row in _dampings(machines, [law])]
    return rows


def acceleration_law(gain: float, corner: float) -> Law:
    """Position error rate feedback with a gain of acceleration [%/(in/s^2)] behind a filter.

    The filter has one pole at `corner` [Hz], 0 for none: z = e^(-2 pi corner T).
    """
    law = evidence.shipped("acceleration")
    pole = float(np.exp(-2.0 * np.pi * corner * FRAME)) if corner > 0.0 else 0.0
    gains = law.direct_gain.model_copy(update={"acceleration": gain})
    update = {"accelerometer_pole": pole, "accelerometer_gain": 1.0 - pole, "direct_gain": gains}
    name = f"acceleration {gain:g} behind {corner:g} Hz"
    return law.model_copy(update={"name": name, **update})


def _point(task: Task) -> list[Row]:
    rows = _dampings(task.machines(task.study.cabs[:1]), task.laws)
    return [dict(task.values) | row for row in rows]


def _simulated(task: Task) -> list[Row]:
    study, rows = task.study, list[Row]()
    (cab,) = (cab for cab in study.cabs if cab.name == task.about)
    oil = study.hydraulics_of(task.values, task.draw)
    for law in task.laws:
        swing = swing_after_step(study.plant(cab, task.values, oil), law)
        rows.append({"cab": cab.name, "law": law.name} | swing)
    return rows


def force_answer(task: Task) -> list[Row]:
    """Acceleration under force feedback [g]."""
    return [{"g": evidence.oscillation_g(task.values["psi"])}]


_ANSWERS: dict[str, Callable[[Task], list[Row]]] = {
    "force": force_answer,
    "drawn": _drawn,
    "kept": _kept,
    "point": _point,
    "simulated": _simulated,
}


def raised(error: BaseException) -> list[Row]:
    """A machine that cannot be asked ends the study."""
    raise error


_WORK = Work(lambda task, _: _ANSWERS[task.kind](task), raised, lambda task: task.number)
