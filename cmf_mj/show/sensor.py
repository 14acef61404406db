"""What the accelerometer filter does, and replays in a figure and a sentence."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.replay import Replay
from cmf_mj.show.look import BLUE, ORANGE, save_figure, stack
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
    output, recorded = 100.0 * replayed.output, replayed.recorded
    names = [f"leg {leg + 1} [%]" for leg in range(output.shape[1])]
    figure, (*legs, apart) = stack(9.0, 8.0, *names, "largest\ndifference [%]")
    if recorded is not None:
        for axis, values in zip(legs, 100.0 * recorded.T, strict=True):
            axis.plot(replayed.time, values, color="#bbbbbb", linewidth=3.0)
        difference = np.abs(output - 100.0 * recorded).max(axis=1)
        apart.plot(replayed.time, difference, color=ORANGE, linewidth=0.8)
    for axis, values in zip(legs, output.T, strict=True):
        axis.plot(replayed.time, values, color=BLUE, linewidth=0.8)
    legs[0].set_title(f"compensator output: recorded (grey) and {replayed.law} replayed (blue)")
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
