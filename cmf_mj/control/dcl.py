"""The digital control law: the blocks of Figure 2-6 in signal order, one frame of 2048 Hz.

demand -> limits -> error -> compensator -> valve command
                      ^ feedback

With a reference model the errors are those from the model, and its own part joins the output:

demand -> limits -> reference model -> error -> compensator -> + -> valve command
                          |______ feed-forward, adaptation ____^
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.compiled import compiled
from cmf_mj.control.compensator import Compensator, compensate, make_compensator
from cmf_mj.control.error import (
    ErrorCalculations,
    filtered_rate,
    integrate,
    make_error_calculations,
)
from cmf_mj.control.feedback import (
    Feedback,
    filter_acceleration,
    make_feedback,
    pressure_force,
)
from cmf_mj.control.law import SIGNALS, Law
from cmf_mj.control.limits import Limits, limit, make_limits
from cmf_mj.control.reference_model import CompiledModel, follow, make_model
from cmf_mj.control.valve_command import clamp

_INTEGRAL = SIGNALS.index("error_integral")


class Dcl(NamedTuple):
    """Compiled parameters of all blocks."""

    feedback: Feedback
    limits: Limits
    error: ErrorCalculations
    compensator: Compensator
    model: CompiledModel


class DclState(NamedTuple):
    """State of the DCL, every array (n,)."""

    compensator: NDArray[np.float64]
    """x of the compensator."""
    integral: NDArray[np.float64]
    """Error integral [m s]."""
    error_filter: NDArray[np.float64]
    """Derivative filter of the position error [m]."""
    reference_filter: NDArray[np.float64]
    """Derivative filter of the reference [m]."""
    acceleration: NDArray[np.float64]
    """Filtered leg acceleration [m/s^2]."""
    model_position: NDArray[np.float64]
    """Position of the reference model [m]."""
    model_velocity: NDArray[np.float64]
    """Its velocity [m/s]."""
    adaptation: NDArray[np.float64]
    """Factor of its feed-forward, less 1."""
    learned_error: NDArray[np.float64]
    """Filtered error that the adaptation learns from [m/s]."""
    learned_feed_forward: NDArray[np.float64]
    """Filtered feed-forward, fraction."""
    feed_forward_power: NDArray[np.float64]
    """Filtered square of the feed-forward."""


class LegFeedback(NamedTuple):
    """What the sensors hand to the DCL, every array (n,)."""

    position: NDArray[np.float64]
    """Leg extension from neutral [m]."""
    velocity: NDArray[np.float64]
    """Leg velocity [m/s]."""
    acceleration: NDArray[np.float64]
    """Leg acceleration [m/s^2]."""
    cap_pressure: NDArray[np.float64]
    """Cap pressure [Pa]."""
    rod_pressure: NDArray[np.float64]
    """Rod pressure [Pa]."""


def make_dcl(law: Law, legs: int) -> Dcl:
    """Compile a law for a number of legs."""
    return Dcl(
        make_feedback(law),
        make_limits(),
        make_error_calculations(law),
        make_compensator(law, legs),
        make_model(law.reference_model),
    )


def engaged(
    dcl: Dcl,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
) -> DclState:
    """State of a DCL that has held `reference` at rest for a long time.

    Filters and reference model have settled on the present error and position. Where the law has an
    integral, it has taken up the static offset, so that the valve command is zero.

    Args:
        dcl: compiled law.
        reference: leg demand at the start [m], (n,).
        feedback: sensor signals at the start, at rest.
    """
    legs = reference.shape[0]
    state = DclState(*(np.zeros(legs) for _ in DclState._fields))
    limited = np.clip(reference, -dcl.limits.travel, dcl.limits.travel)
    state.error_filter[:] = limited - feedback.position
    state.reference_filter[:] = limited
    state.model_position[:] = limited
    passed = dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)
    state.acceleration[:] = passed * feedback.acceleration
    gains = dcl.compensator
    signals = np.zeros(len(SIGNALS))
    for leg in range(legs):
        _fill(dcl, state, leg, limited[leg], limited[leg], feedback, signals)
        still = (gains.input_gain[leg] @ signals) / (1.0 - gains.state_gain[leg])
        output = gains.output_gain[leg] * still + gains.direct_gain[leg] @ signals
        output += dcl.model.position_gain * (limited[leg] - feedback.position[leg])
        output -= dcl.model.rate_gain * feedback.velocity[leg]
        through = gains.output_gain[leg] * gains.input_gain[leg, _INTEGRAL]
        gain = gains.direct_gain[leg, _INTEGRAL] + through / (1.0 - gains.state_gain[leg])
        if gain != 0.0:
            bound = dcl.error.integrator_limit
            state.integral[leg] = np.clip(-output / gain, -bound, bound)
            signals[_INTEGRAL] = state.integral[leg]
            still = (gains.input_gain[leg] @ signals) / (1.0 - gains.state_gain[leg])
        state.compensator[leg] = still
    return state


@compiled
def _fill(dcl, state, leg, reference, target, feedback, signals):  # type: ignore[no-untyped-def]
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
    signals[7] = state.integral[leg]
    signals[8] = state.acceleration[leg]
    signals[9] = pressure_force(dcl.feedback, cap, rod)
    return error_filter, reference_filter


@compiled
def step(dcl, state, demand, feedback, signals, output, command):  # type: ignore[no-untyped-def]
    """One frame of the DCL.

    Args:
        dcl: compiled law.
        state: overwritten by the state of the next frame.
        demand: (n,) leg demands [m].
        feedback: `LegFeedback` of this frame.
        signals: (n, 10) workspace; holds the compensator's inputs afterwards.
        output: (n,) compensator outputs before the clamp, command fractions.
        command: (n,) valve commands, fractions.
    """
    for leg in range(demand.shape[0]):
        reference = limit(dcl.limits, demand[leg])
        target = state.model_position[leg] if dcl.model.active else reference
        error_filter, reference_filter = _fill(
            dcl, state, leg, reference, target, feedback, signals[leg]
        )
        output[leg], following = compensate(
            dcl.compensator, leg, state.compensator[leg], signals[leg]
        )
        if dcl.model.active:
            output[leg] = follow(dcl.model, state, leg, reference, feedback, output[leg])
        command[leg] = clamp(output[leg])
        state.compensator[leg] = following
        state.integral[leg] = integrate(
            dcl.error, state.integral[leg], target, feedback.position[leg]
        )
        state.error_filter[leg] = error_filter
        state.reference_filter[leg] = reference_filter
        state.acceleration[leg] = filter_acceleration(
            dcl.feedback, state.acceleration[leg], feedback.acceleration[leg]
        )
