"""What happens to a host frame when it arrives.

A frame is tested in this order; the first test it fails names the reason:

    values     finite; pose, velocity and acceleration within the limits
    sequence   number and host time follow the newest accepted frame
    motion     the quintic from the newest accepted frame keeps the limits

A frame that fails only the last test, and the first of a stream, becomes the *candidate*: if the
next good one continues it, both are accepted and the demand goes over to them (a step of the host
costs no frame); if not, it is refused as `unconfirmed`. So one wild frame never moves the platform.

Derivatives have to fit the poses. Between two frames h apart the quintic has to make up for

    r = p1 - p0 - h (v0 + v1) / 2 - h^2 (a0 - a1) / 12

and bends by about 6 r / h^2 more for it. Where that is more than the poses themselves bend, and
more than `_FELT_ACCELERATION`, in one of twelve frames that move or more, the derivatives are left
aside, until nearly all have fitted for some ten seconds; straight lines between poses take the
quintics' place.
"""

import numpy as np

from cmf_mj.control.dcu.motion import (
    ACCELERATION,
    DOF_COUNT,
    GAP_OVERSHOOT,
    POSE,
    VELOCITY,
    copy,
    evaluate_quintic,
    line_keeps_limits,
    quintic_keeps_limits,
)
from cmf_mj.control.dcu.state import CAPACITY, Verdict
from cmf_mj.core.compiled import compiled

SEQUENCE_GAP = 4096  #: Most by which a sequence number may run ahead.

STAMP_RESOLUTION = 1e-6  #: Granted to host times [s]; a double counts from 1970 to 0.2 us.

MEAN_TIME, LATENESS_TIME = 1.0, 0.1
"""Time constants of the means of interval and share of late frames, and of lateness [s]."""

_BEND = 6.0  #: Bend of a quintic, times h^2 / r, for what it has to make up.

_FELT_ACCELERATION = 0.01  #: Acceleration [m/s^2, rad/s^2] that derivatives may add to any motion.

_FRAMES_JUDGED, _PATIENCE = 40, 10
"""Frames in motion in which derivatives that do not fit are put aside, and how many times as many
have to fit before they are taken again: a change between the two is felt."""

POSES_HOLD = 1.0 / 3.0  #: Share of the hold that poses wait; the filter bridges the rest.

LATE_SHARE = 0.2  #: Share of late frames from which on the host is late.


@compiled
def receive(dcu, state, sequence, time, motion):  # type: ignore[no-untyped-def]
    """Judge a host frame and, if it is good, put it in the buffer; its `Verdict`.

    Call it for every frame that has arrived since the control frame before, then `step`. The
    sequence number rises by one from frame to frame; the host's `time` [s] may have any origin;
    `motion` (3, 6) is the pose [m, rad], z down, and its first and second derivatives.
    """
    verdict = _judge_numbers(dcu, time, motion)
    if verdict == Verdict.ACCEPTED:
        verdict = _judge_against_stream(dcu, state, sequence, time, motion)
    if verdict >= 0:
        state.rejected[verdict.value] += 1
        if verdict not in (Verdict.REPEATED, Verdict.OUT_OF_ORDER):
            state.stream[0].refusals += 1
    return verdict


@compiled
def _judge_numbers(dcu, time, motion):  # type: ignore[no-untyped-def]
    """Test whether a frame's numbers are finite and within the limits."""
    if not np.isfinite(time):
        return Verdict.NOT_FINITE
    for row in range(3):
        for i in range(DOF_COUNT):
            if not np.isfinite(motion[row, i]):
                return Verdict.NOT_FINITE
    for row, limit, verdict in (
        (POSE, dcu.pose, Verdict.POSE_RANGE),
        (VELOCITY, dcu.velocity, Verdict.VELOCITY_RANGE),
        (ACCELERATION, dcu.acceleration, Verdict.ACCELERATION_RANGE),
    ):
        for i in range(DOF_COUNT):
            if abs(motion[row, i]) > limit[i]:
                return verdict
    return Verdict.ACCEPTED


