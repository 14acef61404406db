"""What the accelerometer filter of the DCL does to noise and signal (Figures 3-15 and 3-16).

The filter y[k+1] = a y[k] + b x[k] (Eq 3.6) has the frequency response

    H(f) = b / (exp(2 pi i f T) - a)

and leaves of white noise the share b / sqrt(1 - a^2) (`predicted_noise_gain`). Both stand next to
what the simulated sensors read.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from cmf_mj import signals
from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.result import Table
from cmf_mj.core.units import FRAME, STANDARD_GRAVITY
from cmf_mj.electronics.channel import SensorSettings, load_sensors
from cmf_mj.electronics.sensors import make_sensors, sense_history
from cmf_mj.facility.replay import FEEDBACK
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.leg_motion import axial_gravity
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record

AMPLITUDE, FREQUENCY = 0.33 * units.INCH, 1.2
"""Heave motion of Figure 3-16 [m, Hz] (section 3.4.1)."""
REPORTED_REST = 0.86 * units.STANDARD_GRAVITY
"""What the hardware's sensors read at rest [m/s^2] (section 3.4.1)."""


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


def predicted_noise_gain(law: Law) -> float:
    """Rms of white noise behind the accelerometer filter over that before it."""
    return float(law.accelerometer_gain / np.sqrt(1.0 - law.accelerometer_pole**2))


def _readings(
    truth: LegFeedback, settings: SensorSettings, law: Law, seed: int, skip: int
) -> Readings:
    """Read histories, filter from rest on the first sample, leave out the first `skip` frames."""
    perfect = SensorSettings(name="perfect", gravity=settings.gravity)
    clean, raw = (
        sense_history(make_sensors(which, 1.0 / FRAME, seed), truth)[0].acceleration
        for which in (perfect, settings)
    )
    a, b = law.accelerometer_pole, law.accelerometer_gain
    filtered, _ = lfilter([0.0, b], [1.0, -a], raw, axis=0, zi=b / (1.0 - a) * raw[:1])
    return Readings(clean[skip:], raw[skip:], filtered[skip:])


def _truth(record: Record) -> LegFeedback:
    """What a record holds of the legs' true motion and pressures."""
    return LegFeedback(*(record[channel] for channel in FEEDBACK.values()))


def filter_effect(
    sensors: str | Path | SensorSettings = "noisy",
    law: str | Law = "acceleration_opposing",
    *,
    seed: int = 0,
    duration: float = 60.0,
) -> FilterEffect:
    """Read the leg accelerometers at rest and in the motion of Figure 3-16, and filter them.

    The law, whose filter it is, moves the hexapod with its default cab on true feedback; `seed` is
    of the noise, `duration` the time at rest [s].
    """
    signals.check_positive(duration=duration)
    settings, loaded = load_sensors(sensors), load_law(law)
    plant = Hexapod()
    hold = simulate(plant, loaded, np.zeros((2, 6)))
    settle = round(0.5 / FRAME)
    still = LegFeedback(
        *(np.tile(c[0], (round(duration / FRAME) + settle, 1)) for c in _truth(hold))
    )
    rest = _readings(still, settings, loaded, seed, settle)
    cycles = 12
    command = signals.sine("heave", AMPLITUDE, FREQUENCY, cycles=cycles, fade=2.0 / FREQUENCY)
    moving = _truth(simulate(plant, loaded, command))
    period = 1.0 / (FREQUENCY * FRAME)
    skip, end = round(4 * period), round(9 * period)
    motion = _readings(LegFeedback(*(c[:end] for c in moving)), settings, loaded, seed, skip)
    turn = 2.0 * np.pi * FREQUENCY
    angle = turn * FRAME * np.arange(len(motion.raw))
    raw, filtered = (fit_sines(v, angle).amplitude[0] for v in (motion.raw, motion.filtered))
    ratio = filtered.sum() / raw.sum()
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
        predicted_noise_gain=predicted_noise_gain(loaded),
        signal_gain=float(abs(ratio)),
        predicted_signal_gain=float(abs(predicted)),
        delay=float(-np.angle(ratio) / turn),
        predicted_delay=float(-np.angle(predicted) / turn),
    )


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
