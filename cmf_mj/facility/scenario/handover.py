"""Hand-over from one control law to another in the middle of a run.

At the change both laws are given what the DCL read last, and the new one starts so that its output
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

from cmf_mj.control import dcl as control
from cmf_mj.control.law import SIGNALS

_INTEGRAL = SIGNALS.index("error_integral")


def handed_over(
    before: control.Dcl,
    state: control.DclState,
    after: control.Dcl,
    reference: NDArray[np.float64],
    feedback: control.LegFeedback,
    gravity: NDArray[np.float64] | None = None,
) -> control.DclState:
    """State in which a law takes over from another.

    Args:
        before: compiled law in force.
        state: its state; left as it is.
        after: compiled law that takes over.
        reference: leg demands of the last frame [m], (n,).
        feedback: what the law in force read in the last frame.
        gravity: what the accelerometers felt of it, (n,) [m/s^2]; default none.
    """
    begun = control.DclState(*(values.copy() for values in state))
    seen = feedback
    if gravity is not None:
        begun.acceleration[:] += _felt(after, gravity) - _felt(before, gravity)
        shift = int(before.feedback.gravity_compensation) - int(after.feedback.gravity_compensation)
        seen = feedback._replace(acceleration=feedback.acceleration + shift * gravity)
    if after.model.active and not before.model.active:
        begun.model_position[:] = feedback.position
        begun.model_velocity[:] = feedback.velocity
    gains, bound = after.compensator, after.error.integrator_limit
    np.clip(begun.integral, -bound, bound, out=begun.integral)
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
        moved = begun.integral[leg] + missing[leg] / gain[leg]
        begun.integral[leg] = np.clip(moved, -bound, bound)
    missing = settled()
    for leg in np.flatnonzero(gains.output_gain):
        begun.compensator[leg] += missing[leg] / gains.output_gain[leg]
    return begun


def _felt(dcl: control.Dcl, gravity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gravity in the accelerometer filters of a law (n,), settled."""
    if dcl.feedback.gravity_compensation:
        return np.zeros(gravity.shape)
    passed = dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)
    return passed * (dcl.coordinates.shape @ gravity if dcl.modal else gravity)


def _output(
    dcl: control.Dcl,
    state: control.DclState,
    reference: NDArray[np.float64],
    feedback: control.LegFeedback,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Outputs (n,) and inputs (n, 10) of a law's compensator, its state left as it is."""
    legs = reference.shape[0]
    signals, output, command = np.zeros((legs, len(SIGNALS))), np.zeros(legs), np.zeros(legs)
    scratch = control.DclState(*(values.copy() for values in state))
    control.step(dcl, scratch, reference, feedback, signals, output, command)
    return output, signals
