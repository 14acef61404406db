"""Traces that grow with a film: demand and response above, pressures below."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj import units
from cmf_mj.kinematics import DOFS
from cmf_mj.record import Record

_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "0.55"
_DPI = 100
_PALE = 0.16
"""How much of the traces shows before their time has come."""


class Traces(NamedTuple):
    """What the strip of a run shows."""

    time: NDArray[np.float64]
    """[s], (N,)."""
    unit: str
    """in or deg."""
    label: str
    """Degree of freedom, or a leg."""
    demand: NDArray[np.float64]
    """In the unit, (N,)."""
    response: NDArray[np.float64]
    """In the unit, (N,)."""
    pressures: NDArray[np.float64]
    """Cap, rod and supply [psi], (N, 3): of the leg whose cap pressure moves most."""
    leg: int
    """Number of that leg, from 1."""


def traces_of(record: Record, dof: str | None = None) -> Traces:
    """The traces of a record.

    Args:
        record: of a run.
        dof: degree of freedom to show; default the one whose demand moves most, lengths against
            1 in and angles against 1 deg.

    Raises:
        ValueError: unknown degree of freedom or a channel that is missing.
    """
    scale = np.array([units.INCH] * 3 + [units.DEGREE] * 3)
    demand = record["demand_pose"] / scale
    if dof is None:
        index = int(np.ptp(demand, axis=0).argmax())
    elif dof in DOFS:
        index = DOFS.index(dof)
    else:
        raise ValueError(f"dof: {dof!r} is not one of {', '.join(DOFS)}")
    cap = record["cap_pressure"]
    leg = int(np.ptp(cap, axis=0).argmax())
    pressures = np.stack(
        [cap[:, leg], record["rod_pressure"][:, leg], record["supply_pressure"]], 1
    )
    if "platform_pose" in record.channels:
        label, unit = DOFS[index], "in" if index < 3 else "deg"
        wanted, found = demand[:, index], record["platform_pose"][:, index] / scale[index]
    else:
        label, unit = f"leg {leg + 1}", "in"
        wanted = record["leg_reference"][:, leg] / units.INCH
        found = record["leg_extension"][:, leg] / units.INCH
    return Traces(record.time, unit, label, wanted, found, pressures / units.PSI, leg + 1)


class Strip:
    """Traces as a picture, revealed from left to right."""

    def __init__(
        self, traces: Traces, width: int, height: int, beside: Sequence[Traces] = ()
    ) -> None:
        """Draw them once.

        Args:
            traces: of the run.
            width: pixels.
            height: pixels.
            beside: traces of other runs, whose range the axes take in too.
        """
        every = [traces, *beside]
        size, letters = (width / _DPI, height / _DPI), min(8.0, height / 24.0)
        figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
        figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.04)
        motion, pressure = figure.subplots(2, 1, sharex=True)
        motion.plot(traces.time, traces.demand, color=_GREY, lw=2.2, label="demand")
        motion.plot(traces.time, traces.response, color=_BLUE, lw=1.2, label="response")
        motion.set_ylabel(f"{traces.label} [{traces.unit}]", fontsize=letters)
        names = ("cap", "rod", "supply")
        for values, name, colour in zip(
            traces.pressures.T, names, (_ORANGE, _GREEN, "0.3"), strict=True
        ):
            pressure.plot(traces.time, values, color=colour, lw=1.0, label=name)
        pressure.set_ylabel(f"leg {traces.leg} [psi]", fontsize=letters)
        pressure.set_xlabel("time [s]", fontsize=letters)
        low = min(float(min(t.demand.min(), t.response.min())) for t in every)
        high = max(float(max(t.demand.max(), t.response.max())) for t in every)
        room = 0.08 * max(high - low, 0.02)
        motion.set_ylim(low - room, high + room)
        top = max(float(t.pressures.max()) for t in every)
        pressure.set_ylim(min(0.0, *(float(t.pressures.min()) for t in every)), 1.08 * top)
        self._time = (float(traces.time[0]), max(float(t.time[-1]) for t in every))
        for axis in (motion, pressure):
            axis.set_xlim(*self._time)
            axis.grid(True, color="0.92", linewidth=0.6)
            axis.tick_params(labelsize=letters - 1.0)
            axis.legend(
                fontsize=letters - 1.0, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False
            )
        figure.align_ylabels()
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        full = np.asarray(canvas.buffer_rgba())[:, :, :3].astype(np.uint8)
        self._full = full[:height, :width]
        self._pale = (255 - _PALE * (255.0 - self._full)).astype(np.uint8)
        self._spans = []
        for axis in (motion, pressure):
            box = axis.get_window_extent()
            rows = slice(height - round(box.y1) + 1, height - round(box.y0) - 1)
            self._spans.append((rows, round(box.x0) + 1, round(box.x1) - 1))

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
