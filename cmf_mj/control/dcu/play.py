"""One control frame of the DCU: the demand at the play clock.

    base         the quintic between the two frames around the play clock; a stop where the later
                 one is missing
    correction   whenever the base is not where the demand is, the gap in pose, velocity and
                 acceleration is closed on top of the base
    limit        the pose is held within its bound
    line         whole frames of transport

A gap is taken up only if it is within the velocity and acceleration limits; otherwise the demand
goes on to rest, from where every stream can be taken up.
"""

from cmf_mj.control.dcu.acceptance import clear, drop_held
from cmf_mj.control.dcu.motion import (
    ACCELERATION,
    VELOCITY,
    add_correction,
    between,
    closing_time,
    copy,
    evaluate,
    hold_within,
    stop,
)
from cmf_mj.control.dcu.state import CAPACITY
from cmf_mj.core.compiled import compiled


@compiled
def step(dcu, state, demand):  # type: ignore[no-untyped-def]
    """Write the platform demand (3, 6) of this control frame.

    It is the pose [m, rad], z down, and its first and second derivatives.
    """
    clocks = state.clocks[0]
    _advance_segments(state)
    _base(dcu, state)
    copy(state.base, state.motion)
    add_correction(dcu, state.gap, clocks.closing, clocks.since_gap, state.motion)
    if clocks.synchronised and not clocks.moving:
        _rejoin(dcu, state)
    slot = clocks.slot
    hold_within(dcu, state.motion, state.line[slot])
    clocks.slot = (slot + 1) % (dcu.line + 1)
    copy(state.line[clocks.slot], demand)
    _advance_clocks(dcu, state)


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
    while state.clocks[0].moving and clocks.local >= clocks.duration:
        clocks.local -= clocks.duration
        _drop_first(state)
        if _continues(state):
            clocks.duration = _plan_quintic(state)
        else:
            _stop_from_first(state)


@compiled
def _stop_from_first(state):  # type: ignore[no-untyped-def]
    state.clocks[0].moving, state.clocks[0].used = 0, 1
    copy(state.frame[state.clocks[0].first], state.origin)


@compiled
def _base(dcu, state):  # type: ignore[no-untyped-def]
    """The base at the present time; in `base`."""
    if state.clocks[0].moving:
        evaluate(state.polynomial, state.clocks[0].duration, state.clocks[0].local, state.base)
    else:
        stop(dcu, state.origin, state.clocks[0].local, state.base)
    _to_real_time(state)


@compiled
def _to_real_time(state):  # type: ignore[no-untyped-def]
    """Turn derivatives over the play clock into derivatives over time."""
    fast, rate = 1.0 + state.clocks[0].slew, state.clocks[0].slew_rate
    for i in range(6):
        v = state.base[VELOCITY, i]
        state.base[VELOCITY, i] = v * fast
        state.base[ACCELERATION, i] = state.base[ACCELERATION, i] * fast * fast + v * rate


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
    else:
        stop(dcu, state.frame[first], local, state.base)
    _to_real_time(state)
    for row, limit in ((VELOCITY, dcu.velocity), (ACCELERATION, dcu.acceleration)):
        for i in range(6):
            if abs(state.motion[row, i] - state.base[row, i]) > limit[i]:
                return
    if goes_on:
        clocks.moving, clocks.duration = 1, duration
    else:
        _stop_from_first(state)
    clocks.local = local
    for row in range(3):
        for i in range(6):
            state.gap[row, i] = state.motion[row, i] - state.base[row, i]
    clocks.since_gap = 0.0
    clocks.closing = closing_time(dcu, state.gap)


@compiled
def _advance_clocks(dcu, state):  # type: ignore[no-untyped-def]
    """All clocks one frame on; the stream is stale after the timeout.

    The play clock's slew u is smoothed so that its time is twice differentiable:
    Tc^2 u'' + 2 Tc u' + u = target, integrated exactly for u'' constant in the frame.
    """
    clocks, frame = state.clocks[0], dcu.frame
    target = 0.0
    beyond = abs(clocks.lateness) - dcu.clock_tolerance
    if clocks.synchronised and beyond > 0.0:
        target = min(beyond / dcu.clock_time, dcu.clock_rate)
        if clocks.lateness > 0.0:
            target = -target
    time = dcu.slew_time
    bend = (target - clocks.slew - 2.0 * time * clocks.slew_rate) / (time * time)
    passed = frame * (
        1.0 + clocks.slew + 0.5 * frame * clocks.slew_rate + frame * frame * bend / 6.0
    )
    clocks.slew += frame * (clocks.slew_rate + 0.5 * frame * bend)
    clocks.slew_rate += frame * bend
    clocks.play += passed
    clocks.local += passed
    clocks.since_gap += frame
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
