"""Tables and figures of the hydraulic modes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj import units
from cmf_mj.files import write_csv, write_text
from cmf_mj.kinematics import DOFS
from cmf_mj.modes import ModeSet, PlaneMap, Range, Sweep
from cmf_mj.report import markdown

PLANES = (("surge", "pitch"), ("sway", "roll"), ("heave", "yaw"))
"""Planes of the maps: the two coupled pairs, and the rest."""

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#000000")


def unit_of(dof: str) -> str:
    """Unit in which a degree of freedom is shown."""
    return "in" if DOFS.index(dof) < 3 else "deg"


def _pose_text(modes: ModeSet) -> str:
    if not modes.pose.any():
        return "neutral"
    parts = (
        f"{dof} {size} {unit_of(dof)}"
        for dof, value in zip(DOFS, modes.pose, strict=True)
        if (size := f"{units.from_si(unit_of(dof), value):.1f}") not in ("0.0", "-0.0")
    )
    return ", ".join(parts)


def _composition(shares: NDArray[np.float64]) -> str:
    order = np.argsort(-shares)
    return ", ".join(f"{DOFS[i]} {100.0 * shares[i]:.0f} %" for i in order if shares[i] > 0.02)


def mode_table(modes: ModeSet) -> Table:
    """Frequency, mass a leg feels, and what moves in each mode."""
    table = Table(
        title=f"{modes.cab.upper()}, {_pose_text(modes)}", box=SIMPLE_HEAD, title_justify="left"
    )
    for name in ("mode", "frequency [Hz]", "mass a leg feels [lbm]"):
        table.add_column(name, justify="right")
    table.add_column("share of the kinetic energy")
    for index in range(6):
        table.add_row(
            str(index + 1),
            f"{modes.frequency_hz[index]:.2f}",
            f"{units.from_si('lbm', modes.leg_mass[index]):.0f}",
            _composition(modes.share[:, index]),
        )
    return table


def mass_table(modes: ModeSet) -> Table:
    """The reflected mass, leg by leg."""
    table = Table(
        title=f"reflected mass in lbm, {modes.cab.upper()}", box=SIMPLE_HEAD, title_justify="left"
    )
    table.add_column("leg", justify="right")
    for leg in range(1, 7):
        table.add_column(str(leg), justify="right")
    for leg, row in enumerate(units.from_si("lbm", modes.reflected_mass), 1):
        table.add_row(str(leg), *(f"{value:.0f}" for value in row))
    return table


def range_cells(ranges: Sequence[Range]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of the frequencies over the envelope, a line a cab and mode."""
    lines = []
    for found in ranges:
        low, middle, high = np.percentile(found.frequency_hz, [5.0, 50.0, 95.0], axis=0)
        least = np.minimum(found.frequency_hz.min(axis=0), found.worst.frequency_hz)
        for mode in range(6):
            values = (least[mode], low[mode], middle[mode], high[mode])
            lines.append([found.worst.cab, str(mode + 1), *(f"{value:.2f}" for value in values)])
    return ["cab", "mode", "lowest [Hz]", "5 % below", "half below", "95 % below"], lines


def range_table(ranges: Sequence[Range]) -> Table:
    """The frequencies over the envelope as a terminal table."""
    header, lines = range_cells(ranges)
    table = Table(title="over the envelope", box=SIMPLE_HEAD, title_justify="left")
    for name in header:
        table.add_column(name, justify="right")
    for line in lines:
        table.add_row(*line)
    return table


