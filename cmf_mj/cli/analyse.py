"""Analyse: `cmf linearize`, `modes`, `measure` and `identify`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, friction_option, pose_option, progress_bar, show, written_text
from cmf_mj.cli.options import choice
from cmf_mj.core.errors import InputError

command = partial(app.command, rich_help_panel="Analyse")
drawing = options.drawing(command)

_ESTIMATOR = "analysis.spectra:Estimator"


@drawing("linearize")
def linearize_command(
    plant: options.PlantName = "hexapod",
    machine: options.Machine = "cmf",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    law: options.Law = "velocity",
    pose: options.Pose = options.NEUTRAL,
    friction: options.Friction = None,
    dofs: options.AnyDofs = options.ALL,
    out: options.Out = Path("out/linearize"),
) -> None:
    """Linearise a plant: modes, Bode diagrams, a law around it."""
    from cmf_mj.plant.hexapod import make_plant
    from cmf_mj.show import linearization as report

    made, stated = make_plant(plant, cab, hydraulics), friction_option(friction)
    linear = cmf_mj.Linear(made, pose_option(pose), friction=stated)
    study = report.linearization_study(linear, law, dofs)
    paths = report.save_study(study, out)
    show(report.pole_table(study), report.loop_table(study), written_text(paths, out))


@drawing("modes")
def modes_command(
    machine: options.Machine = "cmf",
    cabs: options.Cabs = options.ALL,
    hydraulics: options.Hydraulics = "hardware",
    pose: options.Pose = options.NEUTRAL,
    samples: Annotated[int, Option(min=90, help="poses of the envelope")] = 1000,
    rounds: Annotated[int, Option(min=0, help="generations of the search, at most")] = 200,
    seed: options.Seed = 0,
    out: options.Out = Path("out/modes"),
) -> None:
    """Reflected mass, hydraulic modes at a pose and over the envelope, and the worst pose."""
    from cmf_mj.analysis.modes import over_envelope, sweep
    from cmf_mj.machine.geometry import DOFS
    from cmf_mj.show import linearization as report

    plants = [cmf_mj.Hexapod(name, hydraulics) for name in cabs]
    at_pose = [plant.hydraulic_modes(pose_option(pose)) for plant in plants]
    sweeps = [[sweep(plant, dof) for dof in DOFS] for plant in plants]
    with progress_bar() as progress:
        ranges = [
            over_envelope(plant, samples=samples, rounds=rounds, seed=seed, progress=progress)
            for plant in plants
        ]
    paths = report.save_modes(ranges, sweeps, out)
    for modes in at_pose:
        show(report.mode_table(modes))
    for one in ranges:
        show(report.mode_table(one.worst, "worst pose"))
    show(report.range_table(ranges), written_text(paths, out))


@drawing("measure")
def measure_command(
    files: options.Recordings,
    dof: options.Dof = "heave",
    machine: options.Machine = "cmf",
    estimator: Annotated[str, choice(_ESTIMATOR, "ESTIMATOR", "h1 or report")] = "h1",
    columns: options.Columns = None,
    out: options.Out = Path("out/measure"),
) -> None:
    """Measure the response in recordings, the rounds of one session."""
    from cmf_mj.show import measurement as report
    from cmf_mj.studies.measurement import measure_recordings

    measures = measure_recordings(files, dof, estimator, columns, machine)
    paths = report.save_recordings(measures, out)
    show(report.response_table(measures), written_text(paths))


@drawing("identify")
def identify_command(
    files: options.Recordings,
    dof: options.AnyDof = "heave",
    orders: Annotated[str, Option(metavar="NA,NB,NK", help="of poles, zeros, delay")] = "4,3,1",
    columns: options.Columns = None,
    out: options.Out = Path("out/identify"),
) -> None:
    """Identify a linear model of leg velocity per valve command; the last file validates."""
    from cmf_mj.analysis.identification import identify
    from cmf_mj.record.columns import read_mapped
    from cmf_mj.show import fit as report

    parts = [part.strip() for part in orders.split(",")]
    if len(parts) != 3 or not all(part.isdigit() for part in parts):
        raise InputError(f"orders: {orders!r} is refused; allowed: na,nb,nk such as 4,3,1")
    na, nb, nk = map(int, parts)
    model = identify([read_mapped(path, columns) for path in files], dof, (na, nb, nk))
    show(report.model_table(model), written_text(report.save_identification(model, out)))
