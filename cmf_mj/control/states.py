"""Operating states: where the leg reference comes from, and how it changes hands.

    off, settled, return, fault    the settled position, the bottom of the working stroke
    raise                          neutral
    hold                           where the legs came to rest
    engaged                        the host's demand, to the bit

Every change of state hands over position, velocity and acceleration of the reference. With d the
differences of old and new source at the change, t the time since and s(x) = 10 x^3 - 15 x^4 + 6 x^5
(s' and s'' vanish at both ends), the reference is the new source plus

    (d_p + q(S)) (1 - s(t / D)) + q(t) - q(S)
    dq/dt = d_v (1 - 3 x^2 + 2 x^3) + d_a S (x - 2 x^2 + x^3),    x = t / S <= 1

so the difference in motion is taken out within the short stopping time S, the difference in
position within the long fade D, and the sum has two continuous derivatives. S and D are stretched
where they would exceed the speed and acceleration allowed to fades:

    S >= 1.5 |d_v| / acceleration,    D >= 1.875 |d_p + q(S)| / speed,
    D >= sqrt(5.7735 |d_p + q(S)| / acceleration)

all legs with the same S and D. The legs come to hold at the end of q, without any fade.

A request names a state; it is kept up until reached. `Request.ENGAGE` from off leads through
settled and raise. `Request.TRIP` leads from every state to fault: the reference stops, goes down to
the settled position, then the valve command fades to nothing. Fault is left to off by
`Request.RESET`, once the legs really lie on the stops. Raise and return that do not arrive in time
become faults.
"""

from enum import IntEnum
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Quantity, positive_in
from cmf_mj.core.settings import Loader, Settings
from cmf_mj.machine import models
from cmf_mj.machine.machine import Machine, load_machine

_SPEED_PEAK = 1.875
"""Largest s'."""
_ACCELERATION_PEAK = 10.0 / np.sqrt(3.0)
"""Largest s''."""


_Time = Annotated[Quantity, positive_in("s")]
_Length = Annotated[Quantity, positive_in("in", "m")]


class StateSettings(Settings):
    """Times, rates and tolerances of the operating states."""

    raise_time: _Time  #: Least fade from the stops to neutral.
    engage_time: _Time  #: Least fade to the host's demand.
    hold_time: _Time
    """Least fade to hold, where the legs would otherwise come to rest beyond the stroke."""
    return_time: _Time  #: Least fade to the stops.
    fault_time: _Time  #: Least fade to the stops after a fault.
    stop_time: _Time  #: Least time in which a difference in velocity is taken out.
    valve_time: _Time  #: Time in which the valve command is faded in or out.
    speed: Annotated[Quantity, positive_in("in/s", "m/s")]  #: Largest leg speed of a fade.
    acceleration: Annotated[Quantity, positive_in("g", "m/s^2", "in/s^2")]
    """Largest leg acceleration of a fade, and of a stop."""
    settled_tolerance: _Length
    """Distance from the settled position within which a leg without command lies on the stops."""
    arrival_tolerance: _Length
    """Distance from neutral or the settled position within which a leg has followed there."""
    arrival_timeout: _Time  #: Time after the end of raise or return in which the legs must arrive.


load_state_settings = Loader(StateSettings, Path(__file__).with_name("states.toml"))
"""Loads the settings of the operating states."""


class State(IntEnum):
    """Operating states."""

    OFF = 0  #: Valves closed, no command.
    SETTLED = 1  #: On the stops, valve command faded in.
    RAISE = 2  #: On the way to neutral.
    HOLD = 3  #: At rest anywhere above the stops.
    ENGAGED = 4  #: Following the host.
    RETURN = 5  #: On the way to the stops.
    FAULT = 6  #: Stopping, going down, then without command.


class Request(IntEnum):
    """What the operator wants."""

    NONE = 0  #: Stay, or end what has begun.
    OFF = 1  #: Off; above the stops return first.
    SETTLE = 2  #: Settled on the stops.
    RAISE = 3  #: Hold at neutral.
    HOLD = 4  #: Stop here; on the stops and in fault nothing.
    ENGAGE = 5  #: Follow the host.
    TRIP = 6  #: Fault.
    RESET = 7  #: From fault to off.


class States(NamedTuple):
    """Compiled parameters, SI."""

    fade: NDArray[np.float64]  #: Least fade into each state [s], (7,).
    stop_time: float  #: Least S [s].
    valve_time: float  #: Fade of the valve command [s].
    speed: float  #: Largest speed of a fade [m/s].
    acceleration: float  #: Largest acceleration of a fade [m/s^2].
    travel: float  #: Working stroke either way [m]; settled is its lower end.
    settled_tolerance: float  #: [m].
    arrival_tolerance: float  #: [m].
    arrival_timeout: float  #: [s].
    frame: float  #: T [s].


