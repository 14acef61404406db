"""Machines of any size: reflected mass, static forces and gimbals against independent formulas."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import cmf_mj
from cmf_mj import signals
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import DCL_INPUTS, closed_loop, dcl_state_space
from cmf_mj.analysis.modes import bound
from cmf_mj.control.dcl import DclState, make_dcl, step
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import load_law
from cmf_mj.control.protection import load_protection
from cmf_mj.control.states import State
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.electronics.sensors import SensorSettings
from cmf_mj.electronics.servo_electronics import ServoSettings
from cmf_mj.facility.host.stream import from_command
from cmf_mj.facility.host_chain import dcu_of
from cmf_mj.facility.operation import operate
from cmf_mj.facility.scenario import scenario_of
from cmf_mj.facility.signal_session import SignalSession
from cmf_mj.machine import models
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import paired_circles
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.plant.parameters import fitting, hydraulics_of
from cmf_mj.plant.single_legs import design_point
from tests.plant.test_hexapod import Rigid

GRAVITY = 9.80665


def turn(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Eq 2.2, by SciPy's rotations."""
    return np.asarray(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix())


def random_machine(generator: np.random.Generator) -> Machine:
    """A machine of 0.5 to 5 m, whose pairs are apart, with a cab off centre."""
    size = generator.uniform(0.3, 3.0)

    def stated(value: object, unit: str) -> dict[str, object]:
        return {"value": value, "unit": unit, "status": "assumed", "source": "drawn"}

    def body(mass: float, height: float) -> dict[str, object]:
        box = generator.uniform(0.5, 1.0, 3) * size
        moments = mass * (box @ box - box**2) / 12.0
        place = generator.uniform(-0.1, 0.1, 3) * size + [0.0, 0.0, height * size]
        return {
            "mass": stated(mass, "kg"),
            "centre_of_mass": stated(place.tolist(), "m"),
            "inertia": stated(moments.tolist(), "kg m^2"),
        }

    heavy = 1000.0 * size**3
    table = load_machine("lab").model_dump() | {
        "name": "drawn",
        "gimbals": {
            "upper_radius": stated(size, "m"),
            "upper_spacing": stated(generator.uniform(5.0, 30.0), "deg"),
            "lower_radius": stated(size * generator.uniform(1.0, 1.5), "m"),
            "lower_spacing": stated(generator.uniform(5.0, 30.0), "deg"),
            "height": stated(size * generator.uniform(1.2, 1.8), "m"),
            "forward": stated(generator.uniform(-180.0, 180.0), "deg"),
        },
        "legs": {
            "half_stroke": stated(0.3 * size, "m"),
            "working_stroke": stated(0.25 * size, "m"),
            "cylinder_mass": stated(0.02 * heavy, "kg"),
            "rod_mass": stated(0.01 * heavy, "kg"),
        },
        "hydraulics": {"base": "hardware"},
        "platform": body(0.3 * heavy, 0.1),
        "cabs": {"drawn": body(heavy, 0.6) | {"station": stated([0.0, 0.0, size], "m")}},
    }
    return Machine.model_validate(table)


def check_model(plant: cmf_mj.Hexapod, pose: NDArray[np.float64]) -> None:
    """Masses of the legs are those of the file, bars of the retracted length; payload, reflected
    mass and static forces at a pose are those of rigid bodies."""
    machine, cab = plant.machine, plant.cab_parameters
    assert cab is not None
    bar = machine.retracted
    across = (3.0 * (bar / 40.0) ** 2 + bar**2) / 12.0
    for leg, length in enumerate(machine.geometry.neutral, start=1):
        for kind, mass, centre in (
            ("cylinder", cab.legs.cylinder_mass.si, 0.5 * bar),
            ("rod", cab.legs.rod_mass.si, length - 0.5 * bar),
        ):
            body = plant.model.body(f"{kind}_{leg}")
            assert body.mass[0] == pytest.approx(mass, rel=1e-12)
            assert body.ipos == pytest.approx([0.0, 0.0, centre], rel=1e-12)
            assert body.inertia[0] == pytest.approx(mass * across, rel=1e-12)
    for name, part in (("platform", cab.platform), ("cab/cab", cab)):
        assert plant.model.body(name).mass[0] == pytest.approx(part.mass.si, rel=1e-12)
        assert plant.model.body(name).ipos == pytest.approx(part.centre_of_mass.si, rel=1e-12)
        moments = np.linalg.eigvalsh(part.tensor)  # its axes are checked as the plant is made
        assert np.sort(plant.model.body(name).inertia) == pytest.approx(moments, rel=1e-12)
    rigid, found = Rigid(plant, pose), plant.reflected_mass(pose)
    assert np.abs(found - rigid.reflected).max() < 1e-6 * np.abs(found).max()
    size = np.abs(rigid.forces).max()
    np.testing.assert_allclose(plant.static_load(), rigid.forces, rtol=0, atol=1e-9 * size)


