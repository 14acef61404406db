"""Result tables: printed and computed values side by side, judged by a stated tolerance."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cmf_mj.analysis.frequency_response import bandwidths
from cmf_mj.analysis.limit_cycle import limit_cycle
from cmf_mj.analysis.published import Published, published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.core.result import Field, Result, Table, number
from cmf_mj.core.settings import read_toml
from cmf_mj.report_2014.model_tables import table_4_1
from cmf_mj.report_2014.page.runs import PlantName, Runs, RunSpec
from cmf_mj.studies.case import CaseResult
from cmf_mj.studies.fit.campaign import load_campaign

CONTENTS: Mapping[str, Any] = read_toml(Path(__file__).with_name("contents.toml"))
"""The tables of `contents.toml`."""


class PageTable(NamedTuple):
    """A table of the page."""

    anchor: str
    table: Table


def texts(name: str, **values: Any) -> list[str]:
    """The paragraphs of `contents.toml` by a name, with values put in."""
    return [paragraph.format(**values) for paragraph in CONTENTS["text"][name]]


TABLE_TITLES: dict[str, str] = CONTENTS["results"]  #: Result tables of the report, by number.

PHASE_TOLERANCE, GAIN_TOLERANCE, DAMPING_TOLERANCE = 0.10, 0.12, 0.1
"""Tolerances: relative in -90 deg, in all of the hardware and in -3 dB, absolute in damping."""

(TOLERANCE_TEXT,) = texts(
    "tolerances", phase=100 * PHASE_TOLERANCE, gain=100 * GAIN_TOLERANCE, damping=DAMPING_TOLERANCE
)
"""The tolerances in words."""

BANDWIDTHS, DAMPING_RATIO = ("-90 deg", "-3 dB"), "damping ratio"
"""Quantities that shares of agreement are counted of."""

_NAN = float("nan")
_ROUNDING = 1e-9  #: Of deviations on their way through decimals.
_PLANTS: dict[str, PlantName] = {"hardware": "machine", "nonlinear": "model"}
"""The plant that stands for what a printed row was measured on."""
_SOURCE_TITLES: dict[str, str] = {"hardware": "hardware", "nonlinear": "model"}
_LOOP_QUANTITIES = {"-90 deg": "-90 deg", "-3 dB": "-3 dB", "damping, step": DAMPING_RATIO}
"""Quantities of the linear models, as the other tables name them."""
_REMARKS: dict[tuple[str, str, str], str] = {
    (entry["law"], entry["table"], entry["quantity"]): entry["text"] for entry in CONTENTS["remark"]
}
_FITTED = {
    (statement.law, statement.dof, source, statement.field, statement.value)
    for name, source in (("report", "nonlinear"), ("hardware", "hardware"))
    for statement in load_campaign(name).evidence.statements
    if not statement.held_back
}
"""Printed numbers that the two shipped campaigns fitted, wherever they are printed."""


class PrintedQuantity(NamedTuple):
    """A quantity of the result tables."""

    field: str  #: Of `Published`.
    title: str
    unit: str
    tolerance: float


_QUANTITIES = (
    PrintedQuantity("phase_bandwidth_hz", "-90 deg", "Hz", PHASE_TOLERANCE),
    PrintedQuantity("gain_bandwidth_hz", "-3 dB", "Hz", GAIN_TOLERANCE),
    PrintedQuantity("damping_ratio", DAMPING_RATIO, "", DAMPING_TOLERANCE),
    PrintedQuantity("oscillation_hz", "oscillation", "Hz", PHASE_TOLERANCE),
    PrintedQuantity("acceleration_g", "acceleration, at least", "g", 0.0),
)


class ResultRow(NamedTuple):
    """One printed number and the computed one."""

    law: str  #: As the report names it.
    label: str  #: Law or degree of freedom, or linear model.
    source: str  #: What was measured.
    quantity: str
    unit: str
    printed: float  #: NaN where the report prints N/A.
    computed: float  #: NaN where there is none, and of a law whose step rings on.
    deviation: float  #: Relative, of damping ratios absolute.
    tolerance: float  #: Allowed deviation, likewise.
    within: bool  #: N/A agrees with no crossing alone.
    calibrated: bool  #: Whether a number of ours was fitted to the printed one.
    is_as_read: bool  #: Whether the law is the report's as read here; else its gains as printed.
    stable: bool = True  #: Verdict on the step.
    sweep_value: float = _NAN  #: Bandwidth of the sweep whatever the step does.
    hexapod: float | str = ""
    """The same quantity on the machine's stand-in in tables of Appendix D."""
    note: str = ""