@compiled
def _judge_order(dcu, sequence_step, interval):  # type: ignore[no-untyped-def]
    """Test a frame's number and time against an earlier frame's."""
    if sequence_step == 0:
        return Verdict.REPEATED
    if sequence_step < 0:
        return Verdict.OUT_OF_ORDER
    if sequence_step > SEQUENCE_GAP:
        return Verdict.SEQUENCE_JUMP
    if interval <= 0.0:
        return Verdict.TIME_REVERSED
    if interval < dcu.minimum_interval - STAMP_RESOLUTION:
        return Verdict.TOO_SOON
    if interval > dcu.timeout:
        return Verdict.TIME_JUMP
    return Verdict.ACCEPTED


@compiled
def _judge_against_stream(dcu, state, sequence, time, motion):  # type: ignore[no-untyped-def]
    """Test a frame against the stream, then the candidate; else it is the next candidate."""
    clock, stream, candidate = state.clock[0], state.stream[0], state.candidate[0]
    if sequence < 0:
        return Verdict.SEQUENCE_JUMP
    if stream.is_synchronised:
        play_time = time - clock.anchor
        interval = play_time - stream.newest_time
        sequence_step = sequence - stream.newest_sequence
        verdict = _judge_order(dcu, sequence_step, interval)
        if verdict != Verdict.ACCEPTED:
            return verdict
        is_early = play_time > clock.time + play_delay(dcu, state) + dcu.timeout
        if is_early or stream.buffered_frames > CAPACITY - 2:
            return Verdict.TOO_EARLY
        newest_place = (stream.oldest_place + stream.buffered_frames - 1) % CAPACITY
        if _motions_join(dcu, state, state.buffer_motion[newest_place], motion, interval):
            refuse_candidate(state)
            is_jump = _follow_host(dcu, state, play_time, interval, sequence_step)
            _append_to_buffer(dcu, state, sequence, play_time, motion, is_jump)
            return Verdict.ACCEPTED
    if candidate.is_waiting:
        interval = time - candidate.time
        verdict = _judge_order(dcu, sequence - candidate.sequence, interval)
        if verdict == Verdict.ACCEPTED:
            if _motions_join(dcu, state, state.candidate_motion, motion, interval):
                _accept_candidate(dcu, state, sequence, time, motion, interval)
                return Verdict.ACCEPTED
            stream.newest_interval = 0.0
            _judge_derivatives(state, state.candidate_motion, motion, interval)
        if verdict not in (Verdict.ACCEPTED, Verdict.SEQUENCE_JUMP, Verdict.TIME_JUMP):
            return verdict
    refuse_candidate(state)
    candidate.is_waiting, candidate.sequence = 1, sequence
    candidate.time, candidate.age = time, 0.0
    copy(motion, state.candidate_motion)
    return Verdict.CANDIDATE


@compiled
def _motions_join(dcu, state, first, last, interval):  # type: ignore[no-untyped-def]
    """Whether what leads from one frame to another keeps the limits."""
    if state.stream[0].poses_alone:
        return line_keeps_limits(dcu, first, last, interval)
    return quintic_keeps_limits(dcu, first, last, interval)


@compiled
def play_delay(dcu, state):  # type: ignore[no-untyped-def]
    """Time from a frame's arrival to its turn [s]: mean interval and hold, or share of the hold."""
    hold_share = POSES_HOLD if state.stream[0].poses_alone else 1.0
    return max(dcu.host_interval, state.clock[0].interval) + hold_share * dcu.hold


@compiled
def host_is_late(dcu, state):  # type: ignore[no-untyped-def]
    """Whether more than `LATE_SHARE` of the host's frames, or its clock, cannot be followed."""
    return state.stream[0].late_share > LATE_SHARE or abs(state.clock[0].drift) >= dcu.clock_rate


