"""Blocks on what the print has wrong and on what was fitted to it."""

from cmf_mj.analysis.ledger import load_ledger
from cmf_mj.show.listing import figures_text
from cmf_mj.show.report_2014.contents import VERDICTS, Block, PageTable, TableRow, table
from cmf_mj.show.report_2014.curves import law_title
from cmf_mj.show.report_2014.runs import HYDRAULICS, On, Runs, RunSpec
from cmf_mj.studies.calibration.definition import Study, load_studies
from cmf_mj.studies.calibration.fit import residual_rows
from cmf_mj.studies.calibration.trial import starting_values

_PLANTS: dict[str, On] = {name: on for on, name in HYDRAULICS.items()}
_STUDIES = tuple(study for study in load_studies().values() if study.hydraulics in _PLANTS)
_MEASURES = {"phase": "-90 deg [Hz]", "gain": "-3 dB [Hz]", "damping": "damping ratio"}

CALIBRATION_NEEDS = tuple(
    RunSpec(_PLANTS[study.hydraulics], law) for study in _STUDIES for law in study.laws
)
"""Runs that the residuals are read from."""


def ledger_table() -> PageTable:
    """Misprints and contradictions."""
    rows = [
        (
            f"{entry.number}. {entry.title}",
            *(entry.where, entry.printed, entry.finding, figures_text(entry), entry.project),
        )
        for entry in load_ledger()
    ]
    return table("ledger-table", rows)


def _parameters(study: Study) -> PageTable:
    values = starting_values(study)
    rows = [
        (
            p.name.replace("_", " "),
            "fitted" if p.free else "held",
            f"{values[p.name]:g} {'' if p.unit == '1' else p.unit}",
            f"{p.low:g} to {p.high:g}",
            p.source,
        )
        for p in study.parameters
    ]
    title = f"{study.name.capitalize()} set: parameters"
    anchor = f"calibration-{study.name}-parameters"
    return table("calibration-parameters", rows, anchor=anchor, title=title)


def _residuals(runs: Runs, study: Study) -> PageTable:
    on, rows = _PLANTS[study.hydraulics], []
    measures = {law: runs.case(on, law).measures for law in study.laws}
    for row in residual_rows(study, measures):
        relative, verdict = row.measure != "damping", VERDICTS[row.within]
        cells = (
            f"{row.table}, {law_title(row.law)}",
            _MEASURES[row.measure],
            row.role,
            f"{row.printed:g}",
            f"{row.computed:.2f}",
            f"{100.0 * row.deviation:+.1f} %" if relative else f"{row.deviation:+.2f}",
            verdict,
        )
        rows.append(TableRow(cells, verdict))
    title = f"{study.name.capitalize()} set: residuals at the shipped values"
    anchor = f"calibration-{study.name}-residuals"
    return table("calibration-residuals", rows, anchor=anchor, title=title)


def calibration(runs: Runs) -> list[Block]:
    """What was fitted to which printed numbers, and what was only predicted."""
    return [block for study in _STUDIES for block in (_parameters(study), _residuals(runs, study))]
