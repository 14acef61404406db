"""What happens to a host frame when it arrives.

A frame is tested in this order; the first test it fails names the reason:

    values     finite; pose, velocity and acceleration within the limits
    sequence   number and host time follow the newest accepted frame
    motion     the quintic from the newest accepted frame keeps the limits

A frame that fails only the last test, and the first of a stream, is *held*: if the next good one
continues it, both are taken and the demand goes over to them (a step of the host costs no frame);
if not, it is refused as `unconfirmed`. So one wild frame never moves the platform.
"""

import numpy as np

from cmf_mj.control.dcu.motion import ACCELERATION, POSE, VELOCITY, copy, evaluate, joins
from cmf_mj.control.dcu.state import (
    ACCELERATION_RANGE,
    ACCEPTED,
    ANCHOR,
    CAPACITY,
    COUNT,
    DURATION,
    FIRST,
    HELD,
    HELD_AGE,
    HELD_SEQUENCE,
    HELD_TIME,
    HOLDING,
    INTERVAL,
    LATE,
    LATE_AGE,
    LATE_RUN,
    LATENESS,
    LOCAL,
    MISSING,
    MOVING,
    NEWEST,
    NOT_FINITE,
    OUT_OF_ORDER,
    PLAY,
    POSE_RANGE,
    REFUSED,
    REPEATED,
    RESYNCHRONISED,
    SEQUENCE,
    SEQUENCE_JUMP,
    SILENCE,
    STALE,
    SYNCHRONISED,
    TAKEN,
    TIME_JUMP,
    TIME_REVERSED,
    TOO_EARLY,
    TOO_SOON,
    UNCONFIRMED,
    USED,
    VELOCITY_RANGE,
)
from cmf_mj.core.compiled import compiled

SEQUENCE_GAP = 4096
"""Most by which a sequence number may run ahead."""

STAMP = 1e-6
"""Resolution granted to host times [s]; a double counts seconds since 1970 to 0.2 us."""

AVERAGE = 1.0
"""Time constant of the means of lateness and interval [s]."""


@compiled
def receive(dcu, state, sequence, time, values):  # type: ignore[no-untyped-def]
    """Judge a host frame and, if it is good, put it in the buffer.

    Call it for every frame that has arrived since the control frame before, then `step`.

    Args:
        dcu: compiled parameters.
        state: changed in place.
        sequence: number of the frame, rising by one from frame to frame.
        time: host time of the frame [s], of any origin.
        values: (3, 6): pose [m, rad], z down, its first and its second derivative.

    Returns:
        `ACCEPTED`, `HELD`, or the index in `REASONS` of why it is refused.
    """
    verdict = _values(dcu, time, values)
    if verdict == ACCEPTED:
        verdict = _stream(dcu, state, sequence, time, values)
    if verdict >= 0:
        state.rejected[verdict] += 1
        if verdict not in (REPEATED, OUT_OF_ORDER):
            state.whole[REFUSED] += 1
    return verdict


@compiled
def _values(dcu, time, values):  # type: ignore[no-untyped-def]
    if not np.isfinite(time):
        return NOT_FINITE
    for row in range(3):
        for i in range(6):
            if not np.isfinite(values[row, i]):
                return NOT_FINITE
    for i in range(6):
        if abs(values[POSE, i]) > dcu.pose[i]:
            return POSE_RANGE
    for i in range(6):
        if abs(values[VELOCITY, i]) > dcu.velocity[i]:
            return VELOCITY_RANGE
    for i in range(6):
        if abs(values[ACCELERATION, i]) > dcu.acceleration[i]:
            return ACCELERATION_RANGE
    return ACCEPTED


@compiled
def _order(dcu, ahead, interval):  # type: ignore[no-untyped-def]
    """Test a frame's number and time against an earlier frame's."""
    if ahead == 0:
        return REPEATED
    if ahead < 0:
        return OUT_OF_ORDER
    if ahead > SEQUENCE_GAP:
        return SEQUENCE_JUMP
    if interval <= 0.0:
        return TIME_REVERSED
    if interval < dcu.minimum_interval - STAMP:
        return TOO_SOON
    if interval > dcu.timeout:
        return TIME_JUMP
    return ACCEPTED


@compiled
def _stream(dcu, state, sequence, time, values):  # type: ignore[no-untyped-def]
    real, whole = state.real, state.whole
    if sequence < 0:
        return SEQUENCE_JUMP
    relative = time - real[ANCHOR]
    if whole[SYNCHRONISED]:
        interval = relative - real[NEWEST]
        verdict = _order(dcu, sequence - whole[SEQUENCE], interval)
        if verdict != ACCEPTED:
            return verdict
        early = relative > real[PLAY] + play_delay(dcu, state) + dcu.timeout
        if early or whole[COUNT] > CAPACITY - 2:
            return TOO_EARLY
        newest = state.frame[(whole[FIRST] + whole[COUNT] - 1) % CAPACITY]
        if joins(dcu, newest, values, interval):
            drop_held(state)
            _follow(dcu, state, relative, interval, sequence - whole[SEQUENCE])
            _take(state, sequence, relative, values, 0)
            return ACCEPTED
    if whole[HOLDING]:
        interval = time - real[HELD_TIME]
        verdict = _order(dcu, sequence - whole[HELD_SEQUENCE], interval)
        if verdict == ACCEPTED and joins(dcu, state.held, values, interval):
            _confirm(dcu, state, sequence, time, values, interval)
            return ACCEPTED
        if verdict not in (ACCEPTED, SEQUENCE_JUMP, TIME_JUMP):
            return verdict
    drop_held(state)
    whole[HOLDING], whole[HELD_SEQUENCE] = 1, sequence
    real[HELD_TIME], real[HELD_AGE] = time, 0.0
    copy(values, state.held)
    return HELD


