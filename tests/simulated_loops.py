"""The loop of a linearised plant against the simulation, sine by sine.

Both are at rest in the same configuration; each sine is small, has settled, and is fitted over
whole cycles. What is left over falls with the amplitude: the valves' mean opening damps what the
linearisation, about closed valves, leaves undamped. A loop magnifies an error of the plant by its
resonance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.measurable import dof_history
from cmf_mj.analysis.periodic import sine_response
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import RATE
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.signals.signal import Command

SINES = (0.5, 1.0, 1.7, 2.4, 3.0, 3.7, 4.5, 5.5, 6.5, 8.0)
"""Sines of a comparison with the simulation [Hz]."""

SMALL = (0.004 * units.INCH, 0.0024 * units.DEGREE)
"""Amplitudes at which the machine is as good as linear [m, rad]."""


class Comparison(NamedTuple):
    """A closed loop measured and computed."""

    frequency: NDArray[np.float64]  #: [Hz], (K,).
    measured: NDArray[np.complex128]  #: Position over demand of the simulation, (K,).
    linear: NDArray[np.complex128]  #: The same of the linearised loop, (K,).
    rows: tuple[slice, ...]
    """Of the simulation's record, from the first to after the last of each sine's cycles."""
    record: Record | None = None  #: The simulation, a row a frame; a study does not keep it.

    @property
    def gain_error(self) -> NDArray[np.float64]:
        """Measured over linear [dB], (K,)."""
        return 20.0 * np.log10(np.abs(self.measured / self.linear))

    @property
    def phase_error(self) -> NDArray[np.float64]:
        """Measured less linear [deg], (K,)."""
        return np.degrees(np.angle(self.measured / self.linear))


def compare_with_simulation(
    plant: Plant,
    law: str | Law,
    pose: ArrayLike | None = None,
    signal: str = "heave",
    *,
    frequencies: Sequence[float] = SINES,
    cycles: int = 4,
    transient: float = 2.0,
) -> Comparison:
    """Run single sines through the simulation and the linearised loop.

    The loop must be stable in `pose` (as `plant.place` takes it), and the mechanical step divide
    the control frame. `signal` is a degree of freedom, or a leg, `leg_1` and so on. After 4 s of
    rest each sine runs `transient` s at full amplitude, then `cycles` whole ones are fitted.
    """
    leg = signal.startswith("leg_")
    size = SMALL[0] if leg else by_kind(signal, *SMALL)
    loop = Linear(plant, pose, excitation="sine").loop(law, signal)
    fastest = float(np.abs(loop.poles()).max())
    if fastest > 1.0 + 1e-9:
        raise InputError(f"law: its loop is unstable there, with a pole at {fastest:.6f}")
    command = composite.stepped_sines(
        "heave" if leg else signal,
        frequencies,
        [size],
        cycles=cycles,
        transient=transient,
        fade=0.5,
        settle=0.5,
    )
    rest = round(4.0 * RATE)
    dwells = [d._replace(start=rest + d.start) for d in command.signal.dwells]
    pose_demand = np.pad(command.pose, ((rest, 0), (0, 0)))
    if leg:
        plant.start(pose)
        demand = np.tile(plant.extensions(), (pose_demand.shape[0], 1))
        demand[:, int(signal[4:]) - 1] += pose_demand[:, DOFS.index("heave")]
        record = simulate(plant, law, demand, start=pose, legs=True)
    else:
        centre = np.zeros(6) if pose is None else np.asarray(pose, dtype=float)
        record = simulate(plant, law, Command(pose_demand + centre), start=pose)
    x, y = (dof_history(record, name, signal) for name in ("leg_reference", "leg_position"))
    frequency = np.asarray(frequencies, dtype=float)
    linear = control.frequency_response(loop, 2.0 * np.pi * frequency).frdata[0, 0]
    rows = tuple(slice(d.start, d.start + d.frames + 1) for d in dwells)
    measured = [
        sine_response(x[part], y[part], record.rate, f).response[0]
        for part, f in zip(rows, frequency, strict=True)
    ]
    return Comparison(frequency, np.array(measured), np.asarray(linear), rows, record)
