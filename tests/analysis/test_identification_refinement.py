"""Output error and instrumental variables: recovery, bias by Monte Carlo, feedback, subspace."""

from dataclasses import replace

import control
import numpy as np
import pytest
from identified_systems import RATE, SIXTH, driven, lag, noisy, pair, sampled, series
from scipy import signal

from cmf_mj.analysis.identification.arx import arx, simulation_fit
from cmf_mj.analysis.identification.data import Experiment
from cmf_mj.analysis.identification.model import PolynomialModel
from cmf_mj.analysis.identification.refinement import instrumental_variable, output_error

FREQUENCY = np.linspace(0.2, 15.0, 75)
LEG = lag(3.0) * pair(11.0, 0.11)
"""The single leg: a lag and the oil mode."""
RUNS = 40


def response(system: control.TransferFunction) -> np.ndarray:
    b, a = sampled(system)
    z = np.exp(2j * np.pi * FREQUENCY / RATE)
    return np.polyval(b, z) / np.polyval(a, z)


def error(model: PolynomialModel, system: control.TransferFunction) -> float:
    true = response(system)
    return float(np.abs(model.response(FREQUENCY)[:, 0, 0] - true).max() / np.abs(true).max())


def damping(model: PolynomialModel) -> float:
    """Damping ratio of the oscillating pair, 1 without one."""
    roots = [np.log(root.value) for root in model.poles() if root.value.imag > 0.0]
    inside = [s for s in roots if s.imag < 0.9 * np.pi]
    return min((-s.real / abs(s) for s in inside), default=1.0)


@pytest.mark.parametrize("fit", [output_error, instrumental_variable])
def test_sixth_order_system_is_recovered_from_outputs_with_5_per_cent_noise(fit) -> None:
    """Within 2 % of the peak gain up to 15 Hz; all parameters within 4 sigma."""
    model = fit(noisy(SIXTH, 1, samples=8000), (6, 6, 1))
    b, a = sampled(SIXTH)
    assert model.converged
    assert error(model, SIXTH) < 0.02
    off = model.parameters() - np.concatenate([a[1:], b[1:]])
    assert np.all(np.abs(off) < 4.0 * model.standard_errors())


def test_arx_is_biased_on_noisy_outputs_and_refinements_are_not() -> None:
    """Mean damping ratio of the oil mode over 40 experiments with 5 % of noise on the output.

    The true 0.11 lies within 3.3 standard errors of the mean (99.9 %) of OE and IV, and more than
    20 away from ARX's, which is a fifth or more too high.
    """
    estimates = {"arx": [], "oe": [], "iv": []}
    for seed in range(RUNS):
        run = noisy(LEG, seed, samples=1500)
        estimates["arx"].append(damping(arx(run, (3, 3, 1))))
        model = instrumental_variable(run, (3, 3, 1))
        estimates["iv"].append(damping(model))
        estimates["oe"].append(damping(output_error(run, (3, 3, 1), start=model)))
    off = {
        name: (np.mean(values) - 0.11) / (np.std(values, ddof=1) / np.sqrt(RUNS))
        for name, values in estimates.items()
    }
    assert off["arx"] > 20.0
    assert np.mean(estimates["arx"]) > 1.2 * 0.11
    assert abs(off["oe"]) < 3.3
    assert abs(off["iv"]) < 3.3


@pytest.mark.parametrize("fit", [output_error, instrumental_variable])
def test_covariances_are_those_of_repeated_experiments(fit) -> None:
    """Mean of theta^T cov^-1 theta over 40 experiments is 6 +- 3.3 sqrt(12 / 40)."""
    b, a = sampled(LEG)
    true = np.concatenate([a[1:], b[1:]])
    distance = []
    for seed in range(RUNS):
        model = fit(noisy(LEG, seed, samples=1500), (3, 3, 1))
        off = model.parameters() - true
        distance.append(off @ np.linalg.solve(model.covariances[0], off))
    assert np.mean(distance) == pytest.approx(6.0, abs=3.3 * np.sqrt(12.0 / RUNS))


