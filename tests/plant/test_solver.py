"""The implicit stage against scipy on random states, oil to rounding, and its hard corners."""

import numpy as np
import pytest
from hydraulic_equations import changed, content_ratio, leakage, orifice_flow
from scipy import optimize

from cmf_mj.plant.hydraulics import Hydraulics, make_hydraulics
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant.solver import Stage, make_stage, solve
from cmf_mj.plant.supply import ACCUMULATOR, PUMP, RETURN, SUPPLY, TANK, charge_supply, gas_pressure

STEP = 1.0 / 2048.0
LEGS = 3
NAMES = [f"leg_{i + 1}" for i in range(LEGS)]


def prepared(p: HydraulicParameters, rng: np.random.Generator) -> tuple[Hydraulics, Stage]:
    """A stage of random gains, volumes, known contents and supply, guesses anywhere."""
    hydraulics = make_hydraulics(p, NAMES, STEP)
    supply, stage = hydraulics.supply, make_stage(LEGS)
    high, low = rng.uniform(6e6, 1.1e7), rng.uniform(0.0, 3e5)
    for leg in range(LEGS):
        own = stage.chambers[leg]
        own.cap_in, own.cap_out, own.rod_in, own.rod_out = rng.uniform(0, 6e-6, 4) * (
            rng.uniform(size=4) < 0.5
        )
        own.cap_volume, own.rod_volume = rng.uniform(4e-4, 0.03), rng.uniform(4e-4, 0.015)
        cap, rod = rng.uniform(1e5, 1e7, 2)
        own.cap_known = own.cap_volume * content_ratio(p, cap)
        own.rod_known = own.rod_volume * content_ratio(p, rod)
        own.cap, own.rod = cap + rng.normal(0, 3e5), rod + rng.normal(0, 3e5)
    start = charge_supply(supply, hydraulics.oil)
    stage.known[:] = start[:5]
    stage.known[PUMP] = rng.uniform(0, supply.pump_flow)
    stage.known[SUPPLY] = supply.supply_volume * content_ratio(p, high)
    stage.known[RETURN] = supply.return_volume * content_ratio(p, low)
    gas, rise = gas_pressure(supply, start[ACCUMULATOR])
    node = stage.manifolds[0]
    node.high, node.low, node.gas, node.gas_rise = high, low, gas, rise
    node.gas_oil, node.running, node.bank = start[ACCUMULATOR], 1.0, 4.0
    node.burst = supply.jet * rng.choice([0.0, 6e-4])
    return hydraulics, stage


