"""Columns of files as others write them: headers, units, comments, dates and text types."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from cmf_mj.record.sources import Source, read_source

NAMES = ["t", "q", "x", "y"]
ROWS = ["0.0,1,2,3", "0.1,4,5,6", "0.2,7,8,9"]


def source_of(folder: Path, *lines: str) -> Source:
    file = folder / "log.csv"
    file.write_text("\n".join([*lines, ""]))
    return read_source(file)


def as_read(source: Source) -> dict[str, list[float]]:
    return {name: values.tolist() for name, values in source.columns.items()}


@pytest.mark.parametrize(
    "above",
    [
        ["Test 12,,,"],  # a title as Excel saves it
        ["2026-11-28,,,"],
        ["12,,,"],
        ["Test 12,,,", "2026,,,"],
        ["Operator,Smith,2026,3"],
        ["Rig,Oil,Place,Place"],
        ["# 1,2,3,4"],
    ],
)
def test_what_stands_above_a_header_is_no_row(above: list[str], tmp_path: Path) -> None:
    source = source_of(tmp_path, *above, ",".join(NAMES), *ROWS)
    assert [*source.columns] == NAMES
    assert source.columns["y"].tolist() == [3.0, 6.0, 9.0]


@pytest.mark.parametrize(
    "units",
    [
        ["s", "-", "-", "-"],
        ["s", "l/min", "mm", "mm"],
        ["s", "counts", "counts", "counts"],
        ["[s]", "[l/min]", "", "[mm]"],
        ["sec", "Volts", "counts", "mm"],
        ["mm", "mm/s^2", "kg m^2", "bar"],
    ],
)
@pytest.mark.parametrize("title", [[], ["Test 12,,,"]])
def test_units_below_a_header_do_not_replace_it(
    units: list[str], title: list[str], tmp_path: Path
) -> None:
    source = source_of(tmp_path, *title, ",".join(NAMES), ",".join(units), *ROWS)
    assert [*source.columns] == NAMES
    assert source.columns["t"].tolist() == [0.0, 0.1, 0.2]
    assert [*source.units.values()] == [unit.strip("[]") for unit in units]


def test_first_rows_may_have_empty_cells_once_there_is_a_number(tmp_path: Path) -> None:
    """Loggers of several rates leave most cells empty, and a sensor may begin late."""
    sparse = ["0.0,,,", "0.1,4,,", "NaN,,nan,", "-,,,"]
    source = source_of(tmp_path, ",".join(NAMES), *sparse)
    np.testing.assert_array_equal(source.columns["t"], [0.0, 0.1, np.nan, np.nan])
    np.testing.assert_array_equal(source.columns["q"], [np.nan, 4.0, np.nan, np.nan])
    source = source_of(tmp_path, ",".join(NAMES), "nan,nan,nan,nan", *ROWS)
    assert source.columns["t"].size == 4 and [*source.columns] == NAMES


def test_a_quoted_name_may_hold_the_separator(tmp_path: Path) -> None:
    source = source_of(tmp_path, '"t [s]","pos, mm"', "0,1", "1,2")
    assert as_read(source) == {"t [s]": [0.0, 1.0], "pos, mm": [1.0, 2.0]}


def test_a_row_without_its_first_number_is_no_comment(tmp_path: Path) -> None:
    source = source_of(tmp_path, "x,t", "1,0.0", "#N/A,0.1", "3,0.2", "# N/A,0.3")
    assert source.columns["t"].tolist() == [0.0, 0.1, 0.2]
    np.testing.assert_array_equal(source.columns["x"], [1.0, np.nan, 3.0])


@pytest.mark.parametrize("delimiter", [",", " "])
def test_a_header_that_is_commented_counts(delimiter: str, tmp_path: Path) -> None:
    """As `numpy.savetxt` writes it; a header without a mark is preferred."""
    file, rows = tmp_path / "log.csv", np.array([[0.0, 1.0], [0.5, 2.0]])
    np.savetxt(file, rows, delimiter=delimiter, header=f"run 7 of 9\nt{delimiter}x", footer="a,b")
    assert as_read(read_source(file)) == {"t": [0.0, 0.5], "x": [1.0, 2.0]}
    assert [*source_of(tmp_path, "# a,b", "t,x", "0,1", "1,2").columns] == ["t", "x"]


@pytest.mark.parametrize("comment", ["# 1,2,3,4", "# on,and,on,and", "# of two,parts"])
def test_a_comment_that_is_no_header_names_no_column(comment: str, tmp_path: Path) -> None:
    assert [*source_of(tmp_path, comment, *ROWS).columns] == [f"column_{k}" for k in range(1, 5)]


@pytest.mark.parametrize("name", ["date", "large", "category", "duration", "bytes"])
def test_a_column_of_any_type_leaves_the_others_readable(name: str, tmp_path: Path) -> None:
    days = pa.array([20_000, 20_001, 20_003], pa.int32())
    odd, due = {
        "date": (days.cast(pa.date32()), [0.0, 86400.0, 3.0 * 86400.0]),
        "large": (pa.array(["1,5", "2.5", "x"], pa.large_string()), [1.5, 2.5, np.nan]),
        "category": (pa.array(["12:00:02", "12:00:00", "12:00:00"]).dictionary_encode(), [2, 0, 0]),
        "duration": (pa.array([1, 2, 3], pa.duration("ms")), None),
        "bytes": (pa.array([b"a", b"b", b"c"]), None),
    }[name]
    file = tmp_path / "log.parquet"
    pyarrow.parquet.write_table(pa.table({"t": [0.0, 1.0, 2.0], name: odd}), file)
    source = read_source(file)
    assert source.columns["t"].tolist() == [0.0, 1.0, 2.0]
    assert [*source.columns] == ["t"] + ([] if due is None else [name])
    if due is not None:
        np.testing.assert_allclose(source.columns[name], due, rtol=1e-15)


def test_dates_of_a_csv_are_seconds_from_the_earliest(tmp_path: Path) -> None:
    source = source_of(tmp_path, "day,x", "2026-11-29,1", "2026-11-28,2")
    assert as_read(source) == {"day": [86400.0, 0.0], "x": [1.0, 2.0]}
    assert source.units["day"] == "s"


def test_columns_of_another_length_go_with_their_units(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name, count in (("t", 3), ("x", 3), ("map", 2)):
            file[name] = np.arange(count)
            file[name].attrs["unit"] = "m"
    source = read_source(tmp_path / "log.h5")
    assert {*source.columns} == {*source.units} == {"t", "x"}