def _deviation_text(row: ResultRow, value: float, sign: str = "+") -> str:
    """A deviation: of a quantity with a unit in %, of others as it is."""
    return number(100.0 * value, f"{sign}.1f %") if row.unit else number(value, f"{sign}.2f")


def _allowed_text(row: ResultRow) -> str:
    """The tolerance, without a decimal that is 0."""
    return _deviation_text(row, row.tolerance, "").replace(".0 %", " %")


def computed_text(row: ResultRow) -> str:
    """What is computed, or why there is no number."""
    if np.isnan(row.computed):
        return "none below 10 Hz" if row.stable else "unstable"
    return number(row.computed, ".2f")


RESULT_FIELDS = (
    Field("label", "law or axis"),
    Field("source"),
    Field("", "quantity", of=lambda row: f"{row.quantity} [{row.unit}]".removesuffix(" []")),
    Field("printed", form=lambda value: "N/A" if np.isnan(value) else f"{value:g}"),
    Field("", "computed", of=computed_text),
    Field("", "deviation", of=lambda row: _deviation_text(row, row.deviation)),
    Field("", "allowed", of=lambda row: _allowed_text(row)),
    Field("within", "verdict", lambda within: "within" if within else "outside"),
    Field("calibrated", "role", lambda fitted: "calibrated" if fitted else "predicted"),
    Field("hexapod", form=".2f"),
    Field("note", "remark"),
)
"""Fields of the result tables; `hexapod` in those of Appendix D alone."""


def _remark(law: str, table: str, quantity: str) -> str:
    return _REMARKS.get((law, table, quantity), _REMARKS.get((law, table, ""), ""))


def _computed(result: CaseResult, quantity: PrintedQuantity) -> float:
    """A quantity of a law, NaN where its step rings on; force feedback is measured in its step."""
    if quantity.field == "oscillation_hz":
        return limit_cycle(result.step).frequency
    if quantity.field == "acceleration_g":
        return float(np.abs(result.step["leg_acceleration"]).max()) / units.STANDARD_GRAVITY
    return float(getattr(result.measures, quantity.field)) if result.measures.stable else _NAN


def _sweep_value(result: CaseResult, quantity: PrintedQuantity, computed: float) -> float:
    """Bandwidth of the sweep, of other quantities what is computed from both."""
    if quantity.field in ("oscillation_hz", "acceleration_g"):
        return _NAN
    if quantity.title not in BANDWIDTHS or result.response is None:
        return computed
    widths = bandwidths(result.response)
    return widths.phase_hz if quantity.title == "-90 deg" else widths.gain_hz


def _is_calibrated(row: Published, quantity: PrintedQuantity, printed: float) -> bool:
    """Whether a number of ours was fitted to a printed one, NaN for N/A."""
    if row.read_as not in (row.law, row.printed_as):  # its gain is derived from this row
        return not np.isnan(printed) and quantity.title in BANDWIDTHS
    return (row.law, row.dof, row.of, quantity.field, printed) in _FITTED


def _hexapod_value(runs: Runs, row: Published, quantity: PrintedQuantity) -> float | str:
    """A quantity on the machine's stand-in, for the column of Appendix D."""
    measures = runs.case("machine", row.read_as, row.dof).measures
    return float(getattr(measures, quantity.field)) if measures.stable else "unstable"


def _is_in_appendix_d(table: str) -> bool:
    return table.startswith("D-")


def _label(row: Published, law: str) -> str:
    """Law, or in Appendix D degree of freedom, with the law where its gains are as printed."""
    title = load_law(law).title
    if not _is_in_appendix_d(row.table):
        return title
    return row.dof if law == row.read_as else f"{row.dof}, {title}"


