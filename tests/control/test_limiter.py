"""Limits of legs and degrees of freedom: bounds for ever, demand to the bit, back without wind-up.

Frames are 1/2048 s; v = dp / T and a = dv / T are differences of the output itself. Their round-off
is that of positions of the size of the range: some ulps over T and T^2.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lengths import examples
from shared import WORKING_STROKE

from cmf_mj.control import limiter as block
from cmf_mj.control.limiter import limit_history, make_leg_limiter, make_limiter, make_pose_limiter

T = 1.0 / 2048.0
G = 9.80665
ULP = np.finfo(float).eps


def channel(low=-0.9525, high=0.9525, velocity=0.6, acceleration=8.0, rejoin=0.5):
    return make_limiter([low], [high], [velocity], [acceleration], rejoin)


def column(values):
    return np.asarray(values, dtype=float)[:, None]


def assert_within(limiter, found, start):
    """Positions to the bit; velocity and acceleration to round-off, from rest at `start`."""
    position, low, high = found.position, limiter.low, limiter.high
    assert (position - low).min() >= 0.0 and (high - position).min() >= 0.0
    slack = 8.0 * ULP * np.maximum(np.abs(low), np.abs(high)) / T
    velocity = np.diff(position, axis=0, prepend=start[None]) / T
    assert (np.abs(velocity) - limiter.velocity * (1 + 1e-12) - slack).max() <= 0.0
    acceleration = np.diff(velocity, axis=0, prepend=0.0 * velocity[:1]) / T
    assert (np.abs(acceleration) - limiter.acceleration * (1 + 1e-12) - slack / T).max() <= 0.0
    assert (np.abs(found.velocity) - limiter.velocity).max() <= 0.0
    assert (np.abs(found.acceleration) - limiter.acceleration).max() <= 0.0


@st.composite
def limiters(draw, channels):
    """Limits over three decades, ranges off centre."""
    number = st.floats(0.05, 2.0)
    high = np.array([draw(number) for _ in range(channels)])
    low = -np.array([draw(number) for _ in range(channels)])
    velocity = np.array([draw(st.floats(0.02, 20.0)) for _ in range(channels)])
    acceleration = np.array([draw(st.floats(0.5, 500.0)) for _ in range(channels)])
    return make_limiter(low, high, velocity, acceleration, draw(st.floats(0.05, 1.0)))


@st.composite
def violence(draw, frames=1200):
    """Jumps, ramps, tones up to 1 kHz and noise, of a millimetre to a kilometre."""
    time = T * np.arange(frames)
    demand = np.zeros(frames)
    for _ in range(draw(st.integers(1, 4))):
        size = draw(st.sampled_from([1e-3, 0.1, 1.0, 3.0, 1e3])) * draw(st.floats(-1.0, 1.0))
        at, end = sorted(draw(st.tuples(st.integers(0, frames), st.integers(0, frames))))
        kind = draw(st.sampled_from(["step", "ramp", "tone", "noise"]))
        piece = np.full(frames, size)
        if kind == "ramp":
            piece = size * (time - at * T) * 4.0
        elif kind == "tone":
            piece = size * np.sin(2.0 * np.pi * draw(st.floats(0.1, 1000.0)) * time)
        elif kind == "noise":
            piece = size * np.random.default_rng(draw(st.integers(0, 99))).normal(size=frames)
        demand[at:end] += piece[at:end]
    return demand


# Braking


@settings(deadline=None)
@given(st.floats(1e-9, 10.0), st.floats(0.1, 1000.0))
def test_braking_from_the_stopping_velocity_ends_on_the_limit(room, acceleration):
    """b T, then v - A T each frame while positive, sums to R."""
    velocity = block.stopping_velocity(room, acceleration, T)
    frames = np.arange(int(velocity / (acceleration * T)) + 1)
    assert T * (velocity - acceleration * T * frames).sum() == pytest.approx(room, rel=1e-9)


def test_demand_beyond_the_range_is_met_on_the_limit_at_rest():
    """Speed out of reach: full acceleration to the middle, then braking: 2 sqrt(L / A) seconds."""
    found = limit_history(channel(velocity=50.0), column(np.r_[0.0, np.full(4000, 5.0)])).position[
        :, 0
    ]
    arrived = np.flatnonzero(found == 0.9525)[0]
    assert arrived * T == pytest.approx(2.0 * np.sqrt(0.9525 / 8.0), abs=3 * T)
    assert (found[arrived:] == 0.9525).all() and (np.diff(found) >= 0.0).all()


# Bounds, whatever comes


@pytest.mark.fuzz
@settings(max_examples=examples(150), deadline=None)
@given(limiters(1), violence())
def test_every_limit_holds_for_any_demand(limiter, demand):
    found = limit_history(limiter, column(demand))
    assert_within(limiter, found, np.clip(demand[:1], limiter.low, limiter.high))


@pytest.mark.fuzz
@settings(max_examples=examples(100), deadline=None)
@given(limiters(3), st.lists(violence(600), min_size=3, max_size=3))
def test_every_limit_holds_on_one_scale(limiter, demands):
    demand = np.array(demands).T
    found = limit_history(limiter, demand, together=True)
    assert_within(limiter, found, np.clip(demand[0], limiter.low, limiter.high))
    assert (found.share >= 0.0).all() and (found.share <= 1.0).all()


@pytest.mark.parametrize("together", [False, True])
def test_infinities_and_nan_move_no_limit(together):
    """NaN repeats the last demand, infinities are the range's far side."""
    limiter = make_leg_limiter(legs=2)
    demand = np.zeros((6000, 2))
    demand[100:3000] = [np.inf, -1e308]
    demand[3000:] = np.nan
    finite = np.where(np.isinf(demand), 1e9, demand)
    finite[3000:] = finite[2999]
    found, other = (limit_history(limiter, d, together=together) for d in (demand, finite))
    assert_within(limiter, found, np.zeros(2))
    np.testing.assert_array_equal(found.position, other.position)
    np.testing.assert_array_equal(found.position[-1], [WORKING_STROKE, -WORKING_STROKE])


