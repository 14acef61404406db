"""Valve: exact lags against scipy, the orifice law, matched ports."""

from types import SimpleNamespace

import numpy as np
import pytest
from hydraulic_equations import (
    changed,
    content_ratio,
    machine,
    port_flows,
    state_of,
)
from scipy import linalg, signal

from cmf_mj.core import units
from cmf_mj.plant.events import no_faults
from cmf_mj.plant.hydraulics import advance
from cmf_mj.plant.parameters import HYDRAULICS, HydraulicParameters, load_hydraulics
from cmf_mj.plant.solver import solve
from cmf_mj.plant.supply import SUPPLY_PRESSURE
from cmf_mj.plant.valve import Valve, lag_weights, make_valves, opening, orifice, spool

FRAME = 1.0 / 2048.0


def valve_of(drive: float, second: float, time: float = FRAME, **own: float) -> Valve:
    """A valve of given corners whose steps are `time` long, the first stage half of it."""
    numbers = {"null_bias": 0.0, "overlap": 0.0, "play": 0.0, "threshold_pressure": 0.0} | own
    halves, whole = lag_weights(drive, second, 0.5 * time), lag_weights(drive, second, time)
    return Valve(*halves, *whole, cap_gain=2.0, rod_gain=1.0, **numbers)


def lags(valve: Valve, command: float, drive: float, position: float) -> tuple[float, float]:
    """(drive, spool) after a step without play."""
    drive, _, position = spool(valve, True, command, drive, 0.0, position)
    return drive, position


def lag_matrix(drive: float, second: float) -> np.ndarray:
    """dd/dt = a (c - d), du/dt = b (d - u) as one generator of (d, u, c), c held."""
    return np.array([[-drive, 0.0, drive], [second, -second, 0.0], [0.0, 0.0, 0.0]])


@pytest.fixture(params=HYDRAULICS)
def parts(request: pytest.FixtureRequest) -> SimpleNamespace:
    """A set on a constant supply, its first valve, and the corners of that."""
    p = changed(request.param, supply="constant")
    return SimpleNamespace(
        parameters=p,
        valve=make_valves(p, ["leg"], 0.5 * FRAME, FRAME)[0, 0],
        drive_rate=p.drive_lag.si,
        spool_rate=p.valve_lag.si,
        supply=p.supply_pressure.si,
        tank=p.return_pressure.si,
    )


def solved_flows(
    p: HydraulicParameters, size: float, cap: float, rod: float
) -> tuple[float, float]:
    """Content flows into (cap, rod) that one implicit stage of the package finds, both valves open
    by `size`. The chambers have 100 m^3 and the stage 0.1 ms: their pressures move by 10 Pa."""
    hydraulics = machine(changed(p, leak_rate=0.0, bearing_leakage=0.0))
    state = state_of(p, hydraulics, np.array([[0.0, 0.0, cap, rod]]), np.zeros(1))
    stage, valves = state.stage, hydraulics.valve[0]
    stage.manifolds.high, stage.manifolds.low = p.supply_pressure.si, p.return_pressure.si
    chamber = stage.chambers[0]
    cap_gain, rod_gain = valves.cap_gain.sum(), valves.rod_gain.sum()
    chamber.cap_in, chamber.cap_out = max(size, 0.0) * cap_gain, max(-size, 0.0) * cap_gain
    chamber.rod_out, chamber.rod_in = max(size, 0.0) * rod_gain, max(-size, 0.0) * rod_gain
    chamber.cap, chamber.rod = cap, rod
    chamber.cap_volume = chamber.rod_volume = 100.0
    known = [100.0 * content_ratio(p, pressure) for pressure in (cap, rod)]
    chamber.cap_known, chamber.rod_known = known
    time, supply = 1e-4, hydraulics.supply._replace(constant=True)
    laminar = hydraulics.laminar
    assert solve(hydraulics.cylinder, hydraulics.oil, supply, laminar, stage, time) > 0
    found = chamber.cap_content - known[0], chamber.rod_content - known[1]
    return found[0] / time, found[1] / time


