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

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.reduction import pose_loop
from cmf_mj.analysis.measures import Measures, oscillations
from cmf_mj.control.law import Law
from cmf_mj.core.rates import RATE
from cmf_mj.facility.binding import bound
from cmf_mj.facility.run import simulate
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command
from cmf_mj.studies.case import REPORT_AMPLITUDES
from cmf_mj.studies.evaluation import loop_measures

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


class Machine:
    """A plant linearised once, for many laws."""

    def __init__(self, plant: Hexapod) -> None:
        """Linearise a plant about neutral."""
        self.plant = plant
        self.system = linearize(plant)

    def loop(self, law: Law) -> control.StateSpace:
        """From demands to motions of the six degrees of freedom under a law."""
        closed = closed_loop(bound(law, self.plant), self.system)
        return pose_loop(closed, self.plant)

    def damping(self, law: Law) -> dict[str, float]:
        """Damping ratios of the loop under a law, see `loop_damping`."""
        return loop_damping(self.loop(law))

    def measures(self, law: Law) -> tuple[Measures, ...]:
        """Measures of all degrees of freedom."""
        return loop_measures(self.loop(law))[0]


def loop_damping(loop: control.StateSpace) -> dict[str, float]:
    """Least damping ratios of a loop at 2048 Hz from demands to motions of `DOFS`.

    `least` of all poles, of the `pair` with its frequency `pair_hz`, and of each degree of freedom;
    `stable` with all poles within the unit circle, real and slow ones too.
    """
    poles, right = np.linalg.eig(np.asarray(loop.A))
    moved = np.abs(np.asarray(loop.C) @ right)
    driven = np.abs(np.linalg.solve(right, np.asarray(loop.B)))
    upper = poles.imag > 1e-9
    residues = (moved * driven.T)[:, upper]
    pairs = oscillations(poles)
    size = np.abs(pairs) / (2.0 * np.pi)
    ratio = -pairs.real / np.abs(pairs)
    inside = (size > BAND[0]) & (size < BAND[1])
    counts = residues >= SHARE * residues[:, inside].max(axis=1, keepdims=True)
    slow = inside & (size < PAIR_HZ)
    return {
        "stable": bool(np.abs(poles).max() < 1.0),
        "least": _least(ratio, inside),
        "pair": _least(ratio, slow),
        "pair_hz": float(size[slow][np.argmin(ratio[slow])]) if slow.any() else float("nan"),
        **{dof: _least(ratio, inside & counts[i]) for i, dof in enumerate(DOFS)},
    }


def _least(ratio: NDArray[np.float64], where: NDArray[np.bool_]) -> float:
    return float(ratio[where].min()) if where.any() else float("nan")


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
