"""Tables, figures and files of flights in the cab."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from cmf_mj.core import units
from cmf_mj.core.files import whole_file
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.fly import Ride, error_spectra
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception.error import CueingError
from cmf_mj.pilot.transport import TransportDelay
from cmf_mj.show.comparison import markdown
from cmf_mj.show.film.film import FilmSettings, film
from cmf_mj.show.film.strip import Curve, Panel, Traces
from cmf_mj.show.operation import save_operation

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_NAMES = ("f_x", "f_y", "f_z", "p", "q", "r")
_TITLES = (
    "specific force x [m/s²]",
    "specific force y [m/s²]",
    "specific force z [m/s²]",
    "roll rate p [deg/s]",
    "pitch rate q [deg/s]",
    "yaw rate r [deg/s]",
)
_SCALE = np.array([1.0, 1.0, 1.0, units.DEGREE, units.DEGREE, units.DEGREE])
"""Plotted units in SI."""


def _six(motion: PilotMotion) -> NDArray[np.float64]:
    return np.hstack([motion.specific_force, motion.angular_rate]) / _SCALE


def _felt(ride: Ride) -> list[tuple[PilotMotion, str, str, float]]:
    """Motions at the pilot's station with label, colour and width: aircraft, asked, cab."""
    shown = [
        (ride.asked, "asked of the platform", "0.25", 0.9),
        (ride.simulator, "cab", _COLOURS[1], 0.9),
    ]
    if ride.aircraft is not None:
        shown.insert(0, (ride.aircraft, "aircraft", _COLOURS[0], 1.2))
    return shown


def flight_traces(ride: Ride) -> Traces:
    """Specific force and angular rate at the pilot's station as traces of a film."""
    felt = [(_six(motion), label, colour, width) for motion, label, colour, width in _felt(ride)]
    panels = tuple(
        Panel(
            f"{name} [{by_kind(index, 'm/s²', 'deg/s')}]",
            tuple(Curve(label, six[:, index], colour, width) for six, label, colour, width in felt),
        )
        for index, name in enumerate(_NAMES)
    )
    return Traces(ride.asked.time - ride.asked.time[0], panels, columns=2)


