"""One implicit stage of all chambers and both manifolds at once.

Unknown are the pressures p of the 2n chambers and P of supply and return manifold. With the known
contents K, volumes V, the weight w of the stage and the flows Q into each volume,

    V r(p) - K - w Q(p, P) = 0

is solved by Newton's method with the exact Jacobian. Actuators meet at the manifolds only, so the
Jacobian is an arrow: every actuator is eliminated by its 2 by 2 block, the manifolds remain as
one more 2 by 2 system. It is symmetric, a network of conductances.

The content that goes on is the linearised one, V (r + r' dp), for which the last linear system
balances the flows of all volumes to rounding: no oil is made or lost, however the iteration ends.

The orifice's square root would send Newton's method back and forth across zero drop; a step that
crosses it stops there. Pressures stay above vacuum where gas fills a torn chamber.
"""

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.arrays import record_array
from cmf_mj.core.compiled import compiled, inlined
from cmf_mj.plant.oil import density, enthalpy, least_pressure
from cmf_mj.plant.supply import ACCUMULATOR, PUMP, RETURN, SUPPLY, TANK, accumulator_flow, pump_flow
from cmf_mj.plant.valve import orifice

POWERS = ("pump", "accumulators", "valves", "lines", "leakage", "relief", "burst")
"""Powers of a stage [W]: delivered by pump and accumulators, lost in the others."""

_Columns = namedtuple("_Columns", POWERS)  # type: ignore[misc]
_POWER: Any = _Columns(*range(len(POWERS)))  #: Columns of the powers by name.

_TOLERANCE = 20.0
"""Last Newton change accepted [Pa]; convergence is quadratic, the error left is far below 1 Pa. In
a torn chamber, where gas makes a Pascal mean much content, that content counts, as compression of
oil."""
_ITERATIONS = 60


class Chambers(NamedTuple):
    """Workspace of one actuator; contents and volumes [m^3], pressures [Pa]."""

    cap_in: float  #: Flow gain from the supply into the cap chamber [m^3/s/sqrt(Pa)].
    cap_out: float  #: From the cap chamber to the return.
    rod_in: float  #: From the supply into the rod chamber.
    rod_out: float  #: From the rod chamber to the return.
    cap_volume: float  #: V.
    rod_volume: float  #: V.
    cap_known: float  #: K.
    rod_known: float  #: K.
    cap_change: float  #: Change of the pressure over the last step.
    rod_change: float  #: The same.
    cap: float  #: Pressure, guess and result.
    rod: float  #: The same.
    cap_content: float  #: Result.
    rod_content: float  #: Result.
    cap_yield: float  #: Slope of the content with pressure.
    rod_yield: float  #: The same.
    cap_alone: float  #: Newton change with the manifolds fixed.
    rod_alone: float  #: The same.
    cap_enters: float  #: Flow from the supply [m^3/s].
    cap_in_slope: float  #: Its slope with the drop.
    cap_leaves: float  #: Flow to the return.
    cap_out_slope: float  #: Its slope.
    rod_enters: float  #: The same of the rod chamber.
    rod_in_slope: float  #: The same.
    rod_leaves: float  #: The same.
    rod_out_slope: float  #: The same.
    cap_high: float  #: Newton change per change of the supply manifold.
    rod_high: float  #: The same.
    cap_low: float  #: Newton change per change of the return manifold.
    rod_low: float  #: The same.


class Manifolds(NamedTuple):
    """Workspace of the supply, one row."""

    high: float  #: Pressure of the supply manifold, guess and result [Pa].
    low: float  #: Pressure of the return manifold, guess and result [Pa].
    gas: float  #: Gas pressure at the start of the step [Pa].
    gas_rise: float  #: Its slope with the oil in an accumulator [Pa/m^3].
    gas_oil: float  #: Oil in an accumulator at the start of the step [m^3].
    running: float  #: Whether the pump runs.
    bank: float  #: Accumulators in service.
    burst: float  #: Gain of the burst hose [m^3/s/sqrt(Pa)].
    inflow: float  #: Flow from the supply manifold into all actuators [m^3/s].
    outflow: float  #: Flow from all actuators into the return manifold [m^3/s].
    high_high: float  #: Jacobian of the supply manifold with the actuators eliminated.
    low_low: float  #: The same of the return manifold.
    high_low: float  #: Coupling of the two by the actuators.
    high_shift: float  #: What the Newton changes of the actuators alone take from the supply [m^3].
    low_shift: float  #: What they bring to the return [m^3].
    rise: float  #: Newton change of the supply manifold [Pa].
    fall: float  #: Newton change of the return manifold [Pa].


