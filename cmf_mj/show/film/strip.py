"""Traces that grow with a film: panels of curves, revealed from left to right."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.record.record import Record

_BLUE, _ORANGE, _GREEN, _GREY, _DARK = "#0072b2", "#d55e00", "#009e73", "0.55", "0.3"
_DPI = 100
_PALE = 0.16
"""How much of the traces shows before their time has come."""
_LEAST = 0.02
"""Least range of an axis, in its unit."""


class Curve(NamedTuple):
    """One line of a panel."""

    label: str
    values: NDArray[np.float64]  #: In the panel's unit, (N,).
    colour: str
    width: float = 1.0  #: [points].


class Panel(NamedTuple):
    """Axes of a strip."""

    label: str  #: Quantity and [unit].
    curves: tuple[Curve, ...]
    from_zero: bool = False  #: Whether the axis holds zero at its lower end.

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest value."""
        every = [curve.values for curve in self.curves]
        return min(float(v.min()) for v in every), max(float(v.max()) for v in every)


class Traces(NamedTuple):
    """What the strip of a run shows."""

    time: NDArray[np.float64]  #: [s], (N,).
    panels: tuple[Panel, ...]
    """From above, one column after the other; a whole number of them in each."""
    columns: int = 1

    def between(self, start: float, end: float) -> "Traces":
        """A part from start to end [s]; of a run that was over before, its last instant."""
        rows = (self.time >= start) & (self.time <= end)
        rows[-1] |= not rows.any()
        panels = tuple(
            panel._replace(
                curves=tuple(curve._replace(values=curve.values[rows]) for curve in panel.curves)
            )
            for panel in self.panels
        )
        return Traces(self.time[rows], panels, self.columns)


def traces_of(record: Record, dof: str | None = None) -> Traces:
    """A degree of freedom of a record, and pressures of the leg whose cap pressure moves most.

    Args:
        record: of a run.
        dof: degree of freedom to show; default the one whose demand moves most, lengths against
            1 in and angles against 1 deg.

    Raises:
        InputError: unknown degree of freedom or a channel that is missing.
    """
    scale = np.array([units.INCH] * 3 + [units.DEGREE] * 3)
    demand = record["demand_pose"] / scale
    if dof is None:
        index = int(np.ptp(demand, axis=0).argmax())
    elif dof in DOFS:
        index = DOFS.index(dof)
    else:
        raise InputError(f"dof: {dof!r} is not one of {', '.join(DOFS)}")
    cap = record["cap_pressure"]
    leg = int(np.ptp(cap, axis=0).argmax())
    if "platform_pose" in record.channels:
        label = f"{DOFS[index]} [{dof_unit(index)}]"
        wanted, found = demand[:, index], record["platform_pose"][:, index] / scale[index]
    else:
        label = f"leg {leg + 1} [in]"
        wanted = record["leg_reference"][:, leg] / units.INCH
        found = record["leg_extension"][:, leg] / units.INCH
    motion = Curve("demand", wanted, _GREY, 2.2), Curve("response", found, _BLUE, 1.2)
    pressures = (
        Curve("cap", cap[:, leg] / units.PSI, _ORANGE),
        Curve("rod", record["rod_pressure"][:, leg] / units.PSI, _GREEN),
        Curve("supply", record["supply_pressure"] / units.PSI, _DARK),
    )
    panels = Panel(label, motion), Panel(f"leg {leg + 1} [psi]", pressures, from_zero=True)
    return Traces(record.time, panels)


class Strip:
    """Traces as a picture, revealed from left to right."""

    def __init__(
        self, traces: Traces, width: int, height: int, beside: Sequence[Traces] = ()
    ) -> None:
        """Draw them once; panels that all have the same curves share one legend.

        Args:
            traces: of the run.
            width: pixels.
            height: pixels.
            beside: traces of other runs with the same panels, whose range the axes take in too.
        """
        every = [traces, *beside]
        rows = len(traces.panels) // traces.columns
        size, letters = (width / _DPI, height / _DPI), min(8.0, height / (12.0 * rows))
        figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
        figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.04)
        grid = figure.subplots(rows, traces.columns, sharex=True, squeeze=False)
        self._time = (float(traces.time[0]), max(float(t.time[-1]) for t in every))
        shared = len({tuple(curve.label for curve in panel.curves) for panel in traces.panels}) == 1
        axes = list(grid.T.ravel())
        for place, (axis, panel) in enumerate(zip(axes, traces.panels, strict=True)):
            for curve in panel.curves:
                axis.plot(
                    traces.time, curve.values, color=curve.colour, lw=curve.width, label=curve.label
                )
            ranges = [t.panels[place].range for t in every]
            low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
            room = 0.08 * (high if panel.from_zero else max(high - low, _LEAST))
            axis.set_ylim(min(0.0, low) if panel.from_zero else low - room, high + room)
            axis.set_xlim(*self._time)
            axis.set_ylabel(panel.label, fontsize=letters)
            axis.grid(True, color="0.92", linewidth=0.6)
            axis.tick_params(labelsize=letters - 1.0)
            if not shared:
                axis.legend(
                    loc="center left",
                    bbox_to_anchor=(1.0, 0.5),
                    fontsize=letters - 1.0,
                    frameon=False,
                )
        for axis in grid[-1]:
            axis.set_xlabel("time [s]", fontsize=letters)
        if shared:
            figure.legend(
                *axes[0].get_legend_handles_labels(),
                loc="outside lower center",
                ncols=len(traces.panels[0].curves),
                fontsize=letters,
                frameon=False,
            )
        figure.align_ylabels()
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        full = np.asarray(canvas.buffer_rgba())[:, :, :3].astype(np.uint8)
        self._full = full[:height, :width]
        self._pale = (255 - _PALE * (255.0 - self._full)).astype(np.uint8)
        self._spans = []
        for axis in axes:
            box = axis.get_window_extent()
            inside = slice(height - round(box.y1) + 1, height - round(box.y0) - 1)
            self._spans.append((inside, round(box.x0) + 1, round(box.x1) - 1))

    def picture(self, time: float) -> NDArray[np.uint8]:
        """The strip at a time [s], (height, width, 3)."""
        begin, end = self._time
        share = float(np.clip((time - begin) / max(end - begin, 1e-9), 0.0, 1.0))
        shown = self._full.copy()
        for rows, left, right in self._spans:
            cursor = left + round(share * (right - left - 1))
            shown[rows, cursor:right] = self._pale[rows, cursor:right]
            shown[rows, cursor : cursor + 2] = (200, 30, 30)
        return shown
