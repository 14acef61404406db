"""The page: one HTML file with everything in it, first of all how many printed results are met.

Every printed number counts once, however often the report prints it. A law whose step rings on has
no bandwidth and no damping ratio, and so agrees with no printed one. Deviations are relative, those
of damping ratios too.
"""

import base64
from collections.abc import Callable, Collection, Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, NamedTuple, cast

import numpy as np
from matplotlib import rc_context

from cmf_mj.core.errors import check_name, require
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table, fields_of
from cmf_mj.plant.hexapod import make_plant
from cmf_mj.report_2014.page.figures import FIGURES, ReportFigure
from cmf_mj.report_2014.page.runs import CAB, HYDRAULICS, PLANTS, Runs, perform
from cmf_mj.report_2014.page.tables import (
    BANDWIDTHS,
    CONTENTS,
    RATIO,
    TITLES,
    TOLERANCES,
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
    def whole(self) -> bool:
        """Whether it has all result tables, and so shares of agreement."""
        return self.tables == tuple(TITLES)


def provenance() -> PageTable:
    """What made the page: models and versions."""
    packages = ("cmf-mj", "mujoco", "numpy", "scipy", "numba", "control")
    plants = {name: make_plant(name, CAB, HYDRAULICS[on]) for on, name in PLANTS.items()}
    rows = [
        ("cab of the hexapod", CAB.upper()),
        *((f"model digest, {name}", plant.digest) for name, plant in plants.items()),
        *((f"version, {name}", version(name)) for name in packages),
    ]
    return PageTable("provenance-table", Table("Made by", ("", ""), rows))


def page_figure(figure: ReportFigure, runs: Runs) -> PageFigure:
    """A figure of the report as the page has it."""
    drawn, caption = figure.draw(runs)
    with TemporaryDirectory() as folder, rc_context({"svg.fonttype": "none"}):
        image = save_figure(drawn, Path(folder) / "figure.svg").read_bytes()
    title = f"Figure {figure.number}: {figure.title}"
    return PageFigure(f"figure-{figure.number}", title, base64.b64encode(image).decode(), caption)


def sections_of(content: Content) -> tuple[Section, ...]:
    """The sections that have something to say; the summary only with all result tables."""
    runs, figures = content.runs, content.figures
    summary = first_screen(runs) if content.whole else []
    about: list[Block] = [*texts("about"), *(texts("quick") if runs.quick else [])]
    if content.tables:
        about.append(verdict_table(runs, content.tables))
    every = [Section("summary", "In short", summary), Section("about", "About this page", about)]
    for one in CONTENTS["section"]:
        blocks: list[Block] = [
            result_table(runs, name) for name in one["tables"] if name in content.tables
        ]
        blocks += [page_figure(f, runs) for f in figures if f.number.startswith(one["figures"])]
        every.append(Section(one["anchor"], one["title"], blocks))
    every.append(Section("provenance", "Models and versions", [provenance()]))
    return tuple(section for section in every if section.blocks)


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
    progress: Callable[[int, int], None] | None = None,
) -> Content:
    """Make all runs of the figures and result tables with these numbers; see `perform`.

    With all tables, the default, the page also has its summary. An argument out of range is refused
    before anything runs.
    """
    numbers = _chosen("figures", figures, [figure.number for figure in FIGURES])
    chosen = tuple(figure for figure in FIGURES if figure.number in numbers)
    results = _chosen("tables", tables, tuple(TITLES))
    needs = [need for figure in chosen for need in figure.needs]
    needs += [need for table in results for need in table_needs(table)]
    return Content(perform(needs, jobs=jobs, quick=quick, progress=progress), chosen, results)


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
    if content.whole:
        tables.append(PageTable("agreement", agreements(content.runs).table))
    return tables


def save_page(content: Content, folder: Path) -> Path:
    """Write `report.html`, complete when it appears, and its verdicts as `verdicts.md` and on."""
    for part in verdict_tables(content):
        part.table.save(folder / f"{part.anchor}.md")
    return write_text(folder / "report.html", render(content))


