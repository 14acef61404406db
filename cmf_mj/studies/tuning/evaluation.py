"""What a law does on linear plants: bandwidths, peaks and overshoots of all cabs at once.

Frequency responses come from the linearised plant and the linear law. Steps run the compiled law
with its clamps, and the servo electronics with theirs, against the linearised plant, frame by
frame, so that the step sees the valves' saturation and the drive's rate limit; what only the
simulation has is the square root of the ports, and the geometry.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop, closed_loop_response
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.analysis.linear.poles import oscillations
from cmf_mj.analysis.modes import bound
from cmf_mj.control import dcl as blocks
from cmf_mj.control.engage import engaged_state
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law
from cmf_mj.core.compiled import allocating
from cmf_mj.core.threads import on_threads
from cmf_mj.electronics import servo_electronics as servo
from cmf_mj.facility.unknowns import valve_gains
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import fitting
from cmf_mj.studies.case import REPORT_AMPLITUDES, STEP_PER_AMPLITUDE

LINES = np.concatenate([np.arange(0.5, 3.0, 0.5), np.arange(3.0, 10.01, 0.25)])
"""Frequencies of the responses [Hz]; the report's chirp ends at 10 Hz."""

STEP_TIME = 0.7  #: Length of the steps [s].

STEPPED_DOFS = ((1,), (3,), (4,), (0, 1, 2, 3, 4, 5))
"""Degrees of freedom that are stepped: sway, roll, pitch, and all at once. Surge is much like sway,
heave and yaw are easier."""


@allocating
def run_linear_loop(dcl, state, drive, drive_state, matrices, demand, feedback, legs_out):  # type: ignore[no-untyped-def]
    """Run the law against a sampled linear plant, `matrices` A, B, C, with one frame of delay.

    The legs' positions of all frames are written to `legs_out`, (frames, legs).
    """
    a, b, c = matrices
    legs, command = demand.shape[0], dcl.workspace.command
    x = np.zeros(a.shape[0])
    for frame in range(legs_out.shape[0]):
        y = c @ x
        for leg in range(legs):
            feedback.position[leg] = y[leg]
            feedback.velocity[leg] = y[legs + leg]
            feedback.acceleration[leg] = y[2 * legs + leg]
            feedback.cap_pressure[leg] = y[3 * legs + leg]
            feedback.rod_pressure[leg] = y[4 * legs + leg]
        legs_out[frame] = feedback.position
        x = a @ x + b @ command
        blocks.step(dcl, state, demand, feedback)
        servo.step(drive, drive_state, True, command, feedback.position)


class LinearCab(NamedTuple):
    """A cab on linear hydraulics."""

    carrier: Cab  #: The cab on its machine.
    jacobian: NDArray[np.float64]  #: Legs of pose, (6, 6).
    velocity: NDArray[np.complex128]  #: Responses of leg velocities to commands, (K, 6, 6).
    pressures: tuple[NDArray[np.complex128], NDArray[np.complex128]]
    """Those of cap and rod pressures."""
    matrices: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
    """A, B, C at the machine's control rate, outputs `FEEDBACK`."""
    system: control.StateSpace  #: The same with names, and all outputs.


def linear_cab(plant: Hexapod, friction: Contact | None = None) -> LinearCab:
    """Linearise a plant at neutral; `friction` as `linearize` takes it."""
    system = linearize(plant, friction=friction)
    legs, omega = plant.legs, 2.0 * np.pi * LINES
    response = np.moveaxis(control.frequency_response(system, omega).frdata, -1, 0)
    responses = {name: response[:, i * legs : (i + 1) * legs] for i, name in enumerate(FEEDBACK)}
    sampled = control.sample_system(system, plant.machine.frame, method="zoh", copy_names=True)
    a, b, c = (np.ascontiguousarray(part) for part in (sampled.A, sampled.B, sampled.C))
    assert plant.cab_parameters is not None
    return LinearCab(
        carrier=plant.cab_parameters,
        jacobian=pose_jacobian(np.zeros(6), plant.machine),
        velocity=responses["leg_velocity"],
        pressures=(responses["cap_pressure"], responses["rod_pressure"]),
        matrices=(a, b, np.ascontiguousarray(c[: len(FEEDBACK) * legs])),
        system=sampled,
    )


