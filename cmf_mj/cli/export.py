"""Export: `cmf export library`, `law` and `fmu`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, noise_choice, show, written
from cmf_mj.cli.options import argument

exports = typer.Typer(no_args_is_help=True, help="Leave Python: a C library, an FMU, a law alone.")
app.add_typer(exports, name="export", rich_help_panel="Facility")


@exports.command("library")
def library_command(
    plant: options.PlantName = "hexapod",
    cab: options.Cab = "gfd",
    law: options.Law = "velocity",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = False,
    out: options.Out = Path("out/library"),
) -> None:
    """Write the machine as a C library that needs no Python, with header and example."""
    from cmf_mj.export.library import export_library
    from cmf_mj.plant.hexapod import make_plant

    machine = make_plant(plant, cab, hydraulics)
    files = export_library(machine, law, out, electronics=noise_choice(noise))
    show(written(files, out))


@exports.command("law")
def law_command(
    law: Annotated[
        str, argument("cli.options:shipped_laws", "LAW", "name or TOML file", free=True)
    ],
    cab: options.Cab = "gfd",
    out: options.Out = Path("out/law"),
) -> None:
    """Write a control law alone as a C library, to load into a controller."""
    from cmf_mj.export.library import export_law

    show(written(export_law(law, out, cab), out))


@exports.command("fmu")
def fmu_command(
    plant: options.PlantName = "hexapod",
    cab: options.Cab = "gfd",
    law: options.Law = "velocity",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = False,
    fmi: Annotated[int, Option(help="version of FMI, 2 or 3")] = 2,
    file: Annotated[Path, options.new_file(help="FMU to write")] = Path("out/cmf.fmu"),
) -> None:
    """Write the machine as an FMU for co-simulation."""
    from cmf_mj.export.fmu import export_fmu
    from cmf_mj.plant.hexapod import make_plant

    machine = make_plant(plant, cab, hydraulics)
    path = export_fmu(machine, law, file, fmi=fmi, electronics=noise_choice(noise))
    show(written([path]))
