"""Records that a plausible mistake has made: refused by name, or measured right."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from followed_commands import record_of
from typer.testing import CliRunner

from cmf_mj import Record, bandwidths, frequency_response, signals, step_metrics
from cmf_mj.analysis.frequency_response import (
    line_bandwidths,
    matrix_frequency_response,
    rounds_response,
)
from cmf_mj.cli.common import app
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import RATE
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.columns import read_mapped, write_facility_csv
from cmf_mj.signals.composite import orthogonal_multisines
from cmf_mj.studies.measurement import measure_recordings

CHIRP = signals.chirp("heave", 0.008, duration=30.0)
STEP = signals.step("heave", 0.0254, at=1.0, duration=7.0)


def lagging(command: signals.Command, every: int, lag: float = 0.05) -> Record:
    """A record whose platform follows its command with a first-order lag [s]: -45 deg at
    1 / (2 pi lag) Hz, and no peak."""
    feedback, share = command.pose.copy(), 1.0 - np.exp(-1.0 / (lag * RATE))
    for row in range(1, len(feedback)):
        feedback[row] = feedback[row - 1] + share * (command.pose[row] - feedback[row - 1])
    return record_of(command, feedback, every)


def changed(record: Record, **metadata: Any) -> Record:
    return Record(record.time, record.channels, record.units, {**record.metadata, **metadata})


def without_comments(path: Path) -> str:
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith("#"))


@pytest.fixture(scope="module")
def swept() -> Record:
    return lagging(CHIRP, 16)


@pytest.fixture(scope="module")
def stepped() -> Record:
    return lagging(STEP, 8)


@pytest.mark.parametrize("every", [103, 200, 256])
@pytest.mark.parametrize("make", [signals.chirp, signals.multisine])
def test_a_record_too_slow_for_its_excitation_is_refused(
    make: Callable[..., signals.Command], every: int
) -> None:
    """10 Hz needs 20 samples a second (Shannon); 2048 / 103 is 19.9. What is above half of that
    folds down onto the lines below it with a coherence of 1."""
    period = {"period": 103 * 8 / RATE, "periods": 2} if make is signals.multisine else {}
    command = make("heave", 0.005, **period)
    with pytest.raises(InputError, match=r"record_every: .* cannot hold 10(\.0\d*)? Hz of the"):
        frequency_response(record_of(command, command.pose, every))


def test_a_matrix_of_a_record_too_slow_is_refused() -> None:
    command = orthogonal_multisines(np.full(6, 1e-3), period=4.0, periods=2)
    with pytest.raises(InputError, match="record_every: 16 samples a second cannot hold 10 Hz"):
        matrix_frequency_response(record_of(command, command.pose, 128))


@pytest.mark.parametrize(
    ("time", "said"),
    [
        (lambda t: t[::-1], "time: sample 1 at"),
        (lambda t: 0.0 * t, "time: sample 1 at 0.0 s is not at 128.0 Hz"),
        (lambda t: np.where(t > 1.0, np.nan, t), "time: sample 129 at nan s"),
        (lambda t: 2.0 * t, "time: sample 1 at 0.015625 s is not at 128.0 Hz"),
        (lambda t: np.repeat(t, 2)[: t.size], "time: sample 1 at 0.0 s"),
    ],
    ids=["reversed", "zero", "not a number", "doubled", "every row twice"],
)
def test_times_that_are_not_those_of_the_rate_are_refused(
    swept: Record, stepped: Record, time: Any, said: str
) -> None:
    wrong = Record(time(swept.time), swept.channels, swept.units, swept.metadata)
    with pytest.raises(InputError, match=said):
        frequency_response(wrong)
    wrong = Record(time(stepped.time), stepped.channels, stepped.units, stepped.metadata)
    with pytest.raises(InputError, match="time: sample"):
        step_metrics(wrong)


@pytest.mark.parametrize("rate", [0, 0.0, -128.0, float("nan"), float("inf"), True, "128", None])
def test_a_sampling_rate_that_is_none_is_refused(swept: Record, rate: Any) -> None:
    with pytest.raises(InputError, match=r"sample_rate: .* is refused; allowed: a number above 0"):
        frequency_response(changed(swept, sample_rate=rate))


@pytest.mark.parametrize("unit", ["in", "mm", "deg", "psi", "lbf", "m/min", "", "M", "Pascal"])
def test_units_that_are_not_of_si_are_refused(unit: str) -> None:
    with pytest.raises(InputError, match=f"units: leg_position: {unit!r} is refused"):
        Record(np.zeros(1), {"leg_position": np.zeros((1, 6))}, {"leg_position": unit}, {})


def test_empty_records_are_refused() -> None:
    legs = dict.fromkeys(("leg_reference", "leg_position"), np.zeros((0, 6)))
    for command, measure in ((CHIRP, frequency_response), (STEP, step_metrics)):
        told = {"sample_rate": 128.0, "command": command.description}
        empty = Record(np.zeros(0), legs, dict.fromkeys(legs, "m"), told)
        with pytest.raises(InputError, match="record: has no samples"):
            measure(empty)
    with pytest.raises(InputError, match="response: has no lines"):
        line_bandwidths([], np.zeros(0, dtype=complex))


# -- recordings -------------------------------------------------------------------------------


def test_what_the_last_decimal_leaves_along_another_axis_is_no_demand(
    swept: Record, tmp_path: Path
) -> None:
    """Six legs rounded to 1e-6 in: 5e-8 m of a pure heave sweep appear along every other axis."""
    path = write_facility_csv(swept, tmp_path / "swept.csv")
    bare = tmp_path / "bare.csv"
    bare.write_text(without_comments(path))
    for file in (path, bare):
        for dof in set(DOFS) - {"heave"}:
            for estimator in ("h1", "report"):
                with pytest.raises(InputError, match=f"dof: the record holds no demand in {dof}"):
                    measure_recordings([file], dof, estimator)


def test_a_small_demand_is_measured_where_the_file_resolves_it(tmp_path: Path) -> None:
    """A hundredth of the report's amplitude, 84 micrometres, in a file of 25 nm: 1 %."""
    small = lagging(signals.chirp("heave", 84e-6, duration=30.0), 16)
    path = write_facility_csv(small, tmp_path / "small.csv")
    read, kept = (frequency_response(r, "heave") for r in (read_mapped(path), small))
    low = kept.frequency < 3.0
    np.testing.assert_allclose(np.abs(read.response[low]), np.abs(kept.response[low]), rtol=0.01)


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("law", ("velocity", "force")),
        ("plant", ("hexapod", "single_legs")),
        ("cab", ("gfd", "rfd")),
        ("hydraulics", ("hardware", "report")),
        ("machine", ("cmf", "lab")),
        ("law_parameters", ({"gain": 1.0}, {"gain": 2.0})),
        ("events", ([], [{"kind": "valve_dead", "leg": 1}])),
    ],
)
def test_recordings_of_different_sessions_are_not_rounds_of_one(
    swept: Record, field: str, values: tuple[Any, Any]
) -> None:
    other = lagging(signals.chirp("heave", 0.004, duration=30.0), 16)
    pair = [changed(r, **{field: v}) for r, v in zip((swept, other), values, strict=True)]
    with pytest.raises(InputError, match=f"records: {field}"):
        rounds_response(pair)
    assert rounds_response([pair[0], other]).frequency.size > 100  # one does not tell