@pytest.mark.parametrize("time", [1e-6, FRAME, 0.01, 0.3])
@pytest.mark.parametrize(
    ("drive", "spool"),
    [
        (18.85, 471.2),
        (471.2, 18.85),
        (40.0, 40.0),
        # Nearly equal corners, where exp(-a t) - exp(-b t) over b - a cancels: either side of the
        # limit formula's threshold of 1e-9.
        (40.0, 40.0 * (1 + 1e-6)),
        (40.0, 40.0 * (1 + 1e-10)),
    ],
)
def test_lags_are_the_matrix_exponential(drive: float, spool: float, time: float) -> None:
    """Oracle: scipy.linalg.expm of the generator. 1e-9: cancellation of 1e-16 / 1e-6 and more."""
    command, start_drive, start_opening = 0.7, -0.4, 0.25
    expected = linalg.expm(lag_matrix(drive, spool) * time) @ [start_drive, start_opening, command]
    found = lags(valve_of(drive, spool, time), command, start_drive, start_opening)
    np.testing.assert_allclose(found, expected[:2], rtol=0, atol=1e-9)


def test_lags_of_a_held_command_are_the_zero_order_hold(parts: SimpleNamespace) -> None:
    """Oracle: scipy.signal.lsim without interpolation, 200 frames of random commands.

    1e-12: round-off of 200 steps.
    """
    a, b = parts.drive_rate, parts.spool_rate
    commands = np.random.default_rng(1).uniform(-1.0, 1.0, 200)
    system = signal.StateSpace([[-a, 0], [b, -b]], [[a], [0]], np.eye(2), np.zeros((2, 1)))
    _, expected, _ = signal.lsim(system, commands, np.arange(200) * FRAME, interp=False)
    valve = valve_of(a, b)
    state = (0.0, 0.0)
    found = [state]
    for command in commands[:-1]:
        state = lags(valve, command, *state)
        found.append(state)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_orifice_is_odd_and_its_slope_its_derivative() -> None:
    """Central differences at 1e-4 of the local scale: error of order 1e-8. It rises everywhere."""
    laminar = 100.0
    for drop in np.geomspace(1e-3, 1e8, 23):
        flow, slope = orifice(drop, laminar)
        assert orifice(-drop, laminar) == (-flow, slope)
    assert orifice(0.0, laminar)[0] == 0.0
    values = np.array([orifice(drop, laminar) for drop in np.linspace(-3e7, 3e7, 20001)])
    assert (np.diff(values[:, 0]) > 0.0).all() and (values[:, 1] > 0.0).all()
    drops = [*np.geomspace(1.0, 1e7, 29), 0.0, *-np.geomspace(1.0, 1e7, 29)]
    for drop in drops:
        step = 1e-4 * max(abs(drop), 1e-4 * laminar**2)
        rise = orifice(drop + step, laminar)[0] - orifice(drop - step, laminar)[0]
        assert orifice(drop, laminar)[1] == pytest.approx(rise / (2 * step), rel=1e-7)


def test_orifice_solves_its_drop() -> None:
    """|dp| = phi^2 + s phi: turbulent and laminar share, equal at dp = 2 s^2."""
    for drop in np.geomspace(1e-6, 1e8, 29):
        flow = orifice(drop, 30.0)[0]
        assert flow**2 + 30.0 * flow == pytest.approx(drop, rel=1e-12)
    assert orifice(2 * 30.0**2, 30.0)[0] == pytest.approx(30.0, rel=1e-14)


@pytest.mark.parametrize("size", [-1.0, -0.3, 0.02, 1.0])
@pytest.mark.parametrize("share", [0.1, 0.4, 0.5, 0.9])
def test_flows_of_a_stage_are_those_of_the_equations(
    parts: SimpleNamespace, size: float, share: float
) -> None:
    """1e-5: the pressures move by 10 Pa in the stage."""
    cap, rod = share * parts.supply, (1.3 - share) * parts.supply
    found = solved_flows(parts.parameters, size, cap, rod)
    assert found == pytest.approx(port_flows(parts.parameters, size, cap, rod), rel=1e-5)


@pytest.mark.parametrize("size", [-1.0, -0.3, 0.02, 1.0])
@pytest.mark.parametrize("share", [0.1, 0.4, 0.5, 0.9])
def test_matched_ports_ask_for_one_leg_speed(
    parts: SimpleNamespace, size: float, share: float
) -> None:
    """cap port flows A_cap/A_rod times the rod port, so that with
    p_cap + p_rod = Ps + Pt both chambers move the leg alike: q_cap/A_cap = -q_rod/A_rod.
    1e-4: the pressures move by 10 Pa, and not alike."""
    total, p = parts.supply + parts.tank, parts.parameters
    cap = share * total
    cap_flow, rod_flow = solved_flows(p, size, cap, total - cap)
    assert cap_flow / p.cap_area == pytest.approx(-rod_flow / p.rod_area, rel=1e-4)
    assert np.sign(cap_flow) == np.sign(size)
    gains = parts.valve.cap_gain / p.cap_area, parts.valve.rod_gain / p.rod_area
    assert gains[0] == pytest.approx(gains[1], rel=1e-12)