def test_demanded_rates_out_of_range_are_clamped_beside_an_admissible_position():
    limiter = make_leg_limiter(legs=3)
    rates = np.array([[9.0, -0.1, np.nan]])
    found = limit_history(limiter, np.full((1, 3), 0.2), rates, np.array([[-50.0, 1.0, 1.0]]))
    speed, limit = limiter.velocity[0], limiter.acceleration[0]
    np.testing.assert_array_equal(found.velocity, [[speed, -0.1, 0.0]])
    np.testing.assert_array_equal(found.acceleration, [[-limit, 1.0, 0.0]])


# Pass-through


@pytest.mark.fuzz
@settings(max_examples=examples(100), deadline=None)
@given(
    limiters(2),
    st.lists(st.tuples(st.floats(0.05, 60.0), st.floats(0.0, 6.3)), min_size=1, max_size=5),
    st.booleans(),
)
def test_admissible_demands_pass_to_the_bit(limiter, tones, together):
    """Sums of tones scaled to 0.7 of the range, 0.9 of the speed and acceleration, faded in over
    0.3 s from rest at zero: nothing is changed, nothing late."""
    time = T * np.arange(2048)
    s = np.clip(time / 0.3, 0.0, 1.0)
    fade = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    wave = sum(np.sin(2.0 * np.pi * f * time + phase) for f, phase in tones) * fade
    first = np.diff(wave, prepend=0.0) / T
    second = np.diff(first, prepend=0.0) / T
    demand = np.empty((time.size, 2))
    for i in range(2):
        least = min(limiter.high[i], -limiter.low[i])
        scale = min(
            0.7 * least / np.abs(wave).max(),
            0.9 * limiter.velocity[i] / np.abs(first).max(),
            0.9 * limiter.acceleration[i] / np.abs(second).max(),
        )
        # Braking in proportion to the other channel needs its room as well.
        scale = min(scale, 0.1 * least * limiter.acceleration.min() / limiter.velocity.max() ** 2)
        demand[:, i] = scale * wave
    rates = np.gradient(demand, T, axis=0)
    found = limit_history(limiter, demand, rates, 0.5 * rates, together=together)
    np.testing.assert_array_equal(found.position, demand)
    np.testing.assert_array_equal(
        found.velocity, np.clip(rates, -limiter.velocity, limiter.velocity)
    )
    assert (found.share == 1.0).all()


