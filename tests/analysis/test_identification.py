"""ARX models, their errors and continuous models, against known systems."""

from dataclasses import replace

import control
import numpy as np
import pytest
from identified_systems import RATE, SIXTH, driven, lag, noisy, pair, sampled, series
from numpy.typing import NDArray
from scipy import signal, stats

from cmf_mj.analysis.identification import (
    BlackBox,
    arx,
    decimated,
    fit_percentage,
    simulated,
    to_continuous,
)
from cmf_mj.core.errors import InputError

FREQUENCY = np.linspace(0.2, 15.0, 75)
LEG = lag(3.0) * pair(11.0, 0.11)
"""The single leg: a lag and the oil mode."""


def parameters(system: control.TransferFunction) -> np.ndarray:
    """The true parameters, b without its leading zero."""
    b, a = sampled(system)
    return np.concatenate([a[1:], b[1:]])


def response(system: control.TransferFunction, frequency: np.ndarray) -> NDArray[np.complex128]:
    return control.frequency_response(system, 2.0 * np.pi * frequency).frdata[0, 0]


def error(box: BlackBox, system: control.TransferFunction) -> float:
    """Largest error of a response up to 15 Hz, over the largest gain."""
    b, a = sampled(system)
    _, true = signal.freqz(b, a, FREQUENCY, fs=RATE)
    return float(np.abs(box.response(FREQUENCY).response - true).max() / np.abs(true).max())


def test_decimation_keeps_the_band_and_stops_what_would_fold_back() -> None:
    """5 Hz passes within 0.5 % in amplitude and without a phase; 60 Hz at 64 Hz would become 4."""
    time = np.arange(20 * 2048) / 2048.0
    slow, fast = (np.sin(2.0 * np.pi * f * time) for f in (5.0, 60.0))
    inside = slice(128, -128)
    np.testing.assert_allclose(decimated(slow, 32)[inside], slow[::32][inside], atol=0.02)
    assert np.abs(decimated(fast, 32)[inside]).max() < 1e-3


def test_sixth_order_system_is_recovered_from_noisy_data() -> None:
    """Within 1 % of the peak gain up to 15 Hz; all parameters within 4 sigma."""
    box = arx([noisy(SIXTH, 1, samples=8000, noise=0.02, where="equation")], (6, 6, 1))
    assert error(box, SIXTH) < 0.01
    errors = np.sqrt(np.diag(box.covariance))
    assert np.all(np.abs(box.parameters - parameters(SIXTH)) < 4.0 * errors)


def test_without_noise_parameters_are_exact() -> None:
    b, a = sampled(SIXTH)
    box = arx([noisy(SIXTH, 3, noise=0.0)], (6, 6, 1))
    np.testing.assert_allclose(box.denominator, a, rtol=1e-6)
    np.testing.assert_allclose(box.numerator, b, rtol=1e-5, atol=1e-12)
    assert error(box, SIXTH) < 1e-6


def test_direct_path_and_delay_keep_their_places() -> None:
    u = driven(5, 600)
    late = arx([series(u, signal.lfilter([0.0, 0.0, 0.0, 0.8, 0.3], [1.0, -0.6], u))], (1, 2, 3))
    np.testing.assert_allclose(late.numerator, [0.0, 0.0, 0.0, 0.8, 0.3], atol=1e-12)
    direct = arx([series(u, signal.lfilter([2.0, 1.0], [1.0, -0.6], u))], (1, 2, 0))
    np.testing.assert_allclose(direct.numerator, [2.0, 1.0], atol=1e-12)


def test_covariance_of_arx_is_that_of_repeated_experiments() -> None:
    """theta^T cov^-1 theta of 100 experiments follows chi-squared: Kolmogorov-Smirnov, 1 %.

    The true response lies in the circle of at least 95 % (the long axis of the ellipse) in more
    than 90 % of them.
    """
    _, true = signal.freqz(*sampled(LEG), FREQUENCY[::10], fs=RATE)
    distance, inside = [], []
    for seed in range(100):
        box = arx([noisy(LEG, seed, samples=800, where="equation")], (3, 3, 1))
        off, found = box.parameters - parameters(LEG), box.response(FREQUENCY[::10])
        distance.append(off @ np.linalg.solve(box.covariance, off))
        inside.append(np.abs(found.response - true) < found.bound)
    assert stats.kstest(distance, stats.chi2(6).cdf).pvalue > 0.01
    assert (np.mean(inside, axis=0) > 0.9).all()


def test_errors_of_poles_and_responses_are_those_of_repeated_experiments() -> None:
    """First-order propagation against the scatter of 200 experiments, within a fifth."""
    modes, responses = [], []
    for seed in range(200):
        box = arx([noisy(LEG, seed, samples=1500, noise=0.02, where="equation")], (3, 3, 1))
        modes.append(max(box.poles(), key=lambda root: root.value.imag))
        responses.append(box.response(9.0))
    hertz = [root.hertz for root in modes]
    assert modes[-1].error == pytest.approx(np.std(hertz), rel=0.2)
    assert np.mean([root.damping for root in modes]) == pytest.approx(0.11, rel=0.02)
    values = np.array([one.response[0] for one in responses])
    axis = np.linalg.eigvalsh(np.cov(values.real, values.imag))[-1]
    radius = np.sqrt(axis * stats.chi2.ppf(0.95, 2))
    assert responses[-1].bound[0] == pytest.approx(radius, rel=0.2)


