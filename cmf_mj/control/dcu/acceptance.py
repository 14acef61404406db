"""What happens to a host frame when it arrives.

A frame is tested in this order; the first test it fails names the reason:

    values     finite; pose, velocity and acceleration within the limits
    sequence   number and host time follow the newest accepted frame
    motion     the quintic from the newest accepted frame keeps the limits

A frame that fails only the last test, and the first of a stream, is *held*: if the next good one
continues it, both are taken and the demand goes over to them (a step of the host costs no frame);
if not, it is refused as `unconfirmed`. So one wild frame never moves the platform.

Derivatives have to fit the poses. Between two frames h apart the quintic has to make up for

    r = p1 - p0 - h (v0 + v1) / 2 - h^2 (a0 - a1) / 12

and bends by about 6 r / h^2 more for it. Where that is more than the poses themselves bend, and
more than `_FELT`, in one of twelve frames that move or more, the derivatives are left aside,
until nearly all have fitted for some ten seconds; straight lines between poses take the quintics'
place.
"""

import numpy as np

from cmf_mj.control.dcu.motion import (
    ACCELERATION,
    DOF_COUNT,
    GAP_OVERSHOOT,
    POSE,
    VELOCITY,
    copy,
    evaluate,
    line_keeps_limits,
    quintic_keeps_limits,
)
from cmf_mj.control.dcu.state import CAPACITY, Verdict
from cmf_mj.core.compiled import compiled

SEQUENCE_GAP = 4096  #: Most by which a sequence number may run ahead.

STAMP = 1e-6  #: Resolution granted to host times [s]; a double counts seconds since 1970 to 0.2 us.

AVERAGE, LATENESS = 1.0, 0.1
"""Time constants of the means of interval and share of late frames, and of lateness [s]."""

_BEND = 6.0  #: Bend of a quintic, times h^2 / r, for what it has to make up.

_FELT = 0.01  #: Acceleration [m/s^2, rad/s^2] that derivatives may add to any motion.

_FRAMES_JUDGED, _PATIENCE = 40, 10
"""Frames in motion in which derivatives that do not fit are put aside, and how many times as many
have to fit before they are taken again: a change between the two is felt."""

POSES_HOLD = 1.0 / 3.0  #: Share of the hold that poses wait; the filter bridges the rest.

LATE_SHARE = 0.2  #: Share of late frames from which on the host is late.


@compiled
def receive(dcu, state, sequence, time, values):  # type: ignore[no-untyped-def]
    """Judge a host frame and, if it is good, put it in the buffer; its `Verdict`.

    Call it for every frame that has arrived since the control frame before, then `step`. The
    sequence number rises by one from frame to frame; the host's `time` [s] may have any origin;
    `values` (3, 6) are the pose [m, rad], z down, and its first and second derivatives.
    """
    verdict = _judge_numbers(dcu, time, values)
    if verdict == Verdict.ACCEPTED:
        verdict = _judge_in_stream(dcu, state, sequence, time, values)
    if verdict >= 0:
        state.rejected[verdict.value] += 1
        if verdict not in (Verdict.REPEATED, Verdict.OUT_OF_ORDER):
            state.clocks[0].refused += 1
    return verdict


@compiled
def _judge_numbers(dcu, time, values):  # type: ignore[no-untyped-def]
    if not np.isfinite(time):
        return Verdict.NOT_FINITE
    for row in range(3):
        for i in range(6):
            if not np.isfinite(values[row, i]):
                return Verdict.NOT_FINITE
    for row, limit, verdict in (
        (POSE, dcu.pose, Verdict.POSE_RANGE),
        (VELOCITY, dcu.velocity, Verdict.VELOCITY_RANGE),
        (ACCELERATION, dcu.acceleration, Verdict.ACCELERATION_RANGE),
    ):
        for i in range(DOF_COUNT):
            if abs(values[row, i]) > limit[i]:
                return verdict
    return Verdict.ACCEPTED


@compiled
def _judge_order(dcu, ahead, interval):  # type: ignore[no-untyped-def]
    """Test a frame's number and time against an earlier frame's."""
    if ahead == 0:
        return Verdict.REPEATED
    if ahead < 0:
        return Verdict.OUT_OF_ORDER
    if ahead > SEQUENCE_GAP:
        return Verdict.SEQUENCE_JUMP
    if interval <= 0.0:
        return Verdict.TIME_REVERSED
    if interval < dcu.minimum_interval - STAMP:
        return Verdict.TOO_SOON
    if interval > dcu.timeout:
        return Verdict.TIME_JUMP
    return Verdict.ACCEPTED