def test_a_demand_on_the_limits_passes():
    """Full acceleration, full speed, full braking on to the limit: d - p below 1e-12 m."""
    limiter = channel()
    profile = limit_history(limiter, column(np.r_[0.0, np.full(6000, 0.9525)])).position
    again = limit_history(limiter, profile).position
    np.testing.assert_allclose(again, profile, rtol=0, atol=1e-12)


# Back to the demand


def longest_return(limiter, speed):
    """Frames: brake, cross the range with the speed left over, brake."""
    span = (limiter.high - limiter.low).max()
    slow, weak = limiter.velocity.min(), limiter.acceleration.min() * limiter.rejoin
    return int((3.0 * slow / weak + 2.0 * span / (slow - speed)) / T) + 50


@pytest.mark.fuzz
@settings(max_examples=examples(60), deadline=None)
@given(violence(), st.floats(-0.9, 0.9), st.floats(0.2, 1.0), st.booleans())
def test_a_held_demand_is_rejoined_in_finite_time(demand, hold, rejoin, together):
    """Whatever came before: no wind-up, equal to the bit at the end, and no chatter: from there no
    frame moves. Coming in, the acceleration changes sign at most thrice."""
    limiter = channel(rejoin=rejoin)
    frames = longest_return(limiter, 0.0)
    whole = np.r_[demand, np.full(frames, hold)]
    found = limit_history(limiter, column(whole), together=together)
    tail = found.position[demand.size :, 0]
    arrived = np.flatnonzero(tail == hold)
    assert arrived.size and (tail[arrived[0] + 3 :] == hold).all()
    acceleration = np.diff(tail, 2) / T**2
    signs = np.sign(acceleration[np.abs(acceleration) > 1e-3 * limiter.acceleration])
    assert np.count_nonzero(np.diff(signs)) <= 3


@pytest.mark.fuzz
@settings(max_examples=examples(60), deadline=None)
@given(violence(), st.floats(0.1, 2.0), st.floats(0.0, 6.3))
def test_a_moving_demand_is_rejoined_in_finite_time(demand, frequency, phase):
    """Half the speed and 0.45 of the acceleration, where the other half closes in."""
    limiter = channel(rejoin=0.5)
    omega = 2.0 * np.pi * frequency
    size = min(0.3 / omega, 0.45 * 8.0 / omega**2, 0.9)
    frames = longest_return(limiter, 0.3)
    sine = size * np.sin(omega * T * np.arange(frames + 1000) + phase)
    found = limit_history(limiter, column(np.r_[demand, sine])).position[demand.size :, 0]
    np.testing.assert_array_equal(found[frames:], sine[frames:])


def test_a_step_is_a_trapezoid_of_speed():
    """1 m: A up to V, V, rejoin A down: V / 2A + V / 2rA + D / V seconds, without overshoot."""
    limiter = make_limiter([-2.0], [2.0], [0.6], [8.0], 0.25)
    found = limit_history(limiter, column(np.r_[0.0, np.full(8000, 1.0)])).position[:, 0]
    arrived = np.flatnonzero(found == 1.0)[0] * T
    wanted = 0.6 / (2 * 8.0) + 0.6 / (2 * 2.0) + 1.0 / 0.6
    assert arrived == pytest.approx(wanted, abs=4 * T)
    assert found.max() == 1.0
    acceleration = np.diff(found, 2) / T**2
    assert acceleration.max() == pytest.approx(8.0, rel=1e-6)
    assert acceleration.min() == pytest.approx(-2.0, rel=1e-6)


