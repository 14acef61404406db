"""The sections of the page: `contents.toml` names their blocks, and each name is a function here.

A new section is an entry there; a new kind of block is a function and its entry in `BLOCKS`.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version

from cmf_mj.core.table import number
from cmf_mj.report_2014.page import summary
from cmf_mj.report_2014.page.curves import (
    CONTENTS,
    VERDICTS,
    Block,
    Content,
    PageTable,
    Section,
    table,
    texts,
)
from cmf_mj.report_2014.page.runs import CAB, HYDRAULICS, PLANTS, On, Runs, hydraulics_of, plant_of
from cmf_mj.report_2014.page.statements import statement_rows
from cmf_mj.report_2014.page.tables import (
    TITLES,
    TOLERANCES,
    ResultRow,
    gain_rows,
    limit_rows,
    result_rows,
)
from cmf_mj.show.listing import parameter_table


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
    shown = parameter_table(hydraulics_of(on))
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
