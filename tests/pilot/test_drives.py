"""Drives obey their speed, and seeds draw them."""

import numpy as np
import pytest
from cab_motions import G

from cmf_mj.pilot.drives import DRIVES, drive
from cmf_mj.pilot.flight import load_flight


@pytest.mark.parametrize("name", DRIVES)
def test_a_drive_obeys_its_speed(name):
    """f_x = dv/dt, never backwards, and f_y = v r: yaw rate times speed is the side force."""
    for seed in (None, *range(1, 9)):
        motion = drive(name, seed)
        force = motion.specific_force
        speed = (0.0 if name == "urban" else 20.0) + np.cumsum(force[:, 0]) / 80.0
        assert speed.min() > -1e-9
        fast = speed > 5.0
        side = motion.angular_rate[fast, 2] * speed[fast]
        np.testing.assert_allclose(side, force[fast, 1], atol=1e-9)
        np.testing.assert_allclose(force[:, 2], -G)
        assert np.abs(force[:80, :2]).max() == 0.0


def test_a_seed_draws_the_same_drive_and_another_seed_another():
    one, again, other = (drive("urban", seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.specific_force, again.specific_force)
    assert np.abs(one.specific_force - other.specific_force).max() > 0.1
    np.testing.assert_array_equal(load_flight("urban:4").motion.specific_force, one.specific_force)
    with pytest.raises(ValueError, match="seed 'x' of urban"):
        load_flight("urban:x")
    plain = np.abs(drive("lane_change").specific_force[:, 1]).max()
    drawn = [np.abs(drive("lane_change", seed).specific_force[:, 1]).max() for seed in range(8)]
    assert all(0.7 * plain <= size <= 1.3 * plain + 1e-9 for size in drawn)
