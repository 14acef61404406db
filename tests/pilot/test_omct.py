"""Objective motion cueing test: known responses, stages, the machine, files and refusals."""

import csv

import control
import numpy as np
import pytest
from cab_motions import G
from shared import cmf

from cmf_mj.control.dcu.state import load_dcu
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.omct import (
    ANGLE,
    TESTS,
    Omct,
    _fundamental,
    aircraft_command,
    aircraft_motion,
    amplitude,
    cueing_responses,
    fundamentals,
    measurement_start,
    omct,
)
from cmf_mj.pilot.washout_settings import load_washout, save_washout
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.show.omct import _modulus_unit, _phase_deg, omct_table, share_table
from scripts.flights import with_gains

SIMONA = load_washout()
S = control.TransferFunction.s
FREQUENCIES = (0.631, 2.512, 10.0)


def high_pass(dof: str) -> control.TransferFunction:
    axis = getattr(SIMONA, dof)
    wn = axis.natural_frequency.si
    filtered = S**2 / (S**2 + 2.0 * axis.damping.si * wn * S + wn**2)
    if dof in ("surge", "sway", "heave") and axis.break_frequency.si:
        filtered = filtered * S / (S + axis.break_frequency.si)
    return filtered


def low_pass(dof: str) -> control.TransferFunction:
    wl = getattr(SIMONA, dof).low_pass_frequency.si
    return wl**2 / (S**2 + 2.0 * wl * S + wl**2)


@pytest.fixture(scope="module")
def ideal():
    """Stages without a machine, tilt not limited in rate."""
    fast = SIMONA.inputs.tilt_rate.model_copy(update={"value": 90.0})
    inputs = SIMONA.inputs.model_copy(update={"tilt_rate": fast})
    washout = SIMONA.model_copy(update={"inputs": inputs})
    return omct((), washout=washout, frequencies=FREQUENCIES, jobs=1)


@pytest.mark.parametrize("test", TESTS)
def test_responses_of_the_washout_in_closed_form(ideal, test):
    """Small angles: K H for rotations and heave, K (H (1 - L) + L) for surge and sway, K L / g for
    their tilt, and what the false side force of a rotation amounts to."""
    source, output = test
    gain = getattr(SIMONA, source).gain.si
    points = 1j * np.array(FREQUENCIES)
    measured = ideal.responses["washout"][TESTS.index(test)]
    if source == output:
        expected = gain * high_pass(source)(points)
        if source in ("surge", "sway"):
            low = low_pass(source)(points)
            expected = gain * (expected / gain * (1.0 - low) + low)
        if source in ("pitch", "roll"):
            other = {"pitch": "surge", "roll": "sway"}[source]
            expected = expected + getattr(SIMONA, other).gain.si * low_pass(other)(points)
    elif source in ("surge", "sway"):
        expected = gain * low_pass(source)(points) / G * (1.0 if source == "surge" else -1.0)
    else:
        # The aircraft's specific force is g times its angle; the simulator's is its own angle's
        # and what translation makes of the difference.
        share, sign = getattr(SIMONA, output).gain.si, 1.0 if source == "pitch" else -1.0
        angle = gain * high_pass(source)(points) + share * low_pass(output)(points)
        expected = sign * G * (angle + high_pass(output)(points) * (share - angle))
    np.testing.assert_allclose(measured, expected, rtol=0, atol=0.01 * np.abs(expected).max())


def test_the_dcu_delays_and_does_nothing_else(ideal):
    ratio = ideal.responses["ideal"] / ideal.responses["washout"]
    delay = np.exp(-1j * ideal.frequency * load_dcu().delay.total)
    np.testing.assert_allclose(ratio, np.broadcast_to(delay, ratio.shape), atol=4e-3)


def test_tilt_rate_limit_is_seen_where_it_binds(ideal):
    """1 m/s^2 at 2.5 rad/s asks for 3.3 deg/s: less tilt, and later."""
    limited = omct((), frequencies=(2.512,), dofs=("surge",), jobs=1)
    place = TESTS.index(("surge", "pitch"))
    assert abs(limited.responses["washout"][place, 0]) < abs(ideal.responses["washout"][place, 1])


@pytest.fixture(scope="module")
def machine():
    return omct(("velocity",), frequencies=(1.0,), dofs=("surge",), jobs=1)


def test_the_laws_share_is_its_static_gain_at_low_frequency(machine):
    """47 / 50.48 of the velocity law, which the tilt has as well, and its lag of some 50 ms."""
    gain = 47.0 / 50.48
    for test in (("surge", "surge"), ("surge", "pitch")):
        share = machine.share("velocity")[TESTS.index(test), 0]
        assert abs(share) == pytest.approx(gain, rel=0.02)
        assert -6.0 < np.degrees(np.angle(share)) < -1.0
    driven = [np.isfinite(row).all() for row in machine.responses["velocity"]]
    assert driven == [source == "surge" for source, _ in TESTS]


@pytest.mark.parametrize("dof", ["surge", "pitch"])
def test_a_guide_measures_on_an_ideal_machine_what_the_demand_does(dof):
    """From leg positions of legs that follow exactly: modulus within 0.5 %, phase 0.5 deg."""
    frequency = 2.512
    plant = Hexapod()
    command = aircraft_command({"kind": "aircraft", "dof": dof, "frequency": frequency}, plant)
    legs = pose_to_legs(command.pose[::16], plant.machine)
    said = {"sample_rate": 128.0, "cab": plant.cab, "command": command.signal.described()}
    time = np.arange(len(legs)) / 128.0
    record = Record(time, {"leg_position": legs}, {"leg_position": "m"}, said)
    found = cueing_responses(record)
    expected = omct((), frequencies=[frequency], dofs=[dof], jobs=1).responses["ideal"]
    for place in np.flatnonzero(np.isfinite(expected[:, 0])):
        name = f"{dof} > {TESTS[place][1]} {frequency:g} rad/s"
        assert found[f"{name} modulus"] == pytest.approx(abs(expected[place, 0]), rel=5e-3)
        angle = np.degrees(np.angle(expected[place, 0]))
        assert found[f"{name} phase [deg]"] == pytest.approx(angle, abs=0.5)


