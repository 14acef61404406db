"""The compiled frame loop: one closed loop for every plant, law and experiment.

One control frame T = 1/2048 s, with m mechanical steps h = T / m in it:

    for each step k:  position stage of MuJoCo at t[k]: extensions l[k]
                      pressures advance from t[k-1] to t[k] between l[k-1] and l[k]
                      (at a frame) events, sensors, reference, DCL, record
                      cylinder forces of the pressures at t[k] -> force stage: l[k+1]

The order makes the coupling second order at no extra step: the force acts at the instant of its
pressures, and a pressure sees the displacement MuJoCo's leapfrog really made. The command of a
frame reaches the valves a whole number of frames later, one by default: the time the DCL computes.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control import dcl as control
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.protection import (
    FAULTS,
    FaultCode,
    Protection,
    ProtectionState,
    check_frame,
    latch_outside_fault,
    reset,
)
from cmf_mj.core.arrays import record_array
from cmf_mj.core.compiled import compiled, inlined
from cmf_mj.electronics.chain import Electronics, deliver, inertial_feedback, measure, release
from cmf_mj.electronics.sensors import true_acceleration, true_velocity
from cmf_mj.facility import front
from cmf_mj.facility.pace import Pace, begin_frame, end_frame
from cmf_mj.facility.record_layout import Columns
from cmf_mj.plant.cylinder import CAP, ROD
from cmf_mj.plant.events import Faults, Timeline, apply_event
from cmf_mj.plant.hydraulics import Hydraulics, HydraulicState, advance, write_loads
from cmf_mj.plant.native import Stepper, call
from cmf_mj.plant.oil import ATMOSPHERE
from cmf_mj.plant.supply import SUPPLY_PRESSURE

FINITE, VACUUM, PROOF, STROKE, SOLUTION, WARNING = range(6)
"""Bounds a state may leave: finite numbers, absolute pressure above 0, proof pressure, mechanical
stroke, a solvable stage, and what MuJoCo does not warn of."""

_STOP_TRAVEL = 0.05
"""Travel beyond the mechanical stroke at which a run is stopped [m]; the stops are elastic."""

_HARMLESS_FAULTS = ("none", "host_watchdog", "frame_watchdog", "not_arrived", "host_range")
_NEEDS_STOP = tuple(name not in _HARMLESS_FAULTS for name in FAULTS)
"""By fault code, whether the control law cannot be trusted to bring the machine down after it."""


class Dynamics(NamedTuple):
    """A plant as the loop steps it, and its state."""

    mechanics: Stepper
    hydraulics: Hydraulics
    state: HydraulicState
    faults: Faults
    timeline: Timeline


class Controller(NamedTuple):
    """What commands the valves."""

    closed: bool  #: Whether the DCL makes the command; if not, the reference is the command.
    dcl: control.Dcl  #: Compiled law.
    state: control.DclState  #: State of the law.
    source: front.Source  #: Source of the reference.
    delay: int  #: Frames from a DCL frame to its command at the valves.
    guarded: bool  #: Whether a detected fault makes an emergency stop.
    protection: Protection  #: Compiled thresholds.
    guard: ProtectionState  #: What has been detected.
    electronics: Electronics  #: Sensors, converters and servo electronics.
    pace: Pace  #: Real time.


class Recorder(NamedTuple):
    """What the loop records, and how often."""

    sensors: NDArray[np.int64]  #: Indices into MuJoCo's sensordata.
    gimbals: NDArray[np.int64]  #: Sites of the two halves of each gimbal, (gimbals, 2).
    steps: int  #: Mechanical steps in a frame.
    every: int  #: Control frames from row to row.
    columns: Columns  #: First column of each channel in a row.
    out: NDArray[np.float64]
    """Record, (rows, columns); overwritten from the start after its last row."""


class Progress(NamedTuple):
    """Where the loop is."""

    event: int = 0  #: Next event on the time line.
    tripped: int = 0  #: Whether a limit switch has tripped.
    stopped: int = 0  #: Whether there is an emergency stop.
    reset_code: int = 0  #: Code of the last fault that was reset.
    reset_leg: int = 0  #: Its leg.
    reset_frame: int = 0  #: The frame in which it was detected.


class Memory(NamedTuple):
    """What the loop keeps from frame to frame, so that it can be run in parts."""

    extension: NDArray[np.float64]  #: Extensions at the last step [m], (n,).
    extension_before: NDArray[np.float64]  #: Extensions one step earlier [m], (n,).
    mean_velocity: NDArray[np.float64]  #: Mean velocity between them [m/s], (n,).
    mean_velocity_before: NDArray[np.float64]  #: Mean velocity one step earlier [m/s], (n,).
    force: NDArray[np.float64]  #: Cylinder forces [N], (n,).
    truth: LegFeedback  #: True motion and pressures.
    feedback: LegFeedback  #: What the DCL reads.
    reference: NDArray[np.float64]  #: Leg reference [m], (n,).
    command: NDArray[np.float64]
    """Commands on their way to the valves, newest first, (delay + 1, n)."""
    gimbal_error: NDArray[np.float64]  #: Largest gimbal error since the last row [m], (1,).
    progress: np.recarray[Any, Any]  #: `Progress`, (1,).


def make_memory(dynamics: Dynamics, delay: int) -> Memory:
    """Memory of a plant at rest."""
    mechanics = dynamics.mechanics
    extension = mechanics.length[mechanics.motors] - mechanics.neutral
    legs = extension.size

    def feedback_at_rest() -> LegFeedback:
        pressure = dynamics.state.pressure
        cap, rod = pressure[:, CAP].copy(), pressure[:, ROD].copy()
        return LegFeedback(extension.copy(), np.zeros(legs), np.zeros(legs), cap, rod)

    return Memory(
        extension=extension,
        extension_before=extension.copy(),
        mean_velocity=np.zeros(legs),
        mean_velocity_before=np.zeros(legs),
        force=np.zeros(legs),
        truth=feedback_at_rest(),
        feedback=feedback_at_rest(),
        reference=extension.copy(),
        command=np.zeros((delay + 1, legs)),
        gimbal_error=np.zeros(1),
        progress=record_array(Progress, [Progress()]),
    )


@compiled
def _find_bound_left(hydraulics, pressures, extension):  # type: ignore[no-untyped-def]
    """The bound that is left, -1 for none, and the leg."""
    cylinders, proof_pressure = hydraulics.cylinder, hydraulics.proof_pressure
    for leg in range(extension.shape[0]):
        for side in range(2):
            pressure = pressures[leg, side]
            if not np.isfinite(pressure):
                return FINITE, leg
            if pressure < -ATMOSPHERE:
                return VACUUM, leg
            if pressure > proof_pressure:
                return PROOF, leg
        if not abs(extension[leg]) < cylinders[leg].half_stroke + _STOP_TRAVEL:
            return STROKE if np.isfinite(extension[leg]) else FINITE, leg
    return -1, 0


@inlined
def _has_warned(warnings):  # type: ignore[no-untyped-def]
    """Whether MuJoCo has warned of anything."""
    bits = 0
    for i in range(warnings.shape[0]):
        bits |= warnings[i]
    return bits != 0


@compiled
def _apply_next_event(timeline, faults, payload, bodies, progress, position):  # type: ignore[no-untyped-def]
    """Apply the next event; one that calls for it makes an emergency stop."""
    if apply_event(timeline, progress.event, faults, position):
        progress.stopped = 1
    progress.event += 1
    for body in bodies:
        payload[body, 2] = -faults.plant[0].overload / bodies.shape[0]


@inlined
def _move(mechanics, hydraulics, state, faults, memory, command, has_started, senses):  # type: ignore[no-untyped-def]
    """Position stage of a step, and pressures up to it; whether they have a solution.

    The command is that at the valves. Position and velocity sensors are read if `senses`.
    """
    call(mechanics.position_stage, mechanics.model if senses else mechanics.quiet, mechanics.data)
    extension, extension_before = memory.extension, memory.extension_before
    for leg in range(extension.shape[0]):
        extension_before[leg] = extension[leg]
        extension[leg] = mechanics.length[mechanics.motors[leg]] - mechanics.neutral[leg]
        memory.mean_velocity_before[leg] = memory.mean_velocity[leg]
        memory.mean_velocity[leg] = (extension[leg] - extension_before[leg]) / hydraulics.step
    if has_started:
        stopped = memory.progress[0].stopped != 0
        if not advance(hydraulics, state, faults, command, extension_before, extension, stopped):
            return False
    write_loads(hydraulics.cylinder, state.pressure, state.friction, memory.force)
    return True


@inlined
def _sense(dynamics, controller, memory, frame):  # type: ignore[no-untyped-def]
    """Apply events that are due, then write the true motion and pressures, and the feedback."""
    timeline, faults, mechanics = dynamics.timeline, dynamics.faults, dynamics.mechanics
    progress, truth, feedback = memory.progress[0], memory.truth, memory.feedback
    while progress.event < timeline.frame.shape[0] and timeline.frame[progress.event] <= frame:
        payload, bodies = mechanics.payload, mechanics.payload_bodies
        _apply_next_event(timeline, faults, payload, bodies, progress, feedback.position)
    pressure, step = dynamics.state.pressure, dynamics.hydraulics.step
    for leg in range(memory.extension.shape[0]):
        mean, mean_before = memory.mean_velocity[leg], memory.mean_velocity_before[leg]
        truth.position[leg] = memory.extension[leg]
        truth.velocity[leg] = true_velocity(mean, mean_before)
        truth.acceleration[leg] = true_acceleration(mean, mean_before, step)
        truth.cap_pressure[leg] = pressure[leg, CAP]
        truth.rod_pressure[leg] = pressure[leg, ROD]
    reads_inertial = controller.dcl.feedback.gravity_compensation
    measure(controller.electronics, faults, frame, truth, reads_inertial, feedback)


@compiled
def _reset(electronics, guard, progress, integral, position):  # type: ignore[no-untyped-def]
    """Forget a fault the operator has reset, after noting it; the supply is open again.

    The error integral starts again: it has wound up while the valves could not answer.
    """
    fault = guard.detection[0]
    if fault.code != FaultCode.NONE.value:
        progress.reset_code, progress.reset_leg = fault.code, fault.leg
        progress.reset_frame = fault.frame
    reset(guard, position)
    release(electronics)
    integral[:] = 0.0
    progress.tripped, progress.stopped = 0, 0


@inlined
def _find_reference(controller, memory, frame):  # type: ignore[no-untyped-def]
    """Let the source give its reference; returns the gain on the valve command."""
    source, guard = controller.source, controller.guard
    progress, position = memory.progress[0], memory.feedback.position
    tripped = progress.tripped != 0 or progress.stopped != 0
    gain = front.follow(source, frame, position, guard.detection[0].code, tripped, memory.reference)
    latch_outside_fault(guard, front.source_fault(source), frame)
    if front.take_reset(source):
        integral = controller.state.error.integral
        _reset(controller.electronics, guard, progress, integral, position)
    return gain


@inlined
def _find_command(controller, memory, gain):  # type: ignore[no-untyped-def]
    """Put the frame's command behind those on their way to the valves."""
    command, reference = memory.command, memory.reference
    for age in range(controller.delay, 0, -1):
        for leg in range(reference.shape[0]):
            command[age, leg] = command[age - 1, leg]
    if controller.closed:
        control.step(controller.dcl, controller.state, reference, memory.feedback)
        for leg in range(reference.shape[0]):
            command[0, leg] = gain * controller.dcl.workspace.command[leg]
    else:
        for leg in range(reference.shape[0]):
            command[0, leg] = reference[leg]