@compiled
def _judge_in_stream(dcu, state, sequence, time, values):  # type: ignore[no-untyped-def]
    clocks = state.clocks[0]
    if sequence < 0:
        return Verdict.SEQUENCE_JUMP
    relative = time - clocks.anchor
    if clocks.synchronised:
        interval = relative - clocks.newest
        verdict = _judge_order(dcu, sequence - clocks.sequence, interval)
        if verdict != Verdict.ACCEPTED:
            return verdict
        early = relative > clocks.play + play_delay(dcu, state) + dcu.timeout
        if early or clocks.buffered > CAPACITY - 2:
            return Verdict.TOO_EARLY
        newest = state.frame[(clocks.first + clocks.buffered - 1) % CAPACITY]
        if _frames_join(dcu, state, newest, values, interval):
            drop_held(state)
            jumps = _follow_host(dcu, state, relative, interval, sequence - clocks.sequence)
            _buffer(dcu, state, sequence, relative, values, jumps)
            return Verdict.ACCEPTED
    if clocks.holding:
        interval = time - clocks.held_time
        verdict = _judge_order(dcu, sequence - clocks.held_sequence, interval)
        if verdict == Verdict.ACCEPTED:
            if _frames_join(dcu, state, state.held, values, interval):
                _confirm(dcu, state, sequence, time, values, interval)
                return Verdict.ACCEPTED
            clocks.before = 0.0
            _judge_derivatives(state, state.held, values, interval)
        if verdict not in (Verdict.ACCEPTED, Verdict.SEQUENCE_JUMP, Verdict.TIME_JUMP):
            return verdict
    drop_held(state)
    clocks.holding, clocks.held_sequence = 1, sequence
    clocks.held_time, clocks.held_age = time, 0.0
    copy(values, state.held)
    return Verdict.HELD


@compiled
def _frames_join(dcu, state, first, last, interval):  # type: ignore[no-untyped-def]
    if state.clocks[0].poses:
        return line_keeps_limits(dcu, first, last, interval)
    return quintic_keeps_limits(dcu, first, last, interval)


@compiled
def play_delay(dcu, state):  # type: ignore[no-untyped-def]
    """Time from a frame's arrival to its turn [s]: the host's mean interval and the hold.

    The filter of poses takes the place of most of the hold.
    """
    share = POSES_HOLD if state.clocks[0].poses else 1.0
    return max(dcu.host_interval, state.clocks[0].interval) + share * dcu.hold


@compiled
def host_late(dcu, state):  # type: ignore[no-untyped-def]
    """Whether more than `LATE_SHARE` of the host's frames, or its clock, cannot be followed."""
    clocks = state.clocks[0]
    return clocks.late_share > LATE_SHARE or abs(clocks.drift) >= dcu.clock_rate


@compiled
def drop_held(state):  # type: ignore[no-untyped-def]
    """Refuse the frame that waits for confirmation, if there is one."""
    if state.clocks[0].holding:
        state.clocks[0].holding = 0
        state.rejected[Verdict.UNCONFIRMED.value] += 1
        state.clocks[0].refused += 1


@compiled
def to_real_time(state, motion):  # type: ignore[no-untyped-def]
    """Turn derivatives over the play clock into derivatives over time."""
    fast, rate = 1.0 + state.clocks[0].slew, state.clocks[0].slew_rate
    for i in range(DOF_COUNT):
        v = motion[VELOCITY, i]
        motion[VELOCITY, i] = v * fast
        motion[ACCELERATION, i] = motion[ACCELERATION, i] * fast * fast + v * rate


@compiled
def clear(state):  # type: ignore[no-untyped-def]
    """Forget all buffered frames: a stop begins here, or where the present one's quintic ended."""
    clocks = state.clocks[0]
    if clocks.moving:
        left = min(clocks.local, clocks.duration)
        evaluate(state.polynomial, clocks.duration, left, state.origin)
        to_real_time(state, state.origin)
        clocks.local = (clocks.local - left) / (1.0 + clocks.slew)
    clocks.moving, clocks.buffered, clocks.used, clocks.late_run = 0, 0, 0, 0


@compiled
def _buffer(dcu, state, sequence, relative, values, apart):  # type: ignore[no-untyped-def]
    """Append a frame to the buffer."""
    clocks = state.clocks[0]
    place = (clocks.first + clocks.buffered) % CAPACITY
    if clocks.synchronised and not apart:
        newest = state.frame[(place - 1) % CAPACITY]
        _judge_derivatives(state, newest, values, relative - clocks.newest)
    else:
        clocks.before = 0.0
    _widen_range(dcu, state, values)
    clocks.buffered += 1
    state.time[place] = relative
    copy(values, state.frame[place])
    state.apart[place] = apart
    if clocks.synchronised:
        state.events[0].missing += max(sequence - clocks.sequence - 1 - clocks.refused, 0)
    state.events[0].accepted += 1
    clocks.sequence, clocks.refused, clocks.stale = sequence, 0, 0
    clocks.newest, clocks.silence = relative, 0.0


