"""Tables, figures and files of a linearised plant: modes, Bode diagrams, loops of a law."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import control
import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.frequency_response import bandwidths
from cmf_mj.analysis.linear.poles import Mode
from cmf_mj.analysis.measures import joined
from cmf_mj.core.files import write_text
from cmf_mj.core.table import Cell, Table
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show.comparison import phase_text
from cmf_mj.show.look import bode_axes, legend, plot_bode, pose_text, save_files
from cmf_mj.studies.linearization import FREQUENCIES, LinearizationStudy


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


def _mode_cells(alike: Sequence[Mode]) -> list[str]:
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


def mode_table(study: LinearizationStudy) -> Table:
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
        [_mode_cells(alike) for alike in groups],
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