def test_noise_on_the_output_makes_arx_see_more_damping_than_there_is() -> None:
    """5 % of white noise: the oil mode's true 0.11 comes out a fifth too high, mean of 40."""
    found = [
        min(pole.damping for pole in arx([noisy(LEG, seed, samples=1500)], (3, 3, 1)).poles())
        for seed in range(40)
    ]
    assert np.mean(found) > 1.2 * 0.11


def test_a_model_that_grows_is_not_simulated() -> None:
    u = driven(1, 400)
    growing = series(u, signal.lfilter([0.0, 1.0, 0.4], np.poly([1.02, 0.5]), u))
    unstable = arx([growing], (2, 2, 1))
    assert max(abs(pole.value) for pole in unstable.poles()) == pytest.approx(1.02, abs=1e-6)
    with pytest.raises(ValueError, match=r"orders: \(2, 2, 1\) make an unstable model"):
        simulated(unstable, growing)


def test_runs_that_start_in_motion_are_fitted_jointly_and_not_joined_end_to_end() -> None:
    """Two cuts of one run, each with its own unknown start: exact without noise."""
    run = noisy(LEG, 6, noise=0.0)
    cuts = [
        replace(run, input=run.input[part], output=run.output[part])
        for part in (slice(300, 900), slice(1400, 2000))
    ]
    box = arx(cuts, (3, 3, 1))
    np.testing.assert_allclose(box.denominator, sampled(LEG)[1], rtol=1e-5)
    assert fit_percentage(cuts[1].output, simulated(box, cuts[1])) > 99.9
    rest = signal.lfilter(box.numerator, box.denominator, cuts[1].input)
    assert fit_percentage(cuts[1].output, rest) < 99.0


def test_fit_is_the_normalised_rms_error() -> None:
    y = np.array([1.0, 2.0, 3.0, 4.0])
    assert fit_percentage(y, y) == 100.0
    assert fit_percentage(y, np.full(4, 2.5)) == pytest.approx(0.0)
    off = y + np.array([0.1, -0.1, 0.1, -0.1])
    assert fit_percentage(y, off) == pytest.approx(100.0 * (1.0 - 0.2 / np.sqrt(5.0)))
    with pytest.raises(ValueError, match="does not move"):
        fit_percentage(np.ones(4), y)


def test_band_limited_model_becomes_the_continuous_one() -> None:
    """Sampled from the response itself, so that samples know nothing of a hold: 0.1 % in band.

    The model is in in/s per %: 0.0254 m/s at full command is 1 in/s at 100 %.
    """
    line = np.fft.rfftfreq(4096, 1.0 / RATE)
    band = (line > 0.05) & (line < 16.0)
    u = np.zeros(line.size, dtype=complex)
    u[band] = np.exp(2j * np.pi * np.random.default_rng(5).uniform(size=int(band.sum())))
    y = u * response(SIXTH, line)
    box = arx([series(np.fft.irfft(u), np.fft.irfft(y))], (6, 7, 0))
    inside = np.linspace(0.2, 10.0, 99)
    expected, found = response(SIXTH, inside), to_continuous(box)
    assert found.misfit < 1e-3
    result = response(found.velocity.to_si(), inside)
    assert np.abs(result - expected).max() < 1e-3 * np.abs(expected).max()
    np.testing.assert_allclose(0.0254 * 100.0 * response(found.velocity, inside), result)
    with pytest.raises(ValueError, match=r"step: 0.1 s; allowed: below 0.05 s"):
        to_continuous(replace(box, step=0.1))


@pytest.mark.parametrize(
    ("orders", "message"),
    [
        ((0, 1, 1), "na: 0 must be at least 1"),
        ((1, 0, 1), "nb: 0 must be at least 1"),
        ((1, 1, -1), "nk: -1 must be at least 0"),
        ((40, 40, 1), r"orders: \(40, 40, 1\) are too high for 80 samples"),
    ],
)
def test_bad_orders_are_named(orders: tuple[int, int, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        arx([noisy(SIXTH, 0, samples=80)], orders)


def test_an_input_that_does_not_excite_the_model_is_refused() -> None:
    """A sine tells two coefficients of B apart, not three; a silent input none."""
    u = np.sin(0.3 * np.arange(500))
    y = signal.lfilter([0.0, 1.0], [1.0, -0.5], u) + 0.01 * driven(0, 500)
    with pytest.raises(ValueError, match="do not tell these parameters apart"):
        arx([series(u, y)], (1, 3, 1))
    with pytest.raises(ValueError, match="zero all the time"):
        arx([series(np.zeros(500), y)], (1, 1, 1))


def test_runs_of_one_step_are_fitted_and_cut_with_their_reference() -> None:
    run = replace(series(driven(3, 500), driven(4, 500)), reference=np.arange(500.0))
    for none in ([], [run, replace(run, step=0.01)]):
        with pytest.raises(InputError, match="one or more of the same step"):
            arx(none, (2, 2, 1))
    first, rest = run.split(0.3)
    assert first.reference is not None and rest.reference is not None
    assert rest.reference[0] == first.reference.size == first.output.size
