"""Tables, figures and files of a flight in the simulator."""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.core.units import DEGREE, INCH
from cmf_mj.facility.host.files import write_stream
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.pilot.cueing.flight import LIMITS, Cue, Excursion, Tuned
from cmf_mj.pilot.perception import QUANTITIES
from cmf_mj.show.look import BLUE, GREY, legend, save_files, shade
from cmf_mj.show.station import SCALE, Motion, motion_axes, perceived_figure
from cmf_mj.show.table import Table

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
        Motion(flown.aircraft, "aircraft", GREY, 1.2),
        Motion(flown.simulator, "simulator", BLUE, 1.2),
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