class Stage(NamedTuple):
    """Workspace of a step."""

    chambers: np.recarray  #: (n,) of `Chambers`.
    manifolds: np.recarray  #: (1,) of `Manifolds`.
    known: NDArray[np.float64]  #: K of supply, return, accumulator, pump flow and tank, (5,).
    node: NDArray[np.float64]  #: Result of the same, (5,).
    power: NDArray[np.float64]  #: Powers of the stage, see `POWERS`.
    energy: NDArray[np.float64]  #: Energies at the start of the step.


def make_stage(actuators: int) -> Stage:
    """An empty workspace."""
    return Stage(
        record_array(Chambers, [(0.0,) * len(Chambers._fields)] * actuators),
        record_array(Manifolds, [(0.0,) * len(Manifolds._fields)]),
        np.zeros(5),
        np.zeros(5),
        np.zeros(len(POWERS)),
        np.zeros(len(POWERS) + 2),
    )


@compiled
def _flow(gain, hose, laminar, drop):  # type: ignore[no-untyped-def]
    """Flow through an orifice behind a hose, and its slope."""
    if gain == 0.0:
        return 0.0, 0.0
    ratio, slope = orifice(drop, laminar + hose * gain)
    return gain * ratio, gain * slope


@compiled
def _bounded(pressure, change, inward, high, outward, low, lowest, linear_drop):  # type: ignore[no-untyped-def]
    """A pressure after a Newton change, cut short where a drop would change sign, or at vacuum.

    Flow gains `inward` from the supply and `outward` to the return are 0 if shut; below the drop
    `linear_drop` an orifice is as good as linear. All pressures in Pa, `lowest` the lower bound.
    """
    following = pressure + change
    if abs(change) > linear_drop:
        if outward > 0.0 and (pressure - low) * (following - low) < 0.0:
            following = low
        if inward > 0.0 and (pressure - high) * (following - high) < 0.0:
            following = high
    return max(following, lowest)


@inlined
def _eliminate_actuators(cylinders, oil, supply, laminar, stage, weight):  # type: ignore[no-untyped-def]
    """Solve every actuator's block for fixed manifolds; write what all bring to the manifolds."""
    manifolds, power = stage.manifolds[0], stage.power
    high, low = manifolds.high, manifolds.low
    for leg in range(stage.chambers.shape[0]):
        # In a loop of its own, the roots of all actuators are taken side by side.
        pair, cylinder = stage.chambers[leg], cylinders[leg]
        cap, rod = pair.cap, pair.rod
        rod_supply, rod_return = cylinder.supply_hose, cylinder.return_hose
        cap_supply = rod_supply + cylinder.cap_throttle
        cap_return = rod_return + cylinder.cap_throttle
        pair.cap_enters, pair.cap_in_slope = _flow(pair.cap_in, cap_supply, laminar, high - cap)
        pair.cap_leaves, pair.cap_out_slope = _flow(pair.cap_out, cap_return, laminar, cap - low)
        pair.rod_enters, pair.rod_in_slope = _flow(pair.rod_in, rod_supply, laminar, high - rod)
        pair.rod_leaves, pair.rod_out_slope = _flow(pair.rod_out, rod_return, laminar, rod - low)
    h_high, h_low = enthalpy(oil, high), enthalpy(oil, low)
    inflow, outflow, high_shift, low_shift = 0.0, 0.0, 0.0, 0.0
    high_high, low_low, high_low = 0.0, 0.0, 0.0
    flow_loss, hose_loss, leak_loss = 0.0, 0.0, 0.0
    for leg in range(stage.chambers.shape[0]):
        pair, cylinder = stage.chambers[leg], cylinders[leg]
        cap, rod = pair.cap, pair.rod
        leak, bearing = cylinder.leakage, cylinder.bearing_leakage
        cap_in, cap_out = pair.cap_enters, pair.cap_leaves
        rod_in, rod_out = pair.rod_enters, pair.rod_leaves
        piston_flow = leak * (cap - rod)
        bearing_flow = bearing * (rod - low)
        cap_density, cap_slope = density(oil, cap)
        rod_density, rod_slope = density(oil, rod)
        pair.cap_content = pair.cap_volume * cap_density
        pair.cap_yield = pair.cap_volume * cap_slope
        pair.rod_content = pair.rod_volume * rod_density
        pair.rod_yield = pair.rod_volume * rod_slope
        cap_flow = cap_in - cap_out - piston_flow
        rod_flow = rod_in - rod_out - bearing_flow + piston_flow
        cap_residual = pair.cap_content - pair.cap_known - weight * cap_flow
        rod_residual = pair.rod_content - pair.rod_known - weight * rod_flow
        # The actuator's block and what ties it to the manifolds.
        high_cap, high_rod = weight * pair.cap_in_slope, weight * pair.rod_in_slope
        low_cap, low_rod = weight * pair.cap_out_slope, weight * (pair.rod_out_slope + bearing)
        coupling = weight * leak
        cap_diagonal = pair.cap_yield + high_cap + low_cap + coupling
        rod_diagonal = pair.rod_yield + high_rod + low_rod + coupling
        inverse = 1.0 / (cap_diagonal * rod_diagonal - coupling * coupling)
        pair.cap_alone = -inverse * (rod_diagonal * cap_residual + coupling * rod_residual)
        pair.rod_alone = -inverse * (coupling * cap_residual + cap_diagonal * rod_residual)
        if not supply.constant:
            pair.cap_high = inverse * (rod_diagonal * high_cap + coupling * high_rod)
            pair.rod_high = inverse * (coupling * high_cap + cap_diagonal * high_rod)
            pair.cap_low = inverse * (rod_diagonal * low_cap + coupling * low_rod)
            pair.rod_low = inverse * (coupling * low_cap + cap_diagonal * low_rod)
            high_high += high_cap * (1.0 - pair.cap_high) + high_rod * (1.0 - pair.rod_high)
            low_low += low_cap * (1.0 - pair.cap_low) + low_rod * (1.0 - pair.rod_low)
            high_low += high_cap * pair.cap_low + high_rod * pair.rod_low
        high_shift += high_cap * pair.cap_alone + high_rod * pair.rod_alone
        low_shift += low_cap * pair.cap_alone + low_rod * pair.rod_alone
        inflow += cap_in + rod_in
        outflow += cap_out + rod_out + bearing_flow
        h_cap, h_rod = enthalpy(oil, cap), enthalpy(oil, rod)
        inflow_loss = cap_in * (h_high - h_cap) + rod_in * (h_high - h_rod)
        flow_loss += inflow_loss + cap_out * (h_cap - h_low) + rod_out * (h_rod - h_low)
        hose_loss += cylinder.supply_hose * (cap_in * cap_in + rod_in * rod_in)
        hose_loss += cylinder.return_hose * (cap_out * cap_out + rod_out * rod_out)
        hose_loss += cylinder.cap_throttle * (cap_in * cap_in + cap_out * cap_out)
        leak_loss += piston_flow * (h_cap - h_rod) + bearing_flow * (h_rod - h_low)
    manifolds.inflow, manifolds.outflow = inflow, outflow
    manifolds.high_high, manifolds.low_low, manifolds.high_low = high_high, low_low, high_low
    manifolds.high_shift, manifolds.low_shift = high_shift, low_shift
    power[_POWER.valves], power[_POWER.lines] = flow_loss - hose_loss, hose_loss
    power[_POWER.leakage] = leak_loss


