"""Failure study: every event against closed forms and bounds, on both hydraulic sets."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from shared import cmf

from cmf_mj import Hexapod, InputError, load_machine, simulate
from cmf_mj.cli.simulate import events_of
from cmf_mj.electronics.chain import load_electronics
from cmf_mj.facility.session import OutOfBounds
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.events import KINDS, default_event
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.signals.signal import Command
from cmf_mj.studies import failure as measures
from cmf_mj.studies.case import make_case
from cmf_mj.studies.failure import (
    FALL_RATIO,
    FailureResult,
    faded_sine,
    run_failure,
    run_failures,
)

FRAME = 1.0 / 2048.0
INCH, PSI, POUND, GRAVITY = 0.0254, 6894.757293168361, 4.4482216152605, 9.80665
ATMOSPHERE = 101325.0
AT = 2.0  #: The sine of 0.5 Hz is then at its largest speed, and faded in.
CAP, ROD = 23.758 * INCH**2, 11.965 * INCH**2
SUPPLY = 1500.0 * PSI
LEAK = 15.0 * 38 * INCH * (CAP + ROD) / (4 * 1e5 * PSI)
FULL_SPEED = 35.0 * INCH
SINGLE = ("valve_hard_over", "valve_jammed", "valve_dead")


@pytest.fixture(scope="module")
def hardware() -> dict[str, FailureResult]:
    events = [default_event(kind, AT) for kind in KINDS]
    events += [default_event(kind, AT, valve=1) for kind in SINGLE]
    return {r.label: r for r in run_failures(events, after=14.0, jobs=1)}


@pytest.fixture(scope="module")
def lossy() -> dict[str, FailureResult]:
    """To the stops where the legs go there alike or apart, the others for six seconds."""
    long = ("emergency_stop", "valve_hard_over")
    results = []
    for after, kinds in ((14.0, long), (6.0, [kind for kind in KINDS if kind not in long])):
        events = [default_event(kind, AT) for kind in kinds]
        lossy = make_case("velocity", hydraulics="lossy")
        results += run_failures(events, lossy, after=after, jobs=1)
    return {result.label: result for result in results}


@pytest.fixture(scope="module")
def unprotected() -> dict[str, FailureResult]:
    events = [default_event(kind, AT) for kind in KINDS]
    events.append(default_event("valve_hard_over", AT, valve=1))
    return {r.label: r for r in run_failures(events, after=6.0, protection=None, jobs=1)}


def physical(result: FailureResult, supply: float = SUPPLY) -> None:
    """Finite, never below vacuum, no water hammer beyond proof pressure, legs within stops."""
    record = result.record
    for name, values in record.channels.items():
        assert np.isfinite(values).all(), name
    assert result.message == "" and result.state != "out_of_bounds"
    assert -ATMOSPHERE < result.pressure_least.value
    assert result.pressure_peak.value < 6000.0 * PSI
    assert np.abs(record["leg_extension"]).max() < 39.0 * INCH
    assert record["gimbal_error"].max() < 50e-6
    assert result.supply_least.value <= supply


def test_every_event_stays_physical(hardware, lossy, unprotected) -> None:
    for results in (hardware, lossy, unprotected):
        assert {result.event.kind for result in results.values()} == set(KINDS)
        for result in results.values():
            physical(result)


def test_what_is_found_and_how_it_ends(hardware, lossy) -> None:
    faults = {
        "pump_lost": "under_pressure",
        "accumulator_lost": None,
        "supply_hose_burst": "under_pressure",
        "valve_hard_over-leg_1": "tracking_error",
        "valve_jammed-leg_1": "tracking_error",
        "valve_dead-leg_1": "tracking_error",
        "sensor_stuck-leg_1": "sensor_disagreement",
        "sensor_offset-leg_1": "sensor_disagreement",
        "sensor_open-leg_1": "sensor_disagreement",
        "overload": None,
        "emergency_stop": None,
    }
    settled = set(faults) - {"pump_lost", "accumulator_lost", "overload"}
    assert {name for name in faults if hardware[name].state == "settled"} == settled
    assert lossy["emergency_stop"].state == lossy["valve_hard_over-leg_1"].state == "settled"
    for results in (hardware, lossy):
        for name, fault in faults.items():
            late = results is lossy and name == "pump_lost"  # detected after eleven seconds
            assert results[name].detected_by == (None if late else fault), name
            assert (results[name].detection_time is None) == (results[name].detected_by is None)
        assert results["accumulator_lost"].state == "running"
        assert results["overload"].state == "running"
    # One valve of two: the other one keeps the leg within six inches, for a while.
    assert hardware["valve_jammed-leg_1-valve_1"].state == "degraded"
    assert hardware["valve_dead-leg_1-valve_1"].state in ("running", "degraded")


def test_without_protection_nothing_is_found(unprotected) -> None:
    for name, result in unprotected.items():
        assert result.detected_by is None and result.detection_time is None
        stopped = result.record["isolation"].max() > 0.0
        assert stopped == (name == "emergency_stop")


def test_before_the_event_all_runs_are_the_same(hardware, unprotected) -> None:
    one = hardware["pump_lost"]
    for results in (hardware, unprotected):
        for result in results.values():
            assert result.load.before == one.load.before
            assert result.acceleration.before == one.acceleration.before


# Emergency stop


def settle_speed(load: float) -> float:
    """Steady leg speed through the settle valve: Ac v = Gc sqrt(pc) + L (pc - pr) and the wide
    open rod side, Gc such that 7200 lbf sink at 4 in/s; hoses left out."""
    gain = 4.0 * INCH * CAP / np.sqrt(7200.0 * POUND / CAP)
    wide = 10.0 * gain * ROD / CAP

    def rod(cap: float) -> float:
        return (CAP * cap - load) / ROD

    def excess(cap: float) -> float:
        leak = LEAK * (cap - rod(cap))
        lowered = (gain * np.sqrt(cap) + leak) / CAP
        # Rounding may leave a trace of pressure where the upper bracket has none.
        filled = (wide * np.sqrt(max(-rod(cap), 0.0)) + leak) / ROD
        return lowered - filled

    cap = brentq(excess, 0.5 * load / CAP, load / CAP)
    return (gain * np.sqrt(cap) + LEAK * (cap - rod(cap))) / CAP


@pytest.mark.parametrize("name", ["emergency_stop", "sensor_offset-leg_1"])
def test_a_stopped_machine_settles_at_the_settle_speed(hardware, name: str) -> None:
    record = hardware[name].record
    plant = Hexapod()
    for after in (3.0, 5.0, 7.0):
        row = int((AT + after) * 256)
        plant.data.qpos[:] = record["generalised_position"][row]
        loads = plant.static_load()
        speed = -(record["leg_extension"][row + 8] - record["leg_extension"][row - 8]) / (16 / 256)
        expected = [settle_speed(load) for load in loads]
        np.testing.assert_allclose(speed, expected, rtol=0.02)


def test_a_settling_leg_meets_its_stop_at_the_settle_speed(hardware) -> None:
    """A chamber displaces 0.9 of its oil per travel at its stop, so 1 / 0.9 of the speed."""
    result = hardware["emergency_stop"]
    contact = result.contact_speed
    assert contact is not None and contact.value < FALL_RATIO * 4.0 * INCH
    plant = Hexapod()
    plant.data.qpos[:] = result.record["generalised_position"][int(contact.time * 256) - 2]
    load = plant.static_load()[contact.leg - 1]
    assert contact.value == pytest.approx(settle_speed(load) / 0.9, rel=0.03)


def test_cushions_slow_the_legs_at_their_stops(hardware, lossy) -> None:
    """A throttle of 10 % of the valves' opening at the stop."""
    soft, hard = (results["emergency_stop"].contact_speed for results in (lossy, hardware))
    assert soft.value < 0.6 * hard.value


