"""Operating states: where the leg reference comes from, and how it changes hands.

    settled, return                the settled position, the bottom of the working stroke
    off, fault                     likewise; with valves closed, where the legs lie
    raise                          neutral
    hold                           where the reference came to rest
    engaged                        the host's demand, to the bit

Every change of state hands over position, velocity and acceleration of the reference, r0, v0 and
a0. With t the time since, the reference's own motion p comes to rest with the pole k = 4 / S,

    dp/dt = (v0 + (a0 + k v0) t) e^(-k t),    p(inf) = r0 + 2 v0 / k + a0 / k^2

and the new source h takes over within the fade D, with s(x) = 10 x^3 - 15 x^4 + 6 x^5:

    r = h + (1 - s(t / D)) (p - h)

s' and s'' vanish at both ends, so r has two continuous derivatives. It is a weighted mean: each leg
stays between its source and its own stop, whatever the source does, and

    |r'| <= max(|p'|, |h'|) + 1.875 |p - h| / D
    |r''| <= max(|p''|, |h''|) + 3.75 |p' - h'| / D + 5.7735 |p - h| / D^2

The stop is v0 S / 2 + a0 S^2 / 16 long. It obeys p''' + 2 k p'' + k^2 p' = 0, so that to start it
again in its course changes nothing: requests in turns, however fast, lead no further than that
beyond the hull of where the legs were and the source is.

S and D are the settings' least times, stretched where the terms that they divide would exceed the
speed and acceleration of the settings. With d = |p(inf) - h| and w = |h'| at the change, those of
the leg with the largest, so that all legs fade together:

    S >= 4 |v0| / (e acceleration),    D >= 1.875 d / speed,
    D >= (3.75 w + sqrt((3.75 w)^2 + 23.094 d acceleration)) / (2 acceleration)

A host that moves away in the fade widens |p - h|, and with it what the fade adds.

A request names a state; it is kept up until reached. `Request.ENGAGE` from off leads through
settled and raise. `Request.TRIP` leads from every state to fault: the reference stops, goes down to
the settled position, then the valve command fades to nothing. Fault is left to off by
`Request.RESET`, once the valves are closed and the legs lie still. Off leads to settled from where
a return may end or below, from further up to return. Raise and return that do not arrive in time
become faults, as does leaving off while a leg has no reading.
"""

from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.arrays import compiled_params, record_array
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Acceleration, Length, Speed, Time
from cmf_mj.core.settings import Loader, Settings
from cmf_mj.machine import models
from cmf_mj.machine.machine import Machine, load_machine

_SPEED_PEAK = 1.875  #: Largest s'.
_ACCELERATION_PEAK = 10.0 / np.sqrt(3.0)  #: Largest s''.


class StateSettings(Settings):
    """Times, rates and tolerances of the operating states."""

    raise_time: Time  #: Least fade from the stops to neutral.
    engage_time: Time  #: Least fade to the host's demand.
    hold_time: Time
    """Least fade to hold; it moves the legs where they would come to rest beyond the stroke."""
    return_time: Time  #: Least fade to the stops.
    fault_time: Time  #: Least fade to the stops after a fault.
    stop_time: Time  #: Least S of a stop, which is S / 2 times its first velocity long.
    valve_time: Time  #: Time in which the valve command is faded in or out.
    speed: Speed  #: Largest leg speed of a fade.
    acceleration: Acceleration  #: Largest leg acceleration of a fade, and of a stop.
    settled_tolerance: Length
    """Distance that a leg with closed valves may move and still lies where it lay."""
    arrival_tolerance: Length
    """Distance from neutral, or above the settled position, within which a leg has followed there;
    below are the mechanical stops."""
    arrival_timeout: Time  #: Time after the end of raise or return in which the legs must arrive.


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


class Phase(NamedTuple):
    """Where the state machine is."""

    code: int = 0  #: The `State`.
    time: float = 0.0  #: Time t since the last change [s].
    fade: float = 0.0  #: D of the fade [s].
    stop: float = 0.0  #: S of the stop [s].
    valve: float = 0.0  #: Phase of the valve fade, 0 to 1.
    gain: float = 0.0  #: Gain on the valve command, s of it.


class OperatingState(NamedTuple):
    """State of the state machine."""

    phase: np.recarray[Any, Any]  #: `Phase`, (1,).
    stop: NDArray[np.float64]  #: p(inf) [m], v0 [m/s] and a0 [m/s^2] of the fade, (3, n).
    hold: NDArray[np.float64]  #: Where hold, off and fault keep the reference [m], (n,).
    host: NDArray[np.float64]  #: The host's last position that was a number [m], (n,).


