"""What laws do on one machine: linear, in every degree of freedom, and simulated.

A pole of the loop counts in a degree of freedom where its residue |c_i v| |w b_i| in the response
from that demand to that motion is at least `SHARE` of the largest. The damping ratio of a degree of
freedom is the least of the poles that count in it, between `BAND`. The *pair* are the least damped
poles in which the heavy modes of sway with roll and of surge with pitch lie, below `PAIR_HZ`.

Simulated, a law is stable where the swing of its legs after a small step of all six degrees of
freedom dies away: over the last window it is less than over the first, and than the step itself,
or nothing is left of it.
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

SHARE = 0.003
"""Residue over the largest from which on a pole counts in a degree of freedom."""

BAND = (0.5, 50.0)
"""Poles that are looked at [Hz]."""

PAIR_HZ = 8.0
"""Below this, the least damped poles are the pair [Hz]."""

SMALL = 0.15
"""Step of the simulated verdict over the report's amplitudes, all degrees of freedom at once."""

_BEGIN, _DURATION, _WINDOW = 0.5, 12.0, 2.0
"""Of the simulated verdict [s]: the step, the end, and the windows compared."""
_FIRST = 2.5
"""Begin of the first window after the step [s]."""
_NOTHING, _MOST = 1e-4, 1.0
"""Swing over the largest leg step that counts as none, and what only a limit cycle exceeds."""


def simulated_stability(plant: Hexapod, law: Law) -> dict[str, Any]:
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
