"""Tables and figures of laws around the report's linear models, Table 4-1 among them."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import control
import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.linear.loop import closed_loop, loop_response, loop_step
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Field, Result, fields_of
from cmf_mj.report_2014.models import HARDWARE_MODELS, hardware_velocity
from cmf_mj.show import look
from cmf_mj.show.comparison import phase_text

_FREQUENCIES = np.geomspace(0.1, 20.0, 400)

BANDWIDTH_TOLERANCE, DAMPING_TOLERANCE = 0.03, 0.1
"""Deviations from Table 4-1 [Hz and 1] that count as agreement."""


class LawLoop(NamedTuple):
    """A law around one of the report's hardware models."""

    law: Law
    model: int  #: Linear model 1 to 3.
    loop: control.StateSpace
    measures: Measures


LOOPS = (
    Field("law", of="law.name"),
    Field("model", form="#{}".format),
    Field("", "-90 deg", "", of=lambda row: phase_text(row.measures)),
    Field("gain_bandwidth_hz", "-3 dB", ".2f", of="measures.gain_bandwidth_hz"),
    Field("peak_gain_db", "peak dB", ".2f", of="measures.peak_gain_db"),
    Field("static_gain", "static", ".2f", of="measures.static_gain"),
    Field(
        *("", "zeta step", ".2f"),
        of=lambda row: row.measures.damping_ratio if row.measures.stable else "unstable",
    ),
    Field("mode_damping_ratio", "zeta pole", ".2f", of="measures.mode_damping_ratio"),
)
"""Bandwidths and damping of laws around the hardware models."""


def law_loops(laws: str | Sequence[str]) -> Result[LawLoop]:
    """Laws around linear models 1 to 3, pressures zero, as in Figure 4-5."""
    rows = []
    names = [laws] if isinstance(laws, str) else laws
    for law, number in product(map(load_law, names), HARDWARE_MODELS):
        loop = closed_loop(law, hardware_velocity(number))
        rows.append(LawLoop(law, number, loop, measure_loop(loop)))
    return Result(rows, LOOPS, "laws around the report's linear models, pressures zero")


class TableRow(NamedTuple):
    """One entry of Table 4-1 and the computed one."""

    model: Annotated[int, Field(form="#{}".format)]  #: Linear model 1 to 3.
    equation: Annotated[str, Field(title="Eq")]  #: Of its velocity transfer function.
    quantity: str  #: `-90 deg`, `-3 dB`, or `damping` with its reading.
    unit: Annotated[str, Field(printed=False)]
    published: Annotated[float, Field(form=".2f")]
    computed: Annotated[float, Field(form=".3f")]
    deviation: Annotated[float, Field(form="+.3f")]  #: Computed minus published.
    tolerance: Annotated[float, Field(printed=False)]  #: Largest deviation that counts as within.
    within: Annotated[bool, Field(printed=False)]


TABLE_4_1 = (
    *fields_of(TableRow),
    Field("", "allowed", "", of=lambda row: f"{row.tolerance:g} {row.unit}".removesuffix(" 1")),
    Field("", "", of=lambda row: "within" if row.within else "OUTSIDE"),
)

_LEGEND = (
    "damping from the step's overshoot over its final value (step) or over the demand (demand), or "
    "from the gain's peak over 0 dB (peak); the report does not say which. Hardware: -90 deg "
    "{0.phase_bandwidth_hz} Hz, -3 dB {0.gain_bandwidth_hz} Hz, damping {0.damping_ratio}"
)


def table_4_1() -> Result[TableRow]:
    """Table 4-1 computed: the velocity law around linear models 1 to 3, with the printed values.

    The damping ratio stands in all three readings, the hardware under the same law in the caption.
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
            judged = (value, computed, off, tolerance, abs(off) <= tolerance)
            rows.append(TableRow(number, equation, quantity, unit, *judged))
    title = "Table 4-1: velocity law around linear models 1 to 3"
    return Result(rows, TABLE_4_1, title, _LEGEND.format(printed["hardware"]), grouped=True)


def loop_figures(loops: Sequence[LawLoop]) -> tuple[Figure, Figure]:
    """Bode diagram (Figure 4-13) and step (Figures 4-6, 4-9, 4-12) of a law around the models."""
    if not loops:
        raise InputError("loops: none given; at least one is needed")
    bode, gain, phase = look.bode_axes(limits=True)
    step = look.new_figure(8.0, 7.0)
    axis, circles = step.subplots(), ""
    printed = {str(row.of): row for row in published_results() if row.table == "4-1"}
    for item in loops:
        stable, label = item.measures.stable, f"linear model #{item.model}"
        label += f", Eq {HARDWARE_MODELS[item.model]}" + ("" if stable else ", unstable")
        response = loop_response(item.loop, _FREQUENCIES)
        colour = look.plot_bode(gain, phase, response, label=label, stable=stable)
        axis.plot(*(loop_step(item.loop, 2.0) if stable else ((), ())), label=label, color=colour)
        row = printed[f"linear_{item.model}"]
        if item.law.name == row.law and look.plot_printed(gain, phase, row, colour):
            circles = "; circles: Table 4-1"
    law = f"{loops[0].law.title}, reference to leg position"
    gain.set_title(f"Frequency response, {law}{circles}")
    axis.axhline(1.0, color=look.GREY, linewidth=0.8)
    axis.set(
        xlabel="time after the step [s]", ylabel="leg position over demand", title=f"Step, {law}"
    )
    look.legend(bode, step)
    return bode, step


def save_linear(loops: Sequence[LawLoop], rows: Result[TableRow], folder: Path) -> list[Path]:
    """Write the tables as CSV and all figures as PNG."""
    files: dict[str, Any] = {"table_4_1.csv": rows.save}
    for law in dict.fromkeys(item.law.name for item in loops):
        figures = loop_figures([item for item in loops if item.law.name == law])
        files[f"bode_{law}.png"], files[f"step_{law}.png"] = figures
    return look.save_files(files, folder)
