"""State space of a plant with its hydraulics about rest, assembled from the slopes of its parts.

With d, u drive and spool of a valve, l, v extensions and speeds, p chamber pressures, r(p) what the
oil holds per volume, q the port flows, and M_leg, D, G of the mechanics,

    dd/dt = a (c - d)                                      du/dt = b (d - u)
    dl/dt = v                  M_leg dv/dt = A_cap p_cap - A_rod p_rod - (D + b) v - G l
    V r' dp_cap/dt = dq_cap - r A_cap v                    V r' dp_rod/dt = dq_rod + r A_rod v

and of a supply of pump, accumulators and manifolds, P its pressures and o the oil in each of m
accumulators,

    V r' dP_supply/dt = Q + m (g o - P_supply) / Ra - drawn
    V r' dP_return/dt = returned - P_return / R
    do/dt = -(g o - P_supply) / Ra,    T dQ/dt = -(Qm / w) (P_supply + Rp Q) - Q

all as deviations. The relief valve is shut. The pump counts as working: any motion draws oil, which
takes the compensator off the end of its range, where it stands at perfect rest.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.linear import ports
from cmf_mj.analysis.linear.loop import labels
from cmf_mj.analysis.linear.operating_point import OperatingPoint, operating_point
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.plant.cylinder import Contact, volumes
from cmf_mj.plant.oil import density
from cmf_mj.plant.parameters import VALVES
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.supply import gas_pressure

Matrix = NDArray[np.float64]


class _System:
    """Matrices A and B, filled by the names of states and inputs."""

    def __init__(self, states: list[str], inputs: list[str]) -> None:
        self.row = {name: i for i, name in enumerate(states)}
        self.column = {name: i for i, name in enumerate(inputs)}
        self.a = np.zeros((len(states), len(states)))
        self.b = np.zeros((len(states), len(inputs)))

    def add(self, state: str, **coefficients: float) -> None:
        """Add terms to the derivative of a state; those of absent states are left out."""
        for name, value in coefficients.items():
            if name in self.row:
                self.a[self.row[state], self.row[name]] += value
            elif name in self.column:
                self.b[self.row[state], self.column[name]] += value


def linearize(
    plant: Plant,
    pose: ArrayLike | None = None,
    *,
    excitation: ports.Excitation = "noise",
    friction: Contact | None = None,
    at: OperatingPoint | None = None,
) -> control.StateSpace:
    """Linearise a plant with its hydraulics at rest in a configuration; the plant is left there.

    The plant is any whose cylinders determine its motion; the pose is as `plant.place` takes it, by
    default neutral; `excitation` moves the valves, `noise`, `sine` or `mean`, see `ports`;
    `friction` says how dry friction enters, `none`, `stuck` or a speed, see `plant.cylinder`;
    `at` is the operating point, where it is known, instead of these. Two valves of an actuator that
    have the same lags share their states.

    Inputs are `command_1` and on, fractions; outputs `leg_position` [m], `leg_velocity`,
    `leg_acceleration`, `cap_pressure` and `rod_pressure` [Pa] of all legs, name by name as
    `linear.loop.closed_loop` reads them, and of a supply that is no constant one `supply_pressure`
    and `return_pressure` [Pa]. A single leg has bare names.

    Raises `NotLinearError` as `operating_point` does.

    >>> model = cmf_mj.linearize(cmf_mj.SingleLegs(hydraulics="report"))
    >>> model.input_labels[0], bool(model.poles().real.max() < 1e-6)
    ('command_1', True)
    """
    point = at or operating_point(plant, pose, excitation=excitation, friction=friction)
    legs = plant.legs
    valves = [_valve_states(plant, name) for name in plant.actuators]
    leg_suffix = [f"_{leg + 1}" if legs > 1 else "" for leg in range(legs)]
    lags = [
        f"{kind}{valve}{leg_suffix[leg]}"
        for kind in ("drive", "spool")
        for leg in range(legs)
        for valve in dict.fromkeys(valves[leg])
    ]
    motion = ("leg_position", "leg_velocity", "cap_pressure", "rod_pressure")
    supply, manifolds, network = plant.hydraulics.supply, list[str](), list[str]()
    if not supply.constant:
        manifolds = ["supply_pressure", "return_pressure"]
        accumulator = ["accumulator_oil"] if supply.accumulators > 0.0 else []
        network = [*manifolds, *accumulator, "pump_flow"]
    system = _System([*lags, *labels(motion, legs), *network], labels(("command",), legs))
    _fill_mechanics(plant, point, system)
    flows = [_fill_hydraulics(plant, point, system, leg, valves[leg]) for leg in range(legs)]
    if network:
        _fill_supply(plant, point, system, flows)
    outputs = [*labels(FEEDBACK, legs), *manifolds]
    c = np.zeros((len(outputs), system.a.shape[0]))
    for i, name in enumerate(outputs):
        if name in system.row:
            c[i, system.row[name]] = 1.0
    for speed in labels(("leg_velocity",), legs):
        acceleration = speed.replace("velocity", "acceleration")
        c[outputs.index(acceleration)] = system.a[system.row[speed]]
    names = {"inputs": list(system.column), "outputs": outputs}
    matrices = system.a, system.b, c, np.zeros((c.shape[0], legs))
    return control.ss(*matrices, states=list(system.row), name=plant.name, **names)


def _lag_rates(plant: Plant, actuator: str, valve: int) -> tuple[float, float]:
    """Rates a and b of drive and spool of a valve [rad/s]."""
    values = plant.parameters.actuator(actuator, valve)
    return values["drive_lag"].si, values["valve_lag"].si


def _valve_states(plant: Plant, actuator: str) -> list[str]:
    """Suffix of the lag states of each valve: none where both have the same lags."""
    are_alike = len({_lag_rates(plant, actuator, i) for i in range(len(VALVES))}) == 1
    return ["" if are_alike else f"_{name}" for name in VALVES]


def _fill_mechanics(plant: Plant, point: OperatingPoint, system: _System) -> None:
    mechanics, cylinder = point.mechanics, plant.hydraulics.cylinder
    position, speed, cap, rod = (
        labels((name,), plant.legs)
        for name in ("leg_position", "leg_velocity", "cap_pressure", "rod_pressure")
    )
    inverse = np.linalg.inv(mechanics.mass)
    friction = plant.hydraulics.friction.viscous_friction + point.friction.damping
    damping = mechanics.damping + np.diag(friction)
    stiffness = mechanics.stiffness + np.diag(point.friction.stiffness)
    by_pressure = inverse * cylinder.cap_area, -inverse * cylinder.rod_area
    accelerations = np.hstack([-inverse @ stiffness, -inverse @ damping, *by_pressure])
    for leg in range(plant.legs):
        system.add(position[leg], **{speed[leg]: 1.0})
        for state, slope in zip((*position, *speed, *cap, *rod), accelerations[leg], strict=True):
            system.add(speed[leg], **{state: slope})


class _ManifoldFlows(NamedTuple):
    """Slopes of a leg's flows out of the supply and into the return manifold, by state."""

    drawn: dict[str, float]
    returned: dict[str, float]


