"""Laws on machines of the average over plants: `laws.py averaged --study out/effects`.

Machines are drawn from a finished `cmf study effects`: a plant by its share, then one of its
machines by weight. `laws.csv` has all laws on them with the effect of their plant: -90 deg of each
axis, the least damping ratio, the share that is unstable. `certificates.csv` has the scales of the
unit box that are proven about them at neutral, of effects those that are numbers of the machine.
Both give the shipped machine's figure, then median and 90 % of those drawn.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import control
import numpy as np
from joblib import Parallel, delayed

from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law, law_names, load_law
from cmf_mj.core.result import number
from cmf_mj.core.tables import write_csv
from cmf_mj.core.units import FRAME
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.report_2014.posterior import effects
from cmf_mj.report_2014.posterior.answers import (
    LEVELS,
    interval_text,
    probability_interval,
    probability_text,
)
from cmf_mj.report_2014.posterior.effect_run import effects_of, machines_of, run_effects
from cmf_mj.report_2014.posterior.run import Task
from cmf_mj.report_2014.posterior.study import effect_settings, load_effects
from cmf_mj.report_2014.posterior.weighing import Bank
from cmf_mj.studies.certificate import QUICK, certify
from cmf_mj.studies.certificate_box import load_box
from cmf_mj.studies.fit.sampling import effective_size, quantiles

EFFORT = QUICK._replace(samples=30, starts=1, rounds=1, poses=1)  #: Bounds at neutral alone.
LINES = np.geomspace(0.1, 20.0, 400)  #: Responses are read at [Hz].
SPANS = ("shipped", "averaged")


class Drawn(NamedTuple):
    """A machine of the average, by cab, and its effects on a linear plant."""

    machines: dict[str, Linear]
    present: dict[str, float]
    task: Task | None = None  #: Whose law has its own derivative filter.

    def law(self, law: Law) -> Law:
        """The law as this machine has it."""
        return law if self.task is None else self.task.study.law(law, self.task.values)


def drawn(bank: Bank, count: int) -> list[Task]:
    """Machines of the average, with the plant each belongs to."""
    shares, size = bank.shares(), len(bank.study.settings.unknowns)
    used = effect_settings(bank.study).used
    generator = np.random.default_rng(bank.study.settings.seed)
    tasks = []
    for plant in generator.choice(list(shares), count, p=list(shares.values())):
        i = int(generator.choice(len(bank.ratio), p=bank.weights(plant)))
        share = quantiles(bank.points[i])
        values = bank.study.values(share[:size])
        values |= {
            name: float(one.at(u))
            for (name, one), u in zip(used.items(), share[size:], strict=True)
        }
        tasks.append(Task(i, "verdict", values, i, str(plant), study=bank.study))
    return tasks


def made(task: Task) -> Drawn:
    """A machine linearised with each cab."""
    return Drawn(machines_of(task, task.subject), effects_of(task, task.subject), task)


def read(one: Drawn, cab: str, law: Law) -> list[float]:
    """-90 deg [Hz] of each axis, the least damping ratio and whether it is stable."""
    linear, own = one.machines[cab], one.law(law)
    damped = effects.damping(linear, one.present, own)
    loop = closed_loop(bound(own, linear.plant), effects.flown_plant(linear, one.present))
    b, c = loop.B @ linear.jacobian, np.linalg.inv(linear.jacobian) @ loop.C
    pose = control.ss(loop.A, b, c, 0.0, loop.dt)
    response = pose(np.exp(2j * np.pi * LINES * FRAME))
    widths = [line_bandwidths(LINES, response[i, i]).phase_hz for i in range(len(DOFS))]
    widths = widths if damped["stable"] else [np.nan] * len(DOFS)
    return [*widths, damped["least"], float(damped["stable"])]


def proven(one: Drawn, cab: str, law: Law, at: Path) -> float:
    """Scale of the unit box within which all machines about this one are stable."""
    plant = one.machines[cab].plant
    assert isinstance(plant, Hexapod)
    return certify(plant, one.law(law), at, load_box(), EFFORT, friction="none").proven_scale


def spans(shipped: float, values: np.ndarray) -> tuple[str, str]:
    """The shipped machine's, and median and 90 % of the values that there are."""
    there = values[np.isfinite(values)]
    found = np.quantile(there, LEVELS) if there.size else np.full(len(LEVELS), np.nan)
    return number(shipped, ".3g"), interval_text(found, ".3g")


def run(options: argparse.Namespace) -> None:
    """Draw, measure, certify, write."""
    out, study = Path(options.out), load_effects("effects")
    bank = run_effects(study, options.study)
    tasks = drawn(bank, options.machines)
    counted = sum(share * effective_size(bank.weights(p)) for p, share in bank.shares().items())
    workers = Parallel(n_jobs=options.jobs)
    every = list(workers(delayed(made)(task) for task in tasks))
    own = {cab.name: Linear(Hexapod(cab, study.hydraulics)) for cab in study.cabs}
    shipped, rows = Drawn(own, {}), []
    columns = (*DOFS, "least zeta")
    for law in map(load_law, law_names("all")):
        for cab in own:
            base = read(shipped, cab, law)
            found = np.array(list(workers(delayed(read)(one, cab, law) for one in every)))
            rows += [
                (law.name, cab, column, *spans(base[k], found[:, k]))
                for k, column in enumerate(columns)
            ]
            unstable = probability_interval(1.0 - found[:, -1].mean(), min(len(every), counted))
            shares = "no" if base[-1] else "yes", probability_text(unstable)
            rows.append((law.name, cab, "unstable", *shares))
        print(law.name, flush=True)
    write_csv(out / "laws.csv", ("law", "cab", "number", *SPANS), rows)
    boxes = []
    for law in map(load_law, options.laws.split(",")):
        for cab in options.cabs.split(","):
            nominal = proven(shipped, cab, law, out / "shipped")
            some = enumerate(every[: options.certified])
            work = (delayed(proven)(one, cab, law, out / f"{k}") for k, one in some)
            found = np.array(list(workers(work)))
            boxes.append((law.name, cab, len(found), *spans(nominal, found), (found <= 0.0).sum()))
            print(*boxes[-1], flush=True)
    write_csv(out / "certificates.csv", ("law", "cab", "machines", *SPANS, "unstable"), boxes)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options."""
    parser.add_argument("--study", default="out/effects", help="folder of the finished study")
    parser.add_argument("--out", default="out/averaged", help="folder of the tables")
    parser.add_argument("--laws", default="velocity,modal_plan", help="certified")
    parser.add_argument("--cabs", default="gfd,ifd", help="of certificates")
    parser.add_argument("--machines", type=int, default=96, help="drawn")
    parser.add_argument("--certified", type=int, default=24, help="the first of them")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
