"""Tables, figures and files of a linearised plant, and of hydraulic modes over the envelope."""

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any, Literal, NamedTuple

import control
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.poles import Mode, dof_model, leg_model, reduced
from cmf_mj.analysis.measures import are_stable, joined
from cmf_mj.analysis.modes import EnvelopeModes, PlaneMap, Sweep
from cmf_mj.core import units
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Cell, Table
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.plant.hexapod import HydraulicModes
from cmf_mj.show.comparison import phase_text
from cmf_mj.show.look import (
    COLOURS,
    DARK,
    bode_axes,
    legend,
    new_figure,
    plot_bode,
    pose_text,
    save_files,
)

FREQUENCIES = np.geomspace(0.1, 20.0, 400)
"""Lines of the responses [Hz]."""


class LinearizationStudy(NamedTuple):
    """A plant linearised in a configuration, with loops of one law."""

    linear: Linear
    law: str
    modes: tuple[Mode, ...]
    responses: dict[str, FrequencyResponse]  #: Position per command, by degree of freedom or leg.
    loops: dict[str, FrequencyResponse]  #: Demand to position under the law.
    stable: bool  #: The verdict on all of these loops.


def linearization_study(linear: Linear, law: str, signals: Sequence[str]) -> LinearizationStudy:
    """Close a law around a linearised plant; `signals` are degrees of freedom or legs."""
    responses, loops = {}, {name: linear.loop(law, name) for name in signals}
    for name in signals:
        if name.startswith("leg_"):
            moved = reduced(leg_model(linear.system, int(name[4:])), outputs=["leg_position"])
        else:
            model = dof_model(linear.system, linear.plant, linear.pose, name)
            moved = reduced(model, outputs=[name])
        responses[name] = loop_response(moved, FREQUENCIES)
    closed = {name: loop_response(loop, FREQUENCIES) for name, loop in loops.items()}
    stable = all(are_stable(loop.poles()) for loop in loops.values())
    return LinearizationStudy(linear, law, linear.modes(), responses, closed, stable)


def save_system(system: control.StateSpace, path: Path, description: Mapping[str, Any]) -> Path:
    """Write a state space as JSON; numbers read back bit for bit.

    `A` to `D`, `sampling_time` and the labels make a `control.ss` of it again; `description` are
    plain JSON values kept with it, such as plant and pose.
    """
    content: dict[str, Any] = {
        "name": system.name,
        "sampling_time": system.dt,
        "units": "SI; commands as fractions; angles in rad",
        "description": dict(description),
    }
    labels = ("input_labels", "output_labels", "state_labels")
    content |= {name: list(getattr(system, name)) for name in labels}
    content |= {name: np.asarray(getattr(system, name)).tolist() for name in "ABCD"}
    return write_text(path, json.dumps(content, allow_nan=False) + "\n")


_NAMED = 0.1
"""Share from which on a kind of state or a degree of freedom is named."""


def _title(study: LinearizationStudy) -> str:
    plant, pose = study.linear.plant, np.asarray(study.linear.pose, dtype=float)
    name = f"{plant.name} {plant.cab}".strip().replace("_", " ")
    return f"{name}, {plant.parameters.name}, {pose_text(pose)}"


def _largest(names: Sequence[str], shares: Sequence[float]) -> str:
    order = sorted(zip(names, shares, strict=True), key=lambda item: -item[1])
    return ", ".join(f"{name} {share:.2f}" for name, share in order if share >= _NAMED)


def _pole_cells(alike: Sequence[Mode]) -> list[str]:
    """A row of the table: a mode, or several whose poles coincide."""
    mode = alike[0]
    pole, still = mode.pole, np.isnan(mode.damping_ratio)
    text = f"{pole.real:.4g}" + (f" ± {pole.imag:.4g}j" if pole.imag > 0.0 else "")
    cells = [
        "0" if still else text,
        str(len(alike)),
        "0" if still else f"{mode.frequency / (2.0 * np.pi):.3g}",
        "-" if still else f"{mode.damping_ratio:.3f}",
        _largest(list(mode.shares), list(mode.shares.values())),
    ]
    if len(alike) > 1 or mode.shares["motion"] + mode.shares["oil"] < _NAMED:
        return [*cells, "", ""]
    legs = " ".join(f"{size:.2f}" for size in np.abs(mode.leg_shape))
    return [*cells, _largest(DOFS, list(mode.dof_shares)), legs]