def _fill_hydraulics(
    plant: Plant, point: OperatingPoint, system: _System, leg: int, valves: list[str]
) -> _ManifoldFlows:
    """Fill in lags and chambers of one leg; returns its flows at the manifolds.

    `valves` are the suffixes of the states of its valves, alike where they share them.
    """
    hydraulics, leg_suffix = plant.hydraulics, f"_{leg + 1}" if plant.legs > 1 else ""
    cylinder = hydraulics.cylinder[leg]
    for suffix in dict.fromkeys(valves):
        a, b = _lag_rates(plant, plant.actuators[leg], valves.index(suffix))
        drive, spool = f"drive{suffix}{leg_suffix}", f"spool{suffix}{leg_suffix}"
        system.add(drive, **{drive: -a, f"command{leg_suffix}": a})
        system.add(spool, **{spool: -b, drive: b})
    extension = point.mechanics.extension[leg]
    manifolds = np.array([point.supply_pressure, point.return_pressure])
    pressures = np.append(point.pressure[leg], manifolds)
    slopes = ports.port_slopes(hydraulics, leg, point.spool[leg], pressures, point.outward[leg])
    cap, rod, speed = (
        f"{name}{leg_suffix}" for name in ("cap_pressure", "rod_pressure", "leg_velocity")
    )

    def flow_slopes(row: int) -> dict[str, float]:
        """Slopes of a port's flow by state."""
        terms = {
            cap: slopes.pressure[row, ports.CAP],
            rod: slopes.pressure[row, ports.ROD],
            "supply_pressure": slopes.pressure[row, ports.HIGH],
            "return_pressure": slopes.pressure[row, ports.LOW],
        }
        for valve, suffix in enumerate(valves):
            name = f"spool{suffix}{leg_suffix}"
            terms[name] = terms.get(name, 0.0) + slopes.opening[row, valve]
        return terms

    cap_volume, rod_volume = volumes(cylinder, extension)
    for row, chamber, volume, area in (
        (ports.CAP, cap, cap_volume, cylinder.cap_area),
        (ports.ROD, rod, rod_volume, -cylinder.rod_area),
    ):
        content, slope = density(hydraulics.oil, pressures[row])
        terms = flow_slopes(row) | {speed: -content * area}
        system.add(chamber, **{state: value / (volume * slope) for state, value in terms.items()})
    return _ManifoldFlows(flow_slopes(ports.DRAWN), flow_slopes(ports.RETURNED))


