"""Feedback of the DCL: gravity known by its own kinematics."""

import numpy as np
import pytest

from cmf_mj.control.feedback import (
    find_gravity,
    gravity_compensation_state,
    make_gravity_compensation,
)
from cmf_mj.machine import kinematics
from cmf_mj.machine.gravity import axial_gravity

POSE = np.array([0.2, -0.1, 0.3, 0.05, -0.1, 0.2])


def test_what_legs_at_rest_feel_is_known() -> None:
    compensation = make_gravity_compensation(enabled=True)
    legs = kinematics.pose_to_legs(POSE)
    state = gravity_compensation_state(compensation, legs)
    expected, gravity = axial_gravity(POSE), np.zeros(6)
    assert expected.min() > 7.0
    find_gravity(compensation, state, legs, gravity)
    np.testing.assert_allclose(gravity, expected, rtol=0.0, atol=1e-9)


def test_in_motion_too() -> None:
    """The pose follows the measured legs."""
    compensation = make_gravity_compensation(enabled=True)
    state = gravity_compensation_state(compensation, np.zeros(6))
    for share in np.linspace(0.0, 1.0, 1024):
        legs = kinematics.pose_to_legs(share * POSE)
        gravity = np.zeros(6)
        find_gravity(compensation, state, legs, gravity)
        np.testing.assert_allclose(gravity, axial_gravity(share * POSE), rtol=0.0, atol=1e-3)


def test_accelerometers_that_feel_none_may_be_any_number() -> None:
    compensation = make_gravity_compensation(enabled=False)
    state = gravity_compensation_state(compensation, np.zeros(2))
    gravity = np.zeros(2)
    find_gravity(compensation, state, np.zeros(2), gravity)
    assert gravity.tobytes() == np.zeros(2).tobytes()


def test_refusals() -> None:
    compensation = make_gravity_compensation(enabled=True)
    with pytest.raises(ValueError, match=r"shape is \(2,\)"):
        gravity_compensation_state(compensation, np.zeros(2))
