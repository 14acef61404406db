"""Hydraulics: `advance` against independent equations, its order and its stiff limits."""

from typing import NamedTuple

import numpy as np
import pytest
from hydraulic_equations import (
    ATMOSPHERE,
    FRAME,
    WEIGHT,
    areas,
    changed,
    content_ratio,
    jacobian,
    machine,
    neutral,
    one_step,
    rates,
    rows_of,
    state_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate

from cmf_mj.plant.events import no_faults
from cmf_mj.plant.hydraulics import advance, rest, write_loads
from cmf_mj.plant.parameters import HYDRAULICS, HydraulicParameters

CAP = 2  #: First column of the pressures in a row (drive, spool, p_cap, p_rod).

# -- against scipy ------------------------------------------------------------------------------


class Motion(NamedTuple):
    """x(t) = 0.2 m + drift t + 1 mm sin(2 pi 20 Hz t): keeps pace with the valve on average."""

    drift: float

    def position(self, time: float) -> float:
        return 0.2 + self.drift * time + 1e-3 * float(np.sin(2 * np.pi * 20 * time))

    def speed(self, time: float) -> float:
        return self.drift + 1e-3 * 2 * np.pi * 20 * float(np.cos(2 * np.pi * 20 * time))


def advanced(
    p: HydraulicParameters, start: np.ndarray, commands: np.ndarray, motion: Motion, cuts: int
) -> np.ndarray:
    """States (N, 4) of `advance` at the ends of the frames, each in `cuts` steps."""
    hydraulics = machine(p, FRAME / cuts)
    state = state_of(p, hydraulics, start[None, :], [motion.position(0.0)])
    path = []
    for frame, command in enumerate(commands):
        for cut in range(cuts):
            begin, end = (frame + cut / cuts) * FRAME, (frame + (cut + 1) / cuts) * FRAME
            positions = np.array([motion.position(begin)]), np.array([motion.position(end)])
            assert advance(hydraulics, state, no_faults(1), np.array([command]), *positions)
        path.append(rows_of(state)[0])
    return np.array(path)


def integrated(
    p: HydraulicParameters, start: np.ndarray, commands: np.ndarray, motion: Motion
) -> np.ndarray:
    """States (N, 4) at the ends of the frames by scipy's Radau, restarted at command changes."""
    state, path = start, []
    edges = [0, *(np.flatnonzero(np.diff(commands)) + 1), commands.size]
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        command = commands[first]

        def field(time: float, y: np.ndarray, command: float = command) -> np.ndarray:
            return rates(p, y, command, motion.position(time), motion.speed(time))

        solution = integrate.solve_ivp(
            field,
            (first * FRAME, last * FRAME),
            state,
            method="Radau",
            t_eval=np.arange(first + 1, last + 1) * FRAME,
            rtol=1e-10,
            atol=np.array([1e-12, 1e-12, 1e-3, 1e-3]),
        )
        assert solution.success
        path.append(solution.y.T)
        state = solution.y[:, -1]
    return np.concatenate(path)


@pytest.mark.parametrize("name", HYDRAULICS)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_advance_is_second_order_against_radau(name: str, sign: float) -> None:
    """64 frames of a held command and a moving leg; one step a frame errs by less than 2e-5 Ps.

    Both pressures stay between the ports', as they do in service: checked, since the orifice's
    corner at zero drop has no order.
    """
    p = changed(name, supply="constant", hysteresis=0.0)
    supply, motion = p.supply_pressure.si, Motion(0.14 * sign)
    start = np.array([0.1 * sign, 0.05 * sign, 0.4 * supply, 0.5 * supply])
    commands = np.full(64, 0.5 * sign)
    exact = integrated(p, start, commands, motion)
    assert 0.1 * supply < exact[:, CAP:].min() < exact[:, CAP:].max() < 0.9 * supply
    errors = [np.abs(advanced(p, start, commands, motion, n) - exact) for n in (1, 2, 4)]
    assert max(e[:, :CAP].max() for e in errors) < 1e-9  # lags are exact in any step
    sizes = [e[:, CAP:].max() for e in errors]
    assert sizes[0] < 2e-5 * supply
    orders = np.log2(np.array(sizes[:-1]) / np.array(sizes[1:]))
    assert orders.min() >= 1.8


def test_advance_follows_radau_through_reversing_commands() -> None:
    """The opening passes zero at each reversal, where the flow has a corner; one step a frame
    stays within 1e-4 of supply pressure."""
    p = changed("hardware", supply="constant")
    supply, motion = p.supply_pressure.si, Motion(0.0)
    start = np.array([0.0, 0.0, 0.4 * supply, 0.5 * supply])
    commands = np.repeat([0.6, -0.8, 0.9, -1.0, 1.0], 40)
    found = advanced(p, start, commands, motion, 1)
    exact = integrated(p, start, commands, motion)
    assert 0.0 < exact[:, CAP:].min() < exact[:, CAP:].max() < supply
    np.testing.assert_allclose(found[:, :CAP], exact[:, :CAP], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found[:, CAP:], exact[:, CAP:], rtol=0, atol=1e-4 * supply)


# -- limits ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("opening", [-1.0, 1.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_full_opening_without_pressure_difference_at_the_stop_stays_put(
    opening: float, side: float
) -> None:
    """Both chambers on their port pressures and one on its minimum gap: the stiffest state, the
    orifice rate times the frame is above 100. Nothing drives it, so it stays; without leakage
    within 1 Pa."""
    p = changed("hardware", supply="constant", leak_rate=0.0)
    hydraulics = machine(p)
    high, low = p.supply_pressure.si, p.return_pressure.si
    at = np.array([side * (p.half_stroke.si - 0.5 * p.minimum_gap.si)])
    ports = [high, low] if opening > 0 else [low, high]
    state = state_of(p, hydraulics, np.array([[opening, opening, *ports]]), at)
    for _ in range(200):
        assert advance(hydraulics, state, no_faults(1), np.array([opening]), at, at)
    np.testing.assert_allclose(state.pressure[0], ports, rtol=0, atol=1.0)


