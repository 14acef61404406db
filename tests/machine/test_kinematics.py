"""Kinematics: the machine's published numbers, inverse of forward, Jacobians, symmetry, refusals.

Oracles: Appendix A and Table 2-1 of the report; excursions worked out from Appendix A,
computed apart from this code.
"""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shared import WORKING_STROKE

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine import kinematics
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.machine import load_machine

POSE_UNITS = np.array([units.INCH] * 3 + [units.DEGREE] * 3)
MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
SOME_POSES = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.3, -0.2, 0.25, 0.1, -0.15, 0.2],
        [-0.5, 0.4, -0.3, -0.2, 0.1, -0.3],
        [0.1, 0.9, 0.5, 0.05, 0.2, 0.1],
    ]
)


def single(dof, excursion):
    pose = np.zeros(6)
    pose[DOFS.index(dof)] = excursion
    return pose


def poses_within(travel, seed, draws, reach):
    """Random poses, all six axes at once, whose legs lie within the travel; never a handful."""
    poses = np.random.default_rng(seed).uniform(-1.0, 1.0, (draws, 6)) * reach
    inside = (np.abs(pose_to_legs(poses)) <= travel).all(axis=1)
    assert inside.sum() > 1000
    return poses[inside]


def legs_of_the_envelope():
    """All 64 corners of the leg box of +-37.5 in, then random points of it, many near its faces."""
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=6)))
    inner = np.random.default_rng(3).uniform(-1.0, 1.0, (1000, 6))
    inner[::2] = np.sign(inner[::2]) * np.abs(inner[::2]) ** 0.1
    return WORKING_STROKE * np.concatenate([corners, inner])


def one_by_one(legs):
    return np.array([legs_to_pose(row) for row in legs])


# Published numbers


def test_neutral_pin_to_pin_length():
    """159.845 in. Appendix A rounds to 0.01 in, a length thus to about 0.005 in."""
    lengths = load_machine().geometry.neutral / units.INCH
    np.testing.assert_allclose(lengths, 159.845, rtol=0.0, atol=0.005)


def test_neutral_leg_direction():
    """By hand from Appendix A: 133.03 in down, 88.62 in across, direction cosine 0.8323."""
    geometry = load_machine().geometry
    line = geometry.lower - geometry.upper
    np.testing.assert_allclose(line[:, 2] / units.INCH, 133.03, rtol=0.0, atol=1e-9)
    across = np.hypot(line[:, 0], line[:, 1]) / units.INCH
    np.testing.assert_allclose(across, 88.62, rtol=0.0, atol=0.01)
    np.testing.assert_allclose(line[:, 2] / geometry.neutral, 0.8323, rtol=0.0, atol=1e-4)


EXCURSIONS = {
    "surge": (-58.1, 69.8),
    "sway": (-58.6, 58.6),
    "heave": (-43.2, 48.6),
    "roll": (-29.9, 29.9),
    "pitch": (-30.2, 29.2),
    "yaw": (-39.7, 39.7),
}
"""Worked out from Appendix A: inches and degrees, z down; one decimal, some cut and not rounded."""


@pytest.mark.parametrize("dof", DOFS)
def test_single_axis_excursions(dof):
    row = DOFS.index(dof)
    found = kinematics.excursion_envelope()[row] / POSE_UNITS[row]
    np.testing.assert_allclose(found, EXCURSIONS[dof], rtol=0.0, atol=0.1)


def test_first_leg_reaches_its_travel_at_the_excursion():
    for dof, side in itertools.product(range(6), range(2)):
        pose = single(DOFS[dof], kinematics.excursion_envelope()[dof, side])
        # brentq is asked for 1e-12; a leg moves at most about 3 m per rad.
        assert abs(np.abs(pose_to_legs(pose)).max() - WORKING_STROKE) < 1e-11


# Inverse of forward