def _result_row(runs: Runs, row: Published, law: str, quantity: PrintedQuantity) -> ResultRow:
    """A number of a printed row beside that of a law."""
    result, is_as_read = runs.case(_PLANTS[row.of], law, row.dof), law == row.read_as
    value, stable = getattr(row, quantity.field), result.measures.stable
    printed = _NAN if value is None else float(value)
    computed = _computed(result, quantity)
    sweep_value = _sweep_value(result, quantity, computed)
    deviation = computed - printed if quantity.title == DAMPING_RATIO else computed / printed - 1.0
    is_hardware_bandwidth = row.of == "hardware" and quantity.unit == "Hz"
    tolerance = PHASE_TOLERANCE if is_hardware_bandwidth else quantity.tolerance
    within = abs(deviation) <= tolerance + _ROUNDING
    if value is None:
        within = stable and np.isnan(computed)
    elif quantity.field == "acceleration_g":
        within = deviation >= 0.0
    note = "" if within else _remark(row.law, row.table, quantity.title)
    if not (stable or note) and not np.isnan(sweep_value):
        note = f"the step rings on; its sweep has {sweep_value:.2f} Hz all the same"
    has_hexapod = _is_in_appendix_d(row.table) and is_as_read
    return ResultRow(
        law=row.law,
        label=_label(row, law),
        source=_SOURCE_TITLES[row.of],
        quantity=quantity.title,
        unit=quantity.unit,
        printed=printed,
        computed=computed,
        deviation=deviation,
        tolerance=tolerance,
        within=bool(within),
        calibrated=is_as_read and _is_calibrated(row, quantity, printed),
        is_as_read=is_as_read,
        stable=stable,
        sweep_value=sweep_value,
        hexapod=_hexapod_value(runs, row, quantity) if has_hexapod else "",
        note=note,
    )


@cache
def _linear_rows() -> tuple[ResultRow, ...]:
    """Table 4-1 around the report's linear models, damping read as everywhere else."""
    rows = []
    for row in table_4_1():
        if row.quantity not in _LOOP_QUANTITIES:
            continue
        quantity, has_unit = _LOOP_QUANTITIES[row.quantity], row.unit != "1"
        scale = row.published if has_unit else 1.0
        linear_row = ResultRow(
            law="velocity",
            label=f"linear model #{row.model}",
            source=f"Eq {row.equation}",
            quantity=quantity,
            unit=row.unit if has_unit else "",
            printed=row.published,
            computed=row.computed,
            deviation=row.deviation / scale,
            tolerance=row.tolerance / scale,
            within=row.within,
            calibrated=False,
            is_as_read=True,
            sweep_value=row.computed,
            note="" if row.within else _remark("velocity", "4-1", quantity),
        )
        rows.append(linear_row)
    return tuple(rows)


def _compared_laws(table: str) -> list[tuple[Published, str]]:
    """Printed rows of a table, each with the law as read and, if that differs, as printed."""
    rows = [row for row in published_results() if row.table == table and row.of in _PLANTS]
    return [(row, law) for row in rows for law in dict.fromkeys((row.read_as, row.printed_as))]


def table_needs(table: str) -> tuple[RunSpec, ...]:
    """Runs a result table is made from."""
    rows = _compared_laws(table)
    needs = [RunSpec(_PLANTS[row.of], law, row.dof) for row, law in rows]
    if _is_in_appendix_d(table):
        needs += [RunSpec("machine", row.read_as, row.dof) for row, _ in rows]
    return tuple(dict.fromkeys(needs))


def result_rows(runs: Runs, table: str) -> list[ResultRow]:
    """All rows of a result table; a quantity that its printed row lacks has none."""
    rows = list(_linear_rows()) if table == "4-1" else []
    for row, law in _compared_laws(table):
        for quantity in _QUANTITIES:
            is_printed = getattr(row, quantity.field) is not None
            if is_printed or quantity.field in row.not_available:
                rows.append(_result_row(runs, row, law, quantity))
    return rows


def result_table(runs: Runs, name: str) -> PageTable:
    """A result table as the page has it."""
    number = name.capitalize() if name.startswith("section") else f"Table {name}"
    has_hexapod = _is_in_appendix_d(name)
    fields = [field for field in RESULT_FIELDS if has_hexapod or field.name != "hexapod"]
    title = f"{number}: {TABLE_TITLES[name]}"
    result = Result(result_rows(runs, name), fields, title, TOLERANCE_TEXT)
    return PageTable(f"table-{name.replace(' ', '-')}", result.table)