@compiled
def _calls_for_stop(protection, guard, frame, reference, feedback, supply, age, closed):  # type: ignore[no-untyped-def]
    """Whether this frame's readings call for an emergency stop."""
    code = check_frame(protection, guard, frame, reference, feedback, supply, age)
    return code != FaultCode.NONE.value and (_NEEDS_STOP[code] or not closed)


@inlined
def _send_command(controller, memory, supply, frame):  # type: ignore[no-untyped-def]
    """Pass the command on through the servo electronics, and stop where the protection says so."""
    electronics, source, progress = controller.electronics, controller.source, memory.progress[0]
    watches_lower, position = front.watches_switches(source), memory.truth.position
    if deliver(electronics, watches_lower, position, memory.command[0]):
        progress.tripped = 1
    if controller.guarded and progress.stopped == 0:
        feedback, closed = inertial_feedback(electronics, memory.feedback), controller.closed
        target = controller.dcl.workspace.limited_demand if closed else feedback.position
        protection, guard, age = controller.protection, controller.guard, front.host_age(source)
        pressure = supply[SUPPLY_PRESSURE]
        if _calls_for_stop(protection, guard, frame, target, feedback, pressure, age, closed):
            progress.stopped = 1


@inlined
def _note_gimbal_error(gimbals, site, gimbal_error):  # type: ignore[no-untyped-def]
    """Note the largest distance between the halves of a gimbal."""
    for i in range(gimbals.shape[0]):
        a, b = gimbals[i, 0], gimbals[i, 1]
        x, y, z = site[a, 0] - site[b, 0], site[a, 1] - site[b, 1], site[a, 2] - site[b, 2]
        gimbal_error[0] = max(gimbal_error[0], np.sqrt(x * x + y * y + z * z))


