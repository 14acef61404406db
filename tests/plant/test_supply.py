"""Supply: pump, accumulators, relief, manifolds and lines against closed forms."""

from functools import cache

import numpy as np
import pytest
from hydraulic_equations import (
    ATMOSPHERE,
    FRAME,
    GPM,
    PSI,
    areas,
    changed,
    content_ratio,
    machine,
    orifice_flow,
)
from scipy import integrate

from cmf_mj import Record, SingleLegs
from cmf_mj.facility.simulate import drive
from cmf_mj.plant.cylinder import make_cylinders
from cmf_mj.plant.events import no_faults
from cmf_mj.plant.hydraulics import advance, rest
from cmf_mj.plant.oil import make_oil
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.plant.supply import (
    ACCUMULATOR,
    PUMP,
    RETURN_PRESSURE,
    SUPPLY,
    SUPPLY_PRESSURE,
    charge_supply,
    gas_pressure,
    make_supply,
    pump_flow,
)

P = load_hydraulics("hardware")


@cache
def stroke() -> Record:
    """Six legs from 33 in below neutral out at full command for 1.5 s, then 6 s at rest."""
    commands = np.zeros((round(7.5 * 2048), 6))
    commands[200 : 200 + round(1.5 * 2048)] = 1.0
    plant = SingleLegs("hardware")
    return drive(plant, commands, start=np.array([0.0, 0.0, 0.55, 0.0, 0.0, 0.0]))


# Pump


@pytest.mark.parametrize("share", [-0.5, 0.0, 0.3, 0.8, 1.0, 1.7])
def test_pump_droops_from_full_flow_to_none(share: float) -> None:
    """At rest Q = Qm clip((Ps - P - Rp Q) / w, 0, 1): closed form Q = (Ps - P) / (w / Qm + Rp)."""
    supply = make_supply(P)
    pressure = 1500 * PSI - share * 50 * PSI
    flow = 0.0
    for _ in range(4000):
        flow, _ = pump_flow(supply, True, flow, pressure, 1e-3)
    expected = (1500 * PSI - pressure) / (50 * PSI / (400 * GPM) + 0.025 * PSI / GPM)
    assert flow == pytest.approx(min(max(expected, 0.0), 400 * GPM), abs=1e-9)


def test_pump_lags_the_pressure() -> None:
    """First-order: towards full flow with 0.05 s, where the compensator is wide open."""
    supply = make_supply(P)
    flow = 0.0
    for _ in range(1000):
        flow, _ = pump_flow(supply, True, flow, 1000 * PSI, 0.05 / 1000)
    assert flow == pytest.approx(400 * GPM * (1 - np.exp(-1)), rel=1e-3)
    for _ in range(1000):
        flow, _ = pump_flow(supply, False, flow, 1000 * PSI, 0.05 / 1000)
    assert flow == pytest.approx(400 * GPM * (1 - np.exp(-1)) * np.exp(-1), rel=1e-3)


# Accumulators


def test_gas_is_polytropic() -> None:
    """(p + pa) V^n constant from precharge; charged to the set pressure at the start."""
    supply = make_supply(P)
    for oil in (0.0, 0.02, 0.1):
        pressure, rise = gas_pressure(supply, oil)
        left = 50 * 231 * 0.0254**3 - oil
        expected = (1000 * PSI + ATMOSPHERE) * (50 * 231 * 0.0254**3 / left) ** 1.4 - ATMOSPHERE
        assert pressure == pytest.approx(expected, rel=1e-12)
        more = gas_pressure(supply, oil + 1e-6)[0] - gas_pressure(supply, oil - 1e-6)[0]
        assert rise == pytest.approx(more / 2e-6, rel=1e-6)
    start = charge_supply(supply, make_oil(P))
    assert gas_pressure(supply, start[ACCUMULATOR])[0] == pytest.approx(1500 * PSI, rel=1e-12)


def test_recorded_gas_pressure_is_that_of_the_recorded_oil() -> None:
    """The record's gas pressure is that of the step before: the largest change a step is left."""
    record = stroke()
    supply = make_supply(P)
    expected = np.array([gas_pressure(supply, oil)[0] for oil in record["accumulator_oil"]])
    found = record["accumulator_pressure"]
    np.testing.assert_allclose(found[1:], expected[:-1], rtol=1e-9)
    assert expected.min() < 1350 * PSI


def test_flow_of_the_accumulators_is_ohms_law() -> None:
    """-dv/dt = (p_gas - P) / Ra: oil over the stroke against the integral of the pressures. 1 %."""
    record = stroke()
    dt = record.time[1]
    drop = record["accumulator_pressure"] - record["supply_pressure"]
    flow = drop / P.accumulator_line.si
    given = integrate.cumulative_trapezoid(flow, dx=dt, initial=0.0)
    oil = record["accumulator_oil"]
    fallen = oil[0] - oil
    peak = int(np.argmax(fallen))
    assert given[peak] == pytest.approx(fallen[peak], rel=1e-2)
    assert fallen[peak] > 0.005


