"""Tables and figures of the linear models: the report's, their loops, Table 4-1, section 3.4."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.catalogue import (
    HARDWARE_MODELS,
    ReportModel,
    report_entry,
    report_model,
    report_models,
)
from cmf_mj.analysis.linear.loop import loop_response, loop_step
from cmf_mj.analysis.linear.second_order import (
    GAINS,
    FeedbackLoop,
    GainEffect,
    LoopCharacteristics,
    bandwidth_example,
    feedback_model,
    gain_effects,
)
from cmf_mj.analysis.linear.table_4_1 import LawLoop, TableRow, law_loops, table_4_1
from cmf_mj.analysis.published import published_results
from cmf_mj.core.files import write_csv

_LINES = np.geomspace(0.1, 20.0, 400)
_LOOP_COLUMNS = (
    *("stable", "phase_bandwidth_hz", "gain_bandwidth_hz", "peak_gain_db", "static_gain"),
    *("overshoot", "damping_ratio", "demand_damping_ratio", "peak_damping_ratio"),
    *("mode_damping_ratio", "mode_frequency_hz", "rise_time", "settling_time"),
)
_READINGS = {"damping_ratio": "step_damping_ratio"}
_GAIN_TITLES = {
    "position_gain": ("position gain", "$K_p$"),
    "rate_gain": ("rate gain", "$K_r\\omega$"),
    "acceleration_gain": ("acceleration gain", "$K_a\\omega^2$"),
}


def roots_text(roots: Sequence[complex]) -> str:
    """Poles or zeros in rad/s, slowest first, a complex pair once as `-a ± bj`."""
    shown = sorted((r for r in roots if r.imag >= 0.0), key=abs)
    return ", ".join(
        f"{r.real:.5g}" if r.imag == 0.0 else f"{r.real:.5g} ± {r.imag:.5g}j" for r in shown
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
    table = Table(
        title="transfer functions of the report",
        caption="poles and zeros in rad/s, of Eq 3.6 in the z plane",
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    for name in ("Eq", "variant", "model", "from, to", "poles", "zeros", "static gain"):
        table.add_column(name, overflow="fold", no_wrap=name in ("Eq", "variant"))
    for entry in report_models():
        for variant in entry.variants:
            table.add_row(*_model_cells(entry.read(variant), variant))
    return table


def misprint_table() -> Table:
    """What the print has wrong, and what to know before trusting a model."""
    table = Table("Eq", "", "remark", title="remarks", box=SIMPLE_HEAD, pad_edge=False)
    for entry in report_models():
        if entry.corrected:
            table.add_row(entry.number, "misprint", entry.corrected.reason)
        if entry.note:
            table.add_row(entry.number, "note", entry.note)
    return table


def table_4_1_table(rows: Sequence[TableRow]) -> Table:
    """Table 4-1 published beside computed, the hardware under the same law in the caption."""
    machine = next(r for r in published_results() if (r.table, r.of) == ("4-1", "hardware"))
    table = Table(
        title="Table 4-1: velocity law around linear models 1 to 3",
        caption="damping from the step's overshoot over its final value (step) or over the demand "
        "(demand), or from the gain's peak over 0 dB (peak); the report does not say which. "
        f"Hardware: -90 deg {machine.phase_bandwidth_hz} Hz, -3 dB {machine.gain_bandwidth_hz} Hz, "
        f"damping {machine.damping_ratio}",
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    for name in ("model", "Eq", "quantity", "published", "computed", "deviation", "allowed", ""):
        table.add_column(name, justify="left" if name in ("quantity", "") else "right")
    for row in rows:
        table.add_row(
            f"#{row.model}",
            row.equation,
            row.quantity,
            f"{row.published:.2f}",
            f"{row.computed:.3f}",
            f"{row.deviation:+.3f}",
            f"{row.tolerance:g} {row.unit if row.unit != '1' else ''}".strip(),
            "within" if row.within else "OUTSIDE",
            end_section=row.quantity == "damping, peak",
        )
    return table


def loop_table(loops: Sequence[LawLoop]) -> Table:
    """Bandwidths and damping of laws around the hardware models."""
    table = Table(
        title="laws around the report's linear models, pressures zero",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    header = ("law", "model", "-90 deg", "-3 dB", "peak dB", "static", "zeta step", "zeta pole")
    for name in header:
        table.add_column(name, justify="left" if name == "law" else "right")
    for item in loops:
        m = item.measures
        values = [m.phase_bandwidth_hz, m.gain_bandwidth_hz, m.peak_gain_db, m.static_gain]
        values += [m.damping_ratio, m.mode_damping_ratio]
        cells = ["-" if value != value else f"{value:.2f}" for value in values]
        if not m.stable:
            cells[-2] = "unstable"
        table.add_row(item.law.name, f"#{item.model}", *cells)
    return table


def _bode(gain: Axes, phase: Axes, response: FrequencyResponse, **style: str) -> None:
    gain.semilogx(response.frequency, response.gain_db, **style)
    phase.semilogx(response.frequency, response.phase_deg, **style)
    phase.yaxis.set_major_locator(MultipleLocator(45.0))


def _dress(*axes: Axes) -> None:
    for axis in axes:
        axis.grid(True, which="both", color="0.9", linewidth=0.6)


def models_figure() -> Figure:
    """Bode diagrams of the report's position, velocity and acceleration per command."""
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True)
    for (gain, phase), output in zip(
        axes.T, ("leg_position", "leg_velocity", "leg_acceleration"), strict=True
    ):
        entries = [report_entry(e.number) for e in report_models() if e.output == output]
        # The gain of Eq 4.1 is of no use; its poles stand in the map of poles and zeros.
        entries = [e for e in entries if e.input == "command" and e.number != "4.1"]
        for entry in entries:
            response = loop_response(report_model(entry.number), _LINES)
            _bode(gain, phase, response, label=f"Eq {entry.number}, {entry.model}")
        unit = f"{entries[0].output_unit} per {entries[0].input_unit}"
        gain.set(title=output.replace("_", " "), ylabel=f"gain [dB of {unit}]")
        phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
        gain.legend(fontsize=7)
        _dress(gain, phase)
    return figure


