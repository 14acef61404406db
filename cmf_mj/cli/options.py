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
    free: bool = False,
    every: str = "",
    make: Callable[..., Any] = Option,
) -> Any:
    """An option that takes a name, or several with commas between; `all` stands for every one.

    `source` has the names, `every` those that `all` stands for. A `free` option takes files and
    other names too, which the command then checks.
    """

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        return [before + comma + name for name in names_in(source) if name.startswith(last)]

    def checked(ctx: typer.Context, param: typer.CallbackParam, value: Any) -> Any:
        if not value or ctx.resilient_parsing:
            return value
        several = not isinstance(value, str)
        names = [part.strip() for text in value for part in text.split(",") if part.strip()]
        names = names if several else [value]
        if source == LAWS:
            names = [_law(ctx, name) for name in names]
        if not names:
            raise InputError(f"{param.name}: {value!r} names nothing; allowed: one name at least")
        if several and names == ["all"]:
            return names_in(every or source)
        for name in [] if free else names:
            check_name(param.name or "", name, names_in(source))
        return names if several else names[0]

    return make(help=text, metavar=metavar, autocompletion=complete, callback=checked)


def _law(ctx: typer.Context, name: str) -> str:
    """A law, where that of the machine of the option `machine` has a name of its own."""
    from cmf_mj.control.law import law_on

    machine = ctx.params.get("machine")
    return name if machine is None else law_on(cmf_mj.load_machine(machine), name)


def of_machine(source: str, metavar: str, text: str, every: str = "") -> Any:
    """An option whose names and default are those of the machine of the option `machine`.

    The command gets what is loaded: a cab, several, or a hydraulic set; of laws the name. A default
    stands for the machine's own unless that is the CMF.
    """
    plain = choice(source, metavar, text, free=True, make=_of_machine, every=every)
    named = plain.callback

    def loaded(ctx: typer.Context, param: typer.CallbackParam, value: Any) -> Any:
        names = named(ctx, param, value)
        if ctx.resilient_parsing or not names:
            return names
        return _on_machine(ctx, param.name or "", names)

    plain.callback = loaded
    return plain


def _on_machine(ctx: typer.Context, field: str, names: Any) -> Any:
    from cmf_mj.machine.models import CMF
    from cmf_mj.plant.parameters import hydraulics_of

    machine = cmf_mj.load_machine(ctx.params.get("machine", CMF))
    own = machine.name != CMF and not given_by_user(ctx, field)
    if field == "hydraulics":
        return hydraulics_of(machine, None if own else names)
    if field in ("law", "laws"):
        return (machine.law if field == "law" else [machine.law]) if own else names
    if field == "cab":
        return cmf_mj.load_cab(None if own else names, machine)
    everything = own or names == names_in(CABS)
    return [cmf_mj.load_cab(name, machine) for name in (machine.cabs if everything else names)]


def drawing(command: Callable[[str], Any]) -> Callable[[str], Any]:
    """As `command`, for commands that draw: they take format and size of their figures."""

    def decorated(function: Callable[..., None]) -> Callable[..., None]:
        def drawn(figure_format: str | None, figure_size: str | None, **named: Any) -> None:
            from cmf_mj.show.look import printed

            with printed(figure_format, figure_size):
                function(**named)

        own, kind = signature(function, eval_str=True), Parameter.KEYWORD_ONLY
        more = {"figure_format": FigureFormat, "figure_size": FigureSize}
        extra = (Parameter(name, kind, default=None, annotation=one) for name, one in more.items())
        update_wrapper(drawn, function)
        vars(drawn)["__signature__"] = own.replace(parameters=[*own.parameters.values(), *extra])
        return drawn

    return lambda name: lambda function: command(name)(decorated(function))


name_or_file = partial(choice, free=True)  #: As `choice`, for names and files.

argument = partial(choice, make=Argument)  #: As `choice`, for an argument.

size, file = partial(Option, metavar="SIZE"), partial(Option, metavar="FILE")
"""Options of a number with its unit, and of a file; `help` says of what."""

new_file = partial(file, callback=check_writable)  #: Option of a file to write.

_of_machine = partial(Option, rich_help_panel="Machine")
_read_first = partial(Option, is_eager=True)  #: Before the options whose names depend on it.

ALL, VELOCITY = ["all"], ["velocity"]  #: Defaults of options that take several names.