def test_legs_on_their_stops_carry_the_platform(hardware) -> None:
    """Cylinder and stop together hold what the mechanics ask, however they share it."""
    record = hardware["emergency_stop"].record
    assert (record["leg_extension"][-1] < -37.9 * INCH).all()
    plant = Hexapod()
    plant.data.qpos[:] = record["generalised_position"][-1]
    np.testing.assert_allclose(record["axial_load"][-1], plant.static_load(), rtol=1e-3)
    assert np.abs(record["leg_force"][-1]).max() < 0.1 * record["axial_load"][-1].min()


# Supply


def test_accumulators_hold_for_what_their_gas_gives(hardware) -> None:
    """Oil above the precharge pressure by the gas law, drawn at Ac v out and Ar |v| in."""
    result = hardware["pump_lost"]
    record = result.record
    start = int(AT * 256)
    pressure = record["accumulator_pressure"][start]
    ratio = (1000.0 * PSI + ATMOSPHERE) / (pressure + ATMOSPHERE)
    delivered = 4 * 50.0 * 0.003785411784 * (1.0 - ratio ** (1.0 / 1.4))
    travel = np.diff(record["leg_extension"][start:], axis=0)
    drawn = np.cumsum((CAP * np.maximum(travel, 0) - ROD * np.minimum(travel, 0)).sum(axis=1))
    expected = np.searchsorted(drawn, delivered) / 256 + 20 * FRAME
    assert result.detection_time == pytest.approx(expected, rel=0.03)


