"""Peaks of a command and the limits it must keep, known before the run.

With q the pose or the leg extensions at the control frames and T the time between,

    velocity = max |q[k] - q[k-1]| / T,    acceleration = max |q[k+1] - 2 q[k] + q[k-1]| / T^2

from rest at the first pose. A sine of frequency f reads low by (pi f T)^2 / 6 and (pi f T)^2 / 3:
4e-5 and 8e-5 at 10 Hz.

A jump has no rate. Where the largest difference stands alone among its neighbours the peak is
infinite: velocity and acceleration of a step, a pulse or a staircase, acceleration where a command
starts or stops in motion (a chirp or multisine without `fade`).
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.signals.signal import Command

Array = NDArray[np.float64]

_JUMP = 4.0  #: A difference this many times both neighbours together is a jump.


class Peaks(NamedTuple):
    """Largest magnitudes of a command; degrees of freedom in the order of a pose."""

    displacement: Array  #: Of the degrees of freedom [m, rad], (6,).
    velocity: Array  #: [m/s, rad/s], (6,); infinite for a jump of position.
    acceleration: Array  #: [m/s^2, rad/s^2], (6,); infinite for a jump of velocity.
    leg_displacement: Array  #: Of the legs from neutral [m], (6,).
    leg_velocity: Array  #: [m/s], (6,); infinite where one of the above is.
    leg_acceleration: Array  #: [m/s^2], (6,); infinite where one of the above is.


def peaks(command: Command, machine: str | Path | Machine = models.CMF) -> Peaks:
    """Largest displacement, velocity and acceleration per degree of freedom and per leg."""
    legs = pose_to_legs(command.pose, machine)
    velocity, acceleration = _rates(command.pose, command.rate)
    leg_velocity, leg_acceleration = _rates(legs, command.rate)
    if np.isinf(velocity).any():
        leg_velocity = np.where(leg_velocity > 0.0, np.inf, 0.0)
    if np.isinf(acceleration).any():
        leg_acceleration = np.where(leg_acceleration > 0.0, np.inf, 0.0)
    return Peaks(
        displacement=np.abs(command.pose).max(axis=0),
        velocity=velocity,
        acceleration=acceleration,
        leg_displacement=np.abs(legs).max(axis=0),
        leg_velocity=leg_velocity,
        leg_acceleration=leg_acceleration,
    )


def check_limits(command: Command, machine: str | Path | Machine = models.CMF) -> Peaks:
    """Peaks of a command within a machine's limits; call it before the run.

    These are its operational displacements, of the CMF those of Table 2-1, and the working stroke
    of its legs; velocities and accelerations are free. Raises an `InputError` that lists each
    quantity beyond its limit.
    """
    loaded = load_machine(machine)
    limits, stroke = load_motion_limits(None, loaded).operational, loaded.working_stroke
    command_peaks = peaks(command, loaded)
    faults = []
    for i, dof in enumerate(DOFS):
        unit, (low, high) = by_kind(dof, "m", "rad"), limits[i]
        history = command.pose[:, i]
        for value in {float(history.min()), float(history.max())}:
            if not low <= value <= high:
                faults.append(f"{dof}: {value:.4g} {unit}; allowed: {low:.4g} to {high:.4g} {unit}")
    for leg, value in enumerate(command_peaks.leg_displacement, start=1):
        if value > stroke:
            faults.append(f"leg {leg} displacement: {value:.4g} m; allowed: at most {stroke:.4g} m")
    if faults:
        raise InputError("; ".join(faults))
    return command_peaks


def _rates(history: Array, rate: int) -> tuple[Array, Array]:
    """Peak velocity and acceleration of each column, from rest; infinite for jumps."""
    velocity = np.diff(history, axis=0, prepend=history[:1]) * rate
    acceleration = np.diff(velocity, axis=0, prepend=0.0 * velocity[:1]) * rate
    jumps = _stands_alone(velocity)
    return (
        np.where(jumps, np.inf, np.abs(velocity).max(axis=0)),
        np.where(jumps | _stands_alone(acceleration), np.inf, np.abs(acceleration).max(axis=0)),
    )


def _stands_alone(rate: Array) -> NDArray[np.bool_]:
    """Whether each column's largest magnitude is a single sample, (columns,)."""
    size = np.pad(np.abs(rate), ((1, 1), (0, 0)))
    peak = size.argmax(axis=0)
    columns = np.arange(size.shape[1])
    neighbours = size[peak - 1, columns] + size[peak + 1, columns]
    return np.asarray(size[peak, columns] > _JUMP * neighbours)
