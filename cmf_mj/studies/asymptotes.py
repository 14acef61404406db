"""Closed-form limits of a sinusoidal motion in one degree of freedom, about a pose.

V and A are the velocity and acceleration amplitude of the motion, w is its angular frequency. With
J = d(legs)/d(pose), e the unit vector of the degree of freedom, h the working stroke, F the static
leg loads, M_leg the reflected mass and K the oil springs of the legs:

    displacement    V = w min(|low|, high), the operational limits of Table 2-1
    leg stroke      V = w x, x the single-axis excursion at which a leg meets +-h
    valve command   V = |G(jw) H(jw)| min (v / |J e|),  G the lags of drive and spool, v below
    pump flow       V = |H(jw)| pi Q / ((A_cap + A_rod) sum |J e|),  Q the flow of the pump
    acceleration    A = min (stall force - F) / |M_leg J e|

Pump: a leg of speed amplitude u draws up to A_cap u in one half of a cycle and A_rod u in the
other, (A_cap + A_rod) u / pi in the mean. The oil is a spring between what the valves let in and
the payload, so that the platform moves H times as far as the flow alone would take it, 1 at low
frequency:

    H = e' J^-1 (K' - w^2 M_leg)^-1 K' J e,    K' = K jw / (jw + lambda),  lambda the leak rate

Leg speed v with valves fully open, between constant manifolds, out:

    A_cap Ps - A_rod Pt - F
        = (A_cap + A_rod) ((v / k)^2 + s v / k) + (R_in A_cap^2 + R_out A_rod^2) v

and in with A_rod Ps - A_cap Pt + F on the left and the areas exchanged in the last term; Ps and Pt
are the pressures of supply and return, k is the speed gain of both valves, s the laminar root, R
the resistance of the hoses.

H holds where the valves let in what the demand asks for. A law whose motion follows the demand
exactly, with no other axis moving, needs of each leg, at an amplitude a, the flow and the force

    |G^-1 w (1 - w^2 (1 + lambda / jw) K^-1 M_leg) J e| a <= v,      |M_leg J e| w^2 a <= stall

and unit gain ends where the first of them is used up: `saturation`.

Inertia forces, the fall of the manifold, bends of the kinematics and piston leakage (about 1 %) are
left out of v. So a simulated machine sustains up to 15 % less where the valves bind,
in surge and sway up to a third, where harmonics excite their modes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.frequency_response import find_falls
from cmf_mj.core.arrays import shaped
from cmf_mj.machine.geometry import dof_index
from cmf_mj.machine.kinematics import excursion_envelope, pose_jacobian, pose_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hydraulics import Hydraulics
from cmf_mj.plant.oil import density
from cmf_mj.plant.plant import Plant


@dataclass(frozen=True)
class Asymptotes:
    """Limits of one degree of freedom; amplitudes in m or rad and seconds."""

    dof: str  #: Degree of freedom.
    displacement: float  #: Operational limit [m, rad].
    leg_stroke: float  #: Excursion at which the first leg has used up its working stroke [m, rad].
    speed: NDArray[np.float64]  #: v, of legs with valves fully open, the slower way [m/s], (n,).
    pump_flow: float  #: Speed whose mean flow at low frequency is the pump's; infinite if constant.
    acceleration: float  #: Acceleration at which the first leg stalls [m/s^2, rad/s^2].
    corners: tuple[float, float]  #: Corner frequencies of the lags of drive and spool [rad/s].
    column: NDArray[np.float64]  #: J e, leg motion per motion of the degree of freedom, (n,).
    row: NDArray[np.float64]  #: e' J^-1, (n,).
    mass: NDArray[np.float64]  #: Reflected mass M_leg [kg], (n, n).
    stiffness: NDArray[np.float64]  #: K, oil springs of the legs [N/m], (n,).
    leak_rate: NDArray[np.float64]  #: lambda [1/s], (n,).

    def saturation(self, amplitude: float) -> float:
        """Frequency at which unit gain of this amplitude ends, to 100 Hz [Hz]; NaN beyond.

        The first at which following a sine exactly opens a valve fully or stalls a leg.
        """
        frequency = np.geomspace(0.1, 100.0, 1000)
        s = 2j * np.pi * frequency[:, None]
        lags = np.prod([1.0 + s / corner for corner in self.corners], axis=0)
        spring = self.stiffness * s / (s + self.leak_rate)
        flow = np.abs(lags * s * (self.column + s**2 * (self.mass @ self.column) / spring))
        valve_use = (flow / self.speed).max(axis=1)
        force_use = np.abs(s[:, 0]) ** 2 / self.acceleration
        use = np.maximum(valve_use, force_use)
        return float(find_falls(frequency, -amplitude * use, -1.0)[0])

    def transmission(self, frequency: float) -> float:
        """|H|, platform motion over what the oil let in, at a frequency [Hz]."""
        omega = 2.0 * np.pi * frequency
        spring = self.stiffness * 1j * omega / (1j * omega + self.leak_rate)
        leg_motion = np.linalg.solve(np.diag(spring) - omega**2 * self.mass, spring * self.column)
        return float(abs(self.row @ leg_motion))

    def velocities(self, frequency: float) -> dict[str, float]:
        """Velocity amplitude of every limit [m/s, rad/s] at a frequency [Hz], by limit."""
        omega = 2.0 * np.pi * frequency
        lag_gain = np.prod([1.0 / np.hypot(1.0, omega / corner) for corner in self.corners])
        transmission, is_moving = self.transmission(frequency), np.abs(self.column) > 1e-9
        slowest = float((self.speed[is_moving] / np.abs(self.column[is_moving])).min())
        return {
            "displacement": self.displacement * omega,
            "leg_stroke": self.leg_stroke * omega,
            "valve_command": slowest * float(lag_gain) * transmission,
            "pump_flow": self.pump_flow * transmission,
            "stall_force": self.acceleration / omega,
        }

    def velocity(self, frequency: float) -> float:
        """The smallest of the `velocities` [m/s, rad/s]."""
        return min(self.velocities(frequency).values())


def stall_forces(hydraulics: Hydraulics) -> NDArray[np.float64]:
    """Forces at which legs stall with valves fully open [N], (n, 2): pushing, pulling."""
    cylinder, supply = hydraulics.cylinder, hydraulics.supply
    high, low = supply.pressure, supply.return_pressure
    push = cylinder.cap_area * high - cylinder.rod_area * low
    return np.column_stack([push, cylinder.rod_area * high - cylinder.cap_area * low])


def full_speed(
    hydraulics: Hydraulics, load: NDArray[np.float64], high: float, low: float
) -> NDArray[np.float64]:
    """Steady leg speeds with valves fully open [m/s], (n, 2): extending, retracting.

    `load` is the static leg force [N], (n,), positive pressing the leg together; `high` and `low`
    are the manifolds' pressures [Pa]. 0 where the load stalls the leg.
    """
    cylinder = hydraulics.cylinder
    cap, rod = cylinder.cap_area, cylinder.rod_area
    # Valves count content; a leg speed is what it fills at mid pressure.
    middle = 0.5 * (hydraulics.supply.pressure + hydraulics.supply.return_pressure)
    gain = hydraulics.valve.cap_gain.sum(axis=1) / cap / density(hydraulics.oil, middle)[0]
    speeds = []
    for drive, into, out in (
        (cap * high - rod * low - load, cap, rod),
        (rod * high - cap * low + load, rod, cap),
    ):
        square = (cap + rod) / gain**2
        linear = (cap + rod) * hydraulics.laminar / gain
        linear = linear + cylinder.supply_hose * into**2 + cylinder.return_hose * out**2
        root = np.sqrt(linear**2 + 4.0 * square * np.maximum(drive, 0.0))
        speeds.append(2.0 * np.maximum(drive, 0.0) / (linear + root))
    return np.column_stack(speeds)


def asymptotes(plant: Plant, dof: str, pose: ArrayLike | None = None) -> Asymptotes:
    """Closed-form limits of a degree of freedom from the parameters.

    `pose` (6,) [m, rad], z down, is by default neutral, from which excursions count in any pose.
    """
    about = np.zeros(6) if pose is None else shaped("pose", pose, 6)
    index = dof_index(dof)
    hydraulics = plant.hydraulics
    supply, cylinder = hydraulics.supply, hydraulics.cylinder
    jacobian = pose_jacobian(about, plant.machine)
    column = jacobian[:, index]
    plant.start(pose)
    mass, load = plant.reflected_mass(pose), plant.static_load()
    speed = full_speed(hydraulics, load, supply.pressure, supply.return_pressure).min(axis=1)
    areas = cylinder.cap_area + cylinder.rod_area
    mean_flow = float(np.sum(areas * np.abs(column))) / np.pi  # per velocity amplitude
    push, pull = stall_forces(hydraulics).T
    mass_of_dof = np.abs(mass @ column)  # leg force per acceleration
    extension = pose_to_legs(about, plant.machine)
    spring = stiffness(cylinder, hydraulics.oil.bulk_modulus, extension)
    volume = cylinder.half_stroke * areas  # of both chambers at mid stroke
    limits = load_motion_limits(None, plant.machine)
    return Asymptotes(
        dof=dof,
        displacement=float(np.abs(limits.operational[index]).min()),
        leg_stroke=float(np.abs(excursion_envelope(None, plant.machine)[index]).min()),
        speed=speed,
        pump_flow=float("inf") if supply.constant else supply.pump_flow / mean_flow,
        acceleration=float((np.minimum(push - load, load + pull) / mass_of_dof).min()),
        corners=(plant.parameters.drive_lag.si, plant.parameters.valve_lag.si),
        column=column,
        row=np.linalg.inv(jacobian)[index],
        mass=mass,
        stiffness=spring,
        leak_rate=4.0 * hydraulics.oil.bulk_modulus * cylinder.leakage / volume,
    )
