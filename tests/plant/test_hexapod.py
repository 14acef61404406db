"""The hexapod plant: reflected mass, static forces and modes against algebra of our own.

The oracle `Rigid` knows no joints and no constraints: it adds up the kinetic and the potential
energy of platform, cab, cylinders and rods for a twist of the platform. Only masses, centres of
mass and moments are read from the compiled model.
"""

import mujoco
import numpy as np
import pytest
from hydraulic_equations import changed
from scipy.spatial.transform import Rotation

from cmf_mj import Hexapod, SingleLegs, load_law, simulate
from cmf_mj.core import units
from cmf_mj.machine import kinematics, models
from cmf_mj.machine.cab import load_cab
from cmf_mj.plant import cylinder
from tests.plant.test_hexapod_cab import odd

GRAVITY = np.array([0.0, 0.0, 9.80665])  # z down
FLIP = np.array([1.0, -1.0, -1.0])
NEUTRAL = np.zeros(6)
POSES = [
    NEUTRAL,
    np.array([0.3, -0.2, 0.25, 0.1, -0.15, 0.2]),
    np.array([-0.5, 0.4, -0.3, -0.2, 0.1, -0.3]),
    np.array([0.1, 0.6, 0.4, 0.05, 0.2, 0.1]),
]


def cross(vector):
    """[v x], so that [v x] w = v x w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


class Rigid:
    """Reflected mass and static leg forces by adding up rigid bodies, report axes."""

    def __init__(self, plant, pose):
        """Place the bodies at a pose.

        A leg of length l and direction n, whose upper gimbal moves with u = v + w x a = G (v, w),
        has n' = (I - n n') u / l. Its cylinder's centre moves with r n', its rod's, at s = l - d,
        with n (n . u) + s n'. Its turning about its own axis is left out: 3.5 kg m^2 on a
        lever of 4 m.
        """
        model, geometry = plant.model, plant.machine.geometry
        turn = Rotation.from_euler("ZYX", pose[:2:-1]).as_matrix()
        self.mass = np.zeros((6, 6))
        self.wrench = np.zeros(6)
        """Upward force and its moment about the centroid that the legs must supply."""
        self.jacobian = np.zeros((6, 6))
        for name in ("platform", "cab/cab"):
            body = model.body(name)
            axes = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
            inertia = FLIP[:, None] * (axes * body.inertia) @ axes.T * FLIP
            self._add(body.mass[0], np.hstack([np.eye(3), -cross(turn @ (body.ipos * FLIP))]))
            self.mass[3:, 3:] += turn @ inertia @ turn.T
        for leg in range(6):
            tube, rod = model.body(f"cylinder_{leg + 1}"), model.body(f"rod_{leg + 1}")
            arm = turn @ geometry.upper[leg]
            line = pose[:3] + arm - geometry.lower[leg]
            length = np.linalg.norm(line)
            n = line / length
            gimbal = np.hstack([np.eye(3), -cross(arm)])
            along = np.outer(n, n)
            turning = (np.eye(3) - along) @ gimbal / length
            reach = length - geometry.neutral[leg] + rod.ipos[2]
            self._add(tube.mass[0], tube.ipos[2] * turning)
            self._add(rod.mass[0], along @ gimbal + reach * turning)
            self.mass += (tube.inertia[0] + rod.inertia[0]) * turning.T @ turning
            self.jacobian[leg] = n @ gimbal

    def _add(self, mass, velocity):
        self.mass += mass * velocity.T @ velocity
        self.wrench -= mass * velocity.T @ GRAVITY

    @property
    def reflected(self):
        """J^-T M J^-1 [kg]."""
        inverse = np.linalg.inv(self.jacobian)
        return inverse.T @ self.mass @ inverse

    @property
    def forces(self):
        """Leg forces f [N] of J' f = wrench."""
        return np.linalg.solve(self.jacobian.T, self.wrench)


@pytest.fixture(scope="module", params=models.CABS)
def plant(request):
    return Hexapod(request.param)


@pytest.fixture(scope="module", params=[*models.CABS, odd()], ids=[*models.CABS, "odd"])
def any_cab(request):
    return Hexapod(request.param)


