"""Whether a law is stable in the simulation, by how its legs swing after a step.

A law is stable where the swing of its legs after a small step of all six degrees of freedom dies
away: over the last window it is less than over the first, and than the step itself, or nothing is
left of it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import Law
from cmf_mj.core.rates import RATE
from cmf_mj.facility.run import simulate
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command
from cmf_mj.studies.case import REPORT_AMPLITUDES

SMALL = 0.15
"""Step of the simulated verdict over the report's amplitudes, all degrees of freedom at once."""

_BEGIN, _DURATION, _WINDOW = 0.5, 12.0, 2.0
"""Of the simulated verdict [s]: the step, the end, and the windows compared."""
_FIRST = 2.5
"""Begin of the first window after the step [s]."""
_NOTHING, _MOST = 1e-4, 1.0
"""Swing over the largest leg step that counts as none, and what only a limit cycle exceeds."""


def swing_after_step(plant: Hexapod, law: Law) -> dict[str, Any]:
    """Whether a law is stable in the simulation, see `swings`."""
    pose = np.zeros((round(_DURATION * RATE), len(DOFS)))
    pose[round(_BEGIN * RATE) :] = SMALL * REPORT_AMPLITUDES
    try:
        return swings(simulate(plant, law, Command.from_pose(pose), record_every=16))
    except FloatingPointError:  # it left the bounds of the model
        return {"stable": False, "first": float("nan"), "last": float("nan")}


def swings(record: Record) -> dict[str, Any]:
    """Whether a run with a step at 0.5 s is stable, and the swing of its windows.

    `first` and `last` are the largest standard deviations of a leg about a straight line within the
    windows, over the largest leg step.
    """
    legs, reference = record["leg_position"], record["leg_reference"]
    size = float(np.abs(reference[-1] - reference[0]).max())
    count = round(_WINDOW * record.rate)
    begin = round((_BEGIN + _FIRST) * record.rate)
    first, last = (_swing(part) / size for part in (legs[begin : begin + count], legs[-count:]))
    stable = bool(last < _NOTHING or last < min(first, _MOST))
    return {"stable": stable, "first": first, "last": last}


def _swing(legs: NDArray[np.float64]) -> float:
    time = np.linspace(-1.0, 1.0, len(legs))
    about = (
        legs
        - np.polynomial.polynomial.polyval(time, np.polynomial.polynomial.polyfit(time, legs, 1)).T
    )
    return float(about.std(axis=0).max())
