"""Linear models against the report's own arithmetic and the compiled DCL."""

import control
import numpy as np
import pytest

from cmf_mj import bandwidths
from cmf_mj.control import law_names
from cmf_mj.linear_models import closed_loop, dcl_state_space, hardware_velocity
from cmf_mj.published import published_results

OMEGA = 2.0 * np.pi * np.linspace(0.05, 8.0, 4000)

TABLE_4_1 = {int(row.of[-1]): row for row in published_results() if row.of.startswith("linear_")}


@pytest.mark.parametrize("number", [1, 2, 3])
def test_table_4_1_follows_from_published_gains_without_a_free_parameter(number: int) -> None:
    """Table 2-5 around Eqs 4.12, 4.15, 4.18 gives Table 4-1 within 0.03 Hz."""
    loop = closed_loop("velocity", hardware_velocity(number))
    found = bandwidths(control.frequency_response(loop, OMEGA))
    printed = TABLE_4_1[number]
    assert found.phase_hz == pytest.approx(printed.phase_bandwidth_hz, abs=0.03)
    assert found.gain_hz == pytest.approx(printed.gain_bandwidth_hz, abs=0.03)


def test_state_space_of_the_loop_equals_its_block_algebra() -> None:
    """G = z^-1 P H_r / (1 - z^-1 P H_p - z^-1 V H_v), blocks evaluated one by one.

    A held plant is the sum of its aliases, (1 - z^-1) / T * sum G(s_k) / s_k over
    s_k = j (w + 2 pi k / T): an oracle without polynomials or state space. The velocity's direct
    term passes the hold unchanged; summed, it would read the middle of each jump.
    """
    velocity = hardware_velocity(1)
    omega = OMEGA[::40]
    loop = control.frequency_response(closed_loop("velocity", velocity), omega)
    z = np.exp(1j * omega / 2048.0)
    s = 1j * (omega[:, None] + 2.0 * np.pi * 2048.0 * np.arange(-3000, 3001))
    aliases = velocity(s.ravel()).reshape(s.shape) / s
    direct = 0.002907
    speed = direct + (1.0 - 1.0 / z) * 2048.0 * (aliases - direct / s).sum(axis=1)
    position = (1.0 - 1.0 / z) * 2048.0 * (aliases / s).sum(axis=1)
    feedback = (381.8 - 37.1759 / (z - 0.914)) * position - 2.3 * speed
    expected = (47.0 * position / z) / (1.0 - feedback / z)
    np.testing.assert_allclose(loop.frdata[0, 0], expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("law", "gain"), [("original", 0.998), ("original_as_printed", 0.166), ("velocity", 0.931)]
)
def test_dc_gain_of_laws_without_integral(law: str, gain: float) -> None:
    """21.91/21.95, the misprint's 0.166, and 47/50.48 = 0.931."""
    loop = closed_loop(law, hardware_velocity(1))
    low = control.frequency_response(loop, [1e-3])
    assert abs(low.frdata[0, 0, 0]) == pytest.approx(gain, abs=0.001)


def test_original_law_with_corrected_b_reaches_the_hardware_rows() -> None:
    """With B = 0.1079 the three fits give 1.75 to 1.85 and 2.07 to 2.31 Hz; hardware 1.8, 2.4."""
    for number in (1, 2, 3):
        loop = closed_loop("original", hardware_velocity(number))
        found = bandwidths(control.frequency_response(loop, OMEGA))
        assert 1.74 < found.phase_hz < 1.85
        assert 2.06 < found.gain_hz < 2.32


@pytest.mark.parametrize("law", law_names())
def test_position_reaches_the_command_with_the_published_dc_gain(law: str) -> None:
    """Position to command at zero frequency is -21.95 (original) or -50.48 %/in, integral aside."""
    system = dcl_state_space(law)
    keep = [0, 2, 3, 4]  # all states but the integral, which has no DC gain
    a = np.asarray(system.A)[np.ix_(keep, keep)]
    b = np.asarray(system.B)[keep, 1]
    c = np.asarray(system.C)[0, keep]
    gain = float(np.asarray(system.D)[0, 1] + c @ np.linalg.solve(np.eye(4) - a, b))
    expected = {
        "original": -149.8 * 0.1079 / 0.086 + 166.0,
        "original_as_printed": -149.8 * 0.1709 / 0.086 + 166.0,
    }.get(law, -37.1759 / 0.086 + 381.8)
    assert gain * 100.0 * 0.0254 == pytest.approx(expected, rel=1e-9)


def test_bad_model_number_and_delay_are_named() -> None:
    with pytest.raises(ValueError, match="number: 4 is not one of 1, 2, 3"):
        hardware_velocity(4)
    with pytest.raises(ValueError, match="command_delay: 0 frames must be at least 1"):
        closed_loop("velocity", hardware_velocity(1), command_delay=0)
