"""The compiled frame loop: one closed loop for every plant, law and experiment.

One control frame T = 1/2048 s, with m mechanical steps h = T / m in it:

    for each step k:  position stage of MuJoCo at t[k]: extensions l[k]
                      pressures advance from t[k-1] to t[k] between l[k-1] and l[k]
                      (at a frame) events, sensors, DCL, record
                      cylinder forces of the pressures at t[k] -> force stage: l[k+1]

The order makes the coupling second order at no extra step: the force acts at the instant of its
pressures, and a pressure sees the displacement MuJoCo's leapfrog really made. The command of a
frame reaches the valves a whole number of frames later, one by default: the time the DCL computes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import sensors
from cmf_mj.compiled import compiled
from cmf_mj.control import dcl as control
from cmf_mj.control.law import SIGNALS
from cmf_mj.control.protection import NO_FAULT, Protection, ProtectionState, protect
from cmf_mj.events import Timeline, read_position, strike
from cmf_mj.plant.cylinder import CAP, ROD
from cmf_mj.plant.faults import OVERLOAD, STOPPED, Faults
from cmf_mj.plant.hydraulics import Hydraulics, HydraulicState, advance, forces
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


class Machine(NamedTuple):
    """Plant and its state."""

    mechanics: Mechanics
    hydraulics: Hydraulics
    state: HydraulicState
    faults: Faults
    timeline: Timeline


class Controller(NamedTuple):
    """What commands the valves."""

    closed: bool
    """Whether the DCL does; the table does otherwise."""
    dcl: control.Dcl
    """Compiled law."""
    state: control.DclState
    """Its state."""
    reference: NDArray[np.float64]
    """Leg demands [m], or valve commands as fractions, (N, n)."""
    delay: int
    """Frames from a DCL frame to its command at the valves."""
    guarded: bool
    """Whether a detected fault makes an emergency stop."""
    protection: Protection
    """Compiled thresholds."""
    guard: ProtectionState
    """What has been detected."""


class Layout(NamedTuple):
    """What the loop records, and how often."""

    sensors: NDArray[np.int64]
    """Indices into sensordata."""
    gimbals: NDArray[np.int64]
    """First indices of the gimbal error vectors."""
    steps: int
    """Mechanical steps in a frame."""
    every: int
    """Frames from row to row."""


@compiled
def _bounds(machine, extension):  # type: ignore[no-untyped-def]
    """Which bound (-1: none) which leg is beyond."""
    hydraulics, state = machine.hydraulics, machine.state
    for leg in range(extension.shape[0]):
        for side in range(2):
            pressure = state.pressure[leg, side]
            if not np.isfinite(pressure):
                return FINITE, leg
            if pressure < -ATMOSPHERE:
                return VACUUM, leg
            if pressure > hydraulics.proof_pressure:
                return PROOF, leg
        if not abs(extension[leg]) < hydraulics.cylinder[leg].half_stroke + _BEYOND_STOP:
            return STROKE if np.isfinite(extension[leg]) else FINITE, leg
    return -1, 0


@compiled
def run(machine, controller, layout, out):  # type: ignore[no-untyped-def]
    """Run all frames.

    Args:
        machine: plant, its state overwritten.
        controller: DCL or table of valve commands; its state is overwritten.
        layout: what to record.
        out: (rows, columns), overwritten.

    Returns:
        (frame, bound, leg) where the state left its physical bounds; frame -1 if it did not.
    """
    mechanics, hydraulics, state = machine.mechanics, machine.hydraulics, machine.state
    faults, timeline = machine.faults, machine.timeline
    reference, delay, step = controller.reference, controller.delay, hydraulics.step
    frames, legs = reference.shape
    motors = mechanics.motors
    extension = np.empty(legs)
    for leg in range(legs):
        extension[leg] = mechanics.length[motors[leg]] - mechanics.neutral[leg]
    before = extension.copy()
    mean = np.zeros(legs)
    mean_before = np.zeros(legs)
    load = np.zeros(legs)
    feedback = control.LegFeedback(
        np.zeros(legs), np.zeros(legs), np.zeros(legs), np.zeros(legs), np.zeros(legs)
    )
    signals = np.zeros((legs, len(SIGNALS)))
    output = np.zeros(legs)
    command = np.zeros((delay + 1, legs))
    closure = 0.0
    event = 0
    for frame in range(frames):
        for inner in range(layout.steps):
            call(mechanics.position_stage, mechanics.model, mechanics.data)
            for leg in range(legs):
                before[leg] = extension[leg]
                extension[leg] = mechanics.length[motors[leg]] - mechanics.neutral[leg]
                mean_before[leg] = mean[leg]
                mean[leg] = (extension[leg] - before[leg]) / step
            if (frame > 0 or inner > 0) and not advance(
                hydraulics, state, faults, command[delay], before, extension
            ):
                return frame, SOLUTION, 0
            forces(hydraulics, state, load)
            if inner == 0:
                while event < timeline.frame.shape[0] and timeline.frame[event] <= frame:
                    strike(timeline, event, faults, feedback.position)
                    event += 1
                    for body in mechanics.payload_bodies:
                        share = faults.plant[OVERLOAD] / mechanics.payload_bodies.shape[0]
                        mechanics.payload[body, 2] = -share
                for leg in range(legs):
                    feedback.position[leg] = read_position(faults, leg, extension[leg])
                    feedback.velocity[leg] = sensors.velocity(mean[leg], mean_before[leg])
                    feedback.acceleration[leg] = sensors.acceleration(
                        mean[leg], mean_before[leg], step
                    )
                    feedback.cap_pressure[leg] = state.pressure[leg, CAP]
                    feedback.rod_pressure[leg] = state.pressure[leg, ROD]
                for age in range(delay, 0, -1):
                    command[age] = command[age - 1]
                if controller.closed:
                    control.step(
                        controller.dcl,
                        controller.state,
                        reference[frame],
                        feedback,
                        signals,
                        output,
                        command[0],
                    )
                else:
                    command[0] = reference[frame]
                if controller.guarded and faults.plant[STOPPED] == 0.0:
                    supply = state.supply[SUPPLY_PRESSURE]
                    code = protect(
                        controller.protection,
                        controller.guard,
                        frame,
                        signals[:, 0],
                        feedback,
                        supply,
                    )
                    if code != NO_FAULT:
                        faults.plant[STOPPED] = 1.0
                bound, leg = _bounds(machine, extension)
                if bound >= 0:
                    return frame, bound, leg
            for i in layout.gimbals:
                x, y, z = mechanics.sensordata[i : i + 3]
                closure = max(closure, np.sqrt(x * x + y * y + z * z))
            if inner == 0 and frame % layout.every == 0:
                row = out[frame // layout.every]
                for leg in range(legs):
                    row[leg] = signals[leg, 0]
                    row[legs + leg] = feedback.position[leg]
                    row[2 * legs + leg] = feedback.velocity[leg]
                    row[3 * legs + leg] = feedback.acceleration[leg]
                    row[4 * legs + leg] = extension[leg]
                    row[5 * legs + leg] = output[leg]
                    row[6 * legs + leg] = command[0, leg]
                    row[7 * legs + leg] = 0.5 * (state.spool[leg, 0] + state.spool[leg, 1])
                    row[8 * legs + leg] = state.pressure[leg, CAP]
                    row[9 * legs + leg] = state.pressure[leg, ROD]
                    row[10 * legs + leg] = load[leg]
                base = _LEG_COLUMNS * legs
                row[base] = closure
                closure = 0.0
                base += 1
                for source in (state.supply, state.energy, mechanics.qpos):
                    size = source.shape[0]
                    for i in range(size):
                        row[base + i] = source[i]
                    base += size
                for i in range(layout.sensors.shape[0]):
                    row[base + i] = mechanics.sensordata[layout.sensors[i]]
            for leg in range(legs):
                mechanics.ctrl[motors[leg]] = load[leg]
            call(mechanics.force_stage, mechanics.model, mechanics.data)
    return -1, -1, 0
