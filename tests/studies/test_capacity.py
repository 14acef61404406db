"""Capacity of the supply: verdicts, closed forms, the performance envelope and `cmf capacity`.

Oracles: sines integrated through the kinematics, the orifice equation solved by bisection, Table
2-1, gas laws, hydraulic modes; the closed forms for the envelope where one of them rules.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hydraulic_equations import GPM, INCH, PSI, changed
from scipy.optimize import brentq
from shared import cmf

from cmf_mj import Hexapod, SingleLegs, load_hydraulics, load_law
from cmf_mj.analysis.modes import nominal_modes
from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.core.files import write_table
from cmf_mj.facility.simulate import drive
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_jacobian, pose_to_legs
from cmf_mj.studies.asymptotes import FREQUENCIES, asymptotes, envelope, full_speed
from cmf_mj.studies.capacity import capacity, least_allowed, manoeuvre, pressure_margin
from tests.control.test_plan import actuator_polynomial

GALLON = 231.0 * INCH**3
CAP, ROD = math.pi / 4 * 5.5**2 * INCH**2, math.pi / 4 * (5.5**2 - 3.875**2) * INCH**2


@pytest.fixture(scope="module")
def plant() -> Hexapod:
    return Hexapod("gfd")


# The criterion


@pytest.fixture(scope="module")
def sine(plant):
    return capacity(manoeuvre("sine", "heave"), plant)


def test_default_criterion_is_80_percent_of_the_set_pressure(sine):
    assert sine.allowed_pressure == pytest.approx(1200 * PSI)
    assert sine.holds and sine.least_pressure.value > sine.allowed_pressure


@pytest.mark.parametrize(("offset", "holds"), [(-1.0, True), (1.0, False)])
def test_verdict_turns_where_the_least_pressure_meets_the_allowed(plant, sine, offset, holds):
    """The run does not depend on the criterion, so a pascal either way decides."""
    again = capacity(
        manoeuvre("sine", "heave"), plant, least_pressure=sine.least_pressure.value + offset
    )
    assert again.least_pressure == sine.least_pressure
    assert again.holds is holds


@pytest.mark.parametrize("pressure", [0.0, -1.0, 1500 * PSI, float("nan")])
def test_criterion_outside_tank_and_supply_is_refused(pressure):
    with pytest.raises(ValueError, match="least_pressure"):
        least_allowed(load_hydraulics("hardware"), pressure)


def test_measures_of_a_sine(sine):
    """Charge of the gas law; draw (A_cap + A_rod) / pi a leg and speed amplitude."""
    absolute = (1000 + 14.69595) / (1500 + 14.69595)
    assert sine.charged_oil == pytest.approx(
        4 * 50 * GALLON * (1 - absolute ** (1 / 1.4)), rel=1e-6
    )
    pose = sine.record["platform_pose"]
    speed = np.diff(pose_to_legs(pose), axis=0)
    drawn = np.where(speed > 0, CAP * speed, -ROD * speed).sum()
    bank = 4 * (sine.record["accumulator_oil"][-1] - sine.record["accumulator_oil"][0])
    delivered = sine.pump_flow.mean * sine.record.time[-1]
    assert delivered - bank == pytest.approx(drawn, rel=0.02)  # piston leakage and compression
    assert sine.relief_flow == (0.0, 0.0)
    assert sine.pump_flow.peak <= sine.pump_flow_limit
    assert not sine.saturation.any() and (sine.peak_command < 1.0).all()


def test_margin_of_a_machine_at_rest_is_the_supply_less_the_load_over_the_cap(plant, sine):
    plant.start()
    margin = 1500 * PSI - plant.static_load() / CAP
    np.testing.assert_allclose(pressure_margin(plant.hydraulics, sine.record)[0], margin, rtol=1e-5)
    assert sine.least_margin.value < margin.min()


def test_step_saturates_the_valves_for_a_share_of_the_run(plant):
    """10 in at 34 in/s at most: 0.2 to 0.6 s of 13 s."""
    moved = capacity(manoeuvre("step", "heave"), plant)
    assert (moved.saturation > 0.2 / 13).all() and (moved.saturation < 0.6 / 13).all()
    assert (moved.peak_command > 1.0).all()
    assert moved.holds


def test_too_small_a_supply_empties_its_accumulators_and_does_not_hold():
    small = changed("hardware", pump_flow=20.0, accumulator_volume=2.0, accumulator_count=1.0)
    result = capacity(manoeuvre("sine", "heave", 0.2, 0.5), Hexapod(hydraulics=small))
    assert not result.holds
    assert result.empty_time > 0.5
    assert result.least_oil == pytest.approx(0.0, abs=1e-9)
    assert result.least_pressure.value < 1000 * PSI  # below the precharge
    assert result.pump_flow.peak == pytest.approx(20 * GPM, rel=1e-3)


def test_constant_supply_holds_and_has_neither_pump_nor_accumulators():
    result = capacity(manoeuvre("step", "heave"), Hexapod(hydraulics="report"))
    assert result.holds and result.least_pressure.value == pytest.approx(1500 * PSI)
    assert np.isnan([result.pump_flow.mean, result.least_oil, result.empty_time]).all()


def test_command_beyond_the_operational_limits_is_refused(plant):
    with pytest.raises(ValueError, match="heave"):
        capacity(manoeuvre("sine", "heave", 1.2), plant)


# Closed forms


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
    record = capacity(manoeuvre("sine", dof, share * closed / turn, frequency), plant).record
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


def test_the_envelope_has_the_smallest_limit_at_every_frequency(plant):
    found = envelope(plant, ["heave", "roll"])
    assert [one.frequency for one in found] == 2 * list(FREQUENCIES)
    assert found[0].binding == "displacement"
    assert found[0].displacement == pytest.approx(41 * INCH)
    for one in found:
        assert one.velocity == asymptotes(plant, one.dof).velocity(one.frequency)
    assert float(found.table.cells[0][2]) == 41.0
    assert asymptotes(Hexapod("gfd", "report"), "heave").pump_flow == np.inf


# Manoeuvres


@pytest.mark.parametrize("kind", ["sine", "step", "chirp", "noise", "multisine"])
def test_named_manoeuvres_have_the_amplitude_and_end_at_rest_but_for_the_step(kind):
    command = manoeuvre(kind, "roll", 0.01)
    assert np.abs(command.pose[:, 3]).max() == pytest.approx(0.01, rel=0.05)
    assert not np.delete(command.pose, 3, axis=1).any()
    assert abs(command.pose[-1, 3]) < (0.011 if kind == "step" else 1e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("step", "heave", None, 1.0), "a step has none"),
        (("sine", "heave", None, 0.0), "frequency: 0.0"),
        (("sine", "up"), "'up'"),
        (("square", "heave"), "'square' is not one of sine, step"),
        (("poses.csv", "heave", 1.0), "amplitude: 1 is not allowed"),
    ],
)
def test_manoeuvre_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        manoeuvre(*arguments)


@pytest.mark.parametrize("name", ["frames.csv", "frames.parquet"])
def test_frames_of_a_file_are_passed_through(tmp_path, name):
    time = np.arange(41) / 32.0
    motion = {dof: 0.01 * (i + 1) * np.sin(np.pi * time) ** 2 for i, dof in enumerate(DOFS)}
    write_table(pa.table({"time": time} | motion), tmp_path / name)
    command = manoeuvre(tmp_path / name, "heave")
    assert command.pose.shape == (2561, 6)
    np.testing.assert_allclose(command.pose[::64].T, list(motion.values()), atol=1e-12)


# The command


def test_command_writes_tables_and_figures(tmp_path: Path, drawn: dict[str, set[str]]) -> None:
    out = tmp_path / "out"
    arguments = ["--signal", "step", "--dof", "pitch", "--amplitude", "5 deg", "--cab", "ifd"]
    output = cmf("capacity", *arguments, "--dofs", "pitch", "--out", out)
    assert "supply holds" in output and "valve command" in output
    lines = [x for x in (out / "envelope.md").read_text().splitlines() if x[:1] == "|"]
    rows = [line.split(" | ") for line in lines[2:]]
    assert [float(row[1]) for row in rows] == list(FREQUENCIES)
    assert "True" in (out / "capacity.csv").read_text()
    assert set(drawn) == {"envelope.png"}


def test_command_says_no_and_takes_a_file(tmp_path: Path) -> None:
    """A file's manoeuvre with a criterion just under the set pressure."""
    path = tmp_path / "dive.csv"
    time = np.arange(161) / 32.0
    motion = dict.fromkeys(DOFS, 0.0 * time) | {"heave": 0.38 * np.sin(0.8 * np.pi * time) ** 3}
    write_table(pa.table({"time": time} | motion), path)
    arguments = ["--signal", path, "--least-pressure", 1490, "--dofs", "heave"]
    output = cmf("capacity", *arguments, "--out", tmp_path / "out")
    assert "NO" in output and "1490 psi" in output
