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
from cmf_mj.control.dcu.state import (
    CAPACITY,
    CLOSING,
    COUNT,
    DURATION,
    FIRST,
    HELD_AGE,
    HOLDING,
    LATE_AGE,
    LATENESS,
    LOCAL,
    MOVING,
    PLAY,
    SILENCE,
    SILENT,
    SINCE_GAP,
    SLEW,
    SLEW_RATE,
    SLOT,
    STALE,
    SYNCHRONISED,
    USED,
)
from cmf_mj.core.compiled import compiled
from cmf_mj.core.rates import FRAME


@compiled
def step(dcu, state, demand):  # type: ignore[no-untyped-def]
    """The platform demand of this control frame.

    Args:
        dcu: compiled parameters.
        state: changed in place.
        demand: (3, 6), overwritten: pose [m, rad], z down, its first and its second derivative.
    """
    real, whole = state.real, state.whole
    _advance_segments(state)
    _base(dcu, state)
    copy(state.base, state.motion)
    add_correction(dcu, state.gap, real[CLOSING], real[SINCE_GAP], state.motion)
    if whole[SYNCHRONISED] and not whole[MOVING]:
        _rejoin(dcu, state)
    slot = whole[SLOT]
    hold_within(dcu, state.motion, state.line[slot])
    whole[SLOT] = (slot + 1) % (dcu.line + 1)
    copy(state.line[whole[SLOT]], demand)
    _advance_clocks(dcu, state)


@compiled
def _drop_first(state):  # type: ignore[no-untyped-def]
    state.whole[FIRST] = (state.whole[FIRST] + 1) % CAPACITY
    state.whole[COUNT] -= 1


@compiled
def _continues(state):  # type: ignore[no-untyped-def]
    """Whether the buffer holds a quintic from its oldest frame on."""
    return state.whole[COUNT] > 1 and not state.apart[(state.whole[FIRST] + 1) % CAPACITY]


@compiled
def _plan_quintic(state):  # type: ignore[no-untyped-def]
    """Lay the quintic from the oldest buffered frame to the next; returns its length."""
    first = state.whole[FIRST]
    second = (first + 1) % CAPACITY
    duration = state.time[second] - state.time[first]
    between(state.frame[first], state.frame[second], duration, state.polynomial)
    return duration


@compiled
def _advance_segments(state):  # type: ignore[no-untyped-def]
    """At the end of a quintic go over to the next, or to the stop from its last frame."""
    real = state.real
    while state.whole[MOVING] and real[LOCAL] >= real[DURATION]:
        real[LOCAL] -= real[DURATION]
        _drop_first(state)
        if _continues(state):
            real[DURATION] = _plan_quintic(state)
        else:
            _stop_from_first(state)


@compiled
def _stop_from_first(state):  # type: ignore[no-untyped-def]
    state.whole[MOVING], state.whole[USED] = 0, 1
    copy(state.frame[state.whole[FIRST]], state.origin)


@compiled
def _base(dcu, state):  # type: ignore[no-untyped-def]
    """The base at the present time; in `base`."""
    if state.whole[MOVING]:
        evaluate(state.polynomial, state.real[DURATION], state.real[LOCAL], state.base)
    else:
        stop(dcu, state.origin, state.real[LOCAL], state.base)
    _to_real_time(state)


@compiled
def _to_real_time(state):  # type: ignore[no-untyped-def]
    """Turn derivatives over the play clock into derivatives over time."""
    fast, rate = 1.0 + state.real[SLEW], state.real[SLEW_RATE]
    for i in range(6):
        v = state.base[VELOCITY, i]
        state.base[VELOCITY, i] = v * fast
        state.base[ACCELERATION, i] = state.base[ACCELERATION, i] * fast * fast + v * rate


@compiled
def _rejoin(dcu, state):  # type: ignore[no-untyped-def]
    """Take the stream up again if the buffer says how it goes on and the gap allows it."""
    real, whole = state.real, state.whole
    while whole[COUNT] > 1 and state.time[(whole[FIRST] + 1) % CAPACITY] <= real[PLAY]:
        _drop_first(state)
        whole[USED] = 0
    first, goes_on = whole[FIRST], _continues(state)
    local = real[PLAY] - state.time[first]
    if whole[COUNT] == 0 or local < 0.0 or (whole[USED] and not goes_on):
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
        whole[MOVING], real[DURATION] = 1, duration
    else:
        _stop_from_first(state)
    real[LOCAL] = local
    for row in range(3):
        for i in range(6):
            state.gap[row, i] = state.motion[row, i] - state.base[row, i]
    real[SINCE_GAP] = 0.0
    real[CLOSING] = closing_time(dcu, state.gap)


@compiled
def _advance_clocks(dcu, state):  # type: ignore[no-untyped-def]
    """All clocks one frame on; the stream is stale after the timeout.

    The play clock's slew u is smoothed so that its time is twice differentiable:
    Tc^2 u'' + 2 Tc u' + u = target, integrated exactly for u'' constant in the frame.
    """
    real, whole = state.real, state.whole
    target = 0.0
    beyond = abs(real[LATENESS]) - dcu.clock_tolerance
    if whole[SYNCHRONISED] and beyond > 0.0:
        target = min(beyond / dcu.clock_time, dcu.clock_rate)
        if real[LATENESS] > 0.0:
            target = -target
    time = dcu.slew_time
    bend = (target - real[SLEW] - 2.0 * time * real[SLEW_RATE]) / (time * time)
    passed = FRAME * (1.0 + real[SLEW] + 0.5 * FRAME * real[SLEW_RATE] + FRAME * FRAME * bend / 6.0)
    real[SLEW] += FRAME * (real[SLEW_RATE] + 0.5 * FRAME * bend)
    real[SLEW_RATE] += FRAME * bend
    real[PLAY] += passed
    real[LOCAL] += passed
    real[SINCE_GAP] += FRAME
    real[SILENCE] += FRAME
    real[HELD_AGE] += FRAME
    real[LATE_AGE] += FRAME
    if whole[HOLDING] and real[HELD_AGE] > dcu.timeout:
        drop_held(state)
    if whole[SYNCHRONISED] and real[SILENCE] > dcu.timeout:
        clear(state)
        whole[SYNCHRONISED] = 0
        whole[STALE] = 1
        state.events[SILENT] += 1
