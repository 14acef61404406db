"""The operating point: openings and pressures that hold a plant still.

With valves that have no bias and bearings that do not leak the valves are closed, and piston
leakage ends at p_cap = p_rod = F / (A_cap - A_rod). Between the loads at which opening a valve by a
trace, either way, fills both chambers together in the direction of opening, this is the rest of a
leg under control (about 3600 to 14 100 lbf at 1500 psi). A leg loaded less or more, one with a
leaking bearing, or one whose two valves stand apart, rests at the opening at which no oil gathers
in either chamber:

    q_cap(c, p) = q_rod(c, p) = 0,    A_cap p_cap - A_rod p_rod = F

and the supply stands where the pump gives what is drawn,

    P_supply = Ps - (w / Qm + Rp) Q,    P_return = Pt + R Q.

The mechanics about rest, in actuator coordinates.

With l the extensions, T the motion of the machine per actuator velocity and F(l) the static forces,

    M_leg d2l/dt2 = dF - D dl/dt - G dl,    M_leg = T' M T,  D = T' d(-passive)/dv T,  G = dF/dl

M is MuJoCo's full inertia, armature included. G is the change of the static forces with the
configuration: gravity, and springs of joints and tendons. It is the Hessian of the potential in the
extensions, hence symmetric. Velocity products vanish at rest.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from cmf_mj.analysis.linear.ports import (
    CAP,
    DRAWN,
    RETURNED,
    ROD,
    Excitation,
    outward_share,
    port_slopes,
)
from cmf_mj.core.errors import NotLinearError
from cmf_mj.plant.cylinder import CONTACTS, Contact, Slope, friction_slope, holding_pressures
from cmf_mj.plant.hydraulics import Hydraulics
from cmf_mj.plant.oil import ATMOSPHERE
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.supply import Supply

_STEP = 1e-3
"""Displacement [m] and speed [m/s] of the central differences; their error is below 1e-6."""


class Mechanics(NamedTuple):
    """The linear mechanics of n actuators."""

    extension: NDArray[np.float64]  #: l [m], (n,).
    load: NDArray[np.float64]  #: F [N], (n,), positive pressing the legs together.
    mass: NDArray[np.float64]  #: M_leg [kg], (n, n).
    damping: NDArray[np.float64]  #: D [N s/m], (n, n).
    stiffness: NDArray[np.float64]  #: G [N/m], (n, n).


def linear_mechanics(plant: Plant, pose: ArrayLike | None = None) -> Mechanics:
    """Linearise the mechanics at rest in a configuration, default neutral; the plant is left there.

    Raises `NotLinearError` for dry friction in the model, a stop or contact that bears there, a leg
    on its stop, or cylinders that do not determine the motion.
    """
    mass = plant.reflected_mass(pose)
    _check_smooth(plant)
    model, data = plant.model, plant.data
    load, extension, motion = plant.static_load(), plant.extensions(), plant.leg_motion()
    rest = data.qpos.copy()
    stiffness, damping = np.empty_like(mass), np.empty_like(mass)
    for leg, direction in enumerate(motion.T):
        along = np.ascontiguousarray(direction)
        static, moving = [], []
        for step in (_STEP, -_STEP):
            data.qpos[:] = rest
            mujoco.mj_integratePos(model, data.qpos, along, step)
            static.append(plant.static_load())
            data.qpos[:], data.qvel[:] = rest, step * direction
            mujoco.mj_forward(model, data)
            moving.append(motion.T @ (data.qfrc_bias - data.qfrc_passive))
            data.qvel[:] = 0.0
        stiffness[:, leg] = (static[0] - static[1]) / (2.0 * _STEP)
        damping[:, leg] = (moving[0] - moving[1]) / (2.0 * _STEP)
    mujoco.mj_forward(model, data)
    return Mechanics(extension, load, mass, damping, stiffness)


def _check_smooth(plant: Plant) -> None:
    model, data = plant.model, plant.data
    for kind, losses, name in (
        ("joint", model.dof_frictionloss, lambda i: model.joint(model.dof_jntid[i]).name),
        ("tendon", model.tendon_frictionloss, lambda i: model.tendon(i).name),
    ):
        for i in np.flatnonzero(losses):
            raise NotLinearError(
                f"frictionloss: {kind} {name(i)!r} of the model has dry friction of "
                f"{losses[i]:g}, which has no linearisation; allowed: 0"
            )
    if (data.efc_type[: data.nefc] != mujoco.mjtConstraint.mjCNSTR_EQUALITY).any():
        raise NotLinearError("pose: a stop or a contact of the model bears there; allowed: none")
    cylinder, extension = plant.hydraulics.cylinder, plant.extensions()
    free = cylinder.half_stroke - cylinder.minimum_gap
    for leg in np.flatnonzero(np.abs(extension) >= free):
        raise NotLinearError(
            f"pose: puts {plant.actuators[leg]} at {extension[leg]:.4f} m; "
            f"allowed: +-{free[leg]:.4f} m"
        )


_SCAN = 41  #: Pressures at which the balance of an actuator is looked at before it is solved.
_ROUNDS = 50
_APART = 1e-2
"""Least difference of the chambers' pressures over the supply's that a search begins with."""
_EVEN = 1e-6
"""Oil that an opening gathers in both chambers over what passes, below which it gathers none."""
_SHUT = 1e-9
"""Opening that counts as shut: where both chambers have one pressure no flow is a balance too."""
_END = 1e-9
"""Least fill of one way over that of the other, for rounding, of a closed valve at rest."""


class OperatingPoint(NamedTuple):
    """Rest of a plant with its hydraulics."""

    mechanics: Mechanics  #: Extensions, loads and the linear mechanics.
    command: NDArray[np.float64]  #: Valve commands that hold the legs, fractions, (n,).
    spool: NDArray[np.float64]  #: Spool positions, fractions, (n, 2).
    pressure: NDArray[np.float64]  #: Pressures of cap and rod [Pa], (n, 2).
    supply_pressure: float  #: Of the supply manifold [Pa].
    return_pressure: float  #: Of the return manifold [Pa].
    pump_flow: float  #: [m^3/s].
    accumulator_oil: float  #: In one accumulator [m^3].
    outward: NDArray[np.float64]
    """Share of outward motion in the gains of closed valves, see `describing`, (n,)."""
    friction: Slope  #: Slope of dry friction.


def operating_point(
    plant: Plant,
    pose: ArrayLike | None = None,
    *,
    excitation: Excitation = "noise",
    friction: Contact | None = None,
) -> OperatingPoint:
    """Find the rest of a plant in a configuration, default neutral; the plant is left there.

    `excitation` is what moves the valves, see `describing`; `friction` how dry friction enters, see
    `plant.cylinder`, and None refuses it; it holds no load at rest. Raises `NotLinearError` for
    what has no linearisation (overlap, hysteresis, dry friction), named with the set and the
    actuator; a load or a flow the supply cannot hold; a configuration on a stop.
    """
    _check_linear(plant, refuse_friction=friction is None)
    slope = friction_slope(plant.hydraulics.friction, "none" if friction is None else friction)
    mechanics = linear_mechanics(plant, pose)
    hydraulics = plant.hydraulics
    supply, name = hydraulics.supply, plant.parameters.name
    high, low = supply.pressure, supply.return_pressure
    for _ in range(_ROUNDS):
        rests = [hold(plant, leg, mechanics.load[leg], high, low) for leg in range(plant.legs)]
        command = np.array([rest.command for rest in rests])
        pressure = np.array([rest.pressure for rest in rests])
        spool = command[:, None] + hydraulics.valve.null_bias
        ends = np.array([high, low])
        flows = [
            port_slopes(hydraulics, i, spool[i], np.append(pressure[i], ends)).flow
            for i in range(plant.legs)
        ]
        drawn = float(sum(flow[DRAWN] for flow in flows))
        returned = float(sum(flow[RETURNED] for flow in flows))
        if supply.constant:
            break
        if drawn > supply.pump_flow:
            raise NotLinearError(
                f"pump_flow: set {name!r} draws {drawn:.4g} m^3/s at rest; the pump gives at most "
                f"{supply.pump_flow:.4g} m^3/s"
            )
        fall = (supply.pump_droop / supply.pump_flow + supply.pump_line) * drawn
        after = supply.pressure - fall, supply.return_pressure + supply.tank_line * returned
        moved = max(abs(after[0] - high), abs(after[1] - low))
        high, low = after
        if moved < 1e-6:
            break
    _check_supply(plant, supply, high, low)
    ratio = (supply.precharge + ATMOSPHERE) / (high + ATMOSPHERE)
    oil = float(supply.gas_volume * (1.0 - ratio ** (1.0 / supply.exponent)))
    outward = np.array([outward_share(rest.ratio, excitation) for rest in rests])
    supplied = high, low, drawn, oil
    return OperatingPoint(mechanics, command, spool, pressure, *supplied, outward, slope)


class Rest(NamedTuple):
    """What holds one leg."""

    command: float
    pressure: NDArray[np.float64]  #: Of cap and rod [Pa], (2,).
    ratio: float = 1.0
    """Openings outward over openings inward of a valve that is closed on average."""


def hold(plant: Plant, leg: int, load: float, high: float, low: float) -> Rest:
    """The rest of one leg under a load [N] at given pressures of the manifolds [Pa].

    Raises `NotLinearError` for a load that no opening of the valves holds.
    """
    hydraulics = plant.hydraulics
    cylinder, load = hydraulics.cylinder[leg], float(load)
    bias = hydraulics.valve[leg].null_bias
    closed = holding_pressures(cylinder, load, high, low)[0]
    null = cylinder.leakage == 0.0 or abs(closed[0] - closed[1]) < 1e-6 * high
    if bias[0] == bias[1] and cylinder.bearing_leakage == 0.0 and null:
        at = (np.zeros(2), np.append(closed, [high, low]))
        ports = [port_slopes(hydraulics, leg, *at, way).opening[[CAP, ROD]] for way in (0.0, 1.0)]
        fills = [float(opened.sum()) for opened in ports]
        if np.abs(fills).max() < _EVEN * np.abs(ports).max():  # areas alike: neither way fills
            return Rest(-float(bias[0]), closed)
        # At the ends of the range the opening that holds the leg grows from nothing.
        if min(fills) > -_END * max(fills):
            least = _END**2 * max(fills)
            return Rest(-float(bias[0]), closed, max(fills[0], least) / max(fills[1], least))
    reach = 1.0 + float(np.abs(bias).max())
    if bias[0] == bias[1]:
        rest = _rest_by_newton(plant, leg, load, high, low)
        if rest is not None and abs(rest.command) < reach:
            return rest
    areas = cylinder.cap_area, cylinder.rod_area

    def pressures(rod: float) -> NDArray[np.float64]:
        return np.array([(load + areas[1] * rod) / areas[0], rod, high, low])

    def flows(command: float, rod: float) -> NDArray[np.float64]:
        ports = port_slopes(hydraulics, leg, command + bias, pressures(rod))
        return ports.flow[[CAP, ROD]] / areas

    def command_at(rod: float) -> float:
        """The command that moves the leg nowhere: both chambers fill alike; NaN for none."""

        def moves(command: float) -> float:
            return float(np.subtract(*flows(command, rod)))

        if moves(-reach) * moves(reach) > 0.0:  # more leaks than open valves let in
            return float("nan")
        return float(optimize.brentq(moves, -reach, reach, xtol=1e-15))

    def gathering(rod: float) -> float:
        command = command_at(rod)
        return float(flows(command, rod).sum()) if np.isfinite(command) else float("nan")

    least = max(low, (areas[0] * low - load) / areas[1])
    most = min(high, (areas[0] * high - load) / areas[1])
    margin = 1e-9 * (most - least)
    scan = np.linspace(least + margin, most - margin, _SCAN)
    balance = np.array([gathering(rod) for rod in scan])
    # Falling through 0: a pressure too high loses oil, so that the balance keeps itself.
    balanced = [
        optimize.brentq(gathering, scan[i], scan[i + 1], xtol=1e-6)
        for i in np.flatnonzero((balance[:-1] > 0.0) & (balance[1:] <= 0.0))
    ]
    if not balanced:
        raise NotLinearError(
            f"{plant.actuators[leg]}: set {plant.parameters.name!r} has no opening of the valves "
            f"that holds {load:.0f} N still"
        )
    rod = min(balanced, key=lambda p: abs(command_at(p) + float(bias.mean())))
    return Rest(command_at(rod), pressures(rod)[:2])


def _rest_by_newton(plant: Plant, leg: int, load: float, high: float, low: float) -> Rest | None:
    """The rest of a leg with equal valves, by Newton's method; None where it finds none.

    What flows in through one valve port leaks through the piston and leaves through the other, so
    that with sharp orifices and a = A_cap / A_rod

        opened outward  a^2 (Ps - p_cap) = p_rod - Pt      inward  a^2 (p_cap - Pt) = Ps - p_rod

    which with the load gives both pressures: the starting point.
    """
    hydraulics = plant.hydraulics
    cylinder, valves = hydraulics.cylinder[leg], hydraulics.valve[leg]
    bias = float(valves.null_bias[0])
    ratio, share = cylinder.cap_area / cylinder.rod_area, load / cylinder.cap_area
    for way in (1.0, -1.0):
        least, most = (low, high) if way > 0.0 else (high, low)
        rod = (ratio**2 * (most - share) + least) / (1.0 + ratio)
        cap = share + rod / ratio
        if way * (cap - rod) < _APART * high:  # laminar flow may yet hold it, at a small opening
            if ratio == 1.0:  # areas alike: the load alone sets cap - rod
                continue
            rod = (share - way * _APART * high) / (1.0 - 1.0 / ratio)
            cap = share + rod / ratio
        drop = high - cap if way > 0.0 else cap - low
        if drop <= 0.0:
            continue
        flow = cylinder.leakage * (cap - rod)
        command = flow / (float(valves.cap_gain.sum()) * np.sqrt(drop)) - bias
        for _ in range(_ROUNDS):
            pressures = np.array([share + rod / ratio, rod, high, low])
            slopes = port_slopes(hydraulics, leg, command + valves.null_bias, pressures)
            rows = slopes.pressure[[CAP, ROD]]
            jacobian = np.column_stack(
                [slopes.opening[[CAP, ROD]].sum(axis=1), rows[:, ROD] + rows[:, CAP] / ratio]
            )
            step = np.linalg.solve(jacobian, -slopes.flow[[CAP, ROD]])
            command, rod = command + float(step[0]), rod + float(step[1])
            if abs(step[1]) < 1e-9 * high:
                inside = low < rod < high and low < share + rod / ratio < high
                if inside and way * (command + bias) > _SHUT:
                    return Rest(command, np.array([share + rod / ratio, rod]))
                break
    return None


def _check_linear(plant: Plant, *, refuse_friction: bool) -> None:
    hydraulics: Hydraulics = plant.hydraulics
    for leg, name in enumerate(plant.actuators):
        valve, friction = hydraulics.valve[leg], hydraulics.friction[leg]
        for field, value, allowed in (
            ("overlap", valve.overlap.max(), "0"),
            ("hysteresis", 2.0 * valve.play.max(), "0"),
            (
                "coulomb_friction",
                friction.coulomb_friction if refuse_friction else 0.0,
                f"0, or a friction that is stated (--friction): {CONTACTS}",
            ),
        ):
            if value > 0.0:
                raise NotLinearError(
                    f"{field}: {value:g} of {name} in the set {plant.parameters.name!r} has no "
                    f"linearisation; allowed: {allowed}"
                )


def _check_supply(plant: Plant, supply: Supply, high: float, low: float) -> None:
    name = plant.parameters.name
    needed = float(plant.hydraulics.valve.threshold_pressure.max())
    if high - low < needed:
        raise NotLinearError(
            f"threshold_pressure: set {name!r} has {high - low:.4g} Pa across the valves; "
            f"they open from {needed:.4g} Pa on"
        )
    if not supply.constant and supply.accumulators > 0.0 and high <= supply.precharge:
        raise NotLinearError(
            f"precharge_pressure: {supply.precharge:.4g} Pa of set {name!r} must be less than the "
            f"supply's {high:.4g} Pa at rest; the accumulators would be empty"
        )
