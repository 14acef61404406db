"""What the accelerometer filter does, and replays in a figure and a sentence."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.replay import Replay
from cmf_mj.show.look import BLUE, ORANGE, grid, new_figure, save_figure
from cmf_mj.show.table import Table
from cmf_mj.studies.accelerometer_filter import FREQUENCY, REPORTED_REST, FilterEffect


def effect_table(effect: FilterEffect) -> Table:
    """Readings at rest and the filter's effect, measured and predicted."""
    at, g = f"at {FREQUENCY} Hz", STANDARD_GRAVITY
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


def replay_figure(replayed: Replay) -> Figure:
    """Recorded and replayed compensator output of all legs, and their difference."""
    figure = new_figure(9.0, 8.0)
    *legs, apart = figure.subplots(replayed.output.shape[1] + 1, 1, sharex=True)
    for leg, axis in enumerate(legs):
        if replayed.recorded is not None:
            axis.plot(
                replayed.time, 100.0 * replayed.recorded[:, leg], color="#bbbbbb", linewidth=3.0
            )
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
