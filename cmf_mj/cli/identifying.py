"""`cmf identify`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Amplitude,
    Cab,
    HydraulicSet,
    PlantName,
    app,
    in_si,
    plant_builder,
    refuse,
    show,
    written,
)
from cmf_mj.core.errors import InputError
from cmf_mj.record.reader import read_recording
from cmf_mj.show import identification as identification_report
from cmf_mj.studies.identification import (
    Method,
    Signal,
    identify,
    identify_matrix,
    simulated_records,
    simulated_step,
)


def parse_orders(text: str | None) -> tuple[int, int, int] | None:
    """Orders of the command line, `na,nb,nk`.

    Raises:
        InputError: not three whole numbers.
    """
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3 or not all(part.isdigit() for part in parts):
        raise InputError(f"orders: {text!r} is refused; allowed: na,nb,nk such as 4,3,1")
    na, nb, nk = (int(part) for part in parts)
    return na, nb, nk


@app.command("identify")
def identify_command(
    files: Annotated[
        list[Path] | None,
        typer.Argument(help="recordings: facility CSV, UFF 58 or Parquet; the last one validates"),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="identify from simulated runs instead")
    ] = False,
    law: Annotated[
        str | None, typer.Option(help="law by name or TOML file; default velocity, or the file's")
    ] = None,
    dof: Annotated[
        str, typer.Option(help="degree of freedom; leg_1 to leg_6 of files; all")
    ] = "heave",
    plant: PlantName = "hexapod",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    amplitude: Amplitude = None,
    signal: Annotated[
        Signal, typer.Option(help="what the simulated machine is excited with")
    ] = "multisine",
    method: Annotated[
        Method, typer.Option(help="least squares, instruments or output error")
    ] = "oe",
    orders: Annotated[
        str | None, typer.Option(help="na,nb,nk; default by validation fit on a grid")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/identify"),
) -> None:
    """Identify a linear model of leg velocity per valve command, or of all dofs (--dof all)."""
    try:
        if simulate == bool(files):
            raise InputError("files: name recordings, or use --simulate, not both and not neither")
        chosen = parse_orders(orders)
        build = plant_builder(plant, cab, hydraulics)
        name = law or "velocity"
        if dof == "all":
            if not simulate:
                raise InputError("dof: all needs --simulate")
            show(identification_report.matrix_table(identify_matrix(build, name)), width=100)
            return
        if simulate:
            records = simulated_records(build, name, dof, signal, in_si(dof, amplitude))
            step = simulated_step(build, name, dof, in_si(dof, amplitude))
            found = identify(records, dof, method=method, orders=chosen, law=name, step=step)
        else:
            records = [read_recording(path) for path in files or []]
            found = identify(records, dof, method=method, orders=chosen, law=law)
        paths = identification_report.save_identification(found, out)
        tables = (
            identification_report.orders_table(found),
            identification_report.model_table(found),
        )
        show(*tables, written(paths), width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError, ModuleNotFoundError) as error:
        refuse(error)
