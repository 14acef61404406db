"""Live plots of a tab, in the field's units: uPlot draws thousands of points without effort."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.look import COLOURS

DARK, PALE = "#222222", "#8a9099"
DASHED = (5.0, 4.0)


class Line(NamedTuple):
    """One line of a plot."""

    label: str
    colour: str
    dash: tuple[float, ...] = ()


def add_plot(
    client: viser.ClientHandle,
    title: str,
    lines: Sequence[Line],
    soft: tuple[float, float],
    *,
    frequency: bool = False,
) -> viser.GuiUplotHandle:
    """Add an empty plot over time, or over frequency on a logarithmic axis.

    The axis has at least the limits `soft`, so that round-off does not fill it.
    """
    low, high = ({"pad": 0.1, "soft": limit, "mode": 1} for limit in soft)
    series = [uplot.Series(label="f [Hz]" if frequency else "t [s]")]
    for line in lines:
        series.append(uplot.Series(label=line.label, stroke=line.colour, width=1.5))
        if line.dash:
            series[-1]["dash"] = line.dash
    font, ticks = "11px sans-serif", uplot.Axis_Ticks(size=4, width=1)
    across = uplot.Scale(time=False, distr=3) if frequency else uplot.Scale(time=False)
    # A logarithmic axis needs ends above zero.
    ends, empty = np.array([0.1, 10.0]), np.full(2, np.nan)
    return client.gui.add_uplot(
        (ends, *[empty if frequency else np.zeros(2)] * len(lines)),
        tuple(series),
        title=title,
        scales={"x": across, "y": uplot.Scale(range={"min": low, "max": high})},
        axes=(
            uplot.Axis(size=34, font=font, ticks=ticks, gap=4),
            uplot.Axis(size=46, font=font, ticks=ticks),
        ),
        legend=uplot.Legend(show=True, live=False),
        height=230 if frequency else 150,
        padding=(10, 12, 0, 0),
    )


class Plots:
    """The five plots of a tab."""

    def __init__(self, client: viser.ClientHandle) -> None:
        """Add them to the container in force."""
        blue, orange = COLOURS[:2]
        legs = [Line(str(leg), colour) for leg, colour in zip(range(1, 7), COLOURS, strict=False)]
        both = [Line("demand", DARK, DASHED), Line("response", blue)]
        sides = [Line("cap", blue), Line("rod", orange)]
        manifolds = [Line("supply", DARK), Line("return", PALE, DASHED)]
        self._response = {
            unit: add_plot(client, f"platform [{unit}]", both, (-0.05, 0.05))
            for unit in ("in", "deg")
        }
        self._force = add_plot(client, "leg forces [kN]", legs, (20.0, 40.0))
        self._valve = add_plot(client, "valve commands [%]", legs, (-2.0, 2.0))
        self._pressure = add_plot(client, "pressures of the leg [psi]", sides, (0.0, 1000.0))
        self._supply = add_plot(client, "manifolds [psi]", manifolds, (0.0, 2000.0))

    def show(self, traces: Mapping[str, NDArray[np.float64]], dof: str, leg: int) -> None:
        """Draw the rows of `Traces.last`: a degree of freedom, and pressures of a leg from 0."""
        time, index, unit = traces["time"], DOFS.index(dof), dof_unit(dof)
        if time.size < 2:
            return

        def columns(name: str, in_unit: str) -> list[NDArray[np.float64]]:
            return list(np.ascontiguousarray(units.from_si(in_unit, traces[name]).T))

        def one(column: int, in_unit: str, *names: str) -> list[NDArray[np.float64]]:
            return [columns(name, in_unit)[column] for name in names]

        for name, plot in self._response.items():
            plot.visible = name == unit
        self._response[unit].data = (time, *one(index, unit, "demand_pose", "platform_pose"))
        self._force.data = (time, *columns("leg_force", "kN"))
        self._valve.data = (time, *columns("valve_command", "%"))
        self._pressure.data = (time, *one(leg, "psi", "cap_pressure", "rod_pressure"))
        self._supply.data = (time, *one(0, "psi", "supply_pressure", "return_pressure"))
