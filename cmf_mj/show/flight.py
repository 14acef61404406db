"""Tables, figures and files of flights in the cab, and of manoeuvres that were learnt."""

from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cmf_mj.core.result import Cell, Column, Table
from cmf_mj.core.units import DEGREE
from cmf_mj.facility.host.stream import write_stream
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.fly import FlightResult
from cmf_mj.pilot.learning import BAND, LEAD, Learning, frequencies
from cmf_mj.pilot.motion import MOST_RATE
from cmf_mj.pilot.perception import CueingError
from cmf_mj.show import cueing, look
from cmf_mj.show.player.traces import Panels

_MOTIONS = {
    "aircraft": ("aircraft", look.BLUE, 1.2),
    "asked": ("asked of the platform", look.DARK, 0.9),
    "simulator": ("cab", look.ORANGE, 0.9),
}
"""Motions at the pilot's station, and how they are drawn."""
_SCALE = np.array([by_kind(dof, 1e3, 1.0 / DEGREE) for dof in DOFS])
"""What is shown of one SI unit: mm or mm/s^2, and deg or deg/s."""


def drawn(ride: FlightResult) -> list[cueing.DrawnMotion]:
    """Those of a ride."""
    return [cueing.DrawnMotion(getattr(ride, name), *style) for name, style in _MOTIONS.items()]


def saved_traces(records: Sequence[Path]) -> list[Panels]:
    """Traces of what the pilot felt, as `save_ride` wrote it beside each record; else none.

    Of the axes along which a motion changes by more than 0.01 m/s^2 or 0.01 deg/s.
    """
    files = [{name: path.with_name(f"{name}.parquet") for name in _MOTIONS} for path in records]
    if not all(path.exists() for beside in files for path in beside.values()):
        return []
    flights = [
        [cueing.DrawnMotion(load_flight(path).motion, *_MOTIONS[key]) for key, path in one.items()]
        for one in files
    ]
    every = list(zip(*(cueing.motion_panels(*motions) for motions in flights), strict=True))
    moved = [
        any(np.ptp(curve.y) > 0.01 for panel in panels for curve in panel.curves)
        for panels in every
    ]
    return [tuple(compress(panels, moved)) for panels in zip(*every, strict=True)]


def comparison_figure(rides: Sequence[FlightResult]) -> Figure:
    """Perceived size of the machine's error and of the flight's, law by law."""
    figure, first = look.new_figure(12.0, 4.5), rides[0]
    machine, flight = figure.subplots(1, 2)
    coloured = list(zip(rides, look.COLOURS, strict=False))
    _bars(machine, "of the machine: asked less cab", [(r.law, c, r.machine) for r, c in coloured])
    bars = [("machine that follows at once", look.GREY, first.washout_error)]
    bars += [(r.law, colour, r.cueing) for r, colour in coloured]
    _bars(flight, "of the flight: aircraft less cab", bars)
    look.legend(figure)
    figure.suptitle(f"Error at the pilot's station of cab {first.cab}, as it is sensed")
    return figure


def _bars(axes: Axes, title: str, bars: Sequence[tuple[str, str, CueingError]]) -> None:
    """Perceived rms errors over their thresholds."""
    for place, (label, colour, error) in enumerate(bars):
        at = np.arange(6) + 0.8 * ((place + 0.5) / len(bars) - 0.5)
        axes.bar(at, error.rms / error.threshold, 0.75 / len(bars), color=colour, label=label)
    axes.axhline(1.0, color=look.DARK, linestyle=":", linewidth=0.9)
    axes.set_xticks(range(6), cueing.MOTION_NAMES)
    named = "specific force and angular rate, body axes"
    axes.set(yscale="log", xlabel=named, ylabel="perceived rms error / threshold")
    axes.set_title(f"perceived error {title}")
    least = min(float((error.rms / error.threshold).min()) for *_, error in bars)
    axes.set_ylim(bottom=0.5 * max(least, 1e-4))


def flight_table(rides: Sequence[FlightResult]) -> Table:
    """Perceived rms errors of the machine, of the whole flight, delay and envelope, law by law."""
    columns: list[Column] = [
        (f"{name} [{by_kind(i, 'mm/s²', 'deg/s')}]", by_kind(i, ".1f", ".3f"))
        for i, name in enumerate(cueing.MOTION_NAMES)
    ]
    columns += [("flight: f_x [mm/s²]", ".1f"), ("f_y [mm/s²]", ".1f"), ("loop [ms]", ".0f")]
    ideal, still = rides[0].washout_error.rms * _SCALE, ["0"] * 6
    rows: list[list[Cell]] = [["machine that follows at once", *still, *ideal[:2], "0", None, None]]
    for ride in rides:
        machine, flight = ride.machine.rms * _SCALE, ride.cueing.rms * _SCALE
        row = [ride.law, *machine, *flight[:2], 1e3 * ride.loop_delay]
        rows.append([*row, 100 * ride.use.share[3].max(), ride.fault or "none"])
    title = "perceived rms error of the machine; of the whole flight; delay; envelope"
    return Table(title, ("law", *columns, ("legs [%]", ".0f"), "fault"), rows)


