"""The hydraulics' documented equations, written apart from the package, for the tests."""

from collections.abc import Callable

import numpy as np

from cmf_mj.core.settings import validated
from cmf_mj.plant.cylinder import volumes
from cmf_mj.plant.events import no_faults
from cmf_mj.plant.hydraulics import (
    Hydraulics,
    HydraulicState,
    advance,
    make_hydraulics,
    rest,
    write_loads,
)
from cmf_mj.plant.oil import enthalpy
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant.supply import ACCUMULATOR, RETURN, RETURN_PRESSURE, SUPPLY, SUPPLY_PRESSURE, TANK

FRAME = 1.0 / 2048.0
MASS = 7200 * 0.45359237  # lbm in kg, exact by definition
WEIGHT = MASS * 9.80665  # lbf is the weight of a pound at standard gravity
ATMOSPHERE = 101325.0  # standard atmosphere in Pa, exact by definition
INCH = 0.0254
PSI = 0.45359237 * 9.80665 / INCH**2
GPM = 231 * INCH**3 / 60  # gallon of 231 cubic inches

EQ_4_1 = np.roots([1, 491.9, 1.481e4, 2.488e6, 4.526e7, 8.755e6, 4.32e4])
"""Poles of Eq 4.1 from its printed denominator: -471.24, -0.807 +- 70.999j, -18.85, -0.190, ..."""


def nearest(roots: np.ndarray, target: complex) -> complex:
    """The root that is closest to a number."""
    return complex(roots[np.argmin(np.abs(roots - target))])


def changed(
    source: str | HydraulicParameters, **values: float | str | tuple[float, str]
) -> HydraulicParameters:
    """A set with other numbers, in the units it has or (number, unit), or another `supply` or
    `name`; checked anew."""
    table = load_hydraulics(source).model_dump(exclude_none=True)
    for name, value in values.items():
        if isinstance(value, str):
            table[name] = value
        else:
            number, unit = value if isinstance(value, tuple) else (value, table[name]["unit"])
            table[name] |= {"value": float(number), "unit": unit}
    return validated(HydraulicParameters, table, "changed")


def areas(p: HydraulicParameters) -> tuple[float, float]:
    """(A_cap, A_rod) [m^2]."""
    bore, stem = p.bore_diameter.value * INCH, p.rod_diameter.value * INCH
    return np.pi / 4 * bore**2, np.pi / 4 * (bore**2 - stem**2)


def specific(p: HydraulicParameters, pressure: float) -> float:
    """1 / r(p), volume per content: liquid, entrained gas, gas released below the atmosphere."""
    z = pressure / (p.bulk_modulus.value * PSI)
    volume = 1 / (1 + z + z**2 / 2)
    ratio = ATMOSPHERE / (pressure + ATMOSPHERE)
    entrained = p.entrained_gas.value * {"1": 1.0, "%": 0.01}[p.entrained_gas.unit]
    volume += entrained * ratio ** (1 / p.gas_exponent.value)
    if pressure < 0:
        volume += p.cavitation_gas.value * (ratio - 1)
    return volume


def content_ratio(p: HydraulicParameters, pressure: float) -> float:
    """r(p)."""
    return 1 / specific(p, pressure)


def slope(function: Callable[[float], float], at: float, step: float) -> float:
    """Five-point central difference."""
    return (
        8 * (function(at + step) - function(at - step))
        - function(at + 2 * step)
        + function(at - 2 * step)
    ) / (12 * step)


def orifice_flow(p: HydraulicParameters, gain: float, line: float, drop: float) -> float:
    """Root q of |dp| = (q / G)^2 + (s / G + R) q, with the sign of dp; 2 s^2 is the transition."""
    if gain == 0.0:
        return 0.0
    s = np.sqrt(p.transition_pressure.value * PSI / 2)
    a, b = 1 / gain**2, s / gain + line
    return float(np.sign(drop) * (np.sqrt(b**2 + 4 * a * abs(drop)) - b) / (2 * a))


