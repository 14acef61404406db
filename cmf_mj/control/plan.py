"""The plan: a motion of bounded force, and the command that makes it from a model of the machine.

**Motion.** The plan moves as the reference r through the chosen poles E, E(0) = 1, the same for all
coordinates, x = (p, p', .., p''''), with r held over a frame T:

    e5 p^(5) = r - sum_j e_j p^(j), j = 0 .. 4,    x+ = A x + B r.

E is linear, which keeps it from limit cycles; r is bounded. It follows the demand d within bounds R
on its rate, A on its acceleration and A w_s on its jerk. With d' = sat(rate of d, R), in frames,

    e = r - d,    r'' = sat(change of d' - 2 p (r' - d' + g(e)), A),    |change of r''| <= w_s A,

    g(e) = p e / 2,    from e = 4 A / p^2 on    sqrt(2 A (e - 2 A / p^2)):

a demand within the bounds is followed at once, small errors are closed critically damped at the
frequency p, large ones at the deceleration A. Where E has no overshoot in its step, |p''| <= A:
A is chosen so that the legs' forces M_leg p'' stay below what the supply can push.

**Command.** `cmf_mj.control.inverse` makes it of the planned motion and its derivatives. A command
acts from the next frame on and is held, and so it is made of their means over that frame: from
x[k+1] and x[k+2] the mean of p^(j+1) is (p^(j)[k+2] - p^(j)[k+1]) / T. To u are added

    K_p (p - measured) + K_r (p' - measured),

in which K_r is the lead against the drive lag.

Source: two degrees of freedom: G. Kreisselmeier, Automatisierungstechnik 47 (1999) 266-269; smooth
reference: R. Zanasi, C. Guarino Lo Bianco and A. Tonielli, Automatica 36 (2000) 439-448;
feed-forward of velocity, acceleration and jerk: M. Jelali and A. Kroll, Hydraulic Servo-systems
(2003); inverse dynamics of a hydraulic hexapod: I. Davliakos and E. Papadopoulos, Mechanism and
Machine Theory 43 (2008); load of valves: H. E. Merritt, Hydraulic Control Systems (1967).
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from cmf_mj.control.coordinates import Modes, PerMode, Positive, per_coordinate
from cmf_mj.control.inverse import Inverse, Valves, make_inverse
from cmf_mj.core import units
from cmf_mj.core.compiled import compiled
from cmf_mj.core.filters import step_matrix
from cmf_mj.core.settings import Settings, as_tuples
from cmf_mj.machine.machine import Machine

ORDER = 5  #: Order of the model.

_NYQUIST = Field(gt=0.0, le=200.0)


class Plan(Settings):
    """A model of the actuator, the response it is to have, and the gains on errors from it."""

    speed: Positive  #: Leg speed per command k [in/s/%].
    drive_lag: Annotated[float, _NYQUIST]  #: Corner a of the servo drive [Hz].
    valve_lag: Annotated[float, _NYQUIST]  #: Corner b of the spool [Hz].
    leak_rate: Annotated[float, Field(ge=0.0)] = 0.0  #: Rate 2 z w of a force's decay [1/s].
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
    smooth: Annotated[float, Field(gt=0.0)]
    """w_s, frequency to which a sine of that acceleration keeps the bound on its jerk [Hz]."""
    approach: Annotated[float, _NYQUIST]
    """Frequency p at which the reference closes small errors, critically damped [Hz]."""
    stall: Annotated[float, Field(gt=0.0)] | None = None
    """Swing of a leg's load at which a valve passes nothing [klbf]; absent: infinite."""
    position: PerMode = 0.0  #: K_p [%/in].
    velocity: PerMode = 0.0  #: K_r [%/(in/s)].


class PlanState(NamedTuple):
    """State of a plan, every array (n,)."""

    position: NDArray[np.float64]  #: Planned position [m].
    velocity: NDArray[np.float64]  #: Planned velocity [m/s].
    acceleration: NDArray[np.float64]  #: Planned acceleration [m/s^2].
    jerk: NDArray[np.float64]  #: Planned jerk [m/s^3].
    snap: NDArray[np.float64]  #: Planned derivative of the jerk [m/s^4].
    reference: NDArray[np.float64]  #: Reference, as smooth as it has to be [m].
    reference_rate: NDArray[np.float64]  #: Its rate [m per frame].
    reference_change: NDArray[np.float64]  #: Change of that in the frame before [m per frame].
    demand: NDArray[np.float64]  #: Demand of the frame before [m].
    demand_rate: NDArray[np.float64]  #: Its rate, within the bound [m per frame].
    pose: NDArray[np.float64]  #: Pose of the planned legs [m, rad].


class CompiledPlan(NamedTuple):
    """Compiled parameters, SI; arrays by coordinate."""

    frame: float  #: T [s].
    transition: NDArray[np.float64]  #: A, (5, 5).
    input: NDArray[np.float64]  #: B, (5,).
    rate: NDArray[np.float64]  #: Fastest reference, (n,) [m per frame].
    acceleration: NDArray[np.float64]  #: Its largest change in a frame, (n,) [m per frame].
    bend_share: float  #: Largest change of that in a frame, as a share of it.
    approach: float  #: p, per frame.
    position_gain: NDArray[np.float64]  #: K_p, (n,) [1/m].
    velocity_gain: NDArray[np.float64]  #: K_r, (n,) [s/m].
    next_motion: NDArray[np.float64]  #: Position to snap a frame ahead, (5, n), workspace.
    inverse: Inverse  #: From motion to command.


def response_polynomial(plan: Plan) -> NDArray[np.float64]:
    """E, ascending powers of s."""
    polynomial = np.array([1.0, 1.0 / (2.0 * np.pi * plan.pole)])
    for natural, damping in plan.pairs:
        omega = 2.0 * np.pi * natural
        polynomial = np.convolve(polynomial, [1.0, 2.0 * damping / omega, 1.0 / omega**2])
    return polynomial