def test_aircraft_motion_is_one_of_a_pilot():
    """The angle is the integral of the rate; gravity turns with it; amplitudes as stated."""
    assert amplitude("heave", 3.0) == 1.0
    assert amplitude("yaw", 0.1) == pytest.approx(ANGLE)
    assert amplitude("yaw", 2.0) == pytest.approx(np.radians(0.5))
    motion = aircraft_motion("pitch", 1.0)
    assert isinstance(motion, PilotMotion)
    slope = np.gradient(motion.attitude[:, 1], motion.time)
    np.testing.assert_allclose(slope[2:-2], motion.angular_rate[2:-2, 1], atol=2e-4)
    np.testing.assert_allclose(motion.acceleration, 0.0, atol=1e-14)
    later = motion.time >= measurement_start(1.0)
    sine = np.radians(1.0) * np.sin(motion.time[later])
    np.testing.assert_allclose(motion.attitude[later, 1], sine, atol=1e-16)
    driven = fundamentals("pitch", 1.0, motion)
    assert [TESTS[place][1] for place in driven] == ["pitch", "surge"]
    assert driven[0][0] == pytest.approx(1.0, abs=1e-6)


def test_report_holds_all_tests_and_units(machine):
    table = omct_table(machine)
    header, lines = table.header, table.cells
    assert header[3:] == ["1"]
    assert [line[0] for line in lines if ">" in line[0]] == ["surge > surge", "surge > pitch"]
    assert _modulus_unit("surge", "pitch")[0] == "deg/(m/s^2)"
    assert _modulus_unit("yaw", "yaw") == ("", 1.0)
    head, shares = share_table(machine).header, share_table(machine).cells
    assert head == ["test", "velocity"]
    assert [line[0] for line in shares] == ["surge > surge", "surge > pitch"]
    share = machine.share("velocity")[TESTS.index(("surge", "surge")), 0]
    assert shares[0][1] == f"{abs(share):.2f}, {np.degrees(np.angle(share)):.0f}°"
    turning = np.exp(-1j * np.radians([170.0, 190.0, 250.0]))
    np.testing.assert_allclose(_phase_deg(turning), [-170.0, -190.0, -250.0])


def test_shares_are_told_up_to_1_hz_with_what_is_beside_the_fundamental():
    """Least and largest modulus of 0.1 to 6.31 rad/s, the phase there; a ring, a run lost."""
    frequency = np.array([0.1, 1.0, 6.31, 15.8])
    shape = (len(TESTS), frequency.size)
    ideal = np.full(shape, 2.0 + 0j)
    responses = {"washout": ideal, "ideal": ideal, "slow": ideal.copy(), "wild": ideal.copy()}
    responses["slow"][0] = 2.0 * np.array([0.9, 1.0, 1.2, 50.0]) * np.exp(1j * np.radians(-20.0))
    responses["wild"][0, 1] = np.nan
    remainder = {name: np.zeros(shape) for name in responses}
    remainder["wild"][0, 0], remainder["slow"][0, 3] = 1.5, 9.0
    result = Omct("w", "gfd", "hardware", frequency, responses, remainder)
    assert share_table(result).cells[0][1:] == [
        "0.90 to 1.20, -20°",
        "1.00, 0°*, left its bounds",
    ]


def test_the_remainder_is_what_is_beside_mean_and_fundamental():
    """A fundamental of 0.5, a tone of 0.4 far above and an offset: 0.4 / 0.5, and no bias."""
    time = np.arange(4000) / 128.0
    values = 0.5 * np.sin(2.0 * time - 0.3) + 0.4 * np.sin(17.0 * time) - 9.8
    response, remainder = _fundamental(time, values, 2.0, 1.0, begin=5.0)
    assert response == pytest.approx(0.5 * np.exp(-0.3j), abs=5e-3)
    assert remainder == pytest.approx(0.8, abs=0.02)


def test_command_writes_table_and_figure(tmp_path):
    quiet = save_washout(with_gains(SIMONA, 0.5 * SIMONA.gains), tmp_path / "mine.toml")
    out = tmp_path / "out"
    options = ("--laws", "none", "--quick", "--dofs", "yaw", "--jobs", "1")
    said = cmf("omct", *options, "--washout", quiet, "--out", out)
    assert "yaw > yaw" in said and "boundary" in said
    with (out / "omct.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["stage"] for row in rows} == {"washout", "ideal"}
    assert float(rows[-1]["modulus_si"]) == pytest.approx(0.3, abs=0.01)
    assert {path.suffix for path in out.iterdir()} == {".csv", ".md", ".png"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dofs": ("up",)}, "dofs: 'up'"),
        ({"frequencies": ()}, "frequencies: is empty"),
        ({"frequencies": (100.0,)}, "frequencies: 100"),
        ({"jobs": 0}, "jobs: 0"),
        ({"cab": "bus"}, "'bus'"),
        ({"laws": ("fast",)}, "'fast'"),
    ],
)
def test_refusals_before_anything_runs(options, message):
    with pytest.raises(ValueError, match=message):
        omct(**options)