def pole_table(study: LinearizationStudy) -> Table:
    """All modes: pole, frequency, damping, what takes part."""
    groups: list[list[Mode]] = []
    for mode in study.modes:
        if groups and np.isclose(mode.pole, groups[-1][0].pole, rtol=1e-6, atol=1e-6):
            groups[-1].append(mode)
        else:
            groups.append([mode])
    numbers = (("times", ""), ("Hz", ""), ("damping", ""))
    return Table(
        f"modes: {_title(study)}",
        ("pole [rad/s]", *numbers, "states", "degrees of freedom", "legs"),
        [_pole_cells(alike) for alike in groups],
        "shares of states by participation factors, of degrees of freedom in the leg "
        "motion; legs: size of their motion. Poles that coincide share a line and have no shapes.",
    )


def loop_table(study: LinearizationStudy) -> Table:
    """Bandwidths of the law's loops."""
    rows = []
    for name, loop in study.loops.items():
        measures = joined(bandwidths(loop))
        cells: list[Cell] = (
            [phase_text(measures), *measures[1:3]] if study.stable else ["unstable"] * 3
        )
        rows.append((name, *cells))
    widths = (("-90 deg [Hz]", ".2f"), ("-3 dB [Hz]", ".2f"), ("peak [dB]", ".2f"))
    return Table(
        f"{study.law} around the linearised plant",
        ("dof", *widths),
        rows,
        f"'-': not reached below {FREQUENCIES[-1]:g} Hz",
    )


def bode_figure(study: LinearizationStudy) -> Figure:
    """Position per command of every degree of freedom or leg."""
    figure, gain, phase = bode_axes(f"Position per command, all legs by J\n{_title(study)}")
    for name, response in study.responses.items():
        plot_bode(gain, phase, response, label=name)
    gain.set(ylabel="gain [dB of m]")
    legend(gain)
    return figure


def loop_figure(study: LinearizationStudy) -> Figure:
    """The law's loops."""
    unstable = "" if study.stable else ", unstable"
    title = f"Demand to position, {study.law}{unstable}\n{_title(study)}"
    figure, gain, phase = bode_axes(title, limits=True)
    for name, loop in study.loops.items():
        plot_bode(gain, phase, loop, label=name, stable=study.stable)
    legend(gain)
    return figure


def save_study(study: LinearizationStudy, folder: Path) -> list[Path]:
    """Write the state space as JSON, modes as CSV, all figures as PNG."""
    point, plant = study.linear.point, study.linear.plant
    description = {
        **{k: v for k, v in plant.describe().items() if k != "hydraulic_parameters"},
        "pose": np.asarray(study.linear.pose, dtype=float).tolist(),
        "leg_position": point.mechanics.extension.tolist(),
        "static_load": point.mechanics.load.tolist(),
        "command": point.command.tolist(),
        "chamber_pressure": point.pressure.tolist(),
        "supply_pressure": point.supply_pressure,
        "return_pressure": point.return_pressure,
        "outward_share": point.outward.tolist(),
    }
    system = partial(save_system, study.linear.system, description=description)
    files: dict[str, Any] = {"state_space.json": system}
    first = study.modes[0]
    header = [
        *("real", "imaginary", "frequency", "damping_ratio"),
        *(f"share_{name}" for name in (*first.shares, *DOFS)),
        *(f"leg_{i + 1}" for i in range(first.leg_shape.size)),
    ]
    rows = [
        (
            *(m.pole.real, m.pole.imag, m.frequency, m.damping_ratio, *m.shares.values()),
            *(float(value) for value in (*m.dof_shares, *np.abs(m.leg_shape))),
        )
        for m in study.modes
    ]
    files["modes.csv"] = (header, rows)
    files |= {"bode.png": bode_figure(study), "loop.png": loop_figure(study)}
    return save_files(files, folder)


PLANES = (("surge", "pitch"), ("sway", "roll"), ("heave", "yaw"))
"""Planes of the maps: the two coupled pairs, and the rest."""

_STYLES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")
_SIX = range(1, 7)
_POSE_HEADER = ["cab", *(f"{dof}_{dof_unit(dof)}" for dof in DOFS)]


