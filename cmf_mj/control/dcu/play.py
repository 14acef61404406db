"""One control frame of the DCU: the demand at the play clock.

    base         the quintic between the two frames around the play clock; a stop where the later
                 one is missing; where derivatives are left aside, the filter of poses
    gap          whenever the base is not where the demand is, the gap in pose, velocity and
                 acceleration is closed on top of the base
    limit        the pose is held within its bound
    line         whole frames of transport

A gap is taken up only if it is within the velocity and acceleration limits; otherwise the demand
goes on to rest, from where every stream can be taken up.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.acceptance import clear, drop_held, receive, to_real_time
from cmf_mj.control.dcu.motion import (
    ACCELERATION,
    DOF_COUNT,
    POSE,
    VELOCITY,
    add,
    between,
    close_gap,
    copy,
    evaluate,
    hold_within,
    smooth_poses,
    stop,
    subtract,
)
from cmf_mj.control.dcu.state import CAPACITY, Dcu, DcuState
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError

RANGE_SHARE, RANGE_FLOOR = 0.1, 1e-3
"""How far beyond the host's range the demand may be, besides the way to stop: share of the range,
and [m, rad]."""

_STRAYED = 20  #: Control frames beyond the host's range that are no fault yet.

CLOCK_DRIFT = 5e-3  #: Drift of clocks that is not worth remembering.


@compiled
def step(dcu, state, demand):  # type: ignore[no-untyped-def]
    """Write the platform demand (3, 6) of this control frame.

    It is the pose [m, rad], z down, and its first and second derivatives.
    """
    clocks = state.clocks[0]
    _advance_segments(state)
    _base(dcu, state)
    add(state.base, state.gap, state.motion)
    if clocks.synchronised and not clocks.moving:
        _rejoin(dcu, state)
    if clocks.smoothing != clocks.poses:  # between quintics and filter of poses, if they are near
        clocks.smoothing = clocks.poses
        _base(dcu, state)
        if _near(dcu, state):
            subtract(state.motion, state.base, state.gap)
        else:
            clocks.smoothing = 1 - clocks.poses
    clocks.beyond = clocks.beyond + 1 if _beyond(dcu, state) else 0
    slot = clocks.slot
    hold_within(dcu, state.motion, state.line[slot])
    clocks.slot = (slot + 1) % (dcu.line + 1)
    copy(state.line[clocks.slot], demand)
    _advance_clocks(dcu, state)


@compiled
def strayed(state):  # type: ignore[no-untyped-def]
    """Whether the demand has left the host's range for long enough to be a fault."""
    return state.clocks[0].beyond > _STRAYED


@compiled
def _near(dcu, state):  # type: ignore[no-untyped-def]
    """Whether base and demand are as near in velocity and acceleration as a gap may be."""
    for row, limit in ((VELOCITY, dcu.velocity), (ACCELERATION, dcu.acceleration)):
        for i in range(DOF_COUNT):
            if abs(state.motion[row, i] - state.base[row, i]) > limit[i]:
                return False
    return True


@compiled
def _beyond(dcu, state):  # type: ignore[no-untyped-def]
    """Whether the demand is beyond the poses of the last second, with a share and the way to stop.

    While a gap closes at its speed, the demand on its way belongs to the range.
    """
    now, before = state.second, state.earlier
    for i in range(DOF_COUNT):
        pose = state.motion[POSE, i]
        if abs(state.gap[POSE, i]) > dcu.gap_range[i]:
            now.least[i] = min(now.least[i], pose)
            now.most[i] = max(now.most[i], pose)
        least, most = min(now.least[i], before.least[i]), max(now.most[i], before.most[i])
        stop = max(now.stop[i], before.stop[i])
        wide = RANGE_SHARE * (most - least) + stop + RANGE_FLOOR
        if not least - wide <= pose <= most + wide:
            return True
    return False


@compiled
def _drop_first(state):  # type: ignore[no-untyped-def]
    state.clocks[0].first = (state.clocks[0].first + 1) % CAPACITY
    state.clocks[0].buffered -= 1


@compiled
def _continues(state):  # type: ignore[no-untyped-def]
    """Whether the buffer holds a quintic from its oldest frame on."""
    return state.clocks[0].buffered > 1 and not state.apart[(state.clocks[0].first + 1) % CAPACITY]


@compiled
def _plan_quintic(state):  # type: ignore[no-untyped-def]
    """Lay the quintic from the oldest buffered frame to the next; returns its length."""
    first = state.clocks[0].first
    second = (first + 1) % CAPACITY
    duration = state.time[second] - state.time[first]
    between(state.frame[first], state.frame[second], duration, state.polynomial)
    return duration


@compiled
def _advance_segments(state):  # type: ignore[no-untyped-def]
    """At the end of a quintic go over to the next, or to the stop from its last frame."""
    clocks = state.clocks[0]
    while clocks.moving and clocks.local >= clocks.duration:
        clocks.local -= clocks.duration
        _drop_first(state)
        if _continues(state):
            clocks.duration = _plan_quintic(state)
        else:
            _stop_from_first(state, clocks.local)


@compiled
def _stop_from_first(state, since):  # type: ignore[no-untyped-def]
    """Begin the stop of the oldest buffered frame, its turn a time of the play clock ago [s]."""
    clocks = state.clocks[0]
    clocks.moving, clocks.used = 0, 1
    copy(state.frame[clocks.first], state.origin)
    to_real_time(state, state.origin)
    clocks.local = since / (1.0 + clocks.slew)


@compiled
def _base(dcu, state):  # type: ignore[no-untyped-def]
    """The base at the present time; in `base`."""
    clocks = state.clocks[0]
    if clocks.smoothing:
        copy(state.smoothed, state.base)
    elif clocks.moving:
        evaluate(state.polynomial, clocks.duration, clocks.local, state.base)
        to_real_time(state, state.base)
    else:
        stop(dcu, state.origin, clocks.local, state.base)