def make_plan(
    plan: Plan | None, modes: Modes | None, legs: int, frame: float, machine: Machine
) -> CompiledPlan:
    """Compile a plan for legs, or the modes of a cab; None for none."""
    zeros = np.zeros(legs)
    if plan is None:
        motion = np.zeros((ORDER, ORDER)), np.zeros(ORDER), zeros, zeros, 0.0, 0.0, zeros, zeros
        inverse = make_inverse(Valves(1.0, (1.0, 1.0)), zeros + 1.0, None, machine)
        return CompiledPlan(frame, *motion, np.zeros((ORDER, legs)), inverse)
    gain_unit, rate_unit = units.PERCENT / units.INCH, units.INCH * frame
    frequency = np.full(legs, plan.frequency) if modes is None else np.array(modes.frequency)
    stall = np.inf if plan.stall is None else plan.stall * 1000.0 * units.POUND_FORCE
    valves = Valves(
        plan.speed * units.INCH / units.PERCENT,
        (2.0 * np.pi * plan.drive_lag, 2.0 * np.pi * plan.valve_lag),
        plan.leak_rate,
        stall,
    )
    response = response_polynomial(plan)
    transition = step_matrix(response[:ORDER] / response[ORDER], 1.0 / response[ORDER], frame)
    return CompiledPlan(
        frame=frame,
        transition=np.ascontiguousarray(transition[:, :ORDER]),
        input=np.ascontiguousarray(transition[:, ORDER]),
        rate=per_coordinate(plan.rate, legs) * rate_unit,
        acceleration=per_coordinate(plan.acceleration, legs) * rate_unit * frame,
        bend_share=2.0 * np.pi * plan.smooth * frame,
        approach=2.0 * np.pi * plan.approach * frame,
        position_gain=per_coordinate(plan.position, legs) * gain_unit,
        velocity_gain=per_coordinate(plan.velocity, legs) * gain_unit,
        next_motion=np.zeros((ORDER, legs)),
        inverse=make_inverse(valves, 2.0 * np.pi * frequency, modes, machine),
    )


@compiled
def approach_rate(error, pull, deceleration):  # type: ignore[no-untyped-def]
    """Rate g(e) at which to close an error: a line, then a root that keeps a deceleration A."""
    size, unit = abs(error), deceleration / (pull * pull)
    if size <= 4.0 * unit:
        rate = 0.5 * pull * size
    else:
        rate = np.sqrt(2.0 * deceleration * (size - 2.0 * unit))
    return rate * np.sign(error)


@compiled
def advance_reference(plan, state, mode, demand):  # type: ignore[no-untyped-def]
    """Move the reference of one mode on by a frame."""
    largest_rate, largest_change, pull = plan.rate[mode], plan.acceleration[mode], plan.approach
    previous_demand, previous_demand_rate = state.demand[mode], state.demand_rate[mode]
    demand_rate = min(max(demand - previous_demand, -largest_rate), largest_rate)
    rate = state.reference_rate[mode]
    closing_rate = approach_rate(state.reference[mode] - previous_demand, pull, largest_change)
    rate_error = rate - previous_demand_rate + closing_rate
    change = demand_rate - previous_demand_rate - 2.0 * pull * rate_error
    change = min(max(change, -largest_change), largest_change)
    previous_change, largest_bend = state.reference_change[mode], plan.bend_share * largest_change
    change = min(max(change, previous_change - largest_bend), previous_change + largest_bend)
    following_rate = min(max(rate + change, -largest_rate), largest_rate)
    state.reference_change[mode] = following_rate - rate
    state.demand[mode], state.demand_rate[mode] = demand, demand_rate
    state.reference_rate[mode] = following_rate
    state.reference[mode] += following_rate


@compiled
def look_ahead(plan, state, mode, demand):  # type: ignore[no-untyped-def]
    """Write the motion of a mode a frame ahead and its means over the next; move its reference."""
    next_motion, mean_motion = plan.next_motion, plan.inverse.mean_motion
    reference = state.reference[mode]
    for row in range(ORDER):
        weights = plan.transition[row]
        next_motion[row, mode] = (
            weights[0] * state.position[mode]
            + weights[1] * state.velocity[mode]
            + weights[2] * state.acceleration[mode]
            + weights[3] * state.jerk[mode]
            + weights[4] * state.snap[mode]
            + plan.input[row] * reference
        )
    advance_reference(plan, state, mode, demand)
    for row in range(ORDER):
        following = plan.input[row] * state.reference[mode]
        for j in range(ORDER):
            following += plan.transition[row, j] * next_motion[j, mode]
        mean_motion[row + 1, mode] = (following - next_motion[row, mode]) / plan.frame
    mean_motion[0, mode] = next_motion[0, mode] + 0.5 * plan.frame * mean_motion[1, mode]


@compiled
def correction(plan, state, mode, feedback):  # type: ignore[no-untyped-def]
    """Command for the errors of one mode from its plan, fraction."""
    error = state.position[mode] - feedback.position[mode]
    rate = state.velocity[mode] - feedback.velocity[mode]
    return plan.position_gain[mode] * error + plan.velocity_gain[mode] * rate


@compiled
def advance(plan, state, mode):  # type: ignore[no-untyped-def]
    """Move the plan of one mode on by a frame."""
    next_motion = plan.next_motion
    state.position[mode], state.velocity[mode] = next_motion[0, mode], next_motion[1, mode]
    state.acceleration[mode], state.jerk[mode] = next_motion[2, mode], next_motion[3, mode]
    state.snap[mode] = next_motion[4, mode]
