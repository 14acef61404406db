"""Figures 3-15 and 3-16 of the report, what the filter does, and figures of replays."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy import signal

from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME
from cmf_mj.facility.replay import Replay
from cmf_mj.show.look import BLUE, DARK, ORANGE, grid, legend, new_figure, save_figure, save_figures
from cmf_mj.show.table import Table
from cmf_mj.studies.accelerometer_filter import (
    AMPLITUDE,
    FREQUENCY,
    REPORTED_REST,
    FilterEffect,
    Readings,
)

_RAW = "#bbbbbb"
_GRAVITY = units.STANDARD_GRAVITY


def effect_table(effect: FilterEffect) -> Table:
    """Readings at rest and the filter's effect, measured and predicted."""
    at, g = f"at {FREQUENCY} Hz", _GRAVITY
    rest = f"{effect.axial_gravity / g:.4f} g (Appendix C); hardware {REPORTED_REST / g:.2f} g"
    rows = (
        ("reading at rest, neutral", f"{effect.rest_reading / g:.4f} g", rest),
        ("rms at rest, raw", f"{effect.raw_rms / g:.4f} g", ""),
        ("rms at rest, filtered", f"{effect.filtered_rms / g:.5f} g", ""),
        ("share of noise left", f"{effect.noise_gain:.4f}", f"{effect.predicted_noise_gain:.4f}"),
        (f"gain {at}", f"{effect.signal_gain:.4f}", f"{effect.predicted_signal_gain:.4f}"),
        (f"delay {at}", f"{1e3 * effect.delay:.2f} ms", f"{1e3 * effect.predicted_delay:.2f} ms"),
    )
    title = f"leg accelerometers, {effect.sensors} sensors"
    return Table(title, ("quantity", "measured", "closed form"), rows)


def _figure(readings: Readings, title: str, frames: int, *, rest: bool, law: Law) -> Figure:
    """Readings of leg 1 over time, and amplitude densities: the mean of the six legs' powers."""
    figure = new_figure(8.0, 7.0)
    history, spectrum = figure.subplots(2, 1)
    time = np.arange(min(frames, readings.raw.shape[0])) * FRAME
    for values, colour, label, width in (
        (readings.raw, _RAW, "raw", 0.5),
        (readings.truth, BLUE, "true specific force", 1.2),
        (readings.filtered, ORANGE, "filtered, Eq 3.6", 1.2),
    ):
        start = values[: time.size, 0] / _GRAVITY
        history.plot(time, start, color=colour, label=label, linewidth=width)
    if rest:
        level = REPORTED_REST / _GRAVITY
        history.axhline(level, color=DARK, linestyle=":", label="hardware at rest, 0.86 g")
    history.set(xlabel="time [s]", ylabel="accelerometer of leg 1 [g]", xlim=(0.0, time[-1]))
    history.set_title(title)
    for values, colour, label in (
        (readings.raw, _RAW, "raw"),
        (readings.filtered, ORANGE, "filtered"),
    ):
        size = min(8192, values.shape[0])
        frequency, power = signal.welch(values, 1.0 / FRAME, nperseg=size, axis=0)
        density = np.sqrt(power.mean(axis=1)) / _GRAVITY
        spectrum.loglog(frequency[1:], density[1:], color=colour, label=label)
    noise = np.std(readings.raw - readings.truth, axis=0).mean()
    if rest and noise > 0.0:
        frequency = np.geomspace(0.25, 0.5 / FRAME, 400)
        turn = np.exp(2j * np.pi * frequency * FRAME)
        share = np.abs(law.accelerometer_gain / (turn - law.accelerometer_pole))
        density = noise * np.sqrt(2.0 * FRAME) / _GRAVITY
        spectrum.loglog(frequency, density * share, "k--", linewidth=1.0, label="closed form")
    spectrum.set(xlabel="frequency [Hz]", ylabel="density [g/√Hz]", xlim=(0.25, 0.5 / FRAME))
    grid(history, spectrum)
    legend(history, loc="upper right")
    legend(spectrum, loc="lower left")
    return figure


def save_sensor_figures(effect: FilterEffect, folder: Path) -> list[Path]:
    """Write `accelerometer_at_rest.png` (Figure 3-15) and `accelerometer_filter.png` (3-16)."""
    law, second, cycles = load_law(effect.law), round(1.0 / FRAME), round(3.0 / (FREQUENCY * FRAME))
    motion = f"heave {units.from_si('in', AMPLITUDE):.2f} in at {FREQUENCY} Hz, as Figure 3-16"
    still = "at rest, as Figure 3-15"
    figures = {
        "accelerometer_at_rest": _figure(effect.rest, still, second, rest=True, law=law),
        "accelerometer_filter": _figure(effect.motion, motion, cycles, rest=False, law=law),
    }
    return save_figures(figures, folder)


def replay_figure(replayed: Replay) -> Figure:
    """Recorded and replayed compensator output of all legs, and their difference."""
    figure = new_figure(9.0, 8.0)
    *legs, apart = figure.subplots(replayed.output.shape[1] + 1, 1, sharex=True)
    for leg, axis in enumerate(legs):
        if replayed.recorded is not None:
            axis.plot(replayed.time, 100.0 * replayed.recorded[:, leg], color=_RAW, linewidth=3.0)
        axis.plot(replayed.time, 100.0 * replayed.output[:, leg], color=BLUE, linewidth=0.8)
        axis.set_ylabel(f"leg {leg + 1} [%]", fontsize=8)
    if replayed.recorded is not None:
        difference = 100.0 * np.abs(replayed.output - replayed.recorded).max(axis=1)
        apart.plot(replayed.time, difference, color=ORANGE, linewidth=0.8)
    apart.set(ylabel="largest\ndifference [%]", xlabel="time [s]")
    legs[0].set_title(f"compensator output: recorded (grey) and {replayed.law} replayed (blue)")
    grid(*legs, apart)
    return figure


def save_replay(replayed: Replay, path: Path) -> Path:
    """Write `replay_figure` as a PNG file; folders are made."""
    return save_figure(replay_figure(replayed), path)


def replay_summary(replayed: Replay) -> str:
    """The largest difference in one sentence."""
    if replayed.recorded is None:
        return f"{replayed.law}: nothing to compare with; the record has no compensator output"
    if replayed.identical:
        return f"{replayed.law}: identical, bit for bit, over {replayed.time.size} frames"
    note = ", interpolated to 2048 Hz" if replayed.interpolated else ""
    return f"{replayed.law}: largest difference {100.0 * replayed.difference:.3g} %{note}"
