"""Peaks of a command and the limits it must keep, known before the run.

With q the pose or the leg extensions at the control frames and T the time between,

    velocity = max |q[k] - q[k-1]| / T,    acceleration = max |q[k+1] - 2 q[k] + q[k-1]| / T^2

starting at rest at the first pose, as a run does. A sine of frequency f reads low by (pi f T)^2 / 6
and (pi f T)^2 / 3: 4e-5 and 8e-5 at 10 Hz; take contents below some 100 Hz.

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

_ALONE = 4.0  #: A difference this many times both neighbours together is a jump.


class Peaks(NamedTuple):
    """Largest magnitudes of a command; degrees of freedom in the order of a pose."""

    displacement: NDArray[np.float64]  #: Of the degrees of freedom [m, rad], (6,).
    velocity: NDArray[np.float64]
    """Of the degrees of freedom [m/s, rad/s], (6,); infinite for a jump of position."""
    acceleration: NDArray[np.float64]
    """Of the degrees of freedom [m/s^2, rad/s^2], (6,); infinite for a jump of velocity."""
    leg_displacement: NDArray[np.float64]  #: Of the legs from neutral [m], (6,).
    leg_velocity: NDArray[np.float64]
    """Of the legs [m/s], (6,); infinite where a degree of freedom's is."""
    leg_acceleration: NDArray[np.float64]
    """Of the legs [m/s^2], (6,); infinite where a degree of freedom's is."""


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
        np.abs(command.pose).max(axis=0),
        velocity,
        acceleration,
        np.abs(legs).max(axis=0),
        leg_velocity,
        leg_acceleration,
    )


def check_limits(command: Command, machine: str | Path | Machine = models.CMF) -> Peaks:
    """Peaks of a command within a machine's limits; call it before the run.

    These are its operational displacements, of the CMF those of Table 2-1, and the working stroke
    of its legs. Velocities and accelerations are free: those of `cmf_mj.machine.limits` bound what
    the control law does, not what may be tried. Raises an `InputError` that lists each quantity
    beyond its limit, with both.
    """
    carrier = load_machine(machine)
    allowed, most = load_motion_limits(None, carrier).operational, carrier.working_stroke
    largest = peaks(command, carrier)
    faults = []
    for i, dof in enumerate(DOFS):
        unit, (low, high) = by_kind(dof, "m", "rad"), allowed[i]
        reached = command.pose[:, i]
        for value in {float(reached.min()), float(reached.max())}:
            if not low <= value <= high:
                faults.append(f"{dof}: {value:.4g} {unit}; allowed: {low:.4g} to {high:.4g} {unit}")
    for leg, value in enumerate(largest.leg_displacement, start=1):
        if value > most:
            faults.append(f"leg {leg} displacement: {value:.4g} m; allowed: at most {most:.4g} m")
    if faults:
        raise InputError("; ".join(faults))
    return largest


def _rates(
    history: NDArray[np.float64], rate: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Peak velocity and acceleration of each column, from rest; infinite for jumps."""
    velocity = np.diff(history, axis=0, prepend=history[:1]) * rate
    acceleration = np.diff(velocity, axis=0, prepend=0.0 * velocity[:1]) * rate
    jumps = _stands_alone(velocity)
    return (
        np.where(jumps, np.inf, np.abs(velocity).max(axis=0)),
        np.where(jumps | _stands_alone(acceleration), np.inf, np.abs(acceleration).max(axis=0)),
    )


def _stands_alone(rate: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each column's largest magnitude is a single sample, (columns,)."""
    size = np.pad(np.abs(rate), ((1, 1), (0, 0)))
    at = size.argmax(axis=0)
    columns = np.arange(size.shape[1])
    around = size[at - 1, columns] + size[at + 1, columns]
    return np.asarray(size[at, columns] > _ALONE * around)