@compiled
def play_delay(dcu, state):  # type: ignore[no-untyped-def]
    """Time from a frame's arrival to its turn [s]: the host's mean interval and the hold."""
    return max(dcu.host_interval, state.real[INTERVAL]) + dcu.hold


@compiled
def drop_held(state):  # type: ignore[no-untyped-def]
    """Refuse the frame that waits for confirmation, if there is one."""
    if state.whole[HOLDING]:
        state.whole[HOLDING] = 0
        state.rejected[UNCONFIRMED] += 1
        state.whole[REFUSED] += 1


@compiled
def stop_here(state):  # type: ignore[no-untyped-def]
    """Leave the present quintic for a stop that begins here, or where it has just ended."""
    real, whole = state.real, state.whole
    if whole[MOVING] and real[LOCAL] < real[DURATION]:
        evaluate(state.polynomial, real[DURATION], real[LOCAL], state.origin)
        real[LOCAL] = 0.0
    elif whole[MOVING]:
        copy(state.frame[(whole[FIRST] + 1) % CAPACITY], state.origin)
        real[LOCAL] -= real[DURATION]
    whole[MOVING] = 0


@compiled
def clear(state):  # type: ignore[no-untyped-def]
    """Forget all buffered frames and come to rest."""
    stop_here(state)
    state.whole[COUNT] = 0
    state.whole[USED] = 0
    state.whole[LATE_RUN] = 0


@compiled
def _take(state, sequence, relative, values, apart):  # type: ignore[no-untyped-def]
    """Append a frame to the buffer."""
    real, whole = state.real, state.whole
    place = (whole[FIRST] + whole[COUNT]) % CAPACITY
    whole[COUNT] += 1
    state.time[place] = relative
    copy(values, state.frame[place])
    state.apart[place] = apart
    if whole[SYNCHRONISED]:
        state.events[MISSING] += max(sequence - whole[SEQUENCE] - 1 - whole[REFUSED], 0)
    state.events[TAKEN] += 1
    whole[SEQUENCE], whole[REFUSED], whole[STALE] = sequence, 0, 0
    real[NEWEST], real[SILENCE] = relative, 0.0


@compiled
def _follow(dcu, state, relative, interval, ahead):  # type: ignore[no-untyped-def]
    """Update the means of interval and lateness; set the clock anew if the host stays late.

    It does so once frame after frame has been late for the timeout: a host that stumbles and
    catches up leaves the clock alone. The interval is the host's own, so that a lost
    frame does not look like a slower host.
    """
    real, whole = state.real, state.whole
    weight = min(interval / AVERAGE, 1.0)
    real[INTERVAL] += weight * (interval / ahead - real[INTERVAL])
    lateness = real[PLAY] + play_delay(dcu, state) - relative
    real[LATENESS] += weight * (lateness - real[LATENESS])
    if real[PLAY] <= real[NEWEST]:
        whole[LATE_RUN] = 0
        return
    state.events[LATE] += 1
    if not whole[LATE_RUN]:
        whole[LATE_RUN] = 1
        real[LATE_AGE] = 0.0
    elif real[LATE_AGE] > dcu.timeout:
        clear(state)
        real[INTERVAL] = interval
        real[LATENESS] = 0.0
        real[PLAY] = relative - play_delay(dcu, state)
        state.events[RESYNCHRONISED] += 1


@compiled
def _confirm(dcu, state, sequence, time, values, interval):  # type: ignore[no-untyped-def]
    """Take the held frame and the one that confirms it; start the play clock if it rests."""
    real, whole = state.real, state.whole
    whole[HOLDING] = 0
    if not whole[SYNCHRONISED]:
        clear(state)
        real[ANCHOR] = real[HELD_TIME]
        real[INTERVAL] = interval / (sequence - whole[HELD_SEQUENCE])
        real[LATENESS] = 0.0
        real[PLAY] = interval - play_delay(dcu, state)
    relative, refused = time - real[ANCHOR], whole[REFUSED]
    _take(state, whole[HELD_SEQUENCE], real[HELD_TIME] - real[ANCHOR], state.held, 1)
    whole[SYNCHRONISED], whole[REFUSED] = 1, refused
    _take(state, sequence, relative, values, 0)
    whole[LATE_RUN] = 0
    state.events[RESYNCHRONISED] += 1
