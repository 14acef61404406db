"""Motion bases that stand on what yields: modes in heave against two masses on two springs."""

import mujoco
import numpy as np
import pytest
from scipy import linalg

from cmf_mj import Hexapod
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.plant import cylinder
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.yielding import Floor, on_floor, on_mounts

STEPS, RATE = 8192, 2048.0


@pytest.fixture
def lab() -> Hexapod:
    return Hexapod(machine="lab")


def oil(plant: Plant) -> float:
    """Stiffness of a leg's oil [N/m]."""
    numbers = plant.hydraulics
    found = cylinder.stiffness(numbers.cylinder, numbers.oil.bulk_modulus, np.zeros(6))
    return float(found[0])


def in_heave(plant: Plant) -> np.ndarray:
    """Mean extension of the legs after a push up, springs in the place of their oil (N,)."""
    plant.start()
    load, model = plant.static_load(), plant.model
    for number, force in enumerate(load, 1):
        joint = model.joint(f"leg_{number}")
        joint.stiffness[0] = oil(plant)
        model.qpos_spring[joint.qposadr[0]] = force / oil(plant)
    data = mujoco.MjData(model)
    push = model.body("platform").id, 2
    history = []
    for step in range(STEPS):
        data.xfrc_applied[push] = 1000.0 * (step < 8)
        mujoco.mj_step(model, data)
        history.append(data.actuator_length.mean())
    return np.array(history)


def lines(history: np.ndarray, expected: np.ndarray) -> list[float]:
    """Frequencies of the largest lines within a tenth of the expected ones [Hz]."""
    size = 2**18
    found = np.abs(np.fft.rfft((history - history.mean()) * np.hanning(history.size), size))
    frequency = np.fft.rfftfreq(size, 1.0 / RATE)
    near = [np.where(np.abs(frequency / one - 1.0) < 0.1, found, 0.0) for one in expected]
    return [float(frequency[np.argmax(one)]) for one in near]


def test_legs_are_springs_in_series_with_the_oil(lab: Hexapod) -> None:
    # T = (M - m) (s + y)'^2 / 2 + m s'^2 / 2,  U = K s^2 / 2 + k y^2 / 2  of a leg, m its rod.
    legs = pose_jacobian(np.zeros(6), lab.machine)[:, 2]
    mass, rod, stiffness = float(legs @ lab.reflected_mass() @ legs / (legs @ legs)), 6.0, 2e7
    masses = np.array([[mass, mass - rod], [mass - rod, mass - rod]])
    squares = linalg.eigh(np.diag([oil(lab), stiffness]), masses, eigvals_only=True)
    expected = np.sqrt(squares[:1]) / (2.0 * np.pi)
    assert expected[0] < 0.9 * np.sqrt(oil(lab) / mass) / (2.0 * np.pi)
    found = lines(in_heave(on_mounts(lab, stiffness)), expected)
    assert found == pytest.approx(expected, rel=3e-3)


def test_a_floor_adds_the_modes_of_two_masses_on_two_springs(lab: Hexapod) -> None:
    # T = (m + m_f) w'^2 / 2 + S w' h' + M h'^2 / 2,  U = k w^2 / 2 + K h^2 / 2: m the machine's, S
    # the momentum per speed of the legs and M their reflected mass on a floor at rest.
    legs, floor = pose_jacobian(np.zeros(6), lab.machine)[:, 2], Floor(mass=700.0, stiffness=8e6)
    mass = float(legs @ lab.reflected_mass() @ legs)
    lab.start()
    momentum = float(np.abs(lab.static_load() @ legs) / STANDARD_GRAVITY)
    masses = np.array([[floor.mass + lab.model.body_mass.sum(), momentum], [momentum, mass]])
    springs = np.diag([floor.stiffness, oil(lab) * float(legs @ legs)])
    expected = np.sqrt(linalg.eigh(springs, masses, eigvals_only=True)) / (2.0 * np.pi)
    found = lines(in_heave(on_floor(lab, floor)), expected)
    assert found == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("pose", [np.zeros(6), np.array([0.02, 0.0, -0.05, 0.1, 0.0, 0.0])])
def test_both_begin_with_the_forces_of_the_rigid_machine(lab: Hexapod, pose: np.ndarray) -> None:
    lab.start(pose)
    load = lab.static_load()
    for made in (on_floor(lab, Floor(mass=500.0, stiffness=3e7)), on_mounts(lab, 2e7)):
        made.start(pose)
        np.testing.assert_allclose(made.static_load(), load, rtol=1e-6)
