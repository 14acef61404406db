"""Tables and figures of the linear models: the report's, their loops, Table 4-1, section 3.4."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.linear.loop import loop_response, loop_step
from cmf_mj.analysis.published import published_results
from cmf_mj.core.table import Table
from cmf_mj.report_2014.models import (
    HARDWARE_MODELS,
    LawLoop,
    ReportModel,
    TableRow,
    report_model,
    report_models,
)
from cmf_mj.report_2014.second_order import GAINS, gain_effects
from cmf_mj.show.comparison import phase_text
from cmf_mj.show.look import GREY, bode_axes, legend, new_figure, plot_bode, save_files

_FREQUENCIES = np.geomspace(0.1, 20.0, 400)
_EFFECT_COLUMNS = {
    "natural_frequency_hz": "mode_frequency_hz",
    "damping_ratio": "mode_damping_ratio",
    "static_gain": "static_gain",
    "phase_bandwidth_hz": "phase_bandwidth_hz",
    "gain_bandwidth_hz": "gain_bandwidth_hz",
    "peak_db": "peak_gain_db",
    "overshoot": "overshoot",
}


def roots_text(roots: Sequence[complex]) -> str:
    """Poles or zeros in rad/s, slowest first, a complex pair once as `-a ± bj`."""
    upper = sorted((r for r in roots if r.imag >= 0.0), key=abs)
    return ", ".join(
        f"{r.real:.5g}" if r.imag == 0.0 else f"{r.real:.5g} ± {r.imag:.5g}j" for r in upper
    )


def _model_cells(entry: ReportModel, variant: str) -> list[str]:
    cells = [entry.number, variant, f"{entry.model}: {entry.title}" if entry.model else entry.title]
    cells.append(f"{entry.input} [{entry.input_unit}] -> {entry.output} [{entry.output_unit}]")
    if entry.formula:
        return [*cells, entry.formula, "", ""]
    system = report_model(entry.number, "printed" if variant == "printed" else "corrected")
    gain = float(np.real(system.dcgain()))
    return [*cells, roots_text(system.poles()), roots_text(system.zeros()), f"{gain:.4g}"]


def model_table() -> Table:
    """Every transfer function of the report, a line a variant: poles, zeros, static gain."""
    return Table(
        "transfer functions of the report",
        ("Eq", "variant", "model", "from, to", "poles", "zeros", "static gain"),
        [
            _model_cells(entry.read(variant), variant)
            for entry in report_models()
            for variant in entry.variants
        ],
        "poles and zeros in rad/s, of Eq 3.6 in the z plane",
    )


def misprint_table() -> Table:
    """What the print has wrong, and what to know before trusting a model."""
    rows = []
    for entry in report_models():
        if entry.corrected:
            rows.append((entry.number, "misprint", entry.corrected.reason))
        if entry.note:
            rows.append((entry.number, "note", entry.note))
    return Table("remarks", ("Eq", "", "remark"), rows)


def table_4_1_table(rows: Sequence[TableRow]) -> Table:
    """Table 4-1 as published and as computed, the hardware under the same law in the caption."""
    machine = next(r for r in published_results() if (r.table, r.of) == ("4-1", "hardware"))
    columns = (
        *("model", "Eq", "quantity", ("published", ".2f"), ("computed", ".3f")),
        *(("deviation", "+.3f"), ("allowed", ""), ""),
    )
    cells = [
        (
            *(f"#{row.model}", row.equation, row.quantity),
            *(row.published, row.computed, row.deviation),
            f"{row.tolerance:g} {row.unit if row.unit != '1' else ''}".strip(),
            "within" if row.within else "OUTSIDE",
        )
        for row in rows
    ]
    caption = (
        "damping from the step's overshoot over its final value (step) or over the demand "
        "(demand), or from the gain's peak over 0 dB (peak); the report does not say which. "
        f"Hardware: -90 deg {machine.phase_bandwidth_hz} Hz, -3 dB {machine.gain_bandwidth_hz} Hz, "
        f"damping {machine.damping_ratio}"
    )
    title = "Table 4-1: velocity law around linear models 1 to 3"
    return Table(title, columns, cells, caption, grouped=True)


def loop_table(loops: Sequence[LawLoop]) -> Table:
    """Bandwidths and damping of laws around the hardware models."""
    rows = []
    for item in loops:
        m = item.measures
        values = (phase_text(m), m.gain_bandwidth_hz, m.peak_gain_db, m.static_gain)
        damping = m.damping_ratio if m.stable else "unstable"
        rows.append((item.law.name, f"#{item.model}", *values, damping, m.mode_damping_ratio))
    names = ("-90 deg", "-3 dB", "peak dB", "static", "zeta step", "zeta pole")
    columns = ("law", ("model", ""), *((name, ".2f") for name in names))
    return Table("laws around the report's linear models, pressures zero", columns, rows)


def loop_figures(loops: Sequence[LawLoop]) -> tuple[Figure, Figure]:
    """Bode diagram (Figure 4-13) and step (Figures 4-6, 4-9, 4-12) of a law around the models."""
    bode, gain, phase = bode_axes(limits=True)
    step = new_figure(8.0, 7.0)
    axis, circles = step.subplots(), ""
    printed = {str(row.of): row for row in published_results() if row.table == "4-1"}
    for item in loops:
        stable, label = item.measures.stable, f"linear model #{item.model}"
        label += f", Eq {HARDWARE_MODELS[item.model]}" + ("" if stable else ", unstable")
        response = loop_response(item.loop, _FREQUENCIES)
        colour = plot_bode(gain, phase, response, label=label, stable=stable)
        axis.plot(*(loop_step(item.loop, 2.0) if stable else ((), ())), label=label, color=colour)
        row = printed[f"linear_{item.model}"]
        if item.law.name == row.law:
            widths = (row.gain_bandwidth_hz, row.phase_bandwidth_hz)
            for axes, value, level in zip((gain, phase), widths, (-3.0, -90.0), strict=True):
                if value is not None:
                    axes.plot(value, level, "o", color=colour, fillstyle="none")
            circles = "; circles: Table 4-1"
    law = f"{loops[0].law.title}, reference to leg position"
    gain.set_title(f"Frequency response, {law}{circles}")
    axis.axhline(1.0, color=GREY, linewidth=0.8)
    axis.set(
        xlabel="time after the step [s]", ylabel="leg position over demand", title=f"Step, {law}"
    )
    legend(gain, axis)
    return bode, step


def save_linear(loops: Sequence[LawLoop], rows: Sequence[TableRow], folder: Path) -> list[Path]:
    """Write the tables as CSV and all figures as PNG."""
    effects = gain_effects()
    figures: dict[str, Any] = {}
    for law in dict.fromkeys(item.law.name for item in loops):
        figures[f"bode_{law}.png"], figures[f"step_{law}.png"] = loop_figures(
            [item for item in loops if item.law.name == law]
        )
    effect_header = (
        *("gain", "value", "plant_natural_frequency", "plant_damping_ratio"),
        *(*GAINS, *_EFFECT_COLUMNS),
    )
    values = [
        (e.gain, e.value, *e.loop, *(getattr(e.result, n) for n in _EFFECT_COLUMNS.values()))
        for e in effects
    ]
    tables = {
        "table_4_1.csv": (TableRow._fields, rows),
        "gain_effects.csv": (effect_header, values),
    }
    return save_files(tables | figures, folder)
