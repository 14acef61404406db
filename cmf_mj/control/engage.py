"""How a control law begins: engaged at rest, or taking over from another in the middle of a run.

**Taking over.** Both laws read what the DCL read last; w is what the one in force would put out
now, by leg. The other begins in a state whose output is w too, so that the valve command goes on
where it was. Demand and position are taken a frame on, at their present rates.
Legs or modes, all is done in the coordinates of the law that begins, V_2:

    coordinates      states x of the law before become V_2^T V_1 x; only the error integral is kept
                     by leg. What an adaptation has learned belongs to its coordinates and is lost.
    filters          are taken over: they mean the same, but for gravity, which one law may read and
                     the other not. Where one law follows a model or plan and the other the demand,
                     they are set as if the target had always moved as the leg does now.
    load feedback    is taken over, or starts with the present force as its low-passed one
    reference model  is taken over by one of the same motion, or starts at the leg's velocity where
                     its output is w
    plan             is taken over, or starts at the leg's position and velocity; its reference then
                     moves until it asks for w. It goes to the demand from there
                     as from any jump, within its bounds on rate and acceleration.
    compensator      is taken over by one of the same A and B, or starts where its inputs would have
                     brought it, had demand and position always moved as they do now, by r a frame:
                     B u / (1 - A) - B r / (1 - A)^2. Those of the report lead the position by
                     380 %/in, which their compensators balance.
    error integral   moves until the outputs agree, within its saturation; the offset it takes up
                     stays. With a model or plan that starts, it starts at 0: it took up what was
                     static in the law before, such as its part of pressures, which those have not.
    compensator      that was not taken over makes up what is left, where C is not 0, and forgets it
                     with its pole A
    offset           is what still is left. It is added to the output and fades as e^(-t / 0.5 s):
                     a law without integral whose steady command for the same error is another,
                     comes to that by itself, within seconds.

The output of the frame after differs from w by what a frame changes of reference and feedback.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcl import Dcl, DclState, fill, step
from cmf_mj.control.feedback import LegFeedback, load
from cmf_mj.control.inverse import follow
from cmf_mj.control.law import SIGNALS
from cmf_mj.control.plan import correct
from cmf_mj.control.reference_model import CompiledModel
from cmf_mj.core.arrays import copied

_REFERENCE, _POSITION = SIGNALS.index("reference"), SIGNALS.index("position")
_INTEGRAL = SIGNALS.index("error_integral")

_ROUND_OFF = 1e-12  #: Difference of outputs that is none, command fraction.

_FASTEST = 1.0  #: Rate of the demand above which it jumps rather than moves [m/s].

_CHORDS = 20  #: Steps in which a plan finds the pose of its legs.

_PROBE = 2.0**-10  #: Step with which the slope of a linear relation is measured [m].


def engaged(
    dcl: Dcl,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
    hold: NDArray[np.float64] | float = 0.0,
) -> DclState:
    """State of a DCL that has kept `reference` (n,) [m] at rest for a long time.

    Filters, reference model and plan have settled on the present error and position. Where the law
    has an integral, it has taken up the static offset, so that the valve commands are `hold` (n,).
    """
    legs = reference.shape[0]
    state, hold = DclState.zeros(legs), np.full(legs, hold)
    limited = _within(dcl, reference)
    shape, work = dcl.shape, dcl.workspace
    if dcl.modal:
        limited, hold = shape @ limited, shape @ hold
        feedback = LegFeedback(*(shape @ channel for channel in feedback))
    state.error.position_filter[:] = limited - feedback.position
    followed = state.model.position, state.plan.position, state.plan.reference, state.plan.demand
    for values in (state.error.reference_filter, *followed):
        values[:] = limited
    passed = dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)
    state.acceleration[:] = passed * feedback.acceleration
    gains, integral, gain = dcl.compensator, state.error.integral, integral_gain(dcl)
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
        if gain[leg] != 0.0:
            bound = dcl.error.integrator_limit
            integral[leg] = np.clip((hold[leg] - output) / gain[leg], -bound, bound)
            signals[_INTEGRAL] = integral[leg]
            still = (gains.input_gain[leg] @ signals) / (1.0 - gains.state_gain[leg])
        state.compensator[leg] = still
    if dcl.modal:
        integral[:] = shape.T @ integral
    return state


def _within(dcl: Dcl, reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """A leg reference [m] within the working stroke."""
    return np.minimum(np.maximum(reference, -dcl.error.travel), dcl.error.travel)


def handed_over(
    before: Dcl,
    state: DclState,
    after: Dcl,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
    gravity: NDArray[np.float64] | None = None,
) -> DclState:
    """State in which the law `after` takes over from `before`, whose `state` is left as it is.

    Reference (n,) [m] and feedback are those that the law before read in the last frame, `gravity`
    what the accelerometers felt of it, (n,) [m/s^2]; by default none.
    """
    begun = copied(state)
    begun.offset[:] = 0.0
    if not np.array_equal(before.shape, after.shape):
        _turn(begun, after.shape @ before.shape.T)
    now = _within(after, reference)
    frame = before.error.frame
    moved = np.clip(before.workspace.moved, -_FASTEST * frame, _FASTEST * frame)
    moving = np.zeros(after.workspace.inputs.shape)
    moving[:, _REFERENCE] = after.shape @ moved
    moving[:, _POSITION] = after.shape @ feedback.velocity * frame
    ahead = feedback.position + frame * feedback.velocity
    reference, feedback = now + moved, feedback._replace(position=ahead)
    seen = feedback
    if gravity is not None:
        turned = after.shape @ before.shape.T @ _felt(before, gravity)
        begun.acceleration[:] += _felt(after, gravity) - turned
        shift = int(before.feedback.gravity_compensation) - int(after.feedback.gravity_compensation)
        seen = feedback._replace(acceleration=feedback.acceleration + shift * gravity)
    bound = after.error.integrator_limit
    np.clip(begun.error.integral, -bound, bound, out=begun.error.integral)
    command = _output(before, state, reference, feedback)
    one, other = before.compensator, after.compensator
    same = np.array_equal(one.state_gain, other.state_gain)
    same = same and np.array_equal(one.input_gain, other.input_gain)

    def missing() -> NDArray[np.float64]:
        """Settle the compensator; what is missing of the output, in coordinates of the law."""
        _output(after, begun, reference, seen)
        fades = 1.0 - other.state_gain
        inputs = after.workspace.inputs - moving / fades[:, None]
        if not same:
            begun.compensator[:] = np.einsum("ij,ij->i", other.input_gain, inputs) / fades
        return after.shape @ (command - _output(after, begun, reference, seen))

    _begin(before, begun, after, (now, moved), seen)
    if _starts_model(before, after):
        _move(begun.model.position, missing)
    if after.planned:
        for _ in range(3):  # valves under load are not linear, nor are modes alone off neutral
            _move(begun.plan.reference, missing)
    gain = integral_gain(after)
    left = missing()
    share = np.divide(left, gain, out=np.zeros_like(left), where=gain != 0.0)
    begun.error.integral[:] = np.clip(begun.error.integral + after.shape.T @ share, -bound, bound)
    left, gain = missing(), other.output_gain
    made_up = np.divide(left, gain, out=np.zeros_like(left), where=gain != 0.0)
    begun.compensator[:] += 0.0 if same else made_up
    left = command - _output(after, begun, reference, seen)
    begun.offset[:] = np.where(np.abs(left) > _ROUND_OFF, left, 0.0)
    after.workspace.limited[:], after.workspace.moved[:] = now, moved
    return begun


def _begin(
    before: Dcl,
    begun: DclState,
    after: Dcl,
    demands: tuple[NDArray[np.float64], NDArray[np.float64]],
    feedback: LegFeedback,
) -> None:
    """Start the blocks of `after` that `before` does not have; demands are (demand, change)."""
    shape = after.shape
    modes = LegFeedback(*(shape @ channel for channel in feedback))
    demand, moved = (shape @ legs for legs in demands)
    plan, model = begun.plan, begun.model
    if not after.model.adapting:
        model.adaptation.factor[:] = 0.0
    starts = after.planned and not before.planned
    if starts:
        for values in plan:
            values[:] = 0.0
        plan.position[:], plan.velocity[:] = modes.position, modes.velocity
        plan.demand[:] = demand
        plan.demand_rate[:] = np.clip(moved, -after.plan.rate, after.plan.rate)
        plan.reference_rate[:] = plan.demand_rate
        plan.reference[:] = plan.position
        after.plan.inverse.legs[0] = shape.T @ plan.position
        for _ in range(_CHORDS):
            follow(after.plan.inverse, plan.pose)
    if _starts_model(before, after):
        model.position[:], model.velocity[:] = modes.position, modes.velocity
        starts = True
    if starts:
        begun.error.integral[:] = 0.0
    if after.damped and not before.damped:
        for leg in range(demand.size):
            begun.load_filter[leg] = load(after.load_feedback, leg, modes, plan.acceleration[leg])
    if _follows(after) != _follows(before):
        target = model.position if after.model.active else demand
        target = plan.position if after.planned else target
        begun.error.position_filter[:] = target - modes.position
        begun.error.reference_filter[:] = target - modes.velocity / after.error.derivative_pole


def _follows(dcl: Dcl) -> bool:
    """Whether a law follows a model or a plan."""
    return dcl.planned or dcl.model.active


def _starts_model(before: Dcl, after: Dcl) -> bool:
    """Whether a law follows a model that moves in another way than that of the law before."""
    motion = CompiledModel._fields.index("position_gain")
    return after.model.active and before.model[:motion] != after.model[:motion]


def _turn(state: DclState, turn: NDArray[np.float64]) -> None:
    """Turn a state into other coordinates."""
    for name, values in state.arrays().items():
        if name.startswith("model.adaptation."):
            values[:] = 0.0
        elif name not in ("error.integral", "plan.pose"):
            values[:] = turn @ values


def _move(states: NDArray[np.float64], missing: Callable[[], NDArray[np.float64]]) -> None:
    """Move states, each of which the output depends on linearly, until nothing is missing [m]."""
    left = missing()
    states += _PROBE
    slope = (left - missing()) / _PROBE
    states += np.divide(left, slope, out=np.zeros_like(left), where=slope != 0.0) - _PROBE


def integral_gain(dcl: Dcl) -> NDArray[np.float64]:
    """Output per error integral, with the compensator settled, (n,) [1/(m s)]."""
    gains = dcl.compensator
    through = gains.output_gain * gains.input_gain[:, _INTEGRAL] / (1.0 - gains.state_gain)
    return gains.direct_gain[:, _INTEGRAL] + through


def _felt(dcl: Dcl, gravity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gravity in the accelerometer filters of a law (n,), settled."""
    if dcl.feedback.gravity_compensation:
        return np.zeros(gravity.shape)
    passed = dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)
    return passed * (dcl.shape @ gravity if dcl.modal else gravity)


def _output(
    dcl: Dcl, state: DclState, reference: NDArray[np.float64], feedback: LegFeedback
) -> NDArray[np.float64]:
    """Output of a law (n,), its state left as it is."""
    step(dcl, copied(state), reference, feedback)
    return dcl.workspace.output.copy()
