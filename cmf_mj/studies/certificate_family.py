"""All machines of a box in one pose under a law, as one loop with parameters.

The machine at rest in the pose, linearised as `linear.assembly` does, changes by factors:

    drives, spools    their rows                   oil      rows of both chambers
    leakage           flow from cap to rod         valves   slopes of cap and rod port, rho
    cab               M_leg = M_rest + H' B' diag(m, m, m, I) B H

with H the motion of the platform per leg, B that of the cab's centre of mass per platform, I about
it. A port's slope goes with the valve's gain and by the load of its leg, p (A_cap - A_rod), or p A
where both areas are equal,

    rho = gain sqrt(Ps) kappa(p / Ps)        over that of the nominal machine,

kappa the describing function of the valve at rest, see `linear.ports`. Where the load leaves
it open, against the leak, its slope with pressure is that of the nominal machine. The law and a
frame of delay are exact in z = (1 + w T/2) / (1 - w T/2), which takes the plant at w for
s = (2 / T) atanh(w T/2) and the hold for the mean of two frames: right up to (w T)^2 / 12, 2e-4 at
15 Hz. Left out is what gravity's stiffness and the content of the oil change with the cab.

Poles slower than `SLOW_POLE` do not count. They are the mean pressures of chambers, which creep as
fast as pistons leak; a leg whose valve begins to open under its load has one at 0, where what is
left out decides its sign. `operating_point` takes rests alone that keep themselves. They count in
the nominal machine, so that a law that lets the platform creep away is not certified.
"""

from collections.abc import Mapping
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import dcl_state_space, labels
from cmf_mj.analysis.linear.operating_point import find_rest
from cmf_mj.analysis.linear.plants import FEEDBACK, reduced
from cmf_mj.analysis.linear.ports import CAP, ROD, outward_share, port_slopes
from cmf_mj.analysis.linear.structured import Uncertain
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import NotLinearError
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.kinematics import leg_jacobian, rotation
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.certificate_box import Box

Array = NDArray[np.float64]

SLOW_POLE = 0.3  #: Re + |Im| of a pole [rad/s] that does not count; leaks take 0.4 and more.
_ROUNDING = 1e-7  #: Re of a pole [rad/s] that is at 0 but for rounding.
_SLOPE_MARGIN = 1.01  #: Range of the slopes taken over the one found.

_FINE_STEP, _COARSE_STEP = 0.005, 0.05
"""Steps of the loads at which kappa is tabulated, fine where closed valves may hold them."""
_LARGEST_LOAD = 0.96  #: Largest of them over the stall force.

_ACCELERATIONS = slice(12, 18)  #: Rows of the legs' accelerations in the feedback.
_LEG_PARAMETERS = ("drive", "spool", "cap_port", "rod_port", "leak", "cap_oil", "rod_oil")
"""Parameters that each leg has one of."""
_ROWS_OF_LEGS = {name: slice(6 * i, 6 * i + 6) for i, name in enumerate(_LEG_PARAMETERS)}
_ROWS_OF_CAB = slice(6 * len(_LEG_PARAMETERS), None)
"""Where parameters stand among the inputs w and outputs z of the loop."""
_CAB_REPETITIONS = (3, 4, 4, 4, 3)
"""How often the cab's mass, the three shifts of its centre of mass, and its inertia enter."""
REPETITIONS = (1,) * 6 * len(_LEG_PARAMETERS) + _CAB_REPETITIONS  #: How often parameters enter.