def test_one_accumulator_lost_leaves_three(hardware) -> None:
    """They give more, at most a third more: what the falling pressure makes the pump give, and
    the run of the overload has four."""
    with_four, with_three = hardware["overload"], hardware["accumulator_lost"]
    rows = slice(int((AT + 2.0) * 256), int((AT + 10.0) * 256))
    swing = [np.ptp(r.record["accumulator_oil"][rows]) for r in (with_four, with_three)]
    assert 1.1 < swing[1] / swing[0] < 4.0 / 3.0
    assert with_three.supply_least.value < with_four.supply_least.value


def test_burst_hose_empties_the_manifold_through_its_orifice(hardware) -> None:
    """Q = 0.7 A sqrt(2 p / rho); the pump alone then holds p = rho / 2 (Qm / (0.7 A))^2."""
    record = hardware["supply_hose_burst"].record
    row, area = int(AT * 256) + 4, INCH**2
    energy = record["energy"][:, ENERGIES.index("burst")]
    pressure = record["supply_pressure"][row : row + 2].mean()
    flow = (energy[row + 1] - energy[row]) * 256 / (pressure - pressure**2 / (2e5 * PSI))
    assert flow == pytest.approx(0.7 * area * np.sqrt(2 * pressure / 870.0), rel=0.01)
    pumped = 400.0 * 0.003785411784 / 60.0
    alone = 870.0 / 2 * (pumped / (0.7 * area)) ** 2
    # The laminar share of the drop is s sqrt(p), 3 psi.
    laminar = np.sqrt(0.05 * PSI) * np.sqrt(alone)
    assert record["supply_pressure"][-1] == pytest.approx(alone + laminar, rel=0.005)


def test_burst_hose_is_no_free_fall(hardware) -> None:
    """Legs sink no faster than full valves let them, and touch down as in an emergency stop."""
    result = hardware["supply_hose_burst"]
    assert np.abs(result.record["leg_velocity"]).max() < FULL_SPEED
    stop = hardware["emergency_stop"]
    assert result.contact_speed.value == pytest.approx(stop.contact_speed.value, rel=0.01)


# Valves


