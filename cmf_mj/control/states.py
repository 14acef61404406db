"""Operating states: which motion is the leg reference, and how it passes from one to another.

    settled, return                the settled position, the bottom of the working stroke
    off, fault                     likewise; with valves closed, where the legs lie
    raise                          neutral
    hold                           where the reference came to rest
    engaged                        the host's demand, to the bit

A change of state hands over position r0, velocity v0 and acceleration a0 of the reference. With t
the time since, the reference's own motion p comes to rest with the pole k = 4 / S,

    dp/dt = (v0 + (a0 + k v0) t) e^(-k t),    p(inf) = r0 + 2 v0 / k + a0 / k^2

and the new source h takes over within the fade D, with s(x) = 10 x^3 - 15 x^4 + 6 x^5:

    r = h + (1 - s(t / D)) (p - h)

s' and s'' vanish at both ends, so r has two continuous derivatives. It is a weighted mean: each leg
stays between its source and its own stop, whatever the source does, and

    |r'| <= max(|p'|, |h'|) + 1.875 |p - h| / D
    |r''| <= max(|p''|, |h''|) + 3.75 |p' - h'| / D + 5.7735 |p - h| / D^2

The stop is v0 S / 2 + a0 S^2 / 16 long. It obeys p''' + 2 k p'' + k^2 p' = 0, so that to start it
again in its course changes nothing: however fast requests change, legs go no further than that
beyond the hull of where they were and the source is.

S and D are the least times of the settings, longer where the speed and acceleration of the settings
ask for it. With d = |p(inf) - h| and w = |h'| the largest of all legs, which fade together:

    S >= 4 |v0| / (e acceleration),    D >= 1.875 d / speed,
    D >= (3.75 w + sqrt((3.75 w)^2 + 23.094 d acceleration)) / (2 acceleration)

A host that moves away in the fade widens |p - h|, and with it what the fade adds.

A request names a state; it is kept up until reached. `Request.ENGAGE` from off leads through
settled and raise. `Request.TRIP` leads from every state to fault: the reference stops, goes down to
the settled position, then the valve command fades to nothing. `Request.RESET` leads from fault to
off, once the valves are closed and the legs lie still. Off leads to settled from where a return may
end or below, else to return. A late raise or return is a fault, as is a leg unread when off ends.
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
    hold_time: Time  #: Least fade to hold, which moves legs that would rest beyond the stroke.
    return_time: Time  #: Least fade to the stops.
    fault_time: Time  #: Least fade to the stops after a fault.
    stop_time: Time  #: Least S of a stop, which is S / 2 times its first velocity long.
    valve_time: Time  #: Time in which the valve command is faded in or out.
    speed: Speed  #: Largest leg speed of a fade.
    acceleration: Acceleration  #: Largest leg acceleration of a fade, and of a stop.
    settled_tolerance: Length  #: Distance that a leg with closed valves may move and lies still.
    arrival_tolerance: Length
    """Distance from neutral, or above the settled position, within which a leg is there."""
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
    fade_time: float = 0.0  #: D of the fade [s].
    stop_time: float = 0.0  #: S of the stop [s].
    valve_phase: float = 0.0  #: Phase of the valve fade, 0 to 1.
    gain: float = 0.0  #: Gain on the valve command, s of that phase.


class OperatingState(NamedTuple):
    """State of the state machine."""

    phase: np.recarray[Any, Any]  #: `Phase`, (1,).
    stop_end: NDArray[np.float64]  #: p(inf) of the stop [m], (n,).
    stop_velocity: NDArray[np.float64]  #: v0 of the stop [m/s], (n,).
    stop_acceleration: NDArray[np.float64]  #: a0 of the stop [m/s^2], (n,).
    hold_position: NDArray[np.float64]  #: Where hold, off and fault keep the reference [m], (n,).
    host_position: NDArray[np.float64]  #: The host's last position that was a number [m], (n,).


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
    extension = np.clip(np.array(position, dtype=float), -states.travel, states.travel)
    if code == State.OFF:
        extension[:] = -states.travel
    gain = 0.0 if code == State.OFF else 1.0
    phase = record_array(Phase, [Phase(int(code), valve_phase=gain, gain=gain)])
    stop_end, stop_velocity, stop_acceleration = np.zeros((3, extension.size))
    return OperatingState(
        phase, stop_end, stop_velocity, stop_acceleration, extension, extension.copy()
    )


@compiled
def smooth_step(x):  # type: ignore[no-untyped-def]
    """s, s' and s'' at x, at the nearer end outside 0 to 1."""
    x = min(max(x, 0.0), 1.0)
    y = 1.0 - x
    return x * x * x * (10.0 - 15.0 * x + 6.0 * x * x), 30.0 * x * x * y * y, 60.0 * x * y * (y - x)


