"""Specific force and acceleration, centre of gravity and pilot's station."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cmf_mj import Hexapod, signals, simulate
from cmf_mj.facility.host.stream import make_stream
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.kinematics import rotation
from cmf_mj.pilot.motion import PilotMotion, at_lever_arm, gravity_in_body

G = 9.80665
LEVEL = np.zeros((1, 3))


def test_level_rest_reads_one_g_upwards_and_free_fall_nothing():
    rest = PilotMotion(np.zeros(1), LEVEL - gravity_in_body(LEVEL), LEVEL, LEVEL)
    np.testing.assert_array_equal(rest.specific_force, [[0.0, 0.0, -G]])
    np.testing.assert_array_equal(rest.acceleration, LEVEL)
    fall = PilotMotion(np.zeros(1), LEVEL, LEVEL, LEVEL)
    np.testing.assert_array_equal(fall.acceleration, [[0.0, 0.0, G]])


def test_pitched_on_the_ground_it_feels_a_push_in_the_back():
    pitched = gravity_in_body(np.array([[0.0, np.radians(10.0), 0.3]]))
    expected = [[G * np.sin(np.radians(10.0)), 0.0, -G * np.cos(np.radians(10.0))]]
    np.testing.assert_allclose(-pitched, expected, rtol=1e-15)
    banked = gravity_in_body(np.array([np.radians(30.0), 0.0, 1.0]))
    np.testing.assert_allclose(banked, rotation(np.radians(30.0), 0.0, 1.0).T @ [0.0, 0.0, G])


def test_pilot_ahead_of_the_centre_of_gravity():
    """Pitch acceleration lifts the nose, -q' x; a steady pitch rate pulls inwards, -q^2 x. The
    error of taking the centre of gravity for the pilot is the whole of it."""
    rate, change = np.array([[0.0, 0.2, 0.0]]), np.array([[0.0, 0.1, 0.0]])
    moved = at_lever_arm(rate, change, np.array([20.0, 0.0, -3.0]))
    expected = [[0.1 * -3.0 - 0.04 * 20.0, 0.0, -0.1 * 20.0 + 0.04 * 3.0]]
    np.testing.assert_allclose(moved, expected, rtol=1e-14)


def test_coordinated_turn_has_no_side_force():
    """Bank 30 deg at turn rate g tan(bank) / V: f = (0, 0, -g / cos(bank)) in body axes."""
    bank, speed = np.radians(30.0), 120.0
    turn = G * np.tan(bank) / speed
    # Inertial acceleration points to the right, speed times turn rate; in body axes:
    acceleration = rotation(bank, 0.0, 0.0).T @ [0.0, speed * turn, 0.0]
    felt = acceleration - gravity_in_body(np.array([bank, 0.0, 0.0]))
    np.testing.assert_allclose(felt, [0.0, 0.0, -G / np.cos(bank)], atol=1e-14)


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth platform motion in all degrees of freedom with its derivatives."""
    rates = np.array([1.0, 1.3, 0.7, 1.1, 0.9, 1.7])
    sizes = np.array([0.4, 0.3, 0.2, 0.3, 0.25, 0.4])
    phase = np.outer(time, rates) + np.arange(6.0)
    return (
        sizes * np.sin(phase),
        sizes * rates * np.cos(phase),
        -sizes * rates**2 * np.sin(phase),
    )


def test_motion_on_the_platform_against_differenced_positions():
    """Positions of the station differenced twice in inertial axes; error of the order step^2."""
    step, arm = 1e-3, np.array([0.6, 0.2, -2.3])
    time = 1.0 + step * np.arange(-2, 3)
    pose, velocity, acceleration = motion(time)
    result = PilotMotion.from_platform(make_stream(time, pose, velocity, acceleration), arm)
    turn = np.array([rotation(*row[3:]) for row in pose])
    place = pose[:, :3] + turn @ arm
    inertial = (place[3] - 2 * place[2] + place[1]) / step**2 - [0.0, 0.0, G]
    np.testing.assert_allclose(result.specific_force[2], turn[2].T @ inertial, atol=1e-5)
    # Angular velocity of the rotation matrix itself.
    turned = Rotation.from_matrix(turn[1].T @ turn[3]).as_rotvec() / (2 * step)
    np.testing.assert_allclose(result.angular_rate[2], turned, atol=1e-6)
    np.testing.assert_allclose(result.attitude, pose[:, 3:])


def test_record_of_a_run_agrees_with_the_platforms_own_motion():
    """MuJoCo's crew accelerometer against the rigid-body formula on the differentiated pose."""
    command = signals.sine("pitch", np.radians(2.0), 1.0, cycles=2.0)
    record = simulate(Hexapod(), "velocity", command)
    felt = PilotMotion.from_record(record)
    pose = record["platform_pose"]
    step = 1.0 / 2048.0
    velocity = np.gradient(pose, step, axis=0)
    acceleration = (pose[2:] - 2 * pose[1:-1] + pose[:-2]) / step**2
    stream = make_stream(record.time[1:-1], pose[1:-1], velocity[1:-1], acceleration)
    computed = PilotMotion.from_platform(stream, load_cab().station)
    np.testing.assert_allclose(felt.time[1:-1], record.time[1:-2], atol=1e-12)
    inside = slice(200, -200)
    apart = felt.specific_force[1:][: computed.time.size] - computed.specific_force
    swing = np.ptp(computed.specific_force[inside, 0])
    assert swing > 1.0
    assert np.abs(apart[inside]).max() < 0.01 * swing
    turning = felt.angular_rate[1:][: computed.time.size] - computed.angular_rate
    assert np.abs(turning[inside]).max() < 0.01 * np.ptp(computed.angular_rate[:, 1])


def test_resampling_keeps_straight_lines():
    time = np.arange(11) / 10.0
    line = np.outer(time, [1.0, -2.0, 3.0])
    finer = PilotMotion(time, line, line, line).resampled(80.0)
    assert finer.time.size == 81
    np.testing.assert_allclose(finer.attitude, np.outer(finer.time, [1.0, -2.0, 3.0]), atol=1e-14)


def test_refusals_name_the_field():
    zero = np.zeros((2, 3))
    with pytest.raises(ValueError, match="time: row 1"):
        PilotMotion(np.array([1.0, 1.0]), zero, zero, zero)
    with pytest.raises(ValueError, match=r"attitude: shape is \(1, 3\)"):
        PilotMotion(np.array([0.0, 1.0]), zero, zero, zero[:1])
    with pytest.raises(ValueError, match=r"specific_force\[1, 0\]: nan is not a finite number"):
        PilotMotion(np.array([0.0, 1.0]), zero + [[0.0], [np.nan]], zero, zero)
    with pytest.raises(ValueError, match="lever_arm"):
        at_lever_arm(zero, zero, [1.0])
    uneven = PilotMotion(np.array([0.0, 1.0, 3.0]), *np.zeros((3, 3, 3)))
    with pytest.raises(ValueError, match="intervals"):
        _ = uneven.rate
