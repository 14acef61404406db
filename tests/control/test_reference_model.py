"""Model following against closed forms and block algebra; what the adaptation finds, its bounds."""

import control
import numpy as np
import pytest

from cmf_mj import Hexapod, Law, SingleLegs, load_hydraulics, load_law, signals, simulate
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.step_response import step_metrics
from cmf_mj.control.dcl import DclState, make_dcl, step
from cmf_mj.control.engage import engaged_state
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Gains
from cmf_mj.core.units import FRAME
from cmf_mj.facility.replay import replay

INCH = 0.0254
LAG, SPEED = 1.0 / (6.0 * np.pi), 0.35
FIXED, ADAPTIVE = load_law("model_following"), load_law("model_reference_adaptive")
MODEL = ADAPTIVE.reference_model
assert MODEL is not None
SETTINGS = MODEL.adaptation
assert SETTINGS is not None


def with_model(law: Law, **changes: object) -> Law:
    model = law.reference_model
    assert model is not None
    return law.model_copy(update={"reference_model": model.model_copy(update=changes)})


def run(
    law: Law, reference: np.ndarray, feedback: LegFeedback, state: DclState | None = None
) -> tuple[np.ndarray, DclState]:
    """Outputs (N, n) of histories (N, n), and the last state."""
    legs = reference.shape[1]
    dcl = make_dcl(law, legs)
    now = LegFeedback(*(channel[0].copy() for channel in feedback))
    state = engaged_state(dcl, reference[0], now) if state is None else state
    output = np.zeros(reference.shape)
    for k in range(reference.shape[0]):
        now = LegFeedback(*(np.ascontiguousarray(channel[k]) for channel in feedback))
        step(dcl, state, reference[k], now)
        output[k] = dcl.workspace.output
    return output, state


def histories(seed: int, frames: int, size: float) -> tuple[np.ndarray, LegFeedback]:
    rng = np.random.default_rng(seed)
    channels = [np.cumsum(rng.normal(size=(frames, 2)), axis=0) * size for _ in range(3)]
    pressure = np.full((frames, 2), 4e6)
    noise = rng.normal(size=(frames, 2)) * size
    return channels[0], LegFeedback(channels[1], channels[2], noise, pressure, pressure)


def test_a_law_without_a_model_knows_nothing_of_its_states() -> None:
    """Bit for bit the same output whatever stands in them, NaN included, and they stay."""
    reference, feedback = histories(1, 100, 1e-3)
    law = load_law("position_error_rate")
    clean, state = run(law, reference, feedback)
    spoilt = engaged_state(
        make_dcl(law, 2), reference[0], LegFeedback(*(channel[0] for channel in feedback))
    )
    for name, array in spoilt.arrays().items():
        if name.startswith(("model.", "plan.", "load_")):
            array[:] = np.nan
    found, after = run(law, reference, feedback, spoilt)
    assert found.tobytes() == clean.tobytes()
    assert np.isnan(after.model.position).all()
    assert not state.model.adaptation.factor.any()


def test_the_model_is_exact_for_a_step() -> None:
    """1 - exp(-zeta w t) (cos w_d t + zeta / sqrt(1 - zeta^2) sin w_d t), frame by frame, read
    through a law that passes the model's position alone."""
    law = Law.model_validate(
        {
            "name": "probe",
            "title": "probe",
            "direct_gain": {},
            "reference_model": {"natural_frequency": 5.0, "damping_ratio": 0.4, "position": 1.0},
        }
    )
    frames = 2048
    reference = np.ones((frames, 1)) * 2.0 * INCH
    reference[0] = 0.0
    zero = np.zeros((frames, 1))
    output, _ = run(law, reference, LegFeedback(zero, zero, zero, zero, zero))
    time = np.arange(frames - 1) * FRAME
    omega, zeta = 10.0 * np.pi, 0.4
    damped = omega * np.sqrt(1.0 - zeta**2)
    swing = np.cos(damped * time) + zeta * omega / damped * np.sin(damped * time)
    expected = 2.0 * (1.0 - np.exp(-zeta * omega * time) * swing)
    np.testing.assert_allclose(100.0 * output[1:, 0], expected, atol=1e-10)


