"""Closed-form limits of a sine, the performance envelope.

Oracles: sines integrated through the kinematics, the orifice equation solved by bisection, Table
2-1, hydraulic modes; simulated sines where one of the limits rules.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hydraulic_equations import GPM, INCH, PSI, changed
from scipy.optimize import brentq

from cmf_mj import Hexapod, SingleLegs, load_law, signals
from cmf_mj.analysis.modes import nominal_modes
from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.facility.simulate import drive, simulate
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_jacobian, pose_to_legs
from cmf_mj.studies.asymptotes import asymptotes, full_speed
from tests.control.test_plan import actuator_polynomial

CAP, ROD = math.pi / 4 * 5.5**2 * INCH**2, math.pi / 4 * (5.5**2 - 3.875**2) * INCH**2


@pytest.fixture(scope="module")
def plant() -> Hexapod:
    return Hexapod("gfd")


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_full_speed_solves_the_orifices_and_hoses(plant, sense):
    """Drops (v / k)^2 + (s / k + R A) v, balance p_cap A_cap - p_rod A_rod = F, by bisection."""
    high, low, load = 1450 * PSI, 20 * PSI, 7200 * 4.4482216152605
    hose, laminar = 0.07 * PSI / GPM, math.sqrt(0.05 * PSI)
    half_drop = 750 * PSI
    gain = 35 * INCH / (2 * half_drop / (laminar + math.sqrt(laminar**2 + 4 * half_drop)))

    def excess(speed):
        drops = [(speed / gain) ** 2 + (laminar / gain + hose * a) * speed for a in (CAP, ROD)]
        if sense > 0:
            return CAP * (high - drops[0]) - ROD * (low + drops[1]) - load
        return load - CAP * (low + drops[0]) + ROD * (high - drops[1])

    speeds = full_speed(plant.hydraulics, np.full(6, load), high, low)
    expected = brentq(excess, 0.0, 2.0, xtol=1e-14)
    np.testing.assert_allclose(speeds[:, 0 if sense > 0 else 1], expected, rtol=1e-9)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_full_speed_is_what_a_leg_reaches_at_full_command(sense):
    """Without leakage, with the manifolds of the run; flows count content, and the formula takes
    the oil of mid pressure for that of either chamber."""
    legs = SingleLegs(changed("hardware", leak_rate=0.0))
    run = drive(legs, np.full((2048, 6), sense))
    row = np.argmax(np.abs(run["leg_extension"][:, 0]) > 0.5)
    load = np.full(6, 7200 * 4.4482216152605)
    speeds = full_speed(
        legs.hydraulics, load, run["supply_pressure"][row], run["return_pressure"][row]
    )
    reached = abs(run["leg_velocity"][row, 0])
    assert reached == pytest.approx(speeds[0, 0 if sense > 0 else 1], rel=0.01)


def test_full_speed_of_a_stalled_leg_is_zero(plant):
    load = np.full(6, 1.001 * CAP * 1500 * PSI)
    assert (full_speed(plant.hydraulics, load, 1500 * PSI, 0.0)[:, 0] == 0.0).all()


@pytest.mark.parametrize("dof", DOFS)
def test_pump_limit_is_the_mean_flow_of_a_sine_through_the_kinematics(plant, dof):
    limits = asymptotes(plant, dof)
    phase = 2 * np.pi * np.arange(4001) / 4000
    pose = np.zeros((phase.size, 6))
    amplitude, index = 1e-3, DOFS.index(dof)
    pose[:, index] = amplitude * np.sin(phase)
    travel = np.diff(pose_to_legs(pose), axis=0)
    volume = np.where(travel > 0, CAP * travel, -ROD * travel).sum()  # a cycle
    rate = limits.pump_flow / amplitude  # w of a sine with this velocity amplitude
    assert volume * rate / (2 * np.pi) == pytest.approx(400 * GPM, rel=1e-3)


@pytest.mark.parametrize("pose", [(0.0,) * 6, (0.3, 0.0, -0.4, 0.1, 0.0, 0.2)])
@pytest.mark.parametrize("dof", DOFS)
def test_acceleration_limit_puts_one_leg_at_its_stall_force_and_none_beyond(plant, dof, pose):
    limits = asymptotes(plant, dof, pose)
    column = pose_jacobian(np.array(pose))[:, DOFS.index(dof)]
    inertia = plant.reflected_mass(pose) @ column * limits.acceleration
    load = plant.static_load()
    used = [(load + sign * inertia) / (1500 * PSI) for sign in (1, -1)]
    share = max(max((u / CAP).max(), (-u / ROD).max()) for u in used)
    assert share == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("dof", ["surge", "heave", "roll"])
def test_unit_gain_ends_where_the_modes_ask_for_all_that_valves_or_supply_give(plant, dof):
    """By modes, as the plan inverts them: |V D_i(jw) / k V' J| a; and the stall at mid load."""
    limits = asymptotes(plant, dof)
    modes, plan = nominal_modes(plant), load_law("modal_plan").plan
    shape = np.array(modes.shape)
    speed = plan.speed * INCH / 0.01
    polynomials = [actuator_polynomial(plan, 2 * np.pi * f)[::-1] for f in modes.frequency]
    size = 0.33 * INCH
    alike = replace(limits, speed=np.full(6, speed), acceleration=np.inf)
    found = alike.saturation(size)
    along = np.array([np.polyval(p, 2j * np.pi * found) for p in polynomials])
    asked = np.abs(shape.T @ (along * (shape @ limits.column)) * size / speed).max()
    assert asked == pytest.approx(1.0, rel=0.02)
    stalled = replace(limits, speed=np.full(6, np.inf)).saturation(size)
    assert (2 * np.pi * stalled) ** 2 * size == pytest.approx(limits.acceleration, rel=0.01)
    assert limits.saturation(size) <= min(found, stalled) * 1.1
    assert np.isnan(limits.saturation(1e-9))


