"""ARX and output error, their errors, orders and stability, against known systems."""

from dataclasses import replace

import control
import numpy as np
import pytest
from identified_systems import RATE, SIXTH, driven, lag, noisy, pair, sampled, series
from scipy import signal, stats

from cmf_mj.analysis.identification.data import Experiment
from cmf_mj.analysis.identification.estimation import arx, output_error, select_orders
from cmf_mj.analysis.identification.model import (
    Orders,
    PolynomialModel,
    Residuals,
    fit_percentage,
    residual_analysis,
    simulated,
    simulation_fit,
)

FREQUENCY = np.linspace(0.2, 15.0, 75)
LEG = lag(3.0) * pair(11.0, 0.11)
"""The single leg: a lag and the oil mode."""
RUNS = 40


def parameters(system: control.TransferFunction) -> np.ndarray:
    """The true parameters of a row, b without its leading zero."""
    b, a = sampled(system)
    return np.concatenate([a[1:], b[1:]])


def off_from(values: list, true: complex) -> complex:
    """Mean off the truth, in standard errors of the mean."""
    return (np.mean(values) - true) / (np.std(values, ddof=1) / np.sqrt(len(values)))


def error(model, system: control.TransferFunction) -> float:
    """Largest error of a response up to 15 Hz, over the largest gain."""
    b, a = sampled(system)
    z = np.exp(2j * np.pi * FREQUENCY / RATE)
    true = np.polyval(b, z) / np.polyval(a, z)
    return float(np.abs(model.response(FREQUENCY)[:, 0, 0] - true).max() / np.abs(true).max())


def auto_outside(residuals: Residuals) -> float:
    """Share of the lags from 1 on at which the auto-correlation exceeds its bound."""
    return float(np.mean(np.abs(residuals.auto[1:]) > residuals.auto_bound))


def test_sixth_order_system_is_recovered_from_noisy_data() -> None:
    """Equation noise of 2 % of the output: 1 % of the peak gain, parameters within 4 sigma."""
    model, true = arx(noisy(SIXTH, 0, noise=0.02, where="equation"), (6, 6, 1)), parameters(SIXTH)
    assert error(model, SIXTH) < 0.01
    assert np.all(np.abs(model.parameters() - true) < 4.0 * model.standard_errors())


def test_without_noise_the_parameters_are_exact() -> None:
    b, a = sampled(SIXTH)
    model = arx(noisy(SIXTH, 3, noise=0.0), (6, 6, 1))
    np.testing.assert_allclose(model.denominators[0], a, rtol=1e-6)
    np.testing.assert_allclose(model.numerators[0, 0], b, rtol=1e-5, atol=1e-12)


def test_covariance_is_that_of_repeated_experiments() -> None:
    """theta^T cov^-1 theta of 100 experiments follows chi-squared: Kolmogorov-Smirnov, 1 %."""
    true = parameters(LEG)
    distance = []
    for seed in range(100):
        model = arx(noisy(LEG, seed, samples=800, where="equation"), (3, 3, 1))
        off = model.parameters() - true
        distance.append(off @ np.linalg.solve(model.covariances[0], off))
    assert stats.kstest(distance, stats.chi2(6).cdf).pvalue > 0.01


def test_pole_and_response_errors_are_those_of_repeated_experiments() -> None:
    """First-order propagation against the scatter of 200 experiments, within a fifth."""
    poles, zeros, responses, model = [], [], [], None
    for seed in range(200):
        model = arx(noisy(LEG, seed, samples=1500, noise=0.02, where="equation"), (3, 3, 1))
        poles.append(max((root.value for root in model.poles()), key=lambda p: p.imag))
        zeros.append(max(root.value.real for root in model.zeros()))
        responses.append(model.response(9.0)[0, 0, 0])
    assert model is not None
    stated = max(model.poles(), key=lambda root: root.value.imag).covariance
    scatter = np.cov(np.real(poles), np.imag(poles))
    np.testing.assert_allclose(np.sqrt(np.diag(stated)), np.sqrt(np.diag(scatter)), rtol=0.2)
    spread = np.cov(np.real(responses), np.imag(responses))
    near = model.response_covariance(9.0)[0]
    np.testing.assert_allclose(np.sqrt(np.diag(near)), np.sqrt(np.diag(spread)), rtol=0.2)
    zero = max(model.zeros(), key=lambda root: root.value.real).covariance[0, 0]
    assert np.sqrt(zero) == pytest.approx(np.std(zeros), rel=0.3)


