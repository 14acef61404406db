"""Velocities and accelerations between platform and legs, against differences of the positions."""

import numpy as np

from cmf_mj import pose_to_legs
from cmf_mj.machine.leg_motion import leg_motion_to_pose, pose_motion_to_legs

RATE = np.array([0.4, -0.3, 0.5, 0.35, -0.25, 0.3])
SIZE = np.array([0.3, 0.25, 0.2, 0.2, 0.15, 0.25])


def pose(t: np.ndarray) -> np.ndarray:
    """A large motion in all degrees of freedom at once."""
    return SIZE * np.sin(np.outer(t, 2.0 + RATE) + RATE)


def velocity(t: np.ndarray) -> np.ndarray:
    return SIZE * (2.0 + RATE) * np.cos(np.outer(t, 2.0 + RATE) + RATE)


def acceleration(t: np.ndarray) -> np.ndarray:
    return -((2.0 + RATE) ** 2) * pose(t)


TIMES = np.linspace(0.0, 6.0, 50)


def test_leg_motion_is_the_derivative_of_the_legs() -> None:
    """Fourth-order central differences with 1 ms: error h^4 x^(5)/30, 1e-11 m/s; round-off of the
    second difference, 4 m x 1e-16 / h^2 x 16/3, 2e-9 m/s^2."""
    h = 1e-3
    legs = [pose_to_legs(pose(TIMES + k * h)) for k in (-2, -1, 0, 1, 2)]
    first = (legs[0] - 8 * legs[1] + 8 * legs[3] - legs[4]) / (12 * h)
    second = (-legs[0] + 16 * legs[1] - 30 * legs[2] + 16 * legs[3] - legs[4]) / (12 * h * h)
    found = pose_motion_to_legs(pose(TIMES), velocity(TIMES), acceleration(TIMES))
    np.testing.assert_allclose(found.velocity, first, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.acceleration, second, rtol=0, atol=1e-8)


def test_motion_of_platform_and_legs_are_inverse() -> None:
    legs = pose_motion_to_legs(pose(TIMES), velocity(TIMES), acceleration(TIMES))
    back = leg_motion_to_pose(pose(TIMES), *legs)
    np.testing.assert_allclose(back.velocity, velocity(TIMES), rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.acceleration, acceleration(TIMES), rtol=0, atol=1e-11)


def test_a_turning_platform_accelerates_its_legs_at_constant_rate() -> None:
    """The term the Jacobian alone misses: yaw at 1 rad/s, no acceleration, off-neutral."""
    still = np.zeros(6)
    turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    found = pose_motion_to_legs(0.1 * turn, turn, still)
    assert np.abs(found.acceleration).min() > 0.1
