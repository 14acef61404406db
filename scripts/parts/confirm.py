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
from numpy.typing import NDArray

from cmf_mj import load_hydraulics, load_law
from cmf_mj.analysis.frequency_response import crosstalk as largest_gains
from cmf_mj.analysis.frequency_response import matrix_frequency_response
from cmf_mj.analysis.measures import Measures, measure_records
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Table
from cmf_mj.core.tables import write_csv
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.unknowns import with_valve_gains
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.machine.models import CABS
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.record.record import Record
from cmf_mj.signals.composite import orthogonal_multisines
from cmf_mj.signals.single import Chirp
from cmf_mj.studies.case import REPORT_AMPLITUDES, Case, dof_amplitude, make_case

HEADER = (
    "law,cab,dof,seed,pose,scale,quick,noise,phase_hz,gain_hz,peak_db,damping_ratio,overshoot,"
    "stable,clamped"
)

CROSSTALK_BAND = (0.5, 6.0)
"""Frequencies of the cross-talk [Hz]."""


class Trial(NamedTuple):
    """One case, and how it was drawn and scaled."""

    case: Case
    seed: int | None  #: Of the valve gains; None for the nominal ones.
    scale: float  #: Of the report's amplitudes.


class Outcome(NamedTuple):
    """A trial and its result."""

    trial: Trial
    measures: Measures
    clamped: float  #: Part of the sweep's frames to the -90 deg bandwidth with a command clamped.


def make_machine(seed: int | None) -> HydraulicParameters:
    """The `hardware` set with valve gains that are not nominal."""
    return with_valve_gains(load_hydraulics("hardware"), seed)


def run_trial(trial: Trial) -> Outcome:
    """Run chirp and step of a trial."""
    sweep, step = trial.case.sweep_and_step()
    result = measure_records(sweep, step, segment=trial.case.segment)
    return Outcome(trial, result, clamped_part(sweep, result.phase_bandwidth_hz))


def clamped_part(sweep: Record, highest_hz: float) -> float:
    """Part of the frames of a chirp, up to a frequency or 10 Hz, in which a command is clamped."""
    command = sweep.signal_as(Chirp)
    rate = command.band[1] / command.duration
    until = command.settle + np.nan_to_num(highest_hz, nan=10.0) / rate
    full = np.any(np.abs(sweep["valve_command"]) >= 1.0, axis=1)[sweep.time < until]
    return float(full.mean())


def crosstalk(law: Law, cab: str, seed: int | None = None) -> NDArray[np.float64]:
    """Largest cross-talk in 0.5 to 6 Hz, (6, 6), rows moved by columns; 0 on the diagonal.

    From one run of orthogonal multisines in all degrees of freedom.
    """
    command = orthogonal_multisines(
        (0.5 * REPORT_AMPLITUDES).tolist(),
        stop=10.0,
        period=30.0,
        spectrum="acceleration",
        periods=2,
        seed=1,
    )
    case = make_case(law, cab=cab, hydraulics=make_machine(seed))
    response = matrix_frequency_response(case.run(command))
    frequency = np.asarray(response.omega) / (2.0 * np.pi)
    band = (frequency >= CROSSTALK_BAND[0]) & (frequency <= CROSSTALK_BAND[1])
    gains = largest_gains(np.asarray(response.frdata)[..., band], REPORT_AMPLITUDES)
    return np.nan_to_num(gains)


def row(outcome: Outcome) -> list[object]:
    """One line of `trials.csv`."""
    trial, values, clamped = outcome
    case = trial.case
    numbers = (
        *(values.phase_bandwidth_hz, values.gain_bandwidth_hz, values.peak_gain_db),
        *(values.damping_ratio, values.overshoot),
    )
    pose = " ".join(f"{value:.4g}" for value in case.pose)
    return [
        *(case.law.name, case.cab_name, case.dof, trial.seed, pose, trial.scale, case.quick),
        case.electronics is not None,
        *(f"{value:.4f}" for value in numbers),
        values.stable,
        f"{clamped:.4f}",
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
    results = [member.measures for member in members]
    phase, gain, peak, over = (
        np.array([getattr(result, name) for result in results])
        for name in ("phase_bandwidth_hz", "gain_bandwidth_hz", "peak_gain_db", "overshoot")
    )
    zetas = [result.damping_ratio for result in results if not np.isnan(result.damping_ratio)]
    damping = f"{min(zetas):.2f}" if zetas else "-"
    return Worst(
        "> 10" if np.isnan(phase).all() else f"{np.nanmin(phase):.2f}",
        "> 10" if np.isnan(gain).all() else f"{np.nanmin(gain):.2f}",
        f"{peak.max():.1f}",
        f"{100.0 * over.max():.0f} %",
        damping if all(result.stable for result in results) else "unstable",
    )


def grouped(outcomes: list[Outcome], *fields: str) -> dict[tuple[str, ...], list[Outcome]]:
    """Outcomes of trials alike in the law and some fields."""
    groups: dict[tuple[str, ...], list[Outcome]] = {}
    for one in outcomes:
        case = one.trial.case
        key = (case.law.name, *(getattr(case, field) for field in fields))
        groups.setdefault(key, []).append(one)
    return groups


def worst(outcomes: list[Outcome]) -> str:
    """Worst of each law, degree of freedom and cab over all other choices."""
    header = ("law", "dof", "cab", "-90", "-3 dB", "peak", "overshoot", "zeta")
    groups = grouped(outcomes, "dof", "cab_name")
    rows = [[*key, *worst_of(members)] for key, members in groups.items()]
    return Table("", header, rows).markdown()


def summary(outcomes: list[Outcome]) -> str:
    """Worst of each law in each degree of freedom: -90 deg / -3 dB / peak / zeta."""
    groups = grouped(outcomes, "dof")
    dofs = list(dict.fromkeys(one.trial.case.dof for one in outcomes))
    lines = []
    for law in dict.fromkeys(one.trial.case.law.name for one in outcomes):
        cells = [worst_of(groups[law, dof]) for dof in dofs]
        lines.append([law, *(f"{w.phase} / {w.gain} / {w.peak} / {w.damping}" for w in cells)])
    return Table("", ("law", *dofs), lines).markdown()


def numbers(text: str) -> list[float]:
    """Numbers of a comma-separated option."""
    return [float(part) for part in text.split(",")]


def pose_of(text: str) -> tuple[float, ...]:
    """A pose in in and deg, SI."""
    values = numbers(text)
    return tuple(units.to_si(dof_unit(i), v) for i, v in enumerate(values))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
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


def run(options: argparse.Namespace) -> None:
    """Run the trials."""
    seeds = [int(part) or None for part in options.seeds.split(",")]
    laws = [load_law(name) for name in options.laws.split(",")]
    cabs, electronics = options.cabs.split(","), ElectronicsSettings() if options.noise else None
    trials = [
        Trial(
            make_case(
                *(law, dof, "hexapod", cab, make_machine(seed)),
                amplitude=scale * dof_amplitude(dof),
                quick=options.quick,
                electronics=electronics,
                pose=pose_of(options.pose),
            ),
            seed,
            scale,
        )
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
