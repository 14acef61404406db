"""`cmf laws`, `cmf parameters` and `cmf ledger`."""

from typing import Annotated

import typer

from cmf_mj.analysis.ledger import ledger_entry, load_ledger
from cmf_mj.cli.common import TEXT_WIDTH, app, refuse, show
from cmf_mj.control.law import law_names, load_law
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.show.listing import law_table, ledger_table, parameter_table


@app.command("laws")
def laws_command() -> None:
    """List the shipped control laws with their sources."""
    show(law_table([load_law(name) for name in law_names("all")]), width=TEXT_WIDTH)


@app.command("parameters")
def parameters_command(
    hydraulics: Annotated[
        str, typer.Argument(help="report, hardware, lossy or a TOML file")
    ] = "hardware",
) -> None:
    """Show a hydraulic parameter set: value, unit, status and source of every number."""
    try:
        show(parameter_table(load_hydraulics(hydraulics)), width=TEXT_WIDTH)
    except ValueError as error:
        refuse(error)


@app.command("ledger")
def ledger_command(
    number: Annotated[int | None, typer.Argument(help="number of an entry; default all")] = None,
) -> None:
    """Show the misprints and contradictions of the report and what is done about each."""
    try:
        entries = load_ledger() if number is None else (ledger_entry(number),)
        show(ledger_table(entries), width=TEXT_WIDTH)
    except ValueError as error:
        refuse(error)
