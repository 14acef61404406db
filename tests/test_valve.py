"""Valve: exact lags against scipy, the orifice law, matched ports."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import linalg, signal

from cmf_mj import units
from cmf_mj.parameters import HYDRAULICS, load_hydraulics
from cmf_mj.plant.supply import make_supply
from cmf_mj.plant.valve import Valve, lag_weights, lags, make_valve, orifice, port_flows

FRAME = 1.0 / 2048.0


def valve_of(drive: float, spool: float) -> Valve:
    return Valve(drive, spool, cap_gain=2.0, rod_gain=1.0, transition_pressure=1e4)


def lag_matrix(drive: float, spool: float) -> np.ndarray:
    """dd/dt = a (c - d), du/dt = b (d - u) as one generator of (d, u, c), c held."""
    return np.array([[-drive, 0.0, drive], [spool, -spool, 0.0], [0.0, 0.0, 0.0]])


@pytest.fixture(params=HYDRAULICS)
def machine(request: pytest.FixtureRequest) -> SimpleNamespace:
    parameters = load_hydraulics(request.param)
    return SimpleNamespace(
        parameters=parameters, valve=make_valve(parameters), supply=make_supply(parameters)
    )


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
    weights = lag_weights(valve_of(drive, spool), time)
    found = lags(weights, command, start_drive, start_opening)
    np.testing.assert_allclose(found, expected[:2], rtol=0, atol=1e-9)


def test_lags_of_a_held_command_are_the_zero_order_hold(machine: SimpleNamespace) -> None:
    """Oracle: scipy.signal.lsim without interpolation, 200 frames of random commands.

    1e-12: round-off of 200 steps.
    """
    a, b = machine.valve.drive_rate, machine.valve.spool_rate
    commands = np.random.default_rng(1).uniform(-1.0, 1.0, 200)
    system = signal.StateSpace([[-a, 0], [b, -b]], [[a], [0]], np.eye(2), np.zeros((2, 1)))
    _, expected, _ = signal.lsim(system, commands, np.arange(200) * FRAME, interp=False)
    weights = lag_weights(machine.valve, FRAME)
    state = (0.0, 0.0)
    found = [state]
    for command in commands[:-1]:
        state = lags(weights, command, *state)
        found.append(state)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_lags_do_not_depend_on_how_the_time_is_cut(machine: SimpleNamespace) -> None:
    """Exact solutions compose: two halves make the whole. 1e-14: round-off of two exponentials."""
    half = lag_weights(machine.valve, 0.5 * FRAME)
    twice = lags(half, 0.3, *lags(half, 0.3, -0.8, 0.1))
    once = lags(lag_weights(machine.valve, FRAME), 0.3, -0.8, 0.1)
    np.testing.assert_allclose(twice, once, rtol=0, atol=1e-14)


def test_lags_pass_a_steady_command_unchanged(machine: SimpleNamespace) -> None:
    """DC gain 1, reached from anywhere: exp(-18.85 * 3) is 3e-25."""
    steady = lags(lag_weights(machine.valve, 3.0), 0.6, -1.0, 1.0)
    np.testing.assert_allclose(steady, [0.6, 0.6], rtol=0, atol=1e-15)


def test_lag_corners_are_those_of_the_report(machine: SimpleNamespace) -> None:
    """Poles -18.85 and -471.24 rad/s of Eqs 4.1 and 4.4: 3 and 75 Hz (printed to 4 digits)."""
    assert machine.valve.drive_rate == pytest.approx(2 * np.pi * 3.0, rel=1e-12)
    assert machine.valve.spool_rate == pytest.approx(2 * np.pi * 75.0, rel=1e-12)
    assert machine.valve.drive_rate == pytest.approx(18.85, rel=1e-3)
    assert machine.valve.spool_rate == pytest.approx(471.24, rel=1e-4)


@pytest.mark.parametrize("corner", ["drive", "spool"])
def test_gain_and_phase_at_each_corner(machine: SimpleNamespace, corner: str) -> None:
    """A first-order lag at its corner: 1/sqrt(2), -45 deg, times the other lag.

    Oracle: the frames of `lags` under a held sine against 1 / ((1 + jw/a)(1 + jw/b)) and the hold's
    own response. 1e-6: the start's transient after 10 whole cycles and 2 s.
    """
    a, b = machine.valve.drive_rate, machine.valve.spool_rate
    hertz = {"drive": 3.0, "spool": 75.0}[corner]
    steps = 16  # of each frame, so that the held sine is nearly the sine
    time = np.arange(round((2.0 + 10.0 / hertz) / FRAME) * steps) * FRAME / steps
    weights = lag_weights(machine.valve, FRAME / steps)
    omega = 2 * np.pi * hertz
    state = (0.0, 0.0)
    opening = np.empty(time.size)
    for index, command in enumerate(np.sin(omega * time)):
        opening[index] = state[1]
        state = lags(weights, command, *state)
    last = time >= time[-1] + time[1] - 10.0 / hertz - 1e-12
    basis = np.column_stack([np.sin(omega * time[last]), np.cos(omega * time[last])])
    real, imaginary = np.linalg.lstsq(basis, opening[last], rcond=None)[0]
    hold = np.sinc(hertz * time[1]) * np.exp(-0.5j * omega * time[1])
    expected = hold / ((1 + 1j * omega / a) * (1 + 1j * omega / b))
    # The aliases of the held sine, all above 1 / time[1] = 32 kHz, pass the lags by a / w < 1e-7.
    assert complex(real, imaginary) == pytest.approx(expected, abs=2e-6)


def test_orifice_is_odd() -> None:
    for drop in np.geomspace(1e-3, 1e8, 23):
        flow, slope = orifice(drop, 1e4)
        backward, backward_slope = orifice(-drop, 1e4)
        assert (backward, backward_slope) == (-flow, slope)
    assert orifice(0.0, 1e4)[0] == 0.0


def test_orifice_rises_everywhere() -> None:
    drops = np.linspace(-3e7, 3e7, 20001)
    values = np.array([orifice(drop, 1e4) for drop in drops])
    assert (np.diff(values[:, 0]) > 0.0).all()
    assert (values[:, 1] > 0.0).all()


def test_orifice_slope_is_the_derivative() -> None:
    """Central differences at 1e-4 of the local scale: error of order 1e-8."""
    transition = 1e4
    drops = [*np.geomspace(1.0, 1e7, 29), 0.0, *-np.geomspace(1.0, 1e7, 29)]
    for drop in drops:
        step = 1e-4 * max(abs(drop), transition)
        rise = orifice(drop + step, transition)[0] - orifice(drop - step, transition)[0]
        assert orifice(drop, transition)[1] == pytest.approx(rise / (2 * step), rel=1e-7)


def test_orifice_is_a_square_root_far_above_transition_and_linear_far_below() -> None:
    """phi = sqrt(dp) (1 - (ptr/dp)^2 / 4 + ...) and dp / sqrt(ptr) (1 - (dp/ptr)^2 / 4 + ...)."""
    transition = 1e4
    assert orifice(1e3 * transition, transition)[0] == pytest.approx(
        np.sqrt(1e3 * transition), rel=3e-7
    )
    assert orifice(1e-3 * transition, transition)[0] == pytest.approx(
        1e-3 * np.sqrt(transition), rel=3e-7
    )


@pytest.mark.parametrize("opening", [-1.0, -0.3, 0.02, 1.0])
@pytest.mark.parametrize("share", [0.1, 0.4, 0.5, 0.9])
def test_matched_ports_ask_for_one_leg_speed(
    machine: SimpleNamespace, opening: float, share: float
) -> None:
    """cap port flows A_cap/A_rod times the rod port, so that with
    p_cap + p_rod = Ps + Pt both chambers move the leg alike: q_cap/A_cap = -q_rod/A_rod."""
    supply, parameters = machine.supply, machine.parameters
    total = supply.pressure + supply.return_pressure
    cap = share * total
    cap_flow, rod_flow, _, _ = port_flows(machine.valve, opening, supply, cap, total - cap)
    from_cap, from_rod = cap_flow / parameters.cap_area, -rod_flow / parameters.rod_area
    assert from_cap == pytest.approx(from_rod, rel=1e-12)
    assert np.sign(from_cap) == np.sign(opening)


@pytest.mark.parametrize("percent", [-100.0, -1.0, 1.0, 35.0])
def test_steady_speed_at_half_the_supply_drop_is_the_parameter(
    machine: SimpleNamespace, percent: float
) -> None:
    """`leg_speed` [in/s/%] is defined at half the supply pressure across each port.

    1e-5: the transition pressure takes (1.5 / 750)^2 / 4 = 1e-6 off the square root.
    """
    supply, parameters = machine.supply, machine.parameters
    middle = 0.5 * (supply.pressure + supply.return_pressure)
    flow, _, _, _ = port_flows(machine.valve, percent / 100.0, supply, middle, middle)
    inches = units.from_si("in", flow / parameters.cap_area)
    assert parameters.leg_speed.unit == "in/s/%"
    assert inches == pytest.approx(parameters.leg_speed.value * percent, rel=1e-5)


def test_port_flow_slopes_are_the_derivatives(machine: SimpleNamespace) -> None:
    """Central differences of 10 Pa against the slopes, both signs of the opening; error 1e-9."""
    supply = machine.supply
    for opening in (-0.7, 0.4):
        for cap, rod in [(2e6, 7e6), (9e6, 1e6), (supply.pressure + 2e5, -3e5)]:
            slopes = port_flows(machine.valve, opening, supply, cap, rod)[2:]
            step = 10.0
            cap_rise = (
                port_flows(machine.valve, opening, supply, cap + step, rod)[0]
                - port_flows(machine.valve, opening, supply, cap - step, rod)[0]
            )
            rod_rise = (
                port_flows(machine.valve, opening, supply, cap, rod + step)[1]
                - port_flows(machine.valve, opening, supply, cap, rod - step)[1]
            )
            expected = [cap_rise / (2 * step), rod_rise / (2 * step)]
            np.testing.assert_allclose(slopes, expected, rtol=1e-6)
            assert max(slopes) < 0.0


def test_flows_pass_continuously_through_the_closed_valve(machine: SimpleNamespace) -> None:
    """Linear in the opening on both sides and zero at zero: no jump, no deadband."""
    supply = machine.supply
    cap, rod = 0.3 * supply.pressure, 0.6 * supply.pressure
    assert port_flows(machine.valve, 0.0, supply, cap, rod) == (0.0, 0.0, 0.0, 0.0)
    for sign in (-1.0, 1.0):
        full = np.array(port_flows(machine.valve, sign, supply, cap, rod))
        for size in (1e-12, 1e-3, 0.5):
            found = np.array(port_flows(machine.valve, sign * size, supply, cap, rod))
            np.testing.assert_allclose(found, size * full, rtol=1e-12)


def test_flow_gain_is_the_same_both_ways_at_mid_pressure(machine: SimpleNamespace) -> None:
    """With half the supply in both chambers the flow is odd in the opening: no kink at null."""
    supply = machine.supply
    middle = 0.5 * (supply.pressure + supply.return_pressure)
    out = np.array(port_flows(machine.valve, 1e-3, supply, middle, middle))
    back = np.array(port_flows(machine.valve, -1e-3, supply, middle, middle))
    np.testing.assert_allclose(back[:2], -out[:2], rtol=1e-12)
    np.testing.assert_allclose(back[2:], out[2:], rtol=1e-12)


def test_oil_flows_down_the_pressure(machine: SimpleNamespace) -> None:
    """A chamber above supply pressure gives oil back to the supply, one below tank draws."""
    supply = machine.supply
    above, below = supply.pressure + 1e6, supply.return_pressure - 1e6
    assert port_flows(machine.valve, 0.5, supply, above, below)[0] < 0.0
    assert port_flows(machine.valve, 0.5, supply, above, below)[1] > 0.0
    assert port_flows(machine.valve, -0.5, supply, below, above)[0] > 0.0
    assert port_flows(machine.valve, -0.5, supply, below, above)[1] < 0.0
