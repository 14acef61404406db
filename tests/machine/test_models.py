"""The compiled MJCF: sizes, masses, Appendix A to the inch, closed gimbals, sensors at rest.

Assertions are on the compiled models, which is what everything else reads.
"""

import mujoco
import numpy as np
import pytest

from cmf_mj.core import units
from cmf_mj.machine import kinematics, models
from cmf_mj.machine.machine import load_machine
from cmf_mj.plant.hexapod import Hexapod, hexapod_spec

LEGS = range(1, 7)

UPPER = np.array(
    [
        [91.30, 8.98, 0.05],
        [-37.87, 83.56, 0.05],
        [-53.43, 74.58, 0.05],
        [-53.43, -74.58, 0.05],
        [-37.87, -83.56, 0.05],
        [91.30, -8.98, 0.05],
    ]
)
"""Appendix A, matrix A [in], x forward, y right, z down."""

LOWER = np.array(
    [
        [66.17, 93.96, 133.08],
        [48.29, 104.29, 133.08],
        [-114.46, 10.33, 133.08],
        [-114.46, -10.33, 133.08],
        [48.29, -104.29, 133.08],
        [66.17, -93.96, 133.08],
    ]
)
"""Appendix A, matrix B [in]."""

POUNDS = {"gfd": 29920.0, "rfd": 32500.0, "ifd": 35950.0}
"""Platform and cab [lbm]: the two ends of the payload range (models/README.md) and one between."""


@pytest.fixture(scope="module")
def hexapod():
    return mujoco.MjModel.from_xml_path(str(models.model_path("scene.xml")))


@pytest.fixture(scope="module")
def single_legs():
    return mujoco.MjModel.from_xml_path(str(models.model_path("single_legs.xml")))


