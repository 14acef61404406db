"""Electronics without quantisation and limits leave no trace; the shipped ones a known one."""

from pathlib import Path

import numpy as np
import pytest
from shared import axial_gravity

from cmf_mj import Hexapod, SingleLegs, frequency_response, signals, simulate
from cmf_mj.analysis.frequency_response import bandwidths
from cmf_mj.electronics.chain import ElectronicsSettings, write_gravity
from cmf_mj.machine import kinematics
from cmf_mj.machine.leg_motion import make_pose_tracker, tracked_pose

AXES = make_pose_tracker()
POSE = np.array([0.2, -0.1, 0.3, 0.05, -0.1, 0.2])

FAR = """
switch_position = { value = 1000.0, unit = "in", status = "assumed", source = "far away" }
velocity_clamp = { value = 100.0, unit = "%", status = "assumed", source = "the law's own" }
rate_limit = { value = 1e9, unit = "%/s", status = "assumed", source = "far away" }
dac_range = { value = 8.0, unit = "V", status = "assumed", source = "a power of two, exact" }
full_command = { value = 8.0, unit = "V", status = "assumed", source = "a power of two, exact" }
dac_bits = { value = 0, status = "assumed", source = "off" }
"""


@pytest.fixture
def transparent(tmp_path: Path) -> ElectronicsSettings:
    path = tmp_path / "far.toml"
    path.write_text(FAR)
    return ElectronicsSettings(sensors="ideal", converters="off", servo=path)


@pytest.mark.parametrize("law", ["velocity", "acceleration", "force"])
def test_with_limits_far_away_and_quantisation_off_a_run_is_the_same_to_the_bit(
    law: str, transparent: ElectronicsSettings
) -> None:
    command = signals.chirp("heave", 0.33 * 0.0254, duration=3.0)
    plain = simulate(Hexapod(), law, command)
    through = simulate(Hexapod(), law, command, electronics=transparent)
    assert np.ptp(plain["valve_command"]) > 0.1
    for name in plain.channels:
        assert through[name].tobytes() == plain[name].tobytes(), name


def test_so_are_bandwidths(transparent: ElectronicsSettings) -> None:
    command = signals.chirp("heave", 0.33 * 0.0254, duration=30.0)

    def widths(electronics: ElectronicsSettings | None):
        record = simulate(
            SingleLegs(), "velocity", command, electronics=electronics, record_every=16
        )
        return bandwidths(frequency_response(record, segment=10.0))

    plain = widths(None)
    np.testing.assert_array_equal(widths(transparent), plain)
    noisy = widths(ElectronicsSettings())
    assert noisy.phase_hz != plain.phase_hz
    assert noisy.phase_hz == pytest.approx(plain.phase_hz, rel=0.03)


def test_what_the_dcl_reads_is_not_what_is_true() -> None:
    """At rest the reading is off by the noise: rms of an assumed 0.001 in, unlike in each leg."""
    record = simulate(Hexapod(), "velocity", np.zeros((2048, 6)), electronics=ElectronicsSettings())
    apart = record["leg_position"] - record["leg_extension"]
    rms = apart.std(axis=0) / 0.0254
    assert ((rms > 2e-4) & (rms < 3e-3)).all()
    assert np.abs(np.corrcoef(apart.T) - np.eye(6)).max() < 0.2
    volts = record["valve_command"] * 10.0 / (20.0 / 2**16)
    np.testing.assert_allclose(volts, np.rint(volts), atol=1e-6)


def test_what_legs_at_rest_feel_of_gravity_is_known() -> None:
    legs = kinematics.pose_to_legs(POSE)
    state = tracked_pose(AXES, legs)
    expected, gravity = axial_gravity(POSE), np.zeros(6)
    assert expected.min() > 7.0
    write_gravity(AXES, state, legs, gravity)
    np.testing.assert_allclose(gravity, expected, rtol=0.0, atol=1e-9)
