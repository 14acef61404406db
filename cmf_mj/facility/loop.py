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
    NO_FAULT,
    Protection,
    ProtectionState,
    latch,
    protect,
    reset,
)
from cmf_mj.core.compiled import compiled, inlined
from cmf_mj.electronics.chain import Electronics, deliver, measure, release, without_gravity
from cmf_mj.electronics.sensors.suite import true_acceleration, true_velocity
from cmf_mj.facility.front import Chain, cleared, follow, found, host_age, record_demand, watched
from cmf_mj.facility.pace import Pace, begin, end
from cmf_mj.facility.record_layout import Columns
from cmf_mj.plant.cylinder import CAP, ROD
from cmf_mj.plant.events import OVERLOAD, STOPPED, Faults, Timeline, strike
from cmf_mj.plant.hydraulics import Hydraulics, HydraulicState, advance, loads
from cmf_mj.plant.native import Mechanics, call
from cmf_mj.plant.oil import ATMOSPHERE
from cmf_mj.plant.supply import SUPPLY_PRESSURE

FINITE, VACUUM, PROOF, STROKE, SOLUTION, WARNING = range(6)
"""Bounds a state may leave: finite numbers, absolute pressure above 0, proof pressure, mechanical
stroke, a solvable stage, and what MuJoCo does not warn of."""

_BEYOND_STOP = 0.05
"""Travel beyond the mechanical stroke at which a run is stopped [m]; the stops are elastic."""


_TRUSTED = ("none", "host_watchdog", "frame_watchdog", "not_arrived", "host_range")
_UNTRUSTED = tuple(name not in _TRUSTED for name in FAULTS)
"""Faults after which the control law cannot be trusted to bring the machine down."""


class Machine(NamedTuple):
    """Plant and its state."""

    mechanics: Mechanics
    hydraulics: Hydraulics
    state: HydraulicState
    faults: Faults
    timeline: Timeline


class Controller(NamedTuple):
    """What commands the valves.

    Electronics, chain and pace are None in a bare run, and all three there in any other, idle where
    it has no use for them: the loop is compiled in these two variants.
    """

    closed: bool  #: Whether the DCL does; the table does otherwise.
    dcl: control.Dcl  #: Compiled law.
    state: control.DclState  #: Its state.
    table: NDArray[np.float64]
    """Leg demands [m], or valve commands as fractions, (N, n); read again from the start after its
    last row."""
    poses: NDArray[np.float64]
    """Platform demand of the table's rows [m, rad], (N, 6); (1, 0) where there is none."""
    delay: int  #: Frames from a DCL frame to its command at the valves.
    guarded: bool  #: Whether a detected fault makes an emergency stop.
    protection: Protection  #: Compiled thresholds.
    guard: ProtectionState  #: What has been detected.
    electronics: Electronics | None  #: Sensors, converters and servo electronics.
    chain: Chain | None  #: Where the reference comes from, if not from the table.
    pace: Pace | None  #: Real time.


class Recorder(NamedTuple):
    """What the loop records, and how often."""

    sensors: NDArray[np.int64]  #: Indices into sensordata.
    gimbals: NDArray[np.int64]  #: Sites of the two halves of each gimbal, (gimbals, 2).
    steps: int  #: Mechanical steps in a frame.
    every: int  #: Frames from row to row.
    columns: Columns  #: First column of each channel in a row.
    out: NDArray[np.float64]
    """Record, (rows, columns); overwritten from the start after its last row."""


PROGRESS = np.dtype([("event", np.int64), ("tripped", np.int64), ("fault", np.int64, 3)])
"""Next event on the time line; whether a limit switch has tripped; code, leg and frame of the last
fault that was reset."""


class Memory(NamedTuple):
    """What the loop keeps from frame to frame, so that it can be run in parts."""

    extension: NDArray[np.float64]  #: Extensions at the last step [m], (n,).
    before: NDArray[np.float64]  #: Those of the step before, (n,).
    mean: NDArray[np.float64]  #: Mean velocity between them [m/s], (n,).
    mean_before: NDArray[np.float64]  #: That of the step before, (n,).
    load: NDArray[np.float64]  #: Cylinder forces [N], (n,).
    truth: LegFeedback  #: True motion and pressures.
    feedback: LegFeedback  #: What the DCL reads.
    reference: NDArray[np.float64]  #: Leg reference [m], (n,).
    command: NDArray[np.float64]
    """Commands on their way to the valves, newest first, (delay + 1, n)."""
    closure: NDArray[np.float64]  #: Largest gimbal error since the last row [m], (1,).
    progress: np.recarray[Any, Any]  #: One row of `PROGRESS`.