class OperatingState(NamedTuple):
    """State of the state machine."""

    code: NDArray[np.int64]  #: The `State`, (1,).
    clock: NDArray[np.float64]  #: Time t since the last change, D and S of its fade [s], (3,).
    valve: NDArray[np.float64]
    """Phase of the valve fade, 0 to 1, and the gain on the valve command, s of it, (2,)."""
    offset: NDArray[np.float64]  #: d_p + q(S) [m], d_v [m/s] and d_a [m/s^2] of the fade, (3, n).
    hold: NDArray[np.float64]  #: Where hold keeps the legs [m], (n,).
    host: NDArray[np.float64]  #: The host's last position that was a number [m], (n,).


def make_states(
    settings: StateSettings | None = None, machine: str | Machine = models.CMF
) -> States:
    """Compile the settings, default the shipped ones, for stroke and control frame of a machine."""
    settings, carrier = settings or load_state_settings(), load_machine(machine)
    fade = np.zeros(len(State))
    fade[State.RAISE] = settings.raise_time.si
    fade[State.HOLD] = settings.hold_time.si
    fade[State.ENGAGED] = settings.engage_time.si
    fade[State.RETURN] = settings.return_time.si
    fade[State.FAULT] = settings.fault_time.si
    return States(
        fade=fade,
        stop_time=settings.stop_time.si,
        valve_time=settings.valve_time.si,
        speed=settings.speed.si,
        acceleration=settings.acceleration.si,
        travel=carrier.working_stroke,
        settled_tolerance=settings.settled_tolerance.si,
        arrival_tolerance=settings.arrival_tolerance.si,
        arrival_timeout=settings.arrival_timeout.si,
        frame=carrier.frame,
    )


def start(states: States, code: State, position: ArrayLike) -> OperatingState:
    """State of a machine that has been in `code` for a long time.

    That is off, settled, hold or engaged; at the leg positions (n,) [m] it holds, or the host is.
    """
    if code not in (State.OFF, State.SETTLED, State.HOLD, State.ENGAGED):
        raise InputError(f"code: {State(code).name} is no state to start in")
    at = np.clip(np.array(position, dtype=float), -states.travel, states.travel)
    gain = 0.0 if code == State.OFF else 1.0
    return OperatingState(
        code=np.array([int(code)]),
        clock=np.zeros(3),
        valve=np.full(2, gain),
        offset=np.zeros((3, at.size)),
        hold=at,
        host=at.copy(),
    )


@compiled
def smooth(x):  # type: ignore[no-untyped-def]
    """s, s' and s'' at x, at the nearer end outside 0 to 1."""
    x = min(max(x, 0.0), 1.0)
    y = 1.0 - x
    return x * x * x * (10.0 - 15.0 * x + 6.0 * x * x), 30.0 * x * x * y * y, 60.0 * x * y * (y - x)


@compiled
def _stopping(velocity, acceleration, time, duration):  # type: ignore[no-untyped-def]
    """q(t) - q(S) and its first two derivatives."""
    if time >= duration:
        return 0.0, 0.0, 0.0
    x = time / duration
    y = 1.0 - x
    ramp = acceleration * duration
    # Integrals from x to 1, factored so that they vanish exactly at 1.
    left = velocity * 0.5 * y * y * y * (1.0 + x) + ramp * y * y * y * (1.0 + 3.0 * x) / 12.0
    rate = velocity * y * y * (1.0 + 2.0 * x) + ramp * x * y * y
    change = (-6.0 * velocity * x * y + ramp * y * (1.0 - 3.0 * x)) / duration
    return -left * duration, rate, change


@compiled
def _finite(demand, leg):  # type: ignore[no-untyped-def]
    here = np.isfinite(demand[0, leg]) and np.isfinite(demand[1, leg])
    return here and np.isfinite(demand[2, leg])


@compiled
def _source(states, state, leg, demand):  # type: ignore[no-untyped-def]
    """Position, velocity and acceleration of the present source."""
    code = state.code[0]
    if code == State.ENGAGED:
        if _finite(demand, leg):
            return demand[0, leg], demand[1, leg], demand[2, leg]
        return state.host[leg], 0.0, 0.0
    if code == State.RAISE:
        return 0.0, 0.0, 0.0
    if code == State.HOLD:
        return state.hold[leg], 0.0, 0.0
    return -states.travel, 0.0, 0.0


@compiled
def _near(measured, target, tolerance):  # type: ignore[no-untyped-def]
    """Whether all legs are; a position that is no number is nowhere near."""
    for leg in range(measured.shape[0]):
        if not abs(measured[leg] - target) <= tolerance:
            return False
    return True