class Agreement(NamedTuple):
    """What of a class of printed numbers is met."""

    what: Annotated[str, Field(title="")]
    printed: Annotated[int, Field(form="d")]  #: How many numbers are printed.
    within_5: Annotated[float, Field(title="within 5 %", form=".0f %", unit="%")]
    """Share of them that is off by at most so much; likewise those that follow."""
    within_10: Annotated[float, Field(title="10 %", form=".0f %", unit="%")]
    within_15: Annotated[float, Field(title="15 %", form=".0f %", unit="%")]
    median: Annotated[float, Field(title="median deviation", form="+.1f %", unit="%")]
    below: Annotated[float, Field(title="below the print", form=".0f %", unit="%")]
    """Share of those computed that lie below the print."""


def once(rows: Iterable[ResultRow]) -> list[ResultRow]:
    """The rows without the numbers that the report prints once more."""
    seen = {(r.law, r.label, r.of, r.quantity, r.printed, r.read): r for r in reversed([*rows])}
    return [*reversed(seen.values())]


def share_met(what: str, rows: Collection[ResultRow], *, swept: bool = False) -> Agreement:
    """Shares of rows, of ringing laws the bandwidths of their sweeps if `swept`."""
    off = np.array([(r.swept if swept else r.computed) / r.printed - 1.0 for r in rows])
    known = off[np.isfinite(off)]
    values = [np.mean(np.abs(off) <= limit + 1e-9) for limit in (0.05, 0.10, 0.15)]
    values += [np.median(known), np.mean(known < 0.0)]
    return Agreement(what, len(rows), *map(float, values))


def agreements(runs: Runs) -> Result[Agreement]:
    """All classes, from all result tables."""
    every = [row for table in TITLES for row in result_rows(runs, table)]
    rows = once(every)

    def of(quantities: Collection[str], keep: Callable[[ResultRow], bool]) -> list[ResultRow]:
        numbers = [r for r in rows if r.quantity in quantities and r.printed == r.printed]
        return [row for row in numbers if keep(row)]

    widths = of(BANDWIDTHS, lambda row: row.read)
    literal = of(BANDWIDTHS, lambda row: not row.read)
    literal += [row for row in widths if row.law not in {other.law for other in literal}]
    classes = [
        share_met("bandwidths", widths),
        share_met("of them calibrated", [row for row in widths if row.calibrated]),
        share_met("of them predicted", [row for row in widths if not row.calibrated]),
        *(share_met(f"of them {name}", of((name,), lambda row: row.read)) for name in BANDWIDTHS),
        share_met("bandwidths, sweeps that ring read too", widths, swept=True),
        share_met("bandwidths, gains and filter as printed", literal),
        share_met("damping ratios, all predicted", of((RATIO,), lambda row: row.read)),
    ]
    printed, met = not_available(every)
    (note,) = texts("agreement", printed=printed, met=met)
    return Result(classes, fields_of(Agreement), "Share of the printed numbers that are met", note)


def not_available(rows: Iterable[ResultRow]) -> tuple[int, int]:
    """How many -3 dB are printed as N/A, and how many of these ours does not reach either."""
    widths = (row for row in rows if row.read and row.quantity == "-3 dB")
    blank = [row for row in widths if row.printed != row.printed]
    return len(blank), sum(row.within for row in blank)


def verdict_table(runs: Runs, names: Sequence[str]) -> PageTable:
    """Verdicts by result table; of laws as read, not of their gains as printed."""
    rows = []
    for name in names:
        verdicts = [row.within for row in result_rows(runs, name) if row.read]
        rows.append((name, f"{verdicts.count(True)}", f"{verdicts.count(False)}"))
    header = ("table", "within", "outside")
    return PageTable("verdicts", Table("Verdicts by table", header, rows, TOLERANCES))


def first_screen(runs: Runs) -> list[Block]:
    """The first screen of a page with all result tables."""
    rows = [row for name in TITLES for row in result_rows(runs, name) if row.read]
    blank, met = not_available(rows)
    lead = texts("summary", numbers=len(once(rows)), blank=blank, met=met)
    return [*lead, PageTable("agreement", agreements(runs).table)]