def test_several_experiments_are_fitted_jointly_and_not_joined_end_to_end() -> None:
    """Two runs of opposite offset give the exact model; end to end the jump would spoil it."""
    runs = [noisy(LEG, seed, samples=300, noise=0.0) for seed in (1, 2)]
    b, a = sampled(LEG)
    gain = b.sum() / a.sum()
    moved = [
        replace(run, input=run.input + sign, output=run.output + sign * gain)
        for run, sign in zip(runs, (1.0, -1.0), strict=True)
    ]
    model = arx(moved, (3, 3, 1))
    np.testing.assert_allclose(model.denominators[0], a, rtol=1e-6)
    assert model.samples == 2 * (300 - 3)
    joined = series(*(np.concatenate([getattr(r, k) for r in moved]) for k in ("input", "output")))
    assert np.abs(arx(joined, (3, 3, 1)).denominators[0] - a).max() > 1e-3


def test_matrix_of_two_inputs_and_outputs_becomes_transfer_functions() -> None:
    """Against python-control's own simulation of the true 2 by 2 system."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((1500, 2))
    a = np.array([[1.0, -1.2, 0.5], [1.0, -0.7, 0.2]])
    b = np.array([[[0.0, 0.3, 0.1], [0.0, -0.2, 0.4]], [[0.0, 0.05, 0.2], [0.0, 1.0, -0.5]]])
    y = np.column_stack(
        [sum(signal.lfilter(b[i, j], a[i], u[:, j]) for j in range(2)) for i in range(2)]
    )
    names = ("left", "right")
    run = Experiment(u, y, 0.5, names, ("up", "turn"), ("1", "1"), ("m/s", "rad/s"))
    model = arx(run, (2, 2, 1))
    np.testing.assert_allclose(model.numerators, b, atol=1e-9)
    parts = [[model.transfer_function(i, j) for j in range(2)] for i in range(2)]
    out = [
        sum(
            control.forced_response(part, np.arange(1500) * 0.5, u[:, j]).outputs
            for j, part in enumerate(row)
        )
        for row in parts
    ]
    np.testing.assert_allclose(np.transpose(out), y, atol=1e-9)
    one = parts[1][0]
    assert (one.input_labels, one.output_labels, one.dt) == (["left"], ["turn"], 0.5)
    at = np.array([0.1, 0.7])
    np.testing.assert_allclose(
        control.frequency_response(one, 2.0 * np.pi * at).frdata[0, 0],
        model.response(at)[:, 1, 0],
        rtol=1e-10,
    )


def test_direct_path_and_delay_keep_their_places() -> None:
    u = driven(5, 600)
    y = signal.lfilter([0.0, 0.0, 0.0, 0.8, 0.3], [1.0, -0.6], u)
    model = arx(series(u, y), (1, 2, 3))
    np.testing.assert_allclose(model.numerators[0, 0], [0.0, 0.0, 0.0, 0.8, 0.3], atol=1e-12)
    direct = arx(series(u, signal.lfilter([2.0, 1.0], [1.0, -0.6], u)), (1, 2, 0))
    np.testing.assert_allclose(direct.numerators[0, 0], [2.0, 1.0], atol=1e-12)
    assert float(direct.simulate(np.ones((1, 1)))[0, 0]) == pytest.approx(2.0)


def test_orders_are_found_by_bic_and_by_validation() -> None:
    """BIC finds the true orders; one QR of the grid gives what each fit of its own gives."""
    estimation = noisy(LEG, 10, samples=6000, where="equation", noise=0.1)
    validation = noisy(LEG, 11, samples=3000, where="equation", noise=0.1)
    result = select_orders(estimation, validation, na=range(1, 7), nb=range(1, 6), nk=(0, 1, 2))
    assert result.best("bic").orders == Orders(3, 3, 1)
    assert result.best("aic").bic >= result.best("bic").bic
    best = result.best("validation")
    assert best.fit >= max(c.fit for c in result.candidates) - 0.2
    closest = max((c for c in result.candidates if c.stable), key=lambda c: c.fit)
    assert best.parameters <= closest.parameters
    true = next(c for c in result.candidates if c.orders == Orders(3, 3, 1))
    alone = arx(estimation, (3, 3, 1))
    assert true.fit == pytest.approx(float(simulation_fit(alone, validation)[0]), abs=0.05)
    n = 6000 - 6
    assert true.bic - true.aic == pytest.approx(6 * (np.log(n) - 2.0))


def test_unstable_poles_are_reported_and_reflected() -> None:
    b, a = np.array([0.0, 1.0, 0.4]), np.poly([1.02, 0.5])
    u = driven(1, 300)
    run = series(u, signal.lfilter(b, a, u))
    model = arx(run, (2, 2, 1))
    assert model.unstable_poles == pytest.approx((1.02,), abs=1e-6)
    assert not model.reflected
    inside = model.stabilised()
    assert inside.unstable_poles == ()
    assert inside.reflected == pytest.approx((1.02,), abs=1e-6)
    np.testing.assert_allclose(
        np.abs(inside.response(FREQUENCY)), np.abs(model.response(FREQUENCY)), rtol=1e-6
    )
    assert np.isnan(inside.standard_errors()).all()
    fitted = output_error(run, (2, 2, 1))
    assert (fitted.reflected, fitted.unstable_poles) == (inside.reflected, ())


def test_residuals_of_the_right_model_are_white_and_of_a_small_one_are_not() -> None:
    run = noisy(LEG, 21, samples=6000, where="equation", noise=0.1)
    right = residual_analysis(arx(run, (3, 3, 1)), run, lags=100)
    assert auto_outside(right) <= 0.04  # 99 % bounds: one in a hundred on average
    assert right.cross_outside[0] <= 0.04
    small = residual_analysis(arx(run, (1, 1, 1)), run, lags=100)
    assert auto_outside(small) > 0.1
    assert small.cross_outside[0] > 0.03


def test_share_of_residual_correlations_outside_their_bounds_is_one_per_cent() -> None:
    """A hundred true models: 1 % of 20 lags outside, within 0.7 %."""
    outside, crossed = [], []
    for seed in range(100):
        run = noisy(lag(3.0), seed, samples=1000, noise=0.5)
        model = replace(
            arx(noisy(lag(3.0), seed, samples=1000, noise=0.0), (1, 1, 1)), noise="output"
        )
        result = residual_analysis(model, run, lags=20)
        outside.append(auto_outside(result))
        crossed.append(result.cross_outside[0])
    assert np.mean(outside) == pytest.approx(0.01, abs=0.007)
    assert np.mean(crossed) == pytest.approx(0.01, abs=0.007)


def test_fit_is_the_normalised_rms_error() -> None:
    y = np.array([1.0, 2.0, 3.0, 4.0])
    assert fit_percentage(y, y)[0] == 100.0
    assert fit_percentage(y, np.full(4, 2.5))[0] == pytest.approx(0.0)
    off = y + np.array([0.1, -0.1, 0.1, -0.1])
    assert fit_percentage(y, off)[0] == pytest.approx(100.0 * (1.0 - 0.2 / np.sqrt(5.0)))
    with pytest.raises(ValueError, match="does not move"):
        fit_percentage(np.ones(4), y)


def test_simulation_starts_from_the_best_initial_state() -> None:
    """A stretch cut out of a run is simulated exactly, which from rest it is not."""
    run = noisy(SIXTH, 2, noise=0.0).between(10.0, 14.0)
    model = arx(noisy(SIXTH, 3, noise=0.0), (6, 6, 1))
    np.testing.assert_allclose(simulated(model, run)[6:], run.output[6:], atol=1e-3)
    assert simulation_fit(model, run)[0] > 99.9
    assert fit_percentage(run.output, model.simulate(run.input))[0] < 99.0


@pytest.mark.parametrize(
    ("orders", "message"),
    [
        ((0, 1, 1), "na: 0 must be a whole number, at least 1"),
        ((1, 0, 1), "nb: 0 must be a whole number, at least 1"),
        ((1, 1, -1), "nk: -1 must be a whole number, at least 0"),
        ((40, 40, 1), "80 parameters; experiments give"),
        ((90, 1, 1), "reach back 90 samples"),
    ],
)
def test_bad_orders_are_named(orders: tuple[int, int, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        arx(noisy(SIXTH, 0, samples=80), orders)


def test_an_input_that_does_not_excite_the_model_is_refused() -> None:
    """A sine tells two coefficients of B apart, not three; a silent input none."""
    time = np.arange(500)
    u = np.sin(0.3 * time)
    y = signal.lfilter([0.0, 1.0], [1.0, -0.5], u) + 0.01 * driven(0, 500)
    with pytest.raises(ValueError, match="do not tell these parameters apart"):
        arx(series(u, y), (1, 3, 1))
    with pytest.raises(ValueError, match="zero all the time"):
        arx(series(np.zeros(500), y), (1, 1, 1))


def damping(model: PolynomialModel) -> float:
    """Damping ratio of the oscillating pair, 1 without one."""
    roots = [np.log(root.value) for root in model.poles() if root.value.imag > 0.0]
    inside = [s for s in roots if s.imag < 0.9 * np.pi]
    return min((-s.real / abs(s) for s in inside), default=1.0)


def test_output_error_recovers_a_sixth_order_system_from_outputs_with_5_per_cent_noise() -> None:
    """Within 2 % of the peak gain up to 15 Hz; all parameters within 4 sigma."""
    model = output_error(noisy(SIXTH, 1, samples=8000), (6, 6, 1))
    assert model.converged
    assert error(model, SIXTH) < 0.02
    off = model.parameters() - parameters(SIXTH)
    assert np.all(np.abs(off) < 4.0 * model.standard_errors())


def test_arx_is_biased_on_noisy_outputs_and_output_error_is_not() -> None:
    """Mean damping ratio of the oil mode over 40 experiments with 5 % of noise on the output.

    The true 0.11 lies within 3.3 standard errors of the mean (99.9 %) of OE, and more than 20 away
    from ARX's, which is a fifth or more too high.
    """
    runs = [noisy(LEG, seed, samples=1500) for seed in range(RUNS)]
    biased, right = ([damping(fit(run, (3, 3, 1))) for run in runs] for fit in (arx, output_error))
    assert off_from(biased, 0.11) > 20.0
    assert np.mean(biased) > 1.2 * 0.11
    assert abs(off_from(right, 0.11)) < 3.3


def test_covariances_of_output_error_are_those_of_repeated_experiments() -> None:
    """Mean of theta^T cov^-1 theta over 40 experiments is 6 +- 3.3 sqrt(12 / 40)."""
    distance = []
    for seed in range(RUNS):
        model = output_error(noisy(LEG, seed, samples=1500), (3, 3, 1))
        off = model.parameters() - parameters(LEG)
        distance.append(off @ np.linalg.solve(model.covariances[0], off))
    assert np.mean(distance) == pytest.approx(6.0, abs=3.3 * np.sqrt(12.0 / RUNS))


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
        run = series(r - 0.5 * y, y, reference=r)
        gains.append(output_error(run, (3, 3, 1)).response(0.5)[0, 0, 0])
    z = np.exp(2j * np.pi * 0.5 / RATE)
    assert abs(off_from(gains, np.polyval(b, z) / np.polyval(a, z))) > 5.0


def test_output_error_has_the_smallest_simulation_error() -> None:
    """On the data it was fitted to, whatever the model lacks: here a mode."""
    run = noisy(SIXTH, 4, samples=3000)
    fitted, least = (simulation_fit(fit(run, (4, 4, 1)), run)[0] for fit in (output_error, arx))
    assert fitted > least


def test_output_error_fits_runs_that_start_in_motion_jointly() -> None:
    """Two cuts of one run, each with its own unknown start: exact without noise."""
    run = noisy(LEG, 6, noise=0.0)
    cuts = [run.between(5.0, 15.0), run.between(21.0, 30.0)]
    model = output_error(cuts, (3, 3, 1))
    np.testing.assert_allclose(model.denominators[0], sampled(LEG)[1], rtol=1e-5)
    assert model.samples == sum(cut.samples for cut in cuts)


def test_subspace_method_of_a_library_agrees() -> None:
    """N4SID of nfoursid on the same noisy outputs: responses within 3 % of the peak gain.

    The library brings 40 MB of others along, so it is imported here.
    """
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    run = noisy(SIXTH, 1, samples=3000)  # the library decomposes a square of that size
    frame = pd.DataFrame({"u": run.input[:, 0], "y": run.output[:, 0]})
    library = NFourSID(frame, output_columns=["y"], input_columns=["u"], num_block_rows=20)
    library.subspace_identification()
    estimates, _ = library.system_identification(rank=6)
    system = control.ss(estimates.a, estimates.b, estimates.c, estimates.d, 1.0 / RATE)
    theirs = control.frequency_response(system, 2.0 * np.pi * FREQUENCY).frdata[0, 0]
    ours = output_error(run, (6, 6, 1)).response(FREQUENCY)[:, 0, 0]
    assert np.abs(theirs - ours).max() < 0.03 * np.abs(ours).max()


def test_refusals_of_output_error_are_named() -> None:
    with pytest.raises(ValueError, match="experiments: none given"):
        output_error([], (3, 3, 1))
