"""Tables, figures and files of a linearised plant: modes, Bode diagrams, poles, loops measured."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.analysis.frequency_response import bandwidths
from cmf_mj.analysis.linear.files import save_system
from cmf_mj.analysis.linear.poles import Mode
from cmf_mj.core.files import write_csv
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.look import pose_text
from cmf_mj.studies.linearization import FREQUENCIES, LinearizationStudy

_NAMED = 0.1
"""Share from which on a kind of state or a degree of freedom is named."""


def _title(found: LinearizationStudy) -> str:
    plant = found.plant
    name = f"{plant.name} {plant.cab}".strip().replace("_", " ")
    return f"{name}, {plant.parameters.name}, {pose_text(found.pose)}"


def _mode_cells(alike: Sequence[Mode]) -> list[str]:
    """A line of the table: a mode, or several whose poles coincide."""
    mode = alike[0]
    pole = mode.pole
    text = f"{pole.real:.4g}" + (f" ± {pole.imag:.4g}j" if pole.imag > 0.0 else "")
    still = np.isnan(mode.damping_ratio)
    cells = [
        "0" if still else text,
        str(len(alike)),
        "0" if still else f"{mode.frequency / (2.0 * np.pi):.3g}",
        "-" if still else f"{mode.damping_ratio:.3f}",
    ]
    shares = sorted(mode.shares.items(), key=lambda item: -item[1])
    cells.append(", ".join(f"{name} {share:.2f}" for name, share in shares if share >= _NAMED))
    if len(alike) > 1 or mode.shares["motion"] + mode.shares["oil"] < _NAMED:
        return [*cells, "", ""]
    dofs = sorted(zip(DOFS, mode.dof_shares, strict=True), key=lambda item: -item[1])
    cells.append(", ".join(f"{dof} {share:.2f}" for dof, share in dofs if share >= _NAMED))
    return [*cells, " ".join(f"{size:.2f}" for size in np.abs(mode.leg_shape))]


def _alike(found: Sequence[Mode]) -> list[list[Mode]]:
    groups: list[list[Mode]] = []
    for mode in found:
        if groups and np.isclose(mode.pole, groups[-1][0].pole, rtol=1e-6, atol=1e-6):
            groups[-1].append(mode)
        else:
            groups.append([mode])
    return groups


def mode_table(found: LinearizationStudy) -> Table:
    """All modes: pole, frequency, damping, what takes part."""
    table = Table(
        title=f"modes: {_title(found)}",
        caption="shares of states by participation factors, of degrees of freedom in the leg "
        "motion; legs: size of their motion. Poles that coincide share a line and have no shapes.",
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    numbers = ("times", "Hz", "damping")
    for name in ("pole [rad/s]", *numbers, "states", "degrees of freedom", "legs"):
        table.add_column(name, justify="right" if name in numbers else "left")
    for alike in _alike(found.modes):
        table.add_row(*_mode_cells(alike))
    return table


def loop_table(found: LinearizationStudy) -> Table:
    """Bandwidths of the law's loops, and how far the simulation is off where it ran."""
    table = Table(
        title=f"{found.law} around the linearised plant",
        caption="measured less linear, largest from "
        f"{_band(found)}; '-': not reached below {FREQUENCIES[-1]:g} Hz",
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    for name in ("dof", "-90 deg [Hz]", "-3 dB [Hz]", "peak [dB]", "gain off", "phase off"):
        table.add_column(name, justify="left" if name == "dof" else "right")
    for name, loop in found.loops.items():
        values = [f"{value:.2f}" if value == value else "-" for value in bandwidths(loop)]
        beside = found.comparisons.get(name)
        off = ["not measured", ""]
        if beside is not None:
            off = [
                f"{np.abs(beside.gain_error).max():.2f} dB",
                f"{np.abs(beside.phase_error).max():.2f} deg",
            ]
        table.add_row(name, *values, *off)
    return table


def _band(found: LinearizationStudy) -> str:
    for beside in found.comparisons.values():
        return f"{beside.frequency.min():g} to {beside.frequency.max():g} Hz"
    return "0.5 to 8 Hz"


def _axes(title: str) -> tuple[Figure, Axes, Axes]:
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    gain.set(ylabel="gain [dB]", title=title)
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
    phase.yaxis.set_major_locator(MultipleLocator(90.0))
    for axis in (gain, phase):
        axis.grid(True, which="both", color="0.9", linewidth=0.6)
    return figure, gain, phase


def bode_figure(found: LinearizationStudy) -> Figure:
    """Position per command of every degree of freedom or leg."""
    figure, gain, phase = _axes(f"position per command, all legs by J\n{_title(found)}")
    for name, response in found.responses.items():
        gain.semilogx(response.frequency, response.gain_db, label=name)
        phase.semilogx(response.frequency, response.phase_deg)
    gain.set(ylabel="gain [dB of m]")
    gain.legend(fontsize=8)
    return figure


def loop_figure(found: LinearizationStudy) -> Figure:
    """The law's loops; dots where the simulation was run beside them."""
    dots = "; dots: simulation" if found.comparisons else ""
    figure, gain, phase = _axes(f"{found.law}, demand to position{dots}\n{_title(found)}")
    for name, loop in found.loops.items():
        (line,) = gain.semilogx(loop.frequency, loop.gain_db, label=name)
        phase.semilogx(loop.frequency, loop.phase_deg)
        beside = found.comparisons.get(name)
        if beside is not None:
            style = {"marker": "o", "linestyle": "", "color": line.get_color(), "markersize": 4.0}
            near = np.interp(beside.frequency, loop.frequency, loop.phase_deg)
            turns = np.degrees(np.angle(beside.measured))
            gain.semilogx(beside.frequency, 20.0 * np.log10(np.abs(beside.measured)), **style)
            phase.semilogx(
                beside.frequency, turns + 360.0 * np.round((near - turns) / 360.0), **style
            )
    gain.axhline(-3.0, color="0.6", linewidth=0.8)
    phase.axhline(-90.0, color="0.6", linewidth=0.8)
    gain.legend(fontsize=8)
    return figure


def pole_zero_figure(found: LinearizationStudy) -> Figure:
    """Poles and zeros of the minimal models, position per command."""
    count = len(found.models)
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(4.0 * columns, 3.8 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axis in grid.flat[count:]:
        axis.set_visible(False)
    for axis, (name, model) in zip(grid.flat, found.models.items(), strict=False):
        for roots, marker in ((model.poles(), "x"), (model.zeros(), "o")):
            axis.plot(roots.real, roots.imag, marker, color="#0072b2", fillstyle="none")
        axis.axvline(0.0, color="0.6", linewidth=0.8)
        # Linear about the origin, logarithmic beyond: poles lie from 0.1 to 500 rad/s.
        axis.set_xscale("symlog", linthresh=1.0)
        highest = 1.3 * max(float(np.abs(model.poles().imag).max(initial=0.0)), 1.0)
        axis.set(xlim=(-2e3, 2.0), ylim=(-highest, highest))
        axis.set_xticks([-1e3, -1e2, -1e1, -1.0, 0.0, 1.0])
        axis.set(title=name, xlabel="real [rad/s]", ylabel="imaginary [rad/s]")
        axis.tick_params(labelsize=7)
        axis.grid(True, color="0.9", linewidth=0.6)
    figure.suptitle(f"poles (x) and zeros (o), position per command\n{_title(found)}", fontsize=10)
    return figure


def save_study(found: LinearizationStudy, folder: Path) -> list[Path]:
    """Write the state space as JSON, modes and comparison as CSV, all figures as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    point = found.point
    description = {
        **{k: v for k, v in found.plant.describe().items() if k != "hydraulic_parameters"},
        "pose": found.pose.tolist(),
        "leg_position": point.mechanics.extension.tolist(),
        "static_load": point.mechanics.load.tolist(),
        "command": point.command.tolist(),
        "chamber_pressure": point.pressure.tolist(),
        "supply_pressure": point.supply_pressure,
        "return_pressure": point.return_pressure,
        "outward_share": point.outward.tolist(),
    }
    paths = [save_system(found.system, folder / "state_space.json", description)]
    header = ["real", "imaginary", "frequency", "damping_ratio"]
    first = found.modes[0]
    header += [f"share_{name}" for name in first.shares] + [f"share_{dof}" for dof in DOFS]
    header += [f"leg_{i + 1}" for i in range(first.leg_shape.size)]
    rows = [
        (
            *(m.pole.real, m.pole.imag, m.frequency, m.damping_ratio, *m.shares.values()),
            *(float(value) for value in (*m.dof_shares, *np.abs(m.leg_shape))),
        )
        for m in found.modes
    ]
    write_csv(folder / "modes.csv", header, rows)
    paths.append(folder / "modes.csv")
    if found.comparisons:
        header = ["dof", "frequency", "measured_gain_db", "measured_phase_deg"]
        lines = [
            (name, *(float(value) for value in values))
            for name, c in found.comparisons.items()
            for values in zip(
                c.frequency,
                20.0 * np.log10(np.abs(c.measured)),
                np.degrees(np.angle(c.measured)),
                c.gain_error,
                c.phase_error,
                strict=True,
            )
        ]
        write_csv(folder / "comparison.csv", [*header, "gain_error_db", "phase_error_deg"], lines)
        paths.append(folder / "comparison.csv")
    for name, figure in (
        ("bode", bode_figure(found)),
        ("loop", loop_figure(found)),
        ("poles_zeros", pole_zero_figure(found)),
    ):
        figure.savefig(folder / f"{name}.png", dpi=110)
        paths.append(folder / f"{name}.png")
    return paths
