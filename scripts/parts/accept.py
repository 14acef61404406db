"""What a law keeps beyond the report's runs: one table, a line a group of runs, its worst.

Hexapod, `hardware` set, noisy electronics, valve gains of seed 1 where nothing else is said.
`--quick` sweeps in 30 s, leaves out all cabs and seeds but the IFD and 1, and takes every third
pose; a whole run takes half an hour of one core. Groups:

    nominal      three cabs, six degrees of freedom, valve gains of seeds 0 (nominal) to 3
    masses       mass and inertia of the cab, or the oil's bulk modulus, off; no law knows
    poses        each axis at 60 % of its limit; eight corners of all at once, legs at 60 %
    amplitude    three times the report's amplitude
    steps        steps of 0.1 to 5 times 1 in or 0.6 deg: overshoot alone, without the verdict,
                 since noise, which does not shrink with the step, would pass for ringing

Saturation is where unit gain ends at that amplitude and pose, `Asymptotes.saturation`.
"""

import argparse
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed

from cmf_mj import load_cab, load_hydraulics, load_law
from cmf_mj.analysis.measures import Measures, measure_records, measures_from
from cmf_mj.analysis.step_response import step_metrics
from cmf_mj.control.law import Law
from cmf_mj.core.result import Table
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.unknowns import with_valve_gains
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import excursion_envelope, pose_to_legs
from cmf_mj.machine.machine import load_machine
from cmf_mj.machine.models import CABS
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.studies.asymptotes import asymptotes
from cmf_mj.studies.case import Case, dof_amplitude, make_case

GROUPS = ("nominal", "masses", "poses", "amplitude", "steps")

SHARE = 0.6
"""Share of the limits that poses reach."""

SIZES = (0.1, 0.3, 1.0, 2.0, 5.0)
"""Steps over the report's."""


class Run(NamedTuple):
    """A case of a group's line."""

    group: str
    line: str
    case: Case


def poses() -> list[tuple[float, ...]]:
    """Each axis at both its limits, and eight corners: surge, heave and pitch by their signs."""
    limits = SHARE * excursion_envelope()
    single = [np.eye(6)[dof] * limits[dof, side] for dof in range(6) for side in (0, 1)]
    travel = SHARE * load_machine().working_stroke
    corners = []
    for surge, heave, pitch in product((0, 1), repeat=3):
        sides = (surge, 1 - surge, heave, pitch, pitch, 1 - heave)
        corner = np.array([limits[dof, side] for dof, side in enumerate(sides)])
        while np.abs(pose_to_legs(corner)).max() > travel:
            corner *= 0.97
        corners.append(corner)
    return [tuple(pose.tolist()) for pose in single + corners]


def heavier(factor: float) -> Cab:
    """The IFD with masses and inertia multiplied; control laws do not know."""
    cab = load_cab("ifd")
    mass, inertia = factor * cab.mass.si, factor * cab.tensor
    return cab.changed(f"ifd, mass {factor:g}", nominal=cab, mass=mass, inertia=inertia)


def runs(law: Law, quick: bool) -> Iterator[Run]:
    """All runs of all groups."""
    electronics, shipped = ElectronicsSettings(), load_hydraulics("hardware")
    usual = with_valve_gains(shipped, 1)

    def case(
        dof: str, cab: str | Cab = "ifd", hydraulics: HydraulicParameters = usual, **more: Any
    ) -> Case:
        more |= {"electronics": electronics, "quick": quick}
        return make_case(law, dof, "hexapod", cab, hydraulics, **more)

    for dof in DOFS:
        for cab, seed in product(CABS[-1:] if quick else CABS, (1,) if quick else range(4)):
            machine = with_valve_gains(shipped, seed or None)
            yield Run("nominal", cab, case(dof, cab, machine))
        for factor in (0.9, 1.1):
            yield Run("masses", f"cab's mass times {factor}", case(dof, heavier(factor)))
        for factor in (0.8, 1.2):
            oil = usual.bulk_modulus.model_copy(update={"value": factor * usual.bulk_modulus.value})
            softer = usual.model_copy(update={"bulk_modulus": oil})
            yield Run("masses", f"bulk modulus times {factor}", case(dof, hydraulics=softer))
        for number, pose in enumerate(poses()):
            if not quick or number % 3 == 0:
                line = f"{DOFS[number // 2]} at 60 %" if number < 12 else "corners"
                yield Run("poses", line, case(dof, pose=pose))
        yield Run("amplitude", f"{dof}, three times", case(dof, amplitude=3 * dof_amplitude(dof)))
        for size in SIZES:
            step = case(dof, amplitude=size * dof_amplitude(dof))
            yield Run("steps", f"{size:g} times the report's", step)


