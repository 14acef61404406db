"""Result tables: printed and computed values side by side, judged by a stated tolerance."""

from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.linear.table_4_1 import table_4_1
from cmf_mj.analysis.published import Published, published_gains, published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.machine.kinematics import DOFS, excursion_envelope
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.show.report_2014.contents import CONTENTS, texts
from cmf_mj.show.report_2014.curves import law_title
from cmf_mj.show.report_2014.runs import On, Runs, RunSpec

TITLES: dict[str, str] = CONTENTS["results"]
"""Result tables of the report, by number."""

PHASE, GAIN, DAMPING, HARDWARE = 0.10, 0.15, 0.1, 0.10
"""Tolerances: relative in -90 deg and -3 dB of non-linear rows, absolute in damping ratio, relative
in both bandwidths of hardware rows."""

(TOLERANCES,) = texts(
    "tolerances", phase=100 * PHASE, gain=100 * GAIN, hardware=100 * HARDWARE, damping=DAMPING
)
"""The tolerances in words."""

REPORTED = ("combined_rate", "force")
"""Laws whose rows are reported without a verdict."""

_NAN = float("nan")
_ON: dict[str, On] = {"hardware": "machine", "nonlinear": "model"}
_OF = {"hardware": "hardware", "nonlinear": "non-linear model"}
_QUANTITIES = (
    ("phase_bandwidth_hz", "-90 deg", "Hz", PHASE),
    ("gain_bandwidth_hz", "-3 dB", "Hz", GAIN),
    ("damping_ratio", "damping ratio", "", DAMPING),
)
_REMARKS: dict[tuple[str, str, str], str] = {
    (entry["law"], entry["table"], entry["quantity"]): entry["text"] for entry in CONTENTS["remark"]
}


class ResultRow(NamedTuple):
    """One printed number and the computed one."""

    label: str  #: Law or degree of freedom, or linear model.
    of: str  #: What was measured.
    quantity: str
    unit: str
    printed: float  #: NaN where the report prints N/A.
    computed: float
    deviation: float  #: Relative, of damping ratios absolute.
    tolerance: float  #: Allowed deviation, likewise; NaN for what is only reported.
    within: bool | None  #: None for what is only reported.
    hexapod: float
    """The same quantity on the machine's stand-in in tables of Appendix D; else, and of damping
    where the legs ring on undiminished, NaN."""
    note: str


def _remark(law: str, table: str, quantity: str) -> str:
    return _REMARKS.get((law, table, quantity), _REMARKS.get((law, table, ""), ""))


def _judged(runs: Runs, row: Published) -> list[ResultRow]:
    rows = []
    appendix = row.table.startswith("D-")
    label = row.dof if appendix else law_title(row.read_as)
    measures = runs.case(_ON[row.of], row.read_as, row.dof).measures
    machine = runs.case("machine", row.read_as, row.dof).measures if appendix else None
    for field, quantity, unit, tolerance in _QUANTITIES:
        value, damping = getattr(row, field), field == "damping_ratio"
        if value is None and (row.table, quantity) != ("D-2", "-3 dB"):
            continue
        printed, computed = _NAN if value is None else value, float(getattr(measures, field))
        deviation = computed - printed if damping else (computed - printed) / printed
        judged = value is not None and row.law not in REPORTED
        if row.of == "hardware" and not damping:
            tolerance = HARDWARE
        # Round-off of the subtraction is no deviation.
        within = bool(abs(deviation) <= tolerance + 1e-9) if judged else None
        note = "" if within else _remark(row.law, row.table, quantity)
        if damping and not note and not measures.stable:
            note = "of the first overshoot; the legs then ring on undiminished"
        known = machine is not None and (machine.stable or not damping)
        hexapod = float(getattr(machine, field)) if known else _NAN
        rows.append(
            ResultRow(
                *(label, _OF[row.of], quantity, unit, printed, computed, deviation),
                *(tolerance if judged else _NAN, within, hexapod, note),
            )
        )
    return rows


