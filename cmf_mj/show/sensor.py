"""Figures 3-15 and 3-16 of the report, tables of sensor sets, and figures of replays."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.table import Table
from scipy import signal

from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME
from cmf_mj.electronics.sensors.settings import CHANNELS, SensorSettings
from cmf_mj.facility.replay import Replay
from cmf_mj.studies.accelerometer_filter import (
    AMPLITUDE,
    FREQUENCY,
    REPORTED_REST,
    FilterEffect,
    Readings,
)

_RAW, _FILTERED, _TRUE = "#bbbbbb", "#d55e00", "#0072b2"


def effect_table(effect: FilterEffect) -> Table:
    """Readings at rest and the filter's effect, measured and predicted."""
    table = Table(
        "quantity", "measured", "closed form", title=f"leg accelerometers, {effect.sensors} sensors"
    )
    table.box = SIMPLE_HEAD
    gravity = units.STANDARD_GRAVITY
    rows = (
        (
            "reading at rest, neutral",
            f"{effect.rest_reading / gravity:.4f} g",
            f"{effect.axial_gravity / gravity:.4f} g (Appendix C); "
            f"hardware {REPORTED_REST / gravity:.2f} g",
        ),
        ("rms at rest, raw", f"{effect.raw_rms / gravity:.4f} g", ""),
        ("rms at rest, filtered", f"{effect.filtered_rms / gravity:.5f} g", ""),
        (
            "share of noise left",
            f"{effect.noise_gain:.4f}",
            f"{effect.predicted_noise_gain:.4f}",
        ),
        (
            f"gain at {FREQUENCY} Hz",
            f"{effect.signal_gain:.4f}",
            f"{effect.predicted_signal_gain:.4f}",
        ),
        (
            f"delay at {FREQUENCY} Hz",
            f"{1e3 * effect.delay:.2f} ms",
            f"{1e3 * effect.predicted_delay:.2f} ms",
        ),
    )
    for row in rows:
        table.add_row(*row)
    return table


def sensor_table(settings: SensorSettings) -> Table:
    """A sensor set with the unit, status and source of every number."""
    table = Table(title=f"sensors: {settings.name}, gravity {'on' if settings.gravity else 'off'}")
    for name in ("channel", "number", "value", "unit", "status", "source"):
        table.add_column(name, justify="right" if name == "value" else "left", overflow="fold")
    for channel in CHANNELS:
        given = settings.channel(channel).quantities()
        if not given:
            table.add_row(channel, "ideal", "", "", "", "")
        for name, number in given.items():
            cells = (f"{number.value:g}", number.unit, number.status, number.source)
            table.add_row(channel, name, *cells)
    return table


def _spectra(axis: Axes, readings: Readings) -> None:
    """Amplitude densities of leg 1, the mean of the six legs' powers."""
    for values, colour, label in (
        (readings.raw, _RAW, "raw"),
        (readings.filtered, _FILTERED, "filtered"),
    ):
        size = min(8192, values.shape[0])
        frequency, power = signal.welch(values, 1.0 / FRAME, nperseg=size, axis=0)
        density = np.sqrt(power.mean(axis=1)) / units.STANDARD_GRAVITY
        axis.loglog(frequency[1:], density[1:], color=colour, label=label)


def _times(axis: Axes, readings: Readings, frames: int) -> None:
    time = np.arange(min(frames, readings.raw.shape[0])) * FRAME
    for values, colour, label, width in (
        (readings.raw, _RAW, "raw", 0.5),
        (readings.truth, _TRUE, "true specific force", 1.2),
        (readings.filtered, _FILTERED, "filtered, Eq 3.6", 1.2),
    ):
        shown = values[: time.size, 0] / units.STANDARD_GRAVITY
        axis.plot(time, shown, color=colour, label=label, linewidth=width)
    axis.set(xlabel="time [s]", ylabel="accelerometer of leg 1 [g]", xlim=(0.0, time[-1]))