def test_one_valve_hard_over_is_fought_by_the_other(unprotected) -> None:
    """Both fully open against each other: k / 2 (sqrt(Ps - p) - sqrt(p - Pt)) into each chamber,
    and leakage; hoses left out."""
    result = unprotected["valve_hard_over-leg_1-valve_1"]
    record = result.record
    row = int((AT + 5.0) * 256)
    assert record["valve_command"][row, 0] == -1.0
    high, low = record["supply_pressure"][row], record["return_pressure"][row]
    load = record["leg_force"][row, 0]
    half_gain = 0.5 * FULL_SPEED / np.sqrt(0.5 * SUPPLY)

    def inflow(pressure: float) -> float:
        return half_gain * (np.sqrt(high - pressure) - np.sqrt(pressure - low))

    def speeds(cap: float) -> tuple[float, float]:
        rod = (CAP * cap - load) / ROD
        leak = LEAK * (cap - rod)
        return inflow(cap) - leak / CAP, -inflow(rod) - leak / ROD

    least, most = ((load + ROD * rod) / CAP for rod in (low + 1.0, high - 1.0))
    cap = brentq(lambda p: np.subtract(*speeds(p)), least, min(most, high))
    speed = (record["leg_extension"][row + 8, 0] - record["leg_extension"][row - 8, 0]) * 16
    assert speed == pytest.approx(speeds(cap)[0], rel=0.03)
    assert 0.0 < result.load.free.value < CAP * SUPPLY


def test_hard_over_of_both_valves_is_found_at_leg_speed(hardware) -> None:
    """6 in at 35 in/s, spool lag and persistence; no sooner than demand and leg part at 60 in/s."""
    result = hardware["valve_hard_over-leg_1"]
    slowest = 6.0 / 35.0 + 3.0 / (2 * np.pi * 75.0) + 20 * FRAME
    assert 6.0 / 60.0 < result.detection_time < slowest
    assert abs(result.load.free.value) < CAP * SUPPLY


def test_a_dead_leg_is_a_water_hammer(unprotected) -> None:
    """Closing valves stop a moving leg: at most v sqrt(K M) more load, M its reflected mass."""
    result = unprotected["valve_dead-leg_1"]
    speed = np.abs(result.record["leg_velocity"][int(AT * 256), 0])
    plant = Hexapod()
    mass = plant.reflected_mass()[0, 0]
    stiffness = 1e5 * PSI * (CAP + ROD) / (38 * INCH)
    rise = result.load.free.value - result.load.before.value
    assert result.load.free.leg == 1 and result.load.free.time - AT < 0.1
    assert 0.3 < rise / (speed * np.sqrt(stiffness * mass)) < 1.0


# Sensors


def test_sensor_faults_are_found_within_their_persistence(hardware) -> None:
    """A jump at once, 4 frames in a row; a stuck sensor when the leg has gone on 0.25 in."""
    for name in ("sensor_offset-leg_1", "sensor_open-leg_1"):
        assert hardware[name].detection_time == pytest.approx(3 * FRAME, abs=1e-9)
    stuck = hardware["sensor_stuck-leg_1"]
    speed = abs(stuck.record["leg_velocity"][int(AT * 256), 0])
    expected = 0.25 * INCH / speed + 3 * FRAME
    assert stuck.detection_time == pytest.approx(expected, abs=3 * FRAME)


# Overload


def test_overload_is_carried_without_sag() -> None:
    """The integral takes the sag away; the legs share the weight over the cosine 0.832."""
    still = Command.from_pose(np.zeros((12 * 2048, 6)))
    event = default_event("overload", 1.0)
    result = run_failure(event, make_case("velocity_integral"), command=still)
    record = result.record
    assert np.abs(record["leg_extension"][-1]).max() < 20e-6
    rise = record["axial_load"][-1] - result.static_load
    assert rise.mean() == pytest.approx(10_000.0 * POUND / (6 * 0.832), rel=1e-3)
    assert result.state == "running" and result.acceleration.before.value < 1e-3


# What the crew feels


