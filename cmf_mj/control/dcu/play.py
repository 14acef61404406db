"""One control frame of the DCU: the demand at the play clock.

    base         the quintic between the two frames around the play clock; a stop where the later
                 one is missing; where derivatives are left aside, the filter of poses
    gap          whenever the base is not where the demand is, the gap in pose, velocity and
                 acceleration is closed on top of the base
    limit        the pose stays within its bound
    line         whole frames of transport

A gap is taken up only if it is within the velocity and acceleration limits; otherwise the demand
goes on to rest, from where every stream can be taken up.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.acceptance import clear_buffer, receive, refuse_candidate, to_real_time
from cmf_mj.control.dcu.motion import (
    ACCELERATION,
    DOF_COUNT,
    POSE,
    VELOCITY,
    add,
    bound_pose,
    close_gap,
    copy,
    evaluate_quintic,
    evaluate_stop,
    fit_quintic,
    smooth_poses,
    subtract,
)
from cmf_mj.control.dcu.state import CAPACITY, Dcu, DcuState
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError

RANGE_SHARE, RANGE_FLOOR = 0.1, 1e-3
"""How far beyond the host's range the demand may be, besides the way to stop: share of the range,
and [m, rad]."""

_STRAY_FRAMES = 20  #: Control frames beyond the host's range that are no fault yet.

CLOCK_DRIFT = 5e-3  #: Drift of clocks that is not worth remembering.


@compiled
def step(dcu, state, demand):  # type: ignore[no-untyped-def]
    """Write the demand (3, 6) of this frame: pose [m, rad], z down, and two derivatives."""
    _begin_next_segment(state)
    _write_base(dcu, state)
    add(state.base, state.gap, state.motion)
    if state.stream[0].is_synchronised and not state.playback[0].on_quintic:
        _rejoin_stream(dcu, state)
    if state.playback[0].is_filtered != state.stream[0].poses_alone:
        # Change between quintics and filter of poses, if the gap between them allows it.
        state.playback[0].is_filtered = state.stream[0].poses_alone
        _write_base(dcu, state)
        if _gap_is_allowed(dcu, state):
            subtract(state.motion, state.base, state.gap)
        else:
            state.playback[0].is_filtered = 1 - state.stream[0].poses_alone
    is_stray = _leaves_range(dcu, state)
    state.playback[0].stray_frames = state.playback[0].stray_frames + 1 if is_stray else 0
    place = state.playback[0].line_place
    bound_pose(dcu, state.motion, state.transport_line[place])
    place = (place + 1) % (dcu.line_frames + 1)
    copy(state.transport_line[place], demand)
    state.playback[0].line_place = place
    _write_line_pose(state)
    smooth_poses(dcu, state.line_pose, state.filtered)
    close_gap(dcu, state.gap)
    played_time = _advance_play_clock(dcu, state)
    state.playback[0].elapsed += played_time if state.playback[0].on_quintic else dcu.frame
    _renew_range(dcu, state)
    _let_waits_expire(dcu, state)


@compiled
def has_strayed(state):  # type: ignore[no-untyped-def]
    """Whether the demand has left the host's range for long enough to be a fault."""
    return state.playback[0].stray_frames > _STRAY_FRAMES


@compiled
def _gap_is_allowed(dcu, state):  # type: ignore[no-untyped-def]
    """Whether base and demand are as near in velocity and acceleration as a gap may be."""
    for row, limit in ((VELOCITY, dcu.velocity), (ACCELERATION, dcu.acceleration)):
        for i in range(DOF_COUNT):
            if abs(state.motion[row, i] - state.base[row, i]) > limit[i]:
                return False
    return True


@compiled
def _leaves_range(dcu, state):  # type: ignore[no-untyped-def]
    """Whether the demand is beyond the poses of the last second, with a share and the way to stop.

    While a gap closes at its speed, the demand on its way belongs to the range.
    """
    present, previous = state.present_range, state.previous_range
    for i in range(DOF_COUNT):
        pose = state.motion[POSE, i]
        if abs(state.gap[POSE, i]) > dcu.gap_range[i]:
            present.lowest[i] = min(present.lowest[i], pose)
            present.highest[i] = max(present.highest[i], pose)
        lowest = min(present.lowest[i], previous.lowest[i])
        highest = max(present.highest[i], previous.highest[i])
        stop_distance = max(present.stop_distance[i], previous.stop_distance[i])
        margin = RANGE_SHARE * (highest - lowest) + stop_distance + RANGE_FLOOR
        if not lowest - margin <= pose <= highest + margin:
            return True
    return False


@compiled
def _drop_oldest(state):  # type: ignore[no-untyped-def]
    """Drop the oldest buffered frame."""
    stream = state.stream[0]
    stream.oldest_place = (stream.oldest_place + 1) % CAPACITY
    stream.buffered_frames -= 1


@compiled
def _has_quintic(state):  # type: ignore[no-untyped-def]
    """Whether the buffer holds a quintic from its oldest frame on."""
    stream = state.stream[0]
    second = (stream.oldest_place + 1) % CAPACITY
    return stream.buffered_frames > 1 and not state.buffer_jump[second]


