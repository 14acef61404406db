"""Laws around the report's linear models: measures, Bode diagrams and steps, and Table 4-1."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import control
import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.linear.loop import closed_loop, loop_response, loop_step
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Field, Result, fields_of
from cmf_mj.report_2014.models import HARDWARE_MODELS, hardware_velocity, printed_table_4_1
from cmf_mj.show import look
from cmf_mj.show.comparison import phase_text

_FREQUENCIES = np.geomspace(0.1, 20.0, 400)

BANDWIDTH_TOLERANCE, DAMPING_TOLERANCE = 0.03, 0.1
"""Deviations from Table 4-1 [Hz and 1] that count as agreement."""


class LawLoop(NamedTuple):
    """A law around one of the report's hardware models."""

    law: Law
    model: int  #: Linear model 1 to 3.
    system: control.StateSpace  #: Closed, from reference to leg position.
    measures: Measures


class LoopFigures(NamedTuple):
    """Figures of a law around the models."""

    bode: Figure  #: Bode diagram, as Figure 4-13.
    step: Figure  #: Steps, as Figures 4-6, 4-9 and 4-12.


LOOP_FIELDS = (
    Field("law", of="law.name"),
    Field("model", form="#{}".format),
    Field("", "-90 deg", "", of=lambda row: phase_text(row.measures)),
    Field("gain_bandwidth_hz", "-3 dB", ".2f", of="measures.gain_bandwidth_hz"),
    Field("peak_gain_db", "peak dB", ".2f", of="measures.peak_gain_db"),
    Field("static_gain", "static", ".2f", of="measures.static_gain"),
    Field("", "zeta step", ".2f", of=lambda row: _step_damping(row.measures)),
    Field("mode_damping_ratio", "zeta pole", ".2f", of="measures.mode_damping_ratio"),
)
"""Fields of a table of `LawLoop`: bandwidths and damping."""


def _step_damping(measures: Measures) -> float | str:
    return measures.damping_ratio if measures.stable else "unstable"


def law_loops(laws: str | Sequence[str]) -> Result[LawLoop]:
    """Laws around linear models 1 to 3, pressures zero, as in Figure 4-5."""
    loops = []
    names = [laws] if isinstance(laws, str) else laws
    for law, model in product(map(load_law, names), HARDWARE_MODELS):
        system = closed_loop(law, hardware_velocity(model))
        loops.append(LawLoop(law, model, system, measure_loop(system)))
    return Result(loops, LOOP_FIELDS, "laws around the report's linear models, pressures zero")


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


TABLE_4_1_FIELDS = (
    *fields_of(TableRow),
    Field("", "allowed", "", of=lambda row: f"{row.tolerance:g} {row.unit}".removesuffix(" 1")),
    Field("", "", of=lambda row: "within" if row.within else "OUTSIDE"),
)

_CAPTION = (
    "damping from the step's overshoot over its final value (step) or over the demand (demand), or "
    "from the gain's peak over 0 dB (peak); the report does not say which. Hardware: -90 deg "
    "{hardware.phase_bandwidth_hz} Hz, -3 dB {hardware.gain_bandwidth_hz} Hz, damping "
    "{hardware.damping_ratio}"
)


def table_4_1() -> Result[TableRow]:
    """Table 4-1 computed: the velocity law around linear models 1 to 3, with the printed values.

    The damping ratio stands in all three readings, the hardware under the same law in the caption.
    """
    rows, published = list[TableRow](), printed_table_4_1()
    for loop in law_loops("velocity"):
        model, measures, printed = loop.model, loop.measures, published[f"linear_{loop.model}"]
        phase_hz, gain_hz = printed.phase_bandwidth_hz, printed.gain_bandwidth_hz
        damping = printed.damping_ratio
        rows += [
            _table_row(model, "-90 deg", "Hz", phase_hz, measures.phase_bandwidth_hz),
            _table_row(model, "-3 dB", "Hz", gain_hz, measures.gain_bandwidth_hz),
            _table_row(model, "damping, step", "1", damping, measures.damping_ratio),
            _table_row(model, "damping, demand", "1", damping, measures.demand_damping_ratio),
            _table_row(model, "damping, peak", "1", damping, measures.peak_damping_ratio),
        ]
    title = "Table 4-1: velocity law around linear models 1 to 3"
    caption = _CAPTION.format(hardware=published["hardware"])
    return Result(rows, TABLE_4_1_FIELDS, title, caption, grouped=True)


def _table_row(
    model: int, quantity: str, unit: str, printed: float | None, computed: float
) -> TableRow:
    """A quantity of a linear model, 1 to 3."""
    published = float("nan") if printed is None else printed
    deviation = computed - published
    tolerance = BANDWIDTH_TOLERANCE if unit == "Hz" else DAMPING_TOLERANCE
    return TableRow(
        model=model,
        equation=HARDWARE_MODELS[model],
        quantity=quantity,
        unit=unit,
        published=published,
        computed=computed,
        deviation=deviation,
        tolerance=tolerance,
        within=abs(deviation) <= tolerance,
    )


def loop_figures(loops: Sequence[LawLoop]) -> LoopFigures:
    """Bode diagram and step of a law around the models; the step of an unstable loop is empty."""
    if not loops:
        raise InputError("loops: none given; at least one is needed")
    bode, gain, phase = look.bode_axes(limits=True)
    step = look.new_figure(8.0, 7.0)
    step_axes, circles, published = step.subplots(), "", printed_table_4_1()
    for loop in loops:
        stable, equation = loop.measures.stable, HARDWARE_MODELS[loop.model]
        label = f"linear model #{loop.model}, Eq {equation}" + ("" if stable else ", unstable")
        response = loop_response(loop.system, _FREQUENCIES)
        colour = look.plot_bode(gain, phase, response, label=label, stable=stable)
        times, positions = loop_step(loop.system, 2.0) if stable else ((), ())
        step_axes.plot(times, positions, label=label, color=colour)
        printed = published[f"linear_{loop.model}"]
        if loop.law.name == printed.law and look.plot_published(gain, phase, printed, colour):
            circles = "; circles: Table 4-1"
    law = f"{loops[0].law.title}, reference to leg position"
    gain.set_title(f"Frequency response, {law}{circles}")
    step_axes.axhline(1.0, color=look.GREY, linewidth=0.8)
    step_axes.set(
        xlabel="time after the step [s]", ylabel="leg position over demand", title=f"Step, {law}"
    )
    look.legend(bode, step)
    return LoopFigures(bode, step)


def save_linear(loops: Sequence[LawLoop], rows: Result[TableRow], folder: Path) -> list[Path]:
    """Write `rows`, Table 4-1, as CSV and the figures of each law of `loops` as PNG."""
    files: dict[str, Any] = {"table_4_1.csv": rows.save}
    for law in dict.fromkeys(loop.law.name for loop in loops):
        figures = loop_figures([loop for loop in loops if loop.law.name == law])
        files |= {f"bode_{law}.png": figures.bode, f"step_{law}.png": figures.step}
    return look.save_files(files, folder)
