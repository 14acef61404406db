"""Figures 3-15 and 3-16: what the filter does, measured next to its closed forms."""

import control
import numpy as np
import pytest

from cmf_mj.report_2014.page.runs import sensor_readings

POLE, GAIN = 0.9924, 0.007588
"""Of Eq 3.6."""


def test_noise_signal_delay_and_readings_at_rest_are_as_predicted() -> None:
    """Filtered noise in 60 s of six legs is known to some 2 %: 64 ms of memory, 2800 samples."""
    numbers = sensor_readings(seed=1).numbers
    response = control.tf([GAIN], [1.0, -POLE], 1.0 / 2048.0)(np.exp(2j * np.pi * 1.2 / 2048.0))
    delay = -1e3 * np.angle(response) / (2.0 * np.pi * 1.2)
    predicted = GAIN / (1.0 - POLE) * np.sqrt((1.0 - POLE) / (1.0 + POLE))  # of white noise
    assert numbers["noise"] == pytest.approx(100.0 * predicted, rel=0.05)
    assert numbers["raw"] == pytest.approx(40.0, rel=0.01)
    assert numbers["signal"] == pytest.approx(100.0 * abs(response), rel=0.01)
    assert numbers["delay"] == pytest.approx(numbers["predicted"], abs=1.0)
    assert numbers["predicted"] == pytest.approx(delay, rel=1e-12)
    assert numbers["gravity"] == pytest.approx(0.8323, abs=1e-4)
    assert numbers["mean"] == pytest.approx(0.86, abs=1e-3)


def test_ideal_sensors_have_no_noise() -> None:
    ideal = sensor_readings("ideal", duration=1.0)
    assert ideal.numbers["raw"] == 0.0
    assert np.isnan(ideal.numbers["noise"])
    response = control.tf([GAIN], [1.0, -POLE], 1.0 / 2048.0)(np.exp(2j * np.pi * 1.2 / 2048.0))
    assert ideal.numbers["signal"] == pytest.approx(100.0 * abs(response), rel=1e-3)
    assert np.array_equal(ideal.motion.raw, ideal.motion.truth)
    with pytest.raises(ValueError, match="duration"):
        sensor_readings(duration=0.0)