def make_memory(machine: Machine, delay: int) -> Memory:
    """Memory of a machine at rest."""
    mechanics = machine.mechanics
    extension = mechanics.length[mechanics.motors] - mechanics.neutral
    legs = extension.size

    def feedback() -> LegFeedback:
        pressure = machine.state.pressure
        cap, rod = pressure[:, CAP].copy(), pressure[:, ROD].copy()
        return LegFeedback(extension.copy(), np.zeros(legs), np.zeros(legs), cap, rod)

    return Memory(
        extension,
        extension.copy(),
        np.zeros(legs),
        np.zeros(legs),
        np.zeros(legs),
        feedback(),
        feedback(),
        extension.copy(),
        np.zeros((delay + 1, legs)),
        np.zeros(1),
        np.zeros(1, dtype=PROGRESS).view(np.recarray),
    )


@compiled
def _bounds(cylinders, proof_pressure, pressures, extension):  # type: ignore[no-untyped-def]
    """Which bound (-1: none) which leg is beyond."""
    for leg in range(extension.shape[0]):
        for side in range(2):
            pressure = pressures[leg, side]
            if not np.isfinite(pressure):
                return FINITE, leg
            if pressure < -ATMOSPHERE:
                return VACUUM, leg
            if pressure > proof_pressure:
                return PROOF, leg
        if not abs(extension[leg]) < cylinders[leg].half_stroke + _BEYOND_STOP:
            return STROKE if np.isfinite(extension[leg]) else FINITE, leg
    return -1, 0


@inlined
def _warned(warnings):  # type: ignore[no-untyped-def]
    """Whether MuJoCo has warned of anything."""
    raised = 0
    for i in range(warnings.shape[0]):
        raised |= warnings[i]
    return raised != 0


@inlined
def _sense(truth, extension, mean, mean_before, step, pressure):  # type: ignore[no-untyped-def]
    """The true motion and pressures at a control frame."""
    for leg in range(extension.shape[0]):
        truth.position[leg] = extension[leg]
        truth.velocity[leg] = true_velocity(mean[leg], mean_before[leg])
        truth.acceleration[leg] = true_acceleration(mean[leg], mean_before[leg], step)
        truth.cap_pressure[leg] = pressure[leg, CAP]
        truth.rod_pressure[leg] = pressure[leg, ROD]


@compiled
def _strike(timeline, faults, payload, bodies, progress, position):  # type: ignore[no-untyped-def]
    """Let the next event happen."""
    strike(timeline, progress.event, faults, position)
    progress.event += 1
    for body in bodies:
        payload[body, 2] = -faults.plant[OVERLOAD] / bodies.shape[0]


@compiled
def _stops(protection, guard, frame, reference, feedback, supply, age, closed):  # type: ignore[no-untyped-def]
    """Whether this frame's readings call for an emergency stop."""
    code = protect(protection, guard, frame, reference, feedback, supply, age)
    return code != NO_FAULT and (_UNTRUSTED[code] or not closed)


@compiled
def _reset(electronics, guard, progress, plant_faults, integral, position):  # type: ignore[no-untyped-def]
    """Forget a fault the operator has reset, after noting it; the supply is open again.

    The error integral starts again: it has wound up while the valves could not answer.
    """
    if guard.fault[0] != NO_FAULT:
        for i in range(3):
            progress.fault[i] = guard.fault[i]
    reset(guard, position)
    release(electronics)
    integral[:] = 0.0
    progress.tripped = 0
    plant_faults[STOPPED] = 0.0


@compiled
def _record(row, at, memory, work, feedback, state, qpos, closed):  # type: ignore[no-untyped-def]
    """Write a row, its first columns given by `at`, but for demand and sensors."""
    for leg in range(memory.extension.shape[0]):
        if closed:
            row[at.leg_reference + leg] = work.limited[leg]
            row[at.compensator_output + leg] = work.output[leg]
        row[at.leg_position + leg] = feedback.position[leg]
        row[at.leg_velocity + leg] = feedback.velocity[leg]
        row[at.leg_acceleration + leg] = feedback.acceleration[leg]
        row[at.leg_extension + leg] = memory.extension[leg]
        row[at.valve_command + leg] = memory.command[0, leg]
        row[at.valve_opening + leg] = 0.5 * (state.spool[leg, 0] + state.spool[leg, 1])
        row[at.cap_pressure + leg] = feedback.cap_pressure[leg]
        row[at.rod_pressure + leg] = feedback.rod_pressure[leg]
        row[at.leg_force + leg] = memory.load[leg]
    row[at.gimbal_error] = memory.closure[0]
    memory.closure[0] = 0.0
    for i in range(state.supply.shape[0]):
        row[at.supply_content + i] = state.supply[i]
    for i in range(state.energy.shape[0]):
        row[at.energy + i] = state.energy[i]
    for i in range(qpos.shape[0]):
        row[at.generalised_position + i] = qpos[i]


