"""All machines of a box in one pose under a law, as one loop with parameters.

The box of a scale s holds the machines whose numbers are off by at most s times its values, each on
its own. A corner of it is a point of +-1.

The machine at rest in the pose, linearised as `linear.assembly` does, changes by factors:

    drives, spools    their rows                   oil      rows of both chambers
    leakage           flow from cap to rod         valves   slopes of cap and rod port, rho
    cab               M_leg = M_rest + H' B' diag(m, m, m, I) B H

with H the motion of the platform per leg, B that of the cab's centre of mass per platform, I about
it. A port's slope goes with the valve's gain and by the load of its leg, p (A_cap - A_rod), or p A
where both areas are equal,

    rho = gain sqrt(Ps) kappa(p / Ps)        over that of the nominal machine,

kappa the describing function of the valve at rest, see `linear.ports`. Where the load leaves it
open, against the leak, its slope with pressure is that of the nominal machine. The law and a frame
of delay are exact in z = (1 + w T/2) / (1 - w T/2), which takes the plant at w for
s = (2 / T) atanh(w T/2) and the hold for the mean of two frames: right up to (w T)^2 / 12, 2e-4 at
15 Hz. Left out is what gravity's stiffness and the content of the oil change with the cab.

Poles slower than `SLOW` do not count. They are the mean pressures of chambers, which creep as fast
as pistons leak; a leg whose valve begins to open under its load has one at 0, where what is left
out decides its sign. `operating_point` takes rests alone that keep themselves. They count in the
nominal machine, so that a law that lets the platform creep away is not certified.
"""

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy import linalg

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import dcl_state_space, labels
from cmf_mj.analysis.linear.operating_point import hold
from cmf_mj.analysis.linear.plants import FEEDBACK, reduced
from cmf_mj.analysis.linear.ports import CAP, ROD, outward_share, port_slopes
from cmf_mj.analysis.linear.structured import Uncertain
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, NotLinearError
from cmf_mj.core.settings import Settings, read_toml, validated
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.kinematics import leg_jacobian, rotation
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.hexapod import Hexapod

Array = NDArray[np.float64]
Share = Annotated[float, Field(ge=0.0, le=1.0)]

KINDS = {
    "drive_lag": ("hydraulics.actuators.*.drive_lag", 6),
    "valve_lag": ("hydraulics.actuators.*.valve_lag", 6),
    "valve_gain": ("hydraulics.actuators.*.valve_gain", 6),
    "leak_rate": ("hydraulics.actuators.*.leakage", 6),
    "bulk_modulus": ("hydraulics.bulk_modulus", 1),
    "supply_pressure": ("hydraulics.supply", 1),
    "cab_mass": ("cab.mass", 1),
    "cab_place": ("cab.centre_of_mass", 3),
    "cab_inertia": ("cab.inertia", 1),
}
"""Paths of the unknowns and how many numbers each has, in the order of a point of the box."""

SIZE = sum(count for _, count in KINDS.values())
WIDEST = 0.6  #: Largest deviation of a factor: at `LARGEST`, numbers stay positive.
LARGEST = 1.3  #: Largest scale: numbers stay positive, and closed valves hold every leg.
SLOW = 0.3  #: Re + |Im| of a pole [rad/s] below which it does not count; leaks take 0.4 and more.
_STILL = 1e-7  #: Rate [rad/s] of a pole that is at 0 but for rounding.
LEAST = 0.05  #: Share of a number that is left of it at least.


