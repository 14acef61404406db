"""The digital control law: the compiled frame against an independent linear system, block by block.

The oracle is a discrete state-space model in the report's own units (in, Pa, s, lbf, per cent),
assembled here from the printed equations and run by python-control.
"""

import control
import numpy as np
import pytest
from shared import WORKING_STROKE

from cmf_mj import Law, law_names, load_law
from cmf_mj.control import dcl as blocks
from cmf_mj.control.dcl import Dcl, DclState, limit_demand, make_dcl
from cmf_mj.control.engage import engaged_state
from cmf_mj.control.error import integrate, make_error_calculations
from cmf_mj.control.feedback import (
    LegFeedback,
    filter_acceleration,
)
from cmf_mj.control.law import SIGNALS

FRAME = 1.0 / 2048.0
INCH = 0.0254
POUND_FORCE = 0.45359237 * 9.80665
LEGS = 3


def feedback_at_rest(position: np.ndarray, cap: float = 4e6, rod: float = 4e6) -> LegFeedback:
    still = np.zeros(position.size)
    return LegFeedback(
        position,
        still.copy(),
        still.copy(),
        np.full(position.size, cap),
        np.full(position.size, rod),
    )


def run(
    dcl: Dcl, state: DclState, demand: np.ndarray, feedback: LegFeedback
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outputs, commands (N, n) and signals (N, n, 10) of histories (N, n)."""
    frames, legs = demand.shape
    signals_out = np.zeros((frames, legs, len(SIGNALS)))
    output, command = np.zeros((frames, legs)), np.zeros((frames, legs))
    for k in range(frames):
        now = LegFeedback(*(np.ascontiguousarray(channel[k]) for channel in feedback))
        blocks.step(dcl, state, demand[k], now)
        work = dcl.workspace
        signals_out[k], output[k], command[k] = work.inputs, work.output, work.command
    return output, command, signals_out


def published_system(law: Law) -> control.StateSpace:
    """Inputs (reference, position in in, velocity, acceleration, p_cap, p_rod in Pa), output %.

    States: compensator x, error integral, derivative filters of error and reference, filtered
    acceleration. Eqs 2.3 and 2.4; Figures 3-1, 3-5 to 3-7; Eqs 3.6 and 3.7. The numbers of the
    accelerometer's filter are in test_the_accelerometer_filter_is_the_hold_of_its_lag.
    """
    pole, frame = law.derivative_pole, FRAME
    r, s, v, a, pc, pr = np.eye(6)
    x, integral, zf, zr, af = np.eye(5)

    def row(state: np.ndarray | float, inputs: np.ndarray | float) -> np.ndarray:
        return np.concatenate([np.zeros(5) + state, np.zeros(6) + inputs])

    error_rate = row(-pole * zf, pole * (r - s))
    reference_rate = row(-pole * zr, pole * r)
    readings = {
        "reference": row(0, r),
        "cap_pressure": row(0, pc),
        "rod_pressure": row(0, pr),
        "position": row(0, s),
        "velocity": row(0, v),
        "position_error_rate": error_rate,
        "velocity_error": reference_rate - row(0, v),
        "error_integral": row(integral, 0),
        "acceleration": row(af, 0),
        # Eq 3.7 in lbf: 11.97 in^2 times a pressure difference in psi.
        "force": row(0, (pc - pr) * 11.97 * INCH**2 / POUND_FORCE),
    }
    following = row(law.state_gain * x, 0)
    output = row(law.output_gain * x, 0)
    for name, reading in readings.items():
        following = following + getattr(law.input_gain, name) * reading
        output = output + getattr(law.direct_gain, name) * reading
    rows = np.array(
        [
            following,
            row(integral, frame * (r - s)),
            row(zf, 0) + frame * error_rate,
            row(zr, 0) + frame * reference_rate,
            row(law.accelerometer_pole * af, law.accelerometer_gain * a),
        ]
    )
    return control.ss(rows[:, :5], rows[:, 5:], output[None, :5], output[None, 5:], FRAME)


def random_histories(seed: int, frames: int = 400) -> tuple[np.ndarray, LegFeedback]:
    """Demands within +-20 in and feedbacks of the size the machine has, SI."""
    rng = np.random.default_rng(seed)

    def noise(size: float) -> np.ndarray:
        return size * rng.uniform(-1.0, 1.0, (frames, LEGS))

    return noise(20 * INCH), LegFeedback(
        noise(20 * INCH), noise(1.0), noise(10.0), 5e6 + noise(5e6), 5e6 + noise(5e6)
    )


def law_with_every_gain() -> Law:
    """Gains of B and D on all ten signals at once, which no shipped law has."""
    rng = np.random.default_rng(12)
    sizes = dict(zip(SIGNALS, [20, 1e-6, 1e-6, 20, 2, 2, 2, 50, 0.1, 1e-3], strict=True))
    gains = {name: float(size * rng.normal()) for name, size in sizes.items()}
    inner = {name: 0.1 * value for name, value in gains.items()}
    table = {"title": "All gains", "state_gain": -0.7, "output_gain": 3.0, "derivative_pole": 200.0}
    return load_law({"name": "all", "input_gain": inner, "direct_gain": gains} | table)


LAWS = [law for law in map(load_law, law_names()) if law.reference_model is None]


@pytest.mark.parametrize("law", [*LAWS, law_with_every_gain()], ids=lambda law: law.name)
def test_every_law_is_its_published_linear_system(law: Law) -> None:
    """400 frames of random demand and feedback, every leg. 1e-12 of the largest output: round-off,
    units included."""
    demand, feedback = random_histories(11)
    output, command, _ = run(make_dcl(law, LEGS), DclState.zeros(LEGS), demand, feedback)
    inputs = np.array([demand / INCH, *(f / INCH for f in feedback[:3]), *feedback[3:]])
    system, time = published_system(law), np.arange(demand.shape[0]) * FRAME
    for leg in range(LEGS):
        expected = np.ravel(control.forced_response(system, time, inputs[:, :, leg]).outputs)
        size = np.abs(expected).max()
        assert size > 100.0
        np.testing.assert_allclose(100 * output[:, leg], expected, rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(
            100 * command[:, leg], np.clip(expected, -100, 100), rtol=0, atol=1e-12 * size
        )


LAGS = {"acceleration": 0.01, "acceleration_d2": 0.0}
"""Time constants of accelerometer filters that are not Eq 3.6 [s]."""


@pytest.mark.parametrize("name", law_names())
def test_the_accelerometer_filter_is_the_hold_of_its_lag(name: str) -> None:
    """Zero-order hold at 2048 Hz of 1 / (lag s + 1), with unit gain at rest. Eq 3.6, 0.007588 /
    (z - 0.9924), is that of 0.312 / (0.02 s + 0.312).

    0.5 %: the printed pole and gain have four digits, the pole's distance from 1 only two.
    """
    law, lag = load_law(name), LAGS.get(name, 0.02 / 0.312)
    filtering = make_dcl(law, 1).feedback
    state, response = 0.0, []
    for _ in range(8 * 2048):
        response.append(state)
        state = filter_acceleration(filtering, state, 1.0)
    response = np.array(response)
    assert response[0] == 0.0
    assert response[1] == law.accelerometer_gain
    assert response[-1] == pytest.approx(
        law.accelerometer_gain / (1 - law.accelerometer_pole), rel=1e-9
    )
    assert response[-1] == pytest.approx(1.0, rel=2e-3)
    time = np.arange(2048) * FRAME
    held = time > 0.0
    if lag > 0.0:
        assert -FRAME / np.log(law.accelerometer_pole) == pytest.approx(lag, rel=5e-3)
        system = control.sample_system(control.tf([1.0], [lag, 1.0]), FRAME, method="zoh")
        held = control.step_response(system, time).outputs
    np.testing.assert_allclose(response[:2048], held, rtol=0, atol=5e-3)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_integral_saturates_at_50_in_s(sign: float) -> None:
    """Section 3.2.1: limits of +-50. 30 in of error for 4 s would be 120 in s; 1e-12: round-off of
    the sum. It unwinds from the limit at once."""
    error = make_error_calculations(load_law("velocity_integral"), WORKING_STROKE)
    integral, path = 0.0, []
    for _ in range(4 * 2048):
        integral = integrate(error, integral, sign * 15 * INCH, sign * -15 * INCH)
        path.append(integral / INCH)
    expected = np.minimum(30.0 * FRAME * np.arange(1, 4 * 2048 + 1), 50.0)
    np.testing.assert_allclose(path, sign * expected, rtol=1e-12)
    unwound = integrate(error, integral, 0.0, sign * 10 * INCH) / INCH
    assert unwound == pytest.approx(sign * (50.0 - 10.0 * FRAME), rel=1e-12)


@pytest.mark.parametrize(
    ("position", "seen"),
    [(-37.4, -37.5), (-37.1, -37.5), (-37.01, -37.5), (-36.99, -36.99), (0.0, 0.0), (30.0, 30.0)],
)
def test_below_the_trigger_the_integrator_sees_the_bottom(position: float, seen: float) -> None:
    """Half an inch above the bottom stop at -37.5 in the true position is switched in (section
    3.2.1); below, -37.5 in stands for it, so that a parked leg told to be there has no error."""
    error = make_error_calculations(load_law("velocity_integral"), WORKING_STROKE)
    for reference in (-37.5, -30.0):
        moved = integrate(error, 0.0, reference * INCH, position * INCH) / INCH
        assert moved == pytest.approx(FRAME * (reference - seen), rel=1e-12, abs=1e-15)


def test_only_the_integrator_sees_the_bottom_below_the_trigger() -> None:
    """Position and error rate use the true position at any leg position."""
    dcl, state = make_dcl(load_law("position_error_rate"), 1), DclState.zeros(1)
    at = np.full((1, 1), -37.2 * INCH)
    still = np.zeros((1, 1))
    _, _, read = run(dcl, state, at, LegFeedback(at, still, still, still.copy(), still.copy()))
    assert read[0, 0, SIGNALS.index("position")] == at[0, 0]
    assert read[0, 0, SIGNALS.index("position_error_rate")] == 0.0
    assert state.error.integral[0] / INCH == pytest.approx(FRAME * 0.3, rel=1e-9)


def test_demands_are_limited_to_the_working_stroke() -> None:
    """+-37.5 in (section 3.2.1); inside they pass unchanged."""
    for inches in (-37.5, -3.0, 0.0, 37.4):
        assert limit_demand(inches * INCH, WORKING_STROKE) == inches * INCH
    assert limit_demand(45 * INCH, WORKING_STROKE) == pytest.approx(37.5 * INCH, rel=1e-15)
    assert limit_demand(-45 * INCH, WORKING_STROKE) == pytest.approx(-37.5 * INCH, rel=1e-15)
    dcl, far = make_dcl(load_law("velocity_error"), 2), np.array([[50.0, -50.0]]) * INCH
    _, _, read = run(
        dcl, DclState.zeros(2), far, LegFeedback(*(np.zeros((1, 2)) for _ in LegFeedback._fields))
    )
    found = read[0, :, SIGNALS.index("reference")] / INCH
    np.testing.assert_allclose(found, [37.5, -37.5], rtol=1e-14)
    rates = read[0, :, SIGNALS.index("velocity_error")] / INCH
    np.testing.assert_allclose(rates, np.array([37.5, -37.5]) * dcl.error.derivative_pole)


@pytest.mark.parametrize("name", law_names())
@pytest.mark.parametrize("inches", [-20.0, 0.0, 15.0])
def test_engaged_filters_have_settled(name: str, inches: float) -> None:
    """Held at rest, the state that `engaged_state` returns does not move: neither compensator nor
    filters. 1e-12 of the signals: round-off."""
    dcl = make_dcl(load_law(name), LEGS)
    reference = np.array([inches, inches + 1.0, inches - 2.0]) * INCH
    feedback = feedback_at_rest(reference.copy(), 4.2e6, 4.1e6)
    state = engaged_state(dcl, reference, feedback)
    start = DclState.of(state.arrays())
    frames = np.repeat(reference[None], 50, axis=0)
    held = LegFeedback(*(np.repeat(channel[None], 50, axis=0) for channel in feedback))
    output, _, _ = run(dcl, state, frames, held)
    for before, after in zip(start.arrays().values(), state.arrays().values(), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(output, np.repeat(output[:1], 50, axis=0), rtol=0, atol=1e-12)


THROUGH = load_law(
    {
        "name": "through",
        "title": "Through the state",
        "state_gain": 0.8,
        "output_gain": 3.0,
        "input_gain": {"error_integral": 5.0, "position": 1.0},
        "direct_gain": {"reference": 30.0, "position": -31.0, "error_integral": 2.0},
    }
)
"""Its integral acts through B, too, with DC gain C B / (1 - A)."""
INTEGRAL = [law for law in map(load_law, law_names()) if np.any(law.direct_gain.error_integral)]


@pytest.mark.parametrize("law", [*INTEGRAL, THROUGH], ids=lambda law: law.name)
@pytest.mark.parametrize("inches", [-20.0, 0.0, 15.0])
def test_engaged_laws_with_an_integral_command_nothing(law: Law, inches: float) -> None:
    """The integral has taken up the static offset of pressures and position gains, also with a
    standing position error in the filters. 1e-12: round-off."""
    dcl = make_dcl(law, LEGS)
    reference = np.array([inches, inches + 1.0, inches - 2.0]) * INCH
    feedback = feedback_at_rest(reference + 0.001, 4.2e6, 4.1e6)
    state = engaged_state(dcl, reference, feedback)
    output, command, _ = run(
        dcl, state, reference[None], LegFeedback(*(channel[None] for channel in feedback))
    )
    np.testing.assert_allclose(output, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(command, 0.0, rtol=0, atol=1e-12)
    assert np.abs(state.error.integral).max() > 0.0
