"""Figures 3-15 and 3-16 of the report made anew, tables of sensor sets, and figures of replays.

The accelerometer filter y[k+1] = a y[k] + b x[k] (Eq 3.6) has the frequency response

    H(f) = b / (exp(2 pi i f T) - a)

and leaves of white noise the share b / sqrt(1 - a^2) (`noise_gain`). Both stand beside what the
simulated sensors show.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table
from scipy import signal

from cmf_mj import signals
from cmf_mj.control.feedback import filter_acceleration, make_feedback, noise_gain
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME
from cmf_mj.core.settings import validated
from cmf_mj.electronics.sensors.settings import CHANNELS, SensorSettings, load_sensors
from cmf_mj.electronics.sensors.suite import Truth, make_sensors, sense_history
from cmf_mj.facility.replay import FEEDBACK, Replay
from cmf_mj.facility.simulation import simulate
from cmf_mj.machine.gravity import axial_gravity
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record

AMPLITUDE, FREQUENCY = 0.33 * units.INCH, 1.2
"""Heave motion of Figure 3-16 [m, Hz] (section 3.4.1)."""
REPORTED_REST = 0.86 * units.STANDARD_GRAVITY
"""What the hardware's sensors read at rest [m/s^2] (section 3.4.1)."""

_LEGS = 6
_RAW, _FILTERED, _TRUE = "#bbbbbb", "#d55e00", "#0072b2"


class Readings(NamedTuple):
    """Leg accelerometers before and behind the DCL's filter, (N, 6) [m/s^2]."""

    truth: NDArray[np.float64]  #: Without bandwidth, bias, noise, resolution and range.
    raw: NDArray[np.float64]
    filtered: NDArray[np.float64]


class FilterEffect(NamedTuple):
    """What filter and sensors do at rest and in motion; predictions from closed forms."""

    sensors: str  #: Name of the sensor set.
    law: str  #: Law whose filter and motion it is.
    rest: Readings  #: Platform still at neutral.
    motion: Readings  #: Heave of `AMPLITUDE` and `FREQUENCY`, last whole cycles.
    rest_reading: float  #: Mean of the raw readings at rest [m/s^2].
    axial_gravity: float  #: g n . up of Appendix C, mean of the legs [m/s^2].
    raw_rms: float  #: Deviation of the raw readings at rest [m/s^2].
    filtered_rms: float  #: Deviation of the filtered readings at rest [m/s^2].
    predicted_noise_gain: float  #: b / sqrt(1 - a^2).
    signal_gain: float  #: Amplitude at `FREQUENCY`, filtered over raw.
    predicted_signal_gain: float  #: |H|.
    delay: float  #: Phase delay at `FREQUENCY` [s].
    predicted_delay: float  #: -arg H / (2 pi f) [s].

    @property
    def noise_gain(self) -> float:
        """Measured share of the noise that the filter leaves; NaN without noise."""
        return self.filtered_rms / self.raw_rms if self.raw_rms > 0.0 else float("nan")


@compiled
def _filter(feedback, raw, filtered):  # type: ignore[no-untyped-def]
    """Filter histories (N, n) with the DCL's own filter, settled on the first sample."""
    still = feedback.accelerometer_gain / (1.0 - feedback.accelerometer_pole)
    for leg in range(raw.shape[1]):
        filtered[0, leg] = still * raw[0, leg]
        for frame in range(raw.shape[0] - 1):
            filtered[frame + 1, leg] = filter_acceleration(
                feedback, filtered[frame, leg], raw[frame, leg]
            )


def _readings(truth: Truth, settings: SensorSettings, law: Law, seed: int, skip: int) -> Readings:
    """Read histories, filter, and leave out the first `skip` frames."""
    perfect = SensorSettings(name="perfect", gravity=settings.gravity)
    rate = 1.0 / FRAME
    clean, _ = sense_history(make_sensors(perfect, rate), truth)
    sensed, _ = sense_history(make_sensors(settings, rate, seed), truth)
    filtered = np.empty_like(sensed.acceleration)
    _filter(make_feedback(law), sensed.acceleration, filtered)
    return Readings(clean.acceleration[skip:], sensed.acceleration[skip:], filtered[skip:])


def _tone(values: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Complex amplitudes (6,) at `FREQUENCY`, least squares with an offset."""
    angle = 2.0 * np.pi * FREQUENCY * FRAME * np.arange(values.shape[0])
    basis = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    return fit[0] - 1j * fit[1]


def truth_of(record: Record) -> Truth:
    """What a record holds of the legs' true motion and pressures."""
    return Truth(*(record[channel] for channel in FEEDBACK.values()))


def filter_effect(
    sensors: str | Path | SensorSettings = "noisy",
    law: str | Law = "acceleration_opposing",
    *,
    seed: int = 0,
    duration: float = 60.0,
) -> FilterEffect:
    """Read the leg accelerometers at rest and in the motion of Figure 3-16, and filter them.

    Args:
        sensors: `ideal`, `noisy`, a TOML file or a loaded set.
        law: whose filter it is, and which moves the hexapod with its default cab; the DCL itself
            reads the truth.
        seed: of the noise.
        duration: time at rest [s].

    Raises:
        InputError: a refused set, law or seed, or a duration that is not positive.
    """
    signals.check_positive(duration=duration)
    settings, loaded = load_sensors(sensors), load_law(law)
    plant = Hexapod()
    hold = simulate(plant, loaded, np.zeros((2, 6)))
    settle = round(0.5 / FRAME)
    still = Truth(*(np.tile(c[0], (round(duration / FRAME) + settle, 1)) for c in truth_of(hold)))
    rest = _readings(still, settings, loaded, seed, settle)
    cycles = 12
    command = signals.sine("heave", AMPLITUDE, FREQUENCY, cycles=cycles, fade=2.0 / FREQUENCY)
    moving = truth_of(simulate(plant, loaded, command))
    period = 1.0 / (FREQUENCY * FRAME)
    skip, end = round(4 * period), round(9 * period)
    motion = _readings(Truth(*(c[:end] for c in moving)), settings, loaded, seed, skip)
    raw, filtered = _tone(motion.raw), _tone(motion.filtered)
    ratio = filtered.sum() / raw.sum()
    turn = 2.0 * np.pi * FREQUENCY
    predicted = loaded.accelerometer_gain / (np.exp(1j * turn * FRAME) - loaded.accelerometer_pole)
    return FilterEffect(
        sensors=settings.name,
        law=loaded.name,
        rest=rest,
        motion=motion,
        rest_reading=float(rest.raw.mean()),
        axial_gravity=float(axial_gravity(np.zeros(6)).mean()),
        raw_rms=float(np.sqrt(np.mean(rest.raw.var(axis=0)))),
        filtered_rms=float(np.sqrt(np.mean(rest.filtered.var(axis=0)))),
        predicted_noise_gain=noise_gain(loaded),
        signal_gain=float(abs(ratio)),
        predicted_signal_gain=float(abs(predicted)),
        delay=float(-np.angle(ratio) / turn),
        predicted_delay=float(-np.angle(predicted) / turn),
    )


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


def law_of(record: Record) -> Law:
    """The law a record was made with, gains and all.

    Raises:
        InputError: the record does not say.
    """
    if "law_parameters" not in record.metadata:
        raise InputError("law: the recording does not say which law made it; name one")
    return validated(Law, record.metadata["law_parameters"], "law_parameters")
