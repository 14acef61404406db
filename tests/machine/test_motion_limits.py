"""The limits of Table 2-1 as data."""

import math

import numpy as np
import pytest

from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.parameters import load_hydraulics

INCH = 0.0254
SCALE = np.array([[INCH]] * 3 + [[math.pi / 180.0]] * 3)


def test_table_2_1():
    """As printed, longitudinal, lateral, vertical, roll, pitch, yaw; degrees for yaw."""
    limits = load_motion_limits()
    mechanical = [[-57, 70], [-58, 58], [-43, 43], [-30, 30], [-27, 30], [-40, 40]]
    operational = [[-55, 67], [-55, 55], [-41, 41], [-28, 28], [-25, 28], [-38, 38]]
    np.testing.assert_allclose(limits.mechanical / SCALE, mechanical, rtol=1e-14)
    np.testing.assert_allclose(limits.operational / SCALE, operational, rtol=1e-14)
    assert all(axis.operational.status == "stated" for axis in limits.axes)
    assert "degrees are meant" in limits.yaw.operational.source


def test_assumed_rates_are_within_what_legs_and_hydraulics_can_do():
    """Each degree of freedom alone at neutral uses at most the legs' velocity and acceleration;
    the legs' velocity is below that of a fully open valve."""
    limits = load_motion_limits()
    share = np.abs(pose_jacobian(np.zeros(6))).max(axis=0)
    assert (limits.velocity * share <= limits.leg.velocity.si).all()
    assert (limits.acceleration * share <= limits.leg.acceleration.si).all()
    assert limits.leg.velocity.si < load_hydraulics("hardware").leg_speed.si
    rates = [limits.leg.velocity, limits.leg.acceleration, limits.leg.rejoin]
    rates += [q for axis in limits.axes for q in (axis.velocity, axis.acceleration)]
    assert {quantity.status for quantity in rates} == {"assumed"}


def test_own_file_changes_what_it_repeats(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        '[leg]\nvelocity = {value = 0.5, unit = "m/s", status = "assumed", source = "a test"}\n'
    )
    mine, shipped = load_motion_limits(path), load_motion_limits()
    assert mine.leg.velocity.si == 0.5
    assert mine.leg.acceleration == shipped.leg.acceleration
    assert mine.axes == shipped.axes
    assert load_motion_limits(mine) is mine


RANGE = '{{low = {}, high = {}, unit = "{}", status = "assumed", source = "a test"}}'


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ((-38.0, 38.0, "in"), r"yaw\.operational: .*deg, rad"),
        ((-50.0, 38.0, "deg"), r"yaw: .*within mechanical"),
    ],
)
def test_refused_entries_are_named(tmp_path, limits, message):
    path = tmp_path / "mine.toml"
    path.write_text("[yaw]\noperational = " + RANGE.format(*limits))
    with pytest.raises(ValueError, match=message) as raised:
        load_motion_limits(path)
    assert str(path) in str(raised.value)