def sweep_figure(cabs: Sequence[str], sweeps: Sequence[Sequence[Sweep]]) -> Figure:
    """Six modes along each degree of freedom; a line style a cab."""
    figure = Figure(figsize=(10.0, 6.5), layout="constrained")
    panels = figure.subplots(2, 3, sharey=True)
    for cab, style, found in zip(cabs, ("-", "--", ":"), sweeps, strict=False):
        for axis, one in zip(panels.flat, found, strict=True):
            along = units.from_si(unit_of(one.dof), one.excursion)
            for mode in range(6):
                label = cab.upper() if mode == 0 else None
                axis.semilogy(
                    along, one.frequency_hz[:, mode], style, color=_COLOURS[mode], label=label
                )
            axis.set_xlabel(f"{one.dof} [{unit_of(one.dof)}]")
    for axis in panels.flat:
        axis.set_yticks([4, 5, 6, 8, 10, 15, 20, 30], labels="4 5 6 8 10 15 20 30".split())
        axis.minorticks_off()
        axis.grid(True, color="0.9", linewidth=0.6)
    for axis in panels[:, 0]:
        axis.set_ylabel("frequency [Hz]")
    panels[0, 0].legend(fontsize=8, title="lowest mode in blue", title_fontsize=8)
    figure.suptitle("Hydraulic modes along each degree of freedom, all others at neutral")
    return figure


def _draw_map(figure: Figure, axis: Axes, found: PlaneMap) -> None:
    first, second = (
        units.from_si(unit_of(dof), values)
        for dof, values in zip(found.dofs, (found.first, found.second), strict=True)
    )
    lowest = found.frequency_hz[:, :, 0].T
    drawn = axis.contourf(first, second, lowest, levels=12, cmap="viridis")
    lines = axis.contour(first, second, lowest, levels=6, colors="white", linewidths=0.6)
    axis.clabel(lines, fontsize=7, fmt="%.1f")
    figure.colorbar(drawn, ax=axis, format="%.1f")
    axis.plot(0.0, 0.0, "w+")
    axis.set(
        xlabel=f"{found.dofs[0]} [{unit_of(found.dofs[0])}]",
        ylabel=f"{found.dofs[1]} [{unit_of(found.dofs[1])}]",
    )


def map_figure(cabs: Sequence[str], maps: Sequence[Sequence[PlaneMap]]) -> Figure:
    """Lowest mode over planes of the envelope, a row a cab; white outside."""
    figure = Figure(figsize=(11.0, 3.2 * len(cabs)), layout="constrained")
    panels = figure.subplots(len(cabs), len(maps[0]), squeeze=False)
    for cab, row, found in zip(cabs, panels, maps, strict=True):
        for axis, one in zip(row, found, strict=True):
            _draw_map(figure, axis, one)
            axis.set_title(cab.upper(), fontsize=10)
    figure.suptitle("Lowest hydraulic mode [Hz]")
    return figure


def save(
    ranges: Sequence[Range],
    sweeps: Sequence[Sequence[Sweep]],
    maps: Sequence[Sequence[PlaneMap]],
    folder: Path,
) -> list[Path]:
    """Write the figures `modes_sweep.png` and `modes_map.png`, `modes.csv` and `modes.md`.

    The CSV has a line a pose of each cab: excursions in in and deg, six frequencies in Hz, the
    worst pose last. The Markdown is `range_cells`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cabs = [found.worst.cab for found in ranges]
    names = ("modes_sweep.png", "modes_map.png", "modes.csv", "modes.md")
    paths = [folder / name for name in names]
    sweep_figure(cabs, sweeps).savefig(paths[0], dpi=100)
    map_figure(cabs, maps).savefig(paths[1], dpi=100)
    axes = [f"{dof}_{unit_of(dof)}" for dof in DOFS]
    rows: list[tuple[str | float, ...]] = []
    for found in ranges:
        poses = np.vstack([found.poses, found.worst.pose])
        shown = [units.from_si(unit_of(d), poses[:, i]) for i, d in enumerate(DOFS)]
        numbers = [*shown, np.vstack([found.frequency_hz, found.worst.frequency_hz])]
        rows += [(found.worst.cab, *row) for row in np.column_stack(numbers)]
    write_csv(paths[2], ["cab", *axes, *(f"mode_{i}_hz" for i in range(1, 7))], rows, digits=6)
    write_text(paths[3], markdown(*range_cells(ranges)))
    return paths