def integrating_leg(speed: float = SPEED) -> control.StateSpace:
    """tau v' + v = k u, p' = v; SI."""
    k = speed * 100.0 * INCH
    return control.ss(
        [[0.0, 1.0], [0.0, -1.0 / LAG]],
        [[0.0], [k / LAG]],
        np.eye(2),
        np.zeros((2, 1)),
        inputs=["command"],
        outputs=["leg_position", "leg_velocity"],
    )


def test_the_fixed_loop_is_its_block_algebra() -> None:
    """G = z^-1 P_p (F + (K_p + z-integral) M + K_r V) / (1 + feedback), blocks from python-control,
    in inches and per cent."""
    law = with_model(FIXED, rate=0.3)
    frequency = np.linspace(0.1, 12.0, 40)
    z = np.exp(2j * np.pi * frequency * FRAME)

    def at(a: list[list[float]], b: list[list[float]]) -> np.ndarray:
        held = control.sample_system(control.ss(a, b, np.eye(2), np.zeros((2, 1))), FRAME, "zoh")
        return np.array([np.ravel(held(point)) for point in z]).T

    position, velocity = at([[0.0, 1.0], [0.0, -1.0 / LAG]], [[0.0], [SPEED / LAG]]) / z
    omega, zeta = 8.0 * np.pi, 0.7
    model, speed = at([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]], [[0.0], [omega**2]])
    acceleration = (z - 1.0) / FRAME * speed
    integral = 20.0 * FRAME / (z - 1.0)
    forward = 2.857 * speed + 0.1682 * acceleration + 0.3 * speed + (20.0 + integral) * model
    expected = position * forward / (1.0 + (20.0 + integral) * position + 0.3 * velocity)
    found = loop_response(closed_loop(law, integrating_leg()), frequency).response
    np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_a_leg_that_is_known_moves_as_its_model() -> None:
    """With 1.5 frames of delay in the lead, what is left is of second order: a frame T in the
    acceleration's path, T tau w^2 over |1 + j w tau|, times the loop's sensitivity. Without, it is
    of first order."""
    delay = 1.5 * FRAME
    exact = with_model(FIXED, velocity=1.0 / SPEED, acceleration=(LAG + delay) / SPEED)
    frequency = np.linspace(0.1, 6.0, 60)
    omega = 2.0 * np.pi * frequency
    w, zeta = 8.0 * np.pi, 0.7
    model = w**2 / (w**2 - omega**2 + 2j * zeta * w * omega)
    # The model sees a held demand: half a frame, which the loop's response is measured with.
    model = model * np.exp(-0.5j * omega * FRAME)
    s = 1j * omega
    opened = (20.0 + 20.0 / s) * SPEED / (s * (1.0 + LAG * s)) * np.exp(-delay * s)
    left = FRAME * LAG * omega**2 / np.abs((1.0 + LAG * s) * (1.0 + opened))
    found = loop_response(closed_loop(exact, integrating_leg()), frequency).response
    assert (np.abs(found / model - 1.0) < 1.1 * left + 1e-6).all()
    late = with_model(exact, acceleration=LAG / SPEED)
    found = loop_response(closed_loop(late, integrating_leg()), frequency).response
    assert (np.abs(found / model - 1.0) > 1.1 * left + 1e-6)[:20].all()
    slow = loop_response(closed_loop(exact, integrating_leg(0.7 * SPEED)), frequency).response
    assert np.abs(slow / model - 1.0).max() > 0.2


