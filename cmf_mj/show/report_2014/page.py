"""The page: one HTML file with everything in it."""

import base64
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

from cmf_mj.core.errors import InputError, require
from cmf_mj.core.files import write_text
from cmf_mj.show.report_2014 import appendices, chapter_2, chapter_3, chapter_4, force, statements
from cmf_mj.show.report_2014.blocks import Content, Section
from cmf_mj.show.report_2014.chart import Chart
from cmf_mj.show.report_2014.curves import ReportFigure
from cmf_mj.show.report_2014.drawing import chart_height, plotly_json, still
from cmf_mj.show.report_2014.ledger_section import CALIBRATION_NEEDS
from cmf_mj.show.report_2014.runs import Wanted, perform
from cmf_mj.show.report_2014.sections import SECTIONS, STUDIES
from cmf_mj.show.report_2014.tables import TITLES, table_needs

TITLE = "Control laws of the NASA Langley Cockpit Motion Facility: the 2014 report, reproduced"

FIGURES: tuple[ReportFigure, ...] = (
    *chapter_2.FIGURES,
    *chapter_3.FIGURES,
    *chapter_4.FIGURES,
    *appendices.FIGURES,
)
"""All figures with numbers behind them, in the report's order."""

TABLES = tuple(TITLES)
"""All result tables; those of gains, limits and parameters need no run and are always shown."""

_TEMPLATE = Path(__file__).with_name("page.html.jinja")


def chosen_figures(numbers: Sequence[str] | None) -> tuple[ReportFigure, ...]:
    """Figures by number; None for all.

    Raises:
        InputError: a number that is none.
    """
    known = {figure.number: figure for figure in FIGURES}
    for number in numbers or ():
        if number not in known:
            raise InputError(f"figures: {number!r} is not one of {', '.join(known)}")
    return FIGURES if numbers is None else tuple(f for f in FIGURES if f.number in numbers)


def chosen_tables(numbers: Sequence[str] | None) -> tuple[str, ...]:
    """Result tables by number; None for all.

    Raises:
        InputError: a number that is none.
    """
    for number in numbers or ():
        if number not in TABLES:
            raise InputError(f"tables: {number!r} is not one of {', '.join(TABLES)}")
    return TABLES if numbers is None else tuple(t for t in TABLES if t in numbers)


def make_content(
    figures: Sequence[str] | None = None,
    tables: Sequence[str] | None = None,
    *,
    jobs: int | None = None,
    quick: bool = False,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Content:
    """Make all runs of the chosen figures and tables.

    Args:
        figures: numbers; default all.
        tables: numbers of result tables; default all. With all figures and tables the page also
            has its studies of force feedback, of steady states and of the numbers in the text.
        jobs: threads; default one per core. The page does not depend on it.
        quick: shorter sweeps, bandwidths within about 2 %.
        seed: of sensor noise and of validation runs.
        progress: called with (runs done, runs in all).

    Raises:
        InputError: an argument out of range, named; nothing has been run then.
    """
    shown, results = chosen_figures(figures), chosen_tables(tables)
    studies = figures is None and tables is None
    wanted: list[Wanted] = [need for figure in shown for need in figure.needs]
    wanted += [need for table in results for need in table_needs(table)]
    if studies:
        wanted += [*force.FORCE_NEEDS, *statements.STATEMENT_NEEDS, *statements.REST_NEEDS]
        wanted += CALIBRATION_NEEDS
    runs = perform(
        wanted,
        sensors=any(figure.sensors for figure in shown),
        jobs=jobs,
        quick=quick,
        seed=seed,
        progress=progress,
    )
    return Content(runs, shown, results, studies)


def sections_of(content: Content) -> tuple[Section, ...]:
    """The sections that have something to show."""
    made = (section(content) for section in SECTIONS if content.studies or section not in STUDIES)
    return tuple(section for section in made if section.blocks)


def render(content: Content) -> str:
    """The page as text: the same bytes for the same content.

    Raises:
        MissingExtraError: plotly or Jinja2 is not installed.
    """
    jinja = require("jinja2", "report")
    library = require("plotly.offline", "report").get_plotlyjs()
    markup = require("markupsafe", "report").Markup

    def pictured(chart: Chart) -> str:
        return base64.b64encode(still(chart).encode()).decode()

    def data(chart: Chart) -> str:
        # In a script element only the end tag must not occur; JSON may escape the slash.
        return cast("str", markup(plotly_json(chart).replace("</", "<\\/")))

    environment = jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined)
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    return cast(
        "str",
        template.render(
            title=TITLE,
            sections=sections_of(content),
            height=chart_height,
            plotly=data,
            still=pictured,
            library=markup(library),
        ),
    )


def save_page(content: Content, folder: Path) -> Path:
    """Write `report.html`; it appears only when it is complete.

    Raises:
        MissingExtraError: plotly or Jinja2 is not installed.
    """
    target = folder / "report.html"
    text = render(content)
    write_text(target, text)
    return target