@compiled
def _stop_motion(velocity, acceleration, time, stop_time):  # type: ignore[no-untyped-def]
    """p(t) - p(inf) and its first two derivatives."""
    pole = 4.0 / stop_time
    decay = np.exp(-pole * time)
    slope = (acceleration + pole * velocity) * decay
    rate = velocity * decay + slope * time
    return -(rate + slope / pole) / pole, rate, slope - pole * rate


@compiled
def _demand_is_finite(demand, leg):  # type: ignore[no-untyped-def]
    """Whether position, velocity and acceleration that the host demands of a leg are numbers."""
    for row in range(3):
        if not np.isfinite(demand[row, leg]):
            return False
    return True


@compiled
def _source_motion(states, state, leg, demand):  # type: ignore[no-untyped-def]
    """Position, velocity and acceleration of the present state's source h."""
    code = state.phase[0].code
    if code == State.ENGAGED:
        if _demand_is_finite(demand, leg):
            return demand[0, leg], demand[1, leg], demand[2, leg]
        return state.host_position[leg], 0.0, 0.0
    if code == State.RAISE:
        return 0.0, 0.0, 0.0
    if code == State.SETTLED or code == State.RETURN:
        return -states.travel, 0.0, 0.0
    return state.hold_position[leg], 0.0, 0.0


@compiled
def _all_near_neutral(measured, tolerance):  # type: ignore[no-untyped-def]
    """Whether all legs are near neutral; a position that is no number is nowhere near."""
    for leg in range(measured.shape[0]):
        if not abs(measured[leg]) <= tolerance:
            return False
    return True


@compiled
def _all_down(states, measured):  # type: ignore[no-untyped-def]
    """Whether all legs lie where a return may end, or below."""
    for leg in range(measured.shape[0]):
        if not measured[leg] <= states.arrival_tolerance - states.travel:
            return False
    return True


@compiled
def _lying_position(states, state, measured, leg):  # type: ignore[no-untyped-def]
    """Where off and fault keep a leg: settled while valves close and where all legs are down."""
    if state.phase[0].valve_phase > 0.0 or _all_down(states, measured):
        return -states.travel
    if np.isnan(measured[leg]):
        return state.hold_position[leg]
    return min(max(measured[leg], -states.travel), states.travel)


@compiled
def _has_moved(states, state, measured):  # type: ignore[no-untyped-def]
    """Whether a leg in off or fault no longer lies where the reference is kept."""
    if state.phase[0].code == State.OFF or state.phase[0].code == State.FAULT:
        for leg in range(measured.shape[0]):
            distance = _lying_position(states, state, measured, leg) - state.hold_position[leg]
            if abs(distance) > states.settled_tolerance:
                return True
    return False


@compiled
def _all_lie_still(states, state, measured):  # type: ignore[no-untyped-def]
    """Whether in off or fault the valves are closed and all legs lie where they lay."""
    phase = state.phase[0]
    is_closed = phase.time >= phase.fade_time and phase.valve_phase == 0.0
    is_read = _all_near_neutral(measured, np.inf)
    return is_closed and is_read and not _has_moved(states, state, measured)


@compiled
def _next_state(states, state, request, measured):  # type: ignore[no-untyped-def]
    """The state of the next frame."""
    phase = state.phase[0]
    code, has_faded = phase.code, phase.time >= phase.fade_time
    is_late = phase.time >= phase.fade_time + states.arrival_timeout
    leads_up = request == Request.RAISE or request == Request.ENGAGE
    leads_down = request == Request.SETTLE or request == Request.OFF
    if request == Request.TRIP:
        return State.FAULT.value
    if code == State.OFF:
        if not (leads_up or request == Request.SETTLE):
            return code
        if _all_down(states, measured):
            return State.SETTLED.value
        if _all_lie_still(states, state, measured):
            return State.RETURN.value
        return code if _all_near_neutral(measured, np.inf) else State.FAULT.value
    if code == State.SETTLED:
        if request == Request.OFF:
            return State.OFF.value
        return State.RAISE.value if leads_up and phase.valve_phase == 1.0 else code
    if code == State.FAULT:
        is_reset = request == Request.RESET and _all_lie_still(states, state, measured)
        return State.OFF.value if is_reset else code
    if leads_down and code != State.RETURN:
        return State.RETURN.value
    if request == Request.HOLD and code != State.HOLD:
        return State.HOLD.value
    if code == State.RAISE:
        if has_faded and _all_near_neutral(measured, states.arrival_tolerance):
            return State.ENGAGED.value if request == Request.ENGAGE else State.HOLD.value
        return State.FAULT.value if is_late else code
    if code == State.RETURN:
        if leads_up:
            return State.RAISE.value
        if has_faded and _all_down(states, measured):
            return State.SETTLED.value
        return State.FAULT.value if is_late else code
    if request == Request.ENGAGE:
        return State.ENGAGED.value
    is_neutral = code == State.HOLD and not np.any(state.hold_position)
    return State.RAISE.value if request == Request.RAISE and not is_neutral else code