@pytest.mark.parametrize("dof", ["roll", "heave"])
def test_crew_acceleration_is_that_of_the_crew_point(dof: str) -> None:
    """Second difference of the point's path, rotation included; f = R'(a - g) at every row."""
    plant = Hexapod("ifd")
    command = faded_sine(dof, 0.08, 0.5, at=1.0, after=5.0)
    case = make_case("velocity", dof, cab="ifd")
    result = run_failure(default_event("accumulator_lost", 1.0), case, command=command)
    record = result.record
    qpos = record["generalised_position"]
    turn = Rotation.from_quat(qpos[:, 3:7].copy(), scalar_first=True)
    path = qpos[:, :3] + turn.apply(plant.model.site("cab/crew").pos)
    acceleration = np.diff(path, 2, axis=0) * 256**2
    rows = slice(300, 1400)
    largest = np.abs(acceleration[rows]).max()
    difference = record["crew_acceleration"][1:-1][rows] - acceleration[rows]
    assert largest > 0.3 and np.abs(difference).max() < 0.03 * largest


@pytest.mark.parametrize("cab", ["gfd", "rfd", "ifd"])
def test_crew_sits_in_the_cab(cab: str) -> None:
    """On the plane of symmetry, above the centre of mass; at rest the crew feels one g."""
    plant = Hexapod(cab)
    position = plant.model.site("cab/crew").pos
    assert position[1] == 0.0 and position[2] > plant.model.body("cab/cab").ipos[2]
    record = simulate(plant, "velocity", np.zeros((6144, 6)))
    np.testing.assert_allclose(record["crew_accelerometer"][-1], [0, 0, GRAVITY], atol=1e-3)
    assert record.units["crew_accelerometer"] == "m/s^2" and record.units["stop_force"] == "N"


# Interface


def at_rate(rate: int) -> Machine:
    """The CMF with control frames of another length."""
    hertz = {"value": rate, "unit": "Hz", "status": "assumed", "source": "a test"}
    slow = {"name": "slow", "cabs": {"deck": load_machine().cabs["gfd"].model_dump()}}
    table = load_machine().model_dump() | slow | {"control_rate": hertz}
    return Machine.model_validate(table)


@pytest.mark.parametrize("rate", [2048, 1000])
def test_a_state_beyond_its_bounds_is_told_not_lost(tmp_path: Path, rate: int) -> None:
    """Without gas in the oil a chamber torn open goes below vacuum."""
    quantity = '{ value = 0.0, unit = "1", status = "assumed", source = "no floor" }'
    file = tmp_path / "bare.toml"
    file.write_text(f'base = "hardware"\n[bare]\ncavitation_gas = {quantity}\n')
    event, machine = default_event("sensor_open", 1.0), at_rate(rate)
    case = make_case("velocity", hydraulics=file, machine=machine)
    result = run_failure(event, case, after=6.0)
    assert result.state == "out_of_bounds"
    assert "below vacuum" in result.message and "leg_" in result.message
    assert np.isfinite(result.load.after.value)
    command, plant = faded_sine("heave", 6 * INCH, 0.5, at=1.0, after=6.0), case.build()
    with pytest.raises(OutOfBounds, match="below vacuum") as error:
        simulate(plant, "velocity", command, events=[event], protection="default")
    assert result.record.time[-1] == pytest.approx(error.value.frame / rate, abs=9 / rate)


def test_a_slower_machine_falls_as_fast(hardware) -> None:
    """At 1000 frames a second legs meet their stops at the settle speed too: within 2 %."""
    case = make_case("velocity", machine=at_rate(1000))
    result = run_failure(default_event("emergency_stop", AT), case, after=14.0)
    usual = hardware["emergency_stop"].contact_speed.value
    assert result.contact_speed.value == pytest.approx(usual, rel=0.02)
    assert result.state == "settled"
    assert result.record.rate == 500.0


