"""The digital control law: the blocks of Figure 2-6 in signal order, one frame of 2048 Hz.

demand -> limits -> error -> compensator -> valve command
                      ^ feedback

With a reference model the errors are those from the model, and its own part joins the output:

demand -> limits -> reference model -> error -> compensator -> + -> valve command
                          |______ feed-forward, adaptation ____^

A plan takes the place of the reference model. A law in hydraulic modes has all of it between a map
of demand and feedback to modes and the map of the output back to legs; limits, clamp and the error
integral with its trigger and bounds are those of legs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.compensator import Compensator, compensate, make_compensator
from cmf_mj.control.coordinates import Coordinates, make_coordinates, to_legs, to_modes
from cmf_mj.control.error import (
    ErrorCalculations,
    filtered_rate,
    integrate,
    make_error_calculations,
)
from cmf_mj.control.feedback import Feedback, filter_acceleration, make_feedback, pressure_force
from cmf_mj.control.law import SIGNALS, Law
from cmf_mj.control.leg_feedback import LegFeedback as LegFeedback
from cmf_mj.control.limits import Limits, limit, make_limits
from cmf_mj.control.load_feedback import CompiledLoadFeedback, damp, load, make_load_feedback
from cmf_mj.control.plan import CompiledPlan, advance, ask, bounded, correct, make_plan
from cmf_mj.control.reference_model import CompiledModel, follow, make_model
from cmf_mj.control.valve_command import clamp
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME

_INTEGRAL = SIGNALS.index("error_integral")


class Dcl(NamedTuple):
    """Compiled parameters of all blocks.

    The three flags stand outside their blocks: a law without them then touches none of their
    arrays in a frame.
    """

    modal: bool  #: Whether the law runs in hydraulic modes.
    planned: bool  #: Whether it has a plan.
    damped: bool  #: Whether it has load feedback.
    feedback: Feedback
    limits: Limits
    error: ErrorCalculations
    compensator: Compensator
    model: CompiledModel
    plan: CompiledPlan
    load_feedback: CompiledLoadFeedback
    coordinates: Coordinates


class DclState(NamedTuple):
    """State of the DCL, every array (n,): by leg, or by mode but for the error integral."""

    compensator: NDArray[np.float64]  #: x of the compensator.
    integral: NDArray[np.float64]  #: Error integral [m s].
    error_filter: NDArray[np.float64]  #: Derivative filter of the position error [m].
    reference_filter: NDArray[np.float64]  #: Derivative filter of the reference [m].
    acceleration: NDArray[np.float64]  #: Filtered leg acceleration [m/s^2].
    model_position: NDArray[np.float64]  #: Position of the reference model [m].
    model_velocity: NDArray[np.float64]  #: Its velocity [m/s].
    adaptation: NDArray[np.float64]  #: Factor of its feed-forward, less 1.
    learned_error: NDArray[np.float64]  #: Filtered error that the adaptation learns from [m/s].
    learned_feed_forward: NDArray[np.float64]  #: Filtered feed-forward, fraction.
    feed_forward_power: NDArray[np.float64]  #: Filtered square of the feed-forward.
    model_acceleration: NDArray[np.float64]
    """Planned acceleration [m/s^2]; position and velocity are those of the reference model."""
    model_jerk: NDArray[np.float64]  #: Planned jerk [m/s^3].
    model_snap: NDArray[np.float64]  #: Planned derivative of the jerk [m/s^4].
    model_command: NDArray[np.float64]  #: Planned command on its way, fraction.
    model_reference: NDArray[np.float64]  #: Reference of the plan, as smooth as it has to be [m].
    model_reference_rate: NDArray[np.float64]  #: Its rate [m per frame].
    model_demand: NDArray[np.float64]  #: Demand of the frame before [m].
    model_demand_rate: NDArray[np.float64]  #: Its rate, within the bound [m per frame].
    load_filter: NDArray[np.float64]  #: Low-passed load force [N].


def make_dcl(law: Law, legs: int) -> Dcl:
    """Compile a law for a number of legs.

    Raises:
        InputError: a law in hydraulic modes for other than six legs, or not `mounted`.
    """
    modes = law.mounted_modes
    if modes is not None and legs != len(modes.mass):
        raise InputError(
            f"coordinates: law {law.name} runs in hydraulic modes of {len(modes.mass)} legs; "
            f"there are {legs}"
        )
    return Dcl(
        modes is not None,
        law.plan is not None,
        law.load_feedback is not None,
        make_feedback(law),
        make_limits(),
        make_error_calculations(law),
        make_compensator(law, legs),
        make_model(law.reference_model),
        make_plan(law.plan, modes, legs, FRAME),
        make_load_feedback(law.load_feedback, modes if law.plan else None, legs, FRAME),
        make_coordinates(modes, legs),
    )


def engaged(
    dcl: Dcl,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
) -> DclState:
    """State of a DCL that has held `reference` at rest for a long time.

    Filters, reference model and plan have settled on the present error and position. Where the law
    has an integral, it has taken up the static offset, so that the valve command is zero.

    Args:
        dcl: compiled law.
        reference: leg demand at the start [m], (n,).
        feedback: sensor signals at the start, at rest.
    """
    legs = reference.shape[0]
    state = DclState(*(np.zeros(legs) for _ in DclState._fields))
    limited = np.clip(reference, -dcl.limits.travel, dcl.limits.travel)
    shape = dcl.coordinates.shape
    if dcl.modal:
        limited = shape @ limited
        feedback = LegFeedback(*(shape @ channel for channel in feedback))
    state.error_filter[:] = limited - feedback.position
    state.reference_filter[:] = limited
    state.model_position[:] = limited
    state.model_reference[:] = limited
    state.model_demand[:] = limited
    passed = dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)
    state.acceleration[:] = passed * feedback.acceleration
    gains = dcl.compensator
    signals = np.zeros(len(SIGNALS))
    for leg in range(legs):
        state.load_filter[leg] = load(dcl.load_feedback, leg, feedback, 0.0)
        _fill(dcl, state, leg, limited[leg], limited[leg], 0.0, feedback, signals)
        still = (gains.input_gain[leg] @ signals) / (1.0 - gains.state_gain[leg])
        output = gains.output_gain[leg] * still + gains.direct_gain[leg] @ signals
        output += dcl.model.position_gain * (limited[leg] - feedback.position[leg])
        output -= dcl.model.rate_gain * feedback.velocity[leg]
        if dcl.planned:
            output += correct(dcl.plan, state, leg, feedback)
        through = gains.output_gain[leg] * gains.input_gain[leg, _INTEGRAL]
        gain = gains.direct_gain[leg, _INTEGRAL] + through / (1.0 - gains.state_gain[leg])
        if gain != 0.0:
            bound = dcl.error.integrator_limit
            state.integral[leg] = np.clip(-output / gain, -bound, bound)
            signals[_INTEGRAL] = state.integral[leg]
            still = (gains.input_gain[leg] @ signals) / (1.0 - gains.state_gain[leg])
        state.compensator[leg] = still
    if dcl.modal:
        state.integral[:] = shape.T @ state.integral
    return state


@compiled
def _fill(dcl, state, leg, reference, target, integral, feedback, signals):  # type: ignore[no-untyped-def]
    """Write the compensator's inputs of one leg; return the next filter states."""
    position = feedback.position[leg]
    error_rate, error_filter = filtered_rate(dcl.error, target - position, state.error_filter[leg])
    reference_rate, reference_filter = filtered_rate(dcl.error, target, state.reference_filter[leg])
    cap, rod = feedback.cap_pressure[leg], feedback.rod_pressure[leg]
    signals[0] = reference
    signals[1] = cap
    signals[2] = rod
    signals[3] = position
    signals[4] = feedback.velocity[leg]
    signals[5] = error_rate
    signals[6] = reference_rate - feedback.velocity[leg]
    signals[7] = integral
    signals[8] = state.acceleration[leg]
    signals[9] = pressure_force(dcl.feedback, cap, rod)
    return error_filter, reference_filter