class Family:
    """Machines that differ from a nominal one in a pose, under a law."""

    def __init__(
        self, plant: Hexapod, law: Law, pose: Array, friction: Contact | None = None
    ) -> None:
        """Linearise machine and law, and free their parameters.

        `friction` is as `Linear` takes it. Raises `InputError` as `Linear` and `bound` do.
        """
        linear = Linear(plant, pose, friction=friction)
        self.pose, self._mechanics = pose, linear.point.mechanics
        cab = plant.cab_parameters
        assert cab is not None
        to_world = rotation(*pose[3:])
        motion = np.linalg.inv(leg_jacobian(pose, plant.machine))
        self._motion = linalg.block_diag(to_world.T, to_world.T) @ motion  # in axes of the platform
        self._gravity = to_world.T @ np.array([0.0, 0.0, units.STANDARD_GRAVITY])
        self._mass, self._place = cab.mass.si, FLIP * cab.centre_of_mass.si
        self._inertia = FLIP[:, None] * cab.tensor * FLIP
        self._ports = _slopes_of_legs(plant)
        self._unit_load = _load_areas(plant) * plant.parameters.supply_pressure.si
        self._plant = reduced(linear.system, outputs=labels(FEEDBACK, 6))
        self.loop = self._loop(bound(law, plant))
        """The nominal loop; delta of 1 is a change by 100 %, of the cab's place by 1 m."""

    def _loop(self, law: Law) -> Uncertain:
        """The loop with those states of a bound law that feedback reaches.

        Rows of plant and parameters are linear forms of plant states, commands and w.
        """
        dcl = reduced(dcl_state_space(law, 6), labels(FEEDBACK, 6))
        law_a, law_b, law_c = _in_frames(dcl, law.frame)
        a, b, c = (np.asarray(m) for m in (self._plant.A, self._plant.B, self._plant.C))
        ends = [len(a), len(a) + 6]
        state, command, w = np.split(np.eye(ends[-1] + sum(REPETITIONS)), ends)
        rate, z_legs = self._free_legs(a @ state + b @ command, state, w)
        speed = self._rows("leg_velocity")
        rate[speed], z_cab = self._free_cab(rate[speed], w[_ROWS_OF_CAB])
        feedback = c @ state
        feedback[_ACCELERATIONS] = rate[speed]
        rates = np.vstack([rate, law_b @ feedback])
        by_state, by_command, by_w = np.split(rates, ends, axis=1)
        z_state, z_command, z_w = np.split(np.vstack([z_legs, z_cab]), ends, axis=1)
        loop_a = np.hstack([by_state, by_command @ law_c])
        loop_a[len(a) :, len(a) :] += law_a
        loop_c = np.hstack([z_state, z_command @ law_c])
        return Uncertain(loop_a, by_w, loop_c, z_w, REPETITIONS)

    def _rows(self, name: str) -> list[int]:
        """Rows of the six states of a name in the plant."""
        states = list(self._plant.state_labels)
        return [states.index(label) for label in labels((name,), 6)]

    def _free_legs(self, rate: Array, state: Array, w: Array) -> tuple[Array, Array]:
        """Rates of the states with the parameters of the legs, and what these multiply."""
        drive, spool = self._rows("drive"), self._rows("spool")
        cap, rod = self._rows("cap_pressure"), self._rows("rod_pressure")
        a, w_of = np.asarray(self._plant.A), {name: w[rows] for name, rows in _ROWS_OF_LEGS.items()}
        z_of = {
            "drive": rate[drive],
            "spool": rate[spool],
            "cap_port": a[cap, spool][:, None] * state[spool],
            "rod_port": a[rod, spool][:, None] * state[spool],
            "leak": state[rod] - state[cap],
        }
        rate = rate.copy()
        rate[drive] += w_of["drive"]
        rate[spool] += w_of["spool"]
        rate[cap] += w_of["cap_port"] + a[cap, rod][:, None] * w_of["leak"]
        rate[rod] += w_of["rod_port"] - a[rod, cap][:, None] * w_of["leak"]
        z_of |= {"cap_oil": rate[cap], "rod_oil": rate[rod]}
        rate[cap] += w_of["cap_oil"]
        rate[rod] += w_of["rod_oil"]
        return rate, np.vstack([z_of[name] for name in _LEG_PARAMETERS])

    def _free_cab(self, acceleration: Array, w: Array) -> tuple[Array, Array]:
        """Accelerations of the legs with the parameters of the cab, and what these multiply.

        With q = H v', and B + sum of delta_j dB_j for B, dB_j = U_j V_j, the cab moves by
        y = B q + U w1, its pull is h = diag(m, m, m, I) y + w2, the platform's load B' h + V' w3.
        """
        lever = _lever(self._place)
        body = linalg.block_diag(self._mass * np.eye(3), self._inertia)
        lever_changes = [_lever(self._place + axis) - lever for axis in np.eye(3)]
        w_mass, *w_places, w_inertia = np.split(w, np.cumsum(_CAB_REPETITIONS)[:-1])
        motion_change, load_change = np.zeros((6, w.shape[1])), np.zeros((6, w.shape[1]))
        pull_change = np.vstack([w_mass, w_inertia])
        for change, w_place in zip(lever_changes, w_places, strict=True):
            rows, (w_motion, w_load) = change.any(axis=1), np.split(w_place, 2)
            motion_change[rows] += w_motion
            load_change += change[rows].T @ w_load
        platform_load = lever.T @ (body @ motion_change + pull_change) + load_change
        leg_load = self._motion.T @ platform_load
        acceleration = acceleration - np.linalg.solve(self._mechanics.mass, leg_load)
        platform = self._motion @ acceleration
        cab = lever @ platform + motion_change
        pull = body @ cab + pull_change
        z_places = []
        for change in lever_changes:
            rows = change.any(axis=1)
            z_places += [change[rows] @ platform, pull[rows]]
        return acceleration, np.vstack([self._mass * cab[:3], *z_places, self._inertia @ cab[3:]])

    def _load_shares(self, changes: Mapping[str, Array]) -> Array:
        """Static loads of the legs over area and supply pressure, (N, 6)."""
        mass = self._mass * (1.0 + changes["cab_mass"])
        weight = mass * self._gravity - self._mass * self._gravity
        moment = np.cross(self._place + changes["cab_place"], mass * self._gravity)
        moment -= np.cross(self._place, self._mass * self._gravity)
        loads = self._mechanics.load - np.hstack([weight, moment]) @ self._motion
        return np.asarray(loads / (self._unit_load * (1.0 + changes["supply_pressure"])))

    def _port_changes(self, changes: Mapping[str, Array]) -> Array:
        """Rho - 1 of machines' cap and rod ports, (2, N, 6)."""
        supply, gain = 1.0 + changes["supply_pressure"], 1.0 + changes["valve_gain"]
        shares, nominal = self._load_shares(changes), self._mechanics.load / self._unit_load
        ratios = np.empty((2, *shares.shape))
        for leg, ports in enumerate(self._ports):
            ratios[:, :, leg] = ports.at(shares[:, leg]) / ports.at(nominal[[leg]])
        return np.asarray(gain * np.sqrt(supply) * ratios - 1.0)

    def deltas(self, changes: Mapping[str, Array]) -> Array:
        """Delta of machines by what is off, see `Box.changes`, (N, 60)."""
        cap_port, rod_port = self._port_changes(changes)
        oil = np.repeat(changes["bulk_modulus"], 6, axis=1)
        leg_deltas = {"drive": changes["drive_lag"], "spool": changes["valve_lag"]}
        leg_deltas |= {"leak": changes["leak_rate"], "cap_port": cap_port, "rod_port": rod_port}
        leg_deltas |= {"cap_oil": oil, "rod_oil": oil}
        mass = np.repeat(changes["cab_mass"], 3, axis=1)
        place = np.repeat(changes["cab_place"], 4, axis=1)
        inertia = np.repeat(changes["cab_inertia"], 3, axis=1)
        return np.hstack([*(leg_deltas[name] for name in _LEG_PARAMETERS), mass, place, inertia])

    def widths(self, box: Box, scale: float) -> Array:
        """Largest |delta| of the box of a scale, over the scale, (60,)."""
        widths = np.abs(self.deltas(box.corner_changes(scale))).max(axis=0)
        for port in ("cap_port", "rod_port"):
            widths[_ROWS_OF_LEGS[port]] *= _SLOPE_MARGIN
        return np.asarray(widths / scale)

    def holds(self, box: Box, scale: float, *, closed: bool) -> bool:
        """Whether valves at rest, all of them `closed`, hold the legs of every machine in a box."""
        shares = self._load_shares(box.corner_changes(scale))
        low, high = np.transpose([ports.held_range(closed=closed) for ports in self._ports])
        return bool((low < shares).all() and (shares < high).all())

    def damping(self, deltas: Array) -> Array:
        """Least damping ratio of poles, (N,): -1 to 1, of a real one either; slow ones have 1."""
        poles = np.linalg.eigvals(_changed_a(self.loop, deltas))
        slow = poles.real + np.abs(poles.imag) < SLOW_POLE
        return np.asarray(np.where(slow, 1.0, -poles.real / np.abs(poles)).min(axis=1))

    def nominal_damping(self) -> float:
        """Least damping ratio of the nominal machine; -1 where a slow pole of it does not decay."""
        poles = np.linalg.eigvals(self.loop.a)
        slow = poles[poles.real + np.abs(poles.imag) < SLOW_POLE]
        if (slow.real >= -_ROUNDING).any():
            return -1.0
        return float(self.damping(np.zeros((1, sum(REPETITIONS))))[0])

    def damping_in(self, box: Box, points: Array) -> Array:
        """Least damping ratios at points of the unit box, (N,)."""
        return self.damping(self.deltas(box.changes(points)))

    def widen(self, widths: Array) -> Uncertain:
        """The loop with parameters that are off by these widths for a delta of 1."""
        column = widths[:, None]
        return self.loop._replace(c=column * self.loop.c, d=column * self.loop.d)


