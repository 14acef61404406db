"""Replay: the compensator's output comes back bit for bit, from files too; a recorder's nearly."""

from pathlib import Path

import numpy as np
import pytest
from shared import cmf

from cmf_mj import Hexapod, Record, SingleLegs, law_names, signals, simulate
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.replay import replay
from cmf_mj.record.columns import read_mapped, write_facility_csv

INCH = 0.0254


@pytest.fixture(scope="module")
def run() -> Record:
    command = signals.chirp("heave", 0.33 * INCH, duration=4.0)
    return simulate(Hexapod(), "acceleration", command)


@pytest.mark.parametrize("law", law_names("all"))
def test_every_law_comes_back_bit_for_bit(law: str) -> None:
    record = simulate(Hexapod(), law, signals.step("pitch", 0.01, at=0.1, duration=0.6))
    replayed = replay(record, law)
    assert np.ptp(record["compensator_output"]) > 0.01
    assert replayed.output.tobytes() == record["compensator_output"].tobytes()
    assert replayed.identical
    assert replayed.difference == 0.0


@pytest.mark.parametrize("law", ["velocity_integral", "acceleration", "force"])
def test_noise_and_converters_come_back_bit_for_bit(law: str, tmp_path: Path) -> None:
    """The record holds what the law read, and its output before clamp and servo electronics."""
    command = signals.step("pitch", 0.01, at=0.1, duration=0.6)
    record = simulate(Hexapod(), law, command, electronics=ElectronicsSettings(seed=3))
    assert (record["leg_position"] != record["leg_extension"]).any()
    assert (record["valve_command"] != record["compensator_output"]).any()
    loaded = Record.load(record.save(tmp_path / "run.parquet"))
    assert replay(loaded).identical


def test_the_law_starts_as_the_record_says(run: Record) -> None:
    """An integral of its own is lost without: another law or another state is not identical."""
    record = simulate(Hexapod(), "velocity_integral", np.zeros((64, 6)))
    said = dict(record.metadata["law_state"])
    assert replay(record, "velocity_integral").identical
    wound = dict(record.metadata) | {"law_state": said | {"error.integral": [0.01] * 6}}
    other = Record(record.time, dict(record.channels), dict(record.units), wound)
    shift = replay(other, "velocity_integral").output - record["compensator_output"]
    expected = 50.0 * 0.01 / INCH * (0.01 - np.array(said["error.integral"]))
    np.testing.assert_allclose(shift[0], expected, rtol=1e-9)


def test_a_run_that_starts_away_from_its_demand_and_from_neutral() -> None:
    command = signals.Command.from_pose(np.full((400, 6), [0.0, 0.0, -0.2, 0.0, 0.0, 0.0]))
    record = simulate(SingleLegs(), "velocity_integral", command, start=[0.0, 0, -0.22, 0, 0, 0])
    assert replay(record, "velocity_integral").identical


def test_a_recorders_file_comes_back_within_a_ten_thousandth(tmp_path: Path) -> None:
    """128 Hz and six decimals of an inch; most of the output is the velocity law's."""
    command = signals.sine("heave", 0.33 * INCH, 1.2, cycles=4.0)
    record = simulate(Hexapod(), "velocity", command, record_every=16)
    path = write_facility_csv(record, tmp_path / "run.csv")
    replayed = replay(read_mapped(path), "velocity")
    assert replayed.interpolated
    assert replayed.output.shape == replayed.recorded.shape
    assert 0.0 < replayed.difference < 1e-4
    assert np.ptp(replayed.output) > 0.05


def without(record: Record, *names: str, rate: float | None = None) -> Record:
    channels = {n: v for n, v in record.channels.items() if n not in names}
    units = {n: record.units[n] for n in channels}
    metadata = dict(record.metadata) | ({"sample_rate": rate} if rate else {})
    time = record.time if rate is None else np.arange(record.time.size) / rate
    return Record(time, channels, units, metadata)


def test_channels_the_law_does_not_read_may_be_missing(run: Record) -> None:
    lacking = without(run, "leg_acceleration", "compensator_output")
    replayed = replay(lacking, "velocity")
    assert replayed.recorded is None
    assert np.isnan(replayed.difference)
    assert replayed.output.tobytes() == replay(run, "velocity").output.tobytes()
    with pytest.raises(
        ValueError, match="leg_acceleration: is not recorded, and the law acceleration"
    ):
        replay(lacking, "acceleration")


def test_refusals(run: Record) -> None:
    with pytest.raises(ValueError, match="sample_rate: 1000"):
        replay(without(run, rate=1000.0), "velocity")
    flat = {**run.channels, "leg_velocity": run["gimbal_error"]}
    with pytest.raises(ValueError, match="leg_velocity: shape"):
        replay(Record(run.time, flat, run.units, run.metadata), "velocity")
    for channel in ("leg_reference", "leg_position", "leg_velocity", "compensator_output"):
        broken = np.array(run[channel])
        broken[5, 2] = np.nan
        other = Record(run.time, {**run.channels, channel: broken}, run.units, run.metadata)
        with pytest.raises(InputError, match=rf"{channel}\[5, 2\]: nan is not a finite number"):
            replay(other, "velocity")
    said = {**run.metadata["law_state"], "compensator": ["a"] * 6}
    other = Record(run.time, run.channels, run.units, {**run.metadata, "law_state": said})
    with pytest.raises(InputError, match="law_state: compensator: holds <U1; allowed: real"):
        replay(other, "acceleration")
    for name in ("machine", "cab"):
        known = {**run.metadata, "cab_parameters": None, name: 3}
        with pytest.raises(InputError, match=f"{name}: '3' is not one of"):
            replay(Record(run.time, run.channels, run.units, known), "velocity")
    with pytest.raises(ValueError, match="does not say which law"):
        replay(Record(run.time, {}, {}, {"sample_rate": 2048.0}))


def test_the_command_line(run: Record, tmp_path: Path, drawn: dict[str, set[str]]) -> None:
    path = run.save(tmp_path / "run.parquet")
    out = tmp_path / "out"
    assert "identical, bit for bit" in cmf("replay", path, "--out", out)
    assert set(drawn) == {"run_acceleration.png"}
    assert "largest difference" in cmf("replay", path, "--law", "velocity", "--out", out)
    assert "no.parquet" in cmf("replay", tmp_path / "no.parquet", "--out", out, code=2)