@pytest.mark.parametrize("percent", [-100.0, -1.0, 1.0, 35.0])
def test_steady_speed_at_half_the_supply_drop_is_the_parameter(
    parts: SimpleNamespace, percent: float
) -> None:
    """`leg_speed` [in/s/%] is defined at half the supply pressure across each port: what flows in
    fills a chamber at mid pressure. 1e-5: the pressures move by 10 Pa."""
    p, middle = parts.parameters, 0.5 * (parts.supply + parts.tank)
    flow = solved_flows(p, percent / 100.0, middle, middle)[0] / content_ratio(p, middle)
    inches = units.from_si("in", flow / p.cap_area)
    assert p.leg_speed.unit == "in/s/%"
    assert inches == pytest.approx(p.leg_speed.value * percent, rel=1e-5)


@pytest.mark.parametrize("size", [-0.6, 0.6])
def test_a_hose_takes_its_laminar_share(size: float) -> None:
    """Valve and hose in series: the flow solves |dp| = (q/G)^2 + (s/G + R) q with R of the hose."""
    with_hoses, without = load_hydraulics("hardware"), changed("hardware", supply_hose=0.0)
    without = changed(without, return_hose=0.0)
    cap, rod = 4e6, 3e6
    long = solved_flows(with_hoses, size, cap, rod)
    assert long == pytest.approx(port_flows(with_hoses, size, cap, rod), rel=1e-4)
    short = solved_flows(without, size, cap, rod)
    assert short == pytest.approx(port_flows(without, size, cap, rod), rel=1e-4)
    assert abs(long[0]) < 0.999 * abs(short[0])


def test_opening_is_the_spool_less_the_overlap() -> None:
    """And the spool rests at the null bias."""
    valve = valve_of(18.85, 471.2, overlap=0.05)
    assert [opening(valve, x) for x in (-0.05, -0.01, 0.0, 0.05)] == [0.0, 0.0, 0.0, 0.0]
    assert opening(valve, 0.25) == pytest.approx(0.2, rel=1e-14)
    assert opening(valve, -0.25) == pytest.approx(-0.2, rel=1e-14)
    assert opening(valve, 3.0) == 1.0
    assert opening(valve, -3.0) == -1.0
    biased = valve_of(18.85, 471.2, 3.0, null_bias=0.02)
    assert lags(biased, 0.1, 0.0, 0.0)[1] == pytest.approx(0.12, abs=1e-12)


def test_play_follows_the_drive_at_half_the_hysteresis() -> None:
    """Up and down a slow triangle the spool lags by half the hysteresis each way: a loop of the
    full width; the turn from one side to the other moves nothing."""
    valve = valve_of(400.0, 900.0, 0.1, play=0.03)
    up, down = np.linspace(-0.5, 0.5, 101), np.linspace(0.5, -0.5, 101)
    drive, play, position = -0.5, 0.0, -0.5
    path = []
    for command in (*up, *down):
        drive, play, position = spool(valve, True, command, drive, play, position)
        path.append(position)
        assert abs(play) <= 0.03
    rising, falling = np.array(path[:101]), np.array(path[101:])
    np.testing.assert_allclose(rising[10:], up[10:] - 0.03, rtol=0, atol=1e-9)
    np.testing.assert_allclose(falling[10:], down[10:] + 0.03, rtol=0, atol=1e-9)
    np.testing.assert_allclose(falling[:6], 0.47, rtol=0, atol=1e-9)


def test_below_the_threshold_pressure_nothing_passes() -> None:
    """Supply less than 200 psi above the return: the spool moves, the valve stays shut."""
    p = changed("hardware", leak_rate=0.0)
    hydraulics, here = machine(p), np.zeros(1)
    for excess, passes in ((-1.0, False), (1.0, True)):
        state = state_of(p, hydraulics, np.array([[1.0, 1.0, 4e6, 4e6]]), here)
        state.supply[SUPPLY_PRESSURE] = p.threshold_pressure.si + excess
        before = state.content.copy()
        assert advance(hydraulics, state, no_faults(1), np.ones(1), here, here)
        assert (np.abs(state.content - before).max() > 1e-9) == passes
