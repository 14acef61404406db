"""Tables, figures and files of flights in the cab, and of manoeuvres that were learnt."""

from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cmf_mj.core.result import Cell, Column, Table
from cmf_mj.core.units import DEGREE
from cmf_mj.facility.host.stream import write_stream
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.pilot.cueing import LIMITS
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.fly import FlightResult
from cmf_mj.pilot.learning import BAND, LEAD, Learning, filter_frequencies
from cmf_mj.pilot.motion import MOST_RATE
from cmf_mj.pilot.perception import CueingError
from cmf_mj.show import cueing, look
from cmf_mj.show.player.traces import Panels

_STYLES = {
    "aircraft": ("aircraft", look.BLUE, 1.2),
    "asked": ("asked of the platform", look.DARK, 0.9),
    "simulator": ("cab", look.ORANGE, 0.9),
}
"""Label, colour and line width of each motion at the pilot's station."""
_PRINTED_PER_SI = np.array([by_kind(dof, 1e3, 1.0 / DEGREE) for dof in DOFS])
"""Printed units in one SI unit: mm or mm/s^2, and deg or deg/s."""
_LEAST_CHANGE = 0.01  #: Of a motion along an axis that is drawn [m/s^2, deg/s].


def drawn_motions(flight: FlightResult) -> list[cueing.DrawnMotion]:
    """The motions of a flight."""
    return [cueing.DrawnMotion(getattr(flight, name), *style) for name, style in _STYLES.items()]


def saved_traces(records: Sequence[Path]) -> list[Panels]:
    """Panels of what the pilot felt, as `save_flight` wrote it beside each record; else none.

    They are of the axes along which a motion of any record changes by more than `_LEAST_CHANGE`.
    """
    files = [{name: path.with_name(f"{name}.parquet") for name in _STYLES} for path in records]
    if not all(path.exists() for paths in files for path in paths.values()):
        return []
    panels_by_record = [
        cueing.motion_panels(
            *(
                cueing.DrawnMotion(load_flight(path).motion, *_STYLES[name])
                for name, path in paths.items()
            )
        )
        for paths in files
    ]
    has_motion = [
        any(np.ptp(curve.y) > _LEAST_CHANGE for panel in panels_of_axis for curve in panel.curves)
        for panels_of_axis in zip(*panels_by_record, strict=True)
    ]
    return [tuple(compress(panels, has_motion)) for panels in panels_by_record]


class _Bars(NamedTuple):
    """Bars of an error, one for each of `MOTION_NAMES`."""

    label: str
    colour: str
    error: CueingError


def comparison_figure(flights: Sequence[FlightResult]) -> Figure:
    """Perceived size of the machine's error and of the flight's, law by law."""
    figure, first = look.new_figure(12.0, 4.5), flights[0]
    machine_axes, flight_axes = figure.subplots(1, 2)
    machine_bars = list[_Bars]()
    flight_bars = [_Bars("machine that follows at once", look.GREY, first.washout_error)]
    for flight, colour in zip(flights, look.COLOURS, strict=False):
        machine_bars.append(_Bars(flight.law, colour, flight.machine))
        flight_bars.append(_Bars(flight.law, colour, flight.cueing))
    _plot_bars(machine_axes, "of the machine: asked less cab", machine_bars)
    _plot_bars(flight_axes, "of the flight: aircraft less cab", flight_bars)
    look.legend(figure)
    figure.suptitle(f"Error at the pilot's station of cab {first.cab}, as it is sensed")
    return figure


def _plot_bars(axes: Axes, title: str, bars: Sequence[_Bars]) -> None:
    """Draw perceived rms errors over their thresholds."""
    ratios = [bar.error.rms / bar.error.threshold for bar in bars]
    for index, (bar, ratio) in enumerate(zip(bars, ratios, strict=True)):
        x = np.arange(6) + 0.8 * ((index + 0.5) / len(bars) - 0.5)
        axes.bar(x, ratio, 0.75 / len(bars), color=bar.colour, label=bar.label)
    axes.axhline(1.0, color=look.DARK, linestyle=":", linewidth=0.9)
    axes.set_xticks(range(6), cueing.MOTION_NAMES)
    label = "specific force and angular rate, body axes"
    axes.set(yscale="log", xlabel=label, ylabel="perceived rms error / threshold")
    axes.set_title(f"perceived error {title}")
    least = min(float(ratio.min()) for ratio in ratios)
    axes.set_ylim(bottom=0.5 * max(least, 1e-4))


