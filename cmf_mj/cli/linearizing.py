"""`cmf linearize`."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from cmf_mj import linearization_report, units
from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Cab,
    HydraulicSet,
    LawName,
    PlantName,
    app,
    names_of,
    plant_builder,
    refuse,
    show,
)
from cmf_mj.kinematics import DOFS


def pose_option(text: str) -> NDArray[np.float64]:
    """A pose of the command line, six numbers in in and deg, in SI.

    Raises:
        ValueError: not six numbers.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ValueError(f"pose: {text!r} must be six numbers with commas between") from error
    if len(values) != len(DOFS):
        raise ValueError(f"pose: {text!r} has {len(values)} numbers; six are needed")
    return np.array([units.to_si("in" if i < 3 else "deg", v) for i, v in enumerate(values)])


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
        found = linearization_report.study(
            build(), law, pose_option(pose), names_of(dof, DOFS), measure=measure
        )
        paths = linearization_report.save_study(found, out)
        tables = (linearization_report.mode_table(found), linearization_report.loop_table(found))
        written = f"written to {out}: {', '.join(path.name for path in paths)}"
        show(*tables, written, width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