def _figure(readings: Readings, title: str, frames: int, *, rest: bool, law: Law) -> Figure:
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    history, spectrum = figure.subplots(2, 1)
    _times(history, readings, frames)
    history.set_title(title)
    if rest:
        level = REPORTED_REST / units.STANDARD_GRAVITY
        history.axhline(level, color="0.2", linestyle=":", label="hardware at rest, 0.86 g")
    _spectra(spectrum, readings)
    noise = np.std(readings.raw - readings.truth, axis=0).mean()
    if rest and noise > 0.0:
        frequency = np.geomspace(0.25, 0.5 / FRAME, 400)
        turn = np.exp(2j * np.pi * frequency * FRAME)
        share = np.abs(law.accelerometer_gain / (turn - law.accelerometer_pole))
        density = noise * np.sqrt(2.0 * FRAME) / units.STANDARD_GRAVITY
        spectrum.loglog(frequency, density * share, "k--", linewidth=1.0, label="closed form")
    spectrum.set(xlabel="frequency [Hz]", ylabel="density [g/√Hz]", xlim=(0.25, 0.5 / FRAME))
    for axis in (history, spectrum):
        axis.grid(True, which="major", color="0.9", linewidth=0.6)
        axis.legend(fontsize=8, loc="lower left" if axis is spectrum else "upper right")
    return figure


def save_sensor_figures(effect: FilterEffect, folder: Path) -> list[Path]:
    """Write `accelerometer_at_rest.png` (Figure 3-15) and `accelerometer_filter.png` (3-16)."""
    folder.mkdir(parents=True, exist_ok=True)
    law = load_law(effect.law)
    motion = f"heave {units.from_si('in', AMPLITUDE):.2f} in at {FREQUENCY} Hz"
    size = round(3.0 / (FREQUENCY * FRAME))
    pictures = {
        "accelerometer_at_rest.png": _figure(
            effect.rest, "at rest, as Figure 3-15", round(1.0 / FRAME), rest=True, law=law
        ),
        "accelerometer_filter.png": _figure(
            effect.motion, f"{motion}, as Figure 3-16", size, rest=False, law=law
        ),
    }
    for name, figure in pictures.items():
        figure.savefig(folder / name, dpi=110)
    return [folder / name for name in pictures]


def replay_figure(replayed: Replay) -> Figure:
    """Recorded and replayed compensator output of all legs, and their difference."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    *legs, apart = figure.subplots(replayed.output.shape[1] + 1, 1, sharex=True)
    for leg, axis in enumerate(legs):
        if replayed.recorded is not None:
            axis.plot(replayed.time, 100.0 * replayed.recorded[:, leg], color=_RAW, linewidth=3.0)
        axis.plot(replayed.time, 100.0 * replayed.output[:, leg], color=_TRUE, linewidth=0.8)
        axis.set_ylabel(f"leg {leg + 1} [%]", fontsize=8)
    if replayed.recorded is not None:
        difference = 100.0 * np.abs(replayed.output - replayed.recorded).max(axis=1)
        apart.plot(replayed.time, difference, color=_FILTERED, linewidth=0.8)
    apart.set(ylabel="largest\ndifference [%]", xlabel="time [s]")
    legs[0].set_title(f"compensator output: recorded (grey) and {replayed.law} replayed (blue)")
    for axis in (*legs, apart):
        axis.grid(True, color="0.9", linewidth=0.6)
    return figure


def save_replay(replayed: Replay, path: Path) -> Path:
    """Write `replay_figure` as a PNG file; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replay_figure(replayed).savefig(path, dpi=110)
    return path


def replay_summary(replayed: Replay) -> str:
    """The largest difference in one sentence."""
    if replayed.recorded is None:
        return f"{replayed.law}: nothing to compare with; the record has no compensator output"
    if replayed.identical:
        return f"{replayed.law}: identical, bit for bit, over {replayed.time.size} frames"
    note = ", interpolated to 2048 Hz" if replayed.interpolated else ""
    return f"{replayed.law}: largest difference {100.0 * replayed.difference:.3g} %{note}"
