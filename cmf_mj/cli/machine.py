"""What there is: `cmf list`; machines: `cmf machine new`, `check`, `show` and `build`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, show, written_text
from cmf_mj.cli.options import any_argument, argument
from cmf_mj.core.errors import InputError

machines = typer.Typer(no_args_is_help=True, help="Motion bases as files: make, check, build.")
app.add_typer(machines, name="machine", rich_help_panel="Show")

Machine = Annotated[str, any_argument(options.MACHINES, "MACHINE", "name or TOML file")]
CabName = Annotated[str | None, Option(metavar="CAB", help="of the machine; default its first")]

LISTS = ("laws", "machines", "hydraulics", "sensors")  #: What `cmf list` shows.
_LIST = "laws or machines; one set of hydraulics or sensors, number by number"


@app.command("list", rich_help_panel="Show", no_args_is_help=True)
def list_command(
    what: Annotated[str, argument("cli.machine:LISTS", "WHAT", _LIST)],
    name: Annotated[str | None, Argument(metavar="[SET]", help="by name or TOML file")] = None,
    machine: options.Machine = "cmf",
) -> None:
    """List laws, machines, or the numbers of a hydraulic or sensor set with their sources."""
    from cmf_mj.core.quantity import quantity_table
    from cmf_mj.core.result import Field, Result, Table
    from cmf_mj.electronics.sensors import load_sensors
    from cmf_mj.machine.models import machine_names
    from cmf_mj.plant.parameters import hydraulics_of

    if name is not None and what not in ("hydraulics", "sensors"):
        raise InputError(f"set: {name!r} is of no use to {what}; allowed: none")
    if what == "laws":
        fields = [*map(Field, ("name", "title", "source"))]
        laws = [cmf_mj.load_law(law_name) for law_name in cmf_mj.law_names("all")]
        show(Result(laws, fields, "control laws"))
    elif what == "machines":
        rows = [
            (base.name, base.title, ", ".join(base.cabs), cmf_mj.load_law(base.law).name)
            for base in map(cmf_mj.load_machine, machine_names())
        ]
        show(Table("machines", ("name", "title", "cabs", "law"), rows))
    elif what == "hydraulics":
        hydraulics = hydraulics_of(cmf_mj.load_machine(machine), name)
        show(quantity_table(f"hydraulics: {hydraulics.name}", hydraulics.quantities()))
    else:
        sensors = load_sensors(name or "noisy")
        title = f"sensors: {sensors.name}, gravity {'on' if sensors.gravity else 'off'}"
        show(quantity_table(title, sensors.quantities()))


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
    lab_text = (directory() / "machines" / "lab.toml").read_text(encoding="utf-8")
    text = lab_text[lab_text.index("name = ") :].replace('name = "lab"', f'name = "{name}"', 1)
    text = text.replace("laws/lab.toml", "original", 1)
    show(f"written: {write_text(target, text)}")


@machines.command("check")
def check_command(machine: Machine) -> None:
    """Tell whether the numbers of a machine fit together; status 1 if they do not."""
    from cmf_mj.studies.machine_check import check_machine, report_parts

    check = check_machine(cmf_mj.load_machine(machine))
    show(*report_parts(check))
    if check.faults:
        raise typer.Exit(1)


@machines.command("build")
def build_command(
    machine: Machine, cab: CabName = None, out: options.Out = Path("out/machine")
) -> None:
    """Write the MJCF of a machine with a cab: the scene and the files that it includes."""
    from cmf_mj.core.files import write_text
    from cmf_mj.plant.model_text import model_texts

    loaded_cab = cmf_mj.load_cab(cab, machine)
    if not loaded_cab.unchanged:
        raise InputError(f"cab: {loaded_cab.name!r} is changed; allowed: one of the machine's own")
    scene, files = model_texts(loaded_cab)
    texts = {"scene.xml": scene} | {name: text.decode() for name, text in files.items()}
    show(written_text([write_text(out / name, text) for name, text in texts.items()], out))
