"""Tables, figures and files of a flight in the simulator."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.core.files import write_csv
from cmf_mj.core.units import DEGREE, INCH
from cmf_mj.facility.host.files import write_stream
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.kinematics import DOFS, pose_to_legs
from cmf_mj.pilot.cueing.envelope import LIMITS, Excursion
from cmf_mj.pilot.cueing.flight import Cue, Tuned
from cmf_mj.pilot.perception.error import QUANTITIES
from cmf_mj.show.look import BLUE, GREY, ORANGE, grid, legend, new_figure, save_figures
from cmf_mj.show.table import Table

ERROR_LEGEND = (
    "sensed in flight less sensed in the simulator, machine ideal; thresholds are settings, not "
    "verdicts"
)
"""What the table of errors holds."""

_LABELS = (
    *(f"specific force {axis} [m/s^2]" for axis in "xyz"),
    *(f"{name} rate [deg/s]" for name in ("roll", "pitch", "yaw")),
)
_SCALE = np.array([1.0] * 3 + [DEGREE] * 3)
"""Plotted units in SI."""

_LEAST_SPAN = 0.1
"""Of an axis, in its unit, so that round-off shows as the nothing it is."""


def error_table(flown: Cue) -> Table:
    """Cueing errors and their thresholds."""
    error = flown.error
    rows = [
        (
            *(name, by_kind(i, "m/s^2", "deg/s")),
            *(values[i] / _SCALE[i] for values in (error.threshold, error.peak, error.rms)),
            100.0 * error.share_above[i],
        )
        for i, name in enumerate(QUANTITIES)
    ]
    sizes = (("threshold", ".3f"), ("peak", ".3f"), ("rms", ".3f"))
    columns = ("sensed", ("unit", ""), *sizes, ("above", ".1f %"))
    return Table(f"cueing error, washout {flown.settings.name}", columns, rows, ERROR_LEGEND)


def excursion_table(excursion: Excursion, held: int = 0) -> Table:
    """Peaks of a motion over the limits of the machine; `held` frames the limits held back."""
    rows = []
    for row, name in enumerate(LIMITS):
        column = int(excursion.share[row].argmax())
        where = DOFS[column] if row < 3 else f"leg {column + 1}"
        share, time = 100.0 * excursion.share[row, column], excursion.time[row, column]
        rows.append((name.replace("_", " "), share, where, time))
    caption = f"frames held back: {held}" if held else "no frame held back"
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


def _six(motion: Any) -> NDArray[np.float64]:
    """Specific force and angular rate of a motion or of what is sensed, in plotted units."""
    return np.hstack([motion.specific_force, motion.angular_rate]) / _SCALE


def _finish(figure: Figure, axes: NDArray[Any]) -> Figure:
    for axis in axes.flat:
        low, high = axis.get_ylim()
        if high - low < _LEAST_SPAN:
            middle = 0.5 * (low + high)
            axis.set_ylim(middle - 0.5 * _LEAST_SPAN, middle + 0.5 * _LEAST_SPAN)
        axis.tick_params(labelsize=8)
    grid(*axes.flat)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]", fontsize=9)
    return figure


def motion_figure(flown: Cue) -> Figure:
    """Specific forces and rates of both pilots; pose and legs of the platform."""
    figure = new_figure(11.0, 12.0)
    axes = figure.subplots(5, 2, sharex=True)
    time = flown.aircraft.time
    for i, label in enumerate(_LABELS):
        axis: Axes = axes[i % 3, i // 3]
        axis.plot(time, _six(flown.aircraft)[:, i], color=GREY, lw=1.2, label="aircraft")
        axis.plot(time, _six(flown.simulator)[:, i], color=BLUE, lw=1.2, label="simulator")
        axis.set_ylabel(label, fontsize=9)
    legs, pose = pose_to_legs(flown.stream.pose) / INCH, flown.stream.pose
    for column, (unit, scale) in enumerate((("m", 1.0), ("deg", DEGREE))):
        platform, leg = axes[3:, column]
        for i in range(3 * column, 3 * column + 3):
            platform.plot(time, pose[:, i] / scale, lw=1.2, label=DOFS[i])
            leg.plot(time, legs[:, i], lw=1.2, label=f"leg {i + 1}")
        platform.set_ylabel(f"platform [{unit}]", fontsize=9)
        leg.set_ylabel("extension [in]", fontsize=9)
    legend(axes[0, 0], *axes[3:].flat, ncols=3)
    if flown.held.any():
        for axis in axes[3:].flat:
            low, high = axis.get_ylim()
            axis.fill_between(time, low, high, where=flown.held.tolist(), color=ORANGE, alpha=0.15)
            axis.set_ylim(low, high)
        axes[3, 0].set_title("shaded: held back by the limits", fontsize=9)
    return _finish(figure, axes)


def senses_figure(flown: Cue) -> Figure:
    """What canals and otoliths tell in flight and in the simulator, and the difference."""
    figure = new_figure(11.0, 13.0)
    axes = figure.subplots(6, 2, sharex=True)
    error, time = flown.error, flown.error.aircraft.time
    flight, simulator = (_six(part) for part in error[:2])
    for i, label in enumerate(_LABELS):
        sensed, apart = axes[2 * (i % 3) : 2 * (i % 3) + 2, i // 3]
        sensed.plot(time, flight[:, i], color=GREY, lw=1.2, label="in flight")
        sensed.plot(time, simulator[:, i], color=BLUE, lw=1.2, label="in simulator")
        sensed.set_ylabel(f"sensed\n{label}", fontsize=8)
        apart.plot(time, error.error[:, i] / _SCALE[i], color=ORANGE, lw=1.2, label="error")
        limit = error.threshold[i] / _SCALE[i]
        for side, name in ((-limit, None), (limit, "threshold")):
            apart.axhline(side, color="0.4", linestyle=":", lw=1.0, label=name)
        apart.set_ylabel("error", fontsize=8)
    legend(axes[0, 0], axes[1, 0])
    return _finish(figure, axes)


def save_cue(flown: Cue, folder: Path) -> list[Path]:
    """Write host frames, the simulator's motion, errors and figures of a flight.

    `host.csv`, `simulator.csv`, `error.csv` (SI), `motion.png`, `senses.png`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    error = flown.error
    columns = (QUANTITIES, error.threshold, error.peak, error.rms, error.share_above)
    header = ("sensed", "threshold_si", "peak_si", "rms_si", "share_above")
    figures = {"motion": motion_figure(flown), "senses": senses_figure(flown)}
    return [
        write_stream(flown.stream, folder / "host.csv"),
        flown.simulator.save(folder / "simulator.csv"),
        write_csv(folder / "error.csv", header, zip(*columns, strict=True)),
        *save_figures(figures, folder, 90),
    ]