def pole_zero_figure() -> Figure:
    """Poles and zeros of the report's models of the plant."""
    numbers = ("4.1", "4.4", "4.12", "4.15", "4.18", "4.11", "4.14", "4.17")
    figure = Figure(figsize=(12.0, 6.5), layout="constrained")
    for axis, number in zip(figure.subplots(2, 4).flat, numbers, strict=True):
        system, entry = report_model(number), report_entry(number)
        for roots, marker in ((system.poles(), "x"), (system.zeros(), "o")):
            axis.plot(roots.real, roots.imag, marker, color="#0072b2", fillstyle="none")
        axis.axvline(0.0, color="0.6", linewidth=0.8)
        # Linear about the origin, logarithmic beyond: poles lie from 0.005 to 3600 rad/s.
        axis.set_xscale("symlog", linthresh=1.0)
        axis.set_yscale("symlog", linthresh=10.0)
        axis.set(xlim=(-2e3, 2e2), ylim=(-1e4, 1e4))
        axis.set(title=f"Eq {number}: {entry.output.replace('_', ' ')}\n{entry.model}")
        axis.title.set_fontsize(9)
        axis.set(xlabel="real [rad/s]", ylabel="imaginary [rad/s]")
        axis.tick_params(labelsize=7)
        _dress(axis)
    return figure


def loop_figures(loops: Sequence[LawLoop]) -> tuple[Figure, Figure]:
    """Bode diagram (Figure 4-13) and step (Figures 4-6, 4-9, 4-12) of a law around the models."""
    bode, step = (Figure(figsize=(8.0, 7.0), layout="constrained") for _ in range(2))
    gain, phase = bode.subplots(2, 1, sharex=True)
    axis = step.subplots()
    printed = {str(row.of): row for row in published_results() if row.table == "4-1"}
    for item in loops:
        label = f"linear model #{item.model}, Eq {HARDWARE_MODELS[item.model]}"
        response = loop_response(item.loop, _LINES)
        _bode(gain, phase, response, label=label)
        colour = gain.lines[-1].get_color()
        if item.measures.stable:
            time, reached = loop_step(item.loop, 2.0)
            axis.plot(time, reached, label=label, color=colour)
        beside = printed[f"linear_{item.model}"]
        if item.law.name == beside.law:
            gain.plot(beside.gain_bandwidth_hz, -3.0, "o", color=colour, fillstyle="none")
            phase.plot(beside.phase_bandwidth_hz, -90.0, "o", color=colour, fillstyle="none")
    gain.axhline(-3.0, color="0.6", linewidth=0.8)
    phase.axhline(-90.0, color="0.6", linewidth=0.8)
    title = f"{loops[0].law.title}, reference to leg position"
    circles = "; circles: Table 4-1" if len(gain.lines) > len(loops) + 1 else ""
    gain.set(ylabel="gain [dB]", title=title + circles)
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
    axis.axhline(1.0, color="0.6", linewidth=0.8)
    axis.set(xlabel="time after the step [s]", ylabel="leg position over demand", title=title)
    gain.legend(fontsize=8)
    axis.legend(fontsize=8)
    _dress(gain, phase, axis)
    return bode, step


