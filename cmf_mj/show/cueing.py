"""Tables, figures and files of a flight; figures of what is felt and perceived at the station."""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.core.table import Table
from cmf_mj.core.units import DEGREE, INCH
from cmf_mj.facility.host.files import write_stream
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.pilot.cueing.flight import LIMITS, Cue, Excursion, Tuned
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception import QUANTITIES, CueingError
from cmf_mj.show.look import BLUE, GREY, ORANGE, legend, new_figure, save_files, shade

SCALE = np.array([1.0, 1.0, 1.0, DEGREE, DEGREE, DEGREE])
"""Plotted units in SI."""

_TITLES = (
    *(f"specific force {axis} [m/s²]" for axis in "xyz"),
    *("roll rate p [deg/s]", "pitch rate q [deg/s]", "yaw rate r [deg/s]"),
)
_LEAST_SPAN = 0.1
"""Of an axis, in its unit, so that round-off shows as the nothing it is."""


class DrawnMotion(NamedTuple):
    """A motion and how it is drawn."""

    motion: PilotMotion
    label: str
    colour: str
    width: float = 1.0  #: [points].


def six(motion: Any) -> NDArray[np.float64]:
    """Specific force and angular rate of a motion or of its senses, in plotted units, (N, 6)."""
    return np.hstack([motion.specific_force, motion.angular_rate]) / SCALE


def motion_axes(*motions: DrawnMotion, rows: int = 3) -> tuple[Figure, NDArray[Any]]:
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
    figure.suptitle("Specific force and angular rate as sensed")
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


_LEGEND = (
    "sensed in flight less sensed in the simulator, machine ideal; thresholds are settings, not "
    "verdicts"
)


def error_table(flown: Cue) -> Table:
    """Cueing errors and their thresholds."""
    error = flown.error
    rows = [
        (
            *(name, by_kind(i, "m/s^2", "deg/s")),
            *(values[i] / SCALE[i] for values in (error.threshold, error.peak, error.rms)),
            100.0 * error.share_above[i],
        )
        for i, name in enumerate(QUANTITIES)
    ]
    sizes = (("threshold", ".3f"), ("peak", ".3f"), ("rms", ".3f"))
    columns = ("sensed", ("unit", ""), *sizes, ("above", ".1f %"))
    return Table(f"cueing error, washout {flown.settings.name}", columns, rows, _LEGEND)


def excursion_table(excursion: Excursion, changed_frames: int = 0) -> Table:
    """Peaks of a motion over the limits of the machine, which changed so many of its frames."""
    rows = []
    for row, name in enumerate(LIMITS):
        column = int(excursion.share[row].argmax())
        where = DOFS[column] if row < 3 else f"leg {column + 1}"
        share, time = 100.0 * excursion.share[row, column], excursion.time[row, column]
        rows.append((name.replace("_", " "), share, where, time))
    caption = f"frames held back: {changed_frames}" if changed_frames else "no frame held back"
    columns = ("limit", ("largest", ".1f %"), ("where", ""), ("at [s]", ".2f"))
    return Table("use of the machine", columns, rows, caption)


def tuned_table(tuned: Tuned, before: NDArray[np.float64]) -> Table:
    """Gains before and after."""
    return Table(
        f"gains of {tuned.settings.name}",
        ("gain of", ("before", ".3f"), ("after", ".3f")),
        list(zip(DOFS, before, tuned.settings.gains, strict=True)),
        f"factor {tuned.factor:.4f}; bound by {tuned.binding}",
    )


def motion_figure(flown: Cue) -> Figure:
    """Specific forces and rates of both pilots; pose and legs of the platform."""
    figure, axes = motion_axes(
        DrawnMotion(flown.aircraft, "aircraft", GREY, 1.2),
        DrawnMotion(flown.simulator, "simulator", BLUE, 1.2),
        rows=5,
    )
    time, pose = flown.aircraft.time, flown.stream.pose
    legs = pose_to_legs(pose, flown.machine) / INCH
    for column, (unit, scale) in enumerate((("m", 1.0), ("deg", DEGREE))):
        platform, leg = axes[3:, column]
        for i in range(3 * column, 3 * column + 3):
            platform.plot(time, pose[:, i] / scale, lw=1.2, label=DOFS[i])
            leg.plot(time, legs[:, i], lw=1.2, label=f"leg {i + 1}")
        platform.set_ylabel(f"platform [{unit}]")
        leg.set_ylabel("extension [in]")
    legend(*axes[3:].flat, ncols=3)
    if flown.limited.any():
        for axis in axes[3:].flat:
            shade(axis, time, flown.limited)
        axes[3, 0].set_title("shaded: held back by the limits", fontsize=9)
    figure.suptitle(
        "Specific force and angular rate of both pilots, pose and legs: "
        f"washout {flown.settings.name}"
    )
    return figure


def save_cue(flown: Cue, folder: Path) -> list[Path]:
    """Write host frames, the simulator's motion, errors and figures of a flight.

    `host.csv`, `simulator.csv`, `error.csv` (SI), `motion.png`, `senses.png`.
    """
    error = flown.error
    columns = (QUANTITIES, error.threshold, error.peak, error.rms, error.share_above)
    header = ("sensed", "threshold_si", "peak_si", "rms_si", "share_above")
    files = {
        "host.csv": partial(write_stream, flown.stream),
        "simulator.csv": flown.simulator.save,
        "error.csv": (header, zip(*columns, strict=True)),
        "motion.png": motion_figure(flown),
        "senses.png": perceived_figure(error, "sensed in flight", "in the simulator"),
    }
    return save_files(files, folder, 90)
