"""Appendix C: gravity along the legs."""

import numpy as np
from shared import WORKING_STROKE, axial_gravity

from cmf_mj.machine import kinematics
from cmf_mj.machine.leg_motion import (
    cosine_to_vertical,
    make_pose_tracker,
    track,
    tracked_pose,
)

GRAVITY = 9.80665
INCH = 0.0254


def some_poses(count: int, share: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(5)
    limits = kinematics.excursion_envelope()
    poses = rng.uniform(limits[:, 0], limits[:, 1], (20 * count, 6))
    poses *= share * rng.uniform(size=(20 * count, 1))
    reach = np.abs(kinematics.pose_to_legs(poses)).max(axis=1) < WORKING_STROKE
    assert reach.sum() >= count
    return poses[reach][:count]


def test_lengths_and_directions_are_those_of_the_kinematics() -> None:
    axes = make_pose_tracker()
    for pose in some_poses(20):
        legs = kinematics.pose_to_legs(pose)
        state = tracked_pose(axes, legs)
        np.testing.assert_allclose(state.length - axes.geometry.neutral, legs, rtol=0.0, atol=1e-12)
        jacobian = kinematics.leg_jacobian(pose)
        np.testing.assert_allclose(state.direction, jacobian[:, :3], rtol=0.0, atol=1e-12)


def test_the_tracker_contracts_everywhere_in_the_working_strokes() -> None:
    axes = make_pose_tracker()
    for pose in some_poses(200):
        change = np.eye(6) - axes.inverse @ kinematics.pose_jacobian(pose)
        assert np.abs(np.linalg.eigvals(change)).max() < 0.36


def test_the_tracker_follows_a_fast_motion() -> None:
    """1 Hz in all degrees of freedom, legs at up to 2.6 m/s."""
    time = np.arange(2048) / 2048
    swing = np.array([0.3, -0.25, 0.2, 0.1, -0.12, 0.15])
    poses = np.sin(2 * np.pi * time)[:, None] * swing
    legs = kinematics.pose_to_legs(poses)
    axes = make_pose_tracker()
    state = tracked_pose(axes, legs[0])
    worst = 0.0
    for pose, row in zip(poses, legs, strict=True):
        track(axes, state, row)
        found = np.array([cosine_to_vertical(state, leg) for leg in range(6)])
        worst = max(worst, np.abs(found - axial_gravity(pose) / GRAVITY).max())
    assert 0.0 < worst < 1e-4


def test_the_tracker_survives_nonsense_and_comes_back() -> None:
    axes = make_pose_tracker()
    state = tracked_pose(axes, np.zeros(6))
    for nonsense in (np.full(6, np.nan), np.full(6, 1e9), np.array([9.0, -9, 9, -9, 9, -9])):
        track(axes, state, nonsense)
        assert np.isfinite(state.direction).all()
    for _ in range(60):
        track(axes, state, np.full(6, 0.2))
    np.testing.assert_allclose(state.pose, kinematics.legs_to_pose(np.full(6, 0.2)), atol=1e-12)
