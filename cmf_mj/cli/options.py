"""Options that several commands share: one spelling, one unit and one help text each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, update_wrapper
from inspect import Parameter, signature
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, get_args

import typer
from typer import Argument, Option

import cmf_mj
from cmf_mj.cli.common import check_writable, claim, given_by_user
from cmf_mj.core.errors import InputError, check_name


def names_in(source: str) -> list[str]:
    """Names, a literal or what a function returns, at a place such as `machine.models:CABS`."""
    names = resolve_name(f"cmf_mj.{source}")
    return list(get_args(names) or (names() if callable(names) else names))


def shipped_laws() -> tuple[str, ...]:
    """Names of all shipped laws."""
    return cmf_mj.law_names("all")


def choice(
    source: str,
    metavar: str,
    text: str,
    *,
    takes_files: bool = False,
    source_of_all: str = "",
    make: Callable[..., Any] = Option,
) -> Any:
    """An option that takes a name, or several with commas between; `all` stands for every one.

    `source` has the names, `source_of_all` those that `all` stands for. With `takes_files` the
    command checks what is no such name. `make` is `Option` or `Argument`.
    """

    def complete(incomplete: str) -> list[str]:
        names_before, comma, beginning = incomplete.rpartition(",")
        names = [name for name in names_in(source) if name.startswith(beginning)]
        return [names_before + comma + name for name in names]

    def check(ctx: typer.Context, param: typer.CallbackParam, value: Any) -> Any:
        if not value or ctx.resilient_parsing:
            return value
        is_list = not isinstance(value, str)
        names = [name.strip() for text in value for name in text.split(",") if name.strip()]
        names = names if is_list else [value]
        if source == LAWS:
            names = [_law_on_machine(ctx, name) for name in names]
        if not names:
            raise InputError(f"{param.name}: {value!r} names nothing; allowed: one name at least")
        if is_list and names == ["all"]:
            return names_in(source_of_all or source)
        if not takes_files:
            for name in names:
                check_name(param.name or "", name, names_in(source))
        return names if is_list else names[0]

    return make(help=text, metavar=metavar, autocompletion=complete, callback=check)


def _law_on_machine(ctx: typer.Context, name: str) -> str:
    """The name that a law has on the machine of the option `machine`."""
    from cmf_mj.control.law import law_source

    machine = ctx.params.get("machine")
    return name if machine is None else law_source(cmf_mj.load_machine(machine), name)


def of_machine(source: str, metavar: str, text: str, source_of_all: str = "") -> Any:
    """An option whose names and default are those of the machine of the option `machine`.

    The command gets loaded cabs and hydraulic sets, and names of laws. A default stands for the
    machine's own unless that is the CMF.
    """
    option = name_or_file(source, metavar, text, source_of_all=source_of_all, make=_machine_option)
    check = option.callback

    def load(ctx: typer.Context, param: typer.CallbackParam, value: Any) -> Any:
        names = check(ctx, param, value)
        if ctx.resilient_parsing or not names:
            return names
        return _load_of_machine(ctx, param.name or "", names)

    option.callback = load
    return option


def _load_of_machine(ctx: typer.Context, field: str, names: Any) -> Any:
    from cmf_mj.machine.models import CMF
    from cmf_mj.plant.parameters import hydraulics_of

    machine = cmf_mj.load_machine(ctx.params.get("machine", CMF))
    is_own = machine.name != CMF and not given_by_user(ctx, field)
    match field:
        case "hydraulics":
            return hydraulics_of(machine, None if is_own else names)
        case "law":
            return machine.law if is_own else names
        case "laws":
            return [machine.law] if is_own else names
        case "cab":
            return cmf_mj.load_cab(None if is_own else names, machine)
    cabs = machine.cabs if is_own or names == names_in(CABS) else names
    return [cmf_mj.load_cab(name, machine) for name in cabs]


def drawing(command: Callable[[str], Any]) -> Callable[[str], Any]:
    """As `command`, with an option for the format of the figures."""

    def add_options(function: Callable[..., None]) -> Callable[..., None]:
        def draw(figure_format: str | None, **arguments: Any) -> None:
            from cmf_mj.show.look import write_figures_as

            with write_figures_as(figure_format):
                function(**arguments)

        usage = signature(function, eval_str=True)
        figure_format = Parameter(
            "figure_format", Parameter.KEYWORD_ONLY, default=None, annotation=FigureFormat
        )
        update_wrapper(draw, function)
        parameters = [*usage.parameters.values(), figure_format]
        vars(draw)["__signature__"] = usage.replace(parameters=parameters)
        return draw

    return lambda name: lambda function: command(name)(add_options(function))


name_or_file = partial(choice, takes_files=True)
argument = partial(choice, make=Argument)
any_argument = partial(name_or_file, make=Argument)  #: As `argument`, for names and files.
size, file = partial(Option, metavar="SIZE"), partial(Option, metavar="FILE")
"""Options of a number with its unit, and of a file; `help` says of what."""
new_file = partial(file, callback=check_writable)  #: Option of a file to write.
_machine_option = partial(Option, rich_help_panel="Machine")
_first_option = partial(Option, is_eager=True)  #: Read before those whose names depend on it.

DOFS, LAWS = "machine.geometry:DOFS", "cli.options:shipped_laws"
CABS, HYDRAULICS = "machine.models:CABS", "plant.parameters:HYDRAULICS"
MACHINES, SCENARIOS = "machine.models:machine_names", "facility.scenario:scenario_names"
PLANTS, WASHOUTS = "plant.hexapod:PLANTS", "pilot.washout_settings:WASHOUTS"
"""Where names stand, for `names_in`."""
CAMERAS = ("overview", "side", "front")  #: Cameras of the machine.
ALL, VELOCITY, NEUTRAL = ["all"], ["velocity"], "0,0,0,0,0,0"
"""Defaults of options that several commands have."""

_MACHINE = "name or TOML file; other defaults below are its own"
_LAWS = "laws by name or TOML file; `all` of the report"
_HYDRAULICS = "report, hardware, lossy or TOML file"
_WASHOUTS = "simona, reid_nahon, optimal, predictive or TOML file"
_FORMATS = "of figures: png (default), svg or pdf"
_COLUMNS = "TOML file of `cmf recording new`; default the facility's columns"

Dof = Annotated[str, choice(DOFS, "DOF", "surge, sway, heave, roll, pitch or yaw")]
AnyDof = Annotated[str, name_or_file(DOFS, "DOF", "degree of freedom, or leg_1 to leg_6")]
AnyDofs = Annotated[list[str], name_or_file(DOFS, "DOFS", "degrees of freedom or legs, or `all`")]
Dofs = Annotated[list[str], choice(DOFS, "DOFS", "degrees of freedom, or `all`")]
_of_machines = partial(name_or_file, MACHINES, "MACHINE")
Machine = Annotated[str, _of_machines(_MACHINE, make=partial(_machine_option, is_eager=True))]
"""Motion base whose cab, hydraulics and law the others name; read before them."""
OtherMachine = Annotated[str | None, _of_machines("replaces the file's", make=_first_option)]
Law = Annotated[str, of_machine(LAWS, "LAW", "law by name or TOML file")]
OtherLaw = Annotated[str | None, name_or_file(LAWS, "LAW", "default that of the file")]
Laws = Annotated[list[str], of_machine(LAWS, "LAWS", _LAWS, "control.law:law_names")]
Cab = Annotated[str, of_machine(CABS, "CAB", "of the machine, by name or TOML file")]
Cabs = Annotated[list[str], of_machine(CABS, "CABS", "of the machine, TOML files, or `all`")]
OtherCab = Annotated[str | None, name_or_file(CABS, "CAB", "replaces the scenario's")]
PlantName = Annotated[str, choice(PLANTS, "PLANT", "hexapod or single_legs")]
Plants = Annotated[list[str], choice(PLANTS, "PLANTS", "hexapod, single_legs, or `all`")]
Hydraulics = Annotated[str, of_machine(HYDRAULICS, "SET", _HYDRAULICS)]
Washout = Annotated[str, name_or_file(WASHOUTS, "WASHOUT", _WASHOUTS)]
Scenario = Annotated[str, any_argument(SCENARIOS, "[SCENARIO]", "name or TOML file")]
Pose = Annotated[str, Option(metavar="POSE", help="x,y,z [in],roll,pitch,yaw [deg], z down")]
Friction = Annotated[str | None, Option(help="dry friction: none, stuck, or legs' speed [m/s]")]
Jobs = Annotated[
    int | None, Option(min=1, max=1024, help="threads or processes; default one a core")
]
Noise = Annotated[bool, Option("--noise/--ideal", help="sensors and electronics with noise")]
Quick = Annotated[bool, Option("--quick", help="shorter: sweeps of 30 s, not 100 s; fewer draws")]
Seed = Annotated[int, Option(help="of all random numbers", min=0, max=2**32 - 1)]
FigureFormat = Annotated[str | None, choice("show.look:FORMATS", "FORMAT", _FORMATS)]
Out = Annotated[Path, Option(metavar="FOLDER", help="folder for results", callback=claim)]
NamedOut = Annotated[Path | None, Option(metavar="FOLDER", help="folder; default by its name")]
Recordings = Annotated[list[Path], Argument(help="CSV, Parquet, HDF5 or MAT files")]
Columns = Annotated[Path | None, Option(metavar="MAP", help=_COLUMNS)]
Seconds = Annotated[float | None, Option(help="length of a run [s]; default to the end")]
