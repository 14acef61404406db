"""The sections of the page: `contents.toml` names their blocks, and each name is a function here.

A new section is an entry there; a new kind of block is a function and its entry in `BLOCKS`.
"""

from collections.abc import Callable, Mapping, Sequence

from cmf_mj.show.report_2014 import force, ledger_section, provenance
from cmf_mj.show.report_2014.contents import (
    CONTENTS,
    VERDICTS,
    Block,
    Content,
    PageFigure,
    PageTable,
    Section,
    TableRow,
    Text,
    table,
    texts,
)
from cmf_mj.show.report_2014.runs import Runs
from cmf_mj.show.report_2014.statements import rest_rows, statements
from cmf_mj.show.report_2014.tables import (
    TITLES,
    TOLERANCES,
    ResultRow,
    gain_rows,
    limit_rows,
    printed_number,
    result_rows,
)


def result_table(runs: Runs, name: str) -> PageTable:
    """A result table as the page has it; a long remark is written once."""
    appendix = name.startswith("D-")
    seen: set[str] = set()
    rows = []
    for row in result_rows(runs, name):
        again = len(row.note) > 40 and row.note in seen
        seen.add(row.note)
        rows.append(_result_cells(row._replace(note="as above") if again else row, appendix))
    title = f"Table {name}" if name[0] != "s" else name.capitalize()
    return table(
        "results-hexapod" if appendix else "results",
        rows,
        anchor=f"table-{name.replace(' ', '-')}",
        title=f"{title}: {TITLES[name]}",
        note=TOLERANCES,
    )


def _result_cells(row: ResultRow, appendix: bool) -> TableRow:
    relative = row.unit == "Hz"

    def share(value: float, sign: str) -> str:
        if value != value:
            return "–"
        return f"{100.0 * value:{sign}.1f} %" if relative else f"{value:{sign}.2f}"

    verdict = VERDICTS[row.within]
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


def _results(content: Content, number: str) -> list[PageTable]:
    return [result_table(content.runs, number)] if number in content.tables else []


def _gains(content: Content, number: str) -> list[PageTable]:
    """A gain table and the shipped law."""
    rows = []
    for row in gain_rows():
        if row.table == number:
            verdict = VERDICTS[True if row.same else None if row.note else False]
            printed = "not printed here" if row.printed != row.printed else f"{row.printed:g}"
            same = "same" if row.same else "differs"
            cells = (row.law, row.gain, printed, f"{row.shipped:g}", same, row.note)
            rows.append(TableRow(cells, verdict))
    return [table("gains", rows, anchor=f"table-{number}", title=f"Table {number}: gains")]


def _limits(content: Content, argument: str) -> list[PageTable]:
    """Table 2-1 and the geometry."""
    rows = [
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
    ]
    return [table("table-2-1", rows)]


def _figures(content: Content, prefix: str) -> list[PageFigure]:
    return [
        PageFigure(f"figure-{f.number}", f"Figure {f.number}: {f.title}", f.draw(content.runs))
        for f in content.figures
        if f.number.startswith(prefix)
    ]


def _about(content: Content, argument: str) -> list[Text]:
    """What the page is, and how the plants are read."""
    quick = texts("quick") if content.runs.quick else []
    return [*texts("about"), Text(TOLERANCES), *quick]


def _steady_states(content: Content, argument: str) -> list[PageTable]:
    """The velocity law's offset, and the integral that removes it."""
    rows = [
        (row.law, row.formula or "integral", *(f"{value:.3f}" for value in row[2:]))
        for row in rest_rows(content.runs)
    ]
    return [table("steady-states", rows)]


def _statements(content: Content, argument: str) -> list[PageTable]:
    rows = [
        (
            *(s.section, s.what, f"{s.printed} {s.unit}"),
            *(f"{printed_number(s.computed)} {s.unit}", s.remark),
        )
        for s in statements(content.runs)
    ]
    return [table("text-numbers", rows)]


BLOCKS: Mapping[str, Callable[[Content, str], Sequence[Block]]] = {
    "about": _about,
    "text": lambda content, name: texts(name),
    "limits": _limits,
    "gains": _gains,
    "results": _results,
    "figures": _figures,
    "steady_states": _steady_states,
    "statements": _statements,
    "force": lambda content, _: force.blocks(content.runs),
    "ledger": lambda content, _: [ledger_section.ledger_table()],
    "calibration": lambda content, _: ledger_section.calibration(content.runs),
    "parameters": lambda content, _: provenance.parameters(),
    "provenance": lambda content, _: [provenance.provenance(content.runs)],
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