def residual(p: HydraulicParameters, stage: Stage, weight: float, x: np.ndarray) -> np.ndarray:
    """V r(p) - K - w Q of all chambers and both manifolds, from the documented equations."""
    node, out = stage.manifolds[0], np.empty(2 * LEGS + 2)
    high, low = x[-2:]
    tank = p.return_pressure.si
    inward, outward = p.supply_hose.si, p.return_hose.si
    drawn = returned = 0.0
    for leg in range(LEGS):
        own = stage.chambers[leg]
        cap, rod = x[2 * leg : 2 * leg + 2]
        cap_in = orifice_flow(p, own.cap_in, inward, high - cap)
        rod_in = orifice_flow(p, own.rod_in, inward, high - rod)
        cap_out = orifice_flow(p, own.cap_out, outward, cap - low)
        rod_out = orifice_flow(p, own.rod_out, outward, rod - low)
        leak, seep = leakage(p) * (cap - rod), p.bearing_leakage.si * (rod - low)
        out[2 * leg] = own.cap_volume * content_ratio(p, cap) - own.cap_known
        out[2 * leg] -= weight * (cap_in - cap_out - leak)
        out[2 * leg + 1] = own.rod_volume * content_ratio(p, rod) - own.rod_known
        out[2 * leg + 1] -= weight * (rod_in - rod_out + leak - seep)
        drawn += cap_in + rod_in
        returned += cap_out + rod_out + seep
    ratio = weight / p.pump_lag.si
    droop, line = p.pump_droop.si, p.pump_line.si

    def lagging(flow: float) -> float:
        asked = (p.supply_pressure.si - high - line * flow) / droop
        target = p.pump_flow.si * min(max(asked, 0.0), 1.0)
        return flow - (stage.known[PUMP] + ratio * target) / (1 + ratio)

    pump = optimize.brentq(lagging, -1.0, 1.0, xtol=1e-16, rtol=1e-14)
    # The gas follows its tangent at the oil of the step's start.
    known = stage.known[ACCUMULATOR]
    from_gas = (node.gas + node.gas_rise * (known - node.gas_oil) - high) / (
        p.accumulator_line.si + weight * node.gas_rise
    )
    relief = p.relief_conductance.si * max(high - p.relief_pressure.si, 0.0)
    burst = orifice_flow(p, node.burst, 0.0, high - tank)
    drain = (low - tank) / p.tank_line.si
    out[-2] = p.supply_volume.si * content_ratio(p, high) - stage.known[SUPPLY]
    out[-2] -= weight * (pump + node.bank * from_gas - relief - burst - drawn)
    out[-1] = p.return_volume.si * content_ratio(p, low) - stage.known[RETURN]
    out[-1] -= weight * (returned - drain)
    return out


def pressures(stage: Stage) -> np.ndarray:
    pairs = np.column_stack([stage.chambers.cap, stage.chambers.rod]).ravel()
    return np.array([*pairs, stage.manifolds[0].high, stage.manifolds[0].low])


def total(hydraulics: Hydraulics, stage: Stage, node: np.ndarray, side: str) -> float:
    """All oil of a stage: chambers, manifolds, accumulators, tank."""
    chambers = stage.chambers[f"cap_{side}"].sum() + stage.chambers[f"rod_{side}"].sum()
    bank = stage.manifolds[0].bank
    return float(chambers + node[SUPPLY] + node[RETURN] + node[TANK] + bank * node[ACCUMULATOR])


@pytest.mark.parametrize("name", ["hardware", "lossy"])
@pytest.mark.parametrize("seed", range(12))
def test_pressures_are_those_that_scipy_finds(name: str, seed: int) -> None:
    """scipy.optimize.root on equations written apart, from the same guess, within 1 Pa."""
    rng = np.random.default_rng(seed)
    p = load_hydraulics(name)
    hydraulics, stage = prepared(p, rng)
    weight = STEP * rng.uniform(0.2, 1.0)
    guess = pressures(stage)
    arguments = hydraulics.cylinder, hydraulics.oil, hydraulics.supply, hydraulics.laminar
    assert 0 < solve(*arguments, stage, weight) < 30
    found = pressures(stage)

    def scaled(x: np.ndarray) -> np.ndarray:
        return residual(p, stage, weight, x * 1e6) * 1e3

    exact = optimize.root(scaled, guess / 1e6, method="hybr", tol=1e-13).x * 1e6
    if np.abs(scaled(exact / 1e6)).max() > 1e-9:  # started far off: go on from ours
        exact = optimize.root(scaled, found / 1e6, method="hybr", tol=1e-13).x * 1e6
    assert np.abs(scaled(exact / 1e6)).max() < 1e-9
    np.testing.assert_allclose(found, exact, rtol=0, atol=1.0)


@pytest.mark.parametrize("supply", ["constant", "network"])
@pytest.mark.parametrize("seed", range(6))
def test_a_stage_makes_and_loses_no_oil(supply: str, seed: int) -> None:
    """1e-15 of all oil, 0.9 m^3: rounding of the sum."""
    p = changed("lossy", supply=supply)
    hydraulics, stage = prepared(p, np.random.default_rng(seed))
    if supply == "constant":
        stage.manifolds[0].high, stage.manifolds[0].low = p.supply_pressure.si, 0.0
        stage.node[:] = stage.known
    before = total(hydraulics, stage, stage.known, "known")
    arguments = hydraulics.cylinder, hydraulics.oil, hydraulics.supply, hydraulics.laminar
    assert solve(*arguments, stage, STEP) > 0
    after = total(hydraulics, stage, stage.node, "content")
    assert after == pytest.approx(before, rel=2e-15)
    assert stage.node[TANK] != stage.known[TANK]


