"""How a control law begins: engaged at rest, or taking over from another in the middle of a run.

At the change both laws read what the DCL read last, and the new one starts so that its output
is that of the old one, as far as it has a state to do so with:

    filters            of error, reference and acceleration are taken over: they mean the same, but
                       for gravity, which one law may read and the other not
    reference model    is taken over, or starts at the leg's present position and velocity
    compensator        starts where its inputs, held, would have brought it: B u / (1 - A)
    error integral     moves until the outputs agree, within its saturation; the offset it takes
                       up stays
    compensator        makes up what is left and forgets it with its pole A

Without integral and output gain there is nothing to move, and the command jumps by the
difference of the two laws; the lag of the servo drive rounds it.
"""

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcl import Dcl, DclState, fill, step
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import SIGNALS
from cmf_mj.control.load_feedback import load
from cmf_mj.control.plan import correct
from cmf_mj.machine.kinematics import WORKING_STROKE

_INTEGRAL = SIGNALS.index("error_integral")


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
    state = DclState.zeros(legs)
    limited = np.clip(reference, -WORKING_STROKE, WORKING_STROKE)
    shape, work = dcl.shape, dcl.workspace
    if dcl.modal:
        limited = shape @ limited
        feedback = LegFeedback(*(shape @ channel for channel in feedback))
    state.error.position_filter[:] = limited - feedback.position
    followed = state.model.position, state.plan.position, state.plan.reference, state.plan.demand
    for values in (state.error.reference_filter, *followed):
        values[:] = limited
    passed = dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)
    state.acceleration[:] = passed * feedback.acceleration
    gains, integral = dcl.compensator, state.error.integral
    for leg in range(legs):
        state.load_filter[leg] = load(dcl.load_feedback, leg, feedback, 0.0)
        fill(dcl, state, leg, limited[leg], limited[leg], 0.0, feedback, work.signals)
        signals = work.inputs[leg]
        still = (gains.input_gain[leg] @ signals) / (1.0 - gains.state_gain[leg])
        output = gains.output_gain[leg] * still + gains.direct_gain[leg] @ signals
        output += dcl.model.position_gain * (limited[leg] - feedback.position[leg])
        output -= dcl.model.rate_gain * feedback.velocity[leg]
        if dcl.planned:
            output += correct(dcl.plan, state.plan, leg, feedback)
        through = gains.output_gain[leg] * gains.input_gain[leg, _INTEGRAL]
        gain = gains.direct_gain[leg, _INTEGRAL] + through / (1.0 - gains.state_gain[leg])
        if gain != 0.0:
            bound = dcl.error.integrator_limit
            integral[leg] = np.clip(-output / gain, -bound, bound)
            signals[_INTEGRAL] = integral[leg]
            still = (gains.input_gain[leg] @ signals) / (1.0 - gains.state_gain[leg])
        state.compensator[leg] = still
    if dcl.modal:
        integral[:] = shape.T @ integral
    return state


def handed_over(
    before: Dcl,
    state: DclState,
    after: Dcl,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
    gravity: NDArray[np.float64] | None = None,
) -> DclState:
    """State in which a law takes over from another.

    Args:
        before: compiled law in force.
        state: its state; left as it is.
        after: compiled law that takes over.
        reference: leg demands of the last frame [m], (n,).
        feedback: what the law in force read in the last frame.
        gravity: what the accelerometers felt of it, (n,) [m/s^2]; default none.
    """
    begun = DclState.of(state.arrays())
    seen = feedback
    if gravity is not None:
        begun.acceleration[:] += _felt(after, gravity) - _felt(before, gravity)
        shift = int(before.feedback.gravity_compensation) - int(after.feedback.gravity_compensation)
        seen = feedback._replace(acceleration=feedback.acceleration + shift * gravity)
    if after.model.active and not before.model.active:
        begun.model.position[:] = feedback.position
        begun.model.velocity[:] = feedback.velocity
    gains, bound = after.compensator, after.error.integrator_limit
    np.clip(begun.error.integral, -bound, bound, out=begun.error.integral)
    wanted, _ = _output(before, state, reference, feedback)
    lasting = 1.0 - gains.state_gain

    def settled() -> NDArray[np.float64]:
        """Settle the compensator; what is missing of the output."""
        _, signals = _output(after, begun, reference, seen)
        begun.compensator[:] = np.einsum("ij,ij->i", gains.input_gain, signals) / lasting
        return wanted - _output(after, begun, reference, seen)[0]

    missing = settled()
    gain = gains.direct_gain[:, _INTEGRAL]
    gain = gain + gains.output_gain * gains.input_gain[:, _INTEGRAL] / lasting
    for leg in np.flatnonzero(gain):
        moved = begun.error.integral[leg] + missing[leg] / gain[leg]
        begun.error.integral[leg] = np.clip(moved, -bound, bound)
    missing = settled()
    for leg in np.flatnonzero(gains.output_gain):
        begun.compensator[leg] += missing[leg] / gains.output_gain[leg]
    return begun


def _felt(dcl: Dcl, gravity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gravity in the accelerometer filters of a law (n,), settled."""
    if dcl.feedback.gravity_compensation:
        return np.zeros(gravity.shape)
    passed = dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)
    return passed * (dcl.shape @ gravity if dcl.modal else gravity)


def _output(
    dcl: Dcl,
    state: DclState,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Outputs (n,) and inputs (n, 10) of a law's compensator, its state left as it is."""
    scratch = DclState.of(state.arrays())
    step(dcl, scratch, reference, feedback)
    return dcl.workspace.output.copy(), dcl.workspace.inputs.copy()