class Box(Settings):
    """The unit box: how far a number may be off either way."""

    title: str
    pose_share: Share  #: Of an axis alone over its operational limit.
    corner_share: Share  #: Of all axes at once.
    unknowns: dict[str, Unknown]  #: Those of `KINDS`, each with a deviation.

    @model_validator(mode="after")
    def _whole(self) -> "Box":
        paths = [(name, one.path) for name, one in self.unknowns.items()]
        if paths != [(name, path) for name, (path, _) in KINDS.items()]:
            allowed = f"allowed: {', '.join(KINDS)}, in this order, with their paths"
            raise InputError(f"unknowns: {', '.join(self.unknowns)} are refused; {allowed}")
        for name, one in self.unknowns.items():
            most = WIDEST if one.effect == "factor" else np.inf
            if one.distribution != "uniform" or not 0.0 < one.half <= most:
                allowed = f"a uniform deviation of at most {100.0 * WIDEST:g} %"
                raise InputError(f"unknowns.{name}: is refused; allowed: {allowed}")
        return self

    def changes(self, points: Array) -> dict[str, Array]:
        """Relative changes (of the place: metres) of points (N, 31) by kind, (N, count).

        Beyond a wide unit box a factor keeps `LEAST` of its number.
        """
        parts = Unknowns(self.unknowns).split(points)
        sizes = {name: self.unknowns[name].half * part for name, part in parts.items()}
        place = {"cab_place": sizes["cab_place"]}
        return {name: np.maximum(size, LEAST - 1.0) for name, size in sizes.items()} | place

    def values(self, changes: Mapping[str, Array]) -> dict[str, Any]:
        """Values of the unknowns in a machine with changes (1, count), in axes of the cab."""
        found = {name: change + 1.0 for name, change in changes.items()}
        return Unknowns(self.unknowns).shaped(found | {"cab_place": FLIP * changes["cab_place"]})

    def poses(self, plant: Hexapod) -> Array:
        """Neutral, the ends of each axis, and corners of all, (n, 6) [m, rad]."""
        low, high = load_motion_limits(machine=plant.machine).operational.T
        ends = np.vstack([np.diag(high), np.diag(low)]) * self.pose_share
        signs = np.array([(*s, s[1], s[0], s[2]) for s in product((-1.0, 1.0), repeat=3)])
        corners = self.corner_share * np.where(signs > 0.0, high, low)
        return np.vstack([np.zeros(6), ends, corners])


def load_box(source: str | Path | None = None) -> Box:
    """The shipped unit box, or one from a TOML file."""
    path = Path(__file__).with_name("certificate.toml") if source is None else Path(source)
    return validated(Box, read_toml(path), path.name)


_FINE, _COARSE, _MOST = 0.005, 0.05, 0.96
"""Steps of the loads at which kappa is tabulated, fine where closed valves may hold them, and the
largest of them over the stall force."""
_STEPS = 17
"""Cabs between two opposite corners of the box whose slopes are looked at for their range."""
_MARGIN = 1.01  #: Range of the slopes taken over the one found.
_NAMES = "drive spool cap_port rod_port leak cap_oil rod_oil".split()
_OF_LEGS = {name: slice(6 * i, 6 * i + 6) for i, name in enumerate(_NAMES)}
"""Parameters of legs, each of which enters once, by what they change."""
_LEGS = 6 * len(_OF_LEGS)
_OF_CAB = (3, 4, 4, 4, 3)
"""How often those of the cab enter: its mass, three shifts of its centre of mass, its inertia."""
SIZES = (1,) * _LEGS + _OF_CAB  #: How often parameters enter.


