"""A measuring session against what is known of the plant without it."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from cmf_mj import SingleLegs, signals, simulate
from cmf_mj.core.units import RATE
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.show.look import plain_data
from cmf_mj.show.measurement import measurement_table, save_measurement
from cmf_mj.signals.composite import acceleration_step
from cmf_mj.studies.case import make_case
from cmf_mj.studies.measurement import Measurement, dof_accelerations, measure


@pytest.fixture(scope="module")
def session() -> Measurement:
    case = make_case("velocity", "heave", "single_legs")
    return measure(case, frequencies=(0.5, 2.0), shares=(0.25, 1.0))


def test_describing_function_at_the_sweep_s_amplitude_is_its_response(
    session: Measurement,
) -> None:
    """Single sines and the chirp measure the same thing: 0.1 dB and 1 deg."""
    for point in session.describing_function:
        if point.amplitude == session.case.size:
            index = int(np.abs(session.response.frequency - point.frequency_hz).argmin())
            assert point.gain_db == pytest.approx(session.response.gain_db[index], abs=0.1)
            assert point.phase_deg == pytest.approx(session.response.phase_deg[index], abs=1.0)


def test_second_order_fit_and_overshoot_agree_on_the_damping(session: Measurement) -> None:
    """Two definitions of one thing; the loop is of higher order, so 0.05."""
    assert session.second_order is not None
    assert session.second_order.damping_ratio == pytest.approx(
        session.measures.damping_ratio, abs=0.05
    )


def test_hysteresis_is_the_lag_of_the_loop(session: Measurement) -> None:
    """No friction is modelled: what opens the loop is the low-frequency delay, from the phase of
    the describing function at 0.5 Hz: sin(2 pi 0.01 d), within a tenth."""
    phase = next(p.phase_deg for p in session.describing_function if p.frequency_hz == 0.5)
    delay = -np.radians(phase) / (2.0 * np.pi * 0.5)
    gain = 47.0 / 50.48
    assert session.hysteresis == pytest.approx(gain * np.sin(2e-2 * np.pi * delay), rel=0.1)


def test_summary_is_json_with_every_measure(session: Measurement) -> None:
    summary = json.loads(json.dumps(plain_data(session.summary()), allow_nan=False))
    assert summary["law"] == "velocity"
    for driven, row in summary["crosstalk"].items():
        assert row[driven] == 1.0
    assert summary["crosstalk"]["heave"]["surge"] < 1e-3  # six equal legs move a pure heave
    assert summary["crosstalk"]["surge"]["sway"] < 1e-3  # and the machine is symmetric
    assert [p["amplitude"] for p in summary["half_hertz_noise"]] == sorted(
        p["amplitude"] for p in summary["half_hertz_noise"]
    )


def test_session_is_written_as_table_figures_and_files(
    session: Measurement, tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    paths = save_measurement(session, tmp_path / "out")
    assert [path.name for path in paths] == ["response.csv", "response.png", "summary.json"]
    with paths[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == session.response.frequency.size
    assert set(drawn) == {"response.png"}
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(measurement_table(session))
    text = console.export_text()
    for measure_name in ("-90 deg bandwidth", "half-hertz noise", "hysteresis", "crosstalk"):
        assert measure_name in text
    assert text.count("describing function") == len(session.describing_function)


def test_acceleration_step_moves_at_constant_acceleration() -> None:
    command = acceleration_step("surge", 0.2, hold=0.5)
    history = command.pose[:, 0]
    second = np.diff(history, 2) * RATE**2
    inside = slice(RATE + 5, RATE + 1000)
    np.testing.assert_allclose(second[inside], 0.2, rtol=1e-6)
    assert history[-1] == pytest.approx(0.2 * 0.25, rel=1e-12)
    assert history[-1] == history[-2]
    with pytest.raises(ValueError, match="acceleration: 0.0 over 0.5 s is no step"):
        acceleration_step("surge", 0.0, hold=0.5)


def test_accelerations_from_the_legs_are_the_second_derivative_of_the_pose() -> None:
    """Against the recorded legs' second difference, one step late as the sensor is."""
    record = simulate(SingleLegs(), "velocity", signals.sine("pitch", 0.01, 1.0, cycles=3.0))
    pose = legs_to_pose(record["leg_position"])
    second = np.diff(pose, 2, axis=0) * RATE**2
    measured = dof_accelerations(record)[2:]
    scale = np.abs(second[:, 4]).max()
    np.testing.assert_allclose(measured[:, 4], second[:, 4], rtol=0, atol=2e-3 * scale)