def _sum_by_state(slopes: list[dict[str, float]]) -> dict[str, float]:
    states = dict.fromkeys(state for by_state in slopes for state in by_state)
    return {state: sum(by_state.get(state, 0.0) for by_state in slopes) for state in states}


def _fill_supply(
    plant: Plant, point: OperatingPoint, system: _System, flows: list[_ManifoldFlows]
) -> None:
    """Fill in manifolds, pump and accumulators, with what the legs draw and return."""
    supply, oil = plant.hydraulics.supply, plant.hydraulics.oil
    drawn = _sum_by_state([flow.drawn for flow in flows])
    returned = _sum_by_state([flow.returned for flow in flows])
    _, supply_slope = density(oil, point.supply_pressure)
    _, return_slope = density(oil, point.return_pressure)
    supply_rise = 1.0 / (supply.supply_volume * supply_slope)
    return_rise = 1.0 / (supply.return_volume * return_slope)
    system.add("supply_pressure", pump_flow=supply_rise)
    system.add("supply_pressure", **{state: -supply_rise * value for state, value in drawn.items()})
    system.add("return_pressure", return_pressure=-return_rise / supply.tank_line)
    system.add(
        "return_pressure", **{state: return_rise * value for state, value in returned.items()}
    )
    gain = supply.pump_flow / supply.pump_droop
    system.add(
        "pump_flow",
        pump_flow=-(1.0 + gain * supply.pump_line) / supply.pump_lag,
        supply_pressure=-gain / supply.pump_lag,
    )
    if "accumulator_oil" not in system.row:
        return
    _, gas_rise = gas_pressure(supply, point.accumulator_oil)
    count, line = supply.accumulators, supply.accumulator_line
    system.add(
        "supply_pressure",
        accumulator_oil=supply_rise * count * gas_rise / line,
        supply_pressure=-supply_rise * count / line,
    )
    system.add("accumulator_oil", accumulator_oil=-gas_rise / line, supply_pressure=1.0 / line)