def _loop_bode(gain: Axes, phase: Axes, loop: FeedbackLoop, label: str) -> None:
    lines = np.geomspace(0.1, 10.0, 400)
    _bode(gain, phase, loop_response(feedback_model("3.4", loop), lines), label=label)


def example_figure() -> Figure:
    """Three loops with the bandwidths of Figure 3-14."""
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    titles = ("position", "position, rate", "position, rate, acceleration")
    for title, loop in zip(titles, bandwidth_example().values(), strict=True):
        _loop_bode(gain, phase, loop, title)
    gain.set(ylabel="gain [dB]", title="feedback of a second-order plant, Eq 3.4")
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
    gain.legend(fontsize=8)
    _dress(gain, phase)
    return figure


def _relative(effect: GainEffect) -> float:
    """A gain times the power of w that makes it a number."""
    return effect.value * effect.loop.natural_frequency ** GAINS.index(effect.gain)


def gain_figure(effects: Sequence[GainEffect]) -> Figure:
    """The effect of each gain on the Bode diagram, the bandwidths and the damping ratio."""
    figure = Figure(figsize=(12.0, 10.0), layout="constrained")
    axes = figure.subplots(3, 3)
    for (gain, phase, width), name in zip(axes.T, GAINS, strict=True):
        title, symbol = _GAIN_TITLES[name]
        chosen = [effect for effect in effects if effect.gain == name]
        for effect in chosen[:: max((len(chosen) - 1) // 4, 1)]:
            _loop_bode(gain, phase, effect.loop, f"{symbol} = {_relative(effect):.2f}")
        values = [_relative(effect) for effect in chosen]
        results = [effect.result for effect in chosen]
        width.plot(values, [r.phase_bandwidth_hz for r in results], label="-90 deg")
        width.plot(values, [r.gain_bandwidth_hz for r in results], label="-3 dB from static gain")
        damping = width.twinx()
        damping.plot(values, [r.damping_ratio for r in results], "k--")
        damping.set(ylabel="damping ratio (dashed)", ylim=(0.0, None))
        gain.set(title=f"effect of the {title}", ylabel="gain [dB]", ylim=(-40.0, 20.0))
        phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
        width.set(xlabel=symbol, ylabel="bandwidth [Hz]", ylim=(0.0, None))
        gain.legend(fontsize=7, loc="lower left")
        width.legend(fontsize=7, loc="lower left")
        _dress(gain, phase, width)
    return figure


def save_linear(loops: Sequence[LawLoop], rows: Sequence[TableRow], folder: Path) -> list[Path]:
    """Write the tables as CSV and all figures as PNG."""
    effects = gain_effects()
    figures = {
        "models.png": models_figure(),
        "poles_zeros.png": pole_zero_figure(),
        "second_order.png": example_figure(),
        "gain_effects.png": gain_figure(effects),
    }
    for law in dict.fromkeys(item.law.name for item in loops):
        bode, step = loop_figures([item for item in loops if item.law.name == law])
        figures |= {f"bode_{law}.png": bode, f"step_{law}.png": step}
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "table_4_1.csv", TableRow._fields, rows)
    write_csv(
        folder / "loops.csv",
        ("law", "model", *(_READINGS.get(name, name) for name in _LOOP_COLUMNS)),
        [
            (item.law.name, item.model, *(getattr(item.measures, name) for name in _LOOP_COLUMNS))
            for item in loops
        ],
    )
    write_csv(
        folder / "gain_effects.csv",
        (
            *("gain", "value", "plant_natural_frequency", "plant_damping_ratio"),
            *(*GAINS, *LoopCharacteristics._fields),
        ),
        [(e.gain, e.value, *e.loop, *e.result) for e in effects],
    )
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=110)
    return [folder / name for name in ("table_4_1.csv", "loops.csv", "gain_effects.csv", *figures)]


def linear_command(laws: Sequence[str], folder: Path) -> tuple[Table | str, ...]:
    """What `cmf linear` prints, all files written.

    Raises:
        InputError: a law is refused; nothing has been written then.
    """
    loops, rows = law_loops(laws), table_4_1()
    paths = save_linear(loops, rows, folder)
    written = f"written to {folder}: {', '.join(path.name for path in paths)}"
    tables = (model_table(), misprint_table(), table_4_1_table(rows), loop_table(loops))
    return (*tables, written)
