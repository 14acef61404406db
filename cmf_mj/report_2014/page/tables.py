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
from cmf_mj.report_2014.page.runs import On, Runs, RunSpec
from cmf_mj.studies.case import CaseResult
from cmf_mj.studies.fit.campaign import load_campaign

CONTENTS: Mapping[str, Any] = read_toml(Path(__file__).with_name("contents.toml"))
"""The tables of `contents.toml`."""


class PageTable(NamedTuple):
    """A table of the page; the verdict of a row stands in the column of this name."""

    anchor: str
    table: Table


def texts(name: str, **values: Any) -> list[str]:
    """The paragraphs of this name."""
    return [paragraph.format(**values) for paragraph in CONTENTS["text"][name]]


TITLES: dict[str, str] = CONTENTS["results"]  #: Result tables of the report, by number.

PHASE, GAIN, DAMPING = 0.10, 0.12, 0.1
"""Tolerances: relative in -90 deg, in all of the hardware and in -3 dB, absolute in damping."""

(TOLERANCES,) = texts("tolerances", phase=100 * PHASE, gain=100 * GAIN, damping=DAMPING)
"""The tolerances in words."""

BANDWIDTHS, RATIO = ("-90 deg", "-3 dB"), "damping ratio"
"""Quantities that shares of agreement are counted of."""

_NAN = float("nan")
_ON: dict[str, On] = {"hardware": "machine", "nonlinear": "model"}
_OF = {"hardware": "hardware", "nonlinear": "model"}
_LOOP_QUANTITIES = {"-90 deg": "-90 deg", "-3 dB": "-3 dB", "damping, step": RATIO}
_REMARKS: dict[tuple[str, str, str], str] = {
    (entry["law"], entry["table"], entry["quantity"]): entry["text"] for entry in CONTENTS["remark"]
}
_FITTED = {
    (one.at[0], one.at[1], of, one.field, one.value)
    for name, of in (("report", "nonlinear"), ("hardware", "hardware"))
    for one in load_campaign(name).evidence.statements
    if not one.held_back
}
"""Printed numbers that the two shipped campaigns fitted, wherever they are printed."""


class PrintedQuantity(NamedTuple):
    """A quantity of the result tables."""

    field: str  #: Of `Published`.
    title: str
    unit: str
    tolerance: float


_QUANTITIES = (
    PrintedQuantity("phase_bandwidth_hz", "-90 deg", "Hz", PHASE),
    PrintedQuantity("gain_bandwidth_hz", "-3 dB", "Hz", GAIN),
    PrintedQuantity("damping_ratio", RATIO, "", DAMPING),
    PrintedQuantity("oscillation_hz", "oscillation", "Hz", PHASE),
    PrintedQuantity("acceleration_g", "acceleration, at least", "g", 0.0),
)


class ResultRow(NamedTuple):
    """One printed number and the computed one."""

    law: str  #: As the report names it.
    label: str  #: Law or degree of freedom, or linear model.
    of: str  #: What was measured.
    quantity: str
    unit: str
    printed: float  #: NaN where the report prints N/A.
    computed: float  #: NaN where there is none, and of a law whose step rings on.
    deviation: float  #: Relative, of damping ratios absolute.
    tolerance: float  #: Allowed deviation, likewise.
    within: bool  #: N/A agrees with no crossing alone.
    calibrated: bool  #: Whether a number of ours was fitted to the printed one.
    read: bool  #: Whether the law is the report's as read here; False for its gains as printed.
    stable: bool = True  #: Verdict on the step.
    swept: float = _NAN  #: Bandwidth of the sweep whatever the step does.
    hexapod: float | str = ""
    """The same quantity on the machine's stand-in in tables of Appendix D."""
    note: str = ""


def _share(row: ResultRow, value: float, sign: str = "+") -> str:
    """A deviation: of a quantity with a unit in %, of others as it is."""
    return number(100.0 * value, f"{sign}.1f %") if row.unit else number(value, f"{sign}.2f")


def computed_text(row: ResultRow) -> str:
    """What is computed, or why there is no number."""
    if np.isnan(row.computed):
        return "none below 10 Hz" if row.stable else "unstable"
    return number(row.computed, ".2f")


RESULTS = (
    Field("label", "law or axis"),
    Field("of", "source"),
    Field("", "quantity", of=lambda row: f"{row.quantity} [{row.unit}]".removesuffix(" []")),
    Field("printed", form=lambda value: f"{value:g}" if value == value else "N/A"),
    Field("", "computed", of=computed_text),
    Field("", "deviation", of=lambda row: _share(row, row.deviation)),
    Field("", "allowed", of=lambda row: _share(row, row.tolerance, "").replace(".0 %", " %")),
    Field("within", "verdict", lambda within: "within" if within else "outside"),
    Field("calibrated", "role", lambda fitted: "calibrated" if fitted else "predicted"),
    Field("hexapod", form=".2f"),
    Field("note", "remark"),
)
"""Columns of the result tables; `hexapod` in those of Appendix D alone."""


def _remark(law: str, table: str, quantity: str) -> str:
    return _REMARKS.get((law, table, quantity), _REMARKS.get((law, table, ""), ""))


