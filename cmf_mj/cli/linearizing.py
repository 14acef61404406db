"""`cmf linearize`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Cab,
    HydraulicSet,
    LawName,
    PlantName,
    app,
    names_of,
    plant_builder,
    pose_option,
    refuse,
    show,
    written,
)
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show import linearization as linearization_report
from cmf_mj.studies.linearization import linearization_study


@app.command("linearize")
def linearize_command(
    plant: PlantName = "hexapod",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    law: LawName = "velocity",
    pose: Annotated[
        str, typer.Option(help="surge,sway,heave [in],roll,pitch,yaw [deg], z down")
    ] = "0,0,0,0,0,0",
    dof: Annotated[
        str, typer.Option(help="degrees of freedom or legs (leg_1 ...), or `all`")
    ] = "all",
    measure: Annotated[
        bool, typer.Option("--measure", help="run the simulation beside each loop, some 5 s each")
    ] = False,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/linearize"),
) -> None:
    """Linearise a plant: modes, Bode diagrams, poles and zeros, a law around it."""
    try:
        build = plant_builder(plant, cab, hydraulics)
        found = linearization_study(
            build(), law, pose_option(pose), names_of(dof, DOFS), measure=measure
        )
        paths = linearization_report.save_study(found, out)
        tables = (linearization_report.mode_table(found), linearization_report.loop_table(found))
        show(*tables, written(paths, out), width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
