"""Figures of specific force and angular rate at a pilot's station, felt and perceived."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.core.units import DEGREE
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception import CueingError
from cmf_mj.show.look import BLUE, GREY, ORANGE, new_figure

SCALE = np.array([1.0, 1.0, 1.0, DEGREE, DEGREE, DEGREE])
"""Plotted units in SI."""

_TITLES = (
    *(f"specific force {axis} [m/s²]" for axis in "xyz"),
    *("roll rate p [deg/s]", "pitch rate q [deg/s]", "yaw rate r [deg/s]"),
)
_LEAST_SPAN = 0.1
"""Of an axis, in its unit, so that round-off shows as the nothing it is."""


class Motion(NamedTuple):
    """A motion and how it is drawn."""

    motion: PilotMotion
    label: str
    colour: str
    width: float = 1.0  #: [points].


def six(motion: Any) -> NDArray[np.float64]:
    """Specific force and angular rate of a motion or of its senses, in plotted units, (N, 6)."""
    return np.hstack([motion.specific_force, motion.angular_rate]) / SCALE


def motion_axes(*motions: Motion, rows: int = 3) -> tuple[Figure, NDArray[Any]]:
    """Draw forces at the left and rates at the right; further rows of the axes are left empty."""
    figure = new_figure(11.0, 8.0 if rows == 3 else 2.4 * rows)
    axes = figure.subplots(rows, 2, sharex=True)
    panels = axes[:3].T.ravel()
    for motion, label, colour, width in motions:
        for axis, values in zip(panels, six(motion).T, strict=True):
            axis.plot(motion.time, values, color=colour, linewidth=width, label=label)
    for axis, title in zip(panels, _TITLES, strict=True):
        axis.set_ylabel(title)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    _finish(figure, panels)
    return figure, axes


def perceived_figure(error: CueingError, first: str, second: str) -> Figure:
    """What is sensed in two motions, and the error of the second within its threshold."""
    figure, axes = motion_axes()
    panels = axes.T.ravel()
    time, limits, apart = error.aircraft.time, error.threshold / SCALE, error.error / SCALE
    sensed = ((six(error.aircraft), first, GREY), (six(error.simulator), second, BLUE))
    for i, axis in enumerate(panels):
        axis.axhspan(-limits[i], limits[i], color="0.92", label="threshold of the error")
        for values, label, colour in sensed:
            start = values[0, i] if i == 2 else 0.0  # less the weight
            axis.plot(time, values[:, i] - start, color=colour, linewidth=1.2, label=label)
        axis.plot(time, apart[:, i], color=ORANGE, linewidth=0.8, label="error")
    panels[2].set_ylabel(f"{_TITLES[2]}\nless the start")
    _finish(figure, panels)
    return figure


def _finish(figure: Figure, panels: NDArray[Any]) -> None:
    """Widen what is flat, and write one legend."""
    for axis in panels:
        low, high = axis.get_ylim()
        if high - low < _LEAST_SPAN and axis.has_data():
            middle = 0.5 * (low + high)
            axis.set_ylim(middle - 0.5 * _LEAST_SPAN, middle + 0.5 * _LEAST_SPAN)
    handles, labels = panels[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
