"""How a control law begins: engaged at rest, or taking over from another in the middle of a run.

**Taking over.** The law in force would put out w now, by leg. The other law begins in a state with
the same output, so that the valve command makes no step. Demand and position are those of the next
frame, at their present rates. All is done in the coordinates of the law that begins, V_2:

    coordinates      states x of the law before become V_2^T V_1 x; the error integral stays by leg,
                     and what an adaptation has learned is lost
    filters          stay, but for gravity, which one law may read and the other not; where one law
                     follows a model or plan and the other the demand, they start as if the target
                     had always moved as the leg does now
    load feedback    stays, or starts with the present force as its low-passed one
    reference model  stays if its motion is the same, or starts at the leg's velocity where its
                     output is w
    plan             stays, or starts at the leg's position and velocity; its reference starts where
                     it asks for w and goes to the demand within its bounds
    compensator      stays if A and B are the same, or starts where its inputs would have brought
                     it, had demand and position always moved by r a frame:
                     B u / (1 - A) - B r / (1 - A)^2
    error integral   moves until the outputs agree, within its saturation; it starts at 0 with a
                     model or plan that starts, which need no part of pressures
    compensator      if it does not stay, makes up the rest where C is not 0, and forgets it with A
    offset           is the rest of that. It is added to the output and fades as e^(-t / 0.5 s).

The output of the next frame differs from w by the change of reference and feedback in a frame.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcl import Dcl, DclState, step, write_inputs
from cmf_mj.control.feedback import LegFeedback, load_force
from cmf_mj.control.inverse import follow_pose
from cmf_mj.control.law import SIGNALS
from cmf_mj.control.plan import correction
from cmf_mj.control.reference_model import moves_alike
from cmf_mj.core.arrays import copy_block

_REFERENCE, _POSITION = SIGNALS.index("reference"), SIGNALS.index("position")
_INTEGRAL = SIGNALS.index("error_integral")

_ROUND_OFF = 1e-12  #: Difference of outputs that is none, command fraction.

_TOP_RATE = 1.0  #: Rate of a demand that moves; one that changes faster jumps [m/s].

_CHORDS = 20  #: Steps in which a plan finds the pose of its legs.

_PROBE = 2.0**-10  #: Step with which the slope of a linear relation is measured [m].


def engaged_state(
    dcl: Dcl,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
    hold: NDArray[np.float64] | float = 0.0,
) -> DclState:
    """State of a DCL that has kept `reference` (n,) [m] at rest for a long time.

    All filters have settled. The error integral has taken up the static offset, so that the valve
    commands are `hold` (n,).
    """
    legs = reference.shape[0]
    state, hold = DclState.zeros(legs), np.full(legs, hold)
    demand = _limit_reference(dcl, reference)
    shape, workspace = dcl.shape, dcl.workspace
    if dcl.is_modal:
        demand, hold = shape @ demand, shape @ hold
        feedback = LegFeedback(*(shape @ channel for channel in feedback))
    state.error.position_filter[:] = demand - feedback.position
    targets = state.model.position, state.plan.position, state.plan.reference, state.plan.demand
    for target in (state.error.reference_filter, *targets):
        target[:] = demand
    state.acceleration[:] = _filter_gain(dcl) * feedback.acceleration
    gains, integral, gain = dcl.compensator, state.error.integral, integral_gain(dcl)
    for leg in range(legs):
        state.load_filter[leg] = load_force(dcl.load_feedback, leg, feedback, 0.0)
        write_inputs(dcl, state, leg, demand[leg], demand[leg], 0.0, feedback, workspace.signals)
        inputs = workspace.inputs[leg]
        compensator = (gains.input_gain[leg] @ inputs) / (1.0 - gains.state_gain[leg])
        output = gains.output_gain[leg] * compensator + gains.direct_gain[leg] @ inputs
        output += dcl.model.position_gain * (demand[leg] - feedback.position[leg])
        output -= dcl.model.rate_gain * feedback.velocity[leg]
        if dcl.has_plan:
            output += correction(dcl.plan, state.plan, leg, feedback)
        if gain[leg] != 0.0:
            bound = dcl.error.integrator_limit
            integral[leg] = np.clip((hold[leg] - output) / gain[leg], -bound, bound)
            inputs[_INTEGRAL] = integral[leg]
            compensator = (gains.input_gain[leg] @ inputs) / (1.0 - gains.state_gain[leg])
        state.compensator[leg] = compensator
    if dcl.is_modal:
        integral[:] = shape.T @ integral
    return state


def _limit_reference(dcl: Dcl, reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """A leg reference [m] within the working stroke."""
    return np.minimum(np.maximum(reference, -dcl.error.travel), dcl.error.travel)


def handed_over_state(
    previous: Dcl,
    state: DclState,
    dcl: Dcl,
    reference: NDArray[np.float64],
    feedback: LegFeedback,
    gravity: NDArray[np.float64] | None = None,
) -> DclState:
    """State in which the law `dcl` takes over from `previous`, whose `state` is left as it is.

    Reference (n,) [m] and feedback are those that the law before read in the last frame, `gravity`
    what the accelerometers felt of it, (n,) [m/s^2]; by default none.
    """
    next_state, frame, bound = copy_block(state), previous.error.frame, dcl.error.integrator_limit
    next_state.offset[:] = 0.0
    if not np.array_equal(previous.shape, dcl.shape):
        _turn_state(next_state, dcl.shape @ previous.shape.T)
    demand = _limit_reference(dcl, reference)
    largest_change = _TOP_RATE * frame
    demand_change = np.clip(previous.workspace.demand_change, -largest_change, largest_change)
    feedback = feedback._replace(position=feedback.position + frame * feedback.velocity)
    command = _output(previous, state, demand + demand_change, feedback)
    if gravity is not None:
        previous_gravity = dcl.shape @ previous.shape.T @ _filtered_gravity(previous, gravity)
        next_state.acceleration[:] += _filtered_gravity(dcl, gravity) - previous_gravity
        shift = int(previous.feedback.gravity_compensation) - int(dcl.feedback.gravity_compensation)
        feedback = feedback._replace(acceleration=feedback.acceleration + shift * gravity)
    np.clip(next_state.error.integral, -bound, bound, out=next_state.error.integral)
    hand_over = _HandOver(previous, dcl, next_state, command, demand, demand_change, feedback)
    hand_over.start_blocks()
    hand_over.settle_targets()
    hand_over.settle_integral()
    missing = hand_over.missing_output()
    next_state.offset[:] = np.where(np.abs(missing) > _ROUND_OFF, missing, 0.0)
    dcl.workspace.limited_demand[:] = demand
    dcl.workspace.demand_change[:] = demand_change
    return next_state


class _HandOver(NamedTuple):
    """A law that begins in the middle of a run, and the output it has to begin with."""

    previous: Dcl  #: The law in force.
    dcl: Dcl  #: The law that begins.
    state: DclState  #: State of the law that begins, changed stage by stage.
    command: NDArray[np.float64]  #: Output of the law in force, by leg, fractions, (n,).
    demand: NDArray[np.float64]  #: Limited demand of the last frame [m], (n,).
    demand_change: NDArray[np.float64]  #: Its change in a frame [m], (n,).
    feedback: LegFeedback  #: Feedback of the next frame, as the law that begins reads it.

    @property
    def keeps_compensator(self) -> bool:
        """Whether both compensators have the same A and B."""
        gains, next_gains = self.previous.compensator, self.dcl.compensator
        has_same_poles = np.array_equal(gains.state_gain, next_gains.state_gain)
        return has_same_poles and np.array_equal(gains.input_gain, next_gains.input_gain)

    def missing_output(self) -> NDArray[np.float64]:
        """What is missing of the output by leg, fractions, (n,)."""
        reference = self.demand + self.demand_change
        return self.command - _output(self.dcl, self.state, reference, self.feedback)

    def settle_compensator(self) -> NDArray[np.float64]:
        """Settle the compensator; what is missing of the output, in coordinates of the law."""
        dcl, gains = self.dcl, self.dcl.compensator
        self.missing_output()  # whose frame of the law writes `workspace.inputs`, used below
        change = np.zeros(dcl.workspace.inputs.shape)
        change[:, _REFERENCE] = dcl.shape @ self.demand_change
        change[:, _POSITION] = dcl.shape @ self.feedback.velocity * self.previous.error.frame
        fade = 1.0 - gains.state_gain
        inputs = dcl.workspace.inputs - change / fade[:, None]
        if not self.keeps_compensator:
            self.state.compensator[:] = np.einsum("ij,ij->i", gains.input_gain, inputs) / fade
        return dcl.shape @ self.missing_output()

    def start_blocks(self) -> None:
        """Start the blocks that the law before does not have."""
        previous, dcl, state = self.previous, self.dcl, self.state
        feedback = LegFeedback(*(dcl.shape @ channel for channel in self.feedback))
        demand = dcl.shape @ self.demand
        plan, model = state.plan, state.model
        if not dcl.model.is_adapting:
            model.adaptation.factor[:] = 0.0
        starts_plan = dcl.has_plan and not previous.has_plan
        if starts_plan:
            for values in plan:
                values[:] = 0.0
            plan.position[:], plan.velocity[:] = feedback.position, feedback.velocity
            plan.demand[:] = demand
            change = dcl.shape @ self.demand_change
            plan.demand_rate[:] = np.clip(change, -dcl.plan.rate, dcl.plan.rate)
            plan.reference_rate[:] = plan.demand_rate
            plan.reference[:] = plan.position
            dcl.plan.inverse.leg_motion[0] = dcl.shape.T @ plan.position
            for _ in range(_CHORDS):
                follow_pose(dcl.plan.inverse, plan.pose)
        if self.starts_model:
            model.position[:], model.velocity[:] = feedback.position, feedback.velocity
        if starts_plan or self.starts_model:
            state.error.integral[:] = 0.0
        if dcl.has_load_feedback and not previous.has_load_feedback:
            for leg in range(demand.size):
                force = load_force(dcl.load_feedback, leg, feedback, plan.acceleration[leg])
                state.load_filter[leg] = force
        if _has_target(dcl) != _has_target(previous):
            target = model.position if dcl.model.is_active else demand
            target = plan.position if dcl.has_plan else target
            state.error.position_filter[:] = target - feedback.position
            lag = feedback.velocity / dcl.error.derivative_pole
            state.error.reference_filter[:] = target - lag

    @property
    def starts_model(self) -> bool:
        """Whether the law follows a model that moves in another way than that of the law before."""
        return self.dcl.model.is_active and not moves_alike(self.previous.model, self.dcl.model)

    def settle_targets(self) -> None:
        """Move what the model or plan asks for until the output is met."""
        if self.starts_model:
            self._move(self.state.model.position)
        if self.dcl.has_plan:
            for _ in range(3):  # valves under load are not linear, nor are modes alone off neutral
                self._move(self.state.plan.reference)

    def _move(self, states: NDArray[np.float64]) -> None:
        """Move states on which the output depends linearly until nothing is missing."""
        missing = self.settle_compensator()
        states += _PROBE
        slope = (missing - self.settle_compensator()) / _PROBE
        states += _ratio(missing, slope) - _PROBE

    def settle_integral(self) -> None:
        """Move the error integral, then the compensator, by what is missing of the output."""
        dcl, integral = self.dcl, self.state.error.integral
        bound = dcl.error.integrator_limit
        change = _ratio(self.settle_compensator(), integral_gain(dcl))
        integral[:] = np.clip(integral + dcl.shape.T @ change, -bound, bound)
        change = _ratio(self.settle_compensator(), dcl.compensator.output_gain)
        self.state.compensator[:] += 0.0 if self.keeps_compensator else change


def _ratio(missing: NDArray[np.float64], gain: NDArray[np.float64]) -> NDArray[np.float64]:
    """What is missing over a gain, 0 where the gain is."""
    return np.divide(missing, gain, out=np.zeros_like(missing), where=gain != 0.0)


def _has_target(dcl: Dcl) -> bool:
    """Whether a law follows a model or a plan."""
    return dcl.has_plan or dcl.model.is_active


def _turn_state(state: DclState, turn: NDArray[np.float64]) -> None:
    """Turn a state into other coordinates."""
    for name, values in state.arrays().items():
        if name.startswith("model.adaptation."):
            values[:] = 0.0
        elif name not in ("error.integral", "plan.pose"):
            values[:] = turn @ values


def integral_gain(dcl: Dcl) -> NDArray[np.float64]:
    """Output per error integral, with the compensator settled, (n,) [1/(m s)]."""
    gains = dcl.compensator
    compensator_gain = gains.output_gain * gains.input_gain[:, _INTEGRAL] / (1.0 - gains.state_gain)
    return gains.direct_gain[:, _INTEGRAL] + compensator_gain


def _filter_gain(dcl: Dcl) -> float:
    """Steady gain of a law's accelerometer filter."""
    return dcl.feedback.accelerometer_gain / (1.0 - dcl.feedback.accelerometer_pole)


def _filtered_gravity(dcl: Dcl, gravity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gravity in the accelerometer filters of a law (n,), settled."""
    if dcl.feedback.gravity_compensation:
        return np.zeros(gravity.shape)
    return _filter_gain(dcl) * (dcl.shape @ gravity if dcl.is_modal else gravity)


def _output(
    dcl: Dcl, state: DclState, reference: NDArray[np.float64], feedback: LegFeedback
) -> NDArray[np.float64]:
    """Output of a law (n,), its state left as it is."""
    step(dcl, copy_block(state), reference, feedback)
    return dcl.workspace.output.copy()
