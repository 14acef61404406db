"""Canals, otoliths, thresholds and cueing errors."""

import numpy as np
import pytest
from cab_motions import G, level, pushed, sustained, turned

from cmf_mj.pilot.perception import (
    canal_response,
    cueing_error,
    load_senses,
    otolith_response,
    sense,
    state_space,
)

SENSES = load_senses()


@pytest.mark.parametrize("name", ["canals", "otoliths"])
def test_state_space_is_the_transfer_function(name):
    make = {"canals": canal_response, "otoliths": otolith_response}[name]
    response = make(getattr(SENSES, name))
    points = 1j * np.geomspace(1e-3, 1e3, 30)
    np.testing.assert_allclose(state_space(response)(points), response(points), rtol=1e-9)


def test_a_rate_that_lasts_is_forgotten_as_in_closed_form():
    """A step of rate r through T1 T2 s^2 (T3 s + 1) / ((T1 s + 1) (T2 s + 1) (T4 s + 1)); after
    the lag the slow poles leave r (T2 exp(-t/T1) - T1 exp(-t/T2)) / (T2 - T1)."""
    sensed = sense(turned(2, sustained(0.1)))
    t1, t2 = SENSES.canals.time_constant.si, SENSES.canals.adaptation.si
    time = sensed.time - 1.0 + 0.5 / 80.0 + SENSES.canals.lead.si - SENSES.canals.lag.si
    slow = (t2 * np.exp(-time / t1) - t1 * np.exp(-time / t2)) / (t2 - t1)
    later = sensed.time > 1.5
    expected = 0.1 * slow
    np.testing.assert_allclose(sensed.angular_rate[later, 2], expected[later], atol=5e-5)
    assert sensed.angular_rate[-1, 2] < 0.0  # the other way, by adaptation


def test_gravity_is_known_by_the_gain_and_a_step_settles_there():
    sensed = sense(pushed(0, sustained(1.0)))
    np.testing.assert_allclose(sensed.specific_force[:, 2], -0.4 * G, rtol=1e-12)
    oto = SENSES.otoliths
    assert sensed.specific_force[-1, 0] == pytest.approx(oto.gain.si, abs=1e-4)
    early = sensed.specific_force[85:100, 0].max()
    assert early == pytest.approx(oto.gain.si * oto.lead.si / oto.long_lag.si, rel=0.05)


def test_same_motion_has_no_error_and_a_missing_one_all_of_it():
    flown, still = pushed(1, sustained(0.5, seconds=10.0)), level(10.0)
    assert not cueing_error(flown, flown).peak.any()
    error = cueing_error(flown, still)
    np.testing.assert_allclose(error.peak[1], sense(flown).specific_force[:, 1].max())
    assert 0.0 < error.share_above[1] < 1.0
    assert not error.share_above[[0, 2, 3, 4, 5]].any()
    assert error.rms[1] < error.peak[1]
    with pytest.raises(ValueError, match="simulator"):
        cueing_error(flown, level(5.0))


def test_a_tenth_of_g_and_the_thresholds():
    """The figures of docs/how_to/fly.md, from |H| by hand at 1 Hz."""
    w = 2 * np.pi
    gain = 0.4 * np.hypot(10 * w, 1) / (np.hypot(5 * w, 1) * np.hypot(0.016 * w, 1))
    assert abs(otolith_response(SENSES.otoliths)(1j * w)) == pytest.approx(gain, rel=1e-12)
    np.testing.assert_allclose(SENSES.thresholds.si[:3], [0.17, 0.17, 0.28], rtol=1e-15)


def test_own_file_and_refusals(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        '[otoliths]\ngain = {value = 1.0, unit = "1", status = "assumed", source = "t"}\n'
    )
    assert load_senses(path).otoliths.gain.si == 1.0
    assert load_senses(path).canals == SENSES.canals
    path.write_text(
        '[canals]\nlead = {value = -1.0, unit = "s", status = "assumed", source = "t"}\n'
    )
    with pytest.raises(ValueError, match=r"canals.lead.*at least 0 s"):
        load_senses(path)
    assert SENSES.thresholds.x.status == "recalled"
