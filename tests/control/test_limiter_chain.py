"""Pose limits, demand, operating states and leg limits in a row: what they pass and cut back.

That the leg reference keeps its limits whatever host and operator do is asked behind the DCU, in
`tests/facility/test_front.py`.
"""

import numpy as np
from shared import WORKING_STROKE

from cmf_mj.control import demand, limiter, states
from cmf_mj.control.states import State
from cmf_mj.core.compiled import allocating
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import load_machine

T = 1.0 / 2048.0
POSE = limiter.make_pose_limiter()
LEGS = limiter.make_leg_limiter()
GEOMETRY = load_machine().geometry
STATES = states.make_states()


@allocating
def _run(pose_limits, pose_state, parameters, machine, machine_state, leg_limits, leg_state,
         pose, velocity, acceleration, out, codes):  # fmt: skip
    host, reference, motion = np.zeros((3, 6)), np.zeros((3, 6)), np.zeros((3, 6))
    measured = leg_state.position.copy()
    for k in range(codes.size):
        motion[0], motion[1], motion[2] = pose[k], velocity[k], acceleration[k]
        limiter.step(pose_limits, pose_state, motion)
        demand.step(parameters, motion, host)
        codes[k] = states.step(machine, machine_state, 0, host, measured, reference)
        limiter.step(leg_limits, leg_state, reference)
        out[:, k] = reference
        measured[:] = out[0, k]


def run(pose, velocity=None, acceleration=None):
    """Leg reference with its rates (3, N, 6) and operating states (N,), engaged from the start."""
    frames = len(pose)
    rates = [
        np.full((frames, 6), np.nan) if given is None else given.copy()
        for given in (velocity, acceleration)
    ]
    pose_state = limiter.start(POSE, pose[0])
    legs = pose_to_legs(pose_state.position)
    out, codes = np.zeros((3, frames, 6)), np.zeros(frames, int)
    _run(
        POSE, pose_state, GEOMETRY, STATES, states.start(STATES, State.ENGAGED, legs), LEGS,
        limiter.start(LEGS, legs), pose, *rates, out, codes,
    )  # fmt: skip
    return out, codes


def check_limits(out):
    """Differences of the reference; slack as in the limiter's own tests."""
    assert np.isfinite(out).all()
    assert np.abs(out[0]).max() <= WORKING_STROKE
    velocity = np.diff(out[0], axis=0) / T
    slack = 8 * np.finfo(float).eps / T
    assert np.abs(velocity).max() <= LEGS.velocity[0] * (1 + 1e-12) + slack
    acceleration = np.diff(velocity, axis=0) / T
    assert np.abs(acceleration).max() <= LEGS.acceleration[0] * (1 + 1e-12) + slack / T
    assert np.abs(out[1]).max() <= LEGS.velocity[0]
    assert np.abs(out[2]).max() <= LEGS.acceleration[0]


def test_an_admissible_host_reaches_the_legs_unchanged():
    """Engaged, all six degrees of freedom moving: demand block alone, to the bit."""
    rates = np.array([1.1, 1.3, 1.7, 0.9, 1.5, 2.1])
    size = np.array([0.1, 0.1, 0.08, 0.04, 0.03, 0.05])
    phase = np.outer(T * np.arange(6144), rates)
    s = np.clip(T * np.arange(6144) / 0.5, 0.0, 1.0)[:, None]
    fade = s**3 * (10 - 15 * s + 6 * s * s)
    pose = size * np.sin(phase) * fade
    velocity, acceleration = np.gradient(pose, T, axis=0), -size * rates**2 * np.sin(phase) * fade
    out, codes = run(pose, velocity, acceleration)
    expected, legs = np.zeros((3, 6144, 6)), np.zeros((3, 6))
    for k in range(6144):
        demand.step(GEOMETRY, np.array([pose[k], velocity[k], acceleration[k]]), legs)
        expected[:, k] = legs
    assert np.abs(expected[1]).max() > 0.5 * LEGS.velocity[0]
    np.testing.assert_array_equal(out, expected)
    assert (codes == State.ENGAGED).all()


def test_poses_possible_each_alone_are_cut_back_together():
    """Heave up and surge to their operational limits at once ask for legs beyond their travel."""
    pose = np.zeros((8192, 6))
    pose[1:, 0], pose[1:, 2] = 1.7, -1.04
    assert pose_to_legs(pose[-1]).max() > WORKING_STROKE + 0.1
    out, _ = run(pose)
    assert np.abs(out[0]).max() == WORKING_STROKE
    assert not out[1, -1].any()
