"""ARX and output error, their errors, orders and continuous models, against known systems."""

from dataclasses import replace

import control
import numpy as np
import pytest
from identified_systems import RATE, SIXTH, driven, lag, noisy, pair, sampled, series
from numpy.typing import NDArray
from scipy import signal, stats

from cmf_mj.analysis.identification import (
    BlackBox,
    Orders,
    arx,
    decimated,
    fit_percentage,
    output_error,
    residual_analysis,
    select_orders,
    simulated,
    to_continuous,
)

FREQUENCY = np.linspace(0.2, 15.0, 75)
LEG = lag(3.0) * pair(11.0, 0.11)
"""The single leg: a lag and the oil mode."""
RUNS = 40


def parameters(system: control.TransferFunction) -> np.ndarray:
    """The true parameters, b without its leading zero."""
    b, a = sampled(system)
    return np.concatenate([a[1:], b[1:]])


def off_from(values: list, true: complex) -> complex:
    """Mean off the truth, in standard errors of the mean."""
    return (np.mean(values) - true) / (np.std(values, ddof=1) / np.sqrt(len(values)))


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


@pytest.mark.parametrize(
    ("fit", "where", "share", "within"),
    [(arx, "equation", 0.02, 0.01), (output_error, "output", 0.05, 0.02)],
)
def test_sixth_order_system_is_recovered_from_noisy_data(fit, where, share, within) -> None:
    """Within 1 and 2 % of the peak gain up to 15 Hz; all parameters within 4 sigma."""
    box = fit([noisy(SIXTH, 1, samples=8000, noise=share, where=where)], (6, 6, 1))
    assert box.converged and error(box, SIXTH) < within
    assert np.all(np.abs(box.parameters - parameters(SIXTH)) < 4.0 * box.standard_errors)


def test_without_noise_parameters_and_transfer_function_are_exact() -> None:
    b, a = sampled(SIXTH)
    run = noisy(SIXTH, 3, noise=0.0)
    box = arx([run], (6, 6, 1))
    np.testing.assert_allclose(box.denominator, a, rtol=1e-6)
    np.testing.assert_allclose(box.numerator, b, rtol=1e-5, atol=1e-12)
    line = box.transfer_function()
    assert (line.input_labels, line.output_labels, line.dt) == (["input"], ["output"], 1.0 / RATE)
    out = control.forced_response(line, inputs=run.input).outputs
    np.testing.assert_allclose(out, run.output, atol=1e-6)
    np.testing.assert_allclose(
        response(line, FREQUENCY), box.response(FREQUENCY).response, rtol=1e-9
    )


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


def test_errors_of_poles_zeros_and_responses_are_those_of_repeated_experiments() -> None:
    """First-order propagation against the scatter of 200 experiments, within a fifth."""
    modes, zeros, responses = [], [], []
    for seed in range(200):
        box = arx([noisy(LEG, seed, samples=1500, noise=0.02, where="equation")], (3, 3, 1))
        modes.append(max(box.poles(), key=lambda root: root.value.imag))
        zeros.append(max(box.zeros(), key=lambda root: root.value.real))
        responses.append(box.response(9.0))
    hertz = [root.hertz for root in modes]
    assert modes[-1].error == pytest.approx(np.std(hertz), rel=0.2)
    assert np.mean([root.damping for root in modes]) == pytest.approx(0.11, rel=0.02)
    assert zeros[-1].error == pytest.approx(np.std([root.hertz for root in zeros]), rel=0.3)
    values = np.array([one.response[0] for one in responses])
    axis = np.linalg.eigvalsh(np.cov(values.real, values.imag))[-1]
    radius = np.sqrt(axis * stats.chi2.ppf(0.95, 2))
    assert responses[-1].bound[0] == pytest.approx(radius, rel=0.2)


