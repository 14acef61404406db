"""`cmf verify`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Cab,
    HydraulicSet,
    app,
    progress_bar,
    refuse,
    show,
    written,
)
from cmf_mj.core.errors import InputError
from cmf_mj.show import verification as verification_report
from cmf_mj.studies.verification import verify


@app.command("verify")
def verify_command(
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "report",
    seconds: Annotated[float, typer.Option(help="simulated time [s]")] = 4.0,
    finest: Annotated[
        int, typer.Option(help="mechanical steps to a control frame at the finest: 4, 8, 16, ...")
    ] = 8,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/verification"),
) -> None:
    """Compare the plant with Exudyn, from a checkout: error and CPU time over step sizes."""
    try:
        if finest < 4 or finest & (finest - 1):
            raise InputError(f"finest: {finest} must be a power of two, at least 4")
        parts = [2**i for i in range(finest.bit_length())]
        with progress_bar() as progress:
            found = verify(cab, hydraulics, seconds=seconds, parts=parts, progress=progress)
        paths = verification_report.save_verification(found, out)
        show(verification_report.verification_table(found), written(paths, out), width=TEXT_WIDTH)
    except (ValueError, OSError, ImportError, FloatingPointError) as error:
        refuse(error)
