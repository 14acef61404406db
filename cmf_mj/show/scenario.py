"""The figure and the files of a scenario's run."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cmf_mj.control.states import State
from cmf_mj.core import units
from cmf_mj.core.files import whole_file
from cmf_mj.core.rates import RATE
from cmf_mj.facility.scenario.settings import Scenario, save_scenario
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.record.record import Record
from cmf_mj.show.film.film import FilmSettings, film

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""One a leg or a degree of freedom."""

_LEAST = 1e-9
"""Demand below which a degree of freedom is at rest [m or rad]."""


def overview_figure(record: Record, scenario: Scenario) -> Figure:
    """Demand and response, errors, valve commands, pressures and supply of a run.

    Dotted lines mark the changes, dashed ones the failures.
    """
    time, state = record.time, "operating_state" in record.channels
    figure = Figure(figsize=(9.0, 11.0 if state else 9.6), layout="constrained")
    heights = [*((1.2,) if state else ()), 2.4, 1.6, 1.6, 2.0, 1.2]
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    if state:
        _operating(axes[0], record)
    motion, error, valve, pressure, supply = axes[-5:]
    _motion(motion, record)
    missing = (record["leg_reference"] - record["leg_extension"]) / units.INCH
    for leg in range(missing.shape[1]):
        look = {"color": _COLOURS[leg % 6], "lw": 0.8, "label": f"leg {leg + 1}"}
        error.plot(time, missing[:, leg], **look)
        valve.plot(time, 100.0 * record["valve_command"][:, leg], **look)
        pressure.plot(time, record["cap_pressure"][:, leg] / units.PSI, **look)
        look |= {"ls": "--", "label": None}
        pressure.plot(time, record["rod_pressure"][:, leg] / units.PSI, **look)
    supply.plot(time, record["supply_pressure"] / units.PSI, color="0.2", lw=1.0, label="supply")
    supply.plot(time, record["return_pressure"] / units.PSI, color="0.6", lw=1.0, label="return")
    for axis, label in (
        (error, "leg error [in]"),
        (valve, "valve command [%]"),
        (pressure, "cap (-), rod (--) [psi]"),
        (supply, "supply [psi]"),
    ):
        axis.set_ylabel(label, fontsize=9)
    supply.set_ylim(bottom=0.0)
    supply.set_xlabel("time [s]")
    for axis in axes:
        axis.grid(True, color="0.92", linewidth=0.6)
        axis.tick_params(labelsize=8)
        for change in scenario.change:
            axis.axvline(change.when() / RATE, color="0.4", ls=":", lw=0.9)
        for event in scenario.event:
            axis.axvline(event.at, color="#b00020", ls="--", lw=0.9)
    for axis in (motion, error, supply):
        axis.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    figure.align_ylabels(axes)
    figure.suptitle(scenario.title or f"{record.metadata['plant']}, {record.metadata['law']}")
    return figure


def _operating(axis: Axes, record: Record) -> None:
    axis.step(record.time, record["operating_state"], where="post", color="0.2", lw=1.0)
    axis.set_yticks([int(code) for code in State], [code.name.lower() for code in State])
    axis.set_ylim(-0.5, len(State) - 0.5)


def _motion(axis: Axes, record: Record) -> None:
    """Demand, grey, and response of what is moved; lengths in in, angles in deg."""
    demand, time = record["demand_pose"], record.time
    moved = np.flatnonzero(np.ptp(demand, axis=0) > _LEAST)
    found = record.channels.get("platform_pose")
    if found is None:
        for leg in range(record["leg_reference"].shape[1]):
            wanted, is_ = (
                record[f"leg_{n}"][:, leg] / units.INCH for n in ("reference", "extension")
            )
            axis.plot(time, wanted, color="0.7", lw=2.0)
            axis.plot(time, is_, color=_COLOURS[leg % 6], lw=0.9, label=f"leg {leg + 1}")
        axis.set_ylabel("legs [in]", fontsize=9)
        return
    for index in moved if moved.size else range(6):
        unit = dof_unit(int(index))
        scale = units.factor(unit)
        axis.plot(time, demand[:, index] / scale, color="0.7", lw=2.0)
        label = f"{DOFS[index]} [{unit}]"
        axis.plot(time, found[:, index] / scale, color=_COLOURS[index], lw=0.9, label=label)
    axis.set_ylabel("demand (grey), response", fontsize=9)


def save_run(
    record: Record,
    scenario: Scenario,
    folder: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write what a scenario asks for under `outputs`, and the scenario itself.

    Args:
        record: of the run.
        scenario: that was run; written as `scenario.toml`, with absolute names of the files in it.
        folder: made if it is not there.
        progress: called with the pictures of the film done and those in all.

    Raises:
        InputError: a film that cannot be made; the message says why.
    """
    outputs, paths = scenario.outputs, [save_scenario(scenario, folder / "scenario.toml")]
    if outputs.record:
        paths.append(record.save(folder / outputs.record))
    if outputs.plot:
        target = folder / outputs.plot
        with whole_file(target) as partial:
            figure = overview_figure(record, scenario)
            figure.savefig(partial, dpi=110, format=target.suffix[1:])
        paths.append(target)
    if outputs.video is not None:
        video = outputs.video
        settings = FilmSettings(fps=video.fps, speed=video.speed, camera=video.camera)
        paths.append(film([record], folder / video.file, settings, progress=progress))
    return paths