class Performance(NamedTuple):
    """Measures by cab, set of valve gains and degree of freedom."""

    phase_hz: NDArray[np.float64]
    """-90 deg bandwidth, (cabs, seeds, 6); the last line where it is beyond."""
    peak_db: NDArray[np.float64]  #: Peak gain to 10 Hz, (cabs, seeds, 6).
    overshoot: NDArray[np.float64]  #: Of the step, fraction, (cabs, seeds, 4).
    tail: NDArray[np.float64]
    """Largest distance from the demand in the last tenth of the step, (cabs, seeds, 4)."""


def step_response(
    law: Law, cab: LinearCab, dofs: Sequence[int], gains: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Step of the report's size in some degrees of freedom at once, as fractions of it, (N, m).

    The law is bound to the cab; `dofs` are indices, `gains` valve gains over the nominal, (6,).
    """
    machine, indices = cab.carrier.machine, list(dofs)
    a, b, c = cab.matrices
    size = REPORT_AMPLITUDES[indices] * STEP_PER_AMPLITUDE
    legs = cab.jacobian.shape[0]
    dcl = blocks.make_dcl(law, legs)
    feedback = LegFeedback(*(np.zeros(legs) for _ in FEEDBACK))
    state = engaged_state(dcl, np.zeros(legs), feedback)
    positions = np.empty((round(STEP_TIME * machine.rate), legs))
    demand = cab.jacobian[:, indices] @ size
    settings = servo.load_servo_settings(None, fitting(machine))
    drive, drive_state = servo.make_servo_electronics(settings, law.frame), servo.start(legs)
    matrices = a, np.ascontiguousarray(b * gains), c
    run_linear_loop(dcl, state, drive, drive_state, matrices, demand, feedback, positions)
    return positions @ np.linalg.inv(cab.jacobian)[indices].T / size


def _evaluate_case(law: Law, cab: LinearCab, seed: int | None, scale: float) -> Performance:
    """Measures of one cab and one set of valve gains."""
    bound_law, gains = bound(law, cab.carrier), scale * valve_gains(seed)
    pressures = cab.pressures[0] * gains, cab.pressures[1] * gains
    leg_response = closed_loop_response(bound_law, cab.velocity * gains, LINES, pressures=pressures)
    pose_response = np.linalg.inv(cab.jacobian) @ leg_response @ cab.jacobian
    widths = [line_bandwidths(LINES, pose_response[:, dof, dof]) for dof in range(len(DOFS))]
    phase = np.array([width.phase_hz for width in widths])
    steps = [step_response(bound_law, cab, dofs, gains) for dofs in STEPPED_DOFS]
    return Performance(
        phase_hz=np.where(np.isnan(phase), LINES[-1], phase),
        peak_db=np.array([width.peak_db for width in widths]),
        overshoot=np.array([step.max() - 1.0 for step in steps]),
        tail=np.array([np.abs(step[-len(step) // 10 :] - 1.0).max() for step in steps]),
    )


def evaluate(
    law: Law, cabs: Sequence[LinearCab], seeds: Sequence[int | None], *, scale: float = 1.0
) -> Performance:
    """Measure a law on linear plants of all cabs.

    `seeds` are those of the valve gains, None for the nominal ones; `scale` is a factor on all.
    """
    cases = [partial(_evaluate_case, law, cab, seed, scale) for cab in cabs for seed in seeds]
    results = on_threads(lambda case: case(), cases, jobs=len(cases))
    shape = (len(cabs), len(seeds), -1)
    return Performance(*(np.reshape(parts, shape) for parts in zip(*results, strict=True)))


def least_damping(law: Law, cabs: Sequence[LinearCab]) -> float:
    """Least damping ratio of oscillations with all cabs, at most 1; negative where one grows."""
    loops = [closed_loop(bound(law, cab.carrier), cab.system) for cab in cabs]
    poles = np.concatenate([oscillations(loop.poles(), loop.dt) for loop in loops])
    return float(np.min(-poles.real / np.abs(poles), initial=1.0))
