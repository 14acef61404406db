"""Experiments from records: alignment with the valves, decimation, axes, labels, refusals."""

import numpy as np
import pytest
from identified_systems import RATE, driven, series

from cmf_mj import Record, SingleLegs, signals, simulate
from cmf_mj.analysis.identification.data import Experiment, decimated, experiment
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_jacobian


@pytest.fixture(scope="module")
def record() -> Record:
    command = signals.multisine(
        "pitch", np.radians(0.2), start=0.5, stop=15.0, period=4.0, periods=2, fade=1.0
    )
    return simulate(SingleLegs(), "velocity", command)


def test_input_is_the_held_command_at_the_valves(record: Record) -> None:
    """Against the recorded command held sample by sample and delayed a frame, filtered alike.

    The held command is drawn 16 times a frame; its mean over a frame about each sample is what
    band-limited data see of it.
    """
    command = record["valve_command"][:, 0]
    fine = np.repeat(np.concatenate([[command[0]], command[:-1]]), 16)
    about = np.array([fine[max(k - 8, 0) : k + 8].mean() for k in range(0, fine.size, 16)])
    result = experiment(record, "leg_1", rate=2048.0, detrend=False).input[:, 0]
    assert np.abs(result - about)[16:].max() < 2e-3 * np.ptp(command)


def test_degrees_of_freedom_are_the_legs_behind_the_jacobian(record: Record) -> None:
    """Against J^-1 at the pose zero: excursions of 0.2 deg change J by less than a per cent.

    The reference is the pose demand within the anti-alias filters' ripple, 0.2 dB.
    """
    legs = experiment(record, [f"leg_{i + 1}" for i in range(6)], detrend=False)
    dofs = experiment(record, DOFS, detrend=False)
    inverse = np.linalg.inv(pose_jacobian(np.zeros(6)))
    for kind in ("input", "output"):
        expected = getattr(legs, kind) @ inverse.T
        result = getattr(dofs, kind)
        np.testing.assert_allclose(result[:, 4], expected[:, 4], atol=0.01 * np.ptp(expected[:, 4]))
    assert dofs.reference is not None
    np.testing.assert_allclose(
        dofs.reference[64:-64, 4],
        record["demand_pose"][::32][64:-64, 4],
        atol=0.025 * np.ptp(record["demand_pose"][:, 4]),
    )


def test_labels_and_units_follow_channels_and_axes(record: Record) -> None:
    run = experiment(record, ["heave", "roll"], outputs=["leg_velocity", "leg_position"])
    assert run.input_names == ("heave_command", "roll_command")
    assert run.input_units == ("1", "rad/m")
    assert run.output_names == (
        "heave_velocity",
        "roll_velocity",
        "heave_position",
        "roll_position",
    )
    assert run.output_units == ("m/s", "rad/s", "m", "rad")
    assert run.rate == 64.0
    assert run.name == "multisine"


def test_decimation_keeps_the_band_and_stops_what_would_fold_back() -> None:
    """5 Hz passes within 0.5 % in amplitude and without a phase; 60 Hz at 64 Hz would become 4."""
    time = np.arange(20 * 2048) / 2048.0
    slow, fast = (np.sin(2.0 * np.pi * f * time) for f in (5.0, 60.0))
    inside = slice(128, -128)
    np.testing.assert_allclose(decimated(slow, 32)[inside], slow[::32][inside], atol=0.02)
    assert np.abs(decimated(fast, 32)[inside]).max() < 1e-3


def test_split_cut_and_detrend() -> None:
    u = driven(0, 640)
    run = series(u, np.arange(640.0), reference=u)
    first, second = run.split(0.75)
    assert (first.samples, second.samples) == (480, 160)
    np.testing.assert_array_equal(second.output[:, 0], np.arange(480.0, 640.0))
    cut = run.between(1.0, 2.0)
    np.testing.assert_array_equal(cut.output[:, 0], np.arange(64.0, 128.0))
    assert abs(run.detrended().output.mean()) < 1e-9
    with pytest.raises(ValueError, match="share: 1.0 must be"):
        run.split(1.0)


def test_arrays_are_frozen_copies() -> None:
    u = driven(0, 50)
    run = series(u, u)
    u[0] = 99.0
    assert run.input[0, 0] != 99.0
    with pytest.raises(ValueError, match="read-only"):
        run.input[0, 0] = 1.0


def test_bad_arguments_are_named(record: Record) -> None:
    with pytest.raises(ValueError, match="axes: 'leg_9' is not one of surge"):
        experiment(record, "leg_9")
    with pytest.raises(ValueError, match="rate: 100.0 Hz; the record's 2048.0 Hz"):
        experiment(record, "heave", rate=100.0)
    with pytest.raises(ValueError, match="channel: 'leg_mood' is not one of"):
        experiment(record, "heave", outputs="leg_mood")
    with pytest.raises(ValueError, match="output: sample 3 is not finite"):
        series(np.ones(9), [0, 0, 0, np.nan, 0, 0, 0, 0, 0])
    with pytest.raises(ValueError, match="output: 8 samples; input: 9"):
        series(np.ones(9), np.ones(8))
    with pytest.raises(ValueError, match="input_names: has 1 entries; input has 2"):
        Experiment(np.ones((9, 2)), np.ones(9), 1 / RATE, ("u",), ("y",), ("1", "1"), ("m",))
    with pytest.raises(ValueError, match="factor: 0 must be a whole number"):
        decimated(np.ones(9), 0)
