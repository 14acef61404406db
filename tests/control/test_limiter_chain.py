"""Pose limits, demand, operating states and leg limits in a row: whatever the host and operator do.

The leg reference that reaches the error block stays within position, velocity and acceleration at
2048 Hz, and is the host's own where the host asks for nothing else.
"""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from shared import WORKING_STROKE

from cmf_mj.control import demand, limiter, states
from cmf_mj.control.states import Request, State
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
         together, requests, pose, velocity, acceleration, out, codes):  # fmt: skip
    host, reference, motion = np.zeros((3, 6)), np.zeros((3, 6)), np.zeros((3, 6))
    measured = leg_state.position.copy()
    base, wish = np.zeros(6), np.zeros(6)
    for k in range(requests.size):
        motion[0], motion[1], motion[2] = pose[k], velocity[k], acceleration[k]
        limiter.step(pose_limits, pose_state, motion)
        demand.step(parameters, motion, host)
        codes[k] = states.step(machine, machine_state, requests[k], host, measured, reference)
        if together:
            limiter.step_together(leg_limits, leg_state, reference, base, wish)
        else:
            limiter.step(leg_limits, leg_state, reference)
        out[:, k] = reference
        measured[:] = out[0, k]


def run(code, requests, pose, velocity=None, acceleration=None, together=False):
    """Leg reference with its rates (3, N, 6) and operating states (N,)."""
    frames = len(requests)
    rates = [
        np.full((frames, 6), np.nan) if given is None else given.copy()
        for given in (velocity, acceleration)
    ]
    pose_state = limiter.start(POSE, pose[0])
    legs = pose_to_legs(pose_state.position)
    if code in (State.OFF, State.SETTLED):
        legs = np.full(6, -WORKING_STROKE)
    out, codes = np.zeros((3, frames, 6)), np.zeros(frames, int)
    _run(
        POSE, pose_state, GEOMETRY, STATES, states.start(STATES, code, legs), LEGS,
        limiter.start(LEGS, legs), together, np.asarray(requests, int), pose, *rates, out, codes,
    )  # fmt: skip
    return out, codes


def violence(seed, frames):
    """Pose demands with steps of a metre and a radian, tones to 1 kHz and noise at some time."""
    rng = np.random.default_rng(seed)
    pose = np.zeros((frames, 6))
    for dof in range(6):
        for _ in range(rng.integers(1, 4)):
            a, b = np.sort(rng.integers(0, frames, 2))
            size = rng.choice([0.01, 0.3, 1.0, 3.0]) * rng.uniform(-1, 1)
            kind, time = rng.integers(3), T * np.arange(b - a)
            tone = np.sin(2 * np.pi * 10 ** rng.uniform(-1, 3) * time)
            pose[a:b, dof] += size * (tone, rng.normal(size=b - a), 1.0)[kind]
    return pose


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


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 10**6),
    st.lists(st.tuples(st.sampled_from(list(Request)), st.integers(1, 2048)), max_size=8),
    st.sampled_from([State.OFF, State.SETTLED, State.HOLD, State.ENGAGED]),
    st.booleans(),
)
def test_leg_references_stay_within_limits(seed, sequence, first, together):
    requests = np.repeat(*np.array([*sequence, (Request.NONE, 2048)]).T)
    out, _ = run(first, requests, violence(seed, requests.size), together=together)
    check_limits(out)


def test_an_admissible_host_reaches_the_legs_unchanged():
    """Engaged, all six degrees of freedom moving: demand block alone, to the bit."""
    rates = np.array([1.1, 1.3, 1.7, 0.9, 1.5, 2.1])
    size = np.array([0.1, 0.1, 0.08, 0.04, 0.03, 0.05])
    phase = np.outer(T * np.arange(6144), rates)
    s = np.clip(T * np.arange(6144) / 0.5, 0.0, 1.0)[:, None]
    fade = s**3 * (10 - 15 * s + 6 * s * s)
    pose = size * np.sin(phase) * fade
    velocity, acceleration = np.gradient(pose, T, axis=0), -size * rates**2 * np.sin(phase) * fade
    out, codes = run(State.ENGAGED, np.zeros(6144), pose, velocity, acceleration)
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
    out, _ = run(State.ENGAGED, np.zeros(8192), pose)
    assert np.abs(out[0]).max() == WORKING_STROKE
    assert not out[1, -1].any()
