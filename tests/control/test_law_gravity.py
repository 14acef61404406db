"""Gravity in acceleration feedback is the law's choice; protection and ideal sensors know none.

A law that reads g n . up beside the acceleration holds its leg off the demand: with the gain K_a of
the acceleration, K_p of the position and b / (1 - a) of the filter at rest,

    K_p dl = K_a b / (1 - a) g n . up,

since the command that holds the load is the same at both places.
"""

from pathlib import Path

import numpy as np
import pytest
from protected_records import fault_of
from shared import axial_gravity

from cmf_mj import Hexapod, Law, load_law, signals, simulate
from cmf_mj.control import dcl as blocks
from cmf_mj.control.engage import engaged_state, handed_over_state
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.protection import load_protection, make_protection
from cmf_mj.electronics.chain import ElectronicsSettings, gravity_history
from cmf_mj.facility.replay import replay
from cmf_mj.machine import kinematics
from cmf_mj.record.record import Record

INCH, GRAVITY = 0.0254, 9.80665
GAIN, STIFFNESS = -0.01, 37.1759 / (1.0 - 0.914) - 381.8
"""K_a [%/(in/s^2)], K_p of the velocity law [%/in]."""
PASSED = 0.007588 / (1.0 - 0.9924)
POSES = {
    "neutral": np.zeros(6),
    "high": np.array([0.0, 0.0, -0.5, 0.0, 0.0, 0.0]),
    "tilted": np.array([0.2, -0.1, 0.1, 0.25, -0.1, 0.0]),
}


def law(*, compensated: bool, integral: float = 0.0) -> Law:
    flown = load_law("velocity")
    gains = {"acceleration": GAIN, "error_integral": integral}
    return flown.model_copy(
        update={
            "direct_gain": flown.direct_gain.model_copy(update=gains),
            "gravity_compensation": compensated,
        }
    )


@pytest.fixture
def feeling(tmp_path: Path) -> ElectronicsSettings:
    """Sensors without any error that feel gravity."""
    path = tmp_path / "feeling.toml"
    path.write_text('base = "ideal"\n[feeling]\ngravity = true\n')
    return ElectronicsSettings(sensors=path, converters="off")


def hold(chosen: Law, electronics: ElectronicsSettings | None, pose: np.ndarray) -> Record:
    """Six seconds: what is left then is the DAC's step of 0.003 % of command over the stiffness, a
    thousandth of the offset."""
    return simulate(Hexapod(), chosen, np.tile(pose, (6 * 2048, 1)), electronics=electronics)


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
def test_offset_is_the_reading_over_the_stiffness_of_the_law(
    pose: np.ndarray, feeling: ElectronicsSettings
) -> None:
    with_it, without = (
        hold(law(compensated=choice), feeling, pose)["leg_extension"][-1]
        for choice in (True, False)
    )
    held = kinematics.legs_to_pose(without)  # where the static error of the law leaves the pose
    expected = GAIN / STIFFNESS * PASSED * axial_gravity(held)  # in/(in/s^2) is m/(m/s^2)
    np.testing.assert_allclose(without - with_it, expected, rtol=2e-3)


def test_an_integral_takes_it_up(feeling: ElectronicsSettings) -> None:
    """From the start, since the law is engaged in equilibrium."""
    record = hold(law(compensated=False, integral=50.0), feeling, np.zeros(6))
    assert np.abs(record["leg_extension"]).max() < 1e-4 * INCH
    assert record["leg_acceleration"].min() > 0.83 * GRAVITY


def test_ideal_sensors_have_none_to_take_out() -> None:
    command = signals.step("pitch", 0.01, at=0.1, duration=0.3)
    ideal = ElectronicsSettings(sensors="ideal", converters="off")
    first, second = (
        simulate(Hexapod(), law(compensated=choice), command, electronics=ideal)
        for choice in (True, False)
    )
    assert np.ptp(first["leg_acceleration"]) > 0.1
    assert all(first[name].tobytes() == second[name].tobytes() for name in first.channels)


