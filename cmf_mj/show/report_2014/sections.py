"""The sections of the page, in order. A section is a function from what was run to its blocks.

A section that is left out of `SECTIONS` is left out of the page and of its contents; a new one is a
function and its entry.
"""

from collections.abc import Callable, Iterable

from cmf_mj.show.report_2014.blocks import (
    Block,
    Content,
    PageFigure,
    PageTable,
    Section,
    TableRow,
    Text,
    Verdict,
)
from cmf_mj.show.report_2014.ledger_section import calibration, ledger
from cmf_mj.show.report_2014.provenance import parameters, provenance
from cmf_mj.show.report_2014.runs import Runs
from cmf_mj.show.report_2014.study_sections import force_feedback, steady_state, text_numbers
from cmf_mj.show.report_2014.tables import (
    TITLES,
    TOLERANCES,
    ResultRow,
    gain_rows,
    limit_rows,
    result_rows,
)


def result_table(runs: Runs, table: str) -> PageTable:
    """A result table as the page shows it."""
    rows = result_rows(runs, table)
    title = f"Table {table}" if table[0] != "s" else table.capitalize()
    appendix = table.startswith("D-")
    common = ("", "of", "quantity", "printed", "computed", "deviation", "allowed", "verdict")
    header = (*common, "hexapod", "remark") if appendix else (*common, "remark")
    return PageTable(
        f"table-{table.replace(' ', '-')}",
        f"{title}: {TITLES[table]}",
        header,
        _said_once(_result_cells(row, appendix) for row in rows),
        TOLERANCES,
    )


def _said_once(rows: Iterable[TableRow]) -> tuple[TableRow, ...]:
    """Rows whose remark, the last cell, repeats only as a reference to the first."""
    seen: set[str] = set()
    found = []
    for row in rows:
        remark = row.cells[-1]
        again = len(remark) > 40 and remark in seen
        seen.add(remark)
        found.append(row._replace(cells=(*row.cells[:-1], "as above")) if again else row)
    return tuple(found)


def _result_cells(row: ResultRow, appendix: bool) -> TableRow:
    relative = row.unit == "Hz"

    def share(value: float, sign: str) -> str:
        if value != value:
            return "–"
        return f"{100.0 * value:{sign}.1f} %" if relative else f"{value:{sign}.2f}"

    verdict: Verdict = "reported" if row.within is None else "within" if row.within else "outside"
    cells = [
        row.label,
        row.of,
        f"{row.quantity} [{row.unit}]" if row.unit else row.quantity,
        "N/A" if row.printed != row.printed else f"{row.printed:g}",
        f"{row.computed:.2f}" if row.computed == row.computed else "none below 10 Hz",
        share(row.deviation, "+"),
        share(row.tolerance, ""),
        verdict,
    ]
    if appendix:
        missing = "–" if relative else "unstable"
        cells.append(f"{row.hexapod:.2f}" if row.hexapod == row.hexapod else missing)
    return TableRow((*cells, row.note), verdict)


def gains_table(number: str) -> PageTable:
    """A gain table beside the shipped law."""
    rows = []
    for row in gain_rows():
        if row.table != number:
            continue
        verdict: Verdict = "within" if row.same else "outside" if not row.note else "reported"
        printed = "not printed here" if row.printed != row.printed else f"{row.printed:g}"
        said = "same" if row.same else "differs"
        rows.append(
            TableRow((row.law, row.gain, printed, f"{row.shipped:g}", said, row.note), verdict)
        )
    return PageTable(
        f"table-{number}",
        f"Table {number}: gains",
        ("law", "gain", "printed", "in use", "", "remark"),
        tuple(rows),
        "In use: laws.toml. Units: % per in, Pa, in/s, in s, in/s², lbf.",
    )


