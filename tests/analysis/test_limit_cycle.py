"""The oscillation a run ends in, against sines."""

import numpy as np
import pytest

from cmf_mj.analysis.limit_cycle import limit_cycle
from cmf_mj.core.errors import InputError
from cmf_mj.record.record import Record

RATE = 256.0


def swinging(seconds: float, pressure: float) -> Record:
    """Leg 1 swings at 3.25 Hz, the cap's pressure by so much [Pa], its accelerometer by 5 m/s^2."""
    time = np.arange(round(seconds * RATE)) / RATE
    wave = np.sin(2.0 * np.pi * 3.25 * time)[:, None] * (np.arange(6) == 0)
    channels = {"cap_pressure": 4e6 + pressure * wave, "rod_pressure": 0.0 * wave + 3e6}
    channels |= {"leg_acceleration": 5.0 * wave}
    units = {"cap_pressure": "Pa", "rod_pressure": "Pa", "leg_acceleration": "m/s^2"}
    return Record(time, channels, units, {"sample_rate": RATE})


def test_a_sine_is_measured() -> None:
    found = limit_cycle(swinging(6.0, 2e5))
    assert found.frequency == 3.25
    assert found.amplitude == pytest.approx(2e5, rel=1e-3)
    assert found.acceleration == pytest.approx(5.0, rel=1e-3)


def test_what_has_died_down_has_no_frequency() -> None:
    assert np.isnan(limit_cycle(swinging(6.0, 2e4)).frequency)


def test_a_short_record_is_refused() -> None:
    with pytest.raises(InputError, match="record: 2 s are too short; allowed: 4 s or more"):
        limit_cycle(swinging(2.0, 2e5))