class Family:
    """Machines that differ from a nominal one in a pose, under a law."""

    def __init__(
        self, plant: Hexapod, law: Law, pose: Array, friction: Contact | None = None
    ) -> None:
        """Linearise machine and law, and free their parameters.

        `friction` is as `Linear` takes it. Raises `InputError` as `Linear` and `bound` do.
        """
        linear = Linear(plant, pose, friction=friction)
        self.pose, self._point = pose, linear.point
        cab = plant.cab_parameters
        assert cab is not None
        turn = rotation(*pose[3:])
        motion = np.linalg.inv(leg_jacobian(pose, plant.machine))
        self._motion = linalg.block_diag(turn.T, turn.T) @ motion  # in axes of the platform
        self._gravity = turn.T @ np.array([0.0, 0.0, units.STANDARD_GRAVITY])
        self._mass, self._place = cab.mass.si, FLIP * cab.centre_of_mass.si
        self._inertia = FLIP[:, None] * cab.tensor * FLIP
        self._ports_of = _port_slopes(plant)
        self._held = _areas(plant) * plant.parameters.supply_pressure.si
        self._plant = reduced(linear.system, outputs=labels(FEEDBACK, 6))
        self.loop = self._loop(bound(law, plant))
        """The nominal loop; delta of 1 is a change by 100 %, of the cab's place by 1 m."""

    def _loop(self, law: Law) -> Uncertain:
        """The loop with those states of a bound law that feedback reaches."""
        dcl = reduced(dcl_state_space(law, 6), labels(FEEDBACK, 6))
        system, (ak, bk, ck) = self._plant, _in_frames(dcl, law.frame)
        a, b, c, _ = (np.asarray(m) for m in (system.A, system.B, system.C, system.D))
        names, n = list(system.state_labels), len(a)
        state, command, w = np.split(np.eye(n + 6 + sum(SIZES)), [n, n + 6])
        seen, change = np.zeros((len(w), len(state[0]))), a @ state + b @ command
        drive, spool, speed, cap, rod = (
            [names.index(label) for label in labels((kind,), 6)]
            for kind in ("drive", "spool", "leg_velocity", "cap_pressure", "rod_pressure")
        )

        def free(name: str, what: Array) -> Array:
            """What the parameters of six legs add to what they multiply."""
            seen[_OF_LEGS[name]] = what
            return w[_OF_LEGS[name]]

        change[drive] += free("drive", change[drive])
        change[spool] += free("spool", change[spool])
        change[cap] += free("cap_port", a[cap, spool][:, None] * state[spool])
        change[rod] += free("rod_port", a[rod, spool][:, None] * state[spool])
        flow = free("leak", state[rod] - state[cap])
        change[cap] += a[cap, rod][:, None] * flow
        change[rod] -= a[rod, cap][:, None] * flow
        change[cap] += free("cap_oil", change[cap])
        change[rod] += free("rod_oil", change[rod])
        self._free_cab(change, speed, w[_LEGS:], seen[_LEGS:])
        sees = c @ state
        sees[12:18] = change[speed]
        a, by_command, by_w = np.split(np.vstack([change, bk @ sees]), [n, n + 6], axis=1)
        z, z_command, z_w = np.split(seen, [n, n + 6], axis=1)
        whole = np.hstack([a, by_command @ ck])
        whole[n:, n:] += ak
        return Uncertain(whole, by_w, np.hstack([z, z_command @ ck]), z_w, SIZES)

    def _free_cab(self, change: Array, speed: list[int], w: Array, seen: Array) -> None:
        """Put mass, place and inertia of the cab into the rows of the legs' speeds.

        With q = H v' and B + sum of delta_j dB_j, dB_j = U_j V_j, the cab moves by y = B q + U w1,
        is pulled by h = diag(m, m, m, I) y + w2, and the platform feels B' h + V' w3.
        """
        reach = _reach(self._place)
        body = linalg.block_diag(self._mass * np.eye(3), self._inertia)
        shifts = [_reach(self._place + one) - reach for one in np.eye(3)]
        rows = [np.flatnonzero(shift.any(axis=1)) for shift in shifts]
        parts = np.cumsum(_OF_CAB)[:-1]
        w_mass, *w_places, w_inertia = np.split(w, parts)
        z_mass, *z_places, z_inertia = np.split(seen, parts)
        moved, pulled, felt = (np.zeros((6, change.shape[1])) for _ in range(3))
        pulled[:3], pulled[3:] = w_mass, w_inertia
        for shift, at, one in zip(shifts, rows, w_places, strict=True):
            moved[at] += one[:2]
            felt += shift[at].T @ one[2:]
        added = self._motion.T @ (reach.T @ (body @ moved + pulled) + felt)
        change[speed] -= np.linalg.solve(self._point.mechanics.mass, added)
        q = self._motion @ change[speed]
        y = reach @ q + moved
        h = body @ y + pulled
        z_mass[:], z_inertia[:] = self._mass * y[:3], self._inertia @ y[3:]
        for shift, at, one in zip(shifts, rows, z_places, strict=True):
            one[:2], one[2:] = shift[at] @ q, h[at]

    def _loads(self, changes: Mapping[str, Array]) -> Array:
        """Static loads of the legs [N], (N, 6)."""
        mass = self._mass * (1.0 + changes["cab_mass"])
        weight = mass * self._gravity - self._mass * self._gravity
        turned = np.cross(self._place + changes["cab_place"], mass * self._gravity)
        turned -= np.cross(self._place, self._mass * self._gravity)
        return np.asarray(self._point.mechanics.load - np.hstack([weight, turned]) @ self._motion)

    def _ports(self, changes: Mapping[str, Array]) -> Array:
        """Rho - 1 of machines' cap and rod ports, (2, N, 6)."""
        load, loads = self._point.mechanics.load, self._loads(changes)
        high, gain = 1.0 + changes["supply_pressure"], 1.0 + changes["valve_gain"]
        at, nominal = loads / (self._held * high), load / self._held
        ratios = np.empty((2, *at.shape))
        for leg, ports in enumerate(self._ports_of):
            for ratio, kappa in zip(ratios, ports.slopes, strict=True):
                ratio[:, leg] = np.interp(at[:, leg], ports.shares, kappa)
                ratio[:, leg] /= np.interp(nominal[leg], ports.shares, kappa)
        return np.asarray(gain * np.sqrt(high) * ratios - 1.0)

    def deltas(self, changes: Mapping[str, Array]) -> Array:
        """Delta of machines by what is off, see `Box.changes`, (N, 60)."""
        of_legs = {
            "drive": changes["drive_lag"],
            "spool": changes["valve_lag"],
            "leak": changes["leak_rate"],
            **dict.fromkeys(("cap_oil", "rod_oil"), np.repeat(changes["bulk_modulus"], 6, axis=1)),
            **dict(zip(("cap_port", "rod_port"), self._ports(changes), strict=True)),
        }
        places = np.repeat(changes["cab_place"], 4, axis=1)
        mass, inertia = (np.repeat(changes[one], 3, axis=1) for one in ("cab_mass", "cab_inertia"))
        return np.hstack([*(of_legs[name] for name in _OF_LEGS), mass, places, inertia])

    def widths(self, box: Box, scale: float) -> Array:
        """Largest |delta| of the box of a scale, over the scale, (60,)."""
        widths = np.abs(self.deltas(_corners(box, scale))).max(axis=0)
        for port in ("cap_port", "rod_port"):
            widths[_OF_LEGS[port]] *= _MARGIN
        return np.asarray(widths / scale)

    def holds(self, box: Box, scale: float, *, closed: bool) -> bool:
        """Whether valves at rest, all of them `closed`, hold the legs of every machine in a box."""
        corners = _corners(box, scale)
        shares = self._loads(corners) / (self._held * (1.0 + corners["supply_pressure"]))
        ends = (one.closed if closed else one.shares[[0, -1]] for one in self._ports_of)
        low, high = np.transpose(list(ends))
        return bool((low < shares).all() and (shares < high).all())

    def damping(self, deltas: Array) -> Array:
        """Least damping ratio of poles, (N,): -1 to 1, of a real one either; slow ones have 1."""
        poles = np.linalg.eigvals(_off(self.loop, deltas))
        slow = poles.real + np.abs(poles.imag) < SLOW
        return np.asarray(np.where(slow, 1.0, -poles.real / np.abs(poles)).min(axis=1))

    def nominal(self) -> float:
        """That of the nominal machine, whose slow poles are exact: -1 where one does not decay."""
        poles = np.linalg.eigvals(self.loop.a)
        slow = poles[poles.real + np.abs(poles.imag) < SLOW]
        holds = bool((slow.real < -_STILL).all())
        return float(self.damping(np.zeros((1, sum(SIZES))))[0]) if holds else -1.0

    def damping_in(self, box: Box, points: Array) -> Array:
        """Damping ratios at points of the unit box."""
        return self.damping(self.deltas(box.changes(points)))

    def within(self, widths: Array) -> Uncertain:
        """The loop with parameters of these widths for a delta of 1."""
        wide = widths[:, None]
        return self.loop._replace(c=wide * self.loop.c, d=wide * self.loop.d)


