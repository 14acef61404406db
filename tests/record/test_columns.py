"""Recordings that others made come in by a map: every kind of file, unit, sign and clock."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
import tomlkit
from scipy.io import savemat

from cmf_mj import InputError, Record, load_machine
from cmf_mj.core.tables import write_table
from cmf_mj.record.columns import ColumnMap, load_columns, read_mapped
from cmf_mj.record.sources import even_clock

LAB = load_machine("lab")
TIME = np.arange(200) / 250.0
LEGS = 1e-3 * np.sin(TIME[:, None] * np.arange(1.0, 7.0))  # [m]


def mapped(**changes: Any) -> ColumnMap:
    position = {"columns": "x{leg}", "unit": "mm"} | changes.pop("position", {})
    made = {"time": {"column": "t"}, "channels": {"leg_position": position}}
    return ColumnMap.model_validate(made | changes)


def columns(legs: Any = 1e3 * LEGS, time: Any = TIME) -> dict[str, Any]:
    return {"t": time, **{f"x{k + 1}": legs[:, k] for k in range(6)}}


def written(folder: Path, ending: str, content: dict[str, Any]) -> Path:
    file = folder / f"run{ending}"
    if ending == ".mat":
        savemat(file, {"log": {"t": content["t"], "x": np.stack([*content.values()][1:], axis=1)}})
    elif ending == ".h5":
        with h5py.File(file, "w") as target:
            for name, values in content.items():
                target[name] = values
    else:
        write_table(pa.table(content), file)
    return file


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".h5"])
def test_files_of_any_kind_give_the_same_record(ending: str, tmp_path: Path) -> None:
    record = read_mapped(written(tmp_path, ending, columns()), mapped(), LAB)
    np.testing.assert_allclose(record["leg_position"], LEGS, atol=1e-15)
    assert (record.rate, record.units["leg_position"]) == (250.0, "m")


def test_structures_of_matlab_and_version_7_3(tmp_path: Path) -> None:
    file = written(tmp_path, ".mat", columns())
    names = mapped(time={"column": "log.t"}, position={"columns": "log.x_{leg}"})
    np.testing.assert_allclose(read_mapped(file, names, LAB)["leg_position"], LEGS, atol=1e-15)
    with h5py.File(file, "w", userblock_size=512) as target:  # as MATLAB writes it: rows are legs
        target["log/t"], target["log/x"] = TIME[None], 1e3 * LEGS.T
    with file.open("r+b") as header:
        header.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    np.testing.assert_allclose(read_mapped(file, names, LAB)["leg_position"], LEGS, atol=1e-15)


def test_text_of_a_logger_with_decimal_commas(tmp_path: Path) -> None:
    rows = [
        ";".join(f"{v:.6f}".replace(".", ",") for v in row)
        for row in zip(*columns().values(), strict=True)
    ]
    file = tmp_path / "log.csv"
    head = ["Logger 7", "t;x1;x2;x3;x4;x5;x6", "[s]" + 6 * ";[mm]"]
    file.write_text("\n".join([*head, *rows, "# end"]), encoding="latin-1")
    np.testing.assert_allclose(read_mapped(file, mapped(), LAB)["leg_position"], LEGS, atol=1e-9)


def test_sign_scale_offset_and_order(tmp_path: Path) -> None:
    """Counts of 0.5 mm from 100 mm on, retracting positive, legs from 0 on."""
    content = columns(2.0 * (100.0 - 1e3 * LEGS))
    names = {f"x{k + 1}": f"y{k}" for k in range(6)}
    file = written(tmp_path, ".csv", {names.get(n, n): v for n, v in content.items()})
    position = {"columns": "y{leg}", "scale": 0.5, "sign": -1, "offset": 100.0}
    record = read_mapped(file, mapped(position=position, legs=[0, 1, 2, 3, 4, 5]), LAB)
    np.testing.assert_allclose(record["leg_position"], LEGS, atol=1e-12)


@pytest.mark.parametrize("retracting", [1, -1])
def test_the_stroke_of_a_whole_file_counts_from_its_offset(retracting: int, tmp_path: Path) -> None:
    """Half-millimetres from retracted, up to twice the half stroke: a count is no extension."""
    half = 1e3 * LAB.half_stroke
    legs = np.tile(np.linspace(0.01, 1.99, 200)[:, None] * half, (1, 6))
    position = {"scale": 0.5, "sign": retracting, "offset": half}
    chosen = mapped(position=position, whole=True)
    record = read_mapped(written(tmp_path, ".csv", columns(2.0 * legs)), chosen, LAB)
    due = 1e-3 * retracting * (legs - half)
    np.testing.assert_allclose(record["leg_position"], due, atol=1e-12)
    legs[5, 2] = -1.0
    words = f"x3: row 6 has no such; allowed: a number within {half:g} mm of {half:g}"
    with pytest.raises(InputError, match=words):
        read_mapped(written(tmp_path, ".csv", columns(2.0 * legs)), chosen, LAB)


@pytest.mark.parametrize("untold", [0.0, np.nan, None])
def test_a_column_without_numbers_does_not_tell_the_last_place(
    untold: float | None, tmp_path: Path
) -> None:
    content = columns(np.round(1e3 * LEGS, 3))
    content["x2"] = np.full(200, untold)
    if untold is None:
        del content["x2"]
    channels = {"leg_reference": {"columns": "x{leg}", "unit": "mm"}}
    file = written(tmp_path, ".parquet", content)
    record = read_mapped(file, mapped(channels=channels), LAB)
    assert record.metadata["recording"]["last_place"] == pytest.approx(1e-6)


@pytest.mark.parametrize("rate", [128.0, 333.33, 682.0 + 2.0 / 3.0, 2048.0])
def test_clock_is_found_through_stamps_of_few_digits(rate: float) -> None:
    even, found = even_clock(np.round(3.7 + np.arange(5000) / rate, 4))
    assert found == pytest.approx(rate, rel=1e-5)
    np.testing.assert_allclose(even, 3.7 + np.arange(5000) / rate, atol=1e-4)


def test_uneven_time_is_refused_with_its_place_or_resampled(tmp_path: Path) -> None:
    time = TIME + 0.003 * (np.arange(200) >= 100)
    file = written(tmp_path, ".parquet", columns(time=time))
    with pytest.raises(InputError, match=r"row 101, 0.403 s, is 0.007 s after the row before"):
        read_mapped(file, mapped(), LAB)
    record = read_mapped(file, mapped(time={"column": "t", "resample": 500.0}), LAB)
    due = np.interp(record.time, time, LEGS[:, 2])
    np.testing.assert_allclose(record["leg_position"][:, 2], due, atol=1e-15)
    with pytest.raises(InputError, match=r"time: 0\.25 samples a second by unit 's' is refused"):
        read_mapped(
            written(tmp_path, ".parquet", columns(time=1e3 * TIME)),
            mapped(time={"column": "t", "resample": 500.0}),
            LAB,
        )
    time = TIME + 0.5 * (np.arange(200) >= 100)  # rows are lost: no line is drawn across
    file = written(tmp_path, ".parquet", columns(time=time))
    record = read_mapped(file, mapped(time={"column": "t", "resample": 500.0}), LAB)
    lost = np.isnan(record["leg_position"]).all(axis=1)
    assert lost.sum() / 500.0 == pytest.approx(0.5, abs=0.005)


def test_gaps_stay_or_are_bridged_and_counted(tmp_path: Path) -> None:
    legs = 1e3 * LEGS.copy()
    legs[50:54, 1] = np.nan
    file = written(tmp_path, ".csv", columns(legs))
    assert np.isnan(read_mapped(file, mapped(), LAB)["leg_position"]).sum() == 4
    record = read_mapped(file, mapped(bridge=0.02), LAB)
    line = np.interp(np.arange(50, 54), [49, 54], LEGS[[49, 54], 1])
    np.testing.assert_allclose(record["leg_position"][50:54, 1], line, atol=1e-15)
    assert record.metadata["recording"]["bridged"] == {"leg_position/1": 4}


def test_legs_that_nobody_recorded_are_named(tmp_path: Path) -> None:
    content = {name: v for name, v in columns().items() if name not in ("x4", "x5")}
    record = read_mapped(written(tmp_path, ".csv", content), mapped(), LAB)
    assert np.isnan(record["leg_position"]).all(axis=0).tolist() == [False] * 3 + [True] * 2 + [
        False
    ]
    assert record.metadata["recording"]["missing"] == ["x4", "x5"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": {"unit": "bar"}}, "unit: 'bar' is Pa; allowed: a unit of m"),
        ({"position": {"columns": "x"}}, "allowed: a pattern with {leg}, or six names"),
        ({"time": {}}, "needs either column or rate"),
        ({"channels": {"leg_positon": {}}}, "did you mean leg_position"),
    ],
)
def test_map_that_cannot_be_is_refused(changes: Any, words: str, tmp_path: Path) -> None:
    position = {"columns": "x{leg}", "unit": "mm"} | changes.pop("position", {})
    table = {"time": {"column": "t"}, "channels": {"leg_position": position}} | changes
    file = tmp_path / "map.toml"
    full = {"columns": "x{leg}", "unit": "mm"}
    table["channels"] = {name: full | one for name, one in table["channels"].items()}
    file.write_text(tomlkit.dumps(table))
    with pytest.raises(InputError, match=words.replace("{", r"\{")):
        load_columns(file)


def test_record_from_arrays_in_units_of_the_field() -> None:
    record = Record.from_arrays(TIME, {"leg_position": 1e3 * LEGS}, {"leg_position": "mm"})
    np.testing.assert_allclose(record["leg_position"], LEGS, atol=1e-15)
    with pytest.raises(InputError, match="row 3, 0.5 s"):
        Record.from_arrays([0.0, 0.1, 0.5, 0.6], {}, {})