def gain_of_both(p: HydraulicParameters) -> float:
    """k [m/s/sqrt(Pa)], content flow of both valves per area: with half the supply pressure
    across a port the leg goes at leg_speed, its chamber at the pressure in the middle."""
    supply, tank = p.supply_pressure.value * PSI, p.return_pressure.value * PSI
    speed = p.leg_speed.value * INCH * 100
    root = orifice_flow(p, 1.0, 0.0, (supply - tank) / 2)
    return speed * content_ratio(p, (supply + tank) / 2) / root


def leakage(p: HydraulicParameters) -> float:
    """L of content flow L (p_cap - p_rod) [m^3/s/Pa]: a volume at mid pressure relaxes at
    leak_rate."""
    middle = (p.supply_pressure.value + p.return_pressure.value) * PSI / 2
    half, beta = p.half_stroke.value * INCH, p.bulk_modulus.value * PSI
    return p.leak_rate.value * half * sum(areas(p)) / (4 * beta) * content_ratio(p, middle)


def port_flows(
    p: HydraulicParameters,
    opening: float,
    cap: float,
    rod: float,
    x: float = 0.0,
    supply: float | None = None,
    tank: float | None = None,
) -> tuple[float, float]:
    """Content flows into (cap, rod) of both valves, open alike, cushion included."""
    high = p.supply_pressure.value * PSI if supply is None else supply
    low = p.return_pressure.value * PSI if tank is None else tank
    cap_area, rod_area = areas(p)
    k = gain_of_both(p)
    network = p.supply == "network"
    inward = p.supply_hose.value * PSI / GPM * network
    outward = p.return_hose.value * PSI / GPM * network
    length, half = p.cushion_length.value * INCH, p.half_stroke.value * INCH

    def out(gain: float, full: float, gap: float) -> float:
        """Gain of valve and cushion in series: 1/G^2 = 1/g^2 + (e / G_stop)^2."""
        if length == 0.0 or gap >= length or gain == 0.0:
            return gain
        e = min((length - gap) / length, 1.0)
        stop = p.cushion_opening.value / 100 * full
        return 1 / np.sqrt(1 / gain**2 + (e / stop) ** 2)

    e = abs(opening)
    if opening >= 0:
        into_cap = orifice_flow(p, k * cap_area * e, inward, high - cap)
        gain = out(k * rod_area * e, k * rod_area, half - x)
        return into_cap, -orifice_flow(p, gain, outward, rod - low)
    gain = out(k * cap_area * e, k * cap_area, half + x)
    return (
        -orifice_flow(p, gain, outward, cap - low),
        orifice_flow(p, k * rod_area * e, inward, high - rod),
    )


def lap(p: HydraulicParameters, position: float) -> float:
    """Opening of a spool position, less the overlap."""
    overlap = p.overlap.value * {"1": 1.0, "%": 0.01}[p.overlap.unit]
    return float(np.sign(position) * min(max(abs(position) - overlap, 0.0), 1.0))


def rates(
    p: HydraulicParameters, state: np.ndarray, command: float, x: float, v: float
) -> np.ndarray:
    """d/dt (drive, spool, p_cap, p_rod) on a constant supply, without hysteresis, written from the
    documented equations alone: d(V r(p))/dt = Q gives dp/dt = (Q - r dV/dt) / (V dr/dp)."""
    drive, spool, cap, rod = state
    cap_area, rod_area = areas(p)
    half, gap = p.half_stroke.value * INCH, p.minimum_gap.value * INCH
    tank = p.return_pressure.value * PSI
    bias = p.null_bias.value * {"1": 1.0, "%": 0.01}[p.null_bias.unit]
    leak = leakage(p) * (cap - rod)
    bearing = p.bearing_leakage.value * GPM / PSI * (rod - tank)
    cap_flow, rod_flow = port_flows(p, lap(p, spool), cap, rod, x)

    def compressed(flow: float, area: float, length: float, speed: float, pressure: float) -> float:
        grows = area * speed if length > gap else 0.0
        yielded = slope(lambda at: content_ratio(p, at), pressure, 200.0)
        fills = flow - content_ratio(p, pressure) * grows
        return fills / (area * max(length, gap) * yielded)

    return np.array(
        [
            2 * np.pi * p.drive_lag.value * (command - drive),
            2 * np.pi * p.valve_lag.value * (drive + bias - spool),
            compressed(cap_flow - leak, cap_area, half + x, v, cap),
            compressed(rod_flow + leak - bearing, rod_area, half - x, -v, rod),
        ]
    )


