"""The figure of a run: operating state, motion, leg errors, valve commands, pressures, supply."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cmf_mj.control.states import State
from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.record import Record
from cmf_mj.show.look import COLOURS, DARK, GREY, legend, shade, stack

_LEAST = 1e-9
"""Demand below which a degree of freedom is at rest [m or rad]."""


def overview_figure(
    record: Record, title: str = "", changes: Iterable[float] = (), events: Iterable[float] = ()
) -> Figure:
    """Demand and response, errors, valve commands, pressures and supply of a run.

    A run of the facility gets its operating state, shaded where the host was silent; changes are
    dotted lines, events dashed ones [s]; the title is by default plant and law.
    """
    time, state = record.time, "operating_state" in record.channels
    labels = ["", "", "leg error [in]", "valve command [%]", "cap (-), rod (--) [psi]"]
    labels, heights = [*labels, "supply [psi]"], (1.2, 2.4, 1.6, 1.6, 2.0, 1.2)
    first = 0 if state else 1
    figure, axes = stack(9.0, 11.0 if state else 9.6, *labels[first:], ratios=heights[first:])
    if state:
        _operating(axes[0], record)
    motion, error, valve, pressure, supply = axes[-5:]
    plot_motion(motion, record)
    missing = (record["leg_reference"] - record["leg_extension"]) / units.INCH
    error.plot(time, missing, lw=0.8, label=[f"leg {leg + 1}" for leg in range(missing.shape[1])])
    valve.plot(time, 100.0 * record["valve_command"], lw=0.8)
    for side, line in (("cap", "-"), ("rod", "--")):
        pressure.set_prop_cycle(color=COLOURS)
        pressure.plot(time, record[f"{side}_pressure"] / units.PSI, line, lw=0.8)
    supply.plot(time, record["supply_pressure"] / units.PSI, color=DARK, lw=1.0, label="supply")
    supply.plot(time, record["return_pressure"] / units.PSI, color=GREY, lw=1.0, label="return")
    supply.set_ylim(bottom=0.0)
    times = [*((at, "0.4", ":") for at in changes), *((at, "#b00020", "--") for at in events)]
    for axis in axes:
        axis.tick_params(labelsize=8)
        axis.yaxis.label.set_fontsize(9)
        for at, colour, line in times:
            axis.axvline(at, color=colour, ls=line, lw=0.9)
    style: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "frameon": False}
    legend(motion, error, supply, fontsize=7, **style)
    figure.align_ylabels(axes)
    figure.suptitle(title or f"{record.metadata['plant']}, {record.metadata['law']}")
    return figure


def _operating(axis: Axes, record: Record) -> None:
    axis.step(record.time, record["operating_state"], where="post", color=DARK, lw=1.0)
    axis.set_yticks([int(code) for code in State], [code.name.lower() for code in State])
    axis.set_ylim(-0.5, len(State) - 0.5)
    if "host_stale" in record.channels:
        shade(axis, record.time, record["host_stale"] > 0.5)
        axis.set_title("operating state; shaded: no stream from the host", fontsize=9)


def plot_motion(axis: Axes, record: Record) -> None:
    """Demand, grey, and response of what is moved; lengths in in, angles in deg."""
    demand, time = record["demand_pose"], record.time
    moved = np.flatnonzero(np.ptp(demand, axis=0) > _LEAST)
    pose = record.channels.get("platform_pose")
    if pose is None:
        axis.plot(time, record["leg_reference"] / units.INCH, color="0.7", lw=2.0)
        axis.set_prop_cycle(color=COLOURS)
        reached = record["leg_extension"] / units.INCH
        axis.plot(time, reached, lw=0.9, label=[f"leg {n + 1}" for n in range(reached.shape[1])])
        axis.set_ylabel("legs [in]", fontsize=9)
        return
    for index in moved if moved.size else range(6):
        unit = dof_unit(int(index))
        demanded, reached = (units.from_si(unit, values[:, index]) for values in (demand, pose))
        axis.plot(time, demanded, color="0.7", lw=2.0)
        axis.plot(time, reached, color=COLOURS[index], lw=0.9, label=f"{DOFS[index]} [{unit}]")
    axis.set_ylabel("demand (grey), response", fontsize=9)
