"""The compiled law and servo electronics against a sampled linear plant, frame by frame."""

import numpy as np

from cmf_mj.control import dcl as blocks
from cmf_mj.core.compiled import allocating
from cmf_mj.electronics import servo_electronics as servo


@allocating
def run(dcl, state, drive, driven, plant, demand, feedback, legs_out):  # type: ignore[no-untyped-def]
    """Run the law against a sampled linear plant (A, B, C), one frame of delay."""
    a, b, c = plant
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
        servo.step(drive, driven, True, command, feedback.position)