@compiled
def _write(row, columns, memory, work, feedback, state, qpos, closed):  # type: ignore[no-untyped-def]
    """Write a row, but for the demand and MuJoCo's sensors."""
    for leg in range(memory.extension.shape[0]):
        if closed:
            row[columns.leg_reference + leg] = work.limited_demand[leg]
            row[columns.compensator_output + leg] = work.output[leg]
        row[columns.leg_position + leg] = feedback.position[leg]
        row[columns.leg_velocity + leg] = feedback.velocity[leg]
        row[columns.leg_acceleration + leg] = feedback.acceleration[leg]
        row[columns.leg_extension + leg] = memory.extension[leg]
        row[columns.valve_command + leg] = memory.command[0, leg]
        row[columns.valve_opening + leg] = 0.5 * (state.spool[leg, 0] + state.spool[leg, 1])
        row[columns.cap_pressure + leg] = feedback.cap_pressure[leg]
        row[columns.rod_pressure + leg] = feedback.rod_pressure[leg]
        row[columns.leg_force + leg] = memory.force[leg]
    row[columns.gimbal_error] = memory.gimbal_error[0]
    memory.gimbal_error[0] = 0.0
    for i in range(state.supply.shape[0]):
        row[columns.supply_content + i] = state.supply[i]
    for i in range(state.energy.shape[0]):
        row[columns.energy + i] = state.energy[i]
    for i in range(qpos.shape[0]):
        row[columns.generalised_position + i] = qpos[i]


