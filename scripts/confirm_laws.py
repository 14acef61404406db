"""Run laws through the simulation over cabs, degrees of freedom and valve gains; write a table.

`trials.csv` has a row for each run pair of chirp and step, `worst.md` the worst over valve gains,
`summary.md` the worst over cabs too, `crosstalk.csv` the largest cross-talk of each law and cab.
"""

import argparse
import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed

from cmf_mj import load_law
from cmf_mj.core import units
from cmf_mj.core.files import write_csv, write_text
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.table import Table
from cmf_mj.studies.tuning.confirmation import Outcome, Trial, crosstalk, run_trial
from cmf_mj.studies.tuning.nominal import CABS

HEADER = (
    "law,cab,dof,seed,pose,scale,quick,noise,phase_hz,gain_hz,peak_db,damping_ratio,overshoot,"
    "stable,clamped"
)


def row(outcome: Outcome) -> list[object]:
    """One line of `trials.csv`."""
    trial, widths, step = outcome.trial, outcome.bandwidths, outcome.step
    numbers = (*widths, step.damping_ratio, step.overshoot)
    pose = " ".join(f"{value:.4g}" for value in trial.pose)
    told = (trial.seed, pose, trial.scale, trial.quick, trial.electronics is not None)
    measures = [f"{value:.4f}" for value in numbers]
    return [
        trial.law.name,
        trial.cab,
        trial.dof,
        *told,
        *measures,
        step.stable,
        f"{outcome.clamped:.4f}",
    ]


class Worst(NamedTuple):
    """Worst of a group of trials, as printed."""

    phase: str
    gain: str
    peak: str
    overshoot: str
    damping: str


def worst_of(members: list[Outcome]) -> Worst:
    """Worst of each measure."""
    phase, gain, peak = np.array([member.bandwidths for member in members]).T
    over = max(member.step.overshoot for member in members)
    zetas = [z for member in members if not np.isnan(z := member.step.damping_ratio)]
    damping = f"{min(zetas):.2f}" if zetas else "-"
    return Worst(
        "> 10" if np.isnan(phase).all() else f"{np.nanmin(phase):.2f}",
        "> 10" if np.isnan(gain).all() else f"{np.nanmin(gain):.2f}",
        f"{peak.max():.1f}",
        f"{100.0 * over:.0f} %",
        damping if all(member.step.stable for member in members) else "unstable",
    )


def grouped(outcomes: list[Outcome], *fields: str) -> dict[tuple[str, ...], list[Outcome]]:
    """Outcomes of trials alike in the law and some fields."""
    groups: dict[tuple[str, ...], list[Outcome]] = {}
    for one in outcomes:
        key = (one.trial.law.name, *(getattr(one.trial, field) for field in fields))
        groups.setdefault(key, []).append(one)
    return groups


def worst(outcomes: list[Outcome]) -> str:
    """Worst of each law, degree of freedom and cab over all other choices."""
    header = ("law", "dof", "cab", "-90", "-3 dB", "peak", "overshoot", "zeta")
    groups = grouped(outcomes, "dof", "cab")
    rows = [[*key, *worst_of(members)] for key, members in groups.items()]
    return Table("", header, rows).markdown()


def summary(outcomes: list[Outcome]) -> str:
    """Worst of each law in each degree of freedom: -90 deg / -3 dB / peak / zeta."""
    groups = grouped(outcomes, "dof")
    dofs = list(dict.fromkeys(one.trial.dof for one in outcomes))
    lines = []
    for law in dict.fromkeys(one.trial.law.name for one in outcomes):
        found = [worst_of(groups[law, dof]) for dof in dofs]
        lines.append([law, *(f"{w.phase} / {w.gain} / {w.peak} / {w.damping}" for w in found)])
    return Table("", ("law", *dofs), lines).markdown()


def numbers(text: str) -> list[float]:
    """Numbers of a comma-separated option."""
    return [float(part) for part in text.split(",")]


def pose_of(text: str) -> tuple[float, ...]:
    """A pose in in and deg, SI."""
    values = numbers(text)
    return tuple(units.to_si(dof_unit(i), v) for i, v in enumerate(values))


def main() -> None:
    """Run the trials."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--laws", default="modal_plan")
    parser.add_argument("--cabs", default=",".join(CABS))
    parser.add_argument("--dofs", default=",".join(DOFS))
    parser.add_argument("--seeds", default="1,2", help="of valve gains; 0 for the nominal ones")
    parser.add_argument("--pose", default="0,0,0,0,0,0", help="in and deg, z down")
    parser.add_argument("--scales", default="1", help="amplitudes over the report's")
    parser.add_argument("--quick", action="store_true", help="sweep in 30 s")
    parser.add_argument("--noise", action="store_true", help="sensors and electronics with noise")
    parser.add_argument("--crosstalk", action="store_true", help="measure cross-talk, first seed")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/confirm"))
    options = parser.parse_args()
    seeds = [int(part) or None for part in options.seeds.split(",")]
    laws = [load_law(name) for name in options.laws.split(",")]
    cabs, electronics = options.cabs.split(","), ElectronicsSettings() if options.noise else None
    trials = [
        Trial(law, cab, dof, seed, pose_of(options.pose), scale, options.quick, electronics)
        for law in laws
        for dof in filter(None, options.dofs.split(","))
        for cab in cabs
        for seed in seeds
        for scale in numbers(options.scales)
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    pool = Parallel(n_jobs=options.jobs, backend="threading", return_as="generator")
    outcomes = []
    with (options.out / "trials.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER.split(","))
        for outcome in pool(delayed(run_trial)(trial) for trial in trials):
            writer.writerow(row(outcome))
            file.flush()
            outcomes.append(outcome)
    if outcomes:
        write_text(options.out / "worst.md", worst(outcomes))
        write_text(options.out / "summary.md", summary(outcomes))
    if options.crosstalk:
        cases = [(law, cab) for law in laws for cab in cabs]
        measured = Parallel(n_jobs=options.jobs, backend="threading")(
            delayed(crosstalk)(law, cab, seeds[0]) for law, cab in cases
        )
        rows = [
            [law.name, cab, moved, *(f"{share:.4f}" for share in line)]
            for (law, cab), shares in zip(cases, measured, strict=True)
            for moved, line in zip(DOFS, shares, strict=True)
        ]
        write_csv(
            options.out / "crosstalk.csv",
            ["law", "cab", "moved", *(f"by_{dof}" for dof in DOFS)],
            rows,
        )
    print(f"{len(outcomes)} trials; written to {options.out}")


if __name__ == "__main__":
    main()
