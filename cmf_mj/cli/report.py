"""The report and lists: `cmf report`, `ledger`, `linear`, `laws`, `parameters` and `sensors`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, progress_bar, show, written
from cmf_mj.cli.options import argument
from cmf_mj.core.errors import require

command = partial(app.command, rich_help_panel="The report")
listing = partial(app.command, rich_help_panel="Show")


_NUMBERS = "by number with commas between, `all` or `none`"

Figures = Annotated[str, Option(metavar="NUMBERS", help=f"figures {_NUMBERS}")]
Tables = Annotated[str, Option(metavar="NUMBERS", help=f"result tables {_NUMBERS}")]
Sensors = Annotated[str, argument(options.SENSORS, "[SET]", "ideal, noisy or TOML", free=True)]


def _numbers(text: str) -> list[str] | None:
    """Numbers of a comma-separated option; None for all."""
    if text == "all":
        return None
    return [part.strip() for part in text.split(",") if part.strip() not in ("", "none")]


@command("report")
def report_command(
    figures: Figures = "all",
    tables: Tables = "all",
    jobs: options.Jobs = None,
    seed: options.Seed = 0,
    out: options.Out = Path("out/report"),
    quick: options.Quick = False,
) -> None:
    """Reproduce the 2014 report on one HTML page, printed results next to ours."""
    require("jinja2", "report")
    from cmf_mj.report_2014.page.document import make_content, save_page, verdict_tables

    with progress_bar() as update:
        content = make_content(
            _numbers(figures), _numbers(tables), jobs=jobs, quick=quick, seed=seed, progress=update
        )
    path = save_page(content, out)
    size = path.stat().st_size / 1e6
    parts = [part.table for part in verdict_tables(content)]
    show(*parts, f"written to {path}: {len(content.figures)} figures, {size:.1f} MB")


@command("ledger")
def ledger_command(
    number: Annotated[int | None, Argument(help="number of an entry; default all")] = None,
) -> None:
    """Show the misprints and contradictions of the report and what is done about each."""
    from cmf_mj.report_2014.ledger import ledger_entry, ledger_table, load_ledger

    show(ledger_table(load_ledger() if number is None else (ledger_entry(number),)))


@command("linear")
def linear_command(
    laws: options.Laws = options.VELOCITY, out: options.Out = Path("out/linear")
) -> None:
    """Show the report's linear models, Table 4-1 computed, and section 3.4's analysis."""
    from cmf_mj.report_2014 import model_tables as linear

    loops, rows = linear.law_loops(laws), linear.table_4_1()
    paths = linear.save_linear(loops, rows, out)
    tables = (linear.equation_table(), linear.misprint_table(), rows, loops)
    show(*tables, written(paths, out))


@listing("laws")
def laws_command() -> None:
    """List the shipped control laws with their sources."""
    from cmf_mj.control.law import law_names, load_law
    from cmf_mj.show.listing import law_table

    show(law_table([load_law(name) for name in law_names("all")]))


@listing("parameters")
def parameters_command(hydraulics: options.HydraulicSet = "hardware") -> None:
    """Show a hydraulic parameter set: value, unit, status and source of every number."""
    from cmf_mj.plant.parameters.loading import load_hydraulics
    from cmf_mj.show.listing import parameter_table

    show(parameter_table(load_hydraulics(hydraulics)))


@listing("sensors")
def sensors_command(sensors: Sensors = "noisy") -> None:
    """Show a sensor set: bandwidth, noise, bias, range and resolution of every channel."""
    from cmf_mj.electronics.sensors.channel import load_sensors
    from cmf_mj.show.listing import sensor_table

    show(sensor_table(load_sensors(sensors)))