def flight_table(flights: Sequence[FlightResult]) -> Table:
    """Perceived rms errors of the machine, of the whole flight, delay and envelope, law by law."""
    columns: list[Column] = [
        (f"{name} [{by_kind(i, 'mm/s²', 'deg/s')}]", by_kind(i, ".1f", ".3f"))
        for i, name in enumerate(cueing.MOTION_NAMES)
    ]
    columns += [("flight: f_x [mm/s²]", ".1f"), ("f_y [mm/s²]", ".1f"), ("loop [ms]", ".0f")]
    ideal_x, ideal_y, *_ = flights[0].washout_error.rms * _PRINTED_PER_SI
    no_errors = ["0"] * len(_PRINTED_PER_SI)
    rows: list[list[Cell]] = [
        ["machine that follows at once", *no_errors, ideal_x, ideal_y, "0", None, None]
    ]
    leg_displacement = LIMITS.index("leg_displacement")
    for flight in flights:
        force_x, force_y, *_ = flight.cueing.rms * _PRINTED_PER_SI
        errors = [*(flight.machine.rms * _PRINTED_PER_SI), force_x, force_y]
        legs = 100 * flight.use.share[leg_displacement].max()
        rows.append([flight.law, *errors, 1e3 * flight.loop_delay, legs, flight.fault or "none"])
    title = "perceived rms error of the machine; of the whole flight; delay; envelope"
    return Table(title, ("law", *columns, ("legs [%]", ".0f"), "fault"), rows)


def save_flight(flight: FlightResult, folder: Path) -> list[Path]:
    """Write `motion.png`, `perceived.png` and the motions that `saved_traces` reads."""
    files: dict[str, Any] = {f"{name}.parquet": getattr(flight, name) for name in _STYLES}
    case = f"{flight.law}, cab {flight.cab}"
    title = f"Motion at the pilot's station: {case}"
    files["motion.png"] = cueing.motion_axes(title, *drawn_motions(flight)).figure
    title = f"Motion sensed by otoliths and canals: {case}"
    sensed = cueing.perceived_figure(title, flight.cueing, "in the aircraft", "in the cab")
    return look.save_files(files | {"perceived.png": sensed}, folder)


def save_flights(flights: Sequence[FlightResult], folder: Path) -> list[Path]:
    """Write `comparison.csv`, `comparison.md` and `comparison.png`."""
    table = flight_table(flights)
    files = {"comparison.csv": table, "comparison.md": table}
    return look.save_files(files | {"comparison.png": comparison_figure(flights)}, folder, 80)


def trial_table(learnt: Learning) -> Table:
    """Errors of each trial, and their share of the first run's."""
    axes = [(f"{dof} [{by_kind(dof, 'mm', 'deg')}]", ".3f") for dof in DOFS]
    first, rows = learnt.trials[0], []
    for number, trial in enumerate(learnt.trials):
        shares = [100.0 * trial.legs / first.legs, 100.0 * trial.predicted / first.predicted]
        errors = [*(trial.pose * _PRINTED_PER_SI), 1e3 * trial.legs, *shares]
        rows.append([str(number), *errors, trial.held_frames])
    columns = [("legs [mm]", ".3f"), ("left [%]", ".2f"), ("linear [%]", ".2f"), ("held", "d")]
    title = f"tracking error below {BAND:g} Hz, rms; left of the first run's"
    return Table(title, ("trial", *axes, *columns), rows)


def verdict_text(learnt: Learning) -> str:
    """Convergence of the linear models, and the best trial."""
    own_ratio, *other_ratios = learnt.learner.ratio().max(axis=1)
    share = learnt.trials[learnt.best].legs / learnt.trials[0].legs
    return (
        f"largest singular value of Q (1 - L G): {own_ratio:.2f} of the machine that learns, "
        f"{max(own_ratio, *other_ratios):.2f} over machines and poses; best trial {learnt.best}: "
        f"{share:.2%} left"
    )


def learning_figure(learnt: Learning) -> Figure:
    """Error by trial, convergence by frequency, the error in time."""
    figure = look.new_figure(11.0, 7.0)
    axes = figure.subplot_mosaic([["trials", "ratio"], ["history", "history"]])
    trials, ratio, history = axes.values()
    for label, name, style in (("simulated", "sensed", "o-"), ("linear", "predicted", "x--")):
        errors = [1e3 * getattr(trial, name) for trial in learnt.trials]
        trials.semilogy(errors, style, label=label)
    trials.set(xlabel="trial", ylabel=f"legs below {BAND:g} Hz, rms as sensed [mm]")
    hertz = filter_frequencies(len(learnt.reference.time))
    own_ratio, *other_ratios = learnt.learner.ratio()
    ratio.plot(hertz, np.transpose(other_ratios), color=look.GREY, linewidth=0.8)
    ratio.plot(hertz, own_ratio, label="machine that learns, mean pose (grey: others, other poses)")
    ratio.axhline(1.0, color=look.DARK, linestyle=":")
    ratio.set(ylabel="largest singular value of Q (1 - L G)")
    look.frequency_axis(ratio.xaxis)
    dof = int(np.argmax(learnt.trials[0].pose[:3]))
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