@compiled
def _enter_state(states, state, code, demand, measured, reference):  # type: ignore[no-untyped-def]
    """Change the state to `code` and set up the fade from the reference (3, n)."""
    legs, limit, phase = reference.shape[1], states.acceleration, state.phase[0]
    phase.code, stop_time = code, states.stop_time
    for leg in range(legs):
        stop_time = max(stop_time, 4.0 / np.e * abs(reference[1, leg]) / limit)
    distance, speed_term = 0.0, 0.0
    for leg in range(legs):
        velocity, acceleration = reference[1, leg], reference[2, leg]
        remaining, _, _ = _stop_motion(velocity, acceleration, 0.0, stop_time)
        state.stop_end[leg] = reference[0, leg] - remaining
        state.stop_velocity[leg], state.stop_acceleration[leg] = velocity, acceleration
        if code == State.HOLD:
            state.hold_position[leg] = min(max(state.stop_end[leg], -states.travel), states.travel)
        elif code == State.OFF or code == State.FAULT:
            state.hold_position[leg] = _lying_position(states, state, measured, leg)
        source_position, source_velocity, _ = _source_motion(states, state, leg, demand)
        distance = max(distance, abs(state.stop_end[leg] - source_position))
        speed_term = max(speed_term, 2.0 * _SPEED_PEAK * abs(source_velocity))
    root = np.sqrt(speed_term * speed_term + 4.0 * _ACCELERATION_PEAK * distance * limit)
    fade_time = max(states.fade[code], _SPEED_PEAK * distance / states.speed)
    fade_time = max(fade_time, 0.5 * (speed_term + root) / limit, stop_time)
    phase.time, phase.fade_time, phase.stop_time = 0.0, fade_time, stop_time


@compiled
def _fade_valve(states, state):  # type: ignore[no-untyped-def]
    """Renew the valve gain: it falls when off or after a fault, stays in a fault, else rises."""
    phase, change = state.phase[0], states.frame / states.valve_time
    if phase.code == State.OFF or (phase.code == State.FAULT and phase.time >= phase.fade_time):
        change = -change
    elif phase.code == State.FAULT:
        change = 0.0
    phase.valve_phase = min(max(phase.valve_phase + change, 0.0), 1.0)
    phase.gain, _, _ = smooth_step(phase.valve_phase)


@compiled
def step(states, state, request, demand, measured, reference):  # type: ignore[no-untyped-def]
    """Write the reference (3, n) of one frame, position, velocity and acceleration [m].

    The host's demand (3, n) is likewise; one that is not finite is replaced by its last finite
    position at rest. `measured` (n,) are the sensors' leg positions [m]. Returned is the `State` of
    this frame; the valve command is to be multiplied by `gain` of the phase.
    """
    phase = state.phase[0]
    time, fade = phase.time, phase.fade_time
    s, ds, dds = smooth_step(time / fade) if fade > 0.0 else (1.0, 0.0, 0.0)
    for leg in range(reference.shape[1]):
        position, velocity, acceleration = _source_motion(states, state, leg, demand)
        if time < fade:
            remaining, stop_rate, stop_bend = _stop_motion(
                state.stop_velocity[leg], state.stop_acceleration[leg], time, phase.stop_time
            )
            gap = state.stop_end[leg] + remaining - position
            gap_rate = stop_rate - velocity
            position += (1.0 - s) * gap
            velocity += (1.0 - s) * gap_rate - ds / fade * gap
            acceleration += (1.0 - s) * (stop_bend - acceleration)
            acceleration -= 2.0 * ds / fade * gap_rate + dds / (fade * fade) * gap
        reference[0, leg], reference[1, leg], reference[2, leg] = position, velocity, acceleration
        if _demand_is_finite(demand, leg):
            state.host_position[leg] = demand[0, leg]
    code = _next_state(states, state, request, measured)
    if code != phase.code or _has_moved(states, state, measured):
        _enter_state(states, state, code, demand, measured, reference)
    _fade_valve(states, state)
    phase.time += states.frame
    return phase.code