@pytest.fixture(scope="module")
def gfd():
    return Hexapod("gfd")


SEALED = changed("hardware", leak_rate=0.0)  #: Without leakage, the only loss of a closed valve.

NO_COMMAND = load_law({"name": "nothing", "title": "No command", "direct_gain": {}})


def massless(cab):
    """The machine with a cab and legs of next to no mass."""
    return Hexapod(load_cab(cab).changed("massless legs", leg_mass_factor=1e-9))


# Reflected mass


@pytest.mark.parametrize("pose", POSES)
def test_reflected_mass_agrees_with_rigid_body_algebra(any_cab, pose):
    """1e-5: the spin left out is 1e-6; where the legs cannot spin, at neutral, round-off is left.
    Symmetric, positive definite."""
    mass, expected = any_cab.reflected_mass(pose), Rigid(any_cab, pose).reflected
    size = np.abs(expected).max()
    assert np.abs(mass - expected).max() < (1e-5 if pose.any() else 1e-8) * size
    np.testing.assert_allclose(mass, mass.T, rtol=0.0, atol=1e-9 * size)
    assert np.linalg.eigvalsh(mass).min() > 0.0


@pytest.mark.parametrize("cab", models.CABS)
def test_heave_effective_mass_of_massless_legs(cab):
    """M / (6 cos^2) a leg, all legs equal; 7200 lbm for 29 920 lbm."""
    plant = massless(cab)
    payload = plant.model.body("platform").mass[0] + plant.model.body("cab/cab").mass[0]
    effective = plant.reflected_mass().sum() / 6.0
    geometry = plant.machine.geometry
    cosine = np.mean((geometry.lower - geometry.upper)[:, 2] / geometry.neutral)
    # Appendix A's rounding makes the six cosines differ by 1e-5.
    assert abs(effective / (payload / (6.0 * cosine**2)) - 1.0) < 1e-4


# Static forces


@pytest.mark.parametrize("pose", POSES)
def test_static_leg_forces_balance_the_weights(any_cab, pose):
    """J' f: the vertical parts carry the weight, nothing pushes sideways, no moment is left."""
    any_cab.place(pose)
    rigid, found = Rigid(any_cab, pose), any_cab.static_load()
    np.testing.assert_allclose(found, rigid.forces, rtol=1e-9, atol=0.0)
    wrench, weight = rigid.jacobian.T @ found, -rigid.wrench[2]
    np.testing.assert_allclose(wrench, rigid.wrench, rtol=0.0, atol=1e-9 * weight)


def test_massless_ifd_loads_each_leg_with_the_design_load():
    """35 950 lbm gives W / (6 cos) at the mean inclination, 7200 lbf (section 2.4.2), shared
    unevenly by less than 1 lbf."""
    plant = massless("ifd")
    plant.place(NEUTRAL)
    found, geometry = plant.static_load() / units.POUND_FORCE, plant.machine.geometry
    np.testing.assert_allclose(found, 7200.0, rtol=0.0, atol=1.0)
    cosine = ((geometry.lower - geometry.upper)[:, 2] / geometry.neutral).mean()
    assert found.mean() == pytest.approx(35950.0 / (6 * cosine), rel=1e-4)


def test_start_pressures_carry_the_static_forces(plant):
    state = plant.start(POSES[1])
    found = [
        cylinder.force(one, *pressure)
        for one, pressure in zip(plant.hydraulics.cylinder, state.pressure, strict=True)
    ]
    np.testing.assert_allclose(found, plant.static_load(), rtol=1e-12, atol=0.0)
    np.testing.assert_array_equal(state.spool, 0.0)
    np.testing.assert_array_equal(state.drive, 0.0)


# Modes


def test_heave_frequency_of_massless_legs_is_the_single_leg_mode():
    """Eq 4.1: 71.00 rad/s for 7200 lbm; 29 920 lbm puts heave at exactly 11.30 Hz."""
    modes = massless("gfd").hydraulic_modes()
    heave = np.abs(modes.leg_shape.sum(axis=0)).argmax()
    # The cab's centre of mass, 0.1 m forward, couples heave and pitch a little: 0.2 %.
    assert abs(modes.frequency[heave] / 71.00 - 1.0) < 5e-3


