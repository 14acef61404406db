"""The digital control law: the blocks of Figure 2-6 in signal order, one control frame.

demand -> limits -> error -> compensator -> valve command
                      ^ feedback

With a reference model the errors are those from the model, and its own part joins the output:

demand -> limits -> reference model -> error -> compensator -> + -> valve command
                          |______ feed-forward, adaptation ____^

A plan takes the place of the reference model. A law in hydraulic modes has all of it between a map
of demand and feedback to modes and the map of the output back to legs; limits, clamp and the error
integral with its trigger and bounds are those of legs.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control.coordinates import make_shape, per_coordinate
from cmf_mj.control.error import (
    ErrorCalculations,
    ErrorState,
    filtered_rate,
    integrate,
    make_error_calculations,
)
from cmf_mj.control.feedback import (
    CompiledLoadFeedback,
    Feedback,
    LegFeedback,
    damp_load,
    filter_acceleration,
    make_load_feedback,
    pressure_force,
)
from cmf_mj.control.inverse import write_commands
from cmf_mj.control.law import SIGNAL_UNITS, SIGNALS, Gains, Law
from cmf_mj.control.plan import CompiledPlan, PlanState, advance, correction, look_ahead, make_plan
from cmf_mj.control.reference_model import (
    AdaptationState,
    CompiledModel,
    ModelState,
    follow_model,
    make_model,
)
from cmf_mj.core import units
from cmf_mj.core.compiled import assign, compiled, inlined, multiply, multiply_transposed
from cmf_mj.core.errors import InputError

OFFSET_TIME = 0.5  #: Time constant with which the offset of a hand-over fades [s].


class Compensator(NamedTuple):
    """Compensator calculations x+ = A x + B u, y = C x + D u of each leg (Figures 2-8 to 2-10).

    Compiled gains, SI: signals in m, Pa, m/s, m s, m/s^2, N; output as command fraction.
    """

    state_gain: NDArray[np.float64]  #: A, (n,).
    input_gain: NDArray[np.float64]  #: B, (n, 10).
    output_gain: NDArray[np.float64]  #: C, (n,) [fraction per unit of state].
    direct_gain: NDArray[np.float64]  #: D, (n, 10) [fraction per SI unit of the signal].


def make_compensator(law: Law, legs: int) -> Compensator:
    """Convert a law's published gains to SI, the same for every leg or by mode."""

    def gain_rows(gains: Gains, unit: float) -> NDArray[np.float64]:
        columns = [
            per_coordinate(getattr(gains, signal), legs) * unit / size
            for signal, size in SIGNAL_UNITS.items()
        ]
        return np.ascontiguousarray(np.array(columns).T)

    return Compensator(
        state_gain=np.full(legs, law.state_gain),
        input_gain=gain_rows(law.input_gain, 1.0),
        output_gain=np.full(legs, law.output_gain * units.PERCENT),
        direct_gain=gain_rows(law.direct_gain, units.PERCENT),
    )


@compiled
def compensate(compensator, leg, state, signals):  # type: ignore[no-untyped-def]
    """Output y of one leg, command fraction, and its next state x; `signals` are u, (10,), SI."""
    output = compensator.output_gain[leg] * state
    following = compensator.state_gain[leg] * state
    for i in range(signals.shape[0]):
        output += compensator.direct_gain[leg, i] * signals[i]
        following += compensator.input_gain[leg, i] * signals[i]
    return output, following


class Workspace(NamedTuple):
    """Where a frame is computed, (n,): its results stay until the next frame."""

    limited_demand: NDArray[np.float64]  #: Leg demands within limits [m].
    demand_change: NDArray[np.float64]  #: Their change since the frame before [m].
    signals: np.recarray[Any, Any]  #: Inputs of the compensator, fields `SIGNALS`, (n,).
    inputs: NDArray[np.float64]  #: The same memory as an array, (n, 10).
    output: NDArray[np.float64]  #: Outputs before the clamp, by leg, command fractions.
    command: NDArray[np.float64]  #: Valve commands, fractions.
    reference: NDArray[np.float64]  #: Limited demand in coordinates of the law [m].
    integral: NDArray[np.float64]  #: Error integrals in coordinates of the law [m s].
    target: NDArray[np.float64]  #: What the errors count from, by leg [m].
    planned_commands: NDArray[np.float64]  #: Planned commands in coordinates of the law, fractions.
    scratch: NDArray[np.float64]  #: One quantity of all legs, made of that of modes.
    feedback: LegFeedback  #: Feedback in coordinates of the law.


