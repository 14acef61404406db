"""The sections of the page: `contents.toml` names their blocks, and each name is a function here.

A new section is an entry there; a new kind of block is a function and its entry in `BLOCKS`.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version

from cmf_mj.analysis.ledger import load_ledger
from cmf_mj.show.listing import figures_text
from cmf_mj.show.report_2014 import force, summary
from cmf_mj.show.report_2014.curves import (
    CONTENTS,
    VERDICTS,
    Block,
    Content,
    PageTable,
    Section,
    table,
    texts,
)
from cmf_mj.show.report_2014.runs import CAB, HYDRAULICS, PLANTS, Runs, plant_of
from cmf_mj.show.report_2014.statements import rest_rows, statement_rows
from cmf_mj.show.report_2014.tables import (
    TITLES,
    TOLERANCES,
    ResultRow,
    gain_rows,
    limit_rows,
    result_rows,
)
from cmf_mj.show.table import number
from cmf_mj.studies.calibration.trial import Study, load_studies, starting_values


def provenance(runs: Runs) -> PageTable:
    """What made the page: models, versions, seed."""
    packages = ("cmf-mj", "mujoco", "numpy", "scipy", "numba", "control")
    rows = [
        *(("seed", str(runs.seed)), ("cab of the hexapod", CAB.upper())),
        *((f"model digest, {name}", plant_of(on).digest) for on, name in PLANTS.items()),
        *((f"version, {name}", version(name)) for name in packages),
    ]
    return table("provenance-table", rows)


_STUDIES = tuple(s for s in load_studies().values() if s.hydraulics in HYDRAULICS.values())


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


def _gains(content: Content, number: str) -> list[PageTable]:
    """A gain table and the shipped law."""
    rows = [
        (
            *(row.law, row.gain, row.printed if row.printed == row.printed else "not printed here"),
            *(row.shipped, "same" if row.same else "differs", row.note),
        )
        for row in gain_rows()
        if row.table == number
    ]
    return [table("gains", rows, f"table-{number}", f"Table {number}: gains")]


def _limits(content: Content, argument: str) -> list[PageTable]:
    """Table 2-1 and the geometry."""
    rows = [
        (
            *(r.dof, f"{r.mechanical:+g} {r.unit}", f"{r.operational:+g} {r.unit}"),
            *(f"{r.computed:+.1f} {r.unit}", 100.0 * r.deviation, r.note),
        )
        for r in limit_rows()
    ]
    return [table("table-2-1", rows)]


def _ledger(content: Content, argument: str) -> list[PageTable]:
    """Misprints and contradictions."""
    rows = [
        (
            f"{entry.number}. {entry.title}",
            *(entry.where, entry.printed, entry.finding, figures_text(entry), entry.project),
        )
        for entry in load_ledger()
    ]
    return [table("ledger-table", rows)]


def _fitted(study: Study) -> PageTable:
    values = starting_values(study)
    rows = [
        (
            *(p.name.replace("_", " "), "fitted" if p.free else "held"),
            number(values[p.name], "g" if p.unit == "1" else f"g {p.unit}"),
            *(f"{p.low:g} to {p.high:g}", p.source),
        )
        for p in study.parameters
    ]
    title = f"{study.name.capitalize()} set: parameters".replace("_", " ")
    return table("calibration-parameters", rows, f"calibration-{study.name}-parameters", title)


BLOCKS: Mapping[str, Callable[[Content, str], Sequence[Block]]] = {
    "about": lambda content, _: [
        *texts("about"),
        *(texts("quick") if content.runs.quick else []),
        *summary.verdict_tables(content),
    ],
    "summary": summary.blocks,
    "text": lambda content, name: texts(name),
    "limits": _limits,
    "gains": _gains,
    "results": _results,
    "figures": lambda content, prefix: [
        figure.draw(content.runs) for figure in content.figures if figure.number.startswith(prefix)
    ],
    "steady_states": lambda content, _: [table("steady-states", rest_rows(content.runs))],
    "statements": lambda content, _: [table("text-numbers", statement_rows(content.runs))],
    "force": lambda content, _: force.blocks(content.runs),
    "ledger": _ledger,
    "calibration": lambda content, _: [_fitted(study) for study in _STUDIES],
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
