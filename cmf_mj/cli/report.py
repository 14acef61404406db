"""The report: `cmf report`, and below it `ledger`, `linear` and `calibrate`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, claim, progress_bar, show, written
from cmf_mj.cli.options import argument
from cmf_mj.core.errors import require

reports = typer.Typer()
app.add_typer(reports, name="report", rich_help_panel="The report")

_CALIBRATED = "report, hardware, hardware_lag"
_TABLES = "report_2014.calibration.trial:load_studies"
_NUMBERS = "by number with commas between, `all` or `none`"

Figures = Annotated[str, Option(metavar="NUMBERS", help=f"figures {_NUMBERS}")]
Tables = Annotated[str, Option(metavar="NUMBERS", help=f"result tables {_NUMBERS}")]


def _numbers(text: str) -> list[str] | None:
    """Numbers of a comma-separated option; None for all."""
    if text == "all":
        return None
    return [part.strip() for part in text.split(",") if part.strip() not in ("", "none")]


@reports.callback(invoke_without_command=True)
def report_command(
    context: typer.Context,
    figures: Figures = "all",
    tables: Tables = "all",
    jobs: options.Jobs = None,
    seed: options.Seed = 0,
    out: options.NamedOut = None,
    quick: options.Quick = False,
) -> None:
    """Reproduce the 2014 report on one HTML page, printed results next to ours."""
    if context.invoked_subcommand is not None:
        return
    require("jinja2", "report")
    from cmf_mj.report_2014.page.document import make_content, save_page
    from cmf_mj.report_2014.page.statements import verdict_tables

    folder = claim(context, out or Path("out/report"))
    with progress_bar() as update:
        content = make_content(
            _numbers(figures), _numbers(tables), jobs=jobs, quick=quick, seed=seed, progress=update
        )
    path = save_page(content, folder)
    size = path.stat().st_size / 1e6
    parts = [part.table for part in verdict_tables(content)]
    show(*parts, f"written to {path}: {len(content.figures)} figures, {size:.1f} MB")


@reports.command("ledger")
def ledger_command(
    number: Annotated[int | None, Argument(help="number of an entry; default all")] = None,
) -> None:
    """Show the misprints and contradictions of the report and what is done about each."""
    from cmf_mj.report_2014.ledger import ledger_entry, ledger_table, load_ledger

    show(ledger_table(load_ledger() if number is None else (ledger_entry(number),)))


@reports.command("linear")
def linear_command(
    laws: options.Laws = options.VELOCITY, out: options.Out = Path("out/linear")
) -> None:
    """Show the report's linear models, Table 4-1 computed, and section 3.4's analysis."""
    from cmf_mj.report_2014 import model_tables as linear
    from cmf_mj.report_2014.models import law_loops, table_4_1

    loops, rows = law_loops(laws), table_4_1()
    paths = linear.save_linear(loops, rows, out)
    tables = (linear.model_table(), linear.misprint_table(), rows)
    show(*tables, linear.loop_table(loops), written(paths, out))


@reports.command("calibrate")
def calibrate_command(
    tables: Annotated[list[str], argument(_TABLES, "[TABLES]...", _CALIBRATED)] = options.ALL,
    rounds: Annotated[int, Option(help="fits, each followed by a simulation")] = 1,
    quick: options.Quick = False,
    samples: Annotated[int, Option(help="samples for the uncertainty")] = 128,
    jobs: options.Jobs = None,
    out: options.Out = Path("out/calibrate"),
) -> None:
    """Fit the free parameters to the published tables: values, residuals and uncertainty."""
    from cmf_mj.core.files import in_folder
    from cmf_mj.report_2014.calibration import fit as report
    from cmf_mj.report_2014.calibration.fit import calibrate, examine
    from cmf_mj.report_2014.calibration.trial import load_study

    for chosen in [load_study(name) for name in tables]:
        say = partial(typer.echo, err=True)
        fitted = calibrate(chosen, rounds=rounds, quick=quick, jobs=jobs, progress=say)
        result = examine(fitted, samples=samples, jobs=jobs)
        folder = in_folder(out, chosen.name)
        paths = report.save_calibration(result, folder)
        show(*report.tables(result), report.verdict_text(result), written(paths, folder))
