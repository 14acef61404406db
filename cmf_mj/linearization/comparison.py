"""A linearised plant under a law beside the simulation of the same loop, sine by sine.

The comparison is of closed loops, from leg demand to leg position: open loop the extensions drift.
Both are at rest in the same configuration; each sine is small, has settled, and is fitted over
whole cycles. What is left over falls with the amplitude: the valves' mean opening damps what the
linearisation, which is about closed valves, leaves undamped.
"""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj import excitations, units
from cmf_mj.control.law import Law
from cmf_mj.estimation import sine_response
from cmf_mj.frequency_response import dof_history
from cmf_mj.kinematics import DOFS
from cmf_mj.linear_models import closed_loop
from cmf_mj.linearization.assembly import linearize
from cmf_mj.linearization.reduction import pose_loop
from cmf_mj.plant.plant import Plant
from cmf_mj.signals import RATE, Command, dof_index
from cmf_mj.simulation import simulate

FREQUENCIES = (0.5, 1.0, 1.7, 2.4, 3.0, 3.7, 4.5, 5.5, 6.5, 8.0)
"""Sines of a comparison [Hz]."""

SMALL = {"m": 0.004 * units.INCH, "rad": 0.0024 * units.to_si("deg", 1.0)}
"""Amplitudes at which the machine is as good as linear."""


class Comparison(NamedTuple):
    """A closed loop measured and computed."""

    signal: str
    """Degree of freedom, or `leg_1` and so on."""
    frequency: NDArray[np.float64]
    """[Hz], (K,)."""
    measured: NDArray[np.complex128]
    """Position over demand of the simulation, (K,)."""
    linear: NDArray[np.complex128]
    """The same of the linearised loop, (K,)."""

    @property
    def gain_error(self) -> NDArray[np.float64]:
        """Measured over linear [dB], (K,)."""
        return 20.0 * np.log10(np.abs(self.measured / self.linear))

    @property
    def phase_error(self) -> NDArray[np.float64]:
        """Measured less linear [deg], (K,)."""
        return np.degrees(np.angle(self.measured / self.linear))


def loop_between(
    plant: Plant,
    system: control.StateSpace,
    law: str | Law,
    pose: ArrayLike | None,
    signal: str,
) -> control.StateSpace:
    """The loop of a law around a linearised plant, from a demand to its position.

    Args:
        plant: what `system` is of.
        system: of `linearize`.
        law: name, TOML file or loaded law.
        pose: where `system` is; None for neutral.
        signal: degree of freedom, or a leg, `leg_1` and so on.

    Returns:
        One input, one output, discrete at 2048 Hz; all other demands are zero.

    Raises:
        ValueError: another signal, or a law that is refused.
    """
    loop = closed_loop(law, system)
    legs = [f"leg_{leg + 1}" for leg in range(plant.legs)]
    if not signal.startswith("leg_"):
        index = dof_index(signal)
        loop = pose_loop(loop, plant, pose)
    elif signal in legs:
        index = legs.index(signal)
    else:
        raise ValueError(f"dof: {signal!r} is not one of {', '.join(legs)}")
    return loop[index, index]


def compare_with_simulation(
    plant: Plant,
    law: str | Law,
    pose: ArrayLike | None = None,
    signal: str = "heave",
    *,
    frequencies: Sequence[float] = FREQUENCIES,
    amplitude: float | None = None,
    cycles: int = 4,
    transient: float = 2.0,
    settle: float = 4.0,
) -> Comparison:
    """Run single sines through the simulation and the linearised loop.

    Args:
        plant: with a mechanical step that divides the control frame.
        law: name, TOML file or loaded law; its loop must be stable there.
        pose: configuration as `plant.place` takes it; for a degree of freedom (6,) [m, rad].
            Default neutral.
        signal: degree of freedom, or a leg, `leg_1` and so on.
        frequencies: of the sines [Hz].
        amplitude: of each [m or rad]; default `SMALL`.
        cycles: fitted, whole ones.
        transient: at full amplitude before them [s].
        settle: rest before the first sine [s].

    Raises:
        ValueError: an argument out of range, an unstable loop, or a plant without linearisation.
    """
    leg = signal.startswith("leg_")
    turns = not leg and dof_index(signal) >= 3
    size = amplitude if amplitude is not None else SMALL["rad" if turns else "m"]
    system = linearize(plant, pose, excitation="sine")
    loop = loop_between(plant, system, law, pose, signal)
    fastest = float(np.abs(closed_loop(law, system).poles()).max())
    if fastest > 1.0 + 1e-9:
        raise ValueError(f"law: its loop is unstable there, with a pole at {fastest:.6f}")
    command = excitations.stepped_sines(
        "heave" if leg else signal,
        frequencies,
        [size],
        cycles=cycles,
        transient=transient,
        fade=0.5,
        settle=0.5,
    )
    rest = round(settle * RATE)
    pose_demand = np.pad(command.pose, ((rest, 0), (0, 0)))
    if leg:
        demand = np.tile(_extensions(plant, pose), (pose_demand.shape[0], 1))
        demand[:, int(signal[4:]) - 1] += pose_demand[:, DOFS.index("heave")]
        record = simulate(plant, law, demand, start=pose, legs=True)
    else:
        centre = np.zeros(6) if pose is None else np.asarray(pose, dtype=float)
        record = simulate(plant, law, Command(pose_demand + centre), start=pose)
    x, y = (dof_history(record, name, signal) for name in ("leg_reference", "leg_position"))
    found = []
    for dwell in command.description["dwells"]:  # type: ignore[attr-defined]
        first = rest + dwell["start"]
        part = slice(first, first + dwell["frames"] + 1)
        found.append(sine_response(x[part], y[part], record.rate, dwell["frequency"]).response[0])
    frequency = np.asarray(frequencies, dtype=float)
    linear = control.frequency_response(loop, 2.0 * np.pi * frequency).frdata[0, 0]
    return Comparison(signal, frequency, np.array(found), np.asarray(linear))


def _extensions(plant: Plant, pose: ArrayLike | None) -> NDArray[np.float64]:
    plant.start(pose)
    return plant.extensions()