def save_film(
    rides: Sequence[Ride],
    path: Path,
    settings: FilmSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Film rides side by side, with what the pilot is subjected to under each.

    Args:
        rides: of one flight.
        path: ends in .mp4 or .gif.
        settings: how it looks.
        progress: called with the pictures done and those in all.

    Raises:
        InputError: an argument out of range or a missing package, named.
    """
    return film(
        [ride.operation.record for ride in rides],
        path,
        settings,
        titles=[f"{ride.law}, {ride.cab}" for ride in rides],
        traces=[flight_traces(ride) for ride in rides],
        progress=progress,
    )


def _grid(axes: Axes) -> None:
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def motion_figure(ride: Ride) -> Figure:
    """Specific force and angular rate at the pilot's station: aircraft, asked, cab."""
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    panels = figure.subplots(3, 2, sharex=True).T.ravel()
    for motion, label, colour, width in _felt(ride):
        for axes, values in zip(panels, _six(motion).T, strict=True):
            axes.plot(motion.time, values, color=colour, linewidth=width, label=label)
    for axes, title in zip(panels, _TITLES, strict=True):
        axes.set_ylabel(title)
        _grid(axes)
    for axes in panels[2::3]:
        axes.set_xlabel("time [s]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle(f"at the pilot's station: {ride.law}, cab {ride.cab}")
    return figure


def perceived_figure(ride: Ride) -> Figure:
    """What is sensed in aircraft and cab, and the error beside its threshold."""
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    panels = figure.subplots(3, 2, sharex=True).T.ravel()
    error = ride.machine if ride.cueing is None else ride.cueing
    before = "if followed at once" if ride.cueing is None else "sensed in the aircraft"
    sensed = [np.hstack([s.specific_force, s.angular_rate]) / _SCALE for s in error[:2]]
    for index, axes in enumerate(panels):
        time, limit = error.aircraft.time, error.threshold[index] / _SCALE[index]
        axes.axhspan(-limit, limit, color="0.92", label="threshold of the error")
        resting = -0.4 * units.STANDARD_GRAVITY if index == 2 else 0.0
        for values, label, colour in zip(
            sensed, (before, "sensed in the cab"), _COLOURS, strict=False
        ):
            shown = values[:, index] - (values[0, index] if resting else 0.0)
            axes.plot(time, shown, color=colour, linewidth=1.0, label=label)
        axes.plot(
            time, error.error[:, index] / _SCALE[index], color="0.3", linewidth=0.8, label="error"
        )
        axes.set_ylabel(_TITLES[index] + ("\nless the start" if resting else ""))
        _grid(axes)
    for axes in panels[2::3]:
        axes.set_xlabel("time [s]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle(f"sensed by otoliths and canals: {ride.law}, cab {ride.cab}")
    return figure


def envelope_figure(ride: Ride) -> Figure:
    """Legs and degrees of freedom over their limits."""
    record, limits = ride.operation.record, load_motion_limits()
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    legs, pose = figure.subplots(2, 1, sharex=True)
    stroke = units.from_si("in", limits.leg.position.si)
    for leg, values in enumerate(record["leg_extension"].T):
        legs.plot(record.time, values / units.INCH, linewidth=0.9, label=f"leg {leg + 1}")
    for sign in (-1.0, 1.0):
        legs.axhline(sign * stroke, color="0.3", linestyle=":")
    legs.set_ylabel("leg extension [in]")
    legs.set_title(
        f"working stroke ±{stroke:g} in (dotted); largest use {ride.use.leg_position:.0%}"
    )
    low, high = limits.operational.T
    used = 100.0 * np.maximum(record["platform_pose"] / low, record["platform_pose"] / high)
    for dof, values, colour in zip(DOFS, used.T, _COLOURS, strict=True):
        pose.plot(record.time, values, color=colour, linewidth=0.9, label=dof)
    pose.axhline(100.0, color="0.3", linestyle=":")
    pose.set(ylabel="operational limit used [%]", xlabel="time [s]", ylim=(0.0, 110.0))
    for axes in (legs, pose):
        axes.legend(fontsize=8, ncols=6, loc="upper center")
        _grid(axes)
    legs.set_ylim(-1.35 * stroke, 1.35 * stroke)
    pose.set_ylim(0.0, 125.0)
    return figure


def comparison_figure(rides: Sequence[Ride]) -> Figure:
    """Spectra of the machine's error at the pilot's station and its perceived size, law by law."""
    figure = Figure(figsize=(12.0, 10.5), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(2.1, 1.0))
    above, below = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    panels = above.subplots(2, 3, sharex=True).ravel()
    first = rides[0]
    curves: list[tuple[PilotMotion, PilotMotion, str, str, float]] = []
    if first.aircraft is not None:
        label = "washout: aircraft less asked"
        curves.append((first.aircraft, first.asked, label, "0.6", 2.5))
    for ride, colour in zip(rides, _COLOURS, strict=False):
        curves.append((ride.asked, ride.simulator, ride.law, colour, 1.2))
    for reference, motion, label, colour, width in curves:
        frequency, density = error_spectra(reference, motion)
        for index, axes in enumerate(panels):
            size = np.sqrt(density[1:, index]) / _SCALE[index]
            axes.loglog(frequency[1:], size, color=colour, linewidth=width, label=label)
    for index, axes in enumerate(panels):
        unit = by_kind(index, "m/s²/√Hz", "deg/s/√Hz")
        axes.set_title(f"error of {_NAMES[index]} [{unit}]", fontsize=10)
        axes.set_xlim(frequency[1], 30.0)
        axes.grid(True, which="major", color="0.9", linewidth=0.6)
        if index > 2:
            axes.set_xlabel("frequency [Hz]")
    panels[0].legend(fontsize=8, loc="lower left")
    _bars(below.subplots(1, 2), rides)
    above.suptitle(
        f"pilot's station, cab {first.cab}: error spectra (asked of the platform less cab)"
    )
    return figure


def _bars(panels: NDArray[np.object_], rides: Sequence[Ride]) -> None:
    """Perceived rms errors over their thresholds: of the machine, and against the aircraft."""
    titles = ("of the machine: asked less cab", "of the flight: aircraft less cab")
    groups: list[list[tuple[str, str, CueingError]]] = [[], []]
    for ride, colour in zip(rides, _COLOURS, strict=False):
        groups[0].append((ride.law, colour, ride.machine))
        if ride.cueing is not None:
            groups[1].append((ride.law, colour, ride.cueing))
    baseline = rides[0].washout_error
    if baseline is not None:
        groups[1].insert(0, ("machine that follows at once", "0.6", baseline))
    for axes, title, group in zip(panels, titles, groups, strict=True):
        for place, (label, colour, error) in enumerate(group):
            at = np.arange(6) + 0.8 * ((place + 0.5) / len(group) - 0.5)
            axes.bar(at, error.rms / error.threshold, 0.75 / len(group), color=colour, label=label)
        axes.axhline(1.0, color="0.3", linestyle=":", linewidth=0.9)
        axes.set_xticks(range(6), _NAMES)
        axes.set(yscale="log", ylabel="perceived rms error / threshold")
        axes.set_title(f"perceived error {title}", fontsize=10)
        axes.grid(True, axis="y", color="0.9", linewidth=0.6)
        axes.set_axisbelow(True)
        if group:
            least = min(float((error.rms / error.threshold).min()) for *_, error in group)
            axes.set_ylim(bottom=0.5 * max(least, 1e-4))
            axes.legend(fontsize=7, loc="upper right")


def comparison_cells(rides: Sequence[Ride]) -> tuple[list[str], list[list[str]]]:
    """Header and a line per law: perceived rms errors of machine and flight, delay, envelope."""
    header = ["law"]
    header += [f"{name} [{by_kind(i, 'mm/s²', 'deg/s')}]" for i, name in enumerate(_NAMES)]
    header += ["flight: f_x [mm/s²]", "f_y [mm/s²]", "loop [ms]", "legs [%]", "fault"]

    def cells(error: CueingError, indices: Sequence[int]) -> list[str]:
        rms = error.rms / _SCALE
        return [f"{1e3 * rms[i]:.1f}" if i < 3 else f"{rms[i]:.3f}" for i in indices]

    lines = []
    baseline = rides[0].washout_error
    if baseline is not None:
        lines.append(
            ["machine that follows at once", *["0"] * 6, *cells(baseline, (0, 1)), "0", "-", "-"]
        )
    for ride in rides:
        flight = ["-", "-"] if ride.cueing is None else cells(ride.cueing, (0, 1))
        line = [ride.law, *cells(ride.machine, range(6)), *flight]
        line += [f"{1e3 * ride.loop_delay:.0f}", f"{100 * ride.use.leg_position:.0f}"]
        lines.append([*line, ride.fault or "none"])
    return header, lines


def comparison_table(rides: Sequence[Ride]) -> Table:
    """The comparison for the terminal."""
    header, lines = comparison_cells(rides)
    title = "perceived rms error of the machine; of the whole flight; delay; envelope"
    table = Table(*map(escape, header), title=title, box=SIMPLE_HEAD)
    for line in lines:
        table.add_row(*line)
    return table


def delay_table(delay: TransportDelay) -> Table:
    """The way from host to pilot, stage by stage."""
    table = Table(
        "stage",
        escape("delay [ms]"),
        "",
        title=f"host to pilot, {delay.dof} at {delay.frequency:g} Hz",
        box=SIMPLE_HEAD,
    )
    for stage in delay.stages:
        table.add_row(
            stage.name, f"{1e3 * stage.delay:.2f}", "setting" if stage.known else "measured"
        )
    table.add_row("host to leg reference", f"{1e3 * delay.host_to_reference:.2f}", "measured")
    table.add_row("host to pilot", f"{1e3 * delay.total:.2f}", "measured")
    return table


def save_ride(ride: Ride, folder: Path) -> list[Path]:
    """Write the run's files and `motion.png`, `perceived.png`, `envelope.png`."""
    paths = save_operation(ride.operation, folder)
    for name, figure in (
        ("motion", motion_figure(ride)),
        ("perceived", perceived_figure(ride)),
        ("envelope", envelope_figure(ride)),
    ):
        paths.append(folder / f"{name}.png")
        figure.savefig(paths[-1], dpi=110)
    return paths


def save_comparison(rides: Sequence[Ride], folder: Path) -> list[Path]:
    """Write `comparison.csv`, `comparison.md` and `comparison.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    header, lines = comparison_cells(rides)
    paths = [folder / f"comparison.{suffix}" for suffix in ("csv", "md", "png")]
    with whole_file(paths[0]) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *lines])
    with whole_file(paths[1]) as partial:
        partial.write_text(markdown(header, lines), encoding="utf-8")
    comparison_figure(rides).savefig(paths[2], dpi=80)
    return paths
