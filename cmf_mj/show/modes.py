"""Tables and figures of the hydraulic modes."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.analysis.modes import ModeSet, PlaneMap, Range, Sweep
from cmf_mj.core import units
from cmf_mj.core.files import whole_file, write_csv, write_text
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.comparison import markdown

PLANES = (("surge", "pitch"), ("sway", "roll"), ("heave", "yaw"))
"""Planes of the maps: the two coupled pairs, and the rest."""

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#000000")
_STYLES: tuple[Literal["-", "--", ":"], ...] = ("-", "--", ":")
_SIX = range(1, 7)


_POSE_HEADER = ["cab", *(f"{dof}_{dof_unit(dof)}" for dof in DOFS)]


def title_of(modes: ModeSet, name: str = "") -> str:
    """Cab, name of the pose if it has one, and the pose."""
    parts = (modes.cab.upper(), name, _pose_text(modes))
    return ", ".join(part for part in parts if part)


def _pose_text(modes: ModeSet) -> str:
    if not modes.pose.any():
        return "neutral"
    parts = (
        f"{dof} {size} {dof_unit(dof)}"
        for dof, value in zip(DOFS, modes.pose, strict=True)
        if (size := f"{units.from_si(dof_unit(dof), value):.1f}") not in ("0.0", "-0.0")
    )
    return ", ".join(parts)


def _composition(shares: NDArray[np.float64]) -> str:
    order = np.argsort(-shares)
    return ", ".join(f"{DOFS[i]} {100.0 * shares[i]:.0f} %" for i in order if shares[i] > 0.02)


def mode_table(modes: ModeSet, name: str = "") -> Table:
    """Frequency, mass a leg feels, and what moves in each mode; `name` is the pose's."""
    table = Table(title=title_of(modes, name), box=SIMPLE_HEAD, title_justify="left")
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
    figure = Figure(figsize=(10.0, 6.8), layout="constrained")
    panels = figure.subplots(2, 3, sharey=True)
    for style, found in zip(_STYLES, sweeps, strict=False):
        for axis, one in zip(panels.flat, found, strict=True):
            along = units.from_si(dof_unit(one.dof), one.excursion)
            for mode, colour in enumerate(_COLOURS):
                axis.semilogy(along, one.frequency_hz[:, mode], style, color=colour)
            axis.set_xlabel(_axis_text(one.dof))
    for axis in panels.flat:
        axis.set_yticks([4, 5, 6, 8, 10, 15, 20, 30], labels="4 5 6 8 10 15 20 30".split())
        axis.minorticks_off()
        axis.grid(True, color="0.9", linewidth=0.6)
    for axis in panels[:, 0]:
        axis.set_ylabel("frequency [Hz]")
    entries = [Line2D([], [], color=c, label=f"mode {i}") for i, c in enumerate(_COLOURS, 1)]
    entries += [
        Line2D([], [], color="0.3", linestyle=style, label=cab.upper())
        for cab, style in zip(cabs, _STYLES, strict=False)
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), fontsize=8)
    figure.suptitle("Hydraulic modes along each degree of freedom, all others at neutral")
    return figure


def _axis_text(dof: str) -> str:
    return f"{dof} [{dof_unit(dof)}]" + (", down" if dof == "heave" else "")


def map_figure(cabs: Sequence[str], maps: Sequence[Sequence[PlaneMap]]) -> Figure:
    """Lowest mode over planes of the envelope, a row a cab, a scale a plane; white outside."""
    figure = Figure(figsize=(11.0, 3.0 * len(cabs) + 1.0), layout="constrained")
    panels = figure.subplots(len(cabs), len(maps[0]), squeeze=False, sharex="col", sharey="col")
    for column, found in zip(panels.T, zip(*maps, strict=True), strict=True):
        lowest = [one.frequency_hz[..., 0] for one in found]
        levels = MaxNLocator(14).tick_values(
            min(float(values.min()) for values in lowest),
            max(float(values.max()) for values in lowest),
        )
        for cab, axis, one, values in zip(cabs, column, found, lowest, strict=True):
            first, second = (
                units.from_si(dof_unit(dof), along)
                for dof, along in zip(one.dofs, (one.first, one.second), strict=True)
            )
            drawn = axis.contourf(first, second, values, levels=levels, cmap="viridis")
            axis.contour(first, second, values, levels=levels, colors="white", linewidths=0.4)
            axis.plot(0.0, 0.0, "w+")
            axis.set_title(cab.upper(), fontsize=10)
            axis.set_ylabel(_axis_text(one.dofs[1]))
        column[-1].set_xlabel(_axis_text(found[0].dofs[0]))
        figure.colorbar(drawn, ax=list(column), location="bottom", label="frequency [Hz]")
    figure.suptitle("Lowest hydraulic mode, all other degrees of freedom at neutral")
    return figure