def title_of(modes: HydraulicModes, name: str = "") -> str:
    """Cab, name of the pose if it has one, and the pose."""
    parts = (modes.cab.upper(), name, pose_text(modes.pose, ".1f"))
    return ", ".join(part for part in parts if part)


def mode_table(modes: HydraulicModes, name: str = "") -> Table:
    """Frequency, mass a leg feels, and what moves in each mode; `name` is the pose's."""
    rows = []
    for i, shares in enumerate(modes.share.T):
        order = [k for k in np.argsort(-shares) if shares[k] > 0.02]
        moving = ", ".join(f"{DOFS[k]} {100.0 * shares[k]:.0f} %" for k in order)
        mass = units.from_si("lbm", modes.leg_mass[i])
        rows.append((str(i + 1), modes.frequency_hz[i], mass, moving))
    numbers = (("mode", ""), ("frequency [Hz]", ".2f"), ("mass a leg feels [lbm]", ".0f"))
    return Table(title_of(modes, name), (*numbers, "share of the kinetic energy"), rows)


def mass_table(modes: HydraulicModes) -> Table:
    """The reflected mass, leg by leg."""
    masses = units.from_si("lbm", modes.reflected_mass)
    columns = (("leg", ""), *((str(leg), ".0f") for leg in _SIX))
    rows = [(str(leg), *row) for leg, row in zip(_SIX, masses, strict=True)]
    return Table(f"reflected mass in lbm, {modes.cab.upper()}", columns, rows)


def range_table(ranges: Sequence[EnvelopeModes]) -> Table:
    """The frequencies over the envelope, a row a cab and mode."""
    rows = []
    for each in ranges:
        shares = np.percentile(each.frequency_hz, [5.0, 50.0, 95.0], axis=0)
        least = np.minimum(each.frequency_hz.min(axis=0), each.worst.frequency_hz)
        rows += [(each.worst.cab, str(i + 1), least[i], *shares[:, i]) for i in range(6)]
    names = ("lowest [Hz]", "5 % below", "half below", "95 % below")
    columns = (("cab", ""), ("mode", ""), *((name, ".2f") for name in names))
    return Table("over the envelope", columns, rows)


def sweep_figure(cabs: Sequence[str], sweeps: Sequence[Sequence[Sweep]]) -> Figure:
    """Six modes along each degree of freedom; a line style a cab."""
    figure = new_figure(10.0, 6.8)
    panels = figure.subplots(2, 3, sharey=True)
    for style, of_cab in zip(cycle(_STYLES), sweeps, strict=False):
        for axis, one in zip(panels.flat, of_cab, strict=True):
            along = units.from_si(dof_unit(one.dof), one.excursion)
            for mode, colour in zip(one.frequency_hz.T, COLOURS, strict=False):
                axis.semilogy(along, mode, style, color=colour)
            axis.set_xlabel(_axis_text(one.dof))
    for axis in panels.flat:
        axis.set_yticks([4, 5, 6, 8, 10, 15, 20, 30], labels="4 5 6 8 10 15 20 30".split())
        axis.minorticks_off()
    for axis in panels[:, 0]:
        axis.set_ylabel("frequency [Hz]")
    entries = [Line2D([], [], color=COLOURS[i - 1], label=f"mode {i}") for i in _SIX]
    entries += [
        Line2D([], [], color=DARK, linestyle=style, label=cab.upper())
        for cab, style in zip(cabs, cycle(_STYLES), strict=False)
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), fontsize=8)
    figure.suptitle("Hydraulic modes along each degree of freedom, all others at neutral")
    return figure


def _axis_text(dof: str) -> str:
    return f"{dof} [{dof_unit(dof)}]" + (", down" if dof == "heave" else "")


