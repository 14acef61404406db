"""`cmf report`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from cmf_mj.cli.common import TEXT_WIDTH, Jobs, app, progress_bar, refuse, show
from cmf_mj.show.report_2014.drawing import require_extra
from cmf_mj.show.report_2014.page import make_content, save_page
from cmf_mj.show.report_2014.tables import result_rows


def _numbers(text: str) -> list[str] | None:
    """Numbers of a comma-separated option; None for all."""
    if text == "all":
        return None
    return [part.strip() for part in text.split(",") if part.strip() not in ("", "none")]


@app.command("report")
def report_command(
    figures: Annotated[str, typer.Option(help="figures by number, `all` or `none`")] = "all",
    tables: Annotated[str, typer.Option(help="result tables by number, `all` or `none`")] = "all",
    jobs: Jobs = None,
    seed: Annotated[int, typer.Option(help="of sensor noise and validation runs")] = 0,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/report"),
    quick: Annotated[bool, typer.Option("--quick", help="sweep in 30 s instead of 100 s")] = False,
) -> None:
    """Reproduce the 2014 report on one HTML page, printed results beside ours."""
    try:
        require_extra()
        with progress_bar() as update:
            content = make_content(
                _numbers(figures),
                _numbers(tables),
                jobs=jobs,
                quick=quick,
                seed=seed,
                progress=update,
            )
        path = save_page(content, out)
        summary = Table("table", "within", "outside", "reported", title="rows by verdict")
        for table in content.tables:
            verdicts = [row.within for row in result_rows(content.runs, table)]
            counts = (verdicts.count(True), verdicts.count(False), verdicts.count(None))
            summary.add_row(table, *map(str, counts))
        size = path.stat().st_size / 1e6
        written = f"written to {path}: {len(content.figures)} figures, {size:.1f} MB"
        parts: list[Table | str] = [summary] if content.tables else []
        show(*parts, written, width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
