"""Result tables: printed and computed values side by side, judged by a stated tolerance."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.linear.table_4_1 import table_4_1
from cmf_mj.analysis.published import Published, published_gains, published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.machine.kinematics import DOFS, excursion_envelope
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.show.report_2014.curves import law_title
from cmf_mj.show.report_2014.runs import On, Runs, Wanted

TITLES = {
    "2-4": "Original law",
    "2-6": "Velocity feedback",
    "section 3.2.2": "Velocity feedback with the integral",
    "3-2": "Rate feedback techniques",
    "3-5": "Compensators compared",
    "4-1": "Linear models of the hardware",
    "D-1": "Position error rate feedback, other degrees of freedom",
    "D-2": "Acceleration feedback, other degrees of freedom",
}
"""Result tables of the report, by number."""

PHASE, GAIN, DAMPING, HARDWARE = 0.10, 0.15, 0.1, 0.10
"""Tolerances: relative in -90 deg and -3 dB of non-linear rows, absolute in damping ratio, relative
in both bandwidths of hardware rows."""

TOLERANCES = (
    f"Allowed: non-linear rows {100 * PHASE:.0f} % in -90 deg and {100 * GAIN:.0f} % in -3 dB; "
    f"hardware rows {100 * HARDWARE:.0f} % in both; damping ratio {DAMPING:g} absolute; linear "
    "models "
    "0.03 Hz. Force and combined rate feedback were never fitted, and are reported with whatever "
    "they are."
)

REPORTED = ("combined_rate", "force")
"""Laws whose rows are reported without a verdict."""

_ON: dict[str, On] = {"hardware": "machine", "nonlinear": "model"}
_OF = {"hardware": "hardware", "nonlinear": "non-linear model"}
_QUANTITIES = (
    ("phase_bandwidth_hz", "-90 deg", "Hz"),
    ("gain_bandwidth_hz", "-3 dB", "Hz"),
    ("damping_ratio", "damping ratio", ""),
)

_NOTES = {
    ("acceleration", "D-2", "-90 deg"): (
        "0.01 % per in/s² behind a filter of 64 ms cannot move -90 deg from 3.7 to 5 Hz on any "
        "plant "
        "with this leg mode; the report's own Table 3-5 has 4.0 Hz for the same law in heave, and "
        "its six equal legs have the same response in every degree of freedom"
    ),
    ("acceleration", "3-5", "-90 deg"): (
        "with either sign of the gain the law stays within 1 % of position error rate feedback"
    ),
    ("combined_rate", "3-2", ""): (
        "the report lets a damping of -0.5 lower both bandwidths against position error rate "
        "feedback; with the printed gains both loops say that -90 deg rises"
    ),
    ("force", "3-5", ""): "see the section on force feedback; the oil mode rings at 13.7 Hz",
    ("original", "3-5", ""): "Table 2-4 prints 1.6 Hz, 2.0 Hz and 0.6 for the same run",
    ("velocity_error", "3-2", "damping ratio"): (
        "of the first overshoot; the oil mode of damping 0.011 then rings on"
    ),
}
"""Why a row deviates, by law, table and quantity (empty: any)."""


class ResultRow(NamedTuple):
    """One printed number beside the computed one."""

    table: str
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


def _note(law: str, table: str, quantity: str, *, needed: bool) -> str:
    if not needed:
        return ""
    return _NOTES.get((law, table, quantity), _NOTES.get((law, table, ""), ""))


def _value(runs: Runs, on: On, row: Published, field: str) -> float:
    result = runs.case(on, row.law, row.dof)
    if field == "damping_ratio":
        return result.metrics.damping_ratio
    widths = result.bandwidths
    return widths.phase_hz if field == "phase_bandwidth_hz" else widths.gain_hz


def _tolerance(of: str, field: str) -> float:
    if field == "damping_ratio":
        return DAMPING
    if of == "hardware":
        return HARDWARE
    return PHASE if field == "phase_bandwidth_hz" else GAIN


def _judged(runs: Runs, row: Published, label: str) -> list[ResultRow]:
    found = []
    appendix = row.table.startswith("D-")
    ringing = not runs.case(_ON[row.of], row.law, row.dof).metrics.stable
    for field, quantity, unit in _QUANTITIES:
        value = getattr(row, field)
        if value is None and not (row.table == "D-2" and field == "gain_bandwidth_hz"):
            continue
        stated = float("nan") if value is None else float(value)
        computed = _value(runs, _ON[row.of], row, field)
        off = computed - stated
        deviation = off if field == "damping_ratio" else off / stated
        judged = value is not None and row.law not in REPORTED
        tolerance = _tolerance(row.of, field) if judged else float("nan")
        # Round-off of the subtraction is no deviation.
        within = bool(abs(deviation) <= tolerance + 1e-9) if judged else None
        note = _note(row.law, row.table, quantity, needed=within is not True)
        if field == "damping_ratio" and ringing and not note:
            note = "of the first overshoot; the legs then ring on undiminished"
        hexapod = float("nan")
        if appendix and (
            field != "damping_ratio" or runs.case("machine", row.law, row.dof).metrics.stable
        ):
            hexapod = _value(runs, "machine", row, field)
        of = _OF[row.of]
        found.append(
            ResultRow(
                *(row.table, label, of, quantity, unit, stated, computed, deviation),
                *(tolerance, within, hexapod, note),
            )
        )
    return found


def _linear_rows() -> list[ResultRow]:
    nan = float("nan")
    rows = []
    for row in table_4_1():
        damping = row.unit == "1"
        note = ""
        if not row.within:
            note = "the report does not say how it read the damping ratio; the peak fits all three"
        rows.append(
            ResultRow(
                *("4-1", f"linear model #{row.model}", f"Eq {row.equation}", row.quantity),
                *("" if damping else "Hz", row.published, row.computed),
                row.deviation if damping else row.deviation / row.published,
                row.tolerance if damping else row.tolerance / row.published,
                *(row.within, nan, note),
            )
        )
    return rows


def _rows_of(table: str) -> list[Published]:
    return [row for row in published_results() if row.table == table]


def table_needs(table: str) -> tuple[Wanted, ...]:
    """Runs a result table is made from."""
    rows = [row for row in _rows_of(table) if row.of in _ON]
    plants: dict[Wanted, None] = {Wanted(_ON[row.of], row.law, row.dof): None for row in rows}
    if table.startswith("D-"):
        plants |= {Wanted("machine", row.law, row.dof): None for row in rows}
    return tuple(plants)


def result_rows(runs: Runs, table: str) -> list[ResultRow]:
    """All rows of a result table."""
    rows: list[ResultRow] = _linear_rows() if table == "4-1" else []
    for row in _rows_of(table):
        if row.of in _ON:
            label = row.dof if table.startswith("D-") else law_title(row.law)
            rows += _judged(runs, row, label)
    return rows


class GainRow(NamedTuple):
    """One printed gain beside the shipped one."""

    table: str
    law: str
    gain: str  #: Matrix and signal.
    printed: float
    shipped: float
    same: bool
    note: str


_GAIN_NOTES = {
    ("original", "B, position"): "digits exchanged in print: with 0.1709 the DC gain is 0.166 and "
    "the law does not track; with 0.1079 it is 0.998",
    ("force", "D, force"): "printed without a sign; read as opposing, as feedback of force must be",
}


def gain_rows() -> list[GainRow]:
    """Tables 2-2, 2-5, 3-1, 3-3 and 3-4 beside the laws in use."""
    rows = []
    for entry in published_gains():
        law = load_law(entry.law)
        pairs: list[tuple[str, float, float]] = [("A", entry.a, law.state_gain)]
        pairs += [
            (f"B, {name.replace('_', ' ')}", value, getattr(law.input_gain, name))
            for name, value in zip(entry.signals, entry.b, strict=True)
            if value != 0.0 or getattr(law.input_gain, name) != 0.0
        ]
        pairs.append(("C", entry.c, law.output_gain))
        pairs += [
            (f"D, {name.replace('_', ' ')}", value, getattr(law.direct_gain, name))
            for name, value in zip(entry.signals, entry.d, strict=True)
        ]
        for gain, value, shipped in pairs:
            same = shipped == value
            note = "" if same else _GAIN_NOTES.get((entry.law, gain), "")
            rows.append(GainRow(entry.table, law.title, gain, value, shipped, same, note))
        extra = law.direct_gain.of_legs("error_integral")
        if extra and "error_integral" not in entry.signals:
            note = "integral of section 3.2, with which all later laws of the report run"
            gain = "D, error integral"
            rows.append(GainRow(entry.table, law.title, gain, float("nan"), extra, True, note))
    return rows


class LimitRow(NamedTuple):
    """One limit of Table 2-1 beside the geometry's."""

    dof: str
    unit: str
    side: str
    mechanical: float
    operational: float
    computed: float  #: Where the first leg reaches 37.5 in, all else at neutral.
    deviation: float  #: Of the computed from the mechanical limit, relative.
    note: str


