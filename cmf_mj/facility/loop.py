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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control import dcl as control
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.protection import FAULTS, NO_FAULT, Protection, ProtectionState, protect, reset
from cmf_mj.core.compiled import compiled
from cmf_mj.electronics import sensors
from cmf_mj.electronics.chain import Electronics, deliver, measure, release, without_gravity
from cmf_mj.facility.front import Chain, cleared, follow, host_age, watched
from cmf_mj.facility.pace import Pace, begin, end
from cmf_mj.plant.cylinder import CAP, ROD
from cmf_mj.plant.events import Timeline, strike
from cmf_mj.plant.faults import OVERLOAD, STOPPED, Faults
from cmf_mj.plant.hydraulics import Hydraulics, HydraulicState, advance, loads
from cmf_mj.plant.native import call
from cmf_mj.plant.oil import ATMOSPHERE
from cmf_mj.plant.plant import Mechanics
from cmf_mj.plant.supply import SUPPLY_PRESSURE

LEG_CHANNELS = {
    "leg_reference": "m",
    "leg_position": "m",
    "leg_velocity": "m/s",
    "leg_acceleration": "m/s^2",
    "leg_extension": "m",
    "compensator_output": "1",
    "valve_command": "1",
    "valve_opening": "1",
    "cap_pressure": "Pa",
    "rod_pressure": "Pa",
    "leg_force": "N",
}
"""Channels with a leg axis, in the order of the record's columns."""

_LEG_COLUMNS = len(LEG_CHANNELS)

FINITE, VACUUM, PROOF, STROKE, SOLUTION = range(5)
"""Physical bounds a state may leave: finite numbers, absolute pressure above 0, proof pressure,
mechanical stroke, a solvable stage."""

_BEYOND_STOP = 0.05
"""Travel beyond the mechanical stroke at which a run is stopped [m]; the stops are elastic."""


_UNTRUSTED = tuple(name not in ("none", "host_watchdog", "frame_watchdog") for name in FAULTS)
"""Faults after which the control law cannot be trusted to bring the machine down."""


class Machine(NamedTuple):
    """Plant and its state."""

    mechanics: Mechanics
    hydraulics: Hydraulics
    state: HydraulicState
    faults: Faults
    timeline: Timeline


class Controller(NamedTuple):
    """What commands the valves."""

    closed: bool  #: Whether the DCL does; the table does otherwise.
    dcl: control.Dcl  #: Compiled law.
    state: control.DclState  #: Its state.
    table: NDArray[np.float64]
    """Leg demands [m], or valve commands as fractions, (N, n); read again from the start after its
    last row."""
    delay: int  #: Frames from a DCL frame to its command at the valves.
    guarded: bool  #: Whether a detected fault makes an emergency stop.
    protection: Protection  #: Compiled thresholds.
    guard: ProtectionState  #: What has been detected.
    electronics: Electronics | None
    """Sensors, converters and servo electronics; None for ideal ones."""
    chain: Chain | None  #: Where the reference comes from; None for the table.
    pace: Pace | None  #: Real time; None for as fast as possible.


class Layout(NamedTuple):
    """What the loop records, and how often."""

    sensors: NDArray[np.int64]  #: Indices into sensordata.
    gimbals: NDArray[np.int64]  #: First indices of the gimbal error vectors.
    steps: int  #: Mechanical steps in a frame.
    every: int  #: Frames from row to row.
    out: NDArray[np.float64]
    """Record, (rows, columns); overwritten from the start after its last row."""


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
    marks: NDArray[np.int64]
    """Next event; whether a limit switch has tripped; code, leg and frame of the last fault that
    was reset, (5,)."""


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
        np.zeros(5, dtype=np.int64),
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


@compiled
def _strike(timeline, faults, payload, bodies, marks, position):  # type: ignore[no-untyped-def]
    """Let the next event happen."""
    strike(timeline, marks[0], faults, position)
    marks[0] += 1
    for body in bodies:
        payload[body, 2] = -faults.plant[OVERLOAD] / bodies.shape[0]


@compiled
def _stops(protection, guard, frame, reference, feedback, supply, age, closed):  # type: ignore[no-untyped-def]
    """Whether this frame's readings call for an emergency stop."""
    code = protect(protection, guard, frame, reference, feedback, supply, age)
    return code != NO_FAULT and (_UNTRUSTED[code] or not closed)


@compiled
def _reset(electronics, guard, marks, plant_faults, integral, position):  # type: ignore[no-untyped-def]
    """Forget a fault the operator has reset, after noting it; the supply is open again.

    The error integral starts anew: it has wound up while the valves could not answer.
    """
    if guard.fault[0] != NO_FAULT:
        marks[2:] = guard.fault
    reset(guard, position)
    release(electronics)
    integral[:] = 0.0
    marks[1] = 0
    plant_faults[STOPPED] = 0.0


