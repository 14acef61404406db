"""The operating point: openings and pressures that hold a plant still.

Valves without bias are closed where bearings do not leak, and piston leakage ends at
p_cap = p_rod = F / (A_cap - A_rod). This is the rest of a leg under control as long as opening a
valve by a trace, either way, fills both chambers together in the direction of opening: from about
3600 to 14 100 lbf at 1500 psi. Any other leg, and one whose two valves stand apart, rests at the
opening at which no oil gathers in either chamber:

    q_cap(c, p) = q_rod(c, p) = 0,    A_cap p_cap - A_rod p_rod = F

and the supply is at the pressures at which the pump gives what the legs draw,

    P_supply = Ps - (w / Qm + Rp) Q,    P_return = Pt + R Q.

The mechanics about rest are in actuator coordinates: with l the extensions, T the motion of the
machine per actuator velocity and F(l) the static forces,

    M_leg d2l/dt2 = dF - D dl/dt - G dl,    M_leg = T' M T,  D = T' d(-passive)/dv T,  G = dF/dl

M is MuJoCo's full inertia, armature included. G, of gravity and the springs of joints and tendons,
is the Hessian of the potential in the extensions, hence symmetric.
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
    Slopes,
    outward_share,
    port_slopes,
)
from cmf_mj.core.errors import NotLinearError
from cmf_mj.plant.cylinder import (
    CONTACTS,
    Contact,
    FrictionSlope,
    friction_slope,
    holding_pressures,
)
from cmf_mj.plant.hydraulics import Hydraulics
from cmf_mj.plant.oil import ATMOSPHERE
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.supply import Supply

_STEP = 1e-3  #: Displacement [m] and speed [m/s] of differences; their error is below 1e-6.


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
    rest, stiffness, damping = data.qpos.copy(), np.empty_like(mass), np.empty_like(mass)

    for leg, direction in enumerate(motion.T):
        loads, forces = [], []
        for step in (_STEP, -_STEP):
            data.qpos[:] = rest
            mujoco.mj_integratePos(model, data.qpos, np.ascontiguousarray(direction), step)
            loads.append(plant.static_load())
            data.qpos[:], data.qvel[:] = rest, step * direction
            mujoco.mj_forward(model, data)
            forces.append(motion.T @ (data.qfrc_bias - data.qfrc_passive))
            data.qvel[:] = 0.0
        (load_out, load_in), (force_out, force_in) = loads, forces
        stiffness[:, leg] = (load_out - load_in) / (2.0 * _STEP)
        damping[:, leg] = (force_out - force_in) / (2.0 * _STEP)
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
    travel = cylinder.half_stroke - cylinder.minimum_gap
    for leg in np.flatnonzero(np.abs(extension) >= travel):
        raise NotLinearError(
            f"pose: puts {plant.actuators[leg]} at {extension[leg]:.4f} m; "
            f"allowed: +-{travel[leg]:.4f} m"
        )


_SCANNED_PRESSURES = 41  #: Rod pressures at which the search by scan begins.
_ITERATIONS = 50  #: Of Newton's method, and of the balance of the supply.
_PRESSURE_GAP = 1e-2  #: Least difference of the chambers' pressures over the supply's at the start.
_EVEN = 1e-6  #: Oil gathered in both chambers over the flow, below which none counts as gathered.
_SHUT = 1e-9  #: Opening that counts as shut: with equal chamber pressures it is a balance too.
_LEAST_FILL = 1e-9  #: Least fill of one way over the other of a closed valve at rest.


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
    outward: NDArray[np.float64]  #: Share of outward motion at closed valves, see `ports`, (n,).
    friction: FrictionSlope  #: Slope of dry friction.


def operating_point(
    plant: Plant,
    pose: ArrayLike | None = None,
    *,
    excitation: Excitation = "noise",
    friction: Contact | None = None,
) -> OperatingPoint:
    """Find the rest of a plant in a configuration, default neutral; the plant is left there.

    `excitation` is what moves the valves, see `ports`; `friction` how dry friction enters, see
    `plant.cylinder`, and None refuses it; it holds no load at rest. Raises `NotLinearError` for
    what has no linearisation (overlap, hysteresis, dry friction), named with the set and the
    actuator; a load or a flow the supply cannot hold; a configuration on a stop.
    """
    _check_linear(plant, refuse_friction=friction is None)
    slope = friction_slope(plant.hydraulics.friction, "none" if friction is None else friction)
    mechanics, supply = linear_mechanics(plant, pose), plant.hydraulics.supply
    balance = _balance_supply(plant, mechanics.load)
    _check_supply(plant, supply, balance.high, balance.low)
    ratio = (supply.precharge + ATMOSPHERE) / (balance.high + ATMOSPHERE)
    return OperatingPoint(
        mechanics=mechanics,
        command=np.array([rest.command for rest in balance.rests]),
        spool=balance.spool,
        pressure=np.array([rest.pressure for rest in balance.rests]),
        supply_pressure=balance.high,
        return_pressure=balance.low,
        pump_flow=balance.drawn_flow,
        accumulator_oil=float(supply.gas_volume * (1.0 - ratio ** (1.0 / supply.exponent))),
        outward=np.array([outward_share(rest.ratio, excitation) for rest in balance.rests]),
        friction=slope,
    )


class Rest(NamedTuple):
    """What holds one leg."""

    command: float  #: Valve command, a fraction.
    pressure: NDArray[np.float64]  #: Of cap and rod [Pa], (2,).
    ratio: float = 1.0  #: Openings outward over openings inward of a valve closed on average.


class _Balance(NamedTuple):
    """Legs and manifolds at rest."""

    rests: list[Rest]
    spool: NDArray[np.float64]  #: (n, 2).
    drawn_flow: float  #: Out of the supply manifold [m^3/s].
    high: float  #: Pressure of the supply manifold [Pa].
    low: float  #: Pressure of the return manifold [Pa].


def _balance_supply(plant: Plant, loads: NDArray[np.float64]) -> _Balance:
    """The rest of all legs at the pressures at which the pump gives what they draw."""
    hydraulics, supply = plant.hydraulics, plant.hydraulics.supply
    high, low = supply.pressure, supply.return_pressure
    for _ in range(_ITERATIONS):
        rests = [find_rest(plant, leg, load, high, low) for leg, load in enumerate(loads)]
        spool = np.array([rest.command for rest in rests])[:, None] + hydraulics.valve.null_bias
        manifolds = np.array([high, low])
        flows = [
            port_slopes(hydraulics, leg, spool[leg], np.append(rest.pressure, manifolds)).flow
            for leg, rest in enumerate(rests)
        ]
        drawn, returned = (float(sum(flow[row] for flow in flows)) for row in (DRAWN, RETURNED))
        if supply.constant:
            break
        if drawn > supply.pump_flow:
            raise NotLinearError(
                f"pump_flow: set {plant.parameters.name!r} draws {drawn:.4g} m^3/s at rest; the "
                f"pump gives at most {supply.pump_flow:.4g} m^3/s"
            )
        droop = (supply.pump_droop / supply.pump_flow + supply.pump_line) * drawn
        new_high = supply.pressure - droop
        new_low = supply.return_pressure + supply.tank_line * returned
        change = max(abs(new_high - high), abs(new_low - low))
        high, low = new_high, new_low
        if change < 1e-6:
            break
    return _Balance(rests, spool, drawn, high, low)


class _LoadedLeg(NamedTuple):
    """One leg under a load between the manifolds."""

    hydraulics: Hydraulics
    leg_index: int
    load: float  #: [N].
    high: float  #: Pressure of the supply manifold [Pa].
    low: float  #: Pressure of the return manifold [Pa].

    def slopes(self, command: float, cap: float, rod: float, outward: float = 0.5) -> Slopes:
        """Flows and slopes of the leg at a command and pressures of cap and rod [Pa]."""
        spools = command + self.hydraulics.valve[self.leg_index].null_bias
        pressures = np.array([cap, rod, self.high, self.low])
        return port_slopes(self.hydraulics, self.leg_index, spools, pressures, outward)


def find_rest(plant: Plant, leg: int, load: float, high: float, low: float) -> Rest:
    """The rest of one leg under a load [N] at given pressures of the manifolds [Pa].

    Raises `NotLinearError` for a load that no opening of the valves holds.
    """
    loaded = _LoadedLeg(plant.hydraulics, leg, float(load), high, low)
    bias = plant.hydraulics.valve[leg].null_bias
    largest_command = 1.0 + float(np.abs(bias).max())
    rest = None
    if bias[0] == bias[1]:
        rest = _closed_rest(loaded) or _rest_by_newton(loaded)
    if rest is None or abs(rest.command) >= largest_command:
        rest = _rest_by_scan(loaded, largest_command)
    if rest is None:
        raise NotLinearError(
            f"{plant.actuators[leg]}: set {plant.parameters.name!r} has no opening of the valves "
            f"that holds {load:.0f} N still"
        )
    return rest


def _closed_rest(leg: _LoadedLeg) -> Rest | None:
    """The rest of a leg with equal valves, both closed; None where closed valves do not hold it."""
    cylinder = leg.hydraulics.cylinder[leg.leg_index]
    closing = -float(leg.hydraulics.valve[leg.leg_index].null_bias[0])
    ((cap, rod),) = holding_pressures(cylinder, leg.load, leg.high, leg.low)
    leak_ends = cylinder.leakage == 0.0 or abs(cap - rod) < 1e-6 * leg.high
    if cylinder.bearing_leakage != 0.0 or not leak_ends:
        return None
    inward = leg.slopes(closing, cap, rod, 0.0).opening[[CAP, ROD]]
    outward = leg.slopes(closing, cap, rod, 1.0).opening[[CAP, ROD]]
    pressure, fills = np.array([cap, rod]), (float(inward.sum()), float(outward.sum()))
    if np.abs(fills).max() < _EVEN * np.abs([inward, outward]).max():  # areas alike: neither fills
        return Rest(closing, pressure)
    # At the ends of the range the opening that holds the leg grows from nothing.
    if min(fills) <= -_LEAST_FILL * max(fills):
        return None
    inward_fill, outward_fill = np.maximum(fills, _LEAST_FILL**2 * max(fills))
    return Rest(closing, pressure, float(inward_fill / outward_fill))


def _rest_by_scan(leg: _LoadedLeg, largest_command: float) -> Rest | None:
    """The rest of any leg by bisection in command and rod pressure; None where there is none."""
    cylinder, bias = (
        leg.hydraulics.cylinder[leg.leg_index],
        leg.hydraulics.valve[leg.leg_index].null_bias,
    )
    cap_area, rod_area = cylinder.cap_area, cylinder.rod_area

    def cap_of(rod: float) -> float:
        return float((leg.load + rod_area * rod) / cap_area)

    def filling_speeds(command: float, rod: float) -> NDArray[np.float64]:
        """Flows into cap and rod chamber over their areas, (2,) [m/s]."""
        return leg.slopes(command, cap_of(rod), rod).flow[[CAP, ROD]] / (cap_area, rod_area)

    def command_at(rod: float) -> float:
        """The command that moves the leg nowhere: both chambers fill alike; NaN for none."""

        def leg_speed(command: float) -> float:
            cap_speed, rod_speed = filling_speeds(command, rod)
            return float(cap_speed - rod_speed)

        if leg_speed(-largest_command) * leg_speed(largest_command) > 0.0:
            return float("nan")  # more leaks than open valves let in
        return float(optimize.brentq(leg_speed, -largest_command, largest_command, xtol=1e-15))

    def gathering(rod: float) -> float:
        command = command_at(rod)
        return float(filling_speeds(command, rod).sum()) if np.isfinite(command) else float("nan")

    least = max(leg.low, (cap_area * leg.low - leg.load) / rod_area)
    most = min(leg.high, (cap_area * leg.high - leg.load) / rod_area)
    margin = 1e-9 * (most - least)
    scan = np.linspace(least + margin, most - margin, _SCANNED_PRESSURES)
    balance = np.array([gathering(rod) for rod in scan])
    # Falling through 0: a pressure too high loses oil, so that the balance keeps itself.
    balanced_rods = [
        optimize.brentq(gathering, scan[i], scan[i + 1], xtol=1e-6)
        for i in np.flatnonzero((balance[:-1] > 0.0) & (balance[1:] <= 0.0))
    ]
    if not balanced_rods:
        return None
    rod = min(balanced_rods, key=lambda rod: abs(command_at(rod) + float(bias.mean())))
    return Rest(command_at(rod), np.array([cap_of(rod), rod]))


def _rest_by_newton(leg: _LoadedLeg) -> Rest | None:
    """The rest of a leg with equal valves, by Newton's method; None where it finds none.

    What flows in through one valve port leaks through the piston and leaves through the other, so
    that with sharp orifices and a = A_cap / A_rod

        opened outward  a^2 (Ps - p_cap) = p_rod - Pt      inward  a^2 (p_cap - Pt) = Ps - p_rod

    which with the load gives both pressures: the starting point.
    """
    cylinder, valves = leg.hydraulics.cylinder[leg.leg_index], leg.hydraulics.valve[leg.leg_index]
    bias, high, low = float(valves.null_bias[0]), leg.high, leg.low
    ratio, load_pressure = cylinder.cap_area / cylinder.rod_area, leg.load / cylinder.cap_area
    for sign in (1.0, -1.0):  # opened outward, inward
        cap_port, rod_port = (high, low) if sign > 0.0 else (low, high)
        rod = (ratio**2 * (cap_port - load_pressure) + rod_port) / (1.0 + ratio)
        cap = load_pressure + rod / ratio
        if sign * (cap - rod) < _PRESSURE_GAP * high:  # laminar flow may hold it, barely opened
            if ratio == 1.0:  # areas alike: the load alone sets cap - rod
                continue
            rod = (load_pressure - sign * _PRESSURE_GAP * high) / (1.0 - 1.0 / ratio)
            cap = load_pressure + rod / ratio
        drop = high - cap if sign > 0.0 else cap - low
        if drop <= 0.0:
            continue
        flow = cylinder.leakage * (cap - rod)
        command = flow / (float(valves.cap_gain.sum()) * np.sqrt(drop)) - bias
        for _ in range(_ITERATIONS):
            slopes = leg.slopes(command, load_pressure + rod / ratio, rod)
            by_command = slopes.opening[[CAP, ROD]].sum(axis=1)
            by_rod = slopes.pressure[[CAP, ROD], ROD] + slopes.pressure[[CAP, ROD], CAP] / ratio
            jacobian = np.column_stack([by_command, by_rod])
            step = np.linalg.solve(jacobian, -slopes.flow[[CAP, ROD]])
            command, rod = command + float(step[0]), rod + float(step[1])
            if abs(step[1]) < 1e-9 * high:
                cap = load_pressure + rod / ratio
                if low < rod < high and low < cap < high and sign * (command + bias) > _SHUT:
                    return Rest(command, np.array([cap, rod]))
                break
    return None


def _check_linear(plant: Plant, *, refuse_friction: bool) -> None:
    for leg, name in enumerate(plant.actuators):
        valve, friction = plant.hydraulics.valve[leg], plant.hydraulics.friction[leg]
        values = {"overlap": valve.overlap.max(), "hysteresis": 2.0 * valve.play.max()}
        if refuse_friction:
            values["coulomb_friction"] = friction.coulomb_friction
        for field, value in values.items():
            if value > 0.0:
                stated = f", or a friction that is stated (--friction): {CONTACTS}"
                raise NotLinearError(
                    f"{field}: {value:g} of {name} in the set {plant.parameters.name!r} has no "
                    f"linearisation; allowed: 0{stated if field == 'coulomb_friction' else ''}"
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