class Dcl(NamedTuple):
    """Compiled parameters of all blocks, and the workspace of `step`.

    The three flags stand outside their blocks: a law without them then touches none of their
    arrays in a frame.
    """

    is_modal: bool  #: Whether the law runs in hydraulic modes.
    has_plan: bool  #: Whether it has a plan.
    has_load_feedback: bool  #: Whether it has load feedback.
    feedback: Feedback
    error: ErrorCalculations
    compensator: Compensator
    model: CompiledModel
    plan: CompiledPlan
    load_feedback: CompiledLoadFeedback
    shape: NDArray[np.float64]  #: Modes of legs, V^T, (n, n).
    offset_decay: float  #: What is left of the offset of a hand-over after a frame.
    workspace: Workspace


class DclState(NamedTuple):
    """State of the DCL, every array (n,): by leg or mode, error integral and offset by leg."""

    compensator: NDArray[np.float64]  #: x of the compensator.
    error: ErrorState
    acceleration: NDArray[np.float64]  #: Filtered leg acceleration [m/s^2].
    model: ModelState
    plan: PlanState
    load_filter: NDArray[np.float64]  #: Low-passed load force [N].
    offset: NDArray[np.float64]  #: What is left of the output of the law before, by leg, fraction.

    @classmethod
    def zeros(cls, legs: int) -> "DclState":
        """A state of zeros."""

        def block(kind: Any) -> Any:
            return kind(*(np.zeros(legs) for _ in kind._fields))

        return cls(
            compensator=np.zeros(legs),
            error=block(ErrorState),
            acceleration=np.zeros(legs),
            model=ModelState(np.zeros(legs), np.zeros(legs), block(AdaptationState)),
            plan=block(PlanState),
            load_filter=np.zeros(legs),
            offset=np.zeros(legs),
        )

    @classmethod
    def of(cls, arrays: Mapping[str, ArrayLike]) -> "DclState":
        """A new state with the values of `arrays()`."""
        state = cls.zeros(np.size(arrays["compensator"]))
        for name, array in state.arrays().items():
            array[:] = arrays[name]
        return state

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """All arrays by dotted name, such as `plan.jerk`."""
        return _arrays(self, "")


def _arrays(block: Any, prefix: str) -> dict[str, NDArray[np.float64]]:
    arrays: dict[str, NDArray[np.float64]] = {}
    for name, part in block._asdict().items():
        nested = isinstance(part, tuple)
        arrays |= _arrays(part, f"{prefix}{name}.") if nested else {prefix + name: part}
    return arrays


def make_dcl(law: Law, legs: int) -> Dcl:
    """Compile a law for a number of legs of its machine.

    Refused: a law in hydraulic modes for other than six legs, or not bound to a cab.
    """
    modes = law.bound_modes
    if modes is not None and legs != len(modes.mass):
        raise InputError(
            f"coordinates: law {law.name} runs in hydraulic modes of {len(modes.mass)} legs; "
            f"there are {legs}"
        )
    machine, sizes = law.machine, law.machine.leg_sizes
    arrays: dict[str, Any] = {name: np.zeros(legs) for name in Workspace._fields}
    arrays["inputs"] = np.zeros((legs, len(SIGNALS)))
    fields = np.dtype([(name, np.float64) for name in SIGNALS])
    arrays["signals"] = arrays["inputs"].view(fields)[:, 0].view(np.recarray)
    arrays["feedback"] = LegFeedback(*(np.zeros(legs) for _ in LegFeedback._fields))
    return Dcl(
        is_modal=modes is not None,
        has_plan=law.plan is not None,
        has_load_feedback=law.load_feedback is not None,
        feedback=Feedback(
            law.accelerometer_pole,
            law.accelerometer_gain,
            law.gravity_compensation,
            sizes.force_area,
        ),
        error=make_error_calculations(law, sizes.working_stroke),
        compensator=make_compensator(law, legs),
        model=make_model(law.reference_model, law.frame),
        plan=make_plan(law.plan, modes, legs, law.frame, machine),
        load_feedback=make_load_feedback(
            law.load_feedback, sizes, modes if law.plan else None, legs, law.frame
        ),
        shape=make_shape(modes, legs),
        offset_decay=float(np.exp(-law.frame / OFFSET_TIME)),
        workspace=Workspace(**arrays),
    )


@compiled
def limit_demand(demand, travel):  # type: ignore[no-untyped-def]
    """The demand of one leg [m], within the working stroke, +-37.5 in (section 3.2.1)."""
    return min(max(demand, -travel), travel)


@compiled
def clamp_command(output):  # type: ignore[no-untyped-def]
    """Valve command of one leg as a fraction, -1 to 1 (section 2.3.3)."""
    return min(max(output, -1.0), 1.0)


