"""The page: one HTML file with everything in it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

from cmf_mj.core.errors import check_name, require
from cmf_mj.core.files import write_text
from cmf_mj.show.chart import Panel
from cmf_mj.show.report_2014 import figures_of_laws, figures_of_models
from cmf_mj.show.report_2014.contents import CONTENTS, Content, ReportFigure, specs
from cmf_mj.show.report_2014.drawing import figure_height, plotly_json
from cmf_mj.show.report_2014.force import FORCE_NEEDS
from cmf_mj.show.report_2014.runs import perform
from cmf_mj.show.report_2014.sections import CALIBRATION_NEEDS, sections_of, summary
from cmf_mj.show.report_2014.statements import STATEMENT_NEEDS
from cmf_mj.show.report_2014.tables import TITLES, table_needs

_DRAWINGS = vars(figures_of_laws) | vars(figures_of_models)
_TEMPLATE = Path(__file__).with_name("page.html.jinja")

FIGURES = tuple(
    ReportFigure(
        *(entry["number"], entry["title"], _DRAWINGS[entry["draw"]]),
        *(specs(*entry.get("runs", ())), entry.get("sensors", False), entry.get("options", {})),
    )
    for entry in CONTENTS["figure"]
)
"""All figures with numbers behind them, in the report's order."""

TABLES = tuple(TITLES)
"""All result tables; those of gains, limits and parameters need no run and are always there."""

STUDY_NEEDS = (*FORCE_NEEDS, *STATEMENT_NEEDS, *CALIBRATION_NEEDS)
"""Runs of the sections that come only with all figures and tables."""


def _chosen(name: str, numbers: Sequence[str] | None, known: Sequence[str]) -> tuple[str, ...]:
    """Those of `known` that are in `numbers`; all for None."""
    for number in numbers or ():
        check_name(name, number, known)
    return tuple(number for number in known if numbers is None or number in numbers)


def make_content(
    figures: Sequence[str] | None = None,
    tables: Sequence[str] | None = None,
    *,
    jobs: int | None = None,
    quick: bool = False,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Content:
    """Make all runs of the figures and result tables with these numbers; see `perform`.

    With all of both, the default, the page also has its studies of force feedback, of steady states
    and of the numbers in the text. An argument out of range is refused before anything runs.
    """
    numbers = _chosen("figures", figures, [figure.number for figure in FIGURES])
    chosen = tuple(figure for figure in FIGURES if figure.number in numbers)
    results = _chosen("tables", tables, TABLES)
    studies = figures is None and tables is None
    needs = [need for figure in chosen for need in figure.needs]
    needs += [need for table in results for need in table_needs(table)]
    needs += STUDY_NEEDS if studies else ()
    runs = perform(
        needs,
        sensors=any(figure.sensors for figure in chosen),
        jobs=jobs,
        quick=quick,
        seed=seed,
        progress=progress,
    )
    return Content(runs, chosen, results, studies)


def render(content: Content) -> str:
    """The page as text: the same bytes for the same content."""
    jinja = require("jinja2", "report")
    library = require("plotly.offline", "report").get_plotlyjs()
    markup = require("markupsafe", "report").Markup

    def data(panels: Sequence[Panel]) -> str:
        # In a script element only the end tag must not occur; JSON may escape the slash.
        return cast("str", markup(plotly_json(panels).replace("</", "<\\/")))

    environment = jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined)
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    page = template.render(
        title=CONTENTS["title"],
        sections=sections_of(content),
        height=figure_height,
        plotly=data,
        library=markup(library),
    )
    return cast("str", page)


def save_page(content: Content, folder: Path) -> Path:
    """Write `report.html`, complete when it appears, and its `summary` as `verdicts.md` and on."""
    for part in summary(content):
        part.table.save(folder / f"{part.anchor}.md")
    return write_text(folder / "report.html", render(content))