@compiled
def _plan(dcl, state, reference, feedback, output):  # type: ignore[no-untyped-def]
    """Add the plan's part to the outputs of all legs or modes; the plan moves on."""
    plan, commands = dcl.plan, dcl.coordinates.plan
    count = reference.shape[0]
    for leg in range(count):
        commands[leg] = ask(plan, state, leg, reference[leg])
    bounded(plan, dcl.coordinates, dcl.modal, commands)
    for leg in range(count):
        output[leg] += commands[leg] + correct(plan, state, leg, feedback)
        advance(plan, state, leg, commands[leg])


@compiled
def _into_modes(room, integral, feedback):  # type: ignore[no-untyped-def]
    seen = room.feedback
    to_modes(room, room.limited, room.reference)
    to_modes(room, integral, room.integral)
    to_modes(room, feedback.position, seen.position)
    to_modes(room, feedback.velocity, seen.velocity)
    to_modes(room, feedback.acceleration, seen.acceleration)
    to_modes(room, feedback.cap_pressure, seen.cap_pressure)
    to_modes(room, feedback.rod_pressure, seen.rod_pressure)


@compiled
def _out_of_modes(room, signals, output):  # type: ignore[no-untyped-def]
    legs = room.legs
    to_legs(room, output, legs)
    output[:] = legs
    to_legs(room, room.target, legs)
    room.target[:] = legs
    signals[:, 0] = room.limited


