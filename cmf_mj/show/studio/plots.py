"""Live plots of a tab, in the field's units: uPlot draws thousands of points without effort."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS

LEG_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b")
_BLACK, _BLUE, _ORANGE, _GREY = "#222222", "#1f77b4", "#ff7f0e", "#8a9099"

_HEIGHT = 150
_EMPTY = np.zeros(2)


class _Line(NamedTuple):
    label: str
    colour: str
    dash: tuple[float, ...] = ()


def axes() -> tuple[uplot.Axis, uplot.Axis]:
    """Axes with small figures and thin ticks."""
    font, ticks = "11px sans-serif", uplot.Axis_Ticks(size=4, width=1)
    return (
        uplot.Axis(size=34, font=font, ticks=ticks, gap=4),
        uplot.Axis(size=46, font=font, ticks=ticks),
    )


def time_plot(
    client: viser.ClientHandle,
    title: str,
    lines: list[_Line],
    soft: tuple[float, float],
    height: int = _HEIGHT,
) -> viser.GuiUplotHandle:
    """An empty plot over time.

    Args:
        client: the tab.
        title: quantity and unit.
        lines: one per series.
        soft: limits the axis has at least, so that round-off does not fill it.
        height: of the drawing [px].
    """
    low, high = ({"pad": 0.1, "soft": limit, "mode": 1} for limit in soft)
    series = [uplot.Series(label="t [s]")]
    for line in lines:
        one = uplot.Series(label=line.label, stroke=line.colour, width=1.5)
        if line.dash:
            one["dash"] = line.dash
        series.append(one)
    return client.gui.add_uplot(
        (_EMPTY,) * len(series),
        tuple(series),
        title=title,
        scales={
            "x": uplot.Scale(time=False),
            "y": uplot.Scale(range={"min": low, "max": high}),
        },
        axes=axes(),
        legend=uplot.Legend(show=True, live=False),
        height=height,
        padding=(10, 12, 0, 0),
    )


class Plots:
    """The five plots of a tab."""

    def __init__(self, client: viser.ClientHandle) -> None:
        """Add them to the container in force."""
        legs = [_Line(f"{i + 1}", colour) for i, colour in enumerate(LEG_COLOURS)]
        both = [_Line("demand", _BLACK, (5, 4)), _Line("response", _BLUE)]
        self._response = {
            unit: time_plot(client, f"platform [{unit}]", both, (-0.05, 0.05))
            for unit in ("in", "deg")
        }
        self._force = time_plot(client, "leg forces [kN]", legs, (20.0, 40.0))
        self._valve = time_plot(client, "valve commands [%]", legs, (-2.0, 2.0))
        self._pressure = time_plot(
            client,
            "pressures of the leg [psi]",
            [_Line("cap", _BLUE), _Line("rod", _ORANGE)],
            (0.0, 1000.0),
        )
        self._supply = time_plot(
            client,
            "manifolds [psi]",
            [_Line("supply", _BLACK), _Line("return", _GREY, (5, 4))],
            (0.0, 2000.0),
        )

    def show(self, traces: Mapping[str, NDArray[np.float64]], dof: str, leg: int) -> None:
        """Draw the latest rows.

        Args:
            traces: of `Traces.last`.
            dof: degree of freedom of demand and response.
            leg: of the pressures, from 0.
        """
        time = traces["time"]
        if time.size < 2:
            return
        index, unit = DOFS.index(dof), dof_unit(dof)

        def drawn(name: str, in_unit: str) -> list[NDArray[np.float64]]:
            return list(np.ascontiguousarray(units.from_si(in_unit, traces[name]).T))

        for name, plot in self._response.items():
            plot.visible = name == unit
        pose = [drawn(name, unit)[index] for name in ("demand_pose", "platform_pose")]
        self._response[unit].data = (time, *pose)
        self._force.data = (time, *drawn("leg_force", "kN"))
        self._valve.data = (time, *drawn("valve_command", "%"))
        pressures = [drawn(name, "psi") for name in ("cap_pressure", "rod_pressure")]
        self._pressure.data = (time, *(side[leg] for side in pressures))
        supply = [drawn(name, "psi")[0] for name in ("supply_pressure", "return_pressure")]
        self._supply.data = (time, *supply)