@inlined
def _solve_manifolds(oil, supply, laminar, stage, weight):  # type: ignore[no-untyped-def]
    """Change the pressures of both manifolds; the largest change, as compression of oil [Pa]."""
    node, known, power, manifolds = stage.node, stage.known, stage.power, stage.manifolds[0]
    high, low, tank = manifolds.high, manifolds.low, supply.return_pressure
    lowest = least_pressure(oil)
    pump, pump_slope = pump_flow(supply, manifolds.running > 0.0, known[PUMP], high, weight)
    discharge, discharge_slope = accumulator_flow(
        supply, manifolds, known[ACCUMULATOR], high, weight
    )
    bank = manifolds.bank
    excess = high - supply.relief_pressure
    relief = supply.relief_conductance * max(excess, 0.0)
    relief_slope = supply.relief_conductance if excess > 0.0 else 0.0
    burst, burst_slope = _flow(manifolds.burst, 0.0, laminar, high - tank)
    drain = (low - tank) / supply.tank_line
    high_density, high_slope = density(oil, high)
    low_density, low_slope = density(oil, low)
    high_flow = pump + bank * discharge - relief - burst - manifolds.inflow
    high_residual = supply.supply_volume * high_density - known[SUPPLY] - weight * high_flow
    low_flow = manifolds.outflow - drain
    low_residual = supply.return_volume * low_density - known[RETURN] - weight * low_flow
    slopes = relief_slope + burst_slope - pump_slope - bank * discharge_slope
    high_high = manifolds.high_high + (supply.supply_volume * high_slope + weight * slopes)
    low_slope_sum = supply.return_volume * low_slope + weight / supply.tank_line
    low_low, high_low = manifolds.low_low + low_slope_sum, manifolds.high_low
    high_residual -= manifolds.high_shift
    low_residual -= manifolds.low_shift
    inverse = 1.0 / (high_high * low_low - high_low * high_low)
    rise = -inverse * (low_low * high_residual + high_low * low_residual)
    fall = -inverse * (high_low * high_residual + high_high * low_residual)
    node[SUPPLY] = supply.supply_volume * (high_density + high_slope * rise)
    node[RETURN] = supply.return_volume * (low_density + low_slope * fall)
    discharge += discharge_slope * rise
    pump += pump_slope * rise
    relief += relief_slope * rise
    burst += burst_slope * rise
    drain += fall / supply.tank_line
    node[ACCUMULATOR] = known[ACCUMULATOR] - weight * discharge
    node[PUMP] = pump
    node[TANK] = known[TANK] + weight * (drain + relief + burst - pump)
    manifolds.rise, manifolds.fall = rise, fall
    manifolds.high = max(high + rise, lowest)
    manifolds.low = max(low + fall, lowest)
    h_high, h_low, h_tank = enthalpy(oil, high), enthalpy(oil, low), enthalpy(oil, tank)
    h_pump = enthalpy(oil, high + supply.pump_line * pump)
    h_gas = enthalpy(oil, high + supply.accumulator_line * discharge)
    power[_POWER.pump] = pump * (h_pump - h_tank)
    power[_POWER.accumulators] = bank * discharge * h_gas
    power[_POWER.lines] += pump * (h_pump - h_high) + bank * discharge * (h_gas - h_high)
    power[_POWER.lines] += drain * (h_low - h_tank)
    power[_POWER.relief] = relief * (h_high - h_tank)
    power[_POWER.burst] = burst * (h_high - h_tank)
    high_stretch = max(1.0, high_slope * oil.bulk_modulus)
    return max(abs(rise) * high_stretch, abs(fall) * max(1.0, low_slope * oil.bulk_modulus))


