"""Host frames that look as if they were in other units: nothing is refused, but it is said."""

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import load_motion_limits

SLOWEST = 0.25
"""Longest time between frames that a host can drive the DCU with [s]."""

_FASTEST = 1e-3
"""Shortest time that a host is likely to have between frames [s]."""

_TIMES = {"ms": 1e-3, "us": 1e-6}
"""Other units of time that hosts count in [s]."""


def unit_doubts(
    time: NDArray[np.float64], pose: NDArray[np.float64], machine: str | Machine = CMF
) -> list[str]:
    """One line for each quantity that would fit in another unit and does not in its own.

    Frames have times (N,) [s] and poses (N, 6) [m, rad]. A median interval beyond `SLOWEST` is
    doubted if it fits in ms or us; a pose beyond the machine's operational limit if it would be
    within that in inches or degrees.
    """
    doubts = []
    stamps = time[np.isfinite(time)]
    interval = float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0
    for unit, size in _TIMES.items():
        if interval > SLOWEST and _FASTEST <= interval * size <= SLOWEST:
            doubts.append(
                f"time: {interval:g} s from frame to frame; host times are in s: is this {unit}?"
            )
    limits = np.abs(load_motion_limits(None, machine).operational).max(axis=1)
    for dof, values, limit in zip(DOFS, pose.T, limits, strict=True):
        largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
        unit = dof_unit(dof)
        if limit < largest and units.to_si(unit, largest) <= limit:
            own = "m" if unit == "in" else "rad"
            doubts.append(
                f"{dof}: up to {largest:g} {own}, beyond {limit:.3g} {own}; "
                f"poses are in m and rad: is this {unit}?"
            )
    return doubts
