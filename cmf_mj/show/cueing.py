"""Tables, figures and files of cueing: what pilots feel in flight and in the simulator."""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.core.result import Table
from cmf_mj.core.units import DEGREE, INCH
from cmf_mj.facility.host.stream import write_stream
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.pilot.cueing import LIMITS, Cue, Excursion
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception import QUANTITIES, CueingError, Sensed
from cmf_mj.show import look

MOTION_NAMES = ("f_x", "f_y", "f_z", "p", "q", "r")  #: Of specific force and angular rate.
_PLOT_UNITS = ("m/s²", "deg/s")  #: Of specific force and angular rate.
_PLOT_UNIT_SI = np.array([1.0, 1.0, 1.0, DEGREE, DEGREE, DEGREE])
"""SI value of one plotted unit, for `MOTION_NAMES`, (6,)."""
_LEAST_SPAN = 0.1  #: Least range of a y axis, in its unit; else round-off would fill it.


class DrawnMotion(NamedTuple):
    """A motion and how it is drawn."""

    motion: PilotMotion | Sensed
    label: str
    colour: str
    width: float = 1.0  #: [points].


def motion_panels(*motions: DrawnMotion) -> list[look.Panel]:
    """Specific force and angular rate of motions from their start."""
    curves_by_motion = []
    for motion, label, colour, width in motions:
        time = motion.time - motion.time[0]
        values = np.hstack([motion.specific_force, motion.angular_rate]) / _PLOT_UNIT_SI
        curves_by_motion.append([look.Curve(label, time, y, colour, width) for y in values.T])
    return [
        look.Panel(f"{name} [{by_kind(index, *_PLOT_UNITS)}]", curves)
        for index, (name, *curves) in enumerate(zip(MOTION_NAMES, *curves_by_motion, strict=True))
    ]


class MotionAxes(NamedTuple):
    """A figure of motions with its axes."""

    figure: Figure
    panels: NDArray[Any]  #: Axes for each of `MOTION_NAMES`, (6,).
    below: NDArray[Any]  #: Empty axes below them, (rows - 3, 2).


def motion_axes(title: str, *motions: DrawnMotion, rows: int = 3) -> MotionAxes:
    """Draw forces at the left and rates at the right, above rows of empty axes."""
    figure = look.new_figure(11.0, 8.0 if rows == 3 else 2.4 * rows)
    grid = figure.subplots(rows, 2, sharex=True)
    figure.suptitle(title)
    above, below = np.split(grid, [3])
    forces, rates = above.T
    panels = np.concatenate([forces, rates])
    for axes, panel in zip(panels, motion_panels(*motions), strict=True):
        look.plot_panel(axes, panel)
        low, high = axes.get_ylim()
        if high - low < _LEAST_SPAN:
            middle = 0.5 * (low + high)
            axes.set_ylim(middle - 0.5 * _LEAST_SPAN, middle + 0.5 * _LEAST_SPAN)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    look.legend(figure)
    return MotionAxes(figure, panels, below)


def perceived_figure(title: str, error: CueingError, first: str, second: str) -> Figure:
    """What is sensed in two motions, and the error of the second; its threshold is shaded."""
    force, rate = np.split(error.error, 2, axis=1)
    difference = Sensed(time=error.aircraft.time, angular_rate=rate, specific_force=force)
    figure, panels, _ = motion_axes(
        f"{title}; shaded: threshold of the error",
        DrawnMotion(_less_initial_z(error.aircraft), first, look.GREY, 1.2),
        DrawnMotion(_less_initial_z(error.simulator), second, look.BLUE, 1.2),
        DrawnMotion(difference, "error", look.ORANGE, 0.8),
    )
    for axes, limit in zip(panels, error.threshold / _PLOT_UNIT_SI, strict=True):
        axes.axhspan(-limit, limit, color=look.PALE, zorder=0.0)
        axes.autoscale(axis="y")
    panels[MOTION_NAMES.index("f_z")].set_ylabel("f_z [m/s²]\nless the start")
    return figure


