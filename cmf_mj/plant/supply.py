"""Hydraulic supply: pump, accumulators, relief, two manifolds and the lines between them.

The plumbing as an electrical circuit (section 2.4.2): pressures at nodes, flows Q through laminar
lines (Ohm) that add to nothing at a node (Kirchhoff), oil stored by compression (capacitance).

    tank -> pump -R-> supply manifold -hose-> actuators -hose-> return manifold -R-> tank
                       |   |   |
             accumulators  |   burst hose -> tank
                        relief -> tank

Pump, pressure-compensated, largest flow Qm, set pressure Ps, droop w, lag T, line Rp:

    T dQ/dt = Qm clip((Ps - P_pump) / w, 0, 1) - Q,    P_pump = P_supply + Rp Q

Accumulators, m of them, gas volume V at the precharge pressure pc, oil v in each, line Ra:

    dv/dt = -q,    q = (p_gas - P_supply) / Ra,    p_gas + pa = (pc + pa) (V / (V - v))^n

An empty one gives nothing. A `constant` supply holds the pressure of both manifolds.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.arrays import compiled_params
from cmf_mj.core.compiled import compiled
from cmf_mj.plant.oil import ATMOSPHERE, Oil, density
from cmf_mj.plant.parameters import HydraulicParameters

SUPPLY, RETURN, ACCUMULATOR, PUMP, TANK, ISOLATION, SUPPLY_PRESSURE, RETURN_PRESSURE, GAS = range(9)
"""State of the supply: contents of both manifolds, oil in one accumulator [m^3], pump flow
[m^3/s], what the tank has received [m^3], how far an emergency stop has closed the actuators off
(0 to 1), pressures of both manifolds and of the accumulators' gas [Pa]."""

INTEGRATED = 5  #: Length of the part, the first, that is integrated with the chambers.


class Supply(NamedTuple):
    """Compiled parameters of the supply."""

    constant: bool  #: Whether both manifolds hold their pressure.
    pressure: float  #: Ps [Pa], gauge.
    return_pressure: float  #: Pt [Pa], gauge.
    pump_flow: float  #: Qm [m^3/s].
    pump_droop: float  #: w [Pa].
    pump_lag: float  #: T [s].
    pump_line: float  #: Rp [Pa s/m^3].
    relief_pressure: float  #: Pressure at which the relief opens [Pa].
    relief_conductance: float  #: Its slope [m^3/s/Pa].
    accumulators: float  #: m.
    gas_volume: float  #: V [m^3].
    precharge: float  #: pc [Pa], gauge.
    exponent: float  #: n.
    accumulator_line: float  #: Ra [Pa s/m^3].
    supply_volume: float  #: Oil volume of the supply manifold [m^3].
    return_volume: float  #: Oil volume of the return manifold [m^3].
    tank_line: float  #: Resistance from the return manifold to the tank [Pa s/m^3].
    isolation_rate: float  #: Travel of the isolation valve [1/s].
    jet: float  #: Flow per hole area and sqrt(pressure) of a burst hose, 0.7 sqrt(2 / density).


def make_supply(parameters: HydraulicParameters) -> Supply:
    """Derive the supply from a parameter set."""
    return compiled_params(
        Supply,
        parameters,
        constant=parameters.supply == "constant",
        pressure=parameters.supply_pressure,
        accumulators=parameters.accumulator_count,
        gas_volume=parameters.accumulator_volume,
        precharge=parameters.precharge_pressure,
        exponent=parameters.accumulator_exponent,
        isolation_rate=1.0 / parameters.isolation_time.si,
        jet=0.7 * float(np.sqrt(2.0 / parameters.oil_density.si)),
    )


def charge_supply(supply: Supply, oil: Oil) -> NDArray[np.float64]:
    """State (9,) at rest: accumulators charged to the set pressure, no flow."""
    state = np.zeros(GAS + 1)
    ratio = (supply.precharge + ATMOSPHERE) / (supply.pressure + ATMOSPHERE)
    state[ACCUMULATOR] = supply.gas_volume * (1.0 - ratio ** (1.0 / supply.exponent))
    state[GAS] = supply.pressure
    state[SUPPLY_PRESSURE] = supply.pressure
    state[RETURN_PRESSURE] = supply.return_pressure
    state[SUPPLY] = supply.supply_volume * density(oil, supply.pressure)[0]
    state[RETURN] = supply.return_volume * density(oil, supply.return_pressure)[0]
    return state


@compiled
def gas_pressure(supply, oil_volume):  # type: ignore[no-untyped-def]
    """Gauge pressure of an accumulator's gas [Pa] and its rise per oil volume [Pa/m^3]."""
    gas_volume = supply.gas_volume - oil_volume
    ratio = supply.gas_volume / gas_volume
    absolute = (supply.precharge + ATMOSPHERE) * ratio**supply.exponent
    return absolute - ATMOSPHERE, supply.exponent * absolute / gas_volume


@compiled
def accumulator_flow(supply, manifolds, known_oil, pressure, weight):  # type: ignore[no-untyped-def]
    """Flow out of one accumulator [m^3/s] over an implicit stage, and its slope with the pressure.

    `manifolds` has the gas at the start of the step; the stage of weight [s] sets out from the oil
    volume `known_oil` [m^3]. `pressure` is that of the supply manifold [Pa].
    """
    resistance = supply.accumulator_line + weight * manifolds.gas_rise
    gas = manifolds.gas + manifolds.gas_rise * (known_oil - manifolds.gas_oil)
    flow = (gas - pressure) / resistance
    if known_oil - weight * flow <= 0.0:
        return known_oil / weight, 0.0
    return flow, -1.0 / resistance


@compiled
def pump_flow(supply, is_running, known_flow, pressure, weight):  # type: ignore[no-untyped-def]
    """Flow of the pump [m^3/s] at the end of an implicit stage from `known_flow`.

    With its slope with the manifold's pressure; never negative, there is a check valve.
    """
    lag_ratio = weight / supply.pump_lag
    gain = supply.pump_flow / supply.pump_droop
    flow = (known_flow + lag_ratio * gain * (supply.pressure - pressure)) / (
        1.0 + lag_ratio * (1.0 + gain * supply.pump_line)
    )
    demand = (supply.pressure - pressure - supply.pump_line * flow) / supply.pump_droop
    if is_running and 0.0 < demand < 1.0:
        return flow, -lag_ratio * gain / (1.0 + lag_ratio * (1.0 + gain * supply.pump_line))
    target = supply.pump_flow if is_running and demand >= 1.0 else 0.0
    return max((known_flow + lag_ratio * target) / (1.0 + lag_ratio), 0.0), 0.0
