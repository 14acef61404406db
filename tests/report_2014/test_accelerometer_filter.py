"""Figures 3-15 and 3-16: what the filter does, measured next to its closed forms."""

import control
import numpy as np
import pytest
from typer.testing import CliRunner

from cmf_mj import load_law
from cmf_mj.cli.common import app
from cmf_mj.report_2014.accelerometer_filter import (
    FilterEffect,
    filter_effect,
    predicted_noise_gain,
)

GRAVITY = 9.80665


@pytest.fixture(scope="module")
def effect() -> FilterEffect:
    return filter_effect(seed=1)


def test_the_predictions_are_those_of_python_control() -> None:
    law = load_law("acceleration_eq_3_6")
    pole, gain = 0.9924, 0.007588
    system = control.tf([gain], [1.0, -pole], 1.0 / 2048.0)
    _, impulse = control.impulse_response(system, np.arange(20000) / 2048.0)
    assert predicted_noise_gain(law) == pytest.approx(
        np.sqrt(np.sum(impulse**2)) / 2048.0, rel=1e-6
    )
    ratio = gain / (1.0 - pole) * np.sqrt((1.0 - pole) / (1.0 + pole))
    assert predicted_noise_gain(law) == pytest.approx(ratio, rel=1e-12)


def test_noise_signal_and_delay_are_as_predicted(effect: FilterEffect) -> None:
    """Filtered noise in 60 s of six legs is known to some 2 %: 64 ms of memory, 2800 samples."""
    assert effect.noise_gain == pytest.approx(effect.predicted_noise_gain, rel=0.05)
    assert effect.raw_rms / GRAVITY == pytest.approx(0.04, rel=0.01)
    assert effect.signal_gain == pytest.approx(effect.predicted_signal_gain, rel=0.01)
    assert effect.delay == pytest.approx(effect.predicted_delay, abs=0.001)
    system = control.tf([0.007588], [1.0, -0.9924], 1.0 / 2048.0)
    response = system(np.exp(2j * np.pi * 1.2 / 2048.0))
    assert effect.predicted_signal_gain == pytest.approx(abs(response), rel=1e-12)
    delay = -np.angle(response) / (2 * np.pi * 1.2)
    assert effect.predicted_delay == pytest.approx(delay, rel=1e-12)


def test_both_readings_at_rest_are_there(effect: FilterEffect) -> None:
    assert effect.axial_gravity / GRAVITY == pytest.approx(0.8323, abs=1e-4)
    assert effect.rest_reading / GRAVITY == pytest.approx(0.86, abs=1e-3)


def test_ideal_sensors_have_no_noise() -> None:
    ideal = filter_effect("ideal", duration=1.0)
    assert ideal.raw_rms == 0.0
    assert np.isnan(ideal.noise_gain)
    assert ideal.signal_gain == pytest.approx(ideal.predicted_signal_gain, rel=1e-3)
    assert np.array_equal(ideal.motion.raw, ideal.motion.truth)


def test_refusals() -> None:
    with pytest.raises(ValueError, match="duration"):
        filter_effect(duration=0.0)


def test_the_command_line() -> None:
    result = CliRunner().invoke(app, ["list", "sensors"])
    assert result.exit_code == 0, result.output
    assert "0.86 g" in result.output
    assert "noise_density" in result.output
    assert CliRunner().invoke(app, ["list", "sensors", "loud"]).exit_code == 2