def save_ride(ride: FlightResult, folder: Path) -> list[Path]:
    """Write `motion.png`, `perceived.png` and the motions that `saved_traces` reads."""
    files: dict[str, Any] = {f"{name}.parquet": getattr(ride, name) for name in _MOTIONS}
    of, sensed = f"{ride.law}, cab {ride.cab}", ("in the aircraft", "in the cab")
    title = f"Motion at the pilot's station: {of}"
    files["motion.png"] = cueing.motion_axes(title, *drawn(ride))[0]
    title = f"Motion sensed by otoliths and canals: {of}"
    files["perceived.png"] = cueing.perceived_figure(title, ride.cueing, *sensed)
    return look.save_files(files, folder)


def save_flights(rides: Sequence[FlightResult], folder: Path) -> list[Path]:
    """Write `comparison.csv`, `comparison.md` and `comparison.png`."""
    table = flight_table(rides)
    files = {"comparison.csv": table, "comparison.md": table}
    return look.save_files(files | {"comparison.png": comparison_figure(rides)}, folder, 80)


def trial_table(learnt: Learning) -> Table:
    """Errors of each trial, and what is left of the first run's."""
    axes = [(f"{dof} [{by_kind(dof, 'mm', 'deg')}]", ".3f") for dof in DOFS]
    first, rows = learnt.trials[0], []
    for number, one in enumerate(learnt.trials):
        left = [100.0 * one.legs / first.legs, 100.0 * one.predicted / first.predicted]
        rows.append([str(number), *(one.axes * _SCALE), 1e3 * one.legs, *left, one.held])
    columns = [("legs [mm]", ".3f"), ("left [%]", ".2f"), ("linear [%]", ".2f"), ("held", "d")]
    title = f"tracking error below {BAND:g} Hz, rms; left of the first run's"
    return Table(title, ("trial", *axes, *columns), rows)


def verdict(learnt: Learning) -> str:
    """Convergence of the linear models, and the best trial."""
    worst = learnt.learner.ratio().max(axis=1)
    left = learnt.trials[learnt.best].legs / learnt.trials[0].legs
    return (
        f"largest singular value of Q (1 - L G): {worst[0]:.2f} of the machine that learns, "
        f"{worst.max():.2f} over machines and poses; best trial {learnt.best}: {left:.2%} left"
    )


def learning_figure(learnt: Learning) -> Figure:
    """Error by trial, convergence by frequency, the error in time."""
    figure = look.new_figure(11.0, 7.0)
    axes = figure.subplot_mosaic([["trials", "ratio"], ["history", "history"]])
    trials, ratio, history = axes.values()
    for label, name, style in (("simulated", "sensed", "o-"), ("linear", "predicted", "x--")):
        trials.semilogy([1e3 * getattr(one, name) for one in learnt.trials], style, label=label)
    trials.set(xlabel="trial", ylabel=f"legs below {BAND:g} Hz, rms as sensed [mm]")
    lines, values = frequencies(len(learnt.reference.time)), learnt.learner.ratio()
    ratio.plot(lines, values[1:].T, color=look.GREY, linewidth=0.8)
    ratio.plot(lines, values[0], label="machine that learns, mean pose (grey: others, other poses)")
    ratio.axhline(1.0, color=look.DARK, linestyle=":")
    ratio.set(ylabel="largest singular value of Q (1 - L G)")
    look.frequency_axis(ratio.xaxis)
    dof = int(np.argmax(learnt.trials[0].axes[:3]))
    for number, error in zip((0, learnt.best), learnt.errors, strict=True):
        time = LEAD + np.arange(len(error)) / MOST_RATE
        history.plot(time, 1e3 * error[:, dof], label=f"trial {number}", linewidth=0.9)
    history.set(xlabel="time [s]", ylabel=f"error of {DOFS[dof]} [mm]")
    look.legend(trials, ratio, history, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    figure.suptitle("Tracking error of a manoeuvre as it is learnt")
    return figure


def save_learning(learnt: Learning, folder: Path) -> list[Path]:
    """Write the learnt demand `demand.csv`, `trials.csv` and `learning.png`."""
    files = {
        "demand.csv": lambda path: write_stream(learnt.demand, path),
        "trials.csv": trial_table(learnt),
        "learning.png": learning_figure(learnt),
    }
    return look.save_files(files, folder)