def _corners(box: Box, scale: float) -> dict[str, Array]:
    """What is off in machines among which those with the widest slopes are."""
    signs = np.array(list(product((-1.0, 1.0), repeat=4)))
    cabs = (signs[:, None] * np.linspace(-1.0, 1.0, _STEPS)[:, None]).reshape(-1, 4)
    rest = np.array(list(product((-1.0, 0.0, 1.0), (-1.0, 1.0))))  # supply and gains
    counts = [count for _, count in KINDS.values()]
    at = dict(zip(KINDS, np.cumsum([0, *counts]), strict=False))
    points = np.ones((len(cabs) * len(rest), SIZE))
    points[:, at["cab_mass"] : at["cab_inertia"]] = np.repeat(cabs, len(rest), axis=0)
    high, gains = np.tile(rest, (len(cabs), 1)).T[:, :, None]
    points[:, [at["supply_pressure"]]] = high
    points[:, at["valve_gain"] : at["leak_rate"]] = gains
    return box.changes(scale * points)


class _Ports(NamedTuple):
    """Slopes of a leg's ports at rest by the load it holds, over area and supply pressure."""

    shares: Array  #: Loads that the valves hold, (n,).
    slopes: Array  #: Of cap and rod port, (2, n).
    closed: tuple[float, float]  #: Loads that closed valves hold; NaN for none.


