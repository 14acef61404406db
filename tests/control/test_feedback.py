"""Feedback of the DCL: gravity known by its own kinematics."""

import numpy as np

from cmf_mj.control.feedback import find_gravity
from cmf_mj.machine import kinematics
from cmf_mj.machine.gravity import axial_gravity, leg_axes_state, make_leg_axes

AXES = make_leg_axes()
POSE = np.array([0.2, -0.1, 0.3, 0.05, -0.1, 0.2])


def test_what_legs_at_rest_feel_is_known() -> None:
    legs = kinematics.pose_to_legs(POSE)
    state = leg_axes_state(AXES, legs)
    expected, gravity = axial_gravity(POSE), np.zeros(6)
    assert expected.min() > 7.0
    find_gravity(AXES, state, legs, gravity)
    np.testing.assert_allclose(gravity, expected, rtol=0.0, atol=1e-9)


def test_in_motion_too() -> None:
    """The pose follows the measured legs."""
    state = leg_axes_state(AXES, np.zeros(6))
    for share in np.linspace(0.0, 1.0, 1024):
        legs = kinematics.pose_to_legs(share * POSE)
        gravity = np.zeros(6)
        find_gravity(AXES, state, legs, gravity)
        np.testing.assert_allclose(gravity, axial_gravity(share * POSE), rtol=0.0, atol=1e-3)
