"""`cmf modes`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj import models, modes_report
from cmf_mj.cli.common import (
    TEXT_WIDTH,
    HydraulicSet,
    app,
    names_of,
    pose_option,
    progress_bar,
    refuse,
    show,
    written,
)
from cmf_mj.kinematics import DOFS
from cmf_mj.modes import modes_at, over_envelope, plane_map, sweep
from cmf_mj.plant import Hexapod


@app.command("modes")
def modes_command(
    cab: Annotated[str, typer.Option(help="gfd, rfd, ifd, several of them, or `all`")] = "all",
    hydraulics: HydraulicSet = "hardware",
    pose: Annotated[
        str, typer.Option(help="surge,sway,heave [in],roll,pitch,yaw [deg], z down")
    ] = "0,0,0,0,0,0",
    samples: Annotated[int, typer.Option(help="poses of the envelope looked at")] = 1000,
    rounds: Annotated[int, typer.Option(help="generations of the search, at most")] = 200,
    seed: Annotated[int, typer.Option(help="of samples and search of the worst pose")] = 0,
    points: Annotated[int, typer.Option(help="excursions along each axis of a map")] = 21,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/modes"),
) -> None:
    """Reflected mass, hydraulic modes at a pose and over the envelope, and the worst pose."""
    try:
        cabs = names_of(cab, tuple(models.CABS))
        plants = [Hexapod(name, hydraulics) for name in cabs]
        here = pose_option(pose)
        found = [modes_at(plant, here) for plant in plants]
        with progress_bar() as progress:
            ranges = [
                over_envelope(plant, samples=samples, rounds=rounds, seed=seed, progress=progress)
                for plant in plants
            ]
        paths = modes_report.save(
            ranges,
            [[sweep(plant, dof, count=points) for dof in DOFS] for plant in plants],
            [[plane_map(p, pair, count=points) for pair in modes_report.PLANES] for p in plants],
            out,
        )
        for modes in found:
            show(modes_report.mass_table(modes), modes_report.mode_table(modes), width=TEXT_WIDTH)
        for one in ranges:
            show(modes_report.mode_table(one.worst), width=TEXT_WIDTH)
        show(modes_report.range_table(ranges), written(paths, out), width=TEXT_WIDTH)
    except (ValueError, OSError) as error:
        refuse(error)
