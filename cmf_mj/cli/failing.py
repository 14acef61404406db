"""`cmf failure`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cmf_mj.cli.common import (
    Cab,
    Dof,
    HydraulicSet,
    Jobs,
    LawName,
    app,
    in_si,
    names_of,
    refuse,
    show,
)
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.plant.events import KINDS, Event, default_event
from cmf_mj.show import failure as failure_report
from cmf_mj.studies.failure.manoeuvre import AFTER, AT, FREQUENCY
from cmf_mj.studies.failure.runs import run_failures


def read_size(text: str) -> tuple[float, str]:
    """A number and its unit, such as `1 in^2`.

    Raises:
        InputError: it is not that.
    """
    number, _, unit = text.strip().partition(" ")
    try:
        return float(number), unit.strip() or "1"
    except ValueError as error:
        raise InputError(f"size: {text!r} is not a number and a unit, such as '1 in^2'") from error


def events_of(
    event: str, at: float, leg: int | None, valve: int | None, size: str | None
) -> list[Event]:
    """Events of the command line; `all` is every kind, valves once both and once the first.

    Raises:
        InputError: names what is refused.
    """
    kinds = names_of(event, KINDS)
    for kind in kinds:
        if kind not in KINDS:
            raise InputError(f"event: {kind!r} is not one of all, {', '.join(KINDS)}")
    given = None if size is None else read_size(size)
    if len(kinds) > 1 and (given is not None or valve is not None):
        raise InputError("size, valve: are for one event; several events take their defaults")
    if len(kinds) == 1:
        return [default_event(kinds[0], at, leg=leg, valve=valve, size=given)]
    events = []
    for kind in kinds:
        local = default_event(kind, at).leg is not None
        numbers = (None, 1) if kind.startswith("valve") else (None,)
        for number in numbers:
            events.append(default_event(kind, at, leg=leg if local else None, valve=number))
    return events


@app.command("failure")
def failure_command(
    event: Annotated[str, typer.Argument(help=f"`all` or any of {', '.join(KINDS)}")],
    dof: Dof = "heave",
    leg: Annotated[int | None, typer.Option(help="leg of a valve or sensor; default 1")] = None,
    valve: Annotated[int | None, typer.Option(help="1 or 2; default both")] = None,
    size: Annotated[str | None, typer.Option(help="how much, such as '1 in^2'")] = None,
    at: Annotated[float, typer.Option(help="time of the event [s]")] = AT,
    after: Annotated[float, typer.Option(help="length of the run after it [s]")] = AFTER,
    law: LawName = "velocity",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    amplitude: Annotated[
        float | None, typer.Option(help="of the sine [in or deg]; default 6 in or 4 deg")
    ] = None,
    frequency: Annotated[float, typer.Option(help="of the sine [Hz]")] = FREQUENCY,
    protection: Annotated[bool, typer.Option(help="whether a fault stops the machine")] = True,
    thresholds: Annotated[str, typer.Option(help="default or a TOML file")] = "default",
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/failure"),
) -> None:
    """Let something fail during a manoeuvre: leg loads, what the crew feels, how it ends."""
    try:
        results = run_failures(
            events_of(event, at, leg, valve, size),
            cab=cab,
            hydraulics=hydraulics,
            law=law,
            dof=dof,
            amplitude=in_si(dof, amplitude),
            frequency=frequency,
            after=after,
            protection=thresholds if protection else None,
            jobs=jobs,
        )
        paths = failure_report.save_failures(results, out)
        table = failure_report.failure_table(results)
        messages = [result.message for result in results if result.message]
        load = max(results, key=lambda result: abs(result.load_after.value)).load_after
        show(
            table,
            *messages,
            f"largest load: {units.from_si('lbf', load.value):.0f} lbf in leg {load.leg}",
            f"written to {out}: failures.csv, failures.md, {len(paths) - 2} figures",
            width=Console(width=1000).measure(table).maximum,
        )
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
