"""Export: `cmf export library` and `law`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cmf_mj.cli import options
from cmf_mj.cli.common import app, noise_choice, show, written
from cmf_mj.cli.options import argument

exports = typer.Typer(no_args_is_help=True, help="Leave Python: a C library, or a law alone.")
app.add_typer(exports, name="export", rich_help_panel="Facility")


def _machine(plant: str, cab: str, hydraulics: str) -> Any:
    from cmf_mj.plant.build import make_plant

    return make_plant(plant, cab, hydraulics)


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

    machine = _machine(plant, cab, hydraulics)
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
    from cmf_mj.export.law import export_law

    show(written(export_law(law, out, cab), out))
