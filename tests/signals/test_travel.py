"""Commands within the travel of a machine: Table 2-1 of the report, and the legs' stroke."""

import math

import pytest

from cmf_mj import signals
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import excursion_envelope
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.signals import composite
from cmf_mj.signals.signal import Command
from cmf_mj.signals.travel import check_travel

AMPLITUDE, DEGREE = 0.33 * 0.0254, math.pi / 180.0


def test_operational_limits_lie_within_the_leg_travel():
    """Each alone: a command to a limit of Table 2-1 uses up the platform's limit first."""
    limits = load_motion_limits().operational
    assert (limits[:, 0] > excursion_envelope()[:, 0]).all()
    assert (limits[:, 1] < excursion_envelope()[:, 1]).all()


@pytest.mark.parametrize("dof", DOFS)
def test_a_command_within_the_travel_passes(dof):
    """0.33 in or 0.2 deg, the facility's own."""
    size = AMPLITUDE if dof in DOFS[:3] else 0.2 * DEGREE
    check_travel(composite.seven_sines(dof, size, 5))


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
        check_travel(command)


def test_axes_each_within_their_limits_can_exceed_the_leg_travel_together():
    command = Command(signals.step("heave", 1.0).pose + signals.step("surge", 1.2).pose)
    with pytest.raises(ValueError, match=r"^leg \d displacement: .* m; allowed: at most 0\.9525 m"):
        check_travel(command)