@inlined
def _change_chambers(oil, laminar, stage, high, low):  # type: ignore[no-untyped-def]
    """Change the pressures of all chambers; the largest change, as compression of oil [Pa].

    `high` and `low` are the pressures of the manifolds before their change.
    """
    lowest, linear_drop, largest = least_pressure(oil), laminar * laminar, 0.0
    rise, fall = stage.manifolds[0].rise, stage.manifolds[0].fall
    for leg in range(stage.chambers.shape[0]):
        pair = stage.chambers[leg]
        cap_change = pair.cap_alone + rise * pair.cap_high + fall * pair.cap_low
        rod_change = pair.rod_alone + rise * pair.rod_high + fall * pair.rod_low
        pair.cap_content += pair.cap_yield * cap_change
        pair.rod_content += pair.rod_yield * rod_change
        cap_stretch = max(1.0, pair.cap_yield * oil.bulk_modulus / pair.cap_volume)
        rod_stretch = max(1.0, pair.rod_yield * oil.bulk_modulus / pair.rod_volume)
        largest = max(largest, abs(cap_change) * cap_stretch, abs(rod_change) * rod_stretch)
        pair.cap = _bounded(
            pair.cap, cap_change, pair.cap_in, high, pair.cap_out, low, lowest, linear_drop
        )
        pair.rod = _bounded(
            pair.rod, rod_change, pair.rod_in, high, pair.rod_out, low, lowest, linear_drop
        )
    return largest


@compiled
def solve(cylinders, oil, supply, laminar, stage, weight):  # type: ignore[no-untyped-def]
    """Solve a stage of weight w [s] in place; the number of iterations, -1 if not converged.

    Gains, volumes, known contents and guesses go in; pressures, contents and powers come out.
    `laminar` is s of the orifices [sqrt(Pa)].
    """
    chambers, manifolds, lowest = stage.chambers, stage.manifolds[0], least_pressure(oil)
    for leg in range(chambers.shape[0]):
        chambers[leg].cap = max(chambers[leg].cap, lowest)
        chambers[leg].rod = max(chambers[leg].rod, lowest)
    for iteration in range(_ITERATIONS):
        high, low, manifold_change = manifolds.high, manifolds.low, 0.0
        _eliminate_actuators(cylinders, oil, supply, laminar, stage, weight)
        if supply.constant:
            drop = enthalpy(oil, high) - enthalpy(oil, low)
            stage.power[_POWER.pump] = manifolds.inflow * drop
            tank_content = stage.known[TANK] + weight * (manifolds.outflow - manifolds.inflow)
            stage.node[TANK] = tank_content + manifolds.low_shift + manifolds.high_shift
            manifolds.rise, manifolds.fall = 0.0, 0.0
        else:
            manifold_change = _solve_manifolds(oil, supply, laminar, stage, weight)
        chamber_change = _change_chambers(oil, laminar, stage, high, low)
        if max(manifold_change, chamber_change) < _TOLERANCE:
            return iteration + 1
    return -1
