"""Tables, figures and files of cueing: flights at the station, the objective motion cueing test."""

from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from cmf_mj.core.result import Table, number
from cmf_mj.core.units import DEGREE, INCH, STANDARD_GRAVITY
from cmf_mj.facility.host.stream import write_stream
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.pilot.cueing import LIMITS, Cue, Excursion
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.omct import STAGES, TESTS, Omct
from cmf_mj.pilot.perception import QUANTITIES, CueingError, Sensed
from cmf_mj.show import look

MOTION_NAMES = ("f_x", "f_y", "f_z", "p", "q", "r")  #: Of specific force and angular rate.
_PLOT_UNITS = ("m/s²", "deg/s")  #: Of specific force and angular rate.
_PLOT_UNIT_SI = np.array([1.0, 1.0, 1.0, DEGREE, DEGREE, DEGREE])
"""SI value of one plotted unit, for `MOTION_NAMES`, (6,)."""
_LEAST_SPAN = 0.1  #: Least height of an axis, in its unit; else round-off would fill it.


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
        look.Panel(f"{name} [{by_kind(axis, *_PLOT_UNITS)}]", curves)
        for axis, (name, *curves) in enumerate(zip(MOTION_NAMES, *curves_by_motion, strict=True))
    ]


class MotionAxes(NamedTuple):
    """A figure of motions with its axes."""

    figure: Figure
    panels: NDArray[Any]  #: For each of `MOTION_NAMES`, (6,).
    below: NDArray[Any]  #: Empty ones, (rows - 3, 2).


def motion_axes(title: str, *motions: DrawnMotion, rows: int = 3) -> MotionAxes:
    """Draw forces at the left and rates at the right, above rows of empty axes."""
    figure = look.new_figure(11.0, 8.0 if rows == 3 else 2.4 * rows)
    axes = figure.subplots(rows, 2, sharex=True)
    figure.suptitle(title)
    panels = axes[:3].T.ravel()
    for axis, panel in zip(panels, motion_panels(*motions), strict=True):
        look.plot_panel(axis, panel)
        low, high = axis.get_ylim()
        if high - low < _LEAST_SPAN:
            middle = 0.5 * (low + high)
            axis.set_ylim(middle - 0.5 * _LEAST_SPAN, middle + 0.5 * _LEAST_SPAN)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    look.legend(figure)
    return MotionAxes(figure, panels, axes[3:])


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
    for axis, limit in zip(panels, error.threshold / _PLOT_UNIT_SI, strict=True):
        axis.axhspan(-limit, limit, color=look.PALE, zorder=0.0)
        axis.autoscale(axis="y")
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
    plot_units = [by_kind(axis, *_PLOT_UNITS) for axis in range(len(QUANTITIES))]
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
        place = f"leg {largest + 1}" if name.startswith("leg_") else DOFS[largest]
        rows.append((name.replace("_", " "), 100.0 * shares[largest], place, times[largest]))
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
    for (platform, leg), unit, scale, numbers in zip(
        below.T, ("m", "deg"), (1.0, DEGREE), (range(3), range(3, 6)), strict=True
    ):
        for i in numbers:
            platform.plot(time, pose[:, i] / scale, lw=1.2, label=DOFS[i])
            leg.plot(time, legs[:, i], lw=1.2, label=f"leg {i + 1}")
        platform.set_ylabel(f"platform [{unit}]")
        leg.set_ylabel("extension [in]")
    look.legend(*below.flat)
    if flown.limited.any():
        for axis in below.flat:
            look.shade(axis, time, flown.limited)
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


_GRAVITY_PER_DEG = STANDARD_GRAVITY * DEGREE  #: Specific force of a small tilt [m/s^2/deg].
_OMCT_CAPTION = (
    "modulus and phase [deg] from the aircraft's pilot to the simulator's; washout: host frames; "
    "ideal: behind the DCU, machine ideal; laws: at the crew's accelerometer of the machine. Cross "
    f"tests: m/s^2 per deg (the aircraft itself: {_GRAVITY_PER_DEG:.3f}) and deg per m/s^2 (the "
    "aircraft: 0). No boundary of acceptance is known."
)

SHARE_TOP = 2.0 * np.pi + 0.1
"""Highest frequency of `share_table` [rad/s]: the test's 6.31, which is 1 Hz, and a margin."""
_ROTATIONS = ("roll", "pitch", "yaw")


def _modulus_unit(driven: str, output: str) -> tuple[str, float]:
    """Unit of a test's modulus and what one of it is in SI."""
    if (driven in _ROTATIONS) == (output in _ROTATIONS):
        return "", 1.0
    return ("m/s^2/deg", 1.0 / DEGREE) if driven in _ROTATIONS else ("deg/(m/s^2)", DEGREE)