def _pose_cells(modes: ModeSet) -> list[str]:
    shown = (units.from_si(dof_unit(d), v) for d, v in zip(DOFS, modes.pose, strict=True))
    return [modes.cab, *_numbers(shown)]


def _numbers(values: Iterable[float]) -> list[str]:
    # Round-off of what is zero is written as 0.
    return [f"{round(value, 12) + 0.0:.6g}" for value in values]


def _write_lines(path: Path, header: Sequence[str], lines: Iterable[Sequence[str]]) -> Path:
    return write_csv(path, [*_POSE_HEADER, *header], lines)


def _write_figure(figure: Figure, path: Path) -> Path:
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=100, format="png")
    return path


def save_envelope(
    ranges: Sequence[Range],
    sweeps: Sequence[Sequence[Sweep]],
    maps: Sequence[Sequence[PlaneMap]],
    folder: Path,
) -> list[Path]:
    """Write the figures `modes_sweep.png` and `modes_map.png`, `modes.csv` and `modes.md`.

    The CSV has a line a pose of each cab: excursions in in and deg, six frequencies in Hz, the
    worst pose last. The Markdown is `range_cells`.
    """
    cabs = [found.worst.cab for found in ranges]
    lines = (
        [*_pose_cells(modes), *_numbers(modes.frequency_hz)]
        for found in ranges
        for modes in (*found.modes, found.worst)
    )
    paths = [
        _write_figure(sweep_figure(cabs, sweeps), folder / "modes_sweep.png"),
        _write_figure(map_figure(cabs, maps), folder / "modes_map.png"),
        _write_lines(folder / "modes.csv", [f"mode_{i}_hz" for i in _SIX], lines),
    ]
    return [*paths, write_text(folder / "modes.md", markdown(*range_cells(ranges)))]


def save_modes(modes: Iterable[ModeSet], folder: Path) -> list[Path]:
    """Write `reflected_mass.csv` and `mode_shapes.csv`, six lines a cab and pose.

    The first has a row of the (6, 6) reflected mass a line, in lbm. The second a mode a line:
    frequency, mass a leg feels, shares of the kinetic energy, the legs' motion with its largest
    part 1, and the platform's that goes with 1 in of it, in in and deg.
    """
    each = list(modes)
    masses = (
        [*_pose_cells(found), str(leg), *_numbers(row)]
        for found in each
        for leg, row in enumerate(units.from_si("lbm", found.reflected_mass), 1)
    )
    header = ["leg", *(f"leg_{i}_lbm" for i in _SIX)]
    first = _write_lines(folder / "reflected_mass.csv", header, masses)
    header = ["mode", "frequency_hz", "leg_mass_lbm", *(f"share_{dof}" for dof in DOFS)]
    header += [f"leg_{i}" for i in _SIX] + [f"{dof}_{dof_unit(dof)}_per_in" for dof in DOFS]
    shapes = ([*_pose_cells(m), *_mode_cells(m, mode)] for m in each for mode in range(6))
    return [first, _write_lines(folder / "mode_shapes.csv", header, shapes)]


def _mode_cells(modes: ModeSet, mode: int) -> list[str]:
    legs = modes.leg_shape[:, mode]
    largest = legs[np.abs(legs).argmax()]
    # Per metre of the largest leg motion, hence per inch what 0.0254 m make.
    moved = units.to_si("in", 1.0) * modes.pose_shape[:, mode] / largest
    return [
        str(mode + 1),
        *_numbers([modes.frequency_hz[mode], units.from_si("lbm", modes.leg_mass[mode])]),
        *_numbers(modes.share[:, mode]),
        *_numbers(legs / largest),
        *_numbers(units.from_si(dof_unit(d), v) for d, v in zip(DOFS, moved, strict=True)),
    ]
