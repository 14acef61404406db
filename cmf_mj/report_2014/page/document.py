"""The page: one HTML file with everything in it."""

import base64
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, cast

from matplotlib import rc_context

from cmf_mj.core.errors import check_name, require
from cmf_mj.core.files import write_text
from cmf_mj.core.quantity import quantity_table
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.report_2014.page.agreement import agreements, first_screen, verdict_table
from cmf_mj.report_2014.page.figures import FIGURES, ReportFigure
from cmf_mj.report_2014.page.runs import (
    CAB,
    HYDRAULICS,
    PLANTS,
    On,
    Runs,
    perform,
    report_plant,
)
from cmf_mj.report_2014.page.tables import (
    CONTENTS,
    TITLES,
    PageTable,
    gain_rows,
    limit_rows,
    page_table,
    result_table,
    table_needs,
    texts,
)
from cmf_mj.show.look import save_figure


class PageFigure(NamedTuple):
    """A figure of the page."""

    anchor: str
    title: str
    image: str  #: SVG in base64.
    caption: str


Block = PageTable | PageFigure | str
"""A string is a paragraph."""


class Section(NamedTuple):
    """A section with an entry in the contents."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]


class Content(NamedTuple):
    """All that sections are made of."""

    runs: Runs
    figures: tuple[ReportFigure, ...]  #: Figures of the page.
    tables: tuple[str, ...]  #: Result tables of the page.
    studies: bool
    """Whether the page has its summary: it has all figures and tables."""


def provenance(runs: Runs) -> PageTable:
    """What made the page: models, versions, seed."""
    packages = ("cmf-mj", "mujoco", "numpy", "scipy", "numba", "control")
    rows = [
        *(("seed", str(runs.seed)), ("cab of the hexapod", CAB.upper())),
        *((f"model digest, {name}", report_plant(on).digest) for on, name in PLANTS.items()),
        *((f"version, {name}", version(name)) for name in packages),
    ]
    return page_table("provenance-table", rows)


def hydraulic_numbers(on: On) -> PageTable:
    """The hydraulic numbers of a plant, each with its status."""
    shown = quantity_table("", load_hydraulics(HYDRAULICS[on]).quantities())
    title = f"{PLANTS[on]}, {HYDRAULICS[on]} set"
    return page_table("parameters", shown.rows, f"parameters-{on}", title)


def page_figure(figure: ReportFigure, runs: Runs) -> PageFigure:
    """A figure of the report as the page has it."""
    drawn, caption = figure.draw(runs)
    with TemporaryDirectory() as folder, rc_context({"svg.fonttype": "none"}):
        image = save_figure(drawn, Path(folder) / "figure.svg").read_bytes()
    title = f"Figure {figure.number}: {figure.title}"
    return PageFigure(f"figure-{figure.number}", title, base64.b64encode(image).decode(), caption)


BLOCKS: Mapping[str, Callable[[Content, str], Sequence[Block]]] = {
    "about": lambda content, _: [
        *texts("about"),
        *(texts("quick") if content.runs.quick else []),
        *([verdict_table(content.runs, content.tables)] if content.tables else []),
    ],
    "summary": lambda content, _: first_screen(content.runs),
    "limits": lambda content, _: [page_table("table-2-1", limit_rows())],
    "gains": lambda content, number: [
        page_table("gains", gain_rows(number), f"table-{number}", f"Table {number}: gains")
    ],
    "results": lambda content, number: [
        result_table(content.runs, name) for name in content.tables if name == number
    ],
    "figures": lambda content, prefix: [
        page_figure(figure, content.runs)
        for figure in content.figures
        if figure.number.startswith(prefix)
    ],
    "parameters": lambda content, _: [hydraulic_numbers(on) for on in PLANTS],
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

    With all of both, the default, the page also has its summary. An argument out of range is
    refused before anything runs.
    """
    numbers = _chosen("figures", figures, [figure.number for figure in FIGURES])
    chosen = tuple(figure for figure in FIGURES if figure.number in numbers)
    results = _chosen("tables", tables, tuple(TITLES))
    studies = figures is None and tables is None
    needs = [need for figure in chosen for need in figure.needs]
    needs += [need for table in results for need in table_needs(table)]
    runs = perform(needs, jobs=jobs, quick=quick, seed=seed, progress=progress)
    return Content(runs, chosen, results, studies)


def render(content: Content) -> str:
    """The page as text: the same bytes for the same content."""
    jinja = require("jinja2", "report")
    environment = jinja.Environment(autoescape=True, undefined=jinja.StrictUndefined)
    text = Path(__file__).with_name("page.html.jinja").read_text(encoding="utf-8")
    page = environment.from_string(text).render(
        title=CONTENTS["title"], sections=sections_of(content)
    )
    return cast("str", page)


def verdict_tables(content: Content) -> list[PageTable]:
    """Verdicts by table, and with all tables the shares of agreement."""
    tables = [verdict_table(content.runs, content.tables)] if content.tables else []
    if content.tables == tuple(TITLES):
        tables.append(PageTable("agreement", agreements(content.runs).table))
    return tables


def save_page(content: Content, folder: Path) -> Path:
    """Write `report.html`, complete when it appears, and its verdicts as `verdicts.md` and on."""
    for part in verdict_tables(content):
        part.table.save(folder / f"{part.anchor}.md")
    return write_text(folder / "report.html", render(content))