def fed_back(seed: int, samples: int = 3000) -> Experiment:
    """y = G u + v, u = r - y / 2, one sample late, v coloured: its noise drives the input."""
    b, a = sampled(LEG)
    r = driven(seed, samples)
    # The colour of v: first-order, as drifting sensors have.
    v = signal.lfilter([1.0], [1.0, -0.9], np.random.default_rng([seed, 2]).normal(size=samples))
    v *= 0.3 / np.std(v)
    whole = np.polyadd(a, 0.5 * b)
    y = signal.lfilter(b, whole, r) + signal.lfilter(a, whole, v)
    return series(r - 0.5 * y, y, reference=r)


@pytest.mark.slow
def test_under_feedback_only_the_reference_is_an_unbiased_instrument() -> None:
    """Static gain 1 of the leg, 40 experiments in closed loop under coloured noise."""
    estimates = {"oe": [], "input": [], "reference": []}
    for seed in range(RUNS):
        run = fed_back(seed)
        for instrument in ("input", "reference"):
            model = instrumental_variable(run, (3, 3, 1), instrument=instrument)
            estimates[instrument].append(model.response(0.5)[0, 0, 0])
        estimates["oe"].append(output_error(run, (3, 3, 1), start=model).response(0.5)[0, 0, 0])
    b, a = sampled(LEG)
    z = np.exp(2j * np.pi * 0.5 / RATE)
    true = np.polyval(b, z) / np.polyval(a, z)
    off = {
        name: abs(np.mean(values) - true) / (np.std(values, ddof=1) / np.sqrt(RUNS))
        for name, values in estimates.items()
    }
    assert off["oe"] > 5.0
    assert off["input"] > 5.0
    assert off["reference"] < 3.3


def test_output_error_has_the_smallest_simulation_error() -> None:
    """On the data it was fitted to, whatever the model lacks: here a mode."""
    run = noisy(SIXTH, 4, samples=3000)
    fits = [
        float(simulation_fit(fit(run, (4, 4, 1)), run)[0])
        for fit in (output_error, instrumental_variable, arx)
    ]
    assert fits[0] > fits[1]
    assert fits[0] > fits[2]


def test_output_error_fits_runs_that_start_in_motion_jointly() -> None:
    """Two cuts of one run, each with its own unknown start: exact without noise."""
    run = noisy(LEG, 6, noise=0.0)
    cuts = [run.between(5.0, 15.0), run.between(21.0, 30.0)]
    b, a = sampled(LEG)
    model = output_error(cuts, (3, 3, 1), start=arx(cuts, (3, 3, 1)))
    np.testing.assert_allclose(model.denominators[0], a, rtol=1e-5)
    assert model.samples == sum(cut.samples for cut in cuts)


def test_output_error_stays_stable_and_tells_what_it_reflected() -> None:
    """A start with a pole outside is reflected; the result lists it."""
    run = noisy(LEG, 7, samples=1500)
    good = arx(run, (3, 3, 1))
    roots = np.roots(good.denominators[0])
    wild = np.poly(np.where(np.abs(roots.imag) > 0.0, roots, 1.05)).real
    start = replace(good, denominators=wild[None].copy())
    model = output_error(run, (3, 3, 1), start=start)
    assert model.reflected == pytest.approx((1.05,), abs=1e-6)
    assert model.unstable_poles == ()
    assert error(model, LEG) < 0.03


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


def test_refusals_are_named() -> None:
    run = noisy(LEG, 0, samples=300)
    with pytest.raises(ValueError, match="instrument: 'sun' is not one of input, reference"):
        instrumental_variable(run, (3, 3, 1), instrument="sun")
    with pytest.raises(ValueError, match="instrument: the experiments have no reference"):
        instrumental_variable(run, (3, 3, 1), instrument="reference")
    with pytest.raises(ValueError, match=r"start: has orders \(2, 2, 1\); allowed: \(3, 3, 1\)"):
        output_error(run, (3, 3, 1), start=arx(run, (2, 2, 1)))
    with pytest.raises(ValueError, match="experiments: none given"):
        output_error([], (3, 3, 1))
