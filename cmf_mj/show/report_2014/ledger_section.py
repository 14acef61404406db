"""Sections on what the print has wrong and on what was fitted to it."""

from cmf_mj.analysis.ledger import load_ledger
from cmf_mj.show.ledger import figures_text
from cmf_mj.show.report_2014.blocks import Content, PageTable, Section, TableRow, Text, Verdict
from cmf_mj.show.report_2014.curves import law_title
from cmf_mj.show.report_2014.runs import HYDRAULICS, On, Runs, Wanted
from cmf_mj.studies.calibration.definition import Study, load_studies
from cmf_mj.studies.calibration.fit import residual_rows
from cmf_mj.studies.calibration.trial import Measured, starting_values

_PLANTS: dict[str, On] = {name: on for on, name in HYDRAULICS.items()}
_MEASURES = {"phase": "-90 deg [Hz]", "gain": "-3 dB [Hz]", "damping": "damping ratio"}

CALIBRATION_NEEDS: tuple[Wanted, ...] = tuple(
    Wanted(_PLANTS[study.hydraulics], law)
    for study in load_studies().values()
    if study.hydraulics in _PLANTS
    for law in study.laws
)
"""Runs that the residuals are read from."""


def ledger(content: Content) -> Section:
    """Misprints and contradictions."""
    rows = tuple(
        TableRow(
            (
                f"{entry.number}. {entry.title}",
                entry.where,
                entry.printed,
                entry.finding,
                figures_text(entry),
                entry.project,
            )
        )
        for entry in load_ledger()
    )
    table = PageTable(
        "ledger-table",
        "What the report contradicts, in itself or in nature",
        ("what", "where", "printed", "finding", "figures", "here"),
        rows,
        "Each entry is shown in numbers by a test of its own: docs/ledger.md.",
    )
    return Section("ledger", "Misprints and contradictions", (table,))


def _results(runs: Runs, study: Study) -> dict[str, Measured]:
    found = {}
    for law in study.laws:
        result = runs.case(_PLANTS[study.hydraulics], law)
        widths, metrics = result.bandwidths, result.metrics
        found[law] = Measured(
            widths.phase_hz, widths.gain_hz, metrics.damping_ratio, metrics.stable
        )
    return found


def _parameters(study: Study) -> PageTable:
    values = starting_values(study)
    rows = tuple(
        TableRow(
            (
                p.name.replace("_", " "),
                "fitted" if p.free else "held",
                f"{values[p.name]:g} {'' if p.unit == '1' else p.unit}",
                f"{p.low:g} to {p.high:g}",
                p.source,
            )
        )
        for p in study.parameters
    )
    return PageTable(
        f"calibration-{study.name}-parameters",
        f"{study.name.capitalize()} set: parameters",
        ("parameter", "", "shipped", "range", "why this range"),
        rows,
    )


def _residuals(runs: Runs, study: Study) -> PageTable:
    rows = []
    for row in residual_rows(study, _results(runs, study)):
        relative = row.measure != "damping"
        verdict: Verdict = "within" if row.within else "outside"
        off = f"{100.0 * row.deviation:+.1f} %" if relative else f"{row.deviation:+.2f}"
        rows.append(
            TableRow(
                (
                    f"{row.table}, {law_title(row.law)}",
                    _MEASURES[row.measure],
                    row.role,
                    f"{row.printed:g}",
                    f"{row.computed:.2f}",
                    off,
                    verdict,
                ),
                verdict,
            )
        )
    return PageTable(
        f"calibration-{study.name}-residuals",
        f"{study.name.capitalize()} set: residuals at the shipped values",
        ("table, law", "quantity", "role", "printed", "computed", "deviation", "verdict"),
        tuple(rows),
    )


def calibration(content: Content) -> Section:
    """What was fitted to which printed numbers, and what was held back."""
    studies = [study for study in load_studies().values() if study.hydraulics in _PLANTS]
    text = Text(
        "Two numbers of each set were fitted to printed results; all others are stated, derived or "
        "assumed. Fitted rows were made to agree; only the predicted rows test the model. "
        "Deviations here are judged alike for every law, force and combined rate feedback too. "
        "`cmf calibrate` repeats the fit and says what each result owes to each parameter."
    )
    tables = tuple(
        table
        for study in studies
        for table in (_parameters(study), _residuals(content.runs, study))
    )
    return Section("calibration", "Calibration: what was fitted, what predicted", (text, *tables))