def limit_rows() -> list[LimitRow]:
    """Table 2-1 beside the excursions that the legs allow."""
    limits, reach = load_motion_limits(), excursion_envelope()
    notes = {
        ("pitch", "low"): "set by something other than the legs",
        ("heave", "high"): "down; set by something other than the legs",
        ("yaw", "low"): "the operational limit is printed in inches; degrees are meant",
    }
    rows = []
    for index, dof in enumerate(DOFS):
        axis = getattr(limits, dof)
        for side, column in (("low", 0), ("high", 1)):
            stated = getattr(axis.mechanical, side)
            computed = units.from_si(axis.mechanical.unit, float(reach[index, column]))
            rows.append(
                LimitRow(
                    *(dof, axis.mechanical.unit, side, stated, getattr(axis.operational, side)),
                    *(computed, computed / stated - 1.0, notes.get((dof, side), "")),
                )
            )
    return rows


def outside(rows: Iterable[ResultRow]) -> list[ResultRow]:
    """Rows beyond their tolerance."""
    return [row for row in rows if row.within is False]


def printed_number(value: float, digits: int = 3) -> str:
    """A number for a table; a dash where there is none."""
    if 0.0 < abs(value) < 1e-3:
        return "below 0.001"
    return "–" if not np.isfinite(value) else f"{value:.{digits}g}"