def solved(p: HydraulicParameters, **chamber: float) -> tuple[int, Stage]:
    """Iterations of a stage on a constant supply whose chambers are set by hand."""
    hydraulics = make_hydraulics(p, ["leg"], STEP)
    stage = make_stage(1)
    for name, value in chamber.items():
        stage.chambers[0][name] = value
    stage.manifolds[0].high = p.supply_pressure.si
    arguments = hydraulics.cylinder, hydraulics.oil, hydraulics.supply, hydraulics.laminar
    return solve(*arguments, stage, STEP), stage


@pytest.mark.parametrize("size", [1e-9, 1e-6, 6e-6])
@pytest.mark.parametrize("offset", [-1e5, -1e3, -1.0, 0.0, 1e-3, 10.0, 1e5])
@pytest.mark.parametrize("volume", [4e-5, 0.015])
def test_converges_around_zero_drop(size: float, offset: float, volume: float) -> None:
    """The chamber stands `offset` off the supply, the valve is open: Newton on a square root."""
    p = changed("hardware", supply="constant", leak_rate=0.0)
    high = p.supply_pressure.si
    iterations, stage = solved(
        p,
        cap_in=size,
        cap_volume=volume,
        rod_volume=volume,
        cap_known=volume * content_ratio(p, high + offset),
        rod_known=volume,
        cap=high + 3e5,
    )
    assert 0 < iterations < 20
    found = stage.chambers[0].cap
    assert min(0.0, offset) - 1.0 <= found - high <= max(0.0, offset) + 1.0


@pytest.mark.parametrize("name", ["hardware", "lossy"])
@pytest.mark.parametrize("share", [0.3, 0.9, 0.999, 1.0, 1.001, 1.02])
@pytest.mark.parametrize("guess", [-101324.9, -5e4, 0.0, 1e7])
def test_converges_at_vacuum(name: str, share: float, guess: float) -> None:
    """A closed chamber holding `share` of its volume, from any guess: content fixes pressure."""
    p = changed(name, supply="constant", leak_rate=0.0, bearing_leakage=0.0)
    iterations, stage = solved(
        p, cap_volume=0.01, rod_volume=0.01, cap_known=0.01 * share, rod_known=0.01, cap=guess
    )
    assert iterations > 0
    pressure = stage.chambers[0].cap
    assert pressure > -101325.0
    assert content_ratio(p, pressure) == pytest.approx(share, rel=1e-6)


@pytest.mark.parametrize("start", [0.0, 2e6, 1e7, 3e7])
def test_converges_with_both_valves_opposed(start: float) -> None:
    """One valve full out, one full in: both chambers join supply and return through equal ports
    and stand at half the supply pressure once they have filled."""
    p = changed("hardware", supply="constant", leak_rate=0.0)
    middle, cap = 0.5 * p.supply_pressure.si, start
    for _ in range(4000):
        iterations, stage = solved(
            p,
            cap_in=3e-6,
            cap_out=3e-6,
            rod_in=1.5e-6,
            rod_out=1.5e-6,
            cap_volume=1e-3,
            rod_volume=1e-3,
            cap_known=1e-3 * content_ratio(p, cap),
            rod_known=1e-3 * content_ratio(p, cap),
            cap=cap,
            rod=cap,
        )
        assert 0 < iterations < 20
        cap = stage.chambers[0].cap
    assert cap == pytest.approx(middle, rel=1e-5)
