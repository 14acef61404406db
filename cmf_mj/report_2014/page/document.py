"""The page: one HTML file of sections, and how many printed numbers are met.

Every printed number counts once, however often the report prints it. A law whose step rings on has
no bandwidth and no damping ratio, and so agrees with no printed one. All deviations of the shares
of agreement are relative, also those of damping ratios.
"""

import base64
from collections.abc import Callable, Collection, Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
from matplotlib import rc_context

from cmf_mj.core.errors import check_name, require
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table, fields_of
from cmf_mj.plant.hexapod import make_plant
from cmf_mj.report_2014.page.figures import FIGURES, ReportFigure
from cmf_mj.report_2014.page.runs import CAB, HYDRAULICS, PLANT_KINDS, Runs, perform
from cmf_mj.report_2014.page.tables import (
    BANDWIDTHS,
    CONTENTS,
    DAMPING_RATIO,
    TABLE_TITLES,
    TOLERANCE_TEXT,
    PageTable,
    ResultRow,
    result_rows,
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


Block = PageTable | PageFigure | str  #: A string is a paragraph.


class Section(NamedTuple):
    """A section with an entry in the contents."""

    anchor: str
    title: str
    blocks: Sequence[Block]


class Content(NamedTuple):
    """All that sections are made of."""

    runs: Runs
    figures: tuple[ReportFigure, ...]  #: Figures of the page.
    tables: tuple[str, ...]  #: Result tables of the page.

    @property
    def has_all_tables(self) -> bool:
        """Whether it has all result tables, and so shares of agreement."""
        return self.tables == tuple(TABLE_TITLES)


def provenance() -> PageTable:
    """What made the page: models and versions."""
    packages = ("cmf-mj", "mujoco", "numpy", "scipy", "numba", "control")
    plants = {kind: make_plant(kind, CAB, HYDRAULICS[plant]) for plant, kind in PLANT_KINDS.items()}
    rows = [
        ("cab of the hexapod", CAB.upper()),
        *((f"model digest, {name}", plant.digest) for name, plant in plants.items()),
        *((f"version, {name}", version(name)) for name in packages),
    ]
    return PageTable("provenance-table", Table("Made by", ("", ""), rows))


def page_figure(figure: ReportFigure, runs: Runs) -> PageFigure:
    """A figure of the report as the page has it."""
    drawing, caption = figure.draw(runs)
    with TemporaryDirectory() as folder, rc_context({"svg.fonttype": "none"}):
        image = save_figure(drawing, Path(folder) / "figure.svg").read_bytes()
    title = f"Figure {figure.number}: {figure.title}"
    return PageFigure(f"figure-{figure.number}", title, base64.b64encode(image).decode(), caption)


def sections_of(content: Content) -> tuple[Section, ...]:
    """The sections that have a block; the summary only with all result tables."""
    runs = content.runs
    summary = summary_blocks(runs) if content.has_all_tables else []
    about: list[Block] = [*texts("about"), *(texts("quick") if runs.quick else [])]
    if content.tables:
        about.append(verdict_table(runs, content.tables))
    sections = [Section("summary", "In short", summary), Section("about", "About this page", about)]
    for entry in CONTENTS["section"]:
        blocks: list[Block] = [
            result_table(runs, name) for name in entry["tables"] if name in content.tables
        ]
        figures = [f for f in content.figures if f.number.startswith(entry["figures"])]
        blocks += [page_figure(figure, runs) for figure in figures]
        sections.append(Section(entry["anchor"], entry["title"], blocks))
    sections.append(Section("provenance", "Models and versions", [provenance()]))
    return tuple(section for section in sections if section.blocks)


def _selected(field: str, numbers: Sequence[str] | None, known: Sequence[str]) -> tuple[str, ...]:
    """Those of `known` that are in `numbers`; all for None."""
    for number in numbers or ():
        check_name(field, number, known)
    return tuple(number for number in known if numbers is None or number in numbers)


def make_content(
    figures: Sequence[str] | None = None,
    tables: Sequence[str] | None = None,
    *,
    jobs: int | None = None,
    quick: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Content:
    """Make all runs of the figures and result tables with these numbers; see `perform`.

    With all tables, the default, the page also has its summary. An argument out of range is refused
    before anything runs.
    """
    numbers = _selected("figures", figures, [figure.number for figure in FIGURES])
    report_figures = tuple(figure for figure in FIGURES if figure.number in numbers)
    table_names = _selected("tables", tables, tuple(TABLE_TITLES))
    needs = [need for figure in report_figures for need in figure.needs]
    needs += [need for name in table_names for need in table_needs(name)]
    runs = perform(needs, jobs=jobs, quick=quick, progress=progress)
    return Content(runs, report_figures, table_names)


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
    if content.has_all_tables:
        tables.append(PageTable("agreement", agreements(content.runs).table))
    return tables


def save_page(content: Content, folder: Path) -> Path:
    """Write `report.html`, complete when it appears, and its tables of verdicts as Markdown."""
    for page_table in verdict_tables(content):
        page_table.table.save(folder / f"{page_table.anchor}.md")
    return write_text(folder / "report.html", render(content))


class Agreement(NamedTuple):
    """What of a class of printed numbers is met."""

    number_class: Annotated[str, Field(title="")]
    printed: Annotated[int, Field(form="d")]  #: How many numbers are printed.
    within_5: Annotated[float, Field(title="within 5 %", form=".0f %", unit="%")]
    """Share of them that is off by at most 5 %; likewise those that follow."""
    within_10: Annotated[float, Field(title="10 %", form=".0f %", unit="%")]
    within_15: Annotated[float, Field(title="15 %", form=".0f %", unit="%")]
    median: Annotated[float, Field(title="median deviation", form="+.1f %", unit="%")]
    below: Annotated[float, Field(title="below the print", form=".0f %", unit="%")]
    """Share of those computed that lie below the print."""


def distinct_numbers(rows: Iterable[ResultRow]) -> list[ResultRow]:
    """The rows without the numbers that the report prints once more."""
    first_rows: dict[tuple[Any, ...], ResultRow] = {}
    for row in rows:
        number = (row.law, row.label, row.source, row.quantity, row.printed, row.is_as_read)
        first_rows.setdefault(number, row)
    return list(first_rows.values())


def agreement_of(
    number_class: str, rows: Collection[ResultRow], *, from_sweeps: bool = False
) -> Agreement:
    """Shares of a class; `from_sweeps` counts the bandwidths of sweeps of laws that ring on."""
    values = np.array([row.sweep_value if from_sweeps else row.computed for row in rows])
    deviation = values / np.array([row.printed for row in rows]) - 1.0
    known = deviation[np.isfinite(deviation)]
    within_5, within_10, within_15 = (
        float(np.mean(np.abs(deviation) <= limit + 1e-9)) for limit in (0.05, 0.10, 0.15)
    )
    median, below = float(np.median(known)), float(np.mean(known < 0.0))
    return Agreement(number_class, len(rows), within_5, within_10, within_15, median, below)


def agreements(runs: Runs) -> Result[Agreement]:
    """All classes, from all result tables."""
    all_rows = [row for table in TABLE_TITLES for row in result_rows(runs, table)]
    printed = [row for row in distinct_numbers(all_rows) if not np.isnan(row.printed)]
    as_read = [row for row in printed if row.is_as_read]
    bandwidths = [row for row in as_read if row.quantity in BANDWIDTHS]
    as_printed = [row for row in printed if not row.is_as_read and row.quantity in BANDWIDTHS]
    laws_as_printed = {row.law for row in as_printed}
    as_printed += [row for row in bandwidths if row.law not in laws_as_printed]
    classes = [
        agreement_of("bandwidths", bandwidths),
        agreement_of("of them calibrated", [row for row in bandwidths if row.calibrated]),
        agreement_of("of them predicted", [row for row in bandwidths if not row.calibrated]),
    ]
    for name in BANDWIDTHS:
        of_quantity = [row for row in bandwidths if row.quantity == name]
        classes.append(agreement_of(f"of them {name}", of_quantity))
    damping = [row for row in as_read if row.quantity == DAMPING_RATIO]
    classes += [
        agreement_of("bandwidths, sweeps that ring read too", bandwidths, from_sweeps=True),
        agreement_of("bandwidths, gains and filter as printed", as_printed),
        agreement_of("damping ratios, all predicted", damping),
    ]
    blank, met = not_available(all_rows)
    (note,) = texts("agreement", printed=blank, met=met)
    return Result(classes, fields_of(Agreement), "Share of the printed numbers that are met", note)


def not_available(rows: Iterable[ResultRow]) -> tuple[int, int]:
    """How many -3 dB are printed as N/A, and how many of these ours does not reach either."""
    widths = (row for row in rows if row.is_as_read and row.quantity == "-3 dB")
    blank = [row for row in widths if np.isnan(row.printed)]
    return len(blank), sum(row.within for row in blank)


def verdict_table(runs: Runs, names: Sequence[str]) -> PageTable:
    """Verdicts by result table; of laws as read, not of their gains as printed."""
    rows = []
    for name in names:
        verdicts = [row.within for row in result_rows(runs, name) if row.is_as_read]
        rows.append((name, f"{verdicts.count(True)}", f"{verdicts.count(False)}"))
    header = ("table", "within", "outside")
    return PageTable("verdicts", Table("Verdicts by table", header, rows, TOLERANCE_TEXT))


def summary_blocks(runs: Runs) -> list[Block]:
    """The first screen of a page with all result tables."""
    rows = [row for name in TABLE_TITLES for row in result_rows(runs, name) if row.is_as_read]
    blank, met = not_available(rows)
    paragraphs = texts("summary", numbers=len(distinct_numbers(rows)), blank=blank, met=met)
    return [*paragraphs, PageTable("agreement", agreements(runs).table)]