def make_states(
    settings: StateSettings | None = None, machine: str | Machine = models.CMF
) -> States:
    """Compile the settings, default the shipped ones, for stroke and control frame of a machine."""
    settings, carrier = settings or load_state_settings(), load_machine(machine)
    fades = {
        State.RAISE: settings.raise_time,
        State.HOLD: settings.hold_time,
        State.ENGAGED: settings.engage_time,
        State.RETURN: settings.return_time,
        State.FAULT: settings.fault_time,
    }
    return compiled_params(
        States,
        settings,
        fade=np.array([fades[state].si if state in fades else 0.0 for state in State]),
        travel=carrier.working_stroke,
        frame=carrier.frame,
    )


def start(states: States, code: State, position: ArrayLike) -> OperatingState:
    """State of a machine that has been in `code` for a long time.

    That is off, settled, hold or engaged; at the leg positions (n,) [m] it holds, or the host is.
    """
    if code not in (State.OFF, State.SETTLED, State.HOLD, State.ENGAGED):
        raise InputError(f"code: {code!r} is no state to start in")
    at = np.clip(np.array(position, dtype=float), -states.travel, states.travel)
    if code == State.OFF:
        at[:] = -states.travel
    gain = 0.0 if code == State.OFF else 1.0
    phase = record_array(Phase, [Phase(int(code), valve=gain, gain=gain)])
    return OperatingState(phase, np.zeros((3, at.size)), hold=at, host=at.copy())


@compiled
def smooth(x):  # type: ignore[no-untyped-def]
    """s, s' and s'' at x, at the nearer end outside 0 to 1."""
    x = min(max(x, 0.0), 1.0)
    y = 1.0 - x
    return x * x * x * (10.0 - 15.0 * x + 6.0 * x * x), 30.0 * x * x * y * y, 60.0 * x * y * (y - x)


@compiled
def _stopping(velocity, acceleration, time, duration):  # type: ignore[no-untyped-def]
    """p(t) - p(inf) and its first two derivatives."""
    pole = 4.0 / duration
    decay = np.exp(-pole * time)
    slope = (acceleration + pole * velocity) * decay
    rate = velocity * decay + slope * time
    return -(rate + slope / pole) / pole, rate, slope - pole * rate


@compiled
def _finite(demand, leg):  # type: ignore[no-untyped-def]
    here = np.isfinite(demand[0, leg]) and np.isfinite(demand[1, leg])
    return here and np.isfinite(demand[2, leg])


@compiled
def _source(states, state, leg, demand):  # type: ignore[no-untyped-def]
    """Position, velocity and acceleration of the present source."""
    code = state.phase[0].code
    if code == State.ENGAGED:
        if _finite(demand, leg):
            return demand[0, leg], demand[1, leg], demand[2, leg]
        return state.host[leg], 0.0, 0.0
    if code == State.RAISE:
        return 0.0, 0.0, 0.0
    if code == State.SETTLED or code == State.RETURN:
        return -states.travel, 0.0, 0.0
    return state.hold[leg], 0.0, 0.0


@compiled
def _near(measured, target, tolerance):  # type: ignore[no-untyped-def]
    """Whether all legs are; a position that is no number is nowhere near."""
    for leg in range(measured.shape[0]):
        if not abs(measured[leg] - target) <= tolerance:
            return False
    return True


@compiled
def _low(states, measured):  # type: ignore[no-untyped-def]
    """Whether all legs lie where a return may end, or below."""
    for leg in range(measured.shape[0]):
        if not measured[leg] <= states.arrival_tolerance - states.travel:
            return False
    return True


@compiled
def _lies(states, state, measured, leg):  # type: ignore[no-untyped-def]
    """Where off and fault keep the reference: settled while valves close and where legs are low."""
    if state.phase[0].valve > 0.0 or _low(states, measured):
        return -states.travel
    if np.isnan(measured[leg]):
        return state.hold[leg]
    return min(max(measured[leg], -states.travel), states.travel)


@compiled
def _moved(states, state, measured):  # type: ignore[no-untyped-def]
    """Whether a leg in off or fault no longer lies where the reference is kept."""
    if state.phase[0].code == State.OFF or state.phase[0].code == State.FAULT:
        for leg in range(measured.shape[0]):
            apart = _lies(states, state, measured, leg) - state.hold[leg]
            if abs(apart) > states.settled_tolerance:
                return True
    return False


