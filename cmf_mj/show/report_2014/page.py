"""The page: one HTML file with everything in it."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import check_name, require
from cmf_mj.core.files import write_text
from cmf_mj.show.chart import Curve, Panel
from cmf_mj.show.report_2014 import figures_of_laws, figures_of_models
from cmf_mj.show.report_2014.curves import CONTENTS, Content, ReportFigure, specs
from cmf_mj.show.report_2014.force import FORCE_NEEDS
from cmf_mj.show.report_2014.runs import perform
from cmf_mj.show.report_2014.sections import CALIBRATION_NEEDS, sections_of, summary
from cmf_mj.show.report_2014.statements import STATEMENT_NEEDS
from cmf_mj.show.report_2014.tables import TITLES, table_needs

MOST = 1200
"""Largest number of points a curve keeps."""

_PANEL, _MARGIN = 230, 96
"""Height of a panel and of what surrounds all [px]."""

XY = tuple[NDArray[np.floating], NDArray[np.floating]]


def figure_height(panels: Sequence[Panel]) -> int:
    """Height on the screen [px]."""
    return _MARGIN + round(sum(panel.height for panel in panels) * _PANEL)


def thinned(x: NDArray[np.floating], y: NDArray[np.floating]) -> XY:
    """At most `MOST` points: of each of equal stretches the lowest and the highest.

    Peaks survive, as they would not if every n-th point were kept.
    """
    if x.size <= MOST:
        return x, y
    edges = np.linspace(0, x.size, MOST // 2 + 1).astype(int)
    kept: set[int] = {0, x.size - 1}
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        part = y[first:last]
        kept |= {first + int(np.argmin(part)), first + int(np.argmax(part))}
    chosen = np.array(sorted(kept)[:MOST])
    return x[chosen], y[chosen]


def drawn(line: Curve, x_range: tuple[float, float] | None = None) -> XY:
    """What can be drawn of a curve within a range, thinned, in single precision."""
    x, y = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
    low, high = x_range or (-math.inf, math.inf)
    inside = (np.abs(y) < np.finfo(np.float32).max) & (x >= low) & (x <= high)
    x, y = thinned(x[inside], y[inside])
    return x.astype(np.float32), y.astype(np.float32)


def _trace(line: Curve, x_range: tuple[float, float] | None) -> dict[str, Any]:
    x, y = drawn(line, x_range)
    colour = {"color": line.colour}
    return {
        "name": line.name,
        "legendgroup": line.name,
        "x": x,
        "y": y,
        "mode": "markers" if line.marks else "lines",
        "line": {**colour, "width": line.width, "dash": line.dash, "simplify": False},
        "marker": {**colour, "size": 9, "symbol": "circle-open", "line": {"width": 2}},
        "hovertemplate": "%{x:.4g}, %{y:.4g}<extra>%{fullData.name}</extra>",
    }


def plotly_json(panels: Sequence[Panel]) -> str:
    """The panels as JSON of a plotly figure; the same bytes for the same panels."""
    figure = require("plotly.subplots", "report").make_subplots(
        rows=len(panels),
        shared_xaxes=True,
        row_heights=[panel.height for panel in panels],
        vertical_spacing=0.08 / len(panels),
    )
    last = panels[-1]
    names: set[str] = set()
    for row, panel in enumerate(panels, start=1):
        where = {"row": row, "col": 1}
        for line in panel.curves:
            trace = _trace(line, last.x_range)
            figure.add_scatter(**trace, showlegend=line.name not in names, **where)
            names.add(line.name)
        for level in panel.guides:
            figure.add_hline(level, line={"color": "#999999", "width": 1, "dash": "dot"}, **where)
        figure.update_yaxes(range=panel.y_range, dtick=panel.y_tick, title=panel.y_title, **where)
    figure.update_xaxes(range=last.x_range)
    if last.x_log and last.x_range is not None:
        low, high = (math.log10(value) for value in last.x_range)
        decades = range(math.floor(low), math.ceil(high) + 1)
        ticks = [float(f"{digit}e{decade}") for decade in decades for digit in (1, 2, 5)]
        figure.update_xaxes(type="log", range=[low, high], tickvals=ticks)
    figure.update_xaxes(title={"text": last.x_title, "standoff": 6}, row=len(panels), col=1)
    for update in (figure.update_xaxes, figure.update_yaxes):
        update(gridcolor="#e5e5e5", zeroline=False)
    figure.update_layout(
        template="none",
        height=figure_height(panels),
        margin={"l": 62, "r": 12, "t": 44, "b": 52},
        hovermode="closest",
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0.0},
        font={"family": "system-ui, sans-serif", "size": 12},
    )
    return str(figure.to_json())


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