def _linear_rows() -> list[ResultRow]:
    rows = []
    for row in table_4_1():
        unit, scale = ("", 1.0) if row.unit == "1" else ("Hz", row.published)
        note = "the report does not say how it read the damping ratio; the peak fits all three"
        rows.append(
            ResultRow(
                *(f"linear model #{row.model}", f"Eq {row.equation}", row.quantity, unit),
                *(row.published, row.computed, row.deviation / scale, row.tolerance / scale),
                *(row.within, _NAN, "" if row.within else note),
            )
        )
    return rows


def _rows_of(table: str) -> list[Published]:
    return [row for row in published_results() if row.table == table and row.of in _ON]


def table_needs(table: str) -> tuple[RunSpec, ...]:
    """Runs a result table is made from."""
    rows = _rows_of(table)
    needs = [RunSpec(_ON[row.of], row.read_as, row.dof) for row in rows]
    if table.startswith("D-"):
        needs += [RunSpec("machine", row.read_as, row.dof) for row in rows]
    return tuple(dict.fromkeys(needs))


def result_rows(runs: Runs, table: str) -> list[ResultRow]:
    """All rows of a result table."""
    rows = _linear_rows() if table == "4-1" else []
    return rows + [result for row in _rows_of(table) for result in _judged(runs, row)]


class GainRow(NamedTuple):
    """One printed gain and the shipped one."""

    table: str
    law: str
    gain: str  #: Matrix and signal.
    printed: float
    shipped: float
    same: bool
    note: str


def gain_rows() -> list[GainRow]:
    """Tables 2-2, 2-5, 3-1, 3-3 and 3-4 and the laws in use."""
    rows = []
    for entry in published_gains():
        law = load_law(entry.law)
        b, d = (
            [
                (f"{matrix}, {name.replace('_', ' ')}", value, getattr(gains, name))
                for name, value in zip(entry.signals, values, strict=True)
            ]
            for matrix, values, gains in (
                ("B", entry.b, law.input_gain),
                ("D", entry.d, law.direct_gain),
            )
        )
        gains = [
            *[("A", entry.a, law.state_gain), *(row for row in b if row[1:] != (0.0, 0.0))],
            *[("C", entry.c, law.output_gain), *d],
        ]
        for gain, value, shipped in gains:
            same = shipped == value
            note = "" if same else _remark(entry.law, "gains", gain)
            rows.append(GainRow(entry.table, law.title, gain, value, shipped, same, note))
        extra = law.direct_gain.of_legs("error_integral")
        if extra and "error_integral" not in entry.signals:
            note = "integral of section 3.2, with which all later laws of the report run"
            gain = "D, error integral"
            rows.append(GainRow(entry.table, law.title, gain, _NAN, extra, True, note))
    return rows


class LimitRow(NamedTuple):
    """One limit of Table 2-1 and the geometry's."""

    dof: str
    unit: str
    side: str
    mechanical: float
    operational: float
    computed: float  #: Where the first leg reaches 37.5 in, all else at neutral.
    deviation: float  #: Of the computed from the mechanical limit, relative.
    note: str


def limit_rows() -> list[LimitRow]:
    """Table 2-1 and the excursions that the legs allow."""
    limits, reach = load_motion_limits(), excursion_envelope()
    notes = {
        ("pitch", "low"): "set by something other than the legs",
        ("heave", "high"): "down; set by something other than the legs",
        ("yaw", "low"): "the operational limit is printed in inches; degrees are meant",
    }
    rows = []
    for dof, ends in zip(DOFS, reach, strict=True):
        axis = getattr(limits, dof)
        unit = axis.mechanical.unit
        for side, end in zip(("low", "high"), ends, strict=True):
            stated, computed = getattr(axis.mechanical, side), units.from_si(unit, float(end))
            allowed, note = getattr(axis.operational, side), notes.get((dof, side), "")
            numbers = (stated, allowed, computed, computed / stated - 1.0)
            rows.append(LimitRow(dof, unit, side, *numbers, note))
    return rows


def printed_number(value: float, digits: int = 3) -> str:
    """A number for a table; a dash where there is none."""
    if 0.0 < abs(value) < 1e-3:
        return "below 0.001"
    return "–" if not np.isfinite(value) else f"{value:.{digits}g}"