def test_covariance_of_output_error_is_that_of_repeated_experiments_and_arx_is_biased() -> None:
    """Mean of theta^T cov^-1 theta over 40 experiments is 6 +- 3.3 sqrt(12 / 40).

    Damping ratio of the oil mode with 5 % of noise on the output: the true 0.11 lies within 3.3
    standard errors of the mean (99.9 %) of OE, and more than 20 away from ARX's, a fifth too high.
    """
    distance, dampings = [], []
    for seed in range(RUNS):
        run = noisy(LEG, seed, samples=1500)
        boxes = [fit([run], (3, 3, 1)) for fit in (arx, output_error)]
        off = boxes[1].parameters - parameters(LEG)
        distance.append(off @ np.linalg.solve(boxes[1].covariance, off))
        dampings.append([min(root.damping for root in box.poles()) for box in boxes])
    assert np.mean(distance) == pytest.approx(6.0, abs=3.3 * np.sqrt(12.0 / RUNS))
    biased, right = (list(column) for column in zip(*dampings, strict=True))
    assert off_from(biased, 0.11) > 20.0
    assert np.mean(biased) > 1.2 * 0.11
    assert abs(off_from(right, 0.11)) < 3.3


@pytest.mark.slow
def test_feedback_of_coloured_noise_biases_output_error() -> None:
    """Static gain of the leg, 40 experiments in closed loop: y = G u + v, u = r - y / 2.

    The input is one sample late, and v has the first-order colour of a drifting sensor.
    """
    b, a = sampled(LEG)
    gains = []
    for seed in range(RUNS):
        r, white = driven(seed, 3000), np.random.default_rng([seed, 2]).normal(size=3000)
        v = signal.lfilter([1.0], [1.0, -0.9], white)
        v *= 0.3 / np.std(v)
        whole = np.polyadd(a, 0.5 * b)
        y = signal.lfilter(b, whole, r) + signal.lfilter(a, whole, v)
        gains.append(output_error([series(r - 0.5 * y, y)], (3, 3, 1)).response(0.5).response[0])
    _, true = signal.freqz(b, a, [0.5], fs=RATE)
    assert abs(off_from(gains, true[0])) > 5.0


@pytest.mark.parametrize("fit", [arx, output_error])
def test_runs_that_start_in_motion_are_fitted_jointly_and_not_joined_end_to_end(fit) -> None:
    """Two cuts of one run, each with its own unknown start: exact without noise."""
    run = noisy(LEG, 6, noise=0.0)
    cuts = [
        replace(run, input=run.input[part], output=run.output[part])
        for part in (slice(300, 900), slice(1400, 2000))
    ]
    box = fit(cuts, (3, 3, 1))
    np.testing.assert_allclose(box.denominator, sampled(LEG)[1], rtol=1e-5)
    assert fit_percentage(cuts[1].output, simulated(box, cuts[1])) > 99.9
    rest = signal.lfilter(box.numerator, box.denominator, cuts[1].input)
    assert fit_percentage(cuts[1].output, rest) < 99.0


def test_output_error_has_the_smallest_simulation_error() -> None:
    """On the data it was fitted to, whatever the model lacks: here a mode."""
    run = noisy(SIXTH, 4, samples=3000)
    fitted, least = (
        fit_percentage(run.output, simulated(fit([run], (4, 4, 1)), run))
        for fit in (output_error, arx)
    )
    assert fitted > least


def test_orders_are_found_on_the_run_held_back() -> None:
    """The best first, which is within 0.2 % of the best fit; the noise lets 3, 3, 1 be enough."""
    runs = [noisy(LEG, n, samples=6000, where="equation", noise=0.02) for n in (10, 11)]
    grid = [Orders(na, nb, nk) for na in range(1, 6) for nb in range(1, 5) for nk in (0, 1, 2)]
    (best, fit), *others = select_orders(runs[:1], runs[1], grid)
    fits = [one for _, one in others]
    assert fit > max(fits) - 0.2 and fits == sorted(fits, reverse=True)
    assert best.na + best.nb <= 6
    alone = dict(others) | {best: fit}
    box = arx(runs[:1], (3, 3, 1))
    assert alone[Orders(3, 3, 1)] == fit_percentage(runs[1].output, simulated(box, runs[1]))