def _lever(place: Array) -> Array:
    """B, (6, 6): motion and rotation of a point per motion and rotation of the platform."""
    x, y, z = place
    lever = np.eye(6)
    lever[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return lever


def _changed_a(loop: Uncertain, deltas: Array) -> Array:
    """A of machines that are off, (N, n, n)."""
    column = deltas[:, :, None]
    feedback = np.linalg.solve(np.eye(len(loop.d)) - column * loop.d, column * loop.c)
    return np.asarray(loop.a + loop.b @ feedback)


def _in_frames(law: control.StateSpace, frame: float) -> tuple[Array, Array, Array]:
    """A, B, C in w of the law with a frame of delay and, for the hold, the mean of two frames."""
    a, b, c, d = (np.asarray(m) for m in (law.A, law.B, law.C, law.D))
    n, identity = len(a), np.eye(6)
    # States of the law, commands of the last frame, and those of the frame before.
    delayed = np.zeros((n + 12, n + 12))
    delayed[:n, :n], delayed[n : n + 6, :n], delayed[n + 6 :, n : n + 6] = a, c, identity
    mean = 0.5 * np.hstack([np.zeros((6, n)), identity, identity])
    inverse, scale = np.linalg.inv(delayed + np.eye(n + 12)), 2.0 / np.sqrt(frame)
    a_w = 2.0 / frame * inverse @ (delayed - np.eye(n + 12))
    return a_w, scale * inverse @ np.vstack([b, d, 0.0 * d]), scale * mean @ inverse


class _PortSlopes(NamedTuple):
    """Kappa of a leg: slopes of its ports at the loads, over area and supply, that valves hold."""

    shares: Array  #: The loads, ascending, (n,).
    slopes: Array  #: Of cap and rod port, (2, n).
    closed_shares: Array  #: Loads that closed valves hold, (m,).

    def at(self, shares: Array) -> Array:
        """Slopes of cap and rod port at loads (k,), (2, k)."""
        return np.array([np.interp(shares, self.shares, slopes) for slopes in self.slopes])

    def held_range(self, *, closed: bool) -> Array:
        """The ends of the loads that valves hold, or `closed` ones alone, (2,); NaN for none."""
        shares = self.closed_shares if closed else self.shares
        return shares[[0, -1]] if len(shares) else np.full(2, np.nan)


def _load_areas(plant: Hexapod) -> Array:
    """Area of each leg that the pressure at rest acts on [m^2], (6,)."""
    cap, rod = plant.hydraulics.cylinder.cap_area, plant.hydraulics.cylinder.rod_area
    return np.where(cap == rod, cap, cap - rod)


def _slopes_of_legs(plant: Hexapod) -> list[_PortSlopes]:
    """The slopes of each leg; legs of one cylinder, whose valves have other gains, share them."""
    by_cylinder: dict[bytes, _PortSlopes] = {}
    for leg, cylinder in enumerate(plant.hydraulics.cylinder):
        if cylinder.tobytes() not in by_cylinder:
            by_cylinder[cylinder.tobytes()] = _slopes_of_leg(plant, leg)
    return [by_cylinder[cylinder.tobytes()] for cylinder in plant.hydraulics.cylinder]


def _slopes_of_leg(plant: Hexapod, leg: int) -> _PortSlopes:
    """The slopes of a leg at the loads, of a grid, that its valve can hold at rest."""
    hydraulics, supply = plant.hydraulics, plant.parameters.supply_pressure.si
    cylinder = hydraulics.cylinder[leg]
    area, bias = float(_load_areas(plant)[leg]), hydraulics.valve[leg].null_bias
    held_shares, slopes, closed_shares = [], [], []
    low, high = -_LARGEST_LOAD * cylinder.rod_area / area, _LARGEST_LOAD * cylinder.cap_area / area
    shares = _COARSE_STEP * np.arange(np.ceil(low / _COARSE_STEP), high / _COARSE_STEP)
    if cylinder.cap_area != cylinder.rod_area:
        outside = shares[(shares < 0.0) | (shares > 1.0)]
        shares = np.union1d(outside, np.arange(0.0, 1.0, _FINE_STEP))
    for share in shares:
        try:
            rest = find_rest(plant, leg, float(share) * area * supply, supply, 0.0)
        except NotLinearError:
            continue
        pressures = np.append(rest.pressure, [supply, 0.0])
        openings, outward = rest.command + bias, outward_share(rest.ratio)
        by_opening = port_slopes(hydraulics, leg, openings, pressures, outward).opening
        held_shares.append(share)
        slopes.append(by_opening[[CAP, ROD]].sum(axis=1))
        if not openings.any():
            closed_shares.append(share)
    return _PortSlopes(np.array(held_shares), np.array(slopes).T, np.array(closed_shares))