@pytest.mark.parametrize("share", [0.7, 1.0, 1.3])
def test_shipped_gains_are_positive_real_where_a_leg_is_excited(share: float) -> None:
    """c < (1 + k K_r) / tau and K_i < c K_p. With both lags, leg mode and 1.5 frames of delay,
    Re W > 0 from 0.02 to 6 Hz in heave (71 rad/s), to 2.9 Hz for the heavy pair (4.83 Hz)."""
    assert MODEL is not None and SETTINGS is not None
    assert SETTINGS.slope < 1.0 / LAG
    assert ADAPTIVE.direct_gain.error_integral < SETTINGS.slope * MODEL.position
    for mode, top in ((71.0, 6.0), (2.0 * np.pi * 4.83, 2.9)):
        s = 2j * np.pi * np.geomspace(0.02, top, 400)
        lags = (1.0 + LAG * s) * (1.0 + s / (150.0 * np.pi))
        leg = mode**2 / (s**2 + 15.0 * s + mode**2) * np.exp(-1.5 * FRAME * s)
        velocity = share * SPEED * leg / lags
        feedback = (MODEL.position + ADAPTIVE.direct_gain.error_integral / s) * velocity / s
        w = (1.0 + SETTINGS.slope / s) * velocity / (1.0 + feedback)
        assert (w.real > 0.0).all()


def slowed(share: float) -> SingleLegs:
    parameters = load_hydraulics("hardware")
    speed = parameters.leg_speed
    other = speed.model_copy(update={"value": share * speed.value})
    return SingleLegs(parameters.model_copy(update={"leg_speed": other}))


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_the_factor_finds_the_speed_of_the_leg(share: float) -> None:
    """1 / share within 5 %; the distance from the model falls to less than a fifth."""
    command = signals.sine("heave", 2.0 * INCH, 0.4, cycles=12.0)
    far = {}
    for law in (FIXED, ADAPTIVE):
        record = simulate(slowed(share), law, command)
        w, zeta = 8.0 * np.pi, 0.7
        model = control.ss([[0, 1], [-(w**2), -2 * zeta * w]], [[0], [w**2]], [[1, 0]], [[0]])
        held = control.sample_system(model, FRAME, "zoh")
        wanted = control.forced_response(held, inputs=record["leg_reference"][:, 0]).outputs
        window = slice(int(0.6 * wanted.size), int(0.9 * wanted.size))
        far[law.name] = np.sqrt(np.mean((wanted - record["leg_position"][:, 0])[window] ** 2))
        factor = replay(record, law).factor
        if law is ADAPTIVE:
            np.testing.assert_allclose(factor[window], 1.0 / share, rtol=0.05)
        else:
            np.testing.assert_array_equal(factor, 1.0)
    assert far[ADAPTIVE.name] < 0.2 * far[FIXED.name]


@pytest.mark.parametrize(("hertz", "least", "most"), [(2.0, 0.0, 0.02), (3.0, 0.10, 0.16)])
def test_sustained_surge_above_2_hz_biases_the_factor(
    hertz: float, least: float, most: float
) -> None:
    """The legs are as fast as the law takes them to be; laws.md says where that is no longer found.

    0.33 in for 20 s."""
    command = signals.sine("surge", 0.33 * INCH, hertz, cycles=20.0 * hertz)
    factor = replay(simulate(Hexapod(), ADAPTIVE, command), ADAPTIVE).factor[-1]
    assert least <= np.abs(factor - 1.0).max() <= most


