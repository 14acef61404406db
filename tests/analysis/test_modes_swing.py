"""The swing of each mode: legs within their stroke, gimbals closed."""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from shared import WORKING_STROKE

from cmf_mj import Hexapod
from cmf_mj.analysis.modes import largest_stroke, reserve, swinging
from cmf_mj.machine.kinematics import pose_to_legs

LEANING = np.array([0.05, -0.3, -0.5, -0.04, 0.11, -0.05])  #: A pose with a leg far out.


@pytest.fixture(scope="module")
def plant() -> Hexapod:
    return Hexapod("gfd")


def legs_of(plant: Hexapod, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Extensions by MuJoCo's slides, (n, 6)."""
    slides = [plant.model.joint(f"leg_{i}").qposadr[0] for i in range(1, 7)]
    return qpos[:, slides]


@pytest.mark.parametrize("mode", range(6))
@pytest.mark.parametrize("pose", [np.zeros(6), LEANING])
def test_the_room_of_a_mode_ends_at_the_working_stroke(
    plant: Hexapod, pose: NDArray[np.float64], mode: int
) -> None:
    """At its largest stroke one leg just reaches the working stroke."""
    modes = plant.hydraulic_modes(pose)
    most = largest_stroke(plant, modes, mode)
    time = np.arange(8) / (8.0 * modes.frequency_hz[mode])  # has the two ends of the motion in it
    legs = legs_of(plant, swinging(plant, modes, mode, time, stroke=most))
    assert np.abs(legs).max() == pytest.approx(WORKING_STROKE, abs=1e-9)
    assert np.abs(legs - legs[0]).max() == pytest.approx(most, abs=1e-9)


@pytest.mark.parametrize("pose", [np.zeros(6), LEANING])
def test_the_exaggerated_motion_keeps_every_gimbal_closed(
    plant: Hexapod, pose: NDArray[np.float64]
) -> None:
    """MuJoCo's residual of the 18 closures, through the largest swing of each mode."""
    modes = plant.hydraulic_modes(pose)
    for mode in range(6):
        most = largest_stroke(plant, modes, mode)
        time = np.arange(12) / (12.0 * modes.frequency_hz[mode])
        for qpos in swinging(plant, modes, mode, time, stroke=most):
            plant.data.qpos[:] = qpos
            mujoco.mj_forward(plant.model, plant.data)
            closures = plant.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY.value
            assert closures.sum() == 18
            assert np.abs(plant.data.efc_pos[closures]).max() < 1e-9


def test_the_legs_swing_as_the_equation_says(plant: Hexapod) -> None:
    """l = l0 + a s sin(2 pi f t), and for small a the platform follows the pose shape."""
    modes = plant.hydraulic_modes(LEANING)
    time, stroke = np.linspace(0.0, 0.3, 7), 1e-4
    for mode in range(6):
        scale = stroke / np.abs(modes.leg_shape[:, mode]).max()
        swung = scale * np.sin(2.0 * np.pi * modes.frequency_hz[mode] * time)[:, None]
        qpos = swinging(plant, modes, mode, time, stroke=stroke)
        rest = pose_to_legs(LEANING, plant.machine.geometry)
        legs = rest + swung * modes.leg_shape[:, mode]
        assert legs_of(plant, qpos) == pytest.approx(legs, abs=1e-10)
        moved = plant.pose_of(qpos) - LEANING
        straight = swung * modes.pose_shape[:, mode]
        assert moved == pytest.approx(straight, abs=2e-3 * np.abs(straight).max())


def test_a_pose_at_the_end_of_a_leg_has_no_room(plant: Hexapod) -> None:
    pose = np.array([0.0, 0.0, -1.1, 0.0, 0.0, 0.0])
    assert reserve(pose, plant) < 0.0
    modes = Hexapod("gfd").hydraulic_modes(np.zeros(6))._replace(pose=pose)
    with pytest.raises(ValueError, match=r"pose: leaves leg \d -0\.\d+ m of its working stroke"):
        largest_stroke(plant, modes, 0)