def test_reflected_mass_and_static_forces_of_fifty_machines() -> None:
    """J^-T M J^-1 and the legs' static forces, each at a pose of its own."""
    generator = np.random.default_rng(21)
    for _ in range(50):
        cab = load_cab(None, random_machine(generator))
        pose = generator.uniform(-0.1, 0.1, 6)
        pose[:3] *= cab.machine.half_stroke
        check_model(cmf_mj.Hexapod(cab), pose)


@pytest.mark.parametrize("name", ["simona", "lab"])
def test_a_run_keeps_the_gimbals_closed_and_follows(name: str) -> None:
    """Within 10 um; 4 s after a step the platform is where it is asked, within 5 %."""
    machine = load_machine(name)
    plant = cmf_mj.Hexapod(machine=machine)
    size = 0.2 * machine.working_stroke
    command = signals.step("heave", size, duration=4.0)
    record = cmf_mj.simulate(plant, machine.law, command, record_every=16)
    assert record["gimbal_error"].max() < 1e-5
    assert record["platform_pose"][-1, 2] == pytest.approx(size, rel=0.05)
    assert record.metadata["machine"] == name


@pytest.mark.parametrize("name", ["simona", "lab"])
def test_the_law_that_a_machine_ships_with_is_stable(name: str) -> None:
    """All poles of the loop in six degrees of freedom lie inside, with every cab."""
    machine = load_machine(name)
    law = load_law(machine.law)
    assert f"cmf tune --machine {name} " in law.source
    for cab in machine.cabs:
        plant = cmf_mj.Hexapod(load_cab(cab, machine))
        taken = bound(law, plant)
        assert taken.machine == machine and taken.bound_modes is not None
        assert np.abs(closed_loop(taken, linearize(plant)).poles()).max() < 1.0


def test_a_law_counts_with_the_legs_of_its_machine() -> None:
    """A force gain of 1 %/lbf acts on the annulus, the demand ends at the working stroke, and load
    feedback weighs the pressures with the areas of the two sides."""
    table = {
        "title": "t",
        "direct_gain": {"force": 1.0, "reference": 1.0},
        "load_feedback": {"gain": 1.0, "corner": 1.0},
    }
    for name in ("cmf", "simona", "lab"):
        machine = load_machine(name)
        hydraulics = hydraulics_of(machine)
        sizes = machine.leg_sizes
        assert sizes.cap_area == pytest.approx(hydraulics.cap_area, rel=1e-12)
        assert sizes.rod_area == pytest.approx(hydraulics.rod_area, rel=1e-12)
        law = bound(load_law(table), cmf_mj.SingleLegs(machine=machine))
        gain = dict(zip(DCL_INPUTS, dcl_state_space(law).D[0], strict=True))
        newton = 0.01 / 4.4482216152605
        cap = (sizes.force_area - 1e-3 * sizes.cap_area) * newton
        assert gain["cap_pressure"] == pytest.approx(cap, rel=1e-9)
        dcl = make_dcl(law, 1)
        still = LegFeedback(*np.zeros((5, 1)))
        step(dcl, DclState.zeros(1), np.array([9.0]), still)
        assert dcl.workspace.limited_demand[0] == machine.working_stroke


def test_ranges_and_thresholds_go_with_the_machine(tmp_path: Path) -> None:
    """Sensors read to the ends of the legs, converters and switches likewise; what a file states
    stays; the CMF has its own settings to the bit."""
    own = tmp_path / "own.toml"
    own.write_text(
        'base = "noisy"\n[own]\nleg_position = { highest = '
        '{ value = 1.0, unit = "m", status = "stated", source = "test" } }\n'
    )
    assert fitting(load_machine()) is None
    for name in ("simona", "lab"):
        machine = load_machine(name)
        parts = ElectronicsSettings(sensors=str(own)).of(machine)
        assert isinstance(parts.sensors, SensorSettings)
        assert isinstance(parts.servo, ServoSettings)
        lowest, highest = parts.sensors.leg_position.lowest, parts.sensors.leg_position.highest
        assert lowest is not None and highest is not None and highest.si == 1.0
        assert lowest.si == pytest.approx(-machine.half_stroke)
        switch = parts.servo.switch_position.si
        assert switch == pytest.approx(37.7 / 38.0 * machine.half_stroke)
        under = load_protection("default", fitting(machine)).under_pressure.threshold.si
        assert under == pytest.approx(hydraulics_of(machine).supply_pressure.si / 1.5)


def test_the_dcu_of_a_machine_is_used(tmp_path: Path) -> None:
    dcu = tmp_path / "dcu.toml"
    dcu.write_text('[delay]\ntransmission = { value = 9, unit = "1", status = "stated", ')
    with dcu.open("a") as file:
        file.write('source = "test" }\n')
    machine = load_machine("lab").model_copy(update={"name": "mine", "dcu": str(dcu)})
    assert dcu_of(machine).delay.transmission.value == 9
    assert dcu_of(machine, "default").delay.transmission.value != 9