# Equilibrium and placing


@pytest.mark.parametrize("pose", POSES[:2])
def test_start_is_in_equilibrium(pose):
    """Two seconds without a command, valves closed, no leakage.

    The soft gimbals give by 0.02 micrometres as they take up the load (models/README.md) and the
    undamped oil rings about that: at most twice 0.02, over the direction cosine 0.83, at the
    platform. On average nothing moves a leg by 0.01 micrometres.
    """
    record = simulate(Hexapod("gfd", SEALED), NO_COMMAND, np.tile(pose, (4096, 1)))
    assert not record["valve_command"].any() and not record["valve_opening"].any()
    assert np.abs(record["platform_pose"] - pose).max() < 5e-8
    drift = record["leg_position"][-1024:].mean(axis=0) - kinematics.pose_to_legs(pose)
    assert np.abs(drift).max() < 1e-8


@pytest.mark.parametrize("pose", POSES[:2])
def test_single_legs_start_in_equilibrium(pose):
    """No gimbals to give: nothing moves at all."""
    record = simulate(SingleLegs(SEALED), NO_COMMAND, np.tile(pose, (4096, 1)))
    moved = record["leg_position"] - kinematics.pose_to_legs(pose)
    assert np.abs(moved).max() < 1e-12


def test_pose_of_undoes_place(plant):
    rng = np.random.default_rng(0)
    for _ in range(50):
        pose = rng.uniform(-1.0, 1.0, 6) * [0.3, 0.3, 0.2, 0.1, 0.1, 0.2]
        plant.place(pose)
        np.testing.assert_allclose(plant.pose_of(plant.data.qpos), pose, rtol=0.0, atol=1e-12)


# Refusals


def test_refused_cabs_and_poses_are_named(gfd):
    with pytest.raises(ValueError, match="cab: 'bus' is not one of gfd, rfd, ifd"):
        Hexapod("bus")
    for pose, words in (
        ([0.0, 0.0, -2.0, 0.0, 0.0, 0.0], r"puts leg \d at -?\d\.\d+ m; allowed: \+-0\.9652"),
        (np.zeros(5), "shape"),
        (np.zeros((2, 6)), "shape"),
    ):
        with pytest.raises(ValueError, match=f"pose: {words}"):
            gfd.place(pose)
    with pytest.raises(ValueError, match=r"pose\[2\]: nan is not a finite number"):
        gfd.place([0.0, 0.0, np.nan, 0.0, 0.0, 0.0])


# One contract


def test_both_plants_record_the_same_channels(gfd):
    command = np.zeros((32, 6))
    hexapod = simulate(gfd, "velocity", command)
    single = simulate(SingleLegs(), "velocity", command)
    own = {*gfd.sensors, "platform_pose"}
    assert set(hexapod.channels) - own == set(single.channels)
    assert own <= set(hexapod.channels) and own.isdisjoint(single.channels)
    assert {n: hexapod.units[n] for n in single.units} == dict(single.units)
    for name in set(single.channels) - {"generalised_position"}:
        assert hexapod[name].shape == single[name].shape
    assert set(hexapod.metadata) == set(single.metadata)


def test_single_legs_carry_the_design_point_or_any_load():
    """7200 lbf and 7200 lbm a leg (section 4.1), wherever the legs stand; more than their weight,
    or a pull, too. 4000 N more than the load move 4000 kg by 1 m/s^2."""
    for load in (None, -70e3, 0.0, 1e3, 32e3, 150e3):
        single = SingleLegs(effective_mass=4000.0 if load else None, static_load=load)
        expected = 7200.0 * units.POUND_FORCE if load is None else load
        for pose in POSES[:2]:
            single.start(pose)
            np.testing.assert_allclose(single.static_load(), expected, rtol=1e-9, atol=1e-9)
    single.data.ctrl[:] = 154e3
    mujoco.mj_forward(single.model, single.data)
    np.testing.assert_allclose(single.data.qacc, 1.0, rtol=1e-12, atol=0.0)
