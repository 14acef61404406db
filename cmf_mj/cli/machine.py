"""Machines: `cmf machine list`, `new`, `check`, `show` and `build`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, show
from cmf_mj.cli.options import argument, new_file
from cmf_mj.core.errors import InputError

machines = typer.Typer(no_args_is_help=True, help="Motion bases as files: make, check, draw one.")
app.add_typer(machines, name="machine", rich_help_panel="Show")

Machine = Annotated[str, argument(options.MACHINES, "MACHINE", "name or TOML file", free=True)]
SomeCab = Annotated[str | None, Option(metavar="CAB", help="of the machine; default its first")]


@machines.command("list")
def list_command() -> None:
    """List the shipped machines."""
    from cmf_mj.control.law import load_law
    from cmf_mj.core.result import Table
    from cmf_mj.machine.machine import load_machine
    from cmf_mj.machine.models import machine_names

    rows = [
        (one.name, one.title, ", ".join(one.cab_names), load_law(one.law).name)
        for one in map(load_machine, machine_names())
    ]
    show(Table("machines", ("name", "title", "cabs", "law"), rows))


@machines.command("new")
def new_command(
    name: Annotated[str, Argument(metavar="NAME", help="of the machine")],
    file: Annotated[Path | None, Option(metavar="FILE", help="default NAME.toml")] = None,
) -> None:
    """Write a machine file to fill in from a data sheet; it can be run as it is."""
    from cmf_mj.core.files import check_target, write_text
    from cmf_mj.core.settings import checked_name
    from cmf_mj.machine.models import directory, machine_names

    if checked_name(name, "name") in machine_names():
        raise InputError(f"name: {name!r} is a shipped machine; allowed: another name")
    target = check_target(file or Path(f"{name}.toml"))
    if target.exists():
        raise InputError(f"file: {target} exists and is kept; name another one with --file")
    ours = (directory() / "machines" / "lab.toml").read_text(encoding="utf-8")
    text = ours[ours.index("name = ") :].replace('name = "lab"', f'name = "{name}"', 1)
    text = text.replace("laws/lab.toml", "original", 1)
    show(f"written: {write_text(target, text)}")


@machines.command("check")
def check_command(machine: Machine) -> None:
    """Tell whether the numbers of a machine fit together; status 1 if they do not."""
    from cmf_mj.machine.machine import load_machine
    from cmf_mj.studies.machine_check import check_machine, check_parts

    check = check_machine(load_machine(machine))
    show(*check_parts(check))
    if check.faults:
        raise typer.Exit(1)


@machines.command("show")
def show_command(
    machine: Machine,
    cab: SomeCab = None,
    file: Annotated[Path, new_file(help="PNG file")] = Path("out/machine.png"),
    width: options.Width = 1280,
    height: options.Height = 720,
) -> None:
    """Draw a machine with a cab at neutral."""
    from cmf_mj.machine.machine import load_machine
    from cmf_mj.show.stage import save_picture

    drawn = save_picture(load_machine(machine), cab, file, (width, height))
    show(f"written: {drawn}")


@machines.command("build")
def build_command(
    machine: Machine,
    cab: SomeCab = None,
    out: options.Out = Path("out/machine"),
) -> None:
    """Write the MJCF of a machine with a cab: the scene and the files that it includes."""
    from cmf_mj.cli.common import written
    from cmf_mj.core.files import write_text
    from cmf_mj.machine.cab import load_cab
    from cmf_mj.plant.model_text import model_texts

    chosen = load_cab(cab, machine)
    if not chosen.own:
        raise InputError(f"cab: {chosen.name!r} is changed; allowed: one of the machine's own")
    scene, files = model_texts(chosen)
    texts = {"scene.xml": scene} | {name: text.decode() for name, text in files.items()}
    show(written([write_text(out / name, text) for name, text in texts.items()], out))
