"""Laws around the report's linear models, and Table 4-1 computed next to its print."""

from collections.abc import Sequence
from typing import NamedTuple

import control

from cmf_mj.analysis.linear.catalogue import HARDWARE_MODELS, hardware_velocity
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import Law, load_law

BANDWIDTH_TOLERANCE, DAMPING_TOLERANCE = 0.03, 0.1
"""Deviations from Table 4-1 [Hz and 1] that count as agreement."""


class LawLoop(NamedTuple):
    """A law around one of the report's hardware models."""

    law: Law
    model: int  #: Linear model 1 to 3.
    loop: control.StateSpace
    measures: Measures


def law_loops(laws: Sequence[str]) -> tuple[LawLoop, ...]:
    """Every law around linear models 1 to 3, pressures zero, as in Figure 4-5."""
    loops = []
    for law in [load_law(name) for name in laws]:
        for number in HARDWARE_MODELS:
            loop = closed_loop(law, hardware_velocity(number))
            loops.append(LawLoop(law, number, loop, measure_loop(loop)))
    return tuple(loops)


class TableRow(NamedTuple):
    """One entry of Table 4-1 and the computed one."""

    model: int  #: Linear model 1 to 3.
    equation: str  #: Of its velocity transfer function.
    quantity: str  #: `-90 deg`, `-3 dB`, or `damping` with its reading.
    unit: str
    published: float
    computed: float
    deviation: float  #: Computed minus published.
    tolerance: float  #: Largest deviation that counts as within.
    within: bool


def table_4_1() -> tuple[TableRow, ...]:
    """Table 4-1 computed: the velocity law around linear models 1 to 3, with the printed values.

    The damping ratio stands in all three readings.
    """
    rows = []
    printed = {str(row.of): row for row in published_results() if row.table == "4-1"}
    for number, equation in HARDWARE_MODELS.items():
        ours = measure_loop(closed_loop("velocity", hardware_velocity(number)))
        row = printed[f"linear_{number}"]
        entries = [
            ("-90 deg", "Hz", row.phase_bandwidth_hz, ours.phase_bandwidth_hz),
            ("-3 dB", "Hz", row.gain_bandwidth_hz, ours.gain_bandwidth_hz),
            ("damping, step", "1", row.damping_ratio, ours.damping_ratio),
            ("damping, demand", "1", row.damping_ratio, ours.demand_damping_ratio),
            ("damping, peak", "1", row.damping_ratio, ours.peak_damping_ratio),
        ]
        for quantity, unit, stated, computed in entries:
            value = float("nan") if stated is None else stated
            tolerance = BANDWIDTH_TOLERANCE if unit == "Hz" else DAMPING_TOLERANCE
            off = computed - value
            name = (number, equation, quantity, unit)
            rows.append(TableRow(*name, value, computed, off, tolerance, abs(off) <= tolerance))
    return tuple(rows)