@compiled
def step(dcl, state, demand, feedback, signals, output, command):  # type: ignore[no-untyped-def]
    """One frame of the DCL.

    Args:
        dcl: compiled law.
        state: overwritten by the state of the next frame.
        demand: (n,) leg demands [m].
        feedback: `LegFeedback` of this frame.
        signals: (n, 10) workspace; holds the compensator's inputs afterwards, by leg or mode, but
            for the first, the limited demands of the legs.
        output: (n,) compensator outputs before the clamp, command fractions.
        command: (n,) valve commands, fractions.
    """
    # In one piece: handing all arrays to a function with branches costs more than its work.
    room, modal = dcl.coordinates, dcl.modal
    for leg in range(demand.shape[0]):
        room.limited[leg] = limit(dcl.limits, demand[leg])
    if modal:
        _into_modes(room, state.integral, feedback)
    references = room.reference if modal else room.limited
    integral = room.integral if modal else state.integral
    seen = room.feedback if modal else feedback
    followed = dcl.model.active or dcl.planned
    for leg in range(demand.shape[0]):
        reference = references[leg]
        target = state.model_position[leg] if followed else reference
        error_filter, reference_filter = _fill(
            dcl, state, leg, reference, target, integral[leg], seen, signals[leg]
        )
        output[leg], following = compensate(
            dcl.compensator, leg, state.compensator[leg], signals[leg]
        )
        if dcl.model.active:
            output[leg] = follow(dcl.model, state, leg, reference, seen, output[leg])
        if dcl.damped:
            output[leg] += damp(dcl.load_feedback, state, leg, seen)
        state.compensator[leg] = following
        state.error_filter[leg] = error_filter
        state.reference_filter[leg] = reference_filter
        state.acceleration[leg] = filter_acceleration(
            dcl.feedback, state.acceleration[leg], seen.acceleration[leg]
        )
        room.target[leg] = target
    if dcl.planned:
        _plan(dcl, state, references, seen, output)
    if modal:
        _out_of_modes(room, signals, output)
    for leg in range(demand.shape[0]):
        state.integral[leg] = integrate(
            dcl.error, state.integral[leg], room.target[leg], feedback.position[leg]
        )
        command[leg] = clamp(output[leg])