@compiled
def refuse_candidate(state):  # type: ignore[no-untyped-def]
    """Refuse the frame that waits for confirmation, if there is one."""
    if state.candidate[0].is_waiting:
        state.candidate[0].is_waiting = 0
        state.rejected[Verdict.UNCONFIRMED.value] += 1
        state.stream[0].refusals += 1


@compiled
def to_real_time(state, motion):  # type: ignore[no-untyped-def]
    """Turn derivatives over the play clock into derivatives over time."""
    clock_rate, slew_rate = 1.0 + state.clock[0].slew, state.clock[0].slew_rate
    for i in range(DOF_COUNT):
        velocity, acceleration = motion[VELOCITY, i], motion[ACCELERATION, i]
        motion[VELOCITY, i] = velocity * clock_rate
        motion[ACCELERATION, i] = acceleration * clock_rate * clock_rate + velocity * slew_rate


@compiled
def clear_buffer(state):  # type: ignore[no-untyped-def]
    """Forget all buffered frames: a stop begins here, or where the present one's quintic ended."""
    playback, stream = state.playback[0], state.stream[0]
    if playback.on_quintic:
        time = min(playback.elapsed, playback.duration)
        evaluate_quintic(state.polynomial, playback.duration, time, state.stop_origin)
        to_real_time(state, state.stop_origin)
        playback.elapsed = (playback.elapsed - time) / (1.0 + state.clock[0].slew)
    playback.on_quintic, playback.is_stop_of_oldest = 0, 0
    stream.buffered_frames, stream.is_untimely = 0, 0


@compiled
def _append_to_buffer(dcu, state, sequence, play_time, motion, is_jump):  # type: ignore[no-untyped-def]
    """Append a frame to the buffer; its time is that of the play clock [s]."""
    stream = state.stream[0]
    place = (stream.oldest_place + stream.buffered_frames) % CAPACITY
    if stream.is_synchronised and not is_jump:
        newest_motion = state.buffer_motion[(place - 1) % CAPACITY]
        _judge_derivatives(state, newest_motion, motion, play_time - stream.newest_time)
    else:
        stream.newest_interval = 0.0
    _widen_range(dcu, state, motion)
    stream.buffered_frames += 1
    state.buffer_time[place] = play_time
    copy(motion, state.buffer_motion[place])
    state.buffer_jump[place] = is_jump
    if stream.is_synchronised:
        unexplained_frames = sequence - stream.newest_sequence - 1 - stream.refusals
        state.events[0].missing += max(unexplained_frames, 0)
    state.events[0].accepted += 1
    stream.newest_sequence, stream.refusals, stream.is_stale = sequence, 0, 0
    stream.newest_time, stream.silence = play_time, 0.0


@compiled
def _judge_derivatives(state, first, last, h):  # type: ignore[no-untyped-def]
    """Renew the share of frames whose derivatives do not fit the poses."""
    stream = state.stream[0]
    moves, misfits, has_no_derivatives = False, False, True
    for i in range(DOF_COUNT):
        pose_step = last[POSE, i] - first[POSE, i]
        derived_step = 0.5 * h * (first[VELOCITY, i] + last[VELOCITY, i])
        derived_step += h * h / 12.0 * (first[ACCELERATION, i] - last[ACCELERATION, i])
        floor = _FELT_ACCELERATION * h * h / _BEND
        bend = 0.0
        if stream.newest_interval > 0.0:
            bend = pose_step - state.pose_step[i] * h / stream.newest_interval
        moves = moves or max(abs(pose_step), abs(derived_step)) > floor
        misfits = misfits or abs(pose_step - derived_step) > max(floor, abs(bend) / _BEND)
        for row in (VELOCITY, ACCELERATION):
            is_zero = first[row, i] == 0.0 and last[row, i] == 0.0
            has_no_derivatives = has_no_derivatives and is_zero
        state.pose_step[i] = pose_step
    stream.newest_interval = h
    if not moves:
        return
    stream.judged_frames = min(stream.judged_frames + 1, _FRAMES_JUDGED)
    if misfits:
        stream.misfit += (1.0 - stream.misfit) / stream.judged_frames
    else:
        stream.misfit -= stream.misfit / (_PATIENCE * (stream.judged_frames + 2))
    if has_no_derivatives:
        stream.misfit = 1.0
    if stream.misfit > 0.5:
        stream.poses_alone = 1
    elif stream.misfit < 0.1:
        stream.poses_alone = 0