def machine(p: HydraulicParameters, step: float = FRAME, legs: int = 1) -> Hydraulics:
    """Compiled parameters of equal actuators."""
    return make_hydraulics(p, [f"leg_{i + 1}" for i in range(legs)], step)


def state_of(
    p: HydraulicParameters, hydraulics: Hydraulics, rows: np.ndarray, x: np.ndarray
) -> HydraulicState:
    """State from rows (drive, spool, p_cap, p_rod), both valves alike, at extensions x."""
    state = rest(hydraulics, np.zeros(len(rows)), np.asarray(x, dtype=float))
    half, gap = p.half_stroke.value * INCH, p.minimum_gap.value * INCH
    for leg, (drive, spool, cap, rod) in enumerate(rows):
        state.drive[leg], state.spool[leg] = drive, spool
        state.pressure[leg] = cap, rod
        lengths = max(half + x[leg], gap), max(half - x[leg], gap)
        for side, (area, length) in enumerate(zip(areas(p), lengths, strict=True)):
            state.content[leg, side] = area * length * content_ratio(p, (cap, rod)[side])
    return state


def rows_of(state: HydraulicState) -> np.ndarray:
    """(drive, spool, p_cap, p_rod) of the first valves, (n, 4)."""
    return np.column_stack([state.drive[:, 0], state.spool[:, 0], state.pressure])


def one_step(parameters: HydraulicParameters, step: float, z: np.ndarray) -> np.ndarray:
    """Leapfrog of one 7200 lbm leg with `advance`: z = (drive, spool, p_cap, p_rod, x, v)."""
    hydraulics = machine(parameters, step)
    load = np.empty(1)
    state = state_of(parameters, hydraulics, z[None, :4], z[4:5])
    write_loads(hydraulics.cylinder, state.pressure, state.friction, load)
    v = z[5] + step * (load[0] - WEIGHT) / MASS
    x = z[4] + step * v
    assert advance(hydraulics, state, no_faults(1), np.zeros(1), z[4:5], np.array([x]))
    return np.array([*rows_of(state)[0], x, v])


def jacobian(function, at: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Central differences, each column by its own scale."""
    columns = []
    for i, size in enumerate(scale):
        nudge = np.zeros(at.size)
        nudge[i] = size
        columns.append((function(at + nudge) - function(at - nudge)) / (2 * size))
    return np.column_stack(columns)


SCALE = np.array([1e-5, 1e-5, 1e3, 1e3, 1e-5, 1e-4])
"""Steps of the finite differences for (drive, spool, p_cap, p_rod, x, v), SI."""


def neutral(parameters: HydraulicParameters) -> np.ndarray:
    state = rest(machine(parameters), np.array([WEIGHT]), np.zeros(1))
    return np.array([*rows_of(state)[0], 0.0, 0.0])


def oil_content(hydraulics: Hydraulics, state: HydraulicState) -> float:
    """All oil there is [m^3]: chambers, manifolds, accumulators, and what the tank has gained."""
    supply = state.supply
    kept = hydraulics.supply.accumulators * supply[ACCUMULATOR]
    return float(state.content.sum() + supply[SUPPLY] + supply[RETURN] + supply[TANK] + kept)


def stored_energy(hydraulics: Hydraulics, state: HydraulicState, extension: np.ndarray) -> float:
    """Energy of compression U = C h - p V of the oil in chambers and manifolds [J].

    What the tank has received counts with the return pressure it stands under: pump and lines
    reckon from there.
    """
    oil, supply = hydraulics.oil, hydraulics.supply
    total = state.supply[TANK] * enthalpy(oil, supply.return_pressure)
    for leg in range(extension.shape[0]):
        for side, volume in enumerate(volumes(hydraulics.cylinder[leg], extension[leg])):
            pressure = state.pressure[leg, side]
            total += state.content[leg, side] * enthalpy(oil, pressure) - pressure * volume
    for content, place, volume in (
        (SUPPLY, SUPPLY_PRESSURE, supply.supply_volume),
        (RETURN, RETURN_PRESSURE, supply.return_volume),
    ):
        pressure = state.supply[place]
        total += state.supply[content] * enthalpy(oil, pressure) - pressure * volume
    return float(total)