def test_displacement_limits_are_table_2_1_the_smaller_side(plant):
    every = [asymptotes(plant, dof) for dof in DOFS]
    scale = np.array([INCH] * 3 + [np.pi / 180] * 3)
    printed = [55, 55, 41, 28, 25, 38]
    np.testing.assert_allclose([limits.displacement for limits in every] / scale, printed)
    assert all(limits.leg_stroke > limits.displacement for limits in every)


def test_transmission_is_one_at_low_frequency_and_peaks_at_the_heave_mode(plant):
    limits = asymptotes(plant, "heave")
    assert limits.transmission(0.01) == pytest.approx(1.0, abs=1e-4)
    frequency = np.linspace(6, 16, 401)
    peak = frequency[np.argmax([limits.transmission(f) for f in frequency])]
    modes = plant.hydraulic_modes()
    heave = np.abs(modes.pose_shape[2]).argmax()
    assert peak == pytest.approx(modes.frequency[heave] / (2 * np.pi), rel=0.02)
    assert limits.transmission(100.0) < 0.05


# The envelope


def held(plant, dof, frequency, share):
    """Velocity of the response over the closed form, and the record, in whole cycles of a sine."""
    closed, turn = asymptotes(plant, dof).velocity(frequency), 2 * np.pi * frequency
    cycles, amplitude = max(5.0, np.ceil(20.0 * frequency)), share * closed / turn
    sine = signals.sine(dof, amplitude, frequency, cycles=cycles, fade=1.0 / frequency)
    record = simulate(plant, "velocity", sine, record_every=4)
    rows = (record.time > 2.0 / frequency + 1.0) & (record.time < 4.0 / frequency + 1.0)
    motion = record["platform_pose"][rows, DOFS.index(dof)]
    reached = fit_sines(motion, turn * record.time[rows]).amplitude[0]
    return turn * abs(reached) / closed, {n: c[rows] for n, c in record.channels.items()}


@pytest.mark.parametrize("frequency", [0.63, 2.5])
def test_heave_draws_of_the_pump_as_computed(plant, frequency):
    speed, run = held(plant, "heave", frequency, 0.9)
    bank = 4 * run["accumulator_oil"] + run["supply_content"]
    drawn = run["pump_flow"].mean() + (bank[0] - bank[-1]) * frequency / 2.0
    limits = asymptotes(plant, "heave").velocities(frequency)
    assert min(limits, key=limits.get) == "pump_flow"
    assert drawn == pytest.approx(speed * 400 * GPM, rel=0.04)


@pytest.mark.parametrize(
    ("dof", "frequency", "share"), [("pitch", 0.4, 0.07), ("roll", 0.63, 0.1), ("heave", 4.0, 0.06)]
)
def test_leg_speed_region_is_bound_by_the_valves_as_computed(plant, dof, frequency, share):
    """The manifold's fall and the inertia forces, left out of the closed form, take `share`."""
    limits = asymptotes(plant, dof).velocities(frequency)
    assert min(limits, key=limits.get) == "valve_command"
    speed, run = held(plant, dof, frequency, 0.95)
    used = np.abs(run["compensator_output"]).max()
    assert 1 - share < speed / used < 1.02