def test_protection_watches_accelerations_without_gravity(feeling: ElectronicsSettings) -> None:
    """At rest, with a threshold below what a law without compensation reads."""
    default = load_protection()
    half = default.over_acceleration.threshold.model_copy(update={"value": 0.5, "unit": "g"})
    check = default.over_acceleration.model_copy(update={"threshold": half})
    strict = default.model_copy(update={"over_acceleration": check})
    still = np.zeros((400, 6))
    chosen = law(compensated=False, integral=50.0)
    record = simulate(Hexapod(), chosen, still, electronics=feeling, protection=strict)
    assert record["leg_acceleration"].min() > 0.8 * GRAVITY
    assert record.metadata["fault"] is None
    assert fault_of(record, make_protection(strict), 1e7) is None
    jump = np.repeat([[0.0] * 6, [0.0, 0.0, -0.05, 0.0, 0.0, 0.0]], 200, axis=0)
    moved = simulate(Hexapod(), chosen, jump, electronics=feeling, protection=strict)
    assert moved.metadata["fault"]["name"] == "over_acceleration"
    fault = fault_of(moved, make_protection(strict), 1e7)
    assert fault is not None
    assert fault.name == "over_acceleration"


@pytest.mark.parametrize("recorded", [True, False])
def test_a_replay_reads_as_its_own_law_does(recorded: bool, feeling: ElectronicsSettings) -> None:
    command = signals.step("roll", 0.01, at=0.1, duration=0.4)
    run = simulate(Hexapod(), law(compensated=recorded), command, electronics=feeling)
    assert replay(run, law(compensated=recorded)).identical
    difference = (
        replay(run, law(compensated=False)).output - replay(run, law(compensated=True)).output
    )
    expected = 0.01 * GAIN / INCH * PASSED * axial_gravity(np.zeros(6))
    np.testing.assert_allclose(difference, np.tile(expected, (819, 1)), rtol=0.01)
    assert np.ptp(difference, axis=0).min() > 0.0  # roll turns the legs


def test_history_of_gravity_is_that_of_the_poses() -> None:
    poses = np.linspace(np.zeros(6), POSES["tilted"], 1024)
    legs = np.array([kinematics.pose_to_legs(pose) for pose in poses])
    np.testing.assert_allclose(gravity_history(legs), axial_gravity(poses), rtol=0.0, atol=1e-3)
    with pytest.raises(ValueError, match=r"needs \(6,\)"):
        gravity_history(np.zeros((5, 2)))


@pytest.mark.parametrize("first", [True, False])
def test_a_law_that_reads_gravity_takes_over_without_a_jump(first: bool) -> None:
    gravity = axial_gravity(POSES["tilted"])
    inertial = np.random.default_rng(5).uniform(-1.0, 1.0, 6)
    before, after = (
        blocks.make_dcl(law(compensated=choice, integral=50.0), 6) for choice in (first, not first)
    )
    reference = np.random.default_rng(6).uniform(-0.1, 0.1, 6)
    read = {True: inertial, False: inertial + gravity}
    feedback = LegFeedback(
        reference + 0.001, np.zeros(6), read[first], np.full(6, 3e6), np.full(6, 2e6)
    )
    state = engaged_state(before, reference, feedback)
    begun = handed_over_state(before, state, after, reference, feedback, gravity)
    shift = PASSED * gravity * (1.0 if first else -1.0)
    np.testing.assert_allclose(begun.acceleration - state.acceleration, shift, rtol=1e-12)
    outputs = []
    for compiled, own, choice in ((before, state, first), (after, begun, not first)):
        seen = feedback._replace(acceleration=read[choice])
        blocks.step(compiled, own, reference, seen)
        outputs.append(compiled.workspace.output)
    np.testing.assert_allclose(outputs[1], outputs[0], rtol=0.0, atol=1e-12)