def at_keyframe(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


def gimbal_error(data):
    """Largest distance between the halves of a gimbal [m]."""
    return max(float(np.linalg.norm(data.sensor(f"gimbal_error_{i}").data)) for i in LEGS)


def some_poses():
    """Neutral, the twelve single-axis extremes and two mixed poses."""
    poses = [np.zeros(6)]
    for dof, limits in enumerate(kinematics.excursion_envelope()):
        for limit in limits:
            poses.append(np.eye(6)[dof] * limit)
    poses.append(np.array([0.3, -0.2, 0.25, 0.1, -0.15, 0.2]))
    poses.append(np.array([-0.4, 0.3, -0.2, -0.2, 0.1, -0.3]))
    return poses


# Sizes and steps


def test_sizes_step_and_gravity_without_friction(hexapod, single_legs):
    """Free joint and 3 joints a leg: 7 + 18 positions, 6 + 18 velocities, 6 motors. 2048 Hz
    (section 2.3.1); hydrostatic bearings, friction neglected (section 2.4.2)."""
    for model, sizes in ((hexapod, (25, 24, 6)), (single_legs, (6, 6, 6))):
        assert (model.nq, model.nv, model.nu) == sizes
        assert model.opt.timestep == 1.0 / 2048.0
        np.testing.assert_array_equal(model.opt.gravity, [0.0, 0.0, -9.80665])
        for field in ("dof_damping", "dof_frictionloss", "dof_armature", "jnt_stiffness"):
            assert not getattr(model, field).any()


def test_hexapod_has_six_degrees_of_freedom(hexapod):
    data = at_keyframe(hexapod)
    equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    jacobian = np.zeros((data.nefc, hexapod.nv))
    for row in range(data.nefc):
        unit = np.eye(data.nefc)[row]
        mujoco.mj_mulJacTVec(hexapod, data, jacobian[row], unit)
    assert equality.sum() == 18
    assert hexapod.nv - np.linalg.matrix_rank(jacobian[equality]) == 6


# Masses


@pytest.mark.parametrize("cab", models.CABS)
def test_nothing_but_bodies_carries_mass(cab):
    """Platform, cab and six legs of 450 kg: shapes are looks only."""
    model = hexapod_spec(cab).compile()
    total = POUNDS[cab] * units.POUND_MASS + 6 * 450.0
    assert abs(model.body_mass.sum() - total) < 1e-6


def test_single_legs_stand_still_at_the_keyframe(single_legs):
    """The keyframe's forces are the weights, to the nine digits of the mass."""
    data = at_keyframe(single_legs)
    np.testing.assert_allclose(data.qacc, 0.0, rtol=0.0, atol=1e-8)


# Geometry


def test_geometry_read_from_the_file_is_appendix_a():
    geometry = load_machine().geometry
    np.testing.assert_allclose(geometry.upper / units.INCH, UPPER, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(geometry.lower / units.INCH, LOWER, rtol=0.0, atol=1e-10)


def test_slides_run_along_the_legs_within_the_mechanical_stroke(hexapod, single_legs):
    """76 in of stroke about neutral (models/README.md)."""
    for model in (hexapod, single_legs):
        for leg in LEGS:
            joint = model.joint(f"leg_{leg}")
            assert joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
            np.testing.assert_array_equal(joint.axis, [0.0, 0.0, 1.0])
            np.testing.assert_allclose(
                joint.range / units.INCH, [-38.0, 38.0], rtol=0.0, atol=1e-12
            )


# Loading


@pytest.mark.parametrize("cab", models.CABS)
def test_cab_weighs_the_same_alone_and_on_the_machine(cab):
    alone = mujoco.MjModel.from_xml_path(str(load_machine().cabs[cab].mjcf)).body("cab")
    mounted = hexapod_spec(cab).compile().body("cab/cab")
    for name in ("mass", "ipos", "inertia", "iquat"):
        np.testing.assert_array_equal(getattr(mounted, name), getattr(alone, name))


def test_scene_file_carries_the_gfd(hexapod):
    mounted = hexapod_spec("gfd").compile()
    np.testing.assert_array_equal(hexapod.body_mass, mounted.body_mass)
    np.testing.assert_array_equal(hexapod.body_inertia, mounted.body_inertia)


# Gimbals


def test_gimbals_are_closed_wherever_the_machine_is_placed():
    plant = Hexapod()
    for pose in some_poses():
        plant.place(pose)
        assert gimbal_error(plant.data) < 1e-9


@pytest.mark.parametrize("cab", models.CABS)
def test_noise_raises_no_warning_and_opens_no_gimbal(cab):
    """One second of random leg forces, 30 kN about the static ones, new every 64 steps."""
    plant = Hexapod(cab)
    plant.place(np.zeros(6))
    still = plant.static_load()
    noise = np.random.default_rng(7).normal(0.0, 30e3, (32, 6))
    opened = 0.0
    for push in noise:
        plant.data.ctrl[:] = still + push
        for _ in range(64):
            mujoco.mj_step(plant.model, plant.data)
            opened = max(opened, gimbal_error(plant.data))
    assert opened < 10e-6
    assert [int(warning.number) for warning in plant.data.warning] == [0] * len(plant.data.warning)
    assert np.abs(plant.data.actuator_length).max() > 0.1  # it did move


# Sensors


def test_leg_sensors_are_zero_at_the_keyframe(hexapod, single_legs):
    for model in (hexapod, single_legs):
        data = at_keyframe(model)
        for leg in LEGS:
            assert data.sensor(f"leg_position_{leg}").data[0] == 0.0
            assert data.sensor(f"leg_velocity_{leg}").data[0] == 0.0


def test_accelerometers_at_rest_read_the_direction_cosine(hexapod):
    """Appendix C: 0.832 g along the leg at neutral; the report measured 0.86 g."""
    data = at_keyframe(hexapod)
    for _ in range(512):  # the soft gimbals take up the load
        mujoco.mj_step(hexapod, data)
    axial = [data.sensor(f"rod_acceleration_{i}").data[2] / units.STANDARD_GRAVITY for i in LEGS]
    np.testing.assert_allclose(axial, 0.832, rtol=1e-3, atol=0.0)
    whole = [np.linalg.norm(data.sensor(f"rod_acceleration_{i}").data) for i in LEGS]
    np.testing.assert_allclose(whole, units.STANDARD_GRAVITY, rtol=1e-6, atol=0.0)


def test_platform_sensors_at_rest(hexapod):
    data = at_keyframe(hexapod)
    for _ in range(512):
        mujoco.mj_step(hexapod, data)
    reading = data.sensor("platform_accelerometer").data
    np.testing.assert_allclose(reading, [0.0, 0.0, 9.80665], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(data.sensor("platform_gyro").data, 0.0, rtol=0.0, atol=1e-6)


def test_leg_sensors_read_the_kinematics():
    plant = Hexapod()
    for pose in some_poses():
        plant.place(pose)
        found = [plant.data.sensor(f"leg_position_{i}").data[0] for i in LEGS]
        expected = kinematics.pose_to_legs(pose)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


def test_keyframe_forces_hold_the_gfd(hexapod):
    """The file's forces, printed to 1e-6 N, are those of the mechanics."""
    plant = Hexapod("gfd")
    plant.place(np.zeros(6))
    forces = hexapod.key("home").ctrl
    np.testing.assert_allclose(forces, plant.static_load(), rtol=0.0, atol=1e-5)
