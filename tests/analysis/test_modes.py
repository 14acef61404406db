"""Modes over the envelope: closed forms, the machine's symmetry, and a worst pose that is one."""

import csv
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cmf_mj import Hexapod
from cmf_mj.analysis import modes
from cmf_mj.analysis.modes import EnvelopeModes, over_envelope, sweep
from cmf_mj.cli.common import app
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_jacobian, pose_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant import cylinder

RAISED = np.array([0.1, -0.2, -0.3, 0.05, -0.1, 0.2])
MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


@pytest.fixture(scope="module")
def plant() -> Hexapod:
    return Hexapod("gfd")


@pytest.fixture(scope="module")
def envelope(plant: Hexapod) -> EnvelopeModes:
    return over_envelope(plant, samples=120, rounds=50)


def test_heave_at_neutral_is_all_legs_alike(plant: Hexapod) -> None:
    """Pure heave moves all legs alike: 1'M1 / 6. The mode has 2 % of pitch in it, within 1 %."""
    hydraulic = plant.hydraulic_modes()
    heave = int(np.argmax(hydraulic.share[2]))
    moving = float(hydraulic.reflected_mass.sum()) / 6.0
    assert hydraulic.leg_mass[heave] == pytest.approx(moving, rel=0.01)
    assert hydraulic.share[2, heave] > 0.97


def test_mirrored_poses_ring_alike(plant: Hexapod) -> None:
    """The machine is its own image in the vertical plane through x."""
    one, other = plant.hydraulic_modes(RAISED), plant.hydraulic_modes(RAISED * MIRROR)
    assert one.frequency_hz == pytest.approx(other.frequency_hz, rel=1e-6)


@pytest.mark.parametrize("dof", [0, 2])
def test_a_sweep_ends_where_a_limit_or_a_leg_does(plant: Hexapod, dof: int) -> None:
    along = sweep(plant, DOFS[dof], count=7)
    low, high = load_motion_limits().operational[dof]
    for place, excursion in enumerate(along.excursion):
        pose = excursion * np.eye(6)[dof]
        expected = plant.hydraulic_modes(pose).frequency_hz
        np.testing.assert_array_equal(along.frequency_hz[place], expected)
        room = min(float(modes.reserve(pose, plant)), excursion - low, high - excursion)
        assert room >= -1e-9
        if place in (0, 6):
            assert room == pytest.approx(0.0, abs=1e-9)
    assert along.excursion[3] == 0.0


def test_the_worst_pose_is_within_and_worst(plant: Hexapod, envelope: EnvelopeModes) -> None:
    low, high = load_motion_limits().operational.T
    worst = envelope.worst
    assert ((low <= worst.pose) & (worst.pose <= high)).all()
    assert modes.reserve(worst.pose, plant) >= 0.0
    other = modes.envelope_poses(plant, 150, seed=5)
    assert (low <= other).all() and (other <= high).all()
    lowest = [plant.hydraulic_modes(pose).frequency_hz[0] for pose in other]
    assert worst.frequency_hz[0] < min(lowest)
    assert worst.frequency_hz[0] < envelope.frequency_hz[:, 0].min()


def test_the_same_seed_finds_the_same_pose(plant: Hexapod, envelope: EnvelopeModes) -> None:
    again = over_envelope(plant, samples=120, rounds=50)
    np.testing.assert_array_equal(again.worst.pose, envelope.worst.pose)
    np.testing.assert_array_equal(again.frequency_hz, envelope.frequency_hz)
    assert all(modes.reserve(pose, plant) >= 0.0 for pose in (m.pose for m in again.modes))


def test_few_samples_are_refused(plant: Hexapod) -> None:
    with pytest.raises(ValueError, match="samples: 10 must be at least 90"):
        over_envelope(plant, samples=10)
    with pytest.raises(ValueError, match="count: 1 must be at least 2"):
        sweep(plant, "heave", count=1)


@pytest.mark.parametrize("pose", [np.zeros(6), RAISED])
def test_masses_and_shapes_solve_the_eigenvalue_problem(plant: Hexapod, pose: np.ndarray) -> None:
    """By hand, at a pose: M_leg s (2 pi f)^2 = K s; the platform moves as the legs do."""
    found, oil = plant.hydraulic_modes(pose), plant.hydraulics.oil.bulk_modulus
    legs = pose_to_legs(pose, plant.machine.geometry)
    spring = cylinder.stiffness(plant.hydraulics.cylinder, oil, legs)
    mass, jacobian = found.reflected_mass, pose_jacobian(pose, plant.machine.geometry)
    np.testing.assert_array_equal(mass, plant.reflected_mass(pose))
    for i, shape in enumerate(found.leg_shape.T):
        turned = (2.0 * np.pi * found.frequency_hz[i]) ** 2 * mass @ shape
        assert turned == pytest.approx(spring * shape, abs=1e-9 * np.abs(spring * shape).max())
        leg_mass = (shape @ mass @ shape) / (shape @ shape)
        assert found.leg_mass[i] == pytest.approx(leg_mass, rel=1e-9)
        assert jacobian @ found.pose_shape[:, i] == pytest.approx(shape, rel=1e-9, abs=1e-12)
        assert found.share[:, i].sum() == pytest.approx(1.0, abs=1e-9)


def test_the_command_writes_what_it_says(tmp_path: Path, drawn: dict[str, set[str]]) -> None:
    arguments = ["modes", "--cabs", "gfd", "--samples", "90", "--rounds", "5"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "39346" in done.output and "surge 92 %, pitch 8 %" in done.output
    with (tmp_path / "modes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 91
    pose = [float(rows[7][dof]) for dof in DOFS]
    expected = Hexapod("gfd").hydraulic_modes(pose).frequency_hz
    got = [float(rows[7][f"mode_{i}_hz"]) for i in range(1, 7)]
    assert got == pytest.approx(expected, rel=1e-4)
    assert set(drawn) == {"modes_sweep.png"}
    assert {"surge with pitch", "yaw", "heave", "roll with sway"} <= drawn["modes_sweep.png"]
    assert "| gfd | pitch with surge |" in (tmp_path / "modes.md").read_text()