# Network


def test_flows_add_up_at_the_supply_manifold() -> None:
    """Kirchhoff: what is stored = pump + accumulators - what the legs draw, over the stroke. The
    legs draw what their cap chambers gain, extending, but for the piston's leakage."""
    record = stroke()
    dt = record.time[1]
    area, _ = areas(P)
    window = slice(300, 300 + 2048)
    ratio = np.vectorize(lambda q: content_ratio(P, q))(record["cap_pressure"][window])
    content = (area * (P.half_stroke.si + record["leg_extension"][window]) * ratio).sum(axis=1)
    leakage = make_cylinders(P, ["leg"])[0].leakage
    drop = (record["cap_pressure"] - record["rod_pressure"])[window].sum(axis=1)
    leaked = leakage * integrate.trapezoid(drop, dx=dt)
    drawn = content[-1] - content[0] + leaked
    pumped = integrate.trapezoid(record["pump_flow"][window], dx=dt)
    given = P.accumulator_count.value * -np.diff(record["accumulator_oil"][window][[0, -1]])[0]
    stored = np.diff(record["supply_content"][window][[0, -1]])[0]
    assert pumped + given - stored == pytest.approx(drawn, rel=1e-4)
    assert drawn > 0.05


def test_sustained_flow_is_what_the_pump_gives() -> None:
    """Empty accumulators: a burst-free manifold drained by open legs settles where the pump's full
    400 gpm goes through; here a laminar leak from supply to return of known size stands in for
    them: both valves of a held leg opposed. Pressure falls to what 400 gpm drives."""
    hydraulics = machine(changed(P, accumulator_volume=0.05, leak_rate=0.0), legs=6)
    here = np.zeros(6)
    state = rest(hydraulics, here, here)
    faults = no_faults(6)
    faults.valve[:] = 1.0
    faults.spool[:] = [1.0, -1.0]
    for _ in range(6 * 2048):
        assert advance(hydraulics, state, faults, here, here, here)
    assert state.supply[PUMP] == pytest.approx(400 * GPM, rel=1e-6)
    assert state.supply[SUPPLY_PRESSURE] < 1000 * PSI
    # Orifices in series from supply to return: each of a leg's two paths takes half the head.
    valve = hydraulics.valve[0, 0]
    head = state.supply[SUPPLY_PRESSURE] - state.supply[RETURN_PRESSURE]
    paths = (
        orifice_flow(P, g, P.supply_hose.si, head / 2) for g in (valve.cap_gain, valve.rod_gain)
    )
    assert 6 * sum(paths) == pytest.approx(400 * GPM, rel=1e-3)


def test_one_legs_demand_lowers_anothers_pressure() -> None:
    """Two legs asked alike: the second goes slower while four others draw as well."""
    alone, together = np.zeros((2048, 6)), np.zeros((2048, 6))
    alone[:, 0] = 1.0
    together[:, :] = 1.0
    first, second = (drive(SingleLegs("hardware"), c) for c in (alone, together))
    assert second["supply_pressure"].min() < first["supply_pressure"].min() - 30 * PSI
    assert second["leg_extension"][-1, 0] < first["leg_extension"][-1, 0] - 1e-3
    stiff = [
        drive(SingleLegs(changed("hardware", supply="constant")), c) for c in (alone, together)
    ]
    np.testing.assert_allclose(stiff[0]["leg_extension"][:, 0], stiff[1]["leg_extension"][:, 0])


def test_relief_opens_above_its_pressure() -> None:
    """Oil forced into the supply manifold leaves through the relief: above 1650 psi its pressure
    falls by Q = G (P - 1650 psi), exponentially with V / (beta G)."""
    hydraulics = machine(changed(P, leak_rate=0.0, accumulator_volume=1e-3), FRAME / 64)
    here = np.zeros(1)
    state = rest(hydraulics, here, here)
    state.supply[SUPPLY_PRESSURE] = 1750 * PSI
    state.supply[SUPPLY] = P.supply_volume.si * content_ratio(P, 1750 * PSI)
    volume_rate = P.relief_conductance.si * P.bulk_modulus.si / P.supply_volume.si
    start = state.energy.copy()
    for _ in range(64 * 20):
        assert advance(hydraulics, state, no_faults(1), here, here, here)
    assert volume_rate > 100.0
    assert 1500 * PSI < state.supply[SUPPLY_PRESSURE] < 1655 * PSI
    assert state.energy[5] > start[5] + 1.0
