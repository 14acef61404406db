"""Motion-base measures on signals whose answers are known."""

import numpy as np
import pytest

from cmf_mj.analysis.metrics import (
    acceleration_noise,
    describing_function,
    dynamic_threshold,
    harmonics,
    hysteresis,
)

RATE = 128.0


def wave(frequency: float, seconds: float, *shares: float, phase: float = 0.3) -> np.ndarray:
    """Sum of harmonics 1, 2, ... with these amplitudes."""
    angle = 2.0 * np.pi * frequency * np.arange(round(seconds * RATE)) / RATE
    return np.asarray(sum(a * np.sin(k * angle + k * phase) for k, a in enumerate(shares, 1)))


@pytest.mark.parametrize("share", [0.03, 0.2])
def test_a_third_harmonic_reads_its_share(share: float) -> None:
    noise = acceleration_noise(wave(0.5, 20.0, 2.0, 0.0, 2.0 * share), RATE, 0.5)
    assert noise.fundamental == pytest.approx(2.0, rel=1e-12)
    assert noise.low_harmonics == pytest.approx(share, rel=1e-12)
    assert noise.high_harmonics < 1e-12
    assert noise.stochastic < 1e-12
    assert noise.total == pytest.approx(share, rel=1e-12)
    assert noise.peak == pytest.approx(share, rel=1e-3)  # 256 samples a cycle see the peak


def test_harmonics_split_at_three() -> None:
    """2 and 3 are low, 4 and 7 high; root sums of squares 0.05 and 0.13."""
    samples = wave(1.0, 10.0, 1.0, 0.03, 0.04, 0.05, 0.0, 0.0, 0.12)
    noise = acceleration_noise(samples, RATE, 1.0)
    assert noise.low_harmonics == pytest.approx(0.05, rel=1e-12)
    assert noise.high_harmonics == pytest.approx(0.13, rel=1e-12)


def test_white_noise_is_stochastic() -> None:
    """Rms 0.1 on amplitude 1 is a share of 0.141; 6400 samples: 3 standard errors are 2.7 %."""
    samples = wave(0.5, 50.0, 1.0) + 0.1 * np.random.default_rng(1).standard_normal(6400)
    noise = acceleration_noise(samples, RATE, 0.5)
    assert noise.stochastic == pytest.approx(0.1 * np.sqrt(2.0), rel=0.03)
    assert noise.low_harmonics < 0.01
    assert noise.peak > 0.3


def test_an_offset_and_a_broken_cycle_do_not_count() -> None:
    noise = acceleration_noise(9.81 + wave(0.5, 7.3, 1.0), RATE, 0.5)
    assert noise.total < 1e-12


def test_harmonics_give_amplitude_and_phase() -> None:
    result = harmonics(wave(2.0, 3.0, 1.5, 0.2, phase=-0.4), RATE, 2.0, 2)
    np.testing.assert_allclose(result.amplitude, [1.5, 0.2], rtol=1e-12)
    np.testing.assert_allclose(result.phase, [-0.4, -0.8], rtol=1e-12)


def test_describing_function_of_a_saturation() -> None:
    """N(A) = 2/pi (asin(d/A) + d/A sqrt(1 - (d/A)^2)) for a clip at d; d = 1, A = 0.5, 2, 4."""
    demand = [a * wave(0.5, 200.0, 1.0) for a in (0.5, 2.0, 4.0)]
    result = [describing_function(x, np.clip(x, -1, 1), RATE, 0.5) for x in demand]
    ratio = np.array([0.5, 0.25])
    exact = 2 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1 - ratio**2))
    np.testing.assert_allclose(result, [1.0, *exact], atol=2e-4)  # corners fall between samples


@pytest.mark.parametrize("width", [0.02, 0.1])
def test_hysteresis_of_a_backlash_is_its_width(width: float) -> None:
    """Play of +-w: the branches lie 2 w apart over a peak-to-peak of 2. 3 %: 40 harmonics."""
    demand = wave(0.01, 300.0, 1.0, phase=0.0)
    response = np.empty_like(demand)
    sampled = 0.0
    for i, x in enumerate(demand):
        sampled = min(max(sampled, x - width), x + width)
        response[i] = sampled
    result = hysteresis(demand[12800:], response[12800:], RATE, 0.01)
    assert result == pytest.approx(width, rel=0.03)


def test_a_pure_delay_opens_the_loop_by_its_phase() -> None:
    """Three samples at 0.01 Hz and gain 0.9: 0.9 sin(2 pi f d)."""
    demand = wave(0.01, 100.0, 1.0)
    expected = 0.9 * np.sin(2.0 * np.pi * 0.01 * 3.0 / RATE)
    result = hysteresis(demand, 0.9 * np.roll(demand, 3), RATE, 0.01)
    assert result == pytest.approx(expected, rel=1e-6)


def test_dynamic_threshold_of_a_lag_is_its_time_constant() -> None:
    """1 - e^(-t/T) reaches 63.2 % at T; linear interpolation over 1/128 s: 1e-4 s."""
    time = np.arange(512) / RATE
    lag = np.where(time >= 1.0, 0.4 * (1.0 - np.exp(-(time - 1.0) / 0.15)), 0.0)
    assert dynamic_threshold(lag, RATE, 0.4, 1.0) == pytest.approx(0.15, abs=1e-4)
    assert np.isnan(dynamic_threshold(0.5 * lag, RATE, 0.4, 1.0))
    assert dynamic_threshold(-lag, RATE, -0.4, 1.0) == pytest.approx(0.15, abs=1e-4)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda x: harmonics(x, RATE, 0.1, 1), "frequency: 0.1 Hz needs a cycle of 1280"),
        (lambda x: harmonics(x, RATE, 10.0, 7), "count: harmonic 7 of 10.0 Hz"),
        (lambda x: acceleration_noise(x, RATE, 30.0), "rate: 128.0 Hz must exceed 180.0 Hz"),
        (lambda x: acceleration_noise(x, RATE, 0.1), "frequency: 0.1 Hz has no whole cycle"),
    ],
)
def test_what_cannot_be_measured_is_said(call, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        call(np.zeros(128))