@compiled
def _pose(state):  # type: ignore[no-untyped-def]
    """The pose on the straight line between frames, at its end without a later one; in `input`."""
    clocks = state.clocks[0]
    if not (clocks.moving or clocks.used):
        return
    first, share = clocks.first, clocks.local / clocks.duration if clocks.moving else 0.0
    last = (first + 1) % CAPACITY
    for i in range(DOF_COUNT):
        before = state.frame[first, POSE, i]
        step = state.frame[last, POSE, i] - before if clocks.moving else 0.0
        state.input[i] = before + share * step


@compiled
def _rejoin(dcu, state):  # type: ignore[no-untyped-def]
    """Take the stream up again if the buffer says how it goes on and the gap allows it."""
    clocks = state.clocks[0]
    while clocks.buffered > 1 and state.time[(clocks.first + 1) % CAPACITY] <= clocks.play:
        _drop_first(state)
        clocks.used = 0
    first, goes_on = clocks.first, _continues(state)
    local = clocks.play - state.time[first]
    if clocks.buffered == 0 or local < 0.0 or (clocks.used and not goes_on):
        return
    duration = 0.0
    if goes_on:
        duration = _plan_quintic(state)
        evaluate(state.polynomial, duration, local, state.base)
        to_real_time(state, state.base)
    else:
        copy(state.frame[first], state.base)
        to_real_time(state, state.base)
        stop(dcu, state.base, local / (1.0 + clocks.slew), state.base)
    if not (clocks.smoothing or _near(dcu, state)):
        return
    waited = clocks.local
    if goes_on:
        clocks.moving, clocks.duration, clocks.local = 1, duration, local
    else:
        _stop_from_first(state, local)
    if state.apart[first] or waited > dcu.hold:
        # Take the filter of poses along where its input jumps: the gap closes the jump.
        for i in range(DOF_COUNT):
            state.smoothed[POSE, i] -= state.input[i]
        _pose(state)
        for i in range(DOF_COUNT):
            state.smoothed[POSE, i] += state.input[i]
        state.apart[first] = 0
    if clocks.smoothing:
        _base(dcu, state)
    subtract(state.motion, state.base, state.gap)


@compiled
def _target(dcu, clocks):  # type: ignore[no-untyped-def]
    """The slew asked of the play clock: that of a critically damped loop on the host's lateness x.

    u = -2 x / Tc - d,    d' = x / Tc^2,    x = the mean lateness beyond the tolerance

    While x is 0, a drift d as small as that of any clock is forgotten: 2 x / Tc makes up for it.
    """
    beyond = max(abs(clocks.lateness) - dcu.clock_tolerance, 0.0) / dcu.clock_time
    if clocks.lateness < 0.0:
        beyond = -beyond
    change = beyond
    if beyond == 0.0 and abs(clocks.drift) < CLOCK_DRIFT:
        change = -clocks.drift
    clocks.drift += dcu.frame * change / dcu.clock_time
    clocks.drift = min(max(clocks.drift, -dcu.clock_rate), dcu.clock_rate)
    return min(max(-2.0 * beyond - clocks.drift, -dcu.clock_rate), dcu.clock_rate)


@compiled
def _advance_clocks(dcu, state):  # type: ignore[no-untyped-def]
    """All clocks one frame on; the stream is stale after the timeout.

    The play clock's slew u is smoothed so that its time is twice differentiable:
    Ts^2 u'' + 2 Ts u' + u = target, integrated exactly for u'' constant in the frame.
    """
    _pose(state)
    smooth_poses(dcu, state.input, state.smoothed)
    close_gap(dcu, state.gap)
    clocks, frame = state.clocks[0], dcu.frame
    target = _target(dcu, clocks) if clocks.synchronised else 0.0
    time = dcu.slew_time
    bend = (target - clocks.slew - 2.0 * time * clocks.slew_rate) / (time * time)
    passed = frame * (
        1.0 + clocks.slew + 0.5 * frame * clocks.slew_rate + frame * frame * bend / 6.0
    )
    clocks.slew += frame * (clocks.slew_rate + 0.5 * frame * bend)
    clocks.slew_rate += frame * bend
    clocks.play += passed
    clocks.local += passed if clocks.moving else frame
    clocks.window += frame
    if clocks.window >= 1.0 and clocks.synchronised:
        # Another second of the host's range begins, at the pose of now.
        clocks.window = 0.0
        now, before = state.second, state.earlier
        for i in range(DOF_COUNT):
            before.least[i], before.most[i], before.stop[i] = now.least[i], now.most[i], now.stop[i]
            now.least[i], now.most[i], now.stop[i] = state.input[i], state.input[i], 0.0
    clocks.silence += frame
    clocks.held_age += frame
    clocks.late_age += frame
    if clocks.holding and clocks.held_age > dcu.timeout:
        drop_held(state)
    if clocks.synchronised and clocks.silence > dcu.timeout:
        clear(state)
        clocks.synchronised = 0
        clocks.stale = 1
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
def _run(dcu, state, arrivals, demand):  # type: ignore[no-untyped-def]
    cursor = 0
    for frame in range(demand.shape[0]):
        cursor = feed(dcu, state, arrivals, cursor, frame)
        step(dcu, state, demand[frame])


def upsample(dcu: Dcu, state: DcuState, arrivals: Arrivals, frames: int) -> NDArray[np.float64]:
    """Run a DCU over control frames 0 to `frames` - 1, from `resting` or as left before.

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
    _run(dcu, state, arrivals, demand)
    return demand