NEUTRAL = "0,0,0,0,0,0"  #: Default of a pose.

CAMERAS = ("overview", "side", "front")  #: Cameras of the machine.

DOFS, LAWS = "machine.geometry:DOFS", "cli.options:shipped_laws"
CABS, OIL = "machine.models:CABS", "plant.parameters:HYDRAULICS"
MACHINES, SCENARIOS = "machine.models:machine_names", "facility.scenario:scenario_names"
PLANTS, WASHOUTS = "plant.hexapod:PLANTS", "pilot.washout_settings:WASHOUTS"
"""Where names stand, for `names_in`."""

_OWN = "name or TOML file; other defaults below are its own"
_LAWS = "laws by name or TOML file; `all` of the report"
_SETS = "report, hardware, lossy or TOML file"
_WASHOUTS = "simona, reid_nahon, optimal, predictive or TOML file"
_FORMATS = "of figures: png (default), svg or pdf"
_MAP = "TOML file of `cmf recording new`; default the facility's columns"
"""Texts of help that fit no line below."""

Dof = Annotated[str, choice(DOFS, "DOF", "surge, sway, heave, roll, pitch or yaw")]
AnyDof = Annotated[str, name_or_file(DOFS, "DOF", "degree of freedom, or leg_1 to leg_6")]
AnyDofs = Annotated[list[str], name_or_file(DOFS, "DOFS", "degrees of freedom or legs, or `all`")]
Dofs = Annotated[list[str], choice(DOFS, "DOFS", "degrees of freedom, or `all`")]
_machine = partial(name_or_file, MACHINES, "MACHINE")
Machine = Annotated[str, _machine(_OWN, make=partial(_of_machine, is_eager=True))]
"""Motion base whose cab, hydraulics and law the others name; read before them."""
OtherMachine = Annotated[str | None, _machine("replaces the file's", make=_read_first)]
Law = Annotated[str, of_machine(LAWS, "LAW", "law by name or TOML file")]
OtherLaw = Annotated[str | None, name_or_file(LAWS, "LAW", "default that of the file")]
Laws = Annotated[list[str], of_machine(LAWS, "LAWS", _LAWS, every="control.law:law_names")]
Cab = Annotated[str, of_machine(CABS, "CAB", "of the machine, by name or TOML file")]
Cabs = Annotated[list[str], of_machine(CABS, "CABS", "of the machine, TOML files, or `all`")]
OtherCab = Annotated[str | None, name_or_file(CABS, "CAB", "replaces the scenario's")]
PlantName = Annotated[str, choice(PLANTS, "PLANT", "hexapod or single_legs")]
Plants = Annotated[list[str], choice(PLANTS, "PLANTS", "hexapod, single_legs, or `all`")]
Hydraulics = Annotated[str, of_machine(OIL, "SET", _SETS)]
Washout = Annotated[str, name_or_file(WASHOUTS, "WASHOUT", _WASHOUTS)]
Scenario = Annotated[str, argument(SCENARIOS, "[SCENARIO]", "name or TOML file", free=True)]
Pose = Annotated[str, Option(metavar="POSE", help="x,y,z [in],roll,pitch,yaw [deg], z down")]
Friction = Annotated[str | None, Option(help="dry friction: none, stuck, or legs' speed [m/s]")]
Jobs = Annotated[
    int | None, Option(min=1, max=1024, help="threads or processes; default one a core")
]
Noise = Annotated[bool, Option("--noise/--ideal", help="sensors and electronics with noise")]
Quick = Annotated[bool, Option("--quick", help="shorter: sweeps of 30 s, not 100 s; fewer draws")]
Seed = Annotated[int, Option(help="of all random numbers", min=0, max=2**32 - 1)]
FigureFormat = Annotated[str | None, choice("show.look:FORMATS", "FORMAT", _FORMATS)]
FigureSize = Annotated[str | None, size(help="of figures: page, slide or WIDTHxHEIGHT [in]")]
Out = Annotated[Path, Option(metavar="FOLDER", help="folder for results", callback=claim)]
NamedOut = Annotated[Path | None, Option(metavar="FOLDER", help="folder; default by its name")]
Recordings = Annotated[list[Path], Argument(help="CSV, Parquet, HDF5 or MAT files")]
Columns = Annotated[Path | None, Option(metavar="MAP", help=_MAP)]
Seconds = Annotated[float | None, Option(help="length of a run [s]; default to the end")]
