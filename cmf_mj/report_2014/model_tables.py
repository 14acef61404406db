"""Tables and figures of the linear models: the report's, their loops, Table 4-1, section 3.4."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.linear.loop import loop_response, loop_step
from cmf_mj.analysis.published import published_results
from cmf_mj.core.result import Field, Result, Table
from cmf_mj.report_2014.models import (
    HARDWARE_MODELS,
    LawLoop,
    ReportModel,
    TableRow,
    report_model,
    report_models,
)
from cmf_mj.report_2014.second_order import GAINS, gain_effects
from cmf_mj.show.look import GREY, bode_axes, legend, new_figure, plot_bode, save_files
from cmf_mj.show.study import phase_text

_FREQUENCIES = np.geomspace(0.1, 20.0, 400)
EFFECTS = (
    *map(Field, ("gain", "value")),
    Field("plant_natural_frequency", of="loop.natural_frequency"),
    Field("plant_damping_ratio", of="loop.damping_ratio"),
    *(Field(name, of=f"loop.{name}") for name in GAINS),
    Field("natural_frequency_hz", of="result.mode_frequency_hz"),
    Field("damping_ratio", of="result.mode_damping_ratio"),
    Field("static_gain", of="result.static_gain"),
    Field("phase_bandwidth_hz", of="result.phase_bandwidth_hz"),
    Field("gain_bandwidth_hz", of="result.gain_bandwidth_hz"),
    Field("peak_db", of="result.peak_gain_db"),
    Field("overshoot", of="result.overshoot"),
)
"""What varying a gain does."""


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


def save_linear(loops: Sequence[LawLoop], rows: Result[TableRow], folder: Path) -> list[Path]:
    """Write the tables as CSV and all figures as PNG."""
    effects = Result(gain_effects(), EFFECTS)
    files: dict[str, Any] = {"table_4_1.csv": rows.save, "gain_effects.csv": effects.save}
    for law in dict.fromkeys(item.law.name for item in loops):
        figures = loop_figures([item for item in loops if item.law.name == law])
        files[f"bode_{law}.png"], files[f"step_{law}.png"] = figures
    return save_files(files, folder)