@compiled
def _widen_range(dcu, state, motion):  # type: ignore[no-untyped-def]
    """Take a frame into the host's range of this second."""
    present = state.present_range
    stop_time = 0.5 * dcu.stop_time + GAP_OVERSHOOT / dcu.gap_rate
    for i in range(DOF_COUNT):
        stop_distance = stop_time * abs(motion[VELOCITY, i])
        stop_distance += dcu.fade_time * dcu.fade_time / 12.0 * abs(motion[ACCELERATION, i])
        present.lowest[i] = min(present.lowest[i], motion[POSE, i])
        present.highest[i] = max(present.highest[i], motion[POSE, i])
        present.stop_distance[i] = max(present.stop_distance[i], stop_distance)


@compiled
def _follow_host(dcu, state, play_time, interval, sequence_step):  # type: ignore[no-untyped-def]
    """Update the means of interval and lateness; whether the clock is set again, 1 or 0.

    It is set again once frame after frame has been late for the timeout, or ahead by a quarter of
    it for half of it, before they are too early, and is off by half of it: the clock makes up less.
    The interval is the host's own, so that a lost frame does not look like a slower host.
    """
    clock, stream = state.clock[0], state.stream[0]
    host_interval = interval / sequence_step
    weight = min(interval / MEAN_TIME, 1.0)
    clock.interval += weight * (host_interval - clock.interval)
    lateness = clock.time + play_delay(dcu, state) - play_time
    clock.lateness += min(interval / LATENESS_TIME, 1.0) * (lateness - clock.lateness)
    bridged_time = (1.0 - POSES_HOLD) * dcu.hold if stream.poses_alone else 0.0
    is_late = clock.time > stream.newest_time + bridged_time
    stream.late_share += weight * ((1.0 if is_late else 0.0) - stream.late_share)
    if is_late:
        state.events[0].late += 1
    elif lateness > -0.25 * dcu.timeout:
        stream.is_untimely = 0
        return 0
    if not stream.is_untimely:
        stream.is_untimely, stream.untimely_age = 1, 0.0
        return 0
    patience = (1.0 if is_late else 0.5) * dcu.timeout
    if not (stream.untimely_age > patience and abs(lateness) > 0.5 * dcu.timeout):
        return 0
    clear_buffer(state)
    clock.interval = host_interval
    clock.lateness = 0.0
    clock.time = play_time - play_delay(dcu, state)
    state.events[0].resynchronised += 1
    return 1


@compiled
def _accept_candidate(dcu, state, sequence, time, motion, interval):  # type: ignore[no-untyped-def]
    """Take the candidate and the frame that confirms it; start the play clock if it rests."""
    clock, stream, candidate = state.clock[0], state.stream[0], state.candidate[0]
    candidate.is_waiting = 0
    if not stream.is_synchronised:
        clear_buffer(state)
        clock.anchor = candidate.time
        clock.interval = interval / (sequence - candidate.sequence)
        clock.lateness, clock.drift = 0.0, 0.0
        stream.late_share = 0.0
        clock.time = interval - play_delay(dcu, state)
    refusals, candidate_time = stream.refusals, candidate.time - clock.anchor
    _append_to_buffer(dcu, state, candidate.sequence, candidate_time, state.candidate_motion, 1)
    stream.is_synchronised, stream.refusals = 1, refusals
    _append_to_buffer(dcu, state, sequence, time - clock.anchor, motion, 0)
    stream.is_untimely = 0
    state.events[0].resynchronised += 1