def test_an_event_before_the_motion_is_judged_by_the_motion_without_it() -> None:
    """At 0 s nothing has moved yet; poses stand in for the sine."""
    poses = faded_sine("heave", 6 * INCH, 0.5, at=0.0, after=6.0).pose
    result = run_failure(default_event("accumulator_lost", 0.0), command=poses)
    assert result.state == "running"


def test_a_machine_falls_and_follows_by_its_own_sizes() -> None:
    """The laboratory machine settles at 0.05 m/s: on its stops at 0.13 m/s it has fallen."""
    case = make_case("velocity", machine="lab")
    result = run_failure(default_event("emergency_stop", AT), case, after=14.0)
    assert result.state == "settled"
    plant, record = Hexapod(machine="lab"), result.record
    fast = measures.Peak(0.13, 3.0, 1)
    assert measures._final_state(record, plant, AT, 0.0, fast) == "fallen"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"after": 3.0}, "after: 3.0 s must be at least 4 s"),
        ({"amplitude": -1.0}, "amplitude: -1.0 must be a finite number greater than 0"),
        ({"amplitude": 1.2}, "heave: .* allowed"),
        ({"dof": "up"}, "dof: 'up' is not one of"),
        ({"command": Command.from_pose(np.zeros((512, 6)))}, "at: 1.0 s must be within"),
    ],
)
def test_refusals_of_a_manoeuvre(arguments: dict, message: str) -> None:
    options = {name: arguments.pop(name) for name in ("after", "command") if name in arguments}
    with pytest.raises(ValueError, match=message):
        run_failure(default_event("overload", 1.0), make_case("velocity", **arguments), **options)


def test_nothing_to_run_and_legs_without_a_platform_are_refused() -> None:
    with pytest.raises(InputError, match="events: is empty; name at least one event"):
        run_failures([])
    with pytest.raises(InputError, match="plant: 'single_legs' is not one of hexapod"):
        run_failure(default_event("overload", 1.0), make_case("velocity", plant="single_legs"))


def test_command_writes_table_csv_and_figure(tmp_path: Path, drawn: dict[str, set[str]]) -> None:
    out = tmp_path / "out"
    arguments = ["failure", "valve_hard_over", "--leg", "2", "--valve", "1", "--size", "-50 %"]
    arguments += ["--at", "1", "--after", "4", "--dof", "roll", "--no-protection"]
    assert "protection off" in cmf(*arguments, "--out", out)
    with (out / "failures.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["event"], row["leg"], row["valve"]) == ("valve_hard_over", "2", "1")
    assert float(row["size_si"]) == -0.5 and row["detected_by"] == ""
    assert row["protected"] == "False" and row["state"] in measures.__doc__
    assert "valve_hard_over leg_2 valve_1" in (out / "failures.md").read_text()
    assert set(drawn) == {"valve_hard_over-leg_2-valve_1.png"}


def test_all_is_every_kind_and_every_single_valve() -> None:
    events = events_of(list(KINDS), 0.5, 3, None, None)
    assert {event.kind for event in events} == set(KINDS)
    assert len(events) == len(KINDS) + len(SINGLE)
    assert {event.kind for event in events if event.valve == 1} == set(SINGLE)
    assert {event.leg for event in events} == {None, 3}
    assert {event.at for event in events} == {0.5}


def test_a_case_keeps_its_pose_electronics_and_delay() -> None:
    pose, noisy = (0.05, 0.0, -0.1, 0.0, 0.0, 0.0), load_electronics("noisy")
    case = make_case("velocity", pose=pose, electronics=noisy, command_delay=3)
    record = run_failure(default_event("valve_dead", 1.0), case, after=4.0).record
    np.testing.assert_allclose(record["demand_pose"][0], pose, atol=1e-12)
    assert record.metadata["command_delay"] == 3
    assert (
        record.metadata["electronics"]
        != run_failure(default_event("valve_dead", 1.0), after=4.0).record.metadata["electronics"]
    )
