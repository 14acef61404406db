"""Washout parameters, the machine's envelope and the command line."""

import numpy as np
import pytest
from cab_motions import pushed, sustained, turn_entry
from shared import WORKING_STROKE, cmf

from cmf_mj.facility.host.stream import read_stream
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.leg_motion import pose_motion_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import cue, excursion, within_limits
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.washout import Washout
from cmf_mj.pilot.washout_settings import WASHOUTS, load_washout, save_washout
from scripts.flights import with_gains

LIMITS = load_motion_limits()
PUSH = pushed(0, np.clip((np.arange(2400) / 80.0 - 1.0) * 2.0, 0.0, 5.0))


def test_published_parameters_of_simona():
    """Field values as printed: gains, high-pass, break, low-pass, tilt rate; all damping 1."""
    simona = load_washout()
    np.testing.assert_array_equal(simona.gains, [0.6, 0.6, 0.5, 0.6, 0.6, 0.6])
    axes = [getattr(simona, dof) for dof in ("surge", "sway", "heave", "roll", "pitch", "yaw")]
    assert [axis.natural_frequency.si for axis in axes] == [0.8, 1.0, 1.0, 1.0, 0.8, 1.0]
    assert [axis.break_frequency.si for axis in axes[:3]] == [0.0, 0.0, 0.2]
    assert [axis.low_pass_frequency.si for axis in axes[:2]] == [2.0, 2.0]
    assert {axis.damping.si for axis in axes} == {1.0}
    assert simona.inputs.tilt_rate.si == pytest.approx(np.radians(3.0))
    assert {axis.gain.status for axis in axes} == {"published"}
    assert load_washout("reid_nahon").surge.natural_frequency.status == "recalled"


@pytest.mark.parametrize("name", WASHOUTS)
def test_a_set_reads_back_from_its_file(name, tmp_path):
    settings = load_washout(name)
    again = load_washout(save_washout(settings, tmp_path / "set.toml"))
    assert again == settings
    changed = with_gains(settings, np.arange(6) / 10.0)
    np.testing.assert_allclose(changed.gains, np.arange(6) / 10.0)
    assert load_washout(save_washout(changed, tmp_path / "set.toml")) == changed


def test_a_tilt_beyond_1_g_is_refused(tmp_path):
    path = tmp_path / "mine.toml"
    limit = '{value = 9.9, unit = "m/s^2", status = "assumed", source = "t"}'
    path.write_text(f'base = "simona"\n[a.inputs]\ntilt_force_limit = {limit}\n')
    with pytest.raises(ValueError, match="may overshoot to 1 g"):
        load_washout(path)


def test_a_motion_within_the_limits_passes_to_the_bit():
    stream = Washout().run(turn_entry())
    assert excursion(stream).largest < 1.0
    kept, limited = within_limits(stream)
    assert not limited.any()
    for name in ("pose", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(stream, name))


def test_a_motion_beyond_them_is_held_within_travel_and_leg_rates():
    stream = Washout().run(PUSH)
    assert excursion(stream).largest > 1.2
    assert "leg_displacement" in excursion(stream).binding
    kept, limited = within_limits(stream)
    assert limited.any() and not limited.all()
    legs = pose_to_legs(kept.pose)
    assert np.abs(legs).max() <= WORKING_STROKE * (1 + 1e-12)
    low, high = LIMITS.operational.T
    # Legs have the last word: on their way the platform may go a little beyond its own limits.
    assert (kept.pose <= 1.01 * high).all() and (kept.pose >= 1.01 * low).all()
    speed = np.abs(np.diff(legs, axis=0)).max() * 80.0
    assert speed <= LIMITS.leg.velocity.si * (1 + 1e-9)
    push = np.abs(np.diff(legs, n=2, axis=0)).max() * 80.0**2
    assert push <= LIMITS.leg.acceleration.si * (1 + 1e-6)
    rates = pose_motion_to_legs(kept.pose, kept.velocity, kept.acceleration)
    differenced = (legs[2:] - legs[:-2]) * 40.0
    assert (
        np.abs(rates.velocity[1:-1] - differenced).max() < 0.6 * LIMITS.leg.acceleration.si / 80.0
    )


def test_capitals_and_blanks_in_the_header_of_a_flight_are_read(tmp_path):
    path = pushed(0, sustained(0.1, seconds=2.0)).save(tmp_path / "flight.csv")
    header, _, rows = path.read_text().partition("\n")
    named = path.with_name("named.csv")
    named.write_text(header.replace(",", ", ").replace("_x", "_X").title() + "\n" + rows)
    one, other = (cue(load_flight(file).motion).stream.pose for file in (path, named))
    np.testing.assert_array_equal(one, other)


def test_cue_writes_its_files(tmp_path):
    flight = PUSH.save(tmp_path / "flight.csv")
    said = cmf("cue", flight, "--out", tmp_path / "run")
    assert "held back" in said and "threshold" in said
    stream = read_stream(tmp_path / "run" / "host.csv")
    np.testing.assert_allclose(stream.pose, cue(PUSH).stream.pose, atol=1e-12)
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {"host.csv", "simulator.csv", "error.csv", "motion.png", "senses.png"}