def _areas(plant: Hexapod) -> Array:
    """Area of each leg that the load over the pressure at rest is: of equal areas one of them."""
    cap, rod = plant.hydraulics.cylinder.cap_area, plant.hydraulics.cylinder.rod_area
    return np.where(cap == rod, cap, cap - rod)


def _port_slopes(plant: Hexapod) -> list[_Ports]:
    """The slopes of each leg; legs of one cylinder, whose valves have other gains, share them."""
    cylinders, known = plant.hydraulics.cylinder, dict[bytes, _Ports]()
    for leg, cylinder in enumerate(cylinders):
        if cylinder.tobytes() not in known:
            known[cylinder.tobytes()] = _slopes_of(plant, leg)
    return [known[cylinder.tobytes()] for cylinder in cylinders]


def _slopes_of(plant: Hexapod, leg: int) -> _Ports:
    """Slopes of a leg's ports over the loads that its valves hold at rest."""
    hydraulics, supply = plant.hydraulics, plant.parameters.supply_pressure.si
    cylinder, bias = hydraulics.cylinder[leg], hydraulics.valve[leg].null_bias
    area = float(_areas(plant)[leg])
    ends = -_MOST * cylinder.rod_area / area, _MOST * cylinder.cap_area / area
    shares = _COARSE * np.arange(np.ceil(ends[0] / _COARSE), ends[1] / _COARSE)
    if cylinder.cap_area != cylinder.rod_area:
        shares = np.union1d(shares[(shares < 0.0) | (shares > 1.0)], np.arange(0.0, 1.0, _FINE))
    rows, held = [], []
    for share in shares:
        try:
            rest = hold(plant, leg, float(share) * area * supply, supply, 0.0)
        except NotLinearError:
            continue
        at = np.append(rest.pressure, [supply, 0.0])
        opening, outward = rest.command + bias, outward_share(rest.ratio)
        slopes = port_slopes(hydraulics, leg, opening, at, outward).opening[[CAP, ROD]]
        rows.append(slopes.sum(axis=1))
        held.append((share, not opening.any()))
    found, shut = np.array(held).T
    closed = found[shut > 0.0]
    ends = (closed[0], closed[-1]) if len(closed) else (np.nan, np.nan)
    return _Ports(found, np.array(rows).T, ends)


def _reach(place: Array) -> Array:
    """B: motion of a point and turning per motion of the platform, (6, 6)."""
    x, y, z = place
    reach = np.eye(6)
    reach[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return reach


def _off(loop: Uncertain, deltas: Array) -> Array:
    """A of machines that are off, (N, n, n)."""
    a, b, c, d, _ = loop
    wide = deltas[:, :, None]
    return np.asarray(a + b @ np.linalg.solve(np.eye(len(d)) - wide * d, wide * c))


def _in_frames(law: control.StateSpace, frame: float) -> tuple[Array, Array, Array]:
    """Law, a frame of delay, and the mean of two frames for the hold: A, B, C in w."""
    a, b, c, d = (np.asarray(m) for m in (law.A, law.B, law.C, law.D))
    n, one = len(a), np.eye(6)
    late = np.zeros((n + 12, n + 12))
    late[:n, :n], late[n : n + 6, :n], late[n + 6 :, n : n + 6] = a, c, one
    leaves = 0.5 * np.hstack([np.zeros((6, n)), one, one])
    back, scale = np.linalg.inv(late + np.eye(n + 12)), 2.0 / np.sqrt(frame)
    turned = 2.0 / frame * back @ (late - np.eye(n + 12))
    return turned, scale * back @ np.vstack([b, d, 0.0 * d]), scale * leaves @ back