@compiled
def write_inputs(dcl, state, leg, reference, target, integral, feedback, signals):  # type: ignore[no-untyped-def]
    """Write the compensator's inputs of one leg; return the next states of the filters."""
    position = feedback.position[leg]
    error_rate, error_filter = filtered_rate(
        dcl.error, target - position, state.error.position_filter[leg]
    )
    reference_rate, reference_filter = filtered_rate(
        dcl.error, target, state.error.reference_filter[leg]
    )
    cap_pressure, rod_pressure = feedback.cap_pressure[leg], feedback.rod_pressure[leg]
    inputs = signals[leg]
    inputs.reference = reference
    inputs.cap_pressure = cap_pressure
    inputs.rod_pressure = rod_pressure
    inputs.position = position
    inputs.velocity = feedback.velocity[leg]
    inputs.position_error_rate = error_rate
    inputs.velocity_error = reference_rate - feedback.velocity[leg]
    inputs.error_integral = integral
    inputs.acceleration = state.acceleration[leg]
    inputs.force = pressure_force(dcl.feedback, cap_pressure, rod_pressure)
    return error_filter, reference_filter


@compiled
def _add_plan(dcl, state, reference, feedback):  # type: ignore[no-untyped-def]
    """Add the plan's part to the outputs of all legs or modes; the plan moves on."""
    plan, workspace = dcl.plan, dcl.workspace
    commands, count = workspace.planned_commands, reference.shape[0]
    for leg in range(count):
        look_ahead(plan, state, leg, reference[leg])
    write_commands(plan.inverse, state.pose, dcl.shape, dcl.is_modal, commands)
    for leg in range(count):
        workspace.output[leg] += commands[leg] + correction(plan, state, leg, feedback)
        advance(plan, state, leg)


@compiled
def _turn_to_modes(shape, workspace, integral, feedback):  # type: ignore[no-untyped-def]
    """Write demand, integral and feedback in modes, q = V^T l."""
    modal_feedback = workspace.feedback
    multiply(shape, workspace.limited_demand, workspace.reference)
    multiply(shape, integral, workspace.integral)
    multiply(shape, feedback.position, modal_feedback.position)
    multiply(shape, feedback.velocity, modal_feedback.velocity)
    multiply(shape, feedback.acceleration, modal_feedback.acceleration)
    multiply(shape, feedback.cap_pressure, modal_feedback.cap_pressure)
    multiply(shape, feedback.rod_pressure, modal_feedback.rod_pressure)


@compiled
def _turn_to_legs(shape, workspace):  # type: ignore[no-untyped-def]
    """Turn outputs and targets back to legs, l = V q."""
    multiply_transposed(shape, workspace.output, workspace.scratch)
    assign(workspace.output, workspace.scratch)
    multiply_transposed(shape, workspace.target, workspace.scratch)
    assign(workspace.target, workspace.scratch)


@inlined
def step(dcl, state, demand, feedback):  # type: ignore[no-untyped-def]
    """One frame of the DCL from leg demands (n,) [m]; its results are in `dcl.workspace`."""
    # In one piece: handing all arrays to a function with branches costs more than its work.
    workspace, is_modal = dcl.workspace, dcl.is_modal
    for leg in range(demand.shape[0]):
        limited = limit_demand(demand[leg], dcl.error.travel)
        workspace.demand_change[leg] = limited - workspace.limited_demand[leg]
        workspace.limited_demand[leg] = limited
    if is_modal:
        _turn_to_modes(dcl.shape, workspace, state.error.integral, feedback)
    references = workspace.reference if is_modal else workspace.limited_demand
    integral = workspace.integral if is_modal else state.error.integral
    measured = workspace.feedback if is_modal else feedback
    for leg in range(demand.shape[0]):
        reference = references[leg]
        target = reference
        if dcl.model.is_active:
            target = state.model.position[leg]
        elif dcl.has_plan:
            target = state.plan.position[leg]
        error_filter, reference_filter = write_inputs(
            dcl, state, leg, reference, target, integral[leg], measured, workspace.signals
        )
        output, following = compensate(
            dcl.compensator, leg, state.compensator[leg], workspace.inputs[leg]
        )
        if dcl.model.is_active:
            output = follow_model(dcl.model, state.model, leg, reference, measured, output)
        if dcl.has_load_feedback:
            acceleration = state.plan.acceleration[leg]
            output += damp_load(dcl.load_feedback, state.load_filter, leg, measured, acceleration)
        workspace.output[leg] = output
        workspace.target[leg] = target
        state.compensator[leg] = following
        state.error.position_filter[leg] = error_filter
        state.error.reference_filter[leg] = reference_filter
        state.acceleration[leg] = filter_acceleration(
            dcl.feedback, state.acceleration[leg], measured.acceleration[leg]
        )
    if dcl.has_plan:
        _add_plan(dcl, state.plan, references, measured)
    if is_modal:
        _turn_to_legs(dcl.shape, workspace)
    for leg in range(demand.shape[0]):
        state.error.integral[leg] = integrate(
            dcl.error, state.error.integral[leg], workspace.target[leg], feedback.position[leg]
        )
        if state.offset[leg] != 0.0:
            workspace.output[leg] += state.offset[leg]
            state.offset[leg] *= dcl.offset_decay
        workspace.command[leg] = clamp_command(workspace.output[leg])
