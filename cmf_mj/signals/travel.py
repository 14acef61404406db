"""Whether a command stays within the travel of a machine, known before the run."""

from pathlib import Path

import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.signals.signal import Command


def check_travel(command: Command, machine: str | Path | Machine = models.CMF) -> None:
    """Refuse a command beyond a machine's travel; call it before the run.

    That is its operational displacements, of the CMF those of Table 2-1, and the working stroke of
    its legs; velocities and accelerations are free. Raises an `InputError` that lists each quantity
    beyond its limit.

    >>> from cmf_mj import signals
    >>> from cmf_mj.signals.travel import check_travel
    >>> check_travel(signals.step("heave", 1.0))
    >>> check_travel(signals.step("heave", 1.1))
    Traceback (most recent call last):
    cmf_mj.InputError: heave: 1.1 m; allowed: -1.041 to 1.041 m
    """
    loaded = load_machine(machine)
    limits, stroke = load_motion_limits(None, loaded).operational, loaded.working_stroke
    faults = []
    for i, dof in enumerate(DOFS):
        unit, (low, high) = by_kind(dof, "m", "rad"), limits[i]
        history = command.pose[:, i]
        for value in {float(history.min()), float(history.max())}:
            if not low <= value <= high:
                faults.append(f"{dof}: {value:.4g} {unit}; allowed: {low:.4g} to {high:.4g} {unit}")
    leg_travel = np.abs(pose_to_legs(command.pose, loaded)).max(axis=0)
    for leg, value in enumerate(leg_travel, start=1):
        if value > stroke:
            faults.append(f"leg {leg} displacement: {value:.4g} m; allowed: at most {stroke:.4g} m")
    if faults:
        raise InputError("; ".join(faults))
