"""Servo electronics: converter, switches, clamp and rate limiter, each by its arithmetic."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cmf_mj.electronics import servo_electronics as servo

INCH = 0.0254
SHIPPED = servo.make_servo_electronics()
FREE = SHIPPED._replace(velocity_clamp=1.0, change=1e9, quantum=0.0)


def run(electronics: servo.ServoElectronics, command, position=None, raised=True, state=None):
    """Volts, valve commands (N, n) and whether tripped (N,) of histories (N, n)."""
    command = np.array(command, dtype=float)
    where = np.zeros(command.shape) if position is None else np.array(position, dtype=float)
    state = state or servo.start(command.shape[1])
    volts = np.reshape([servo.convert(electronics, u)[1] for u in command.ravel()], command.shape)
    rows = zip(command, where, strict=True)
    tripped = [servo.step(electronics, state, raised, *row) for row in rows]
    return volts, command, np.array(tripped)


# Converter


@pytest.mark.parametrize(
    ("command", "counts"),
    [(0.0, 0), (1.0, 32767), (-1.0, -32768), (0.5, 16384), (1e-5, 0), (1.6e-5, 1), (7.0, 32767)],
)
def test_sixteen_bits_over_ten_volts(command, counts):
    """q = 20 V / 65536 = 305.18 microvolts; +100 % saturates one count below full scale."""
    found, volts = servo.convert(SHIPPED, command)
    assert found == counts
    assert volts == pytest.approx(counts * 20.0 / 65536, rel=1e-15)


@given(st.floats(-0.999, 0.999), st.integers(4, 24))
def test_quantisation_is_within_half_a_count(command, bits):
    electronics = SHIPPED._replace(quantum=20.0 / 2**bits)
    counts, volts = servo.convert(electronics, command)
    assert counts == int(counts)
    top = 10.0 - electronics.quantum
    assert abs(volts - min(10.0 * command, top)) <= 0.5 * electronics.quantum * (1 + 1e-12)


def test_quantisation_noise_is_that_of_a_uniform_error():
    """q / sqrt(12) rms over commands spread across many counts; 5e4 samples know it to 0.5 %."""
    electronics = SHIPPED._replace(quantum=20.0 / 2**12)
    commands = np.random.default_rng(3).uniform(-0.9, 0.9, 50_000)
    error = [servo.convert(electronics, u)[1] - 10.0 * u for u in commands]
    assert np.std(error) == pytest.approx(electronics.quantum / np.sqrt(12.0), rel=0.015)


def test_range_below_full_command_saturates():
    """5 V of range for 10 V of full command: half the command is left."""
    electronics = FREE._replace(dac_range=5.0)
    volts, valve, _ = run(electronics, [[0.4, 0.6, -0.9]])
    np.testing.assert_allclose(volts, [[4.0, 5.0, -5.0]], rtol=1e-15)
    np.testing.assert_allclose(valve, [[0.4, 0.5, -0.5]], rtol=1e-15)


def test_a_command_that_is_no_number_closes_the_valve():
    volts, valve, _ = run(FREE, [[np.nan, np.inf, -np.inf]])
    np.testing.assert_array_equal(volts, [[0.0, 10.0, -10.0]])
    np.testing.assert_array_equal(valve, [[0.0, 1.0, -1.0]])


# Clamp and rate limiter


def test_velocity_clamp():
    commands = [[0.5, 0.9, 0.95, -1.0]]
    _, valve, _ = run(FREE._replace(velocity_clamp=0.9), commands)
    np.testing.assert_allclose(valve, [[0.5, 0.9, 0.9, -0.9]], rtol=1e-15)


def test_rate_limiter_ramps_at_its_rate():
    """2000 %/s: 0.9766 % a frame; 90 % take 92.16 frames, and as many back and through zero."""
    commands = np.repeat([[1.0], [-1.0]], 250, axis=0)
    _, valve, _ = run(SHIPPED._replace(quantum=0.0), commands)
    frames = np.arange(1, 251)
    up = np.minimum(frames * 20.0 / 2048, 0.9)
    np.testing.assert_allclose(valve[:250, 0], up, rtol=1e-12)
    np.testing.assert_allclose(valve[250:, 0], np.maximum(0.9 - frames * 20.0 / 2048, -0.9))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 1000), st.floats(1e-3, 1.0), st.floats(0.1, 1.0))
def test_clamp_and_rate_hold_for_any_command(seed, change, clamp):
    rng = np.random.default_rng(seed)
    commands = rng.standard_cauchy((100, 2))
    positions = rng.normal(0.0, 0.4, (100, 2))
    electronics = SHIPPED._replace(change=change, velocity_clamp=clamp)
    _, valve, _ = run(electronics, commands, positions)
    assert np.abs(valve).max() <= clamp
    assert np.abs(np.diff(valve, axis=0, prepend=0.0)).max() <= change * (1 + 1e-12)


# Limit switches


@pytest.mark.parametrize(("side", "sign"), [(0, -1.0), (1, 1.0)])
def test_a_passed_switch_stays_tripped_until_reset(side, sign):
    """37.7 in: the command of all legs goes to nothing at the limiter's rate and stays there."""
    state = servo.start(3)
    positions = np.zeros((600, 3))
    positions[200:210, 1] = sign * 37.71 * INCH
    volts, valve, tripped = run(SHIPPED, np.full((600, 3), 0.5), positions, state=state)
    np.testing.assert_array_equal(tripped, np.arange(600) >= 200)
    assert np.argwhere(state.tripped).tolist() == [[1, side]]
    assert np.allclose(volts, 5.0)
    assert (valve[199] == 0.5).all() and not valve[252:].any()
    assert np.abs(np.diff(valve, axis=0)).max() <= 20.0 / 2048 * (1 + 1e-12)
    servo.reset(state)
    _, valve, tripped = run(SHIPPED, np.full((100, 3), 0.5), state=state)
    assert not tripped.any() and (valve[-1] == 0.5).all()


def test_reset_on_a_passed_switch_trips_again():
    state = servo.start(1)
    run(SHIPPED, [[0.0]], [[1.0]], state=state)
    servo.reset(state)
    assert run(SHIPPED, [[0.0]], [[1.0]], state=state)[2].all()


def test_lower_switches_are_watched_in_the_air_only():
    """The legs lie on the stops at -38 in; the upper ones are always watched."""
    low, high = [[-38.0 * INCH]], [[38.0 * INCH]]
    assert not run(SHIPPED, [[0.3]], low, raised=False)[2].any()
    assert run(SHIPPED, [[0.3]], low, raised=True)[2].all()
    assert run(SHIPPED, [[0.3]], high, raised=False)[2].all()
    assert not run(SHIPPED, [[0.3]] * 2, [[37.69 * INCH], [-37.69 * INCH]])[2].any()


def test_a_position_that_is_no_number_trips():
    assert run(SHIPPED, [[0.3]], [[np.nan]])[2].all()


# Settings


def test_settings_are_assumed_and_own_ones_replace_them(tmp_path):
    shipped = servo.load_servo_settings()
    assert {getattr(shipped, name).status for name in type(shipped).model_fields} == {"assumed"}
    path = tmp_path / "mine.toml"
    path.write_text("dac_bits = {value = 0}\nrate_limit = {value = 500.0}\n")
    mine = servo.make_servo_electronics(servo.load_servo_settings(path))
    assert mine.quantum == 0.0
    assert mine.change == pytest.approx(5.0 / 2048)
    assert mine.switch_position == SHIPPED.switch_position
