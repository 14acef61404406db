"""Live plots of a tab, in the field's units: uPlot draws thousands of points without effort."""

from collections.abc import Sequence

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show.look import BLUE, COLOURS, ORANGE
from cmf_mj.show.studio.live import PLOT_RATE, View

_DARK, _PALE = "#222222", "#8a9099"


def _add_plot(
    client: viser.ClientHandle,
    title: str,
    lines: Sequence[tuple[str, str]],
    low: float,
    high: float,
    dashed: str = "",
) -> viser.GuiUplotHandle:
    """Add an empty plot over time of lines, each a label and a colour.

    Its axis reaches from `low` to `high` at least, so that round-off does not fill it.
    """
    least, most = ({"pad": 0.1, "soft": limit, "mode": 1} for limit in (low, high))
    series = [uplot.Series(label="t [s]")]
    for label, colour in lines:
        series.append(uplot.Series(label=label, stroke=colour, width=1.5))
        if label == dashed:
            series[-1]["dash"] = (5.0, 4.0)
    font, ticks = "11px sans-serif", uplot.Axis_Ticks(size=4, width=1)
    return client.gui.add_uplot(
        (np.zeros(2),) * len(series),
        tuple(series),
        title=title,
        scales={
            "x": uplot.Scale(time=False),
            "y": uplot.Scale(range={"min": least, "max": most}),
        },
        axes=(
            uplot.Axis(size=34, font=font, ticks=ticks, gap=4),
            uplot.Axis(size=46, font=font, ticks=ticks),
        ),
        legend=uplot.Legend(show=True, live=False),
        height=150,
        padding=(10, 12, 0, 0),
    )


class Plots:
    """The five plots of a tab."""

    def __init__(self, client: viser.ClientHandle) -> None:
        """Add them to the container in force."""
        legs = [(str(leg), colour) for leg, colour in zip(range(1, 7), COLOURS, strict=False)]
        both = [("demand", _DARK), ("response", BLUE)]
        self._response = {
            unit: _add_plot(client, f"platform [{unit}]", both, -0.05, 0.05, "demand")
            for unit in ("in", "deg")
        }
        self._force = _add_plot(client, "leg forces [kN]", legs, 20.0, 40.0)
        self._valve = _add_plot(client, "valve commands [%]", legs, -2.0, 2.0)
        sides = [("cap", BLUE), ("rod", ORANGE)]
        self._pressure = _add_plot(client, "pressures of the leg [psi]", sides, 0.0, 1000.0)
        manifolds = [("supply", _DARK), ("return", _PALE)]
        self._supply = _add_plot(client, "manifolds [psi]", manifolds, 0.0, 2000.0, "return")

    def show(self, view: View, seconds: float, dof: str, leg: int) -> None:
        """Draw the last seconds: a degree of freedom, and the pressures of a leg from 0."""
        past = list(view.past)[-round(seconds * PLOT_RATE) :]
        if len(past) < 2:
            return
        index, unit = DOFS.index(dof), dof_unit(dof)

        def of(name: str, in_unit: str) -> list[NDArray[np.float64]]:
            """A signal, column by column."""
            values = units.from_si(in_unit, np.array([getattr(live, name) for live in past]))
            return list(np.ascontiguousarray(np.atleast_2d(values.T)))

        time = of("time", "s")[0]
        pose = view.plant.pose_of(np.array([live.qpos for live in past]))
        response = units.from_si(unit, pose[:, index])
        for name, plot in self._response.items():
            plot.visible = name == unit
        self._response[unit].data = (time, of("demand", unit)[index], response)
        self._force.data = (time, *of("force", "kN"))
        self._valve.data = (time, *of("valve_command", "%"))
        pressures = of("cap_pressure", "psi")[leg], of("rod_pressure", "psi")[leg]
        self._pressure.data = (time, *pressures)
        self._supply.data = (time, *of("supply_pressure", "psi"), *of("return_pressure", "psi"))