def test_round_trip_over_the_envelope():
    """As one history, and a part of it from a cold start each."""
    reach = np.abs(kinematics.excursion_envelope()).max(axis=1)
    poses = poses_within(WORKING_STROKE, seed=0, draws=200_000, reach=reach)
    legs = pose_to_legs(poses)
    np.testing.assert_allclose(legs_to_pose(legs), poses, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one_by_one(legs[:1000]), poses[:1000], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("dof", DOFS)
def test_round_trip_at_the_single_axis_extremes(dof):
    for limit in kinematics.excursion_envelope()[DOFS.index(dof)]:
        pose = single(dof, limit)
        np.testing.assert_allclose(legs_to_pose(pose_to_legs(pose)), pose, rtol=0.0, atol=1e-9)


def test_legs_come_back_from_every_corner_of_the_leg_box():
    legs = legs_of_the_envelope()
    np.testing.assert_allclose(pose_to_legs(one_by_one(legs)), legs, rtol=0.0, atol=1e-9)


def test_cold_start_lands_on_the_assembly_of_the_pose_zero():
    """Oracle: the legs taken from neutral in 40 small steps cannot change the assembly."""
    for legs in legs_of_the_envelope()[:150]:
        path = np.linspace(0.0, 1.0, 41)[:, None] * legs
        walked = np.zeros(6)
        for row in path[1:]:
            for _ in range(5):
                error = row - pose_to_legs(walked)
                walked = walked + np.linalg.solve(kinematics.pose_jacobian(walked), error)
        np.testing.assert_allclose(legs_to_pose(legs), walked, rtol=0.0, atol=1e-9)


def test_no_pose_of_the_leg_box_is_singular():
    """The determinant keeps the sign it has at neutral: there is one assembly to land on."""
    signs = [
        np.sign(np.linalg.det(kinematics.pose_jacobian(pose)))
        for pose in one_by_one(legs_of_the_envelope())
    ]
    assert set(signs) == {np.sign(np.linalg.det(kinematics.pose_jacobian(np.zeros(6))))}


def test_jumps_between_corners_stay_on_the_assembly():
    """From each corner of the leg box straight to each other one."""
    corners = legs_of_the_envelope()[:64]
    alone = one_by_one(corners)
    strays = [
        (start, end)
        for start, end in itertools.permutations(range(64), 2)
        if np.abs(legs_to_pose(corners[[start, end]])[1] - alone[end]).max() > 1e-9
    ]
    assert strays == []


# Leading axes and memory layout


def smooth_history():
    time = np.linspace(0.0, 1.0, 40)[:, None]
    return np.sin(2.0 * np.pi * time * np.arange(1, 7)) * [0.3, 0.3, 0.2, 0.1, 0.1, 0.2]


def test_history_equals_row_by_row():
    poses = smooth_history()
    legs = pose_to_legs(poses)
    assert np.array_equal(legs, np.array([pose_to_legs(row) for row in poses]))
    np.testing.assert_allclose(legs_to_pose(legs), one_by_one(legs), rtol=0.0, atol=1e-12)


def test_inputs_are_left_alone():
    poses = smooth_history()
    before = poses.copy()
    legs = pose_to_legs(poses)
    legs_before = legs.copy()
    legs_to_pose(legs)
    assert np.array_equal(poses, before) and np.array_equal(legs, legs_before)


# Jacobians


@pytest.mark.parametrize("pose", SOME_POSES)
def test_pose_jacobian_is_the_derivative_of_the_legs(pose):
    step = 1e-5
    found = [
        (pose_to_legs(pose + d) - pose_to_legs(pose - d)) / (2 * step) for d in step * np.eye(6)
    ]
    # Truncation step^2 / 6 times a third derivative of order 1, round-off 1e-16 / step: 1e-10.
    np.testing.assert_allclose(
        kinematics.pose_jacobian(pose), np.transpose(found), rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize("pose", SOME_POSES)
def test_leg_jacobian_is_the_derivative_along_a_twist(pose):
    """Turned by small rotation vectors about inertial axes with SciPy, an independent rotation."""
    step = 1e-5

    def moved(twist):
        turn = Rotation.from_rotvec(twist[3:]) * Rotation.from_euler("ZYX", pose[:2:-1])
        return pose_to_legs(np.concatenate([pose[:3] + twist[:3], turn.as_euler("ZYX")[::-1]]))

    found = [(moved(d) - moved(-d)) / (2 * step) for d in step * np.eye(6)]
    np.testing.assert_allclose(
        kinematics.leg_jacobian(pose), np.transpose(found), rtol=0.0, atol=1e-9
    )


def test_rotation_is_yaw_pitch_roll():
    """Eq 2.2: body to inertial, Euler order yaw, pitch, roll, as SciPy's intrinsic ZYX."""
    expected = Rotation.from_euler("ZYX", [0.7, -0.4, 0.3]).as_matrix()
    np.testing.assert_allclose(kinematics.rotation(0.3, -0.4, 0.7), expected, rtol=0.0, atol=1e-15)


# Symmetry


@pytest.mark.parametrize("pose", SOME_POSES)
def test_machine_is_its_own_mirror_image(pose):
    """Sides exchanged swap legs 1 and 6, 2 and 5, 3 and 4; sway, roll and yaw change sign."""
    legs = pose_to_legs(pose)
    np.testing.assert_allclose(pose_to_legs(MIRROR * pose), legs[::-1], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(legs_to_pose(legs[::-1]), MIRROR * pose, rtol=0.0, atol=1e-9)


# Refusals


def test_impossible_legs_name_the_row():
    legs = np.zeros((3, 6))
    legs[1] = [-1.3, -1.3, 1.3, -1.3, -1.3, 1.3]
    with pytest.raises(ValueError, match=r"legs\[1\]: no platform pose .* 1\.3\] m$"):
        legs_to_pose(legs)


@pytest.mark.parametrize("machine", ["cmf", "lab", "simona"])
@pytest.mark.parametrize("leg", [10.0, -4.0, 39.0])
def test_legs_that_no_cylinder_has_are_refused(machine, leg):
    """A cylinder is longer than its stroke, so a leg changes by less than a third of its neutral
    length; all six at 10 m have a pose, 10.5 m up, that no machine reaches."""
    with pytest.raises(InputError, match=r"legs\[0\]: no .* allowed: within \+-[0-9.]+ m, a third"):
        legs_to_pose(np.full((1, 6), leg), machine)
    third = load_machine(machine).geometry.neutral.min() / 3.0
    up = legs_to_pose(np.full(6, 0.999 * third), machine)
    assert up[2] < 0.0
    assert np.abs(up[[0, 1, 3, 4, 5]]).max() < 1e-3


NAN, INF = np.zeros((2, 2, 3, 6))
NAN[1, 2, 4], INF[1, 2, 4] = np.nan, np.inf


@pytest.mark.parametrize("function", [pose_to_legs, legs_to_pose])
@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (np.full(6, 1j), ": holds complex128; allowed: real numbers"),
        (["a"] * 6, ": holds <U1; allowed: real numbers"),
        ([[0.0] * 6, [0.0]], ": holds rows of different lengths; allowed: real numbers"),
        (NAN, r"\[1, 2, 4\]: nan is not a finite"),
        (INF, r"\[1, 2, 4\]: inf is not a finite"),
        *(
            (np.zeros(shape), r": shape is \(.*allowed: \(..., 6\)")
            for shape in ((), (5,), (6, 1), (4, 7))
        ),
    ],
)
def test_what_are_no_six_finite_numbers_is_refused(function, bad, said):
    with pytest.raises(InputError, match=f"(legs|pose){said}"):
        function(bad)
