"""Tables, figures and files of a flight in the simulator."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.core.files import write_csv
from cmf_mj.core.units import DEGREE, INCH
from cmf_mj.facility.host.files import write_stream
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.kinematics import DOFS, pose_to_legs
from cmf_mj.pilot.cueing.envelope import LIMITS, Excursion
from cmf_mj.pilot.cueing.flight import Cue, Tuned
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception.error import QUANTITIES

ERROR_LEGEND = (
    "sensed in flight less sensed in the simulator, machine ideal; thresholds are settings, not "
    "verdicts"
)
"""What the table of errors holds."""

_LABELS = (
    *(f"specific force {axis} [m/s^2]" for axis in "xyz"),
    *(f"{name} rate [deg/s]" for name in ("roll", "pitch", "yaw")),
)
_SHOWN = np.array([1.0] * 3 + [DEGREE] * 3)
_LEAST_SPAN = 0.1
"""Of an axis, in its unit, so that round-off shows as the nothing it is."""

_BLUE, _ORANGE = "#0072b2", "#d55e00"


def _table(title: str, caption: str, *columns: str) -> Table:
    table = Table(
        title=title, caption=caption, caption_justify="left", box=SIMPLE_HEAD, pad_edge=False
    )
    for index, name in enumerate(columns):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    return table


def error_table(flown: Cue) -> Table:
    """Cueing errors beside the thresholds."""
    error = flown.error
    table = _table(
        f"cueing error, washout {flown.settings.name}",
        ERROR_LEGEND,
        *("sensed", "unit", "threshold", "peak", "rms", "above"),
    )
    for i, name in enumerate(QUANTITIES):
        values = (error.threshold[i], error.peak[i], error.rms[i])
        cells = [f"{value / _SHOWN[i]:.3f}" for value in values]
        share = f"{100.0 * error.share_above[i]:.1f} %"
        table.add_row(name, by_kind(i, "m/s^2", "deg/s"), *cells, share)
    return table


def excursion_table(excursion: Excursion, held: int = 0) -> Table:
    """Peaks of a motion over the limits of the machine."""
    caption = f"frames held back: {held}" if held else "no frame held back"
    table = _table("use of the machine", caption, "limit", "largest", "where", "at [s]")
    for row, name in enumerate(LIMITS):
        column = int(excursion.share[row].argmax())
        where = DOFS[column] if row < 3 else f"leg {column + 1}"
        share = f"{100.0 * excursion.share[row, column]:.1f} %"
        table.add_row(name.replace("_", " "), share, where, f"{excursion.time[row, column]:.2f}")
    return table


def tuned_table(tuned: Tuned, before: NDArray[np.float64]) -> Table:
    """Gains before and after."""
    table = _table(
        f"gains of {tuned.settings.name}",
        f"factor {tuned.factor:.4f}; bound by {tuned.binding}",
        *("gain of", "before", "after"),
    )
    for dof, old, new in zip(DOFS, before, tuned.settings.gains, strict=True):
        table.add_row(dof, f"{old:.3f}", f"{new:.3f}")
    return table


def _six(motion: PilotMotion) -> NDArray[np.float64]:
    return np.hstack([motion.specific_force, motion.angular_rate])


def _finish(figure: Figure, axes: NDArray[Any]) -> Figure:
    for axis in axes.flat:
        low, high = axis.get_ylim()
        if high - low < _LEAST_SPAN:
            middle = 0.5 * (low + high)
            axis.set_ylim(middle - 0.5 * _LEAST_SPAN, middle + 0.5 * _LEAST_SPAN)
        axis.grid(True, color="0.9", linewidth=0.6)
        axis.tick_params(labelsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]", fontsize=9)
    return figure


def motion_figure(flown: Cue) -> Figure:
    """Specific forces and rates of both pilots; pose and legs of the platform."""
    figure = Figure(figsize=(11.0, 12.0), layout="constrained")
    axes = figure.subplots(5, 2, sharex=True)
    time = flown.aircraft.time
    for i, label in enumerate(_LABELS):
        axis: Axes = axes[i % 3, i // 3]
        for motion, colour, name in (
            (flown.aircraft, "0.6", "aircraft"),
            (flown.simulator, _BLUE, "simulator"),
        ):
            axis.plot(time, _six(motion)[:, i] / _SHOWN[i], color=colour, lw=1.2, label=name)
        axis.set_ylabel(label, fontsize=9)
    axes[0, 0].legend(fontsize=8)
    legs = pose_to_legs(flown.stream.pose) / INCH
    for column, (place, kind, shown) in enumerate(((0, "m", 1.0), (3, "deg", DEGREE))):
        for i in range(3):
            label = DOFS[place + i]
            values = flown.stream.pose[:, place + i] / shown
            axes[3, column].plot(time, values, lw=1.2, label=label)
        axes[3, column].set_ylabel(f"platform [{kind}]", fontsize=9)
        axes[3, column].legend(fontsize=8, ncols=3)
        first = 3 * column
        for leg in range(first, first + 3):
            axes[4, column].plot(time, legs[:, leg], lw=1.2, label=f"leg {leg + 1}")
        axes[4, column].set_ylabel("extension [in]", fontsize=9)
        axes[4, column].legend(fontsize=8, ncols=3)
    if flown.held.any():
        for axis in axes[3:].flat:
            low, high = axis.get_ylim()
            axis.fill_between(time, low, high, where=flown.held.tolist(), color=_ORANGE, alpha=0.15)
            axis.set_ylim(low, high)
        axes[3, 0].set_title("shaded: held back by the limits", fontsize=9)
    return _finish(figure, axes)


def senses_figure(flown: Cue) -> Figure:
    """What canals and otoliths tell in flight and in the simulator, and the difference."""
    figure = Figure(figsize=(11.0, 13.0), layout="constrained")
    axes = figure.subplots(6, 2, sharex=True)
    error = flown.error
    both = [np.hstack([part.specific_force, part.angular_rate]) for part in error[:2]]
    for i, label in enumerate(_LABELS):
        sensed: Axes = axes[2 * (i % 3), i // 3]
        apart: Axes = axes[2 * (i % 3) + 1, i // 3]
        time = error.aircraft.time
        sensed.plot(time, both[0][:, i] / _SHOWN[i], color="0.6", lw=1.2, label="in flight")
        sensed.plot(time, both[1][:, i] / _SHOWN[i], color=_BLUE, lw=1.2, label="in simulator")
        sensed.set_ylabel(f"sensed\n{label}", fontsize=8)
        apart.plot(time, error.error[:, i] / _SHOWN[i], color=_ORANGE, lw=1.2, label="error")
        limit = error.threshold[i] / _SHOWN[i]
        for side in (-limit, limit):
            shown = "threshold" if side > 0.0 else None
            apart.axhline(side, color="0.4", linestyle=":", lw=1.0, label=shown)
        apart.set_ylabel("error", fontsize=8)
    axes[0, 0].legend(fontsize=8)
    axes[1, 0].legend(fontsize=8)
    return _finish(figure, axes)


def save_cue(flown: Cue, folder: Path) -> list[Path]:
    """Write host frames, the simulator's motion, errors and figures of a flight.

    `host.csv`, `simulator.csv`, `error.csv` (SI), `motion.png`, `senses.png`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [
        write_stream(flown.stream, folder / "host.csv"),
        flown.simulator.save(folder / "simulator.csv"),
        folder / "error.csv",
        folder / "motion.png",
        folder / "senses.png",
    ]
    error = flown.error
    columns = (QUANTITIES, error.threshold, error.peak, error.rms, error.share_above)
    header = ("sensed", "threshold_si", "peak_si", "rms_si", "share_above")
    write_csv(paths[2], header, zip(*columns, strict=True))
    motion_figure(flown).savefig(paths[3], dpi=90)
    senses_figure(flown).savefig(paths[4], dpi=90)
    return paths