def test_models_that_are_unstable_or_alternate_are_not_chosen() -> None:
    """y+ = -0.98 y + u alternates; no continuous system does."""
    u = driven(1, 400)
    alternating = series(u, signal.lfilter([0.0, 1.0], [1.0, 0.98], u))
    growing = series(u, signal.lfilter([0.0, 1.0, 0.4], np.poly([1.02, 0.5]), u))
    for run, orders in ((alternating, Orders(1, 1)), (growing, Orders(2, 2))):
        with pytest.raises(ValueError, match="orders: none of the grid make a stable model"):
            select_orders([run], run, [orders])
    unstable = arx([growing], (2, 2, 1))
    assert max(abs(root.value) for root in unstable.poles()) == pytest.approx(1.02, abs=1e-6)
    for refused in (lambda: simulated(unstable, growing), lambda: output_error([growing], (2, 2))):
        with pytest.raises(ValueError, match=r"orders: \(2, 2, 1\) make an unstable model"):
            refused()


def test_residuals_of_the_right_model_are_white_and_of_a_small_one_are_not() -> None:
    """99 % bounds: one lag in a hundred outside on average, here of 20 lags of 100 models."""
    run = noisy(LEG, 21, samples=6000, where="equation", noise=0.1)
    auto, cross = residual_analysis(arx([run], (1, 1, 1)), run, lags=100)
    assert auto > 0.1 and cross > 0.03
    found = []
    for seed in range(100):
        run = noisy(lag(3.0), seed, samples=1000, noise=0.5)
        true = replace(arx([noisy(lag(3.0), seed, noise=0.0)], (1, 1, 1)), method="oe")
        found.append(residual_analysis(true, run, lags=20))
    np.testing.assert_allclose(np.mean(found, axis=0), 0.01, atol=0.007)


def test_fit_is_the_normalised_rms_error() -> None:
    y = np.array([1.0, 2.0, 3.0, 4.0])
    assert fit_percentage(y, y) == 100.0
    assert fit_percentage(y, np.full(4, 2.5)) == pytest.approx(0.0)
    off = y + np.array([0.1, -0.1, 0.1, -0.1])
    assert fit_percentage(y, off) == pytest.approx(100.0 * (1.0 - 0.2 / np.sqrt(5.0)))
    with pytest.raises(ValueError, match="does not move"):
        fit_percentage(np.ones(4), y)


def test_subspace_method_of_a_library_agrees() -> None:
    """N4SID of nfoursid on the same noisy outputs: responses within 3 % of the peak gain.

    The library brings 40 MB of others along, so it is imported here.
    """
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    run = noisy(SIXTH, 1, samples=3000)  # the library decomposes a square of that size
    frame = pd.DataFrame({"u": run.input, "y": run.output})
    library = NFourSID(frame, output_columns=["y"], input_columns=["u"], num_block_rows=20)
    library.subspace_identification()
    estimates, _ = library.system_identification(rank=6)
    system = control.ss(estimates.a, estimates.b, estimates.c, estimates.d, 1.0 / RATE)
    theirs = response(system, FREQUENCY)
    ours = output_error([run], (6, 6, 1)).response(FREQUENCY).response
    assert np.abs(theirs - ours).max() < 0.03 * np.abs(ours).max()


def test_band_limited_model_becomes_the_continuous_one() -> None:
    """Sampled from the response itself, so that samples know nothing of a hold: 0.1 % in band.

    The model is in in/s per %: 0.0254 m/s at full command is 1 in/s at 100 %.
    """
    line = np.fft.rfftfreq(4096, 1.0 / RATE)
    band = (line > 0.05) & (line < 16.0)
    u = np.zeros(line.size, dtype=complex)
    u[band] = np.exp(2j * np.pi * np.random.default_rng(5).uniform(size=int(band.sum())))
    y = u * response(SIXTH, line)
    box = output_error([series(np.fft.irfft(u), np.fft.irfft(y))], (6, 7, 0))
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
