"""A linearised plant under a law compared with the simulation of the same loop, sine by sine.

Both are at rest in the same configuration; each sine is small, has settled, and is fitted over
whole cycles. Two things are compared. The plant: what the valve commands of the run, as they were,
make of the linearised plant, next to the legs' motion. The closed loop, from leg demand to leg
position: it magnifies an error of the plant by its resonance. What is left over falls with the
amplitude: the valves' mean opening damps what the linearisation, about closed valves, leaves
undamped.
"""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.frequency_response import dof_history
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.reduction import pose_loop, reduced
from cmf_mj.analysis.response.periodic import sine_response
from cmf_mj.analysis.sine import fit_sines
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.rates import RATE
from cmf_mj.facility.simulation import simulate
from cmf_mj.machine.dof import dof_index
from cmf_mj.machine.kinematics import DOFS, pose_jacobian
from cmf_mj.plant.plant import Plant
from cmf_mj.signals import composite
from cmf_mj.signals.signal import Command

FREQUENCIES = (0.5, 1.0, 1.7, 2.4, 3.0, 3.7, 4.5, 5.5, 6.5, 8.0)
"""Sines of a comparison [Hz]."""

SMALL = {"m": 0.004 * units.INCH, "rad": 0.0024 * units.to_si("deg", 1.0)}
"""Amplitudes at which the machine is as good as linear."""


class Comparison(NamedTuple):
    """A closed loop measured and computed."""

    signal: str  #: Degree of freedom, or `leg_1` and so on.
    frequency: NDArray[np.float64]  #: [Hz], (K,).
    measured: NDArray[np.complex128]  #: Position over demand of the simulation, (K,).
    linear: NDArray[np.complex128]  #: The same of the linearised loop, (K,).
    plant: NDArray[np.complex128]
    """Position of the simulation over that of the linearised plant under the same valve commands,
    (K,); 1 where they agree."""

    @property
    def plant_gain_error(self) -> NDArray[np.float64]:
        """The plant, measured over linear [dB], (K,)."""
        return 20.0 * np.log10(np.abs(self.plant))

    @property
    def plant_phase_error(self) -> NDArray[np.float64]:
        """The plant, measured less linear [deg], (K,)."""
        return np.degrees(np.angle(self.plant))

    @property
    def gain_error(self) -> NDArray[np.float64]:
        """Measured over linear [dB], (K,)."""
        return 20.0 * np.log10(np.abs(self.measured / self.linear))

    @property
    def phase_error(self) -> NDArray[np.float64]:
        """Measured less linear [deg], (K,)."""
        return np.degrees(np.angle(self.measured / self.linear))


def loop_between(
    plant: Plant, system: control.StateSpace, law: str | Law, pose: ArrayLike | None, signal: str
) -> control.StateSpace:
    """The loop of a law around a linearised plant, from a demand to its position.

    `system` is the plant linearised in `pose`; `signal` is a degree of freedom, or a leg, `leg_1`
    and so on. The loop has one input and one output, at 2048 Hz; all other demands are zero.
    """
    loop = closed_loop(load_law(law).bound_to(plant.law_key), system)
    legs = [f"leg_{leg + 1}" for leg in range(plant.legs)]
    if not signal.startswith("leg_"):
        index = dof_index(signal)
        loop = pose_loop(loop, plant, pose)
    else:
        index = legs.index(check_name("dof", signal, legs))
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

    The loop must be stable in `pose` (as `plant.place` takes it), and the mechanical step divide
    the control frame. `signal` is a degree of freedom, or a leg, `leg_1` and so on; `amplitude` [m
    or rad] defaults to `SMALL`. After `settle` s of rest each sine runs `transient` s at full
    amplitude, then `cycles` whole ones are fitted.
    """
    leg = signal.startswith("leg_")
    turns = not leg and dof_index(signal) >= 3
    size = amplitude if amplitude is not None else SMALL["rad" if turns else "m"]
    system = linearize(plant, pose, excitation="sine")
    loop = loop_between(plant, system, law, pose, signal)
    bound = load_law(law).bound_to(plant.law_key)
    fastest = float(np.abs(closed_loop(bound, system).poles()).max())
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
    rest = round(settle * RATE)
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
    positions = reduced(system, outputs=[f"leg_position_{i + 1}" for i in range(plant.legs)])
    along = _along(plant, pose, signal)
    # The command of a row reaches the valves one frame later and is held over that frame.
    at_valves = np.roll(record["valve_command"], record.metadata["command_delay"], axis=0)
    measured, plants = [], []
    for dwell in command.signal.dwells:
        first = rest + dwell.start
        part = slice(first, first + dwell.frames + 1)
        measured.append(sine_response(x[part], y[part], record.rate, dwell.frequency).response[0])
        whole = slice(first, first + dwell.frames)
        omega = 2.0 * np.pi * dwell.frequency
        angle = omega * np.arange(dwell.frames) / record.rate
        moved, valves = (
            fit_sines(values[whole], angle, drift=True).amplitude[0]
            for values in (record["leg_extension"], at_valves)
        )
        valves = valves * np.exp(-0.5j * omega / record.rate)
        plants.append((along @ moved) / (along @ (positions(1j * omega) @ valves)))
    frequency = np.asarray(frequencies, dtype=float)
    linear = control.frequency_response(loop, 2.0 * np.pi * frequency).frdata[0, 0]
    return Comparison(signal, frequency, np.array(measured), np.asarray(linear), np.array(plants))


def _along(plant: Plant, pose: ArrayLike | None, signal: str) -> NDArray[np.float64]:
    """Row (n,) that reads a degree of freedom, or a leg, off the leg positions."""
    if signal.startswith("leg_"):
        return np.eye(plant.legs)[int(signal[4:]) - 1]
    at = np.zeros(6) if pose is None else np.asarray(pose, dtype=float)
    return np.linalg.inv(pose_jacobian(at))[dof_index(signal)]
