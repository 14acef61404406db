"""Peaks of commands, and the limits they must keep.

Oracles: A w and A w^2 of a sine, the Jacobian of the legs, Table 2-1 of the report.
"""

import math

import numpy as np
import pytest

from cmf_mj import signals
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import excursion_envelope, pose_jacobian
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.signals import composite
from cmf_mj.signals.peaks import check_limits, peaks
from cmf_mj.signals.signal import Command

INCH = 0.0254
DEGREE = math.pi / 180.0
AMPLITUDE = 0.33 * INCH

# Peaks


@pytest.mark.parametrize("frequency", [0.5, 2.0, 10.0])
@pytest.mark.parametrize("dof", DOFS)
def test_peaks_of_a_sine(dof, frequency):
    """A, A w, A w^2; the differences read low by (pi f T)^2 / 6 and / 3, below 8e-5 at 10 Hz.

    A fade of four periods adds nothing: |e'' s + 2 e' w c - e w^2 s| stays below w^2.
    """
    index, omega = DOFS.index(dof), 2.0 * np.pi * frequency
    largest = peaks(signals.sine(dof, 0.001, frequency, cycles=40.0, fade=4.0 / frequency))
    expected = 0.001 * np.array([1.0, omega, omega**2])
    measured = [largest.displacement[index], largest.velocity[index], largest.acceleration[index]]
    np.testing.assert_allclose(measured, expected, rtol=2e-4, atol=0.0)
    others = np.delete(np.array(largest[:3]), index, axis=1)
    assert not others.any()


def test_leg_peaks_are_the_jacobian_times_the_platform_s():
    """For a small heave sine: second-order terms are of the order A / leg length, 0.1 mm in 4 m."""
    largest = peaks(signals.sine("heave", 1e-4, 2.0))
    ratio = np.abs(pose_jacobian(np.zeros(6))[:, 2])
    for leg, platform in zip(largest[3:], largest[:3], strict=True):
        np.testing.assert_allclose(leg, ratio * platform[2], rtol=1e-4, atol=0.0)


@pytest.mark.parametrize("kind", ["step", "pulse"])
def test_jump_of_position_has_infinite_rates(kind):
    largest = peaks(getattr(signals, kind)("heave", AMPLITUDE))
    assert largest.displacement[2] == AMPLITUDE
    assert np.isinf(largest.velocity[2]) and np.isinf(largest.acceleration[2])
    assert np.isinf(largest.leg_velocity).all() and np.isinf(largest.leg_acceleration).all()
    assert not np.delete(largest.velocity, 2).any()


@pytest.mark.parametrize("kind", ["chirp", "multisine"])
def test_start_or_stop_in_motion_has_infinite_acceleration_and_a_fade_cures_it(kind):
    """Velocity stays below w A of the 10 Hz at which both end, and below w^2 A once faded."""
    omega = 2.0 * np.pi * 10.0
    bare, faded = (peaks(getattr(signals, kind)("heave", 0.01, fade=f)) for f in (0.0, 0.5))
    assert np.isinf(bare.acceleration[2]) and np.isinf(bare.leg_acceleration).all()
    assert 0.0 < bare.velocity[2] <= 0.01 * omega
    assert 0.0 < faded.acceleration[2] <= 0.01 * omega**2
    assert np.isfinite(faded.leg_acceleration).all()


# Limits


def test_operational_limits_lie_within_the_leg_travel():
    """Each alone: a command to a limit of Table 2-1 uses up the platform's limit first."""
    limits = load_motion_limits().operational
    assert (limits[:, 0] > excursion_envelope()[:, 0]).all()
    assert (limits[:, 1] < excursion_envelope()[:, 1]).all()


@pytest.mark.parametrize("dof", DOFS)
def test_command_within_the_limits_passes_and_gives_its_peaks(dof):
    """0.33 in or 0.2 deg, the facility's own."""
    size = AMPLITUDE if dof in DOFS[:3] else 0.2 * DEGREE
    command = composite.seven_sines(dof, size, 5)
    np.testing.assert_array_equal(np.array(check_limits(command)), np.array(peaks(command)))


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (signals.step("heave", 1.1), r"heave: 1\.1 m; allowed: -1\.041 to 1\.041 m"),
        (signals.step("surge", -1.5), r"surge: -1\.5 m; allowed: -1\.397 to 1\.702 m"),
        (signals.step("pitch", -0.45), r"pitch: -0\.45 rad; allowed: -0\.4363 to 0\.4887"),
    ],
)
def test_each_excess_is_named_with_its_value_and_its_limit(command, message):
    with pytest.raises(ValueError, match=message):
        check_limits(command)


def test_axes_each_within_their_limits_can_exceed_the_leg_travel_together():
    command = Command(signals.step("heave", 1.0).pose + signals.step("surge", 1.2).pose)
    with pytest.raises(ValueError, match=r"^leg \d displacement: .* m; allowed: at most 0\.9525 m"):
        check_limits(command)