@compiled
def _record(row, memory, work, feedback, state, qpos, sensordata, indices):  # type: ignore[no-untyped-def]
    """Write a row."""
    legs = memory.extension.shape[0]
    for leg in range(legs):
        row[leg] = work.limited[leg]
        row[legs + leg] = feedback.position[leg]
        row[2 * legs + leg] = feedback.velocity[leg]
        row[3 * legs + leg] = feedback.acceleration[leg]
        row[4 * legs + leg] = memory.extension[leg]
        row[5 * legs + leg] = work.output[leg]
        row[6 * legs + leg] = memory.command[0, leg]
        row[7 * legs + leg] = 0.5 * (state.spool[leg, 0] + state.spool[leg, 1])
        row[8 * legs + leg] = feedback.cap_pressure[leg]
        row[9 * legs + leg] = feedback.rod_pressure[leg]
        row[10 * legs + leg] = memory.load[leg]
    base = _LEG_COLUMNS * legs
    row[base] = memory.closure[0]
    memory.closure[0] = 0.0
    base += 1
    for source in (state.supply, state.energy, qpos):
        size = source.shape[0]
        for i in range(size):
            row[base + i] = source[i]
        base += size
    for i in range(indices.shape[0]):
        row[base + i] = sensordata[indices[i]]


@compiled
def run(machine, controller, memory, layout, first, last):  # type: ignore[no-untyped-def]
    """Run the control frames from `first` to before `last`.

    Args:
        machine: plant, its state overwritten.
        controller: what commands the valves; its states are overwritten.
        memory: of `make_memory`, or as the frames before left it.
        layout: what to record.
        first: first frame.
        last: frame after the last.

    Returns:
        (frame, bound, leg) where the state left its physical bounds; frame -1 if it did not.
    """
    # Everything is taken out of the tuples here, once: in the loop it would be counted each frame.
    mechanics, hydraulics, state = machine.mechanics, machine.hydraulics, machine.state
    faults, timeline = machine.faults, machine.timeline
    model, data = mechanics.model, mechanics.data
    motors, length, neutral, ctrl = (
        mechanics.motors,
        mechanics.length,
        mechanics.neutral,
        mechanics.ctrl,
    )
    sensordata, qpos, bodies = mechanics.sensordata, mechanics.qpos, mechanics.payload_bodies
    cylinders, step, delay = hydraulics.cylinder, hydraulics.step, controller.delay
    dcl, dcl_state, table = controller.dcl, controller.state, controller.table
    protection, guard, closed = controller.protection, controller.guard, controller.closed
    electronics, chain, pace = controller.electronics, controller.chain, controller.pace
    extension, before, mean = memory.extension, memory.before, memory.mean
    mean_before, load, truth = memory.mean_before, memory.load, memory.truth
    feedback, reference, work = memory.feedback, memory.reference, dcl.workspace
    command, marks, closure = memory.command, memory.marks, memory.closure
    plant_faults, supply = faults.plant, state.supply
    newest, oldest = command[0], command[delay]
    limited, commanded = work.limited, work.command
    compensated, inertial = (
        dcl.feedback.gravity_compensation,
        without_gravity(electronics, feedback),
    )
    legs, events, rows = extension.shape[0], timeline.frame, layout.out.shape[0]
    for frame in range(first, last):
        begin(pace, frame)
        row = frame // layout.every % rows if frame % layout.every == 0 else -1
        for inner in range(layout.steps):
            call(mechanics.position_stage, model, data)
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
                while marks[0] < events.shape[0] and events[marks[0]] <= frame:
                    _strike(timeline, faults, mechanics.payload, bodies, marks, feedback.position)
                for leg in range(legs):
                    truth.position[leg] = extension[leg]
                    truth.velocity[leg] = sensors.velocity(mean[leg], mean_before[leg])
                    truth.acceleration[leg] = sensors.acceleration(
                        mean[leg], mean_before[leg], step
                    )
                    truth.cap_pressure[leg] = state.pressure[leg, CAP]
                    truth.rod_pressure[leg] = state.pressure[leg, ROD]
                for age in range(delay, 0, -1):
                    for leg in range(legs):
                        command[age, leg] = command[age - 1, leg]
                measure(electronics, faults, frame, truth, compensated, feedback)
                fault, tripped = guard.fault[0], marks[1] != 0
                gain = follow(
                    chain, frame, table, feedback.position, fault, tripped, row, reference
                )
                if cleared(chain):
                    _reset(
                        electronics,
                        guard,
                        marks,
                        plant_faults,
                        dcl_state.error.integral,
                        feedback.position,
                    )
                if closed:
                    control.step(dcl, dcl_state, reference, feedback)
                    for leg in range(legs):
                        newest[leg] = gain * commanded[leg]
                else:
                    for leg in range(legs):
                        newest[leg] = reference[leg]
                if deliver(electronics, watched(chain), truth.position, newest):
                    marks[1] = 1
                if controller.guarded and plant_faults[STOPPED] == 0.0:
                    wanted = limited if closed else feedback.position
                    pressure, age = supply[SUPPLY_PRESSURE], host_age(chain)
                    if _stops(protection, guard, frame, wanted, inertial, pressure, age, closed):
                        plant_faults[STOPPED] = 1.0
                bound, leg = _bounds(
                    cylinders, hydraulics.proof_pressure, state.pressure, extension
                )
                if bound >= 0:
                    return frame, bound, leg
            for i in layout.gimbals:
                x, y, z = sensordata[i], sensordata[i + 1], sensordata[i + 2]
                closure[0] = max(closure[0], np.sqrt(x * x + y * y + z * z))
            if inner == 0 and row >= 0:
                _record(
                    layout.out[row],
                    memory,
                    work,
                    feedback,
                    state,
                    qpos,
                    sensordata,
                    layout.sensors,
                )
            for leg in range(legs):
                ctrl[motors[leg]] = load[leg]
            call(mechanics.force_stage, model, data)
        end(pace, frame)
    return -1, -1, 0