@compiled
def run(machine, controller, memory, recorder, first, last):  # type: ignore[no-untyped-def]
    """Run the control frames from `first` to before `last`; all states are overwritten.

    Returns (frame, bound, leg) where the state left its physical bounds; frame -1 if it did not.
    """
    # Everything is taken out of the tuples here, once: in the loop it would be counted each frame.
    mechanics, hydraulics, state = machine.mechanics, machine.hydraulics, machine.state
    faults, timeline = machine.faults, machine.timeline
    model, quiet, data = mechanics.model, mechanics.quiet, mechanics.data
    motors, length = mechanics.motors, mechanics.length
    neutral, ctrl = mechanics.neutral, mechanics.ctrl
    sensordata, site, qpos = mechanics.sensordata, mechanics.site, mechanics.qpos
    payload, bodies = mechanics.payload, mechanics.payload_bodies
    warnings = mechanics.warnings
    cylinders, step, delay = hydraulics.cylinder, hydraulics.step, controller.delay
    dcl, dcl_state, table = controller.dcl, controller.state, controller.table
    protection, guard, closed = controller.protection, controller.guard, controller.closed
    electronics, chain, pace = controller.electronics, controller.chain, controller.pace
    extension, before, mean = memory.extension, memory.before, memory.mean
    mean_before, load, truth = memory.mean_before, memory.load, memory.truth
    feedback, reference, work = memory.feedback, memory.reference, dcl.workspace
    command, progress, closure = memory.command, memory.progress[0], memory.closure
    plant_faults, supply = faults.plant, state.supply
    newest, oldest = command[0], command[delay]
    limited, commanded = work.limited, work.command
    compensated = dcl.feedback.gravity_compensation
    inertial = without_gravity(electronics, feedback)
    legs, events, rows = extension.shape[0], timeline.frame, recorder.out.shape[0]
    columns, indices, gimbals = recorder.columns, recorder.sensors, recorder.gimbals
    steps = recorder.steps
    for frame in range(first, last):
        begin(pace, frame)
        row = frame // recorder.every % rows if frame % recorder.every == 0 else -1
        for inner in range(steps):
            # Position and velocity sensors are read after this stage, those of acceleration after
            # the force stage before it.
            call(mechanics.position_stage, model if inner == 0 and row >= 0 else quiet, data)
            for leg in range(legs):
                before[leg] = extension[leg]
                extension[leg] = length[motors[leg]] - neutral[leg]
                mean_before[leg] = mean[leg]
                mean[leg] = (extension[leg] - before[leg]) / step
            if frame > 0 or inner > 0:
                if not advance(hydraulics, state, faults, oldest, before, extension):
                    return frame, SOLUTION, 0
            loads(cylinders, state.pressure, state.friction, load)
            if inner == 0:
                while progress.event < events.shape[0] and events[progress.event] <= frame:
                    _strike(timeline, faults, payload, bodies, progress, feedback.position)
                _sense(truth, extension, mean, mean_before, step, state.pressure)
                for age in range(delay, 0, -1):
                    for leg in range(legs):
                        command[age, leg] = command[age - 1, leg]
                measure(electronics, faults, frame, truth, compensated, feedback)
                fault = guard.fault[0]
                tripped = progress.tripped != 0 or plant_faults[STOPPED] != 0.0
                gain = follow(chain, table, frame, feedback.position, fault, tripped, reference)
                latch(guard, found(chain), frame)
                if cleared(chain):
                    integral = dcl_state.error.integral
                    _reset(electronics, guard, progress, plant_faults, integral, feedback.position)
                if closed:
                    control.step(dcl, dcl_state, reference, feedback)
                    for leg in range(legs):
                        newest[leg] = gain * commanded[leg]
                else:
                    for leg in range(legs):
                        newest[leg] = reference[leg]
                if deliver(electronics, watched(chain), truth.position, newest):
                    progress.tripped = 1
                if controller.guarded and plant_faults[STOPPED] == 0.0:
                    target = limited if closed else feedback.position
                    pressure, age = supply[SUPPLY_PRESSURE], host_age(chain)
                    if _stops(protection, guard, frame, target, inertial, pressure, age, closed):
                        plant_faults[STOPPED] = 1.0
                bound, leg = _bounds(
                    cylinders, hydraulics.proof_pressure, state.pressure, extension
                )
                if bound >= 0:
                    return frame, bound, leg
            for i in range(gimbals.shape[0]):
                a, b = gimbals[i, 0], gimbals[i, 1]
                x, y, z = site[a, 0] - site[b, 0], site[a, 1] - site[b, 1], site[a, 2] - site[b, 2]
                closure[0] = max(closure[0], np.sqrt(x * x + y * y + z * z))
            if inner == 0 and row >= 0:
                out = recorder.out[row]
                record_demand(chain, controller.poses, frame, out, columns)
                _record(out, columns, memory, work, feedback, state, qpos, closed)
                for i in range(indices.shape[0]):
                    out[columns.sensors + i] = sensordata[indices[i]]
            for leg in range(legs):
                ctrl[motors[leg]] = load[leg]
            sensed = inner == steps - 1 and (frame + 1) % recorder.every == 0
            call(mechanics.force_stage, model if sensed else quiet, data)
            if _warned(warnings):
                return frame, WARNING, 0
        end(pace, frame)
    return -1, -1, 0