def map_figure(cabs: Sequence[str], maps: Sequence[Sequence[PlaneMap]]) -> Figure:
    """Lowest mode over planes of the envelope, a row a cab, a scale a plane; white outside."""
    figure = new_figure(11.0, 3.0 * len(cabs) + 1.0, gridded=False)
    panels = figure.subplots(len(cabs), len(maps[0]), squeeze=False, sharex="col", sharey="col")
    for column, planes in zip(panels.T, zip(*maps, strict=True), strict=True):
        lowest = [one.frequency_hz[..., 0] for one in planes]
        levels = MaxNLocator(14).tick_values(float(np.min(lowest)), float(np.max(lowest)))
        for cab, axis, one, values in zip(cabs, column, planes, lowest, strict=True):
            first, second = (
                units.from_si(dof_unit(dof), along)
                for dof, along in zip(one.dofs, (one.first, one.second), strict=True)
            )
            drawn = axis.contourf(first, second, values, levels=levels, cmap="viridis")
            axis.contour(first, second, values, levels=levels, colors="white", linewidths=0.4)
            axis.plot(0.0, 0.0, "w+")
            axis.set_title(cab.upper(), fontsize=10)
            axis.set_ylabel(_axis_text(one.dofs[1]))
        column[-1].set_xlabel(_axis_text(planes[0].dofs[0]))
        figure.colorbar(drawn, ax=list(column), location="bottom", label="frequency [Hz]")
    figure.suptitle("Lowest hydraulic mode, all other degrees of freedom at neutral")
    return figure


def _numbers(values: Iterable[float]) -> list[str]:
    # Round-off of what is zero is written as 0.
    return [f"{round(value, 12) + 0.0:.6g}" for value in values]


def _in_units(pose: NDArray[np.float64]) -> list[str]:
    return _numbers(units.from_si(dof_unit(d), v) for d, v in zip(DOFS, pose, strict=True))


def _pose_cells(modes: HydraulicModes) -> list[str]:
    return [modes.cab, *_in_units(modes.pose)]


def save_envelope(
    ranges: Sequence[EnvelopeModes],
    sweeps: Sequence[Sequence[Sweep]],
    maps: Sequence[Sequence[PlaneMap]],
    folder: Path,
) -> list[Path]:
    """Write the figures `modes_sweep.png` and `modes_map.png`, `modes.csv` and `modes.md`.

    The CSV has a line a pose of each cab: excursions in in and deg, six frequencies in Hz, the
    worst pose last. The Markdown is `range_table`.
    """
    cabs = [each.worst.cab for each in ranges]
    header = [*_POSE_HEADER, *(f"mode_{i}_hz" for i in _SIX)]
    rows = (
        [*_pose_cells(modes), *_numbers(modes.frequency_hz)]
        for each in ranges
        for modes in (*each.modes, each.worst)
    )
    files = {
        "modes_sweep.png": sweep_figure(cabs, sweeps),
        "modes_map.png": map_figure(cabs, maps),
        "modes.csv": (header, rows),
        "modes.md": range_table(ranges).save,
    }
    return save_files(files, folder, 100)


def save_modes(modes: Iterable[HydraulicModes], folder: Path) -> list[Path]:
    """Write `reflected_mass.csv` and `mode_shapes.csv`, six lines a cab and pose.

    The first has a row of the (6, 6) reflected mass a line, in lbm. The second a mode a line:
    frequency, mass a leg feels, shares of the kinetic energy, the legs' motion with its largest
    part 1, and the platform's that goes with 1 in of it, in in and deg.
    """
    each = list(modes)
    masses = (
        [*_pose_cells(one), str(leg), *_numbers(row)]
        for one in each
        for leg, row in enumerate(units.from_si("lbm", one.reflected_mass), 1)
    )
    of_masses = [*_POSE_HEADER, "leg", *(f"leg_{i}_lbm" for i in _SIX)]
    of_shapes = [*_POSE_HEADER, "mode", "frequency_hz", "leg_mass_lbm"]
    of_shapes += [*(f"share_{dof}" for dof in DOFS), *(f"leg_{i}" for i in _SIX)]
    of_shapes += [f"{dof}_{dof_unit(dof)}_per_in" for dof in DOFS]
    shapes = ([*_pose_cells(m), *_mode_cells(m, mode)] for m in each for mode in range(6))
    files = {"reflected_mass.csv": (of_masses, masses), "mode_shapes.csv": (of_shapes, shapes)}
    return save_files(files, folder)


def _mode_cells(modes: HydraulicModes, mode: int) -> list[str]:
    legs = modes.leg_shape[:, mode]
    largest = legs[np.abs(legs).argmax()]
    # Per metre of the largest leg motion, hence per inch what 0.0254 m make.
    moved = units.to_si("in", 1.0) * modes.pose_shape[:, mode] / largest
    mass = units.from_si("lbm", modes.leg_mass[mode])
    numbers = (modes.frequency_hz[mode], mass, *modes.share[:, mode], *(legs / largest))
    return [str(mode + 1), *_numbers(numbers), *_in_units(moved)]
