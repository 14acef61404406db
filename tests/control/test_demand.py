"""Demand of one frame, against complex steps, the array version and shifted gimbals."""

import numpy as np
import pytest

from cmf_mj import Hexapod, legs_to_pose, pose_to_legs
from cmf_mj.control import demand as block
from cmf_mj.machine.kinematics import geometry_about, leg_jacobian
from cmf_mj.machine.leg_motion import pose_motion_to_legs
from cmf_mj.machine.machine import load_machine

GEOMETRY = load_machine().geometry
RNG = np.random.default_rng(7)
SIZE = np.array([0.8, 0.8, 0.6, 0.4, 0.4, 0.5])
MOTIONS = RNG.uniform(-1.0, 1.0, (40, 3, 6)) * np.array([SIZE, 2.0 * SIZE, 8.0 * SIZE])


def frame(geometry, pose, velocity, acceleration):
    out = np.full((3, 6), np.nan)
    block.step(geometry, np.array([pose, velocity, acceleration]), out)
    return out


def turn(roll, pitch, yaw):
    """T of Eq 2.2 as a product of three elementary rotations; complex angles allowed."""
    cf, sf, ct, st = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cp, sp = np.cos(yaw), np.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cf, -sf], [0, sf, cf]])
    about_y = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
    about_z = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def lengths(upper, pose):
    """Pin-to-pin lengths (6,), analytic in a complex pose."""
    lines = pose[:3] + upper @ turn(*pose[3:]).T - GEOMETRY.lower
    return np.sqrt((lines * lines).sum(axis=1))


@pytest.mark.parametrize("motion", MOTIONS[:10])
def test_velocity_is_the_complex_step_of_the_length(motion):
    """Im l(x + i h v) / h with h = 1e-30 has no truncation and no cancellation."""
    pose, velocity, acceleration = motion
    found = frame(GEOMETRY, *motion)
    upper, neutral = GEOMETRY.upper, GEOMETRY.neutral
    np.testing.assert_allclose(found[0], lengths(upper, pose) - neutral, rtol=0, atol=1e-14)
    first = lengths(upper, pose + 1e-30j * velocity).imag / 1e-30
    np.testing.assert_allclose(found[1], first, rtol=0, atol=1e-13)


@pytest.mark.parametrize("motion", MOTIONS[:10])
def test_acceleration_is_the_complex_step_of_the_velocity(motion):
    """Along x(t) = x + v t + a t^2 / 2: central difference of the complex-step velocity, h = 1e-3
    with one Richardson step. Truncation of the order h^4 l^(6) / 30, below 1e-9; round-off 1e-12 /
    h."""
    pose, velocity, acceleration = motion
    upper = GEOMETRY.upper

    def rate(t):
        x, v = pose + velocity * t + acceleration * t * t / 2, velocity + acceleration * t
        return lengths(upper, x + 1e-30j * v).imag / 1e-30

    def central(h):
        return (rate(h) - rate(-h)) / (2 * h)

    second = (4 * central(5e-4) - central(1e-3)) / 3
    np.testing.assert_allclose(frame(GEOMETRY, *motion)[2], second, rtol=0, atol=2e-8)


def test_frame_and_history_agree():
    """Two derivations of the same motion: round-off of 10^2 m/s^2."""
    found = np.array([frame(GEOMETRY, *motion) for motion in MOTIONS])
    poses = np.ascontiguousarray(MOTIONS[:, 0])
    history = pose_motion_to_legs(poses, MOTIONS[:, 1], MOTIONS[:, 2])
    np.testing.assert_allclose(found[:, 0], pose_to_legs(poses), rtol=0, atol=1e-14)
    np.testing.assert_allclose(found[:, 1], history.velocity, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found[:, 2], history.acceleration, rtol=1e-12, atol=1e-12)


# Degrees of freedom about the static centre of mass

CENTRE = np.array([0.4, -0.1, -0.9])  #: r_cg of Eq 2.1 [m], platform axes.


@pytest.mark.parametrize("motion", MOTIONS[:10])
def test_a_demand_about_the_centre_of_mass_is_eq_2_1(motion):
    """Positions are |A - r + T'(c - B)| of Eq 2.1, c from where the centroid is at neutral. Rates
    are those of the centroid's motion p = c - T r, differentiated by complex steps."""
    pose, velocity, acceleration = motion
    found = frame(geometry_about(CENTRE), *motion)
    upper, lower, neutral = GEOMETRY
    matrix, centre = turn(*pose[3:]), CENTRE + pose[:3]
    lines = upper - CENTRE + (centre - lower) @ matrix
    np.testing.assert_allclose(found[0], np.linalg.norm(lines, axis=1) - neutral, atol=1e-14)

    def centroid(t, step=0.0):
        at = pose + velocity * t + acceleration * t * t / 2
        at = at + step * (velocity + acceleration * t)
        return np.concatenate([at[:3] + CENTRE - turn(*at[3:]) @ CENTRE, at[3:]])

    rates = [centroid(h, 1e-30j).imag / 1e-30 for h in (-1e-4, 0.0, 1e-4)]
    moved = centroid(0.0), rates[1], (rates[2] - rates[0]) / 2e-4
    other = frame(GEOMETRY, *moved)
    np.testing.assert_allclose(found[:2], other[:2], rtol=0, atol=1e-13)
    np.testing.assert_allclose(found[2], other[2], rtol=0, atol=1e-5)  # h^2 of the difference


def test_poses_about_the_centre_of_mass_come_back():
    poses = 0.5 * MOTIONS[:, 0]  # a stroke of less than a third of the neutral length
    legs = pose_to_legs(poses, geometry_about(CENTRE))
    np.testing.assert_allclose(legs_to_pose(legs, geometry_about(CENTRE)), poses, atol=1e-10)
    np.testing.assert_array_equal(
        pose_to_legs(poses, geometry_about(np.zeros(3))), pose_to_legs(poses)
    )


def test_about_the_centre_of_mass_force_and_moment_do_not_mix():
    """J' M_leg J at neutral has no block that couples them, but for the legs' own inertia."""
    plant = Hexapod()
    body = plant.model.body("platform").id
    plant.place(np.zeros(6))
    centre = plant.data.subtree_com[body] * np.array([1.0, -1.0, -1.0])

    def coupling(geometry):
        jacobian = leg_jacobian(np.zeros(6), geometry)
        return np.abs((jacobian.T @ plant.reflected_mass() @ jacobian)[:3, 3:]).max()

    payload = plant.model.body_subtreemass[body]
    assert coupling(GEOMETRY) > 0.3 * payload  # kg m: the centre is that far above
    assert coupling(geometry_about(centre)) < 0.1 * coupling(GEOMETRY)


def test_a_point_must_be_three_numbers():
    with pytest.raises(ValueError, match=r"point: shape is \(2,\); allowed: \(3,\)"):
        geometry_about([1.0, 2.0])