@compiled
def _next(states, state, request, measured):  # type: ignore[no-untyped-def]
    """The state of the next frame."""
    phase = state.phase[0]
    code, done = phase.code, phase.time >= phase.fade
    late = phase.time >= phase.fade + states.arrival_timeout
    upwards = request == Request.RAISE or request == Request.ENGAGE
    downwards = request == Request.SETTLE or request == Request.OFF
    read = _near(measured, 0.0, np.inf)
    lies = done and read and phase.valve == 0.0 and not _moved(states, state, measured)
    if request == Request.TRIP:
        return State.FAULT.value
    if code == State.OFF:
        if upwards or request == Request.SETTLE:
            if _low(states, measured):
                return State.SETTLED.value
            if lies:
                return State.RETURN.value
            if not read:
                return State.FAULT.value
    elif code == State.SETTLED:
        if request == Request.OFF:
            return State.OFF.value
        if upwards and phase.valve == 1.0:
            return State.RAISE.value
    elif code == State.FAULT:
        if request == Request.RESET and lies:
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
        if done and _low(states, measured):
            return State.SETTLED.value
        if late:
            return State.FAULT.value
    elif request == Request.ENGAGE:
        return State.ENGAGED.value
    elif request == Request.RAISE and not (code == State.HOLD and not np.any(state.hold)):
        return State.RAISE.value
    return code


@compiled
def _enter(states, state, following, demand, measured, reference):  # type: ignore[no-untyped-def]
    """Change the state and set up the fade from the reference (3, n)."""
    legs, limit, phase = reference.shape[1], states.acceleration, state.phase[0]
    phase.code = following
    time = states.stop_time
    for leg in range(legs):
        time = max(time, 4.0 / np.e * abs(reference[1, leg]) / limit)
    far, swift = 0.0, 0.0
    for leg in range(legs):
        left, _, _ = _stopping(reference[1, leg], reference[2, leg], 0.0, time)
        state.stop[0, leg] = reference[0, leg] - left
        state.stop[1, leg], state.stop[2, leg] = reference[1, leg], reference[2, leg]
        if following == State.HOLD:
            state.hold[leg] = min(max(state.stop[0, leg], -states.travel), states.travel)
        elif following == State.OFF or following == State.FAULT:
            state.hold[leg] = _lies(states, state, measured, leg)
        position, velocity, _ = _source(states, state, leg, demand)
        far = max(far, abs(state.stop[0, leg] - position))
        swift = max(swift, 2.0 * _SPEED_PEAK * abs(velocity))
    both = swift + np.sqrt(swift * swift + 4.0 * _ACCELERATION_PEAK * far * limit)
    fade = max(states.fade[following], _SPEED_PEAK * far / states.speed)
    phase.time, phase.fade, phase.stop = 0.0, max(fade, 0.5 * both / limit, time), time


@compiled
def _fade_valve(states, state):  # type: ignore[no-untyped-def]
    """Renew the gain on the valve command.

    It rises unless off or in fault; it falls when off and at the end of a fault.
    """
    phase, change = state.phase[0], states.frame / states.valve_time
    valve, ended = phase.valve, phase.time >= phase.fade
    if phase.code == State.OFF or (phase.code == State.FAULT and ended):
        valve -= change
    elif phase.code != State.FAULT:
        valve += change
    phase.valve = min(max(valve, 0.0), 1.0)
    phase.gain, _, _ = smooth(phase.valve)


@compiled
def step(states, state, request, demand, measured, reference):  # type: ignore[no-untyped-def]
    """Write the reference (3, n) of one frame, position, velocity and acceleration [m].

    The host's demand (3, n) is likewise; one that is not finite is replaced by its last finite
    position at rest. `measured` (n,) are the sensors' leg positions [m]. Returned is the `State` of
    this frame; the valve command is to be multiplied by `gain` of the phase.
    """
    phase = state.phase[0]
    time, fade, stop = phase.time, phase.fade, phase.stop
    s, ds, dds = smooth(time / fade) if fade > 0.0 else (1.0, 0.0, 0.0)
    for leg in range(reference.shape[1]):
        position, velocity, acceleration = _source(states, state, leg, demand)
        if time < fade:
            left, rate, slowing = _stopping(state.stop[1, leg], state.stop[2, leg], time, stop)
            apart = state.stop[0, leg] + left - position
            parting = rate - velocity
            position += (1.0 - s) * apart
            velocity += (1.0 - s) * parting - ds / fade * apart
            acceleration += (1.0 - s) * (slowing - acceleration)
            acceleration -= 2.0 * ds / fade * parting + dds / (fade * fade) * apart
        reference[0, leg], reference[1, leg] = position, velocity
        reference[2, leg] = acceleration
        if _finite(demand, leg):
            state.host[leg] = demand[0, leg]
    following = _next(states, state, request, measured)
    if following != phase.code or _moved(states, state, measured):
        _enter(states, state, following, demand, measured, reference)
    _fade_valve(states, state)
    phase.time += states.frame
    return phase.code
