"""Section 3.4: closed forms against python-control's simulation of the block diagram."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cmf_mj.report_2014.models import (
    GAINS,
    FeedbackLoop,
    bandwidth_example,
    characteristics,
    feedback_model,
)

LOOPS = st.builds(
    FeedbackLoop,
    st.floats(0.5, 50.0),
    st.floats(0.02, 1.5),
    st.floats(0.0, 5.0),
    st.floats(0.0, 1.0),
    st.floats(0.0, 0.1),
)


@given(LOOPS)
@settings(deadline=None, max_examples=30)
def test_eqs_3_2_to_3_4_are_the_nested_loops_of_figure_3_12(loop: FeedbackLoop) -> None:
    """G1 = G/(1 + K_p G), G2 = G1/(1 + K_r s G1), G3 = G2/(1 + K_a s^2 G2), point by point."""
    s = 1j * loop.natural_frequency * np.geomspace(0.1, 10.0, 9)
    w, zeta = loop.natural_frequency, loop.damping_ratio
    g = w**2 / (s**2 + 2.0 * w * zeta * s + w**2)
    g1 = g / (1.0 + loop.position_gain * g)
    g2 = g1 / (1.0 + loop.rate_gain * s * g1)
    g3 = g2 / (1.0 + loop.acceleration_gain * s**2 * g2)
    for number, expected in (("3.1", g), ("3.2", g1), ("3.3", g2), ("3.4", g3)):
        np.testing.assert_allclose(feedback_model(number, loop)(s), expected, rtol=1e-9)


@given(LOOPS)
@settings(deadline=None, max_examples=30)
def test_characteristics_are_those_of_the_transfer_function(loop: FeedbackLoop) -> None:
    system, result = feedback_model("3.4", loop), characteristics(loop)
    natural, damping, _ = control.damp(system, doprint=False)
    assert np.sqrt(np.prod(natural)) / (2.0 * np.pi) == pytest.approx(result.mode_frequency_hz)
    if result.mode_damping_ratio < 1.0:
        assert damping[0] == pytest.approx(result.mode_damping_ratio)
    assert system.dcgain() == pytest.approx(result.static_gain)
    at_phase = system(2j * np.pi * result.phase_bandwidth_hz)
    assert np.angle(at_phase, deg=True) == pytest.approx(-90.0)
    at_gain = system(2j * np.pi * result.gain_bandwidth_hz)
    assert abs(at_gain) == pytest.approx(result.static_gain * 10.0 ** (-3.0 / 20.0))
    omega = 2.0 * np.pi * result.mode_frequency_hz * np.linspace(1e-6, 2.0, 20001)
    peak = np.abs(system(1j * omega)).max() / result.static_gain
    assert 20.0 * np.log10(peak) == pytest.approx(result.peak_gain_db, abs=1e-3)


@pytest.mark.parametrize("damping", [0.1, 0.4, 0.7, 1.3])
def test_overshoot_is_that_of_the_simulated_step(damping: float) -> None:
    loop = FeedbackLoop(6.0, damping, 0.5)
    result = characteristics(loop)
    reached = control.step_response(feedback_model("3.4", loop), np.linspace(0.0, 10.0, 20001))
    over = float(reached.outputs.max()) / result.static_gain - 1.0
    assert max(over, 0.0) == pytest.approx(result.overshoot, abs=2e-5)


def test_each_gain_does_what_the_characteristic_equation_says() -> None:
    """K_p raises the frequency, K_r only damps, K_a lowers frequency and damping."""
    loop = bandwidth_example()["acceleration"]
    varied = {
        name: [
            characteristics(loop._replace(**{field: share * getattr(loop, field)}))
            for share in np.linspace(0.5, 1.5, 5)
        ]
        for name, field in zip(("kp", "kr", "ka"), GAINS, strict=True)
    }
    phase, gain, damping = (
        {
            name: np.sign(np.diff([getattr(one, field) for one in effects]).round(12))
            for name, effects in varied.items()
        }
        for field in ("phase_bandwidth_hz", "gain_bandwidth_hz", "mode_damping_ratio")
    )
    assert (phase["kp"] == 1).all() and (phase["kr"] == 0).all() and (phase["ka"] == -1).all()
    assert (gain["kp"] == 1).all() and (gain["kr"] == -1).all() and (gain["ka"] == -1).all()
    assert (damping["kp"] == -1).all() and (damping["kr"] == 1).all()
    assert (damping["ka"] == -1).all()


@pytest.mark.parametrize("plant_damping", [0.05, 0.3])
@pytest.mark.parametrize("loop_damping", [0.4, 0.7])
def test_example_has_the_bandwidths_of_figure_3_14(
    plant_damping: float, loop_damping: float
) -> None:
    """1.08 Hz with position and rate feedback, 1.06 Hz with acceleration feedback added."""
    loops = bandwidth_example(plant_damping, loop_damping)
    rate, acceleration = (feedback_model("3.4", loops[name]) for name in ("rate", "acceleration"))
    assert loops["acceleration"].acceleration_gain > 0.0
    for system, hertz in ((rate, 1.08), (acceleration, 1.06)):
        # python-control's bandwidth counts from the static gain, -3 dB as given.
        assert control.bandwidth(system, -3.0) / (2.0 * np.pi) == pytest.approx(hertz, abs=1e-4)
    natural, damping, _ = control.damp(rate, doprint=False)
    assert damping[0] == pytest.approx(loop_damping)


def test_unstable_and_refused_loops() -> None:
    unstable = characteristics(FeedbackLoop(5.0, 0.1, rate_gain=-0.1))
    assert unstable.mode_damping_ratio == pytest.approx(-0.15)
    assert np.isnan([unstable.phase_bandwidth_hz, unstable.peak_gain_db, unstable.overshoot]).all()
    for loop, message in (
        (FeedbackLoop(0.0, 0.1), "natural_frequency: 0.0 rad/s must be above 0"),
        (FeedbackLoop(5.0, 0.1, position_gain=-1.0), "position_gain: -1.0 must be above -1"),
        (FeedbackLoop(5.0, 0.1, acceleration_gain=-0.04), "acceleration_gain: -0.04"),
    ):
        with pytest.raises(ValueError, match=message):
            characteristics(loop)
        with pytest.raises(ValueError, match=message):
            feedback_model("3.4", loop)
    with pytest.raises(ValueError, match="number: '3.5' is not one of 3.1, 3.2, 3.3, 3.4"):
        feedback_model("3.5", FeedbackLoop(5.0, 0.1))
    for damping in (0.01, 0.75):
        with pytest.raises(ValueError, match=f"loop_damping: {damping} must be at least .* 0.706"):
            bandwidth_example(loop_damping=damping)


def test_acceleration_feedback_widens_the_band_of_a_well_damped_loop() -> None:
    """Why the example ends at a damping ratio of 0.706: above it -3 dB moves up at first."""
    for damping, direction in ((0.70, -1.0), (0.72, 1.0)):
        bare, heavier = (
            characteristics(FeedbackLoop(5.0, damping, acceleration_gain=gain)).gain_bandwidth_hz
            for gain in (0.0, 1e-6)
        )
        assert np.sign(heavier - bare) == direction
