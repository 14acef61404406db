"""The plan: command and motion from a model of the actuator, within what the actuator can do.

A leg, or a hydraulic mode (`cmf_mj.control.coordinates`), of speed k, drive lag a, valve lag b,
frequency w and damping ratio z answers to a command u as

    D(d/dt) p = k u,    D(s) = s (1 + s/a) (1 + s/b) (1 + 2 z s/w + s^2/w^2).

The plan runs that model in the law, in its phase variables x = (p, p', .., p''''), under state
feedback that would give it the response of the chosen poles E(s) r = p, E(0) = 1:

    u = (1/k) [ (d5/e5) (r - sum_j e_j p^(j)) + sum_j d_j p^(j) ],    j = 0 .. 4,

since then p^(5) = (k u - sum d_j p^(j)) / d5 = (r - sum e_j p^(j)) / e5. As long as nothing is
clamped, u = D E^-1 r / k: feed-forward of velocity, acceleration, jerk and their next two
derivatives, which inverts both lags and the mode. With the same E for all modes the legs, and so
all degrees of freedom, answer alike and none drives another.

Since that inverts two lags, what is asked must be smooth. The reference r follows the demand d
within bounds R on its rate and A on its acceleration. With d' = sat(rate of d, R), in units of
frames,

    e = r - d,    r' <- sat(r' + sat(change of d' - 2 p (r' - d' + g(e)), A), R),    r <- r + r',

    g(e) = p e / 2,    from e = 4 A / p^2 on    sqrt(2 A (e - 2 A / p^2)),

small errors are closed critically damped at the frequency p, large ones at the deceleration A. A
demand within the bounds is followed at once; a small jump is smoothed in proportion, and a large
one becomes a ramp with rounded ends: what the servo drive with its own rate limit can follow.
Planned leg commands are clamped to the `authority`, and the model is advanced by what is left: so
the plan knows the saturation and leaves the rest of the valve to the feedback.

The model sees its command a frame later, as the plant does. x+ = A x + B u(k - 1) is thus known,
and the state feedback acts on it. To u are added the gains on what is left of errors from the plan,

    K_p (p - measured) + K_r (p' - measured),

in which K_r is the lead against the drive lag.

Source: a plant model under (saturated) state feedback as feed-forward and reference is the
structure of two degrees of freedom of G. Kreisselmeier, Automatisierungstechnik 47 (1999) 266-269;
the smooth reference: R. Zanasi, C. Guarino Lo Bianco and A. Tonielli, Automatica 36 (2000) 439-448,
and J. Han, IEEE Transactions on Industrial Electronics 56 (2009) 900-906;
for electrohydraulic servos feed-forward of velocity, acceleration and jerk: M. Jelali and A. Kroll,
Hydraulic Servo-systems (2003); I. Davliakos and E. Papadopoulos, Mechanism and Machine Theory 43
(2008), for hexapods.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field
from scipy import signal

from cmf_mj.control.coordinates import (
    Modes,
    PerMode,
    Positive,
    spread,
    to_legs,
    to_modes,
)
from cmf_mj.core import units
from cmf_mj.core.compiled import assign, compiled
from cmf_mj.core.settings import Settings, as_tuples

ORDER = 5
"""Order of the model."""

_NYQUIST = Field(gt=0.0, le=200.0)


class Plan(Settings):
    """A model of the actuator, the response it is to have, and the gains on errors from it."""

    speed: Positive  #: Leg speed per command k [in/s/%].
    drive_lag: Annotated[float, _NYQUIST]  #: Corner a of the servo drive [Hz].
    valve_lag: Annotated[float, _NYQUIST]  #: Corner b of the spool [Hz].
    leak_rate: Annotated[float, Field(ge=0.0)] = 0.0
    """Rate 2 z w at which leakage relaxes a force [1/s]."""
    frequency: Annotated[float, _NYQUIST] | None = None
    """w of a leg [Hz], for laws in leg coordinates; modes have their own."""
    pairs: Annotated[
        tuple[tuple[Annotated[float, _NYQUIST], Positive], ...],
        Field(min_length=2, max_length=2),
        BeforeValidator(as_tuples),
    ]
    """Two pole pairs of E: natural frequency [Hz] and damping ratio."""
    pole: Annotated[float, _NYQUIST]  #: Real pole of E [Hz].
    rate: PerMode  #: Fastest reference [in/s].
    acceleration: PerMode  #: Largest acceleration of the reference [in/s^2].
    approach: Annotated[float, _NYQUIST]
    """Frequency p at which the reference closes small errors, critically damped [Hz]."""
    authority: Annotated[float, Field(gt=0.0, le=100.0)]  #: Largest planned leg command [%].
    position: PerMode = 0.0  #: K_p [%/in].
    velocity: PerMode = 0.0  #: K_r [%/(in/s)].


class PlanState(NamedTuple):
    """State of a plan, every array (n,)."""

    position: NDArray[np.float64]  #: Planned position [m].
    velocity: NDArray[np.float64]  #: Planned velocity [m/s].
    acceleration: NDArray[np.float64]  #: Planned acceleration [m/s^2].
    jerk: NDArray[np.float64]  #: Planned jerk [m/s^3].
    snap: NDArray[np.float64]  #: Planned derivative of the jerk [m/s^4].
    command: NDArray[np.float64]  #: Planned command on its way, fraction.
    reference: NDArray[np.float64]  #: Reference, as smooth as it has to be [m].
    reference_rate: NDArray[np.float64]  #: Its rate [m per frame].
    demand: NDArray[np.float64]  #: Demand of the frame before [m].
    demand_rate: NDArray[np.float64]  #: Its rate, within the bound [m per frame].


class CompiledPlan(NamedTuple):
    """Compiled parameters, SI; arrays by coordinate."""

    transition: NDArray[np.float64]  #: A, (n, 5, 5).
    input: NDArray[np.float64]  #: B, (n, 5).
    feedback: NDArray[np.float64]  #: K of u = N r - K x, (n, 5).
    forward: NDArray[np.float64]  #: N, (n,) [1/m].
    rate: NDArray[np.float64]  #: Fastest reference, (n,) [m per frame].
    acceleration: NDArray[np.float64]  #: Its largest change in a frame, (n,) [m per frame].
    pull: float  #: p, per frame.
    authority: float  #: Largest planned leg command, fraction.
    position_gain: NDArray[np.float64]  #: K_p, (n,) [1/m].
    velocity_gain: NDArray[np.float64]  #: K_r, (n,) [s/m].


def actuator_polynomial(plan: Plan, frequency: float) -> NDArray[np.float64]:
    """D, ascending powers of s, of a leg or mode of this undamped frequency [rad/s]."""
    polynomial = np.array([0.0, 1.0])
    for corner in (plan.drive_lag, plan.valve_lag):
        polynomial = np.convolve(polynomial, [1.0, 1.0 / (2.0 * np.pi * corner)])
    return np.convolve(polynomial, [1.0, plan.leak_rate / frequency**2, 1.0 / frequency**2])


def response_polynomial(plan: Plan) -> NDArray[np.float64]:
    """E, ascending powers of s."""
    polynomial = np.array([1.0, 1.0 / (2.0 * np.pi * plan.pole)])
    for natural, damping in plan.pairs:
        omega = 2.0 * np.pi * natural
        polynomial = np.convolve(polynomial, [1.0, 2.0 * damping / omega, 1.0 / omega**2])
    return polynomial


def make_plan(plan: Plan | None, modes: Modes | None, legs: int, frame: float) -> CompiledPlan:
    """Compile a plan for legs, or the modes of a cab; None for none."""
    empty = np.zeros((legs, ORDER))
    none = np.zeros(legs)
    if plan is None:
        square = np.zeros((legs, ORDER, ORDER))
        return CompiledPlan(square, empty, empty, none, none, none, 0.0, 0.0, none, none)
    hertz = np.full(legs, plan.frequency) if modes is None else np.array(modes.frequency)
    speed = plan.speed * units.INCH / units.PERCENT
    response = response_polynomial(plan)
    transitions, inputs, feedbacks, forwards = [], [], [], []
    for omega in 2.0 * np.pi * hertz:
        actuator = actuator_polynomial(plan, omega)
        a, b = np.diag(np.ones(ORDER - 1), 1), np.zeros((ORDER, 1))
        a[-1], b[-1] = -actuator[:ORDER] / actuator[ORDER], speed / actuator[ORDER]
        system = (a, b, np.eye(ORDER), np.zeros((ORDER, 1)))
        a, b, *_ = signal.cont2discrete(system, frame, method="zoh")
        share = actuator[ORDER] / response[ORDER]
        transitions.append(a)
        inputs.append(b[:, 0])
        feedbacks.append((share * response[:ORDER] - actuator[:ORDER]) / speed)
        forwards.append(share / speed)
    scale = units.PERCENT / units.INCH
    return CompiledPlan(
        transition=np.array(transitions),
        input=np.array(inputs),
        feedback=np.array(feedbacks),
        forward=np.array(forwards),
        rate=spread(plan.rate, legs) * units.INCH * frame,
        acceleration=spread(plan.acceleration, legs) * units.INCH * frame**2,
        pull=2.0 * np.pi * plan.approach * frame,
        authority=plan.authority * units.PERCENT,
        position_gain=spread(plan.position, legs) * scale,
        velocity_gain=spread(plan.velocity, legs) * scale,
    )


@compiled
def _advanced(plan, state, mode, row):  # type: ignore[no-untyped-def]
    """A derivative of the planned position a frame ahead."""
    weights = plan.transition[mode, row]
    return (
        weights[0] * state.position[mode]
        + weights[1] * state.velocity[mode]
        + weights[2] * state.acceleration[mode]
        + weights[3] * state.jerk[mode]
        + weights[4] * state.snap[mode]
        + plan.input[mode, row] * state.command[mode]
    )


@compiled
def approach(error, pull, most):  # type: ignore[no-untyped-def]
    """Rate g(e) at which to close an error: a line, then a root that keeps the deceleration A."""
    size, near = abs(error), most / (pull * pull)
    rate = 0.5 * pull * size if size <= 4.0 * near else np.sqrt(2.0 * most * (size - 2.0 * near))
    return rate * np.sign(error)


@compiled
def ask(plan, state, mode, demand):  # type: ignore[no-untyped-def]
    """Command of the plan for one mode before the clamp, fraction; its reference moves on."""
    fastest, most, pull = plan.rate[mode], plan.acceleration[mode], plan.pull
    before, moved = state.demand[mode], state.demand_rate[mode]
    moving = min(max(demand - before, -fastest), fastest)
    rate = state.reference_rate[mode]
    closing = approach(state.reference[mode] - before, pull, most)
    change = moving - moved - 2.0 * pull * (rate - moved + closing)
    rate += min(max(change, -most), most)
    rate = min(max(rate, -fastest), fastest)
    state.demand[mode] = demand
    state.demand_rate[mode] = moving
    state.reference_rate[mode] = rate
    state.reference[mode] += rate
    command = plan.forward[mode] * state.reference[mode]
    for row in range(ORDER):
        command -= plan.feedback[mode, row] * _advanced(plan, state, mode, row)
    return command


@compiled
def bounded(plan, shape, modal, commands, legs):  # type: ignore[no-untyped-def]
    """Clamp planned commands (n,), in coordinates of the law, to the authority of each leg.

    They are those of modes of the shape V^T if `modal`; `legs` (n,) is workspace.
    """
    if modal:
        to_legs(shape, commands, legs)
    else:
        assign(legs, commands)
    beyond = False
    for leg in range(legs.shape[0]):
        beyond = beyond or abs(legs[leg]) > plan.authority
        legs[leg] = min(max(legs[leg], -plan.authority), plan.authority)
    if beyond and modal:
        to_modes(shape, legs, commands)
    elif beyond:
        assign(commands, legs)


@compiled
def correct(plan, state, mode, feedback):  # type: ignore[no-untyped-def]
    """Command for what the mode has of errors from the plan, fraction."""
    error = state.position[mode] - feedback.position[mode]
    rate = state.velocity[mode] - feedback.velocity[mode]
    return plan.position_gain[mode] * error + plan.velocity_gain[mode] * rate


@compiled
def advance(plan, state, mode, command):  # type: ignore[no-untyped-def]
    """Move the plan of one mode on by a frame; `command` acts a frame later."""
    position, velocity = _advanced(plan, state, mode, 0), _advanced(plan, state, mode, 1)
    acceleration, jerk = _advanced(plan, state, mode, 2), _advanced(plan, state, mode, 3)
    state.snap[mode] = _advanced(plan, state, mode, 4)
    state.position[mode], state.velocity[mode] = position, velocity
    state.acceleration[mode], state.jerk[mode] = acceleration, jerk
    state.command[mode] = command
