"""Feedback of the DCL: gravity taken out by its own kinematics."""

import numpy as np
import pytest

from cmf_mj import kinematics
from cmf_mj.control.feedback import (
    compensate_gravity,
    gravity_compensation_state,
    make_gravity_compensation,
)
from cmf_mj.gravity import axial_gravity

POSE = np.array([0.2, -0.1, 0.3, 0.05, -0.1, 0.2])


def test_a_leg_at_rest_reads_nothing() -> None:
    compensation = make_gravity_compensation(enabled=True)
    legs = kinematics.pose_to_legs(POSE)
    state = gravity_compensation_state(compensation, legs)
    acceleration = axial_gravity(POSE)
    assert acceleration.min() > 7.0
    compensate_gravity(compensation, state, legs, acceleration)
    np.testing.assert_allclose(acceleration, 0.0, rtol=0.0, atol=1e-9)


def test_what_is_not_gravity_is_left() -> None:
    """In motion too: the pose follows the measured legs."""
    compensation = make_gravity_compensation(enabled=True)
    state = gravity_compensation_state(compensation, np.zeros(6))
    for share in np.linspace(0.0, 1.0, 1024):
        legs = kinematics.pose_to_legs(share * POSE)
        acceleration = axial_gravity(share * POSE) + 1.5
        compensate_gravity(compensation, state, legs, acceleration)
        np.testing.assert_allclose(acceleration, 1.5, rtol=0.0, atol=1e-3)


def test_off_leaves_the_bits_of_any_number_of_legs() -> None:
    compensation = make_gravity_compensation(enabled=False)
    state = gravity_compensation_state(compensation, np.zeros(2))
    acceleration = np.array([-0.0, 9.1])
    compensate_gravity(compensation, state, np.zeros(2), acceleration)
    assert acceleration.tobytes() == np.array([-0.0, 9.1]).tobytes()


def test_refusals() -> None:
    compensation = make_gravity_compensation(enabled=True)
    with pytest.raises(ValueError, match=r"shape is \(2,\)"):
        gravity_compensation_state(compensation, np.zeros(2))