def _computed(result: CaseResult, quantity: PrintedQuantity) -> tuple[float, float]:
    """A quantity of a law, NaN where its step rings on, and that of its sweep in any case."""
    stable, field = result.measures.stable, quantity.field
    if field == "oscillation_hz":
        return limit_cycle(result.step).frequency, _NAN
    if field == "acceleration_g":
        largest = float(np.abs(result.step["leg_acceleration"]).max())
        return largest / units.STANDARD_GRAVITY, _NAN
    value = float(getattr(result.measures, field)) if stable else _NAN
    swept = value
    if quantity.title in BANDWIDTHS and result.response is not None:
        widths = bandwidths(result.response)
        swept = widths.phase_hz if quantity.title == "-90 deg" else widths.gain_hz
    return value, swept


def _judged(runs: Runs, row: Published, law: str) -> list[ResultRow]:
    """The numbers of a printed row beside those of a law."""
    rows = []
    appendix, read = row.table.startswith("D-"), law == row.read_as
    title = load_law(law).title
    label = title if not appendix else row.dof if read else f"{row.dof}, {title}"
    result = runs.case(_ON[row.of], law, row.dof)
    machine = runs.case("machine", law, row.dof).measures if appendix and read else None
    for quantity in _QUANTITIES:
        value = getattr(row, quantity.field)
        if value is None and quantity.field not in row.not_available:
            continue
        printed = _NAN if value is None else float(value)
        computed, swept = _computed(result, quantity)
        off = computed - printed if quantity.title == RATIO else computed / printed - 1.0
        allowed = PHASE if row.of == "hardware" and quantity.unit == "Hz" else quantity.tolerance
        within, stable = abs(off) <= allowed + 1e-9, result.measures.stable
        if value is None:
            within = stable and np.isnan(computed)
        elif quantity.field == "acceleration_g":
            within = off >= 0.0
        hexapod: float | str = ""
        if machine is not None:
            ours = float(getattr(machine, quantity.field))
            hexapod = ours if machine.stable else "unstable"
        fitted = (row.law, row.dof, row.of, quantity.field, printed) in _FITTED
        if row.read_as not in (row.law, row.printed_as):  # its gain is derived from this row
            fitted = value is not None and quantity.title in BANDWIDTHS
        note = "" if within else _remark(row.law, row.table, quantity.title)
        if not (stable or note) and swept == swept:
            note = f"the step rings on; its sweep has {swept:.2f} Hz all the same"
        of_what = (row.law, label, _OF[row.of], quantity.title, quantity.unit)
        judged = ResultRow(*of_what, printed, computed, off, allowed, bool(within), False, read)
        judged = judged._replace(calibrated=fitted and read, stable=stable, swept=swept)
        rows.append(judged._replace(hexapod=hexapod, note=note))
    return rows


@cache
def _linear_rows() -> tuple[ResultRow, ...]:
    """Table 4-1 around the report's linear models, damping read as everywhere else."""
    rows = []
    for row in table_4_1():
        if row.quantity not in _LOOP_QUANTITIES:
            continue
        unit, scale = ("", 1.0) if row.unit == "1" else ("Hz", row.published)
        quantity = _LOOP_QUANTITIES[row.quantity]
        note = "" if row.within else _remark("velocity", "4-1", quantity)
        of_what = ("velocity", f"linear model #{row.model}", f"Eq {row.equation}", quantity, unit)
        off = (row.deviation / scale, row.tolerance / scale, row.within)
        judged = ResultRow(*of_what, row.published, row.computed, *off, False, True)
        rows.append(judged._replace(swept=row.computed, note=note))
    return tuple(rows)


def _readings(table: str) -> list[tuple[Published, str]]:
    """Printed rows of a table, each with the law as read and, if that differs, as printed."""
    rows = [row for row in published_results() if row.table == table and row.of in _ON]
    return [(row, law) for row in rows for law in dict.fromkeys((row.read_as, row.printed_as))]


def table_needs(table: str) -> tuple[RunSpec, ...]:
    """Runs a result table is made from."""
    rows = _readings(table)
    needs = [RunSpec(_ON[row.of], law, row.dof) for row, law in rows]
    if table.startswith("D-"):
        needs += [RunSpec("machine", row.read_as, row.dof) for row, _ in rows]
    return tuple(dict.fromkeys(needs))


def result_rows(runs: Runs, table: str) -> list[ResultRow]:
    """All rows of a result table."""
    rows = list(_linear_rows()) if table == "4-1" else []
    return rows + [result for row, law in _readings(table) for result in _judged(runs, row, law)]


def result_table(runs: Runs, name: str) -> PageTable:
    """A result table as the page has it."""
    appendix = name.startswith("D-")
    title = f"Table {name}" if name[0] != "s" else name.capitalize()
    fields = [field for field in RESULTS if appendix or field.name != "hexapod"]
    shown = Result(result_rows(runs, name), fields, f"{title}: {TITLES[name]}", TOLERANCES).table
    return PageTable(f"table-{name.replace(' ', '-')}", shown)