def limits_table() -> PageTable:
    """Table 2-1 beside the geometry."""
    rows = tuple(
        TableRow(
            (
                row.dof,
                f"{row.mechanical:+g} {row.unit}",
                f"{row.operational:+g} {row.unit}",
                f"{row.computed:+.1f} {row.unit}",
                f"{100.0 * row.deviation:+.1f} %",
                row.note,
            ),
            "reported",
        )
        for row in limit_rows()
    )
    return PageTable(
        "table-2-1",
        "Table 2-1: displacement limits",
        ("", "mechanical", "operational", "where a leg reaches ±37.5 in", "deviation", "remark"),
        rows,
        "z down: positive heave lowers. The computed excursion is along one axis from neutral. The "
        "printed limits are used as they are; the deviation is from the mechanical one.",
    )


def _figures(content: Content, prefix: str) -> list[PageFigure]:
    return [
        PageFigure(
            figure.anchor, f"Figure {figure.number}: {figure.title}", figure.draw(content.runs)
        )
        for figure in content.figures
        if figure.number.startswith(prefix)
    ]


def _tables(content: Content, *numbers: str) -> list[PageTable]:
    return [result_table(content.runs, number) for number in numbers if number in content.tables]


def about(content: Content) -> Section:
    """What the page is, and how the plants are read."""
    quick = (
        "Quick version: sweeps of 30 s for 100 s and shorter rounds; bandwidths move by about 2 %."
    )
    lines = [
        "Figures and result tables of Investigation and Development of Control Laws for the NASA "
        "Langley Research Center Cockpit Motion Facility (June 2014), made anew by simulation. "
        "Printed results stand beside ours and enter no computation.",
        "Non-linear model: the report's own plant, six uncoupled legs, with the report set of "
        "hydraulics. Hardware: no recording is available; a simulated stand-in takes its place, "
        "the "
        "hexapod with the Generic Flight Deck and the hardware set, which was calibrated on the "
        "hardware rows of Tables 2-4 and 2-6. Frequency responses go from DCL leg demand to leg "
        "feedback; host and DCU, with their delay, are outside.",
        TOLERANCES,
    ]
    if content.runs.quick:
        lines.append(quick)
    return Section("about", "About this page", tuple(Text(line) for line in lines))


def chapter_2(content: Content) -> Section:
    """Axes, original law, velocity feedback."""
    blocks: list[Block] = [limits_table(), gains_table("2-2"), gains_table("2-5")]
    blocks += [*_tables(content, "2-4", "2-6"), *_figures(content, "2-")]
    return Section("chapter-2", "Chapter 2: the facility and its first laws", tuple(blocks))


def chapter_3(content: Content) -> Section:
    """New compensators."""
    blocks: list[Block] = [gains_table(number) for number in ("3-1", "3-3", "3-4")]
    blocks += [*_tables(content, "section 3.2.2", "3-2", "3-5"), *_figures(content, "3-")]
    return Section("chapter-3", "Chapter 3: new compensators", tuple(blocks))


def chapter_4(content: Content) -> Section:
    """Linear models."""
    blocks: list[Block] = [*_tables(content, "4-1"), *_figures(content, "4-")]
    return Section("chapter-4", "Chapter 4: linear models of the hardware", tuple(blocks))


def appendix_b(content: Content) -> Section:
    """Original and velocity feedback in all degrees of freedom."""
    return Section(
        "appendix-b", "Appendix B: original and velocity feedback", tuple(_figures(content, "B-"))
    )


def appendix_d(content: Content) -> Section:
    """Rate and acceleration feedback in the other degrees of freedom."""
    blocks: list[Block] = [*_tables(content, "D-1", "D-2"), *_figures(content, "D-")]
    return Section("appendix-d", "Appendix D: the other degrees of freedom", tuple(blocks))


SECTIONS: tuple[Callable[[Content], Section], ...] = (
    about,
    chapter_2,
    chapter_3,
    steady_state,
    force_feedback,
    chapter_4,
    text_numbers,
    appendix_b,
    appendix_d,
    ledger,
    calibration,
    parameters,
    provenance,
)
"""The page, in order."""

STUDIES = (steady_state, force_feedback, text_numbers, calibration)
"""Sections shown only with all figures and tables, since they need runs of their own."""
