"""Traces that grow with a film: panels of curves, revealed from left to right."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.record import Record
from cmf_mj.show.chart import Curve, Panel
from cmf_mj.show.look import BLUE, DARK, GREEN, GREY, ORANGE

_DPI = 100
_MOST = 3
"""Panels one above the other."""
_PALE = 0.16
"""How much of the traces shows before their time has come."""
_LEAST = 0.02
"""Least range of an axis, in its unit."""
_CURSOR = (200, 30, 30)

Panels = Sequence[Panel]
"""What the strip of a run shows, from above, one column after the other."""


def traces_of(record: Record) -> Panels:
    """A degree of freedom of a record, and pressures of the leg whose cap pressure moves most.

    It is the one whose demand moves most, lengths against 1 in and angles against 1 deg.
    """
    scale = np.array([units.factor(dof_unit(name)) for name in DOFS])
    dof = int(np.ptp(record["demand_pose"] / scale, axis=0).argmax())
    leg = int(np.ptp(record["cap_pressure"], axis=0).argmax())

    def line(
        name: str, channel: str, column: int, unit: str, colour: str, width: float = 1.0
    ) -> Curve:
        values = record[channel].reshape(record.time.size, -1)[:, column]
        return Curve(name, record.time, values / units.factor(unit), colour, width=width)

    title, column, unit = f"leg {leg + 1}", leg, "in"
    channels = ("leg_reference", "leg_extension")
    if "platform_pose" in record.channels:
        title, column, unit = DOFS[dof], dof, dof_unit(dof)
        channels = ("demand_pose", "platform_pose")
    motion = (
        line("demand", channels[0], column, unit, GREY, 2.2),
        line("response", channels[1], column, unit, BLUE, 1.2),
    )
    pressures = (
        line("cap", "cap_pressure", leg, "psi", ORANGE),
        line("rod", "rod_pressure", leg, "psi", GREEN),
        line("supply", "supply_pressure", 0, "psi", DARK),
    )
    below = Panel(f"leg {leg + 1} [psi]", pressures, from_zero=True)
    return Panel(f"{title} [{unit}]", motion), below


class Strip:
    """Traces as a picture, revealed from left to right."""

    def __init__(
        self,
        panels: Panels,
        width: int,
        height: int,
        span: tuple[float, float],
        every: Sequence[Panels] = (),
    ) -> None:
        """Draw them once, over a span of time [s]; panels of the same curves share one legend.

        The axes take in the range of the panels of `every` run.
        """
        self._span, columns = span, -(-len(panels) // _MOST)
        rows = len(panels) // columns
        size, letters = (width / _DPI, height / _DPI), min(8.0, height / (12.0 * rows))
        small: dict[str, Any] = {"fontsize": letters - 1.0, "frameon": False}
        figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
        figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.04)
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        shared = len({tuple(curve.name for curve in panel.curves) for panel in panels}) == 1
        axes = list(grid.T.ravel())
        for axis, panel, *others in zip(axes, panels, *(every or [panels]), strict=True):
            lines = [
                axis.plot(c.x, c.y, color=c.colour, linewidth=c.width, label=c.name)[0]
                for c in panel.curves
            ]
            axis.set(xlim=span, ylim=_limits(others, span))
            axis.set_ylabel(panel.y_title, fontsize=letters)
            axis.grid(True, color="0.92", linewidth=0.6)
            axis.tick_params(labelsize=letters - 1.0)
            if not shared:
                axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **small)
        for axis in grid[-1]:
            axis.set_xlabel("time [s]", fontsize=letters)
        if shared:
            below: dict[str, Any] = {"loc": "outside lower center", "ncols": len(lines)}
            figure.legend(handles=lines, **below, **(small | {"fontsize": letters}))
        figure.align_ylabels()
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        full = np.asarray(canvas.buffer_rgba())[:, :, :3].astype(np.uint8)
        self._full = full[:height, :width]
        self._pale = (255 - _PALE * (255.0 - self._full)).astype(np.uint8)
        self._boxes = []
        for axis in axes:
            (left, low), (right, high) = axis.get_window_extent().get_points().round().astype(int)
            self._boxes.append((slice(height - high + 1, height - low - 1), left + 1, right - 1))

    def picture(self, time: float) -> NDArray[np.uint8]:
        """The strip at a time [s], (height, width, 3)."""
        share = float(np.interp(time, self._span, (0.0, 1.0)))
        pixels = self._full.copy()
        for rows, left, right in self._boxes:
            cursor = left + round(share * (right - left - 1))
            pixels[rows, cursor:right] = self._pale[rows, cursor:right]
            pixels[rows, cursor : cursor + 2] = _CURSOR
        return pixels


def _limits(panels: Panels, span: tuple[float, float]) -> tuple[float, float]:
    """Ends of an axis that holds the curves of all panels within a span of time."""
    curves = [curve for panel in panels for curve in panel.curves]
    values = np.concatenate([c.y[(c.x >= span[0]) & (c.x <= span[1])] for c in curves])
    low, high = float(values.min()), float(values.max())
    if panels[0].from_zero:
        return min(0.0, low), 1.08 * high
    margin = 0.08 * max(high - low, _LEAST)
    return low - margin, high + margin
