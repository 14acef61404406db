"""The page: one HTML file with everything in it."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import check_name, require
from cmf_mj.core.files import write_text
from cmf_mj.core.quantity import quantity_table
from cmf_mj.core.result import number
from cmf_mj.report_2014.page import figures_of_laws, figures_of_models
from cmf_mj.report_2014.page import statements as summary
from cmf_mj.report_2014.page.curves import (
    CONTENTS,
    VERDICTS,
    Block,
    Content,
    PageTable,
    ReportFigure,
    Section,
    specs,
    table,
    texts,
)
from cmf_mj.report_2014.page.runs import (
    CAB,
    HYDRAULICS,
    PLANTS,
    On,
    Runs,
    hydraulics_of,
    perform,
    plant_of,
)
from cmf_mj.report_2014.page.statements import STATEMENT_NEEDS, statement_rows, verdict_tables
from cmf_mj.report_2014.page.tables import (
    TITLES,
    TOLERANCES,
    ResultRow,
    gain_rows,
    limit_rows,
    result_rows,
    table_needs,
)
from cmf_mj.show.look import Curve, Panel


def provenance(runs: Runs) -> PageTable:
    """What made the page: models, versions, seed."""
    packages = ("cmf-mj", "mujoco", "numpy", "scipy", "numba", "control")
    rows = [
        *(("seed", str(runs.seed)), ("cab of the hexapod", CAB.upper())),
        *((f"model digest, {name}", plant_of(on).digest) for on, name in PLANTS.items()),
        *((f"version, {name}", version(name)) for name in packages),
    ]
    return table("provenance-table", rows)


def parameters(on: On) -> PageTable:
    """The hydraulic numbers of a plant, each with its status."""
    shown = quantity_table("", hydraulics_of(on).quantities())
    return table(
        "parameters", shown.rows, f"parameters-{on}", f"{PLANTS[on]}, {HYDRAULICS[on]} set"
    )


def _share(value: float, relative: bool, sign: str = "+") -> str:
    """A deviation: relative in %, absolute as it is."""
    return number(100.0 * value, f"{sign}.1f %") if relative else number(value, f"{sign}.2f")


def _computed(row: ResultRow) -> float | str:
    """A computed number, or why there is none."""
    if row.computed == row.computed:
        return row.computed
    return "none below 10 Hz" if row.stable else "unstable"


def result_table(runs: Runs, name: str) -> PageTable:
    """A result table as the page has it; a long remark is written once."""
    appendix = name.startswith("D-")
    seen: set[str] = set()
    rows = []
    for row in result_rows(runs, name):
        again = len(row.note) > 40 and row.note in seen
        seen.add(row.note)
        relative = row.unit != ""
        rows.append(
            (
                *(row.label, row.of, f"{row.quantity} [{row.unit}]" if row.unit else row.quantity),
                row.printed if row.printed == row.printed else "N/A",
                _computed(row),
                _share(row.deviation, relative),
                _share(row.tolerance, relative, "").replace(".0 %", " %"),
                *(VERDICTS[row.within], "calibrated" if row.calibrated else "predicted"),
                *([number(row.hexapod, ".2f")] if appendix else []),
                "as above" if again else row.note,
            )
        )
    title = f"Table {name}" if name[0] != "s" else name.capitalize()
    head, anchor = "results-hexapod" if appendix else "results", f"table-{name.replace(' ', '-')}"
    return table(head, rows, anchor, f"{title}: {TITLES[name]}", TOLERANCES)


def _results(content: Content, number: str) -> list[PageTable]:
    return [result_table(content.runs, number)] if number in content.tables else []


BLOCKS: Mapping[str, Callable[[Content, str], Sequence[Block]]] = {
    "about": lambda content, _: [
        *texts("about"),
        *(texts("quick") if content.runs.quick else []),
        *summary.verdict_tables(content),
    ],
    "summary": summary.blocks,
    "limits": lambda content, _: [table("table-2-1", limit_rows())],
    "gains": lambda content, number: [
        table("gains", gain_rows(number), f"table-{number}", f"Table {number}: gains")
    ],
    "results": _results,
    "figures": lambda content, prefix: [
        figure.draw(content.runs) for figure in content.figures if figure.number.startswith(prefix)
    ],
    "statements": lambda content, _: [table("text-numbers", statement_rows(content.runs))],
    "parameters": lambda content, _: [parameters(on) for on in PLANTS],
    "provenance": lambda content, _: [provenance(content.runs)],
}
"""Kinds of blocks: functions of what was run and an argument."""


def sections_of(content: Content) -> tuple[Section, ...]:
    """The sections that have something to say; studies only with all figures and tables."""
    sections = []
    for entry in CONTENTS["section"]:
        if content.studies or not entry.get("study"):
            parts = (name.partition(" ") for name in entry["blocks"])
            blocks = [block for kind, _, what in parts for block in BLOCKS[kind](content, what)]
            sections.append(Section(entry["anchor"], entry["title"], tuple(blocks)))
    return tuple(section for section in sections if section.blocks)


MOST = 1200
"""Largest number of points a curve keeps."""

FLAT = 5e-4
"""Largest error of a curve as drawn, over the range of its axis."""

MOST_DRAWN = 1e6
"""Largest value that is drawn, of models that are unstable."""

_PANEL, _MARGIN = 230, 96
"""Height of a panel and of what surrounds all [px]."""

_Values = NDArray[np.floating]


def figure_height(panels: Sequence[Panel]) -> int:
    """Height on the screen [px]."""
    return _MARGIN + round(sum(panel.height for panel in panels) * _PANEL)


def thinned(x: _Values, y: _Values) -> tuple[_Values, _Values]:
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


def corners(x: _Values, y: _Values, most_off: float) -> NDArray[np.intp]:
    """Points between which straight lines are nowhere more than `most_off` from y.

    Douglas and Peucker: a stretch is split at its farthest point until none is too far.
    """
    kept, stretches = {0, x.size - 1}, [(0, x.size - 1)]
    while stretches:
        first, last = stretches.pop()
        inside = slice(first + 1, last)
        off = np.abs(y[inside] - np.interp(x[inside], x[[first, last]], y[[first, last]]))
        if off.size and off.max() > most_off:
            middle = first + 1 + int(np.argmax(off))
            kept.add(middle)
            stretches += [(first, middle), (middle, last)]
    return np.array(sorted(kept))


def drawn(line: Curve, below: Panel, most_off: float = 0.0) -> tuple[_Values, _Values]:
    """What can be drawn of a curve over the x axis of the panel `below` all: few points."""
    x, y = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
    low, high = below.x_range or (-math.inf, math.inf)
    inside = (np.abs(y) < MOST_DRAWN) & (x >= low) & (x <= high)
    x, y = thinned(x[inside], y[inside])
    if line.marks or x.size == 0:
        return x, y
    kept = corners(np.log(x) if below.x_log else x, y, most_off)
    return x[kept], y[kept]


def _range(panel: Panel, below: Panel) -> tuple[float, float]:
    """Ends of the y axis: given, or all that is seen with a margin of 5 %."""
    if panel.y_range:
        return panel.y_range
    seen = np.concatenate([drawn(line, below)[1] for line in panel.curves] + [panel.guides])
    low, high = float(seen.min()), float(seen.max())
    margin = 0.05 * (high - low)
    return low - margin, high + margin


def figure_data(panels: Sequence[Panel]) -> dict[str, Any]:
    """The panels as `page.js` draws them, numbers with five digits."""

    def short(values: _Values) -> list[float]:
        return [float(f"{value:.5g}") for value in values]

    below, parts = panels[-1], list[dict[str, Any]]()
    for panel in panels:
        low, high = _range(panel, below)
        curves: list[dict[str, Any]] = []
        for line in panel.curves:
            x, y = drawn(line, below, FLAT * (high - low))
            style = {name: getattr(line, name) for name in ("name", "colour", "dash", "marks")}
            style |= {"width": line.width, "pale": line.pale}
            curves.append(style | {"x": short(x), "y": short(y)})
        part = {"title": panel.y_title, "height": panel.height * _PANEL, "range": (low, high)}
        parts.append(part | {"tick": panel.y_tick, "guides": panel.guides, "curves": curves})
    seen = [x for part in parts for curve in part["curves"] for x in curve["x"]]
    ends = below.x_range or (min(seen), max(seen))
    return {"title": below.x_title, "range": ends, "log": below.x_log, "panels": parts}


_DRAWINGS = vars(figures_of_laws) | vars(figures_of_models)
_TEMPLATE, _SCRIPT = map(Path(__file__).with_name, ("page.html.jinja", "page.js"))

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


def _chosen(name: str, numbers: Sequence[str] | None, known: Sequence[str]) -> tuple[str, ...]:
    """Those of `known` that are in `numbers`; all for None."""
    for one in numbers or ():
        check_name(name, one, known)
    return tuple(one for one in known if numbers is None or one in numbers)


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
    needs += STATEMENT_NEEDS if studies else ()
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
    markup = require("markupsafe", "report").Markup

    def data(panels: Sequence[Panel]) -> str:
        text = json.dumps(figure_data(panels), separators=(",", ":"))
        # In a script element only the end tag must not occur; JSON may escape the slash.
        return cast("str", markup(text.replace("</", "<\\/")))

    environment = jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined)
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    page = template.render(
        title=CONTENTS["title"],
        sections=sections_of(content),
        height=figure_height,
        data=data,
        script=markup(_SCRIPT.read_text(encoding="utf-8")),
    )
    return cast("str", page)


def save_page(content: Content, folder: Path) -> Path:
    """Write `report.html`, complete when it appears, and its verdicts as `verdicts.md` and on."""
    for part in verdict_tables(content):
        part.table.save(folder / f"{part.anchor}.md")
    return write_text(folder / "report.html", render(content))
