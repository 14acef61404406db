"""First-order hold against python-control and closed forms."""

import control
import numpy as np
import pytest

from cmf_mj.core.filters import advance, discretise, settled_state, write_history

SYSTEM = (
    np.array([[0.0, 1.0], [-4.0, -2.4]]),
    np.array([[0.0], [4.0]]),
    np.array([[1.0, 0.0], [0.0, 1.0]]),
    np.array([[0.0], [0.5]]),
)


def test_response_to_straight_pieces_is_python_controls():
    """python-control integrates inputs that run straight between samples; so does the hold."""
    interval, draw = 0.0125, np.random.default_rng(2).standard_normal(400)
    time = interval * np.arange(draw.size)
    oracle = control.forced_response(control.ss(*SYSTEM), time, draw).outputs
    outputs = np.empty((draw.size, 2))
    write_history(discretise(*SYSTEM, interval), np.zeros(2), draw[:, None], outputs)
    np.testing.assert_allclose(outputs.T, oracle, rtol=0, atol=1e-9 * np.abs(oracle).max())


def test_a_ramp_comes_out_in_closed_form():
    """dx/dt = -x + t from rest: x = t - 1 + exp(-t), whatever the interval."""
    time = np.arange(9) * 0.7
    outputs = np.empty((9, 1))
    write_history(
        discretise([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.7), np.zeros(1), time[:, None], outputs
    )
    np.testing.assert_allclose(outputs[:, 0], time - 1.0 + np.exp(-time), atol=1e-14)


def test_settled_state_stays():
    system = discretise(*SYSTEM, 0.1)
    state = settled_state(system, [3.0])
    before, work = state.copy(), np.empty(2)
    advance(system, state, np.array([3.0]), np.array([3.0]), work)
    np.testing.assert_allclose(state, before, atol=1e-14)
    np.testing.assert_allclose(state, [3.0, 0.0], atol=1e-14)


def test_refusals():
    with pytest.raises(ValueError, match="c: shape"):
        discretise([[-1.0]], [[1.0]], [[1.0, 0.0]], [[0.0]], 0.1)
    with pytest.raises(ValueError, match="interval"):
        discretise([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0)
