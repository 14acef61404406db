"""`cmf capacity`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Cab,
    Dof,
    HydraulicSet,
    Jobs,
    LawName,
    app,
    in_si,
    names_of,
    progress_bar,
    refuse,
    show,
    written,
)
from cmf_mj.core import units
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.show import capacity as capacity_report
from cmf_mj.studies.capacity.envelope import FREQUENCIES, QUICK_FREQUENCIES, performance_envelope
from cmf_mj.studies.capacity.manoeuvre import SIGNALS, manoeuvre
from cmf_mj.studies.capacity.verdict import capacity

_ENVELOPE_WIDTH = 132
"""Width of the envelope's table."""


@app.command("capacity")
def capacity_command(
    signal: Annotated[
        str,
        typer.Option(
            help=f"{', '.join(SIGNALS)}, or a CSV or Parquet file with columns time [s] and "
            "surge, sway, heave [in], roll, pitch, yaw [deg]"
        ),
    ] = "sine",
    dof: Dof = "heave",
    amplitude: Annotated[
        float | None, typer.Option(help="amplitude [in or deg]; default 15 for the sine")
    ] = None,
    frequency: Annotated[
        float | None,
        typer.Option(help="of the sine, highest of chirp, noise and multisine [Hz]"),
    ] = None,
    law: LawName = "velocity",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    least_pressure: Annotated[
        float | None,
        typer.Option(help="least manifold pressure [psi]; default 80 % of the set pressure"),
    ] = None,
    envelope: Annotated[
        bool, typer.Option(help="the largest sustained sine at each frequency, 0.1 to 10 Hz")
    ] = True,
    dofs: Annotated[str, typer.Option(help="of the envelope, or `all`")] = "all",
    jobs: Jobs = None,
    quick: Annotated[
        bool, typer.Option("--quick", help=f"envelope at {len(QUICK_FREQUENCIES)} frequencies")
    ] = False,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/capacity"),
) -> None:
    """Does the supply hold through a manoeuvre, and what is the largest that holds?"""
    try:
        parameters = load_hydraulics(hydraulics)
        least = None if least_pressure is None else least_pressure * units.PSI
        command = manoeuvre(signal, dof, in_si(dof, amplitude), frequency)
        result = capacity(command, law, cab, parameters, least_pressure=least)
        paths = capacity_report.save_capacity(result, parameters, out)
        show(capacity_report.capacity_table(result), width=TEXT_WIDTH)
        if envelope:
            with progress_bar() as update:
                found = performance_envelope(
                    law,
                    cab,
                    parameters,
                    dofs=names_of(dofs, DOFS),
                    frequencies=QUICK_FREQUENCIES if quick else FREQUENCIES,
                    least_pressure=least,
                    jobs=jobs,
                    progress=update,
                )
            paths += capacity_report.save_envelope(found, out)
            show(capacity_report.envelope_table(found), width=_ENVELOPE_WIDTH)
        show(written(paths), width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