@compiled
def _next(states, state, request, measured):  # type: ignore[no-untyped-def]
    """The state of the next frame."""
    code = state.code[0]
    time, fade, stop = state.clock
    done = time >= max(fade, stop)
    late = time >= max(fade, stop) + states.arrival_timeout
    upwards = request == Request.RAISE or request == Request.ENGAGE
    downwards = request == Request.SETTLE or request == Request.OFF
    settled = _near(measured, -states.travel, states.settled_tolerance)
    if request == Request.TRIP:
        return State.FAULT.value
    if code == State.OFF:
        if settled and (upwards or request == Request.SETTLE):
            return State.SETTLED.value
    elif code == State.SETTLED:
        if request == Request.OFF:
            return State.OFF.value
        if upwards and state.valve[0] == 1.0:
            return State.RAISE.value
    elif code == State.FAULT:
        if request == Request.RESET and done and settled and state.valve[0] == 0.0:
            return State.OFF.value
    elif downwards and code != State.RETURN:
        return State.RETURN.value
    elif request == Request.HOLD and code != State.HOLD:
        return State.HOLD.value
    elif code == State.RAISE:
        if done and _near(measured, 0.0, states.arrival_tolerance):
            return State.ENGAGED.value if request == Request.ENGAGE else State.HOLD.value
        if late:
            return State.FAULT.value
    elif code == State.RETURN:
        if upwards:
            return State.RAISE.value
        if done and _near(measured, -states.travel, states.arrival_tolerance):
            return State.SETTLED.value
        if late:
            return State.FAULT.value
    elif request == Request.ENGAGE:
        return State.ENGAGED.value
    elif request == Request.RAISE and not (code == State.HOLD and not np.any(state.hold)):
        return State.RAISE.value
    return code


@compiled
def _enter(states, state, following, demand, reference):  # type: ignore[no-untyped-def]
    """Change the state and set up the fade from the reference (3, n)."""
    legs = reference.shape[1]
    state.code[0] = following
    swift = 0.0
    for leg in range(legs):
        _, velocity, _ = _source(states, state, leg, demand)
        swift = max(swift, abs(reference[1, leg] - velocity))
    stop = max(states.stop_time, 1.5 * swift / states.acceleration)
    far = 0.0
    for leg in range(legs):
        if following == State.HOLD:
            left, _, _ = _stopping(reference[1, leg], reference[2, leg], 0.0, stop)
            state.hold[leg] = min(max(reference[0, leg] - left, -states.travel), states.travel)
        position, velocity, change = _source(states, state, leg, demand)
        state.offset[1, leg] = reference[1, leg] - velocity
        state.offset[2, leg] = reference[2, leg] - change
        left, _, _ = _stopping(state.offset[1, leg], state.offset[2, leg], 0.0, stop)
        # q(0) - q(S) is `left`, so that the difference in position is the sum of both parts.
        state.offset[0, leg] = reference[0, leg] - position - left
        far = max(far, abs(state.offset[0, leg]))
    fade = max(states.fade[following], _SPEED_PEAK * far / states.speed)
    state.clock[0] = 0.0
    state.clock[1] = max(fade, np.sqrt(_ACCELERATION_PEAK * far / states.acceleration))
    state.clock[2] = stop


@compiled
def _fade_valve(states, state):  # type: ignore[no-untyped-def]
    """Renew the gain on the valve command.

    It rises unless off or in fault; it falls when off and at the end of a fault.
    """
    code = state.code[0]
    phase = state.valve[0]
    ended = state.clock[0] >= max(state.clock[1], state.clock[2])
    if code == State.OFF or (code == State.FAULT and ended):
        phase -= states.frame / states.valve_time
    elif code != State.FAULT:
        phase += states.frame / states.valve_time
    state.valve[0] = min(max(phase, 0.0), 1.0)
    state.valve[1], _, _ = smooth(state.valve[0])


@compiled
def step(states, state, request, demand, measured, reference):  # type: ignore[no-untyped-def]
    """Write the reference (3, n) of one frame, position, velocity and acceleration [m].

    The host's demand (3, n) is likewise; one that is not finite is replaced by its last finite
    position at rest. `measured` (n,) are the sensors' leg positions [m]. Returned is the `State` of
    this frame; the valve command is to be multiplied by `state.valve[1]`.
    """
    time, fade, stop = state.clock
    s, ds, dds = smooth(time / fade) if fade > 0.0 else (1.0, 0.0, 0.0)
    for leg in range(reference.shape[1]):
        position, velocity, change = _source(states, state, leg, demand)
        if time < max(fade, stop):
            far = state.offset[0, leg]
            left, rate, bend = _stopping(state.offset[1, leg], state.offset[2, leg], time, stop)
            position += far * (1.0 - s) + left
            velocity += rate
            change += bend
            if fade > 0.0:
                velocity -= far * ds / fade
                change -= far * dds / (fade * fade)
        reference[0, leg], reference[1, leg], reference[2, leg] = position, velocity, change
        if _finite(demand, leg):
            state.host[leg] = demand[0, leg]
    following = _next(states, state, request, measured)
    if following != state.code[0]:
        _enter(states, state, following, demand, reference)
    _fade_valve(states, state)
    state.clock[0] += states.frame
    return state.code[0]