def _phase_deg(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Phase [deg] unwrapped along the frequencies that have a response, (K,)."""
    known, angle = np.isfinite(response), np.full(response.shape, np.nan)
    angle[known] = np.degrees(np.unwrap(np.angle(response[known])))
    return angle


def omct_table(result: Omct) -> Table:
    """Modulus and phase of each test and stage over the frequencies."""
    rows: list[list[str]] = []
    first_stage, second_stage = STAGES
    for place, (driven, output) in enumerate(TESTS):
        unit, scale = _modulus_unit(driven, output)
        titles = {first_stage: f"{driven} > {output}", second_stage: unit}
        for stage, responses in result.responses.items():
            response = responses[place]
            if not np.isfinite(response).any():
                continue
            moduli = (number(modulus, ".3f") for modulus in np.abs(response) / scale)
            phases = (number(phase, ".0f") for phase in _phase_deg(response))
            rows.append([titles.get(stage, ""), stage, "mod", *moduli])
            rows.append(["", "", "deg", *phases])
    title = f"OMCT: washout {result.washout}, {result.cab} cab, {result.hydraulics} hydraulics"
    frequencies = [(f"{value:.3g}", "") for value in result.frequency]
    return Table(title, ("test", "", "rad/s", *frequencies), rows, _OMCT_CAPTION)


def share_table(result: Omct) -> Table:
    """One row per test, one column per law, of frequencies up to `SHARE_TOP`.

    A cell has the least to the largest modulus of machine over ideal machine, one number where they
    round alike, and the phase [deg] at the last frequency. It has a `*` if at any frequency the
    remainder exceeds the fundamental.
    """
    laws = [name for name in result.responses if name not in STAGES]
    is_low = result.frequency <= SHARE_TOP
    rows = []
    for place, (driven, output) in enumerate(TESTS):
        shares = {law: result.share(law)[place][is_low] for law in laws}
        if any(np.isfinite(share).any() for share in shares.values()):
            remainders = {law: result.remainder[law][place][is_low] for law in laws}
            cells = [_share_cell(shares[law], bool((remainders[law] > 1.0).any())) for law in laws]
            rows.append([f"{driven} > {output}", *cells])
    return Table("", ("test", *laws), rows)


def _share_cell(share: NDArray[np.complex128], remainder_dominates: bool) -> str:
    known = np.isfinite(share)
    if not known.any():
        return "-"
    moduli = np.abs(share[known])
    ends = (number(modulus, ".2f") for modulus in (moduli.min(), moduli.max()))
    modulus = " to ".join(dict.fromkeys(ends))
    last_phase = number(_phase_deg(share)[known][-1], ".0f")
    star = "*" if remainder_dominates else ""
    fault = "" if known.all() else ", left its bounds"
    return f"{modulus}, {last_phase}°{star}{fault}"


def omct_figure(result: Omct) -> Figure:
    """Modulus and phase over frequency of all tests that were made, two tests in a row."""
    is_tested = np.isfinite(np.array(list(result.responses.values()))).any(axis=(0, 2))
    places = np.flatnonzero(is_tested).tolist()
    rows, columns = -(-len(places) // 2), 2 * min(len(places), 2)
    figure = look.new_figure(3.25 * columns, 3.0 * rows + 0.6)
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for place, (modulus, phase) in zip(places, axes.reshape(-1, 2), strict=False):
        _plot_test(modulus, phase, result, place)
    for axis in axes.flat:
        axis.grid(True, which="both")
        axis.set_visible(axis.has_data())
    for column in axes.T:
        last = column[sum(axis.has_data() for axis in column) - 1]  # lowest axis that is drawn
        look.frequency_axis(last.xaxis, "rad/s")
        last.tick_params(labelbottom=True)
    look.legend(figure)
    figure.suptitle(
        "Modulus and phase from the aircraft's pilot to the simulator's: "
        f"washout {result.washout}, cab {result.cab}, {result.hydraulics} hydraulics"
    )
    return figure


def _plot_test(modulus: Axes, phase: Axes, result: Omct, place: int) -> None:
    """Draw modulus and phase of the test at a place in `TESTS`, a line a stage."""
    driven, output = TESTS[place]
    unit, scale = _modulus_unit(driven, output)
    colours = dict.fromkeys((look.GREY, look.BLACK, *look.COLOURS))  # each once
    for colour, (stage, responses) in zip(cycle(colours), result.responses.items(), strict=False):
        style: dict[str, Any] = {"color": colour, "label": stage}
        style |= {"linestyle": "--" if stage == "washout" else "-", "marker": ".", "lw": 1.2}
        modulus.plot(result.frequency, np.abs(responses[place]) / scale, **style)
        phase.plot(result.frequency, _phase_deg(responses[place]), **style)
    modulus.set(yscale="log")
    low, high = modulus.get_ylim()
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    modulus.yaxis.set_major_formatter(plain)
    modulus.yaxis.set_minor_formatter(plain if high < 10.0 * low else NullFormatter())
    if driven != output and driven in _ROTATIONS:
        modulus.axhline(_GRAVITY_PER_DEG, color=look.GREY, linestyle=":")
    ylabel = f"modulus [{unit}]" if unit else "modulus"
    modulus.set(title=f"{driven} > {output}", ylabel=ylabel)
    phase.set_ylabel("phase [deg]")


def save_omct(result: Omct, folder: Path) -> list[Path]:
    """Write `omct.csv` (modulus in SI, phases in deg), `omct.md`, `share.md` and `omct.png`."""
    rows = []
    for place, (driven, output) in enumerate(TESTS):
        for stage, responses in result.responses.items():
            share, response = result.share(stage)[place], responses[place]
            columns = {
                "frequency_rad_s": result.frequency,
                "modulus_si": np.abs(response),
                "phase_deg": _phase_deg(response),
                "remainder": result.remainder[stage][place],
                "share_modulus": np.abs(share),
                "share_phase_deg": _phase_deg(share),
            }
            test = {"test": f"{driven}>{output}", "stage": stage}
            for line in np.flatnonzero(np.isfinite(response)):
                rows.append(test | {name: values[line] for name, values in columns.items()})
    files = {
        "omct.csv": rows,
        "omct.md": omct_table(result),
        "share.md": share_table(result),
        "omct.png": omct_figure(result),
    }
    return look.save_files(files, folder, 70)