class Found(NamedTuple):
    """What a run shows."""

    measures: Measures
    saturation_hz: float  #: NaN where nothing was swept.

    @property
    def share(self) -> float:
        """-90 deg over saturation."""
        return self.measures.phase_bandwidth_hz / self.saturation_hz


def measured(run: Run) -> tuple[Run, Found]:
    """Chirp and step of a run; the step alone of a group of steps."""
    case = run.case
    if run.group == "steps":
        step = step_metrics(case.run(case.step(), rate=256))._replace(stable=True)
        return run, Found(measures_from(None, step), float("nan"))
    ends = asymptotes(case.build(), case.dof, case.pose).saturation(case.size)
    return run, Found(measure_records(*case.sweep_and_step(), segment=case.segment), ends)


def line_of(group: str, line: str, runs: list[Found]) -> list[str]:
    """The worst of a line's runs; `-` for what no run has."""
    found = [one.measures for one in runs]

    def worst(name: str, best: bool = False) -> float:
        of = runs if name == "share" else found
        values = np.array([getattr(one, name) for one in of])
        values = values[~np.isnan(values)]
        return np.nan if not values.size else float(values.min() if best else values.max())

    numbers = (
        (worst("phase_bandwidth_hz", best=True), "{:.2f}"),
        (worst("share", best=True), "{:.2f}"),
        (worst("gain_bandwidth_hz", best=True), "{:.2f}"),
        (worst("peak_gain_db"), "{:.1f}"),
        (100.0 * worst("overshoot"), "{:.1f}"),
        (worst("damping_ratio", best=True), "{:.2f}"),
    )
    cells = ["-" if np.isnan(value) else form.format(value) for value, form in numbers]
    kept = sum(one.stable for one in found)
    stable = "-" if group == "steps" else f"{kept} of {len(found)}"
    return [group, line, stable, *cells]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--law", default="modal_plan")
    parser.add_argument("--groups", default=",".join(GROUPS))
    parser.add_argument("--quick", action="store_true", help="a part of it, in 30 s chirps")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/accept"))


def run(options: argparse.Namespace) -> None:
    """Run the groups, print each run, and keep `accept.md` true to what has run."""
    chosen = options.groups.split(",")
    todo = [one for one in runs(load_law(options.law), options.quick) if one.group in chosen]
    pool = Parallel(n_jobs=options.jobs, backend="threading", return_as="generator")
    lines: dict[tuple[str, str], list[Found]] = {}
    header = ("group", "runs", "stable", "-90 [Hz]", "over saturation", "-3 dB [Hz]")
    for run, found in pool(delayed(measured)(one) for one in todo):
        lines.setdefault((run.group, run.line), []).append(found)
        one = found.measures
        print(
            f"{run.group}, {run.line}, {run.case.dof}: {'stable' if one.stable else 'unstable'}, "
            f"{one.phase_bandwidth_hz:.2f} of {found.saturation_hz:.2f} Hz, "
            f"{one.peak_gain_db:.2f} dB, {100.0 * one.overshoot:.1f} %",
            flush=True,
        )
        ordered = sorted(lines, key=lambda key: GROUPS.index(key[0]))
        rows = [line_of(*key, lines[key]) for key in ordered]
        table = Table("", (*header, "peak [dB]", "overshoot [%]", "zeta"), rows)
        table.save(options.out / "accept.md")