def test_no_wind_up():
    """A kilometre beyond the limit for 20 s or half a metre for 5 s: the way back is the same."""
    away = [
        np.r_[0.0, np.full(n, size), np.full(4000, 0.1)] for n, size in ((40960, 1e3), (10240, 1.5))
    ]
    back = [limit_history(channel(), column(demand)).position[-4001:] for demand in away]
    assert back[0][0] == back[1][0] == 0.9525
    np.testing.assert_array_equal(back[0], back[1])


def test_a_demand_back_from_beyond_is_met_at_its_own_speed():
    """The output leaves the limit before the demand crosses it and is on it from then, where a
    lone clamp would start from rest: 0.36 m/s at 4 m/s^2 take 90 ms, 184 frames."""
    time = T * np.arange(4 * 8192)
    demand = 0.6 + 0.6 * np.sin(2 * np.pi * 0.06 * time) ** 2
    found = limit_history(channel(), column(demand)).position[:, 0]
    assert found.max() == 0.9525
    crossing = np.flatnonzero((demand[:-1] > 0.9525) & (demand[1:] <= 0.9525))[0] + 1
    assert found[crossing] < 0.9525
    np.testing.assert_array_equal(found[crossing + 184 :][:4000], demand[crossing + 184 :][:4000])


# One scale


def test_on_one_scale_a_step_is_a_straight_line():
    """From rest to rest: p - p0 stays parallel to the demand; alone the short way ends early."""
    limiter = make_leg_limiter()
    target = np.array([0.8, -0.4, 0.1, 0.0, -0.7, 0.33])
    demand = np.vstack([np.zeros(6), np.tile(target, (6000, 1))])
    found = limit_history(limiter, demand, together=True).position
    progress = found @ target / (target @ target)
    np.testing.assert_allclose(found, np.outer(progress, target), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found[-1], target)
    alone = limit_history(limiter, demand).position
    assert np.abs(alone - np.outer(alone @ target / (target @ target), target)).max() > 0.05
    assert np.flatnonzero(np.abs(found - target).max(axis=1) == 0.0)[0] * T == pytest.approx(
        0.8 / 0.6096 + 0.6096 / (2 * 0.8 * G) * 3.0, abs=4 * T
    )


def test_on_one_scale_all_wait_for_the_leg_that_can_go_no_further():
    limiter = make_leg_limiter(legs=2)
    time = T * np.arange(12288)
    demand = np.column_stack([0.3 * time, 0.1 * np.sin(time)])
    demand[8192:] = demand[8192] * [0.5, 1.0]
    found = limit_history(limiter, demand, together=True)
    assert found.position[8191, 0] == pytest.approx(WORKING_STROKE, abs=1e-9)
    assert np.ptp(found.position[7900:8192], axis=0).max() == pytest.approx(0.0, abs=1e-9)
    assert found.share[8191] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_array_equal(found.position[-1], demand[-1])


# Parameters


def test_leg_and_pose_limiters_take_the_shipped_limits():
    legs, pose = make_leg_limiter(), make_pose_limiter()
    np.testing.assert_array_equal(legs.high, WORKING_STROKE)
    np.testing.assert_allclose(legs.velocity, 24 * 0.0254)
    np.testing.assert_allclose(legs.acceleration, 0.8 * G)
    np.testing.assert_allclose(pose.low[:3] / 0.0254, [-55, -55, -41])
    np.testing.assert_allclose(np.degrees(pose.high[3:]), [28, 28, 38])