@inlined
def _record(recorder, row_number, controller, mechanics, state, memory, frame):  # type: ignore[no-untyped-def]
    """Write a row of the record."""
    row, columns, closed = recorder.out[row_number], recorder.columns, controller.closed
    front.record_demand(controller.source, frame, row, columns)
    work = controller.dcl.workspace
    _write(row, columns, memory, work, memory.feedback, state, mechanics.qpos, closed)
    for i in range(recorder.sensors.shape[0]):
        row[columns.sensors + i] = mechanics.sensordata[recorder.sensors[i]]


@inlined
def _accelerate(mechanics, force, senses):  # type: ignore[no-untyped-def]
    """Force stage of a step; whether MuJoCo warns. It reads sensors of acceleration if `senses`."""
    for leg in range(force.shape[0]):
        mechanics.ctrl[mechanics.motors[leg]] = force[leg]
    call(mechanics.force_stage, mechanics.model if senses else mechanics.quiet, mechanics.data)
    return _has_warned(mechanics.warnings)


@compiled
def run(dynamics, controller, memory, recorder, first, last):  # type: ignore[no-untyped-def]
    """Run the control frames from `first` to before `last`; all states are overwritten.

    Returns (frame, bound, leg) where the state left its physical bounds; frame -1 if it did not.
    """
    mechanics, hydraulics, state = dynamics.mechanics, dynamics.hydraulics, dynamics.state
    faults, valve_command = dynamics.faults, memory.command[controller.delay]
    for frame in range(first, last):
        begin_frame(controller.pace, frame)
        is_recorded = frame % recorder.every == 0
        for step in range(recorder.steps):
            has_started, writes_row = frame > 0 or step > 0, step == 0 and is_recorded
            if not _move(
                mechanics, hydraulics, state, faults, memory, valve_command, has_started, writes_row
            ):
                return frame, SOLUTION, 0
            if step == 0:
                _sense(dynamics, controller, memory, frame)
                gain = _find_reference(controller, memory, frame)
                _find_command(controller, memory, gain)
                _send_command(controller, memory, state.supply, frame)
                bound, leg = _find_bound_left(hydraulics, state.pressure, memory.extension)
                if bound >= 0:
                    return frame, bound, leg
            _note_gimbal_error(recorder.gimbals, mechanics.site, memory.gimbal_error)
            if writes_row:
                row_number = frame // recorder.every % recorder.out.shape[0]
                _record(recorder, row_number, controller, mechanics, state, memory, frame)
            ends_at_row = step == recorder.steps - 1 and (frame + 1) % recorder.every == 0
            if _accelerate(mechanics, memory.force, ends_at_row):
                return frame, WARNING, 0
        end_frame(controller.pace, frame)
    return -1, -1, 0