def test_recordings_of_different_axes_are_not_rounds_of_one(swept: Record) -> None:
    other = lagging(signals.chirp("surge", 0.008, duration=30.0), 16)
    with pytest.raises(InputError, match="records: axis: 'heave' and 'surge' differ"):
        rounds_response([swept, other], "heave")


def test_a_recording_counts_once(swept: Record, tmp_path: Path) -> None:
    names = [tmp_path / name for name in ("one.csv", "other.csv", "copy.csv")]
    for name, amplitude in zip(names, (0.008, 0.004, 0.008), strict=True):
        command = signals.chirp("heave", amplitude, duration=30.0)
        write_facility_csv(lagging(command, 16), name)
    with pytest.raises(InputError, match="records: 1 and 3 hold the same samples"):
        measure_recordings(names, "heave", "h1")


@pytest.mark.parametrize("machine", ["cmf", "simona"])
def test_a_recording_with_columns_of_its_own_is_measured_by_their_map(
    swept: Record, machine: str, tmp_path: Path
) -> None:
    """The same samples as the facility's file, in mm and in under other names, say the same."""
    table = {"t": 1e3 * swept.time}
    for letter, channel, size in (("x", "leg_position", 1e-3), ("r", "leg_reference", 0.0254)):
        table |= {f"{letter}{k + 1}": swept[channel][:, k] / size for k in range(6)}
    file, mapped = tmp_path / "own.csv", tmp_path / "columns.toml"
    rows = np.column_stack([*table.values()])
    np.savetxt(file, rows, delimiter=",", header=",".join(table), comments="")
    mapped.write_text(
        f"""machine = "{machine}"
        time = {{ column = "t", unit = "ms" }}
        [channels]
        leg_position = {{ columns = "x{{leg}}", unit = "mm" }}
        leg_reference = {{ columns = "r{{leg}}", unit = "in" }}"""
    )
    what = ["measure", str(file), "--columns", str(mapped), "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(app, what).exit_code == 0
    with (tmp_path / "out" / "measures.csv").open() as file:
        found = {row["measure"]: row["value"] for row in csv.DictReader(file)}
    facility = write_facility_csv(swept, tmp_path / "swept.csv")
    expected = bandwidths(measure_recordings([facility], "heave", "h1").response)
    measured = float(found["-3 dB bandwidth"].removesuffix(" Hz"))
    assert measured == pytest.approx(expected.gain_hz, rel=1e-3)


@pytest.mark.parametrize("estimator", ["h1", "report"])
def test_only_lines_that_are_excited_and_cohere_are_read(estimator: str, tmp_path: Path) -> None:
    """A multisine up to 5 Hz of which no comment line tells: a lag has no peak, and nothing above
    5 Hz was asked. What is left out is counted."""
    command = signals.multisine("heave", 0.005, stop=5.0, period=20.0, periods=3)
    path = write_facility_csv(lagging(command, 16), tmp_path / "told.csv")
    path.write_text(without_comments(path))
    measures = measure_recordings([path], "heave", estimator)
    assert bandwidths(measures.response).peak_db < 0.3
    assert measures.response.frequency.max() < 5.2
    assert measures.response.coherence.min() >= 0.8
    assert measures.left_out > 400


# -- steps ------------------------------------------------------------------------------------


def test_a_step_of_a_lag_is_measured(stepped: Record) -> None:
    """10 to 90 % of a first-order lag take ln 9 of it, 0.1099 s; two samples of 1/256 s."""
    metrics = step_metrics(stepped)
    assert metrics.stable
    assert metrics.rise_time == pytest.approx(np.log(9.0) * 0.05, abs=2.0 / 256.0)


def touched(record: Record, row: int | slice, value: float) -> Record:
    legs = record["leg_position"].copy()
    legs[row, 2] = value
    channels = {**record.channels, "leg_position": legs}
    return Record(record.time, channels, record.units, record.metadata)


@pytest.mark.parametrize("row", [3, 700, -1])
def test_a_reading_that_is_no_number_is_no_unstable_run(stepped: Record, row: int) -> None:
    with pytest.raises(InputError, match=r"leg_position\[\d+, \d\]: nan is not a finite number"):
        step_metrics(touched(stepped, row, np.nan))


@pytest.mark.parametrize("row", [3, 600, 700, -1])
def test_a_reading_beyond_the_stops_is_refused(stepped: Record, row: int) -> None:
    """38 in and 2 in for the stops' give: 1.0152 m. 600 lies in the earlier window of the verdict,
    where an outlier passed for a ring that has decayed."""
    with pytest.raises(InputError, match=r"leg_position: 10 m of leg 3 in row .* within its stops"):
        step_metrics(touched(stepped, row, 10.0))


def test_a_record_cut_before_its_windows_is_refused(stepped: Record) -> None:
    kept = slice(0, round(3.9 * 256))
    channels = {name: values[kept] for name, values in stepped.channels.items()}
    cut = Record(stepped.time[kept], channels, stepped.units, stepped.metadata)
    with pytest.raises(InputError, match=r"must go on for 5.0 s after the step; it has 0 to 3.898"):
        step_metrics(cut)


@pytest.mark.parametrize("every", [64, 512, 1024, 2048])
def test_a_step_sampled_too_slowly_is_refused(every: int) -> None:
    """A limit cycle of five times the step at 2 Hz stands still in two samples a second."""
    feedback = STEP.pose.copy()
    time = np.arange(len(feedback)) / RATE
    feedback[:, 2] += 0.127 * np.sin(2.0 * np.pi * 2.0 * time)
    with pytest.raises(InputError, match=r"record_every: .* samples a second; allowed: from 64"):
        step_metrics(record_of(STEP, feedback, every))
    assert not step_metrics(record_of(STEP, feedback, 32)).stable


def test_a_rise_within_a_sample_is_refused() -> None:
    with pytest.raises(InputError, match="goes from 10 to 90 % of the step within a sample"):
        step_metrics(record_of(STEP, STEP.pose, 8))


@pytest.mark.parametrize("size", [1e-8, 1e-7, 1e-6])
def test_a_step_smaller_than_the_motion_before_it_is_refused(size: float) -> None:
    """Legs that settle by 4 micrometres with 1 s from the step on: 28 % of them, 1.1 micrometres,
    in the quarter second before it."""
    command = signals.step("heave", size, at=1.0, duration=7.0)
    feedback, time = command.pose.copy(), np.arange(len(command.pose)) / RATE - 1.0
    feedback[:, 2] = size * (1.0 - np.exp(-20.0 * np.maximum(time, 0.0))) - 4e-6 * np.exp(-time)
    with pytest.raises(InputError, match=r"record: moves by .* before a step of"):
        step_metrics(record_of(command, feedback, 8))


def test_a_step_of_nothing_is_refused(stepped: Record) -> None:
    still = signals.step("heave", 0.0, at=1.0, duration=7.0)
    with pytest.raises(InputError, match="dof: the record holds no step in heave"):
        step_metrics(record_of(still, still.pose, 8))


def test_the_command_line_refuses_with_status_2(swept: Record, tmp_path: Path) -> None:
    path = str(write_facility_csv(swept, tmp_path / "swept.csv"))
    for options, said in (
        (["--dof", "pitch"], "dof: the record holds no demand in pitch"),
        ([path], "records: 1 and 2 hold the same samples"),
    ):
        line = ["measure", path, *options, "--out", str(tmp_path / "out")]
        result = CliRunner().invoke(app, line)
        assert result.exit_code == 2, result.output
        assert said in " ".join(result.output.split())
        assert not (tmp_path / "out").exists()