@compiled
def _judge_derivatives(state, first, last, h):  # type: ignore[no-untyped-def]
    """Renew the share of frames whose derivatives do not fit the poses."""
    clocks = state.clocks[0]
    moving, unfit, silent = False, False, True
    for i in range(DOF_COUNT):
        step = last[POSE, i] - first[POSE, i]
        carried = 0.5 * h * (first[VELOCITY, i] + last[VELOCITY, i])
        carried += h * h / 12.0 * (first[ACCELERATION, i] - last[ACCELERATION, i])
        floor = _FELT * h * h / _BEND
        bend = step - state.step[i] * h / clocks.before if clocks.before > 0.0 else 0.0
        moving = moving or max(abs(step), abs(carried)) > floor
        unfit = unfit or abs(step - carried) > max(floor, abs(bend) / _BEND)
        for row in (VELOCITY, ACCELERATION):
            silent = silent and first[row, i] == 0.0 and last[row, i] == 0.0
        state.step[i] = step
    clocks.before = h
    if not moving:
        return
    clocks.judged = min(clocks.judged + 1, _FRAMES_JUDGED)
    if unfit:
        clocks.misfit += (1.0 - clocks.misfit) / clocks.judged
    else:
        clocks.misfit -= clocks.misfit / (_PATIENCE * (clocks.judged + 2))
    if silent:  # the host sends none
        clocks.misfit = 1.0
    if clocks.misfit > 0.5:
        clocks.poses = 1
    elif clocks.misfit < 0.1:
        clocks.poses = 0


@compiled
def _widen_range(dcu, state, values):  # type: ignore[no-untyped-def]
    """Take a frame into the host's range of this second."""
    now, way = state.second, 0.5 * dcu.stop_time + GAP_OVERSHOOT / dcu.gap_rate
    for i in range(DOF_COUNT):
        far = way * abs(values[VELOCITY, i])
        far += dcu.fade_time * dcu.fade_time / 12.0 * abs(values[ACCELERATION, i])
        now.least[i] = min(now.least[i], values[POSE, i])
        now.most[i] = max(now.most[i], values[POSE, i])
        now.stop[i] = max(now.stop[i], far)


@compiled
def _follow_host(dcu, state, relative, interval, ahead):  # type: ignore[no-untyped-def]
    """Update the means of interval and lateness; whether the clock is set again, 1 or 0.

    It is once frame after frame has been late for the timeout, or ahead by a quarter of it
    for half of it, before they are too early, and is off by half of it: what is less the clock
    makes up. The interval is the host's own, so that a lost frame does not look like a slower host.
    """
    clocks = state.clocks[0]
    weight = min(interval / AVERAGE, 1.0)
    clocks.interval += weight * (interval / ahead - clocks.interval)
    lateness = clocks.play + play_delay(dcu, state) - relative
    clocks.lateness += min(interval / LATENESS, 1.0) * (lateness - clocks.lateness)
    bridged = (1.0 - POSES_HOLD) * dcu.hold if clocks.poses else 0.0
    late = clocks.play > clocks.newest + bridged
    clocks.late_share += weight * ((1.0 if late else 0.0) - clocks.late_share)
    if late:
        state.events[0].late += 1
    elif lateness > -0.25 * dcu.timeout:
        clocks.late_run = 0
        return 0
    if not clocks.late_run:
        clocks.late_run = 1
        clocks.late_age = 0.0
    elif (
        clocks.late_age > (1.0 if late else 0.5) * dcu.timeout and abs(lateness) > 0.5 * dcu.timeout
    ):
        clear(state)
        clocks.interval = interval / ahead
        clocks.lateness = 0.0
        clocks.play = relative - play_delay(dcu, state)
        state.events[0].resynchronised += 1
        return 1
    return 0


@compiled
def _confirm(dcu, state, sequence, time, values, interval):  # type: ignore[no-untyped-def]
    """Take the held frame and the one that confirms it; start the play clock if it rests."""
    clocks = state.clocks[0]
    clocks.holding = 0
    if not clocks.synchronised:
        clear(state)
        clocks.anchor = clocks.held_time
        clocks.interval = interval / (sequence - clocks.held_sequence)
        clocks.lateness, clocks.drift = 0.0, 0.0
        clocks.late_share = 0.0
        clocks.play = interval - play_delay(dcu, state)
    relative, refused = time - clocks.anchor, clocks.refused
    _buffer(dcu, state, clocks.held_sequence, clocks.held_time - clocks.anchor, state.held, 1)
    clocks.synchronised, clocks.refused = 1, refused
    _buffer(dcu, state, sequence, relative, values, 0)
    clocks.late_run = 0
    state.events[0].resynchronised += 1