def test_nothing_drifts_at_rest_and_the_leak_forgets() -> None:
    """Noise on every sensor and a demand at rest: d is 0 to the bit, and one of 0.3 fades as
    exp(-leak t)."""
    assert SETTINGS is not None
    frames = 3000
    rng = np.random.default_rng(3)
    reference = np.full((frames, 2), 3.0 * INCH)
    noise = [rng.normal(size=(frames, 2)) * size for size in (1e-3, 0.1, 1.0, 1e5, 1e5)]
    noise[0] += reference
    output, state = run(ADAPTIVE, reference, LegFeedback(*noise))
    assert np.ptp(output) > 0.01
    np.testing.assert_array_equal(state.model.adaptation.factor, 0.0)
    state.model.adaptation.factor[:] = 0.3
    _, after = run(ADAPTIVE, reference, LegFeedback(*noise), state)
    expected = 0.3 * np.exp(-SETTINGS.leak * frames * FRAME)
    np.testing.assert_allclose(after.model.adaptation.factor, expected, rtol=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_factor_keeps_within_its_bounds_and_stands_still_when_clamped(sign: float) -> None:
    """A leg that moves thrice as fast, or the wrong way, for 20 s; one that is clamped."""
    assert SETTINGS is not None
    frames = 20 * 2048
    time = np.arange(frames)[:, None] * FRAME
    reference = np.hstack([np.sin(3.0 * time), np.sin(4.0 * time)]) * INCH
    speed = np.gradient(reference, FRAME, axis=0)
    zero = np.zeros((frames, 2))
    answer = LegFeedback(reference, (1 + 2 * sign) * speed, zero, zero, zero)
    fast = with_model(ADAPTIVE, adaptation=SETTINGS.model_copy(update={"rate": 5.0}))
    _, state = run(fast, reference, answer)
    bound = SETTINGS.lowest if sign > 0 else SETTINGS.highest
    np.testing.assert_allclose(1.0 + state.model.adaptation.factor, bound, rtol=0.02)
    kept = state.model.adaptation.factor.copy()
    off = answer._replace(position=answer.position - 15.0 * INCH)
    output, after = run(fast, reference[:2000], LegFeedback(*(c[:2000] for c in off)), state)
    clamped = (np.abs(output) >= 1.0).all(axis=0)
    assert clamped.all()
    np.testing.assert_array_equal(after.model.adaptation.factor, kept)


def test_errors_count_from_the_model() -> None:
    """Integral and rates of a law with a model are those of a law without whose demand it is."""
    gains = {"error_integral": 30.0, "position_error_rate": 2.0, "velocity_error": 1.5}
    plain = Law.model_validate({"name": "a", "title": "a", "direct_gain": gains})
    model = {"natural_frequency": 3.0, "damping_ratio": 0.9}
    following = Law.model_validate(plain.model_dump() | {"name": "b", "reference_model": model})
    reference, feedback = histories(4, 300, 1e-4)
    probe = with_model(following, position=1.0).model_copy(update={"direct_gain": Gains()})
    still = LegFeedback(*(np.zeros_like(channel) for channel in feedback))
    track = 100.0 * INCH * run(probe, reference, still)[0]
    found, _ = run(following, reference, feedback)
    expected, _ = run(plain, track, feedback)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("dof", ["surge", "pitch"])
def test_the_heavy_pair_of_the_hexapod_settles(dof: str) -> None:
    """Where the report's faster laws ring on; engaged at rest nothing moves before the step."""
    size = INCH if dof == "surge" else np.radians(0.6)
    record = simulate(Hexapod(), ADAPTIVE, signals.step(dof, size), record_every=8)
    metrics = step_metrics(record)
    assert metrics.stable
    assert metrics.residual < 0.01
    assert np.abs(record["valve_command"][:100]).max() < 1e-6
    assert abs(metrics.steady_state_error) < 0.002


def test_without_a_rate_the_law_is_the_fixed_one_bit_for_bit() -> None:
    assert SETTINGS is not None
    still = with_model(ADAPTIVE, adaptation=SETTINGS.model_copy(update={"rate": 0.0}))
    reference, feedback = histories(2, 400, 1e-4)
    outputs = [run(law, reference, feedback)[0] for law in (FIXED, still, ADAPTIVE)]
    assert outputs[0].tobytes() == outputs[1].tobytes()
    assert outputs[0].tobytes() != outputs[2].tobytes()
