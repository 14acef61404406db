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
from cmf_mj.control.dcu.state import CAPACITY, Verdict
from cmf_mj.core.compiled import compiled

SEQUENCE_GAP = 4096
"""Most by which a sequence number may run ahead."""

STAMP = 1e-6
"""Resolution granted to host times [s]; a double counts seconds since 1970 to 0.2 us."""

AVERAGE = 1.0
"""Time constant of the means of lateness and interval [s]."""


@compiled
def receive(dcu, state, sequence, time, values):  # type: ignore[no-untyped-def]
    """Judge a host frame and, if it is good, put it in the buffer; its `Verdict`.

    Call it for every frame that has arrived since the control frame before, then `step`. The
    sequence number rises by one from frame to frame; the host's `time` [s] may have any origin;
    `values` (3, 6) are the pose [m, rad], z down, and its first and second derivatives.
    """
    verdict = _values(dcu, time, values)
    if verdict == Verdict.ACCEPTED:
        verdict = _stream(dcu, state, sequence, time, values)
    if verdict >= 0:
        state.rejected[verdict.value] += 1
        if verdict not in (Verdict.REPEATED, Verdict.OUT_OF_ORDER):
            state.clocks[0].refused += 1
    return verdict


@compiled
def _values(dcu, time, values):  # type: ignore[no-untyped-def]
    if not np.isfinite(time):
        return Verdict.NOT_FINITE
    for row in range(3):
        for i in range(6):
            if not np.isfinite(values[row, i]):
                return Verdict.NOT_FINITE
    for i in range(6):
        if abs(values[POSE, i]) > dcu.pose[i]:
            return Verdict.POSE_RANGE
    for i in range(6):
        if abs(values[VELOCITY, i]) > dcu.velocity[i]:
            return Verdict.VELOCITY_RANGE
    for i in range(6):
        if abs(values[ACCELERATION, i]) > dcu.acceleration[i]:
            return Verdict.ACCELERATION_RANGE
    return Verdict.ACCEPTED


@compiled
def _order(dcu, ahead, interval):  # type: ignore[no-untyped-def]
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
def _stream(dcu, state, sequence, time, values):  # type: ignore[no-untyped-def]
    clocks = state.clocks[0]
    if sequence < 0:
        return Verdict.SEQUENCE_JUMP
    relative = time - clocks.anchor
    if clocks.synchronised:
        interval = relative - clocks.newest
        verdict = _order(dcu, sequence - clocks.sequence, interval)
        if verdict != Verdict.ACCEPTED:
            return verdict
        early = relative > clocks.play + play_delay(dcu, state) + dcu.timeout
        if early or clocks.buffered > CAPACITY - 2:
            return Verdict.TOO_EARLY
        newest = state.frame[(clocks.first + clocks.buffered - 1) % CAPACITY]
        if joins(dcu, newest, values, interval):
            drop_held(state)
            _follow(dcu, state, relative, interval, sequence - clocks.sequence)
            _take(state, sequence, relative, values, 0)
            return Verdict.ACCEPTED
    if clocks.holding:
        interval = time - clocks.held_time
        verdict = _order(dcu, sequence - clocks.held_sequence, interval)
        if verdict == Verdict.ACCEPTED and joins(dcu, state.held, values, interval):
            _confirm(dcu, state, sequence, time, values, interval)
            return Verdict.ACCEPTED
        if verdict not in (Verdict.ACCEPTED, Verdict.SEQUENCE_JUMP, Verdict.TIME_JUMP):
            return verdict
    drop_held(state)
    clocks.holding, clocks.held_sequence = 1, sequence
    clocks.held_time, clocks.held_age = time, 0.0
    copy(values, state.held)
    return Verdict.HELD


@compiled
def play_delay(dcu, state):  # type: ignore[no-untyped-def]
    """Time from a frame's arrival to its turn [s]: the host's mean interval and the hold."""
    return max(dcu.host_interval, state.clocks[0].interval) + dcu.hold


@compiled
def drop_held(state):  # type: ignore[no-untyped-def]
    """Refuse the frame that waits for confirmation, if there is one."""
    if state.clocks[0].holding:
        state.clocks[0].holding = 0
        state.rejected[Verdict.UNCONFIRMED.value] += 1
        state.clocks[0].refused += 1


@compiled
def stop_here(state):  # type: ignore[no-untyped-def]
    """Leave the present quintic for a stop that begins here, or where it has just ended."""
    clocks = state.clocks[0]
    if clocks.moving and clocks.local < clocks.duration:
        evaluate(state.polynomial, clocks.duration, clocks.local, state.origin)
        clocks.local = 0.0
    elif clocks.moving:
        copy(state.frame[(clocks.first + 1) % CAPACITY], state.origin)
        clocks.local -= clocks.duration
    clocks.moving = 0


@compiled
def clear(state):  # type: ignore[no-untyped-def]
    """Forget all buffered frames and come to rest."""
    stop_here(state)
    state.clocks[0].buffered = 0
    state.clocks[0].used = 0
    state.clocks[0].late_run = 0


@compiled
def _take(state, sequence, relative, values, apart):  # type: ignore[no-untyped-def]
    """Append a frame to the buffer."""
    clocks = state.clocks[0]
    place = (clocks.first + clocks.buffered) % CAPACITY
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
def _follow(dcu, state, relative, interval, ahead):  # type: ignore[no-untyped-def]
    """Update the means of interval and lateness; set the clock anew if the host stays late.

    It does so once frame after frame has been late for the timeout: a host that stumbles and
    catches up leaves the clock alone. The interval is the host's own, so that a lost
    frame does not look like a slower host.
    """
    clocks = state.clocks[0]
    weight = min(interval / AVERAGE, 1.0)
    clocks.interval += weight * (interval / ahead - clocks.interval)
    lateness = clocks.play + play_delay(dcu, state) - relative
    clocks.lateness += weight * (lateness - clocks.lateness)
    if clocks.play <= clocks.newest:
        clocks.late_run = 0
        return
    state.events[0].late += 1
    if not clocks.late_run:
        clocks.late_run = 1
        clocks.late_age = 0.0
    elif clocks.late_age > dcu.timeout:
        clear(state)
        clocks.interval = interval
        clocks.lateness = 0.0
        clocks.play = relative - play_delay(dcu, state)
        state.events[0].resynchronised += 1


@compiled
def _confirm(dcu, state, sequence, time, values, interval):  # type: ignore[no-untyped-def]
    """Take the held frame and the one that confirms it; start the play clock if it rests."""
    clocks = state.clocks[0]
    clocks.holding = 0
    if not clocks.synchronised:
        clear(state)
        clocks.anchor = clocks.held_time
        clocks.interval = interval / (sequence - clocks.held_sequence)
        clocks.lateness = 0.0
        clocks.play = interval - play_delay(dcu, state)
    relative, refused = time - clocks.anchor, clocks.refused
    _take(state, clocks.held_sequence, clocks.held_time - clocks.anchor, state.held, 1)
    clocks.synchronised, clocks.refused = 1, refused
    _take(state, sequence, relative, values, 0)
    clocks.late_run = 0
    state.events[0].resynchronised += 1