@compiled
def _plan_quintic(state):  # type: ignore[no-untyped-def]
    """Lay the quintic from the oldest buffered frame to the next; returns its length."""
    oldest = state.stream[0].oldest_place
    second = (oldest + 1) % CAPACITY
    duration = state.buffer_time[second] - state.buffer_time[oldest]
    motions = state.buffer_motion
    fit_quintic(motions[oldest], motions[second], duration, state.polynomial)
    return duration


@compiled
def _begin_next_segment(state):  # type: ignore[no-untyped-def]
    """At the end of a quintic go over to the next, or to the stop from its last frame."""
    playback = state.playback[0]
    while playback.on_quintic and playback.elapsed >= playback.duration:
        playback.elapsed -= playback.duration
        _drop_oldest(state)
        if _has_quintic(state):
            playback.duration = _plan_quintic(state)
        else:
            _stop_from_oldest(state, playback.elapsed)


@compiled
def _stop_from_oldest(state, play_time):  # type: ignore[no-untyped-def]
    """Begin the stop of the oldest buffered frame, its turn a time of the play clock ago [s]."""
    playback = state.playback[0]
    playback.on_quintic, playback.is_stop_of_oldest = 0, 1
    copy(state.buffer_motion[state.stream[0].oldest_place], state.stop_origin)
    to_real_time(state, state.stop_origin)
    playback.elapsed = play_time / (1.0 + state.clock[0].slew)


@compiled
def _write_base(dcu, state):  # type: ignore[no-untyped-def]
    """Write the base at the present time."""
    playback = state.playback[0]
    if playback.is_filtered:
        copy(state.filtered, state.base)
    elif playback.on_quintic:
        evaluate_quintic(state.polynomial, playback.duration, playback.elapsed, state.base)
        to_real_time(state, state.base)
    else:
        evaluate_stop(dcu, state.stop_origin, playback.elapsed, state.base)


@compiled
def _write_line_pose(state):  # type: ignore[no-untyped-def]
    """Write the pose on the straight line between frames, at its end without a later one."""
    playback = state.playback[0]
    if not (playback.on_quintic or playback.is_stop_of_oldest):
        return
    share = playback.elapsed / playback.duration if playback.on_quintic else 0.0
    oldest = state.stream[0].oldest_place
    second = (oldest + 1) % CAPACITY
    for i in range(DOF_COUNT):
        start = state.buffer_motion[oldest, POSE, i]
        change = state.buffer_motion[second, POSE, i] - start if playback.on_quintic else 0.0
        state.line_pose[i] = start + share * change


@compiled
def _rejoin_stream(dcu, state):  # type: ignore[no-untyped-def]
    """Take the stream up again if the buffer says how it goes on and the gap allows it."""
    clock, stream, playback = state.clock[0], state.stream[0], state.playback[0]
    while (
        stream.buffered_frames > 1
        and state.buffer_time[(stream.oldest_place + 1) % CAPACITY] <= clock.time
    ):
        _drop_oldest(state)
        playback.is_stop_of_oldest = 0
    oldest, has_quintic = stream.oldest_place, _has_quintic(state)
    play_time = clock.time - state.buffer_time[oldest]
    is_spent = playback.is_stop_of_oldest and not has_quintic
    if stream.buffered_frames == 0 or play_time < 0.0 or is_spent:
        return
    duration = 0.0
    if has_quintic:
        duration = _plan_quintic(state)
        evaluate_quintic(state.polynomial, duration, play_time, state.base)
    else:
        copy(state.buffer_motion[oldest], state.base)
    to_real_time(state, state.base)
    if not has_quintic:
        evaluate_stop(dcu, state.base, play_time / (1.0 + clock.slew), state.base)
    if not (playback.is_filtered or _gap_is_allowed(dcu, state)):
        return
    has_jump = state.buffer_jump[oldest] or playback.elapsed > dcu.hold
    if has_quintic:
        playback.on_quintic, playback.duration, playback.elapsed = 1, duration, play_time
    else:
        _stop_from_oldest(state, play_time)
    if has_jump:
        # Take the filter of poses along where its input jumps: the gap closes the jump.
        for i in range(DOF_COUNT):
            state.filtered[POSE, i] -= state.line_pose[i]
        _write_line_pose(state)
        for i in range(DOF_COUNT):
            state.filtered[POSE, i] += state.line_pose[i]
        state.buffer_jump[oldest] = 0
    if playback.is_filtered:
        _write_base(dcu, state)
    subtract(state.motion, state.base, state.gap)