def test_edited_gimbals_count_everywhere() -> None:
    """Upper gimbal 1 moved 40 mm aside and 20 mm up: leg references behind the DCU, platform poses
    and reflected mass are those of independent kinematics of the edited gimbals."""
    lab = load_machine("lab")
    shape = lab.geometry
    upper = shape.upper + [[0.0, 0.04, -0.02], *[[0.0, 0.0, 0.0]] * 5]
    known = {"unit": "m", "status": "assumed", "source": "edited"}
    gimbals = {
        name: {"value": (points * [1.0, -1.0, -1.0]).tolist(), **known}
        for name, points in (("upper", upper), ("lower", shape.lower))
    }
    machine = Machine.model_validate(
        lab.model_dump() | {"name": "edited", "gimbals": gimbals, "law": "original"}
    )

    def legs(pose: NDArray[np.float64]) -> NDArray[np.float64]:
        ends = pose[:3] + upper @ turn(*pose[3:]).T - shape.lower
        return np.linalg.norm(ends, axis=1) - np.linalg.norm(upper - shape.lower, axis=1)

    pose = np.array([0.05, -0.02, 0.03, 0.04, -0.05, 0.06])
    np.testing.assert_allclose(pose_to_legs(pose, machine), legs(pose), rtol=0, atol=1e-12)
    assert np.abs(legs(pose) - pose_to_legs(pose, "lab")).max() > 1e-4
    np.testing.assert_allclose(legs_to_pose(legs(pose), machine), pose, rtol=0, atol=1e-9)
    plant = cmf_mj.Hexapod(machine=machine)
    check_model(plant, pose)
    stream = from_command(signals.step("roll", 0.1, duration=3.0), 80.0)
    record = operate(plant, machine.law, stream).record
    begun = operate(plant, machine.law, stream, begin=State.OFF).record["leg_reference"][0]
    np.testing.assert_allclose(begun, -machine.working_stroke, rtol=0, atol=1e-12)
    wanted = legs(np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]))
    np.testing.assert_allclose(record["leg_reference"][-1], wanted, rtol=0, atol=1e-9)
    every = slice(None, None, 500)
    moved = np.array([legs(row) for row in record["platform_pose"][every]])
    np.testing.assert_allclose(record["leg_extension"][every], moved, rtol=0, atol=1e-5)
    assert record["gimbal_error"].max() < 1e-5


def test_a_session_runs_a_machine_with_edited_gimbals(tmp_path: Path) -> None:
    """What it shows of a run in progress has the legs of the machine's file."""
    text = (models.directory() / "machines" / "simona.toml").read_text("utf-8")
    text = text.replace('"simona"', '"wide"', 1).replace("laws/simona.toml", "velocity")
    text = text.replace("upper_radius = { value = 1.6", "upper_radius = { value = 1.5")
    (file := tmp_path / "wide.toml").write_text(text)
    signal = {"kind": "step", "dof": "yaw", "amplitude": 0.1, "at": 0.1}
    run = SignalSession(scenario_of({"machine": str(file), "signal": [signal]}, "test"))
    run.run(500)
    shape = paired_circles((1.5, np.radians(7.166644)), (1.65, np.radians(20.951369)), 2.39)
    before, after = (
        np.linalg.norm(shape[0] @ turn(0.0, 0.0, yaw).T - shape[1], axis=1) for yaw in (0.0, 0.1)
    )
    np.testing.assert_allclose(run.memory.reference, after - before, rtol=0, atol=1e-9)


def test_the_design_point_of_single_legs() -> None:
    """Stated for the CMF; the formula gives its 7200 lbm too. Six equal legs carry the weight."""
    cmf = load_machine()
    assert design_point(cmf).effective_mass == pytest.approx(7200 * 0.45359237)
    derived = cmf.model_copy(update={"single_leg": type(cmf.single_leg)()})
    assert design_point(derived).effective_mass == pytest.approx(7199.5 * 0.45359237, rel=1e-5)
    assert design_point(derived).static_load == pytest.approx(5991.79 * 4.4482216, rel=1e-6)
    with pytest.raises(ValueError, match="static_load: nan N must be finite"):
        cmf_mj.SingleLegs(static_load=np.nan)
    with pytest.raises(ValueError, match="effective_mass: inf kg"):
        cmf_mj.SingleLegs(effective_mass=np.inf)
    for name in ("simona", "lab"):
        cab = load_cab(None, name)
        shape = cab.machine.geometry
        upward = float((shape.lower[0, 2] - shape.upper[0, 2]) / shape.neutral[0])
        point, mass = design_point(cab.machine), cab.payload.mass
        assert point.static_load == pytest.approx(mass * GRAVITY / (6 * upward))
        legs = cmf_mj.SingleLegs(machine=name)
        assert legs.reflected_mass() == pytest.approx(point.effective_mass * np.eye(6))
        assert point.effective_mass == pytest.approx(mass / (6 * upward**2))