@pytest.mark.parametrize("name", HYDRAULICS)
@pytest.mark.parametrize("opening", [-1.0, 1.0])
@pytest.mark.parametrize("gap", [0.0, 0.0005, 0.0025, 0.01, 0.1])
def test_stiff_chambers_stay_bounded_and_settle(name: str, opening: float, gap: float) -> None:
    """Held legs at and near both stops, valve full open, any pressures between tank and supply.

    The exact pressures never leave [Pt, Ps]. The method may overshoot for a step, at most by
    (sqrt(2) - 1) / 2 = 0.207 of the way it goes: the least value of its stability function
    R(z) = (1 + (1 - 2 g) z) / (1 - g z)^2, g = 1 - 1/sqrt(2), on the negative axis. After 2 s
    nothing may be left outside: 1 Pa.
    """
    p = changed(name, supply="constant")
    high, low = p.supply_pressure.si, p.return_pressure.si
    grid = np.linspace(low, high, 6)
    pairs = np.array([[a, b] for a in grid for b in grid])
    pairs = np.vstack([pairs, pairs])
    legs = pairs.shape[0]
    extension = (p.half_stroke.si - gap) * np.repeat([-1.0, 1.0], legs // 2)
    hydraulics = machine(p, legs=legs)
    rows = np.column_stack([np.full((legs, 2), opening), pairs])
    state = state_of(p, hydraulics, rows, extension)
    command = np.full(legs, opening)
    overshoot = 0.5 * (np.sqrt(2) - 1) * (high - low)
    for _ in range(4096):
        assert advance(hydraulics, state, no_faults(legs), command, extension, extension)
        assert state.pressure.min() > low - overshoot
        assert state.pressure.max() < high + overshoot
    assert state.pressure.min() > low - 1.0
    assert state.pressure.max() < high + 1.0
    # Where it settles the exact rates vanish: those that are left move it by less than 1 Pa in
    # the chambers' time constant, which the largest slope of the rates gives.
    for row, x in zip(rows_of(state)[:: legs // 8], extension[:: legs // 8], strict=True):

        def field(pressures: np.ndarray, row: np.ndarray = row, x: float = x) -> np.ndarray:
            return rates(p, np.array([*row[:CAP], *pressures]), opening, x, 0.0)[CAP:]

        slopes = jacobian(field, row[CAP:], np.array([10.0, 10.0]))
        assert np.abs(np.linalg.solve(slopes, field(row[CAP:]))).max() < 1.0


@settings(max_examples=50, deadline=None, derandomize=True, database=None)
@given(
    path=st.lists(st.floats(-0.9, 0.9), min_size=2, max_size=30),
    cap=st.floats(0.0, 1e7),
    rod=st.floats(0.0, 1e7),
)
def test_closed_valve_conserves_the_oil_under_any_motion(
    path: list[float], cap: float, rod: float
) -> None:
    """V r(p) stays what it was without flow, however wild the motion, also torn to vacuum.

    The content that is kept is the same to round-off. The pressure is the one that belongs to it
    within 1 Pa, in a torn chamber within 1e-6 of its content.
    """
    p = changed("hardware", leak_rate=0.0)
    hydraulics = machine(p)
    here = np.array(path[:1])
    state = state_of(p, hydraulics, np.array([[0.0, 0.0, cap, rod]]), here)
    start = state.content.copy()
    half, beta = p.half_stroke.si, p.bulk_modulus.si
    for before, after in zip(path[:-1], path[1:], strict=True):
        positions = np.array([before]), np.array([after])
        assert advance(hydraulics, state, no_faults(1), np.zeros(1), *positions)
        np.testing.assert_allclose(state.content, start, rtol=1e-13)
        volumes = np.array(areas(p)) * [half + after, half - after]
        for pressure, ratio in zip(state.pressure[0], state.content[0] / volumes, strict=True):
            assert pressure > -ATMOSPHERE
            found = content_ratio(p, pressure)
            assert found == pytest.approx(ratio, abs=1e-6 if pressure < 0 else 1 / beta)
    assert not state.drive.any() and not state.spool.any()


@pytest.mark.parametrize("supply", ["constant", "network"])
@pytest.mark.parametrize("rate", [0.0, 1.614])
def test_rest_state_does_not_move(supply: str, rate: float) -> None:
    """A held load with closed valve keeps its pressures, leaking (equal pressures) or tight, and
    so do manifolds and accumulators. 1e-2 Pa over 2 s: round-off."""
    p = changed("report", supply=supply, leak_rate=rate)
    hydraulics = machine(p, legs=2)
    weights = np.array([0.2 * WEIGHT, WEIGHT])
    here = np.array([-0.3, 0.5])
    state = rest(hydraulics, weights, here)
    pressure, network = state.pressure.copy(), state.supply.copy()
    for _ in range(4096):
        assert advance(hydraulics, state, no_faults(2), np.zeros(2), here, here)
    np.testing.assert_allclose(state.pressure, pressure, rtol=0, atol=1e-2)
    np.testing.assert_allclose(state.supply, network, rtol=0, atol=1e-2)
    np.testing.assert_allclose(state.supply[:5], network[:5], rtol=0, atol=1e-12)
    held = np.empty(2)
    write_loads(hydraulics.cylinder, state.pressure, state.friction, held)
    np.testing.assert_allclose(held, weights, rtol=1e-9)
    assert not state.energy.any() or np.abs(state.energy).max() < 1e-6


@pytest.mark.parametrize("name", ["report", "hardware"])
@pytest.mark.parametrize("rate", [1.614, 15.0])
def test_leakage_damps_the_leg_mode_at_half_the_leak_rate(name: str, rate: float) -> None:
    """Damping ratio lambda / (2 w) of a 7200 lbm leg ringing on a closed valve, w = 71.00 rad/s.

    From the swings between turning points, which shrink by exp(-pi zeta / sqrt(1 - zeta^2)).
    3 %: the slow mode under the ringing and the second order of lambda / w.
    """
    p = changed(name, supply="constant", leak_rate=rate)
    z = neutral(p)
    z[5] = 0.01  # m/s: 0.14 mm
    path = [0.0]
    for _ in range(1500):
        z = one_step(p, FRAME / 4, z)
        path.append(z[4])
    x = np.array(path)
    turns = 1 + np.flatnonzero((x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) < 0)
    # Turning points to better than a step: vertex of the parabola through three samples.
    left, middle, right = x[turns - 1], x[turns], x[turns + 1]
    peaks = middle - (right - left) ** 2 / (8 * (left - 2 * middle + right))
    swings = np.abs(np.diff(peaks))[:6]
    decrement = np.log(swings[:-1] / swings[1:]).mean()
    zeta = decrement / np.hypot(np.pi, decrement)
    omega = np.pi / (np.diff(turns)[:6].mean() * FRAME / 4) / np.sqrt(1 - zeta**2)
    assert omega == pytest.approx(71.00, rel=1e-2)
    assert zeta == pytest.approx(rate / (2 * 71.00), rel=3e-2)


def test_legs_on_a_constant_supply_do_not_know_each_other() -> None:
    """Advancing five legs together or one by one gives the same: 1e-12, round-off, for the
    iteration ends for all legs together."""
    p = changed("lossy", supply="constant")
    rng = np.random.default_rng(5)
    rows = np.column_stack([rng.uniform(-1, 1, (5, 2)), rng.uniform(1e6, 9e6, (5, 2))])
    command, before = rng.uniform(-1, 1, 5), rng.uniform(-0.8, 0.8, 5)
    after = before + rng.uniform(-1e-3, 1e-3, 5)
    hydraulics = machine(p, legs=5)
    together = state_of(p, hydraulics, rows, before)
    assert advance(hydraulics, together, no_faults(5), command, before, after)
    found = rows_of(together)
    for leg in range(5):
        one = slice(leg, leg + 1)
        single = machine(p)
        alone = state_of(p, single, rows[one], before[one])
        assert advance(single, alone, no_faults(1), command[one], before[one], after[one])
        np.testing.assert_allclose(rows_of(alone)[0], found[leg], rtol=1e-12)
        np.testing.assert_allclose(alone.content[0], together.content[leg], rtol=1e-14)
        assert alone.friction[0] == together.friction[leg]
