"""What the leg accelerometers read before and behind the DCL's filter (Figures 3-15 and 3-16).

The filter y[k+1] = a y[k] + b x[k] (Eq 3.6) has the frequency response

    H(f) = b / (exp(2 pi i f T) - a)

and leaves of white noise the share b / sqrt(1 - a^2).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from cmf_mj import signals
from cmf_mj.analysis.response.periodic import fit_sines
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.units import FRAME, STANDARD_GRAVITY
from cmf_mj.electronics.sensors.channel import SensorSettings, load_sensors
from cmf_mj.electronics.sensors.suite import make_sensors, sense_history
from cmf_mj.facility.replay import FEEDBACK
from cmf_mj.facility.run import simulate
from cmf_mj.machine.gravity import axial_gravity
from cmf_mj.plant.hexapod import Hexapod

_AMPLITUDE, _FREQUENCY = 0.33 * units.INCH, 1.2
"""Heave motion of Figure 3-16 [m, Hz] (section 3.4.1)."""


class Readings(NamedTuple):
    """Leg accelerometers before and behind the DCL's filter, (N, 6) [m/s^2]."""

    truth: NDArray[np.float64]  #: Without bandwidth, bias, noise, resolution and range.
    raw: NDArray[np.float64]
    filtered: NDArray[np.float64]


class SensorReadings(NamedTuple):
    """Readings of the accelerometers at rest and in motion."""

    rest: Readings  #: Platform still at neutral.
    motion: Readings  #: Heave of 0.33 in at 1.2 Hz, five whole cycles.
    numbers: dict[str, Any]
    """What captions say of them: `mean`, `gravity` by Appendix C [g], `raw` and `filtered` rms at
    rest [mg], shares of `noise` and `signal` that the filter leaves [%], its `delay` at 1.2 Hz and
    the `predicted` one, -arg H / (2 pi f) [ms]."""


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


def sensor_readings(
    sensors: str = "noisy", *, seed: int = 0, duration: float = 60.0
) -> SensorReadings:
    """Read and filter the leg accelerometers at rest and in the motion of Figure 3-16.

    Acceleration feedback with Eq 3.6 moves the hexapod with its default cab on true feedback;
    `seed` is of the noise, `duration` the time at rest [s].
    """
    signals.check_positive(duration=duration)
    settings, law, plant = load_sensors(sensors), load_law("acceleration_opposing"), Hexapod()
    sine = signals.sine("heave", _AMPLITUDE, _FREQUENCY, cycles=12, fade=2.0 / _FREQUENCY)
    hold, moving = (
        LegFeedback(*(simulated[channel] for channel in FEEDBACK.values()))
        for simulated in (simulate(plant, law, command) for command in (np.zeros((2, 6)), sine))
    )
    settle = round(0.5 / FRAME)
    frames = round(duration / FRAME) + settle
    still = LegFeedback(*(np.tile(channel[0], (frames, 1)) for channel in hold))
    rest = _readings(still, settings, law, seed, settle)
    skip, end = (round(cycles / (_FREQUENCY * FRAME)) for cycles in (4, 9))
    motion = _readings(LegFeedback(*(c[:end] for c in moving)), settings, law, seed, skip)
    turn = 2.0 * np.pi * _FREQUENCY
    angle = turn * FRAME * np.arange(len(motion.raw))
    raw, filtered = (fit_sines(v, angle).amplitude[0] for v in (motion.raw, motion.filtered))
    ratio = filtered.sum() / raw.sum()
    predicted = law.accelerometer_gain / (np.exp(1j * turn * FRAME) - law.accelerometer_pole)
    noise = [float(np.sqrt(np.mean(v.var(axis=0)))) for v in (rest.raw, rest.filtered)]
    numbers = {
        "sensors": settings.name,
        "mean": float(rest.raw.mean()) / STANDARD_GRAVITY,
        "gravity": float(axial_gravity(np.zeros(6)).mean()) / STANDARD_GRAVITY,
        "raw": 1e3 * noise[0] / STANDARD_GRAVITY,
        "filtered": 1e3 * noise[1] / STANDARD_GRAVITY,
        "amplitude": units.from_si("in", _AMPLITUDE),
        "frequency": _FREQUENCY,
        "noise": 100.0 * noise[1] / noise[0] if noise[0] > 0.0 else float("nan"),
        "signal": 100.0 * float(abs(ratio)),
        "delay": 1e3 * float(-np.angle(ratio) / turn),
        "predicted": 1e3 * float(-np.angle(predicted) / turn),
    }
    return SensorReadings(rest, motion, numbers)
