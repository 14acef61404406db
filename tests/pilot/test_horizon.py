"""The condensed horizon: linear-quadratic limits, exact costs, knots, otoliths."""

import numpy as np
import pytest
from scipy import integrate, linalg

from cmf_mj.core.filters import discretise
from cmf_mj.pilot.horizon import condense, finite_problem, knot_times, otoliths_ahead, span_cost
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.optimal import washout_modes
from cmf_mj.pilot.perception import load_senses, sense
from cmf_mj.pilot.washout_settings import load_washout

MODES = washout_modes(load_washout("predictive"))


@pytest.mark.parametrize("name", MODES)
def test_unconstrained_over_a_long_horizon_it_is_the_discrete_riccati_solution(name):
    """State (x, u), input the next u: SciPy's equation has u+ = -K (x, u)."""
    mode, span, count = MODES[name], 0.1, 150
    a, both, weight, _ = finite_problem(mode)
    n, m = len(a), mode.plant[1].shape[1]
    b = both[:, :m]
    held = discretise(a, b, np.zeros((0, n)), np.zeros((0, m)), span)
    w = span_cost((a, b), weight[: n + m, : n + m], span)
    moved = np.block([[held.transition, held.previous_gain], [np.zeros((m, n + m))]])
    driven = np.vstack([held.next_gain, np.eye(m)])
    q, s, r = w[: n + m, : n + m], w[: n + m, n + m :], w[n + m :, n + m :]
    p = linalg.solve_discrete_are(moved, driven, q, r, s=s)
    gain = np.linalg.solve(r + driven.T @ p @ driven, driven.T @ p @ moved + s.T)
    whole = condense(mode, knot_times(count, span, 0.0))
    plan = -np.linalg.solve(whole.hessian, whole.gradient[:, : n + m])
    np.testing.assert_allclose(plan[:m], -gain, atol=1e-7 * np.abs(gain).max())


def test_cost_of_a_span_is_the_integral():
    """Against adaptive quadrature of the simulated motion."""
    draw = np.random.default_rng(4)
    mode = MODES["pitch_surge"]
    a, both, weight, _ = finite_problem(mode)
    x, w0, w1 = draw.normal(size=len(a)), draw.normal(size=4), draw.normal(size=4)
    span = 0.3
    whole = np.concatenate([x, w0, w1])
    actual = whole @ span_cost((a, both), weight, span) @ whole

    def rate(t, y):
        w = w0 + (w1 - w0) * t / span
        z = np.concatenate([y[:-1], w])
        return np.concatenate([a @ y[:-1] + both @ w, [z @ weight @ z]])

    run = integrate.solve_ivp(rate, (0, span), np.append(x, 0.0), rtol=1e-11, atol=1e-12)
    assert actual == pytest.approx(run.y[-1, -1], rel=1e-8)


def test_knots_begin_with_a_frame_and_end_at_the_horizon():
    times = knot_times(16, 0.0125, 3.0)
    assert (times[0], times[1], times[-1]) == pytest.approx((0.0, 0.0125, 3.0))
    ratio = np.diff(times)[1:] / np.diff(times)[:-1]
    np.testing.assert_allclose(ratio, ratio[0])


def test_otoliths_ahead_sense_what_the_senses_do():
    """Of a force that runs straight between the knots, next to the samples of `sense`."""
    times = np.array([0.0, 0.05, 0.1, 0.25, 0.4])
    force = np.array([0.4, 0.7, -0.2, 1.0, 0.3])
    fine = np.arange(0.0, 0.4 + 1e-9, 0.001)
    flown = np.zeros((fine.size, 3))
    flown[:, 0] = np.interp(fine, times, force)
    told = sense(PilotMotion(fine, flown, 0.0 * flown, 0.0 * flown)).specific_force[:, 0]
    otoliths = otoliths_ahead(times)
    rows = otoliths.sensed
    # At rest with the first force, x_0 gives what a constant force does.
    constant = rows[:, 2:].sum(axis=1) * force[0]
    gain = load_senses().otoliths.gain.si * force[0]
    start, *_ = np.linalg.lstsq(rows[:, :2], gain - constant, rcond=None)
    ahead = rows @ np.concatenate([start, force])
    np.testing.assert_allclose(ahead, np.interp(times[1:], fine, told), atol=1e-9)
    assert otoliths.next_state.shape == (2, rows.shape[1])