@compiled
def _target_slew(dcu, clock):  # type: ignore[no-untyped-def]
    """The slew that a critically damped loop on the host's lateness asks of the play clock.

    u = -2 x / Tc - d,    d' = x / Tc^2,    x = the mean lateness beyond the tolerance

    While x is 0, a drift d as small as that of any clock is forgotten: 2 x / Tc makes up for it.
    """
    excess = max(abs(clock.lateness) - dcu.clock_tolerance, 0.0) / dcu.clock_time
    if clock.lateness < 0.0:
        excess = -excess
    drift_change = excess
    if excess == 0.0 and abs(clock.drift) < CLOCK_DRIFT:
        drift_change = -clock.drift
    clock.drift += dcu.frame * drift_change / dcu.clock_time
    clock.drift = min(max(clock.drift, -dcu.clock_rate), dcu.clock_rate)
    return min(max(-2.0 * excess - clock.drift, -dcu.clock_rate), dcu.clock_rate)


@compiled
def _advance_play_clock(dcu, state):  # type: ignore[no-untyped-def]
    """Advance the play clock by a frame; the time that it passes [s].

    Its slew u is smoothed so that its time is twice differentiable:
    Ts^2 u'' + 2 Ts u' + u = target, integrated exactly for u'' constant in the frame.
    """
    clock, frame, slew_time = state.clock[0], dcu.frame, dcu.slew_time
    target = _target_slew(dcu, clock) if state.stream[0].is_synchronised else 0.0
    slew_bend = (target - clock.slew - 2.0 * slew_time * clock.slew_rate) / (slew_time * slew_time)
    played_time = frame * (
        1.0 + clock.slew + 0.5 * frame * clock.slew_rate + frame * frame * slew_bend / 6.0
    )
    clock.slew += frame * (clock.slew_rate + 0.5 * frame * slew_bend)
    clock.slew_rate += frame * slew_bend
    clock.time += played_time
    return played_time


@compiled
def _renew_range(dcu, state):  # type: ignore[no-untyped-def]
    """After a second begin another one of the host's range, at the present pose."""
    state.playback[0].range_age += dcu.frame
    if state.playback[0].range_age < 1.0 or not state.stream[0].is_synchronised:
        return
    state.playback[0].range_age = 0.0
    present, previous = state.present_range, state.previous_range
    for i in range(DOF_COUNT):
        previous.lowest[i], previous.highest[i] = present.lowest[i], present.highest[i]
        previous.stop_distance[i] = present.stop_distance[i]
        present.lowest[i] = present.highest[i] = state.line_pose[i]
        present.stop_distance[i] = 0.0


@compiled
def _let_waits_expire(dcu, state):  # type: ignore[no-untyped-def]
    """After the timeout refuse the candidate, and give up a stream that is silent."""
    stream, candidate = state.stream[0], state.candidate[0]
    stream.silence += dcu.frame
    candidate.age += dcu.frame
    stream.untimely_age += dcu.frame
    if candidate.is_waiting and candidate.age > dcu.timeout:
        refuse_candidate(state)
    if stream.is_synchronised and stream.silence > dcu.timeout:
        clear_buffer(state)
        stream.is_synchronised, stream.is_stale = 0, 1
        state.events[0].silent += 1


class Arrivals(NamedTuple):
    """Host frames in the order in which they reach the DCU, good or bad."""

    frame: NDArray[np.int64]  #: Control frame of arrival, never falling, (N,).
    sequence: NDArray[np.int64]  #: Sequence numbers, (N,).
    time: NDArray[np.float64]  #: Host times [s], (N,).
    values: NDArray[np.float64]  #: Pose [m, rad], z down, and its two derivatives, (N, 3, 6).


@compiled
def feed(dcu, state, arrivals, cursor, frame):  # type: ignore[no-untyped-def]
    """Hand the DCU all frames that have arrived by the control frame `frame`.

    The cursor is the index of the first frame not yet handed over; returned is the next one.
    """
    while cursor < arrivals.sequence.shape[0] and arrivals.frame[cursor] <= frame:
        receive(
            dcu, state, arrivals.sequence[cursor], arrivals.time[cursor], arrivals.values[cursor]
        )
        cursor += 1
    return cursor


@allocating
def _write_demand(dcu, state, arrivals, demand):  # type: ignore[no-untyped-def]
    cursor = 0
    for frame in range(demand.shape[0]):
        cursor = feed(dcu, state, arrivals, cursor, frame)
        step(dcu, state, demand[frame])


def upsample(dcu: Dcu, state: DcuState, arrivals: Arrivals, frames: int) -> NDArray[np.float64]:
    """Run a DCU over control frames 0 to `frames` - 1, from a state of `resting` or of a run.

    The demand (frames, 3, 6) at 2048 Hz: pose [m, rad], z down, and its two derivatives.
    """
    count = arrivals.sequence.shape[0]
    for name, shape in (("frame", (count,)), ("time", (count,)), ("values", (count, 3, 6))):
        actual = getattr(arrivals, name).shape
        if actual != shape:
            raise InputError(f"{name}: shape is {actual}; allowed: {shape}")
    if (np.diff(arrivals.frame) < 0).any():
        raise InputError("frame: control frames of arrival must not fall")
    if frames < 1:
        raise InputError(f"frames: {frames} must be at least 1")
    demand = np.empty((frames, 3, 6))
    _write_demand(dcu, state, arrivals, demand)
    return demand