def _less_initial_z(sensed: Sensed) -> Sensed:
    """The same with f_z less its first value."""
    initial_z = [0.0, 0.0, sensed.specific_force[0, 2]]
    return sensed._replace(specific_force=sensed.specific_force - initial_z)


_ERROR_CAPTION = (
    "sensed in flight less sensed in the simulator, machine ideal; thresholds are settings, not "
    "verdicts"
)


def error_table(flown: Cue) -> Table:
    """Cueing errors and their thresholds."""
    error = flown.error
    plot_units = [by_kind(index, *_PLOT_UNITS) for index in range(len(QUANTITIES))]
    sizes = (values / _PLOT_UNIT_SI for values in (error.threshold, error.peak, error.rms))
    percent_above = 100.0 * error.share_above
    rows = list(zip(QUANTITIES, plot_units, *sizes, percent_above, strict=True))
    size_columns = (("threshold", ".3f"), ("peak", ".3f"), ("rms", ".3f"))
    columns = ("sensed", ("unit", ""), *size_columns, ("above", ".1f %"))
    return Table(f"cueing error, washout {flown.settings.name}", columns, rows, _ERROR_CAPTION)


def excursion_table(excursion: Excursion, changed_frames: int = 0) -> Table:
    """Peaks of a motion over the limits of the machine, which changed so many of its frames."""
    rows = []
    for name, shares, times in zip(LIMITS, excursion.share, excursion.time, strict=True):
        largest = int(shares.argmax())
        limited = f"leg {largest + 1}" if name.startswith("leg_") else DOFS[largest]
        rows.append((name.replace("_", " "), 100.0 * shares[largest], limited, times[largest]))
    caption = f"frames held back: {changed_frames}" if changed_frames else "no frame held back"
    columns = ("limit", ("largest", ".1f %"), ("where", ""), ("at [s]", ".2f"))
    return Table("use of the machine", columns, rows, caption)


def motion_figure(flown: Cue) -> Figure:
    """Specific forces and rates of both pilots; pose and legs of the platform."""
    title = f"Motion of both pilots, pose and legs: washout {flown.settings.name}"
    aircraft = DrawnMotion(flown.aircraft, "aircraft", look.GREY, 1.2)
    simulator = DrawnMotion(flown.simulator, "simulator", look.BLUE, 1.2)
    figure, _, below = motion_axes(title, aircraft, simulator, rows=5)
    time, pose = flown.aircraft.time, flown.stream.pose
    legs = pose_to_legs(pose, flown.machine) / INCH
    left, right = below.T
    for (platform, leg), first, unit, scale in ((left, 0, "m", 1.0), (right, 3, "deg", DEGREE)):
        for i in range(first, first + 3):
            platform.plot(time, pose[:, i] / scale, lw=1.2, label=DOFS[i])
            leg.plot(time, legs[:, i], lw=1.2, label=f"leg {i + 1}")
        platform.set_ylabel(f"platform [{unit}]")
        leg.set_ylabel("extension [in]")
    look.legend(*below.flat)
    if flown.limited.any():
        for axes in below.flat:
            look.shade(axes, time, flown.limited)
        below[0, 0].set_title("shaded: held back by the limits")
    return figure


def save_cue(flown: Cue, folder: Path) -> list[Path]:
    """Write host frames, the simulator's motion, errors and figures of a flight.

    `host.csv`, `simulator.csv`, `error.csv` (SI), `motion.png`, `senses.png`.
    """
    error, title = flown.error, "Specific force and angular rate as sensed"
    sizes = {"threshold_si": error.threshold, "peak_si": error.peak, "rms_si": error.rms}
    files = {
        "host.csv": partial(write_stream, flown.stream),
        "simulator.csv": flown.simulator,
        "error.csv": {"sensed": QUANTITIES, **sizes, "share_above": error.share_above},
        "motion.png": motion_figure(flown),
        "senses.png": perceived_figure(title, error, "in flight", "in the simulator"),
    }
    return look.save_files(files, folder, 90)
