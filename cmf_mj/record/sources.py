"""Columns and clocks of recordings that others made: CSV, Parquet, HDF5 and MAT files.

A column is a name and numbers, NaN where there is none; dates and times of day are seconds from the
earliest. An array of rows by columns, as HDF5 and MAT files hold, gives `name_1`, `name_2` and so
on; a table in a table gives `table.name`, a group of HDF5 `group/name`, a structure of MATLAB
`structure.name`. A CSV file may have text above its header, units in a row below it, any of the
separators comma, semicolon, tab and blanks, a decimal comma, and comments that begin with `#`, of
which the last above the numbers may be the header; the last `# cmf_mj {...}` has metadata as JSON.
"""

import csv
import io
import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from statistics import mode
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.csv
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, reason, require, unknown_name
from cmf_mj.core.settings import check_file, parsed_json
from cmf_mj.core.tables import read_table

Array = NDArray[np.float64]

_NULLS = ["", "nan", "NaN", "NAN", "NA", "N/A", "null", "-", "#N/A", "-nan", "-nan(ind)", "1.#QNAN"]
_NUMBER = r"[+-]?([0-9]+([.,][0-9]*)?|[.,][0-9]+)([eE][+-]?[0-9]+)?"
_CELL = re.compile(rf"{_NUMBER}|[+-]?inf|(?i:-?nan)|[0-9][-0-9:./T ]*Z?")
"""A number, date or time of day."""
_COMMENT = re.compile(r"\s*#(?!N/A)")  #: How a line begins that is a comment.
_HEADER_LINES = 200  #: Lines in which the header of a CSV file is looked for.
_CLOCK = r"^[0-9]{2}:[0-9]{2}:[0-9]{2}([.][0-9]+)?$"  #: Pattern of a time of day, for pyarrow.

_MAX_STAMP_ERROR, _MAX_INTERVAL_ERROR = 0.4, 0.6  #: In samples.
REMARK = "# cmf_mj "  #: How the comment with the metadata of a CSV file begins.
_GAP_INTERVALS = 3.0  #: Longest interval of a resampled recording, in medians.


class _Column(NamedTuple):
    name: str
    unit: str  #: Empty where the file states none.
    values: Array  #: (N,).


class Source(NamedTuple):
    """What a file holds."""

    path: Path
    columns: Mapping[str, Array]  #: Name to numbers, (N,).
    units: Mapping[str, str]  #: Name to unit, empty where the file states none.
    metadata: Mapping[str, Any] = {}  #: What a CSV file says of itself.
    ended: bool = True  #: False if the last line has no line end and may be cut off.

    def column(self, name: str) -> Array:
        """A column by name; refused with the most similar one."""
        if name not in self.columns:
            raise unknown_name("column", name, self.columns)
        return self.columns[name]


def read_source(path: str | Path) -> Source:
    """All columns of numbers of a file, by its ending: .csv, .txt, .parquet, .h5, .hdf5 or .mat."""
    file = check_file(Path(path))
    read = _READERS.get(file.suffix.lower())
    if read is None:
        raise InputError(f"{file}: ending {file.suffix!r} is not one of {', '.join(_READERS)}")
    try:
        return read(file)
    except (OSError, ValueError, TypeError, KeyError, csv.Error, pa.ArrowException) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{file}: cannot be read: {reason(error)}") from error


def _source(path: Path, columns: Iterator[_Column], **fields: Any) -> Source:
    """A source of the columns whose length is the commonest; the others are dropped."""
    columns_of_length: dict[int, list[_Column]] = {}
    for column in columns:
        columns_of_length.setdefault(column.values.size, []).append(column)
    if not columns_of_length:
        raise InputError(f"{path}: has no column of numbers")
    length = max(columns_of_length, key=lambda size: (len(columns_of_length[size]), size))
    kept_columns = columns_of_length[length]
    values = {column.name: column.values for column in kept_columns}
    return Source(path, values, {column.name: column.unit for column in kept_columns}, **fields)


def _csv(path: Path) -> Source:
    """Read a CSV file: names and units above its first row of numbers, rows, metadata."""
    raw_bytes = path.read_bytes()
    try:
        text = raw_bytes.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw_bytes.decode("latin-1")
    all_lines = text.splitlines()
    lines = [line for line in all_lines if line.strip() and not _COMMENT.match(line)]
    separator, first_row = _find_rows(path, lines[:_HEADER_LINES])
    rows, header_lines = lines[first_row:], lines[max(first_row - 2, 0) : first_row]
    width = len(_cells(rows[0], separator))
    header, units_below = _header([_cells(line, separator) for line in header_lines], width)
    if not any(header):
        lines_above = all_lines[: all_lines.index(rows[0])]
        comments = [_COMMENT.sub("", line) for line in lines_above if _COMMENT.match(line)]
        comment_rows = [_cells(comment, separator) for comment in comments]
        titles, title_units = _header([row for row in comment_rows if not _is_numeric(row)], width)
        if len({*titles}) == width:  # else a sentence
            header, units_below = titles, title_units
    names = [name or f"column_{k + 1}" for k, name in enumerate(header)]
    if repeated_names := [name for name in names if names.count(name) > 1]:
        text = f"{repeated_names[0]!r} names {len(repeated_names)} columns"
        raise InputError(f"{path}: header: {text}")
    decimal = "," if separator != "," and re.search(r"\d,\d", rows[0]) else "."
    body = "\n".join(rows if separator else ["\t".join(row.split()) for row in rows]).encode()
    table = pyarrow.csv.read_csv(
        io.BytesIO(body),
        pyarrow.csv.ReadOptions(use_threads=False, column_names=names, block_size=len(body) + 1),
        pyarrow.csv.ParseOptions(delimiter=separator or "\t"),
        pyarrow.csv.ConvertOptions(null_values=_NULLS, decimal_point=decimal),
    )
    remarks = [line.removeprefix(REMARK) for line in all_lines if line.startswith(REMARK)]
    metadata = parsed_json(remarks[-1], f"{path}: {REMARK.strip()}") if remarks else {}
    if not isinstance(metadata, dict):
        raise InputError(f"{path}: {REMARK.strip()}: {metadata!r} is refused; allowed: a table")
    columns = _table_columns(table, dict(zip(names, units_below, strict=True)))
    return _source(path, columns, metadata=metadata, ended=text.endswith(("\n", "\r")))


def _cells(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return [cell.strip('"') for cell in line.split()]
    reader = csv.reader([line], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in next(reader)]


def _find_rows(path: Path, lines: list[str]) -> tuple[str | None, int]:
    """The separator, None for blanks, and the first of two rows of numbers, or the only one."""
    for separator in ("\t", ";", ",", None):
        rows = [_cells(line, separator) for line in lines]
        width = mode([len(row) for row in rows if len(row) > 1] or [0])
        candidates = [number for number, row in enumerate(rows) if len(row) == width > 1]
        numeric = [_is_numeric(rows[number]) for number in candidates]
        for number, pair in zip(candidates, pairwise([*numeric, True]), strict=True):
            if all(pair):
                return separator, number
    raise InputError(f"{path}: no row of numbers within the first {_HEADER_LINES} lines")


def _is_numeric(row: list[str]) -> bool:
    """Whether more cells are numbers than text; an empty one is neither."""
    numbers = [cell for cell in row if _CELL.fullmatch(cell)]
    return len(numbers) > sum(cell not in (*_NULLS, *numbers) for cell in row)


def _header(lines: list[list[str]], width: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns by the last of these lines that are as wide as a row, or "".

    Of two, the lower has units if `core.units` knows one of them or if one stands there twice, and
    if the upper has text, and no number, wherever the lower has a unit.
    """
    wide_lines = [cells for cells in lines if len(cells) == width]
    lower = wide_lines[-1] if wide_lines else []
    upper = wide_lines[-2] if len(wide_lines) > 1 else []
    marks = [cell.strip("[]() ") for cell in lower]
    texts = [mark for mark in marks if mark]
    are_units = any(map(units.is_known, marks)) or len({*texts}) < len(texts)
    if (
        upper
        and are_units
        and all(name or not mark for name, mark in zip(upper, marks, strict=True))
    ):
        if not any(map(_CELL.fullmatch, upper)):
            return upper, marks
    return lower or [""] * width, [""] * width


def _table_columns(table: pa.Table, unit_of: Mapping[str, str] = {}) -> Iterator[_Column]:
    for field, column in zip(table.schema, table.columns, strict=True):
        unit = (field.metadata or {}).get(b"unit", b"").decode()
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        if pa.types.is_date(column.type):
            column = column.cast(pa.timestamp("ms"))
        if pa.types.is_time(column.type) or pa.types.is_large_string(column.type):
            column = column.cast(pa.string())
        if pa.types.is_string(column.type):  # times of day, or numbers with something between them
            text = pa.compute.utf8_trim_whitespace(column)
            if pa.compute.all(pa.compute.match_substring_regex(text, _CLOCK)).as_py():
                instants = pa.compute.binary_join_element_wise("1970-01-01", text, " ")
                column = instants.cast(pa.timestamp("ns"))
            else:
                is_number = pa.compute.match_substring_regex(text, f"^{_NUMBER}$")
                text = pa.compute.replace_substring(pa.compute.utf8_ltrim(text, "+"), ",", ".")
                column = pa.compute.if_else(is_number, text, None).cast(pa.float64())
                if column.null_count == len(column):
                    continue
        if pa.types.is_timestamp(column.type):
            ticks = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64())
            ticks = pa.compute.subtract(ticks, pa.compute.min(ticks))
            column, unit = pa.compute.multiply(ticks.cast(pa.float64()), 1e-9), "s"
        numeric = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_null)
        if not any(is_kind(column.type) for is_kind in numeric):
            continue
        numbers = pa.compute.fill_null(column.cast(pa.float64()), np.nan)
        yield _Column(field.name, unit_of.get(field.name) or unit, np.array(numbers.to_numpy()))


def _hdf5(path: Path, joint: str = "/") -> Source:
    with require("h5py", "hdf5").File(path, "r") as file:
        return _source(path, _tree_columns("", file, joint))


def _mat(path: Path) -> Source:
    from scipy.io import loadmat

    try:
        return _source(path, _tree_columns("", loadmat(path, simplify_cells=True), "."))
    except NotImplementedError:  # version 7.3 is HDF5
        return _hdf5(path, ".")


def _tree_columns(name: str, item: Any, joint: str, unit: str = "") -> Iterator[_Column]:
    """Columns of arrays, whose longer axis is time, in groups, structures and tables."""
    if isinstance(item, Mapping):
        for key in item:
            if key[:1] not in ("#", "_"):
                yield from _tree_columns(f"{name}{joint}{key}" if name else key, item[key], joint)
        return
    attributes = getattr(item, "attrs", {})
    own_unit = attributes.get("unit", attributes.get("units", unit))
    unit = own_unit.decode() if isinstance(own_unit, bytes) else str(own_unit)
    array = np.asarray(item)
    for field in array.dtype.names or ():
        yield from _tree_columns(f"{name}.{field}", array[field], joint, unit)
    if array.dtype.kind in "biuf" and array.size > 1:
        array = np.squeeze(array).astype(float)
        if array.ndim == 1:
            yield _Column(name, unit, array)
        elif array.ndim == 2:
            columns = array if array.shape[0] < array.shape[1] else array.T
            for number, values in enumerate(columns, start=1):
                yield _Column(f"{name}_{number}", unit, values.copy())


_READERS = {
    **dict.fromkeys((".csv", ".txt"), _csv),
    ".parquet": lambda path: _source(path, _table_columns(read_table(path))),
    **dict.fromkeys((".h5", ".hdf5"), _hdf5),
    ".mat": _mat,
}


def _intervals(time: Array) -> Array:
    """Intervals of time stamps [s], refused with the row where they do not rise."""
    if time.size < 2:
        raise InputError(f"time: has {time.size} samples; allowed: at least 2")
    steps = np.diff(time)
    is_wrong = ~(steps > 0.0)
    if is_wrong.any():
        row = int(is_wrong.argmax()) + 1
        text = f"row {row + 1} is at {time[row]:.9g} s after {time[row - 1]:.9g} s"
        raise InputError(f"time: {text}; allowed: times that rise")
    return steps


def even_clock(time: Array) -> tuple[Array, float]:
    """Even times of stamps [s], (N,), and their rate [Hz].

    The rate with the fewest digits whose largest error is at most 1.2 times that of the best
    straight line. Stamps that are not even are refused with the row.
    """
    steps, numbers = _intervals(time), np.arange(time.size)
    median_step = float(np.median(steps))
    slope, start = np.polyfit(numbers, time - time[0], 1) if time.size > 2 else (median_step, 0.0)
    line_error = float(np.abs(time - time[0] - start - slope * numbers).max())
    for digits in range(1, 17):
        rate = float(f"{1.0 / slope:.{digits}g}")
        errors = time - time[0] - numbers / rate
        shift = 0.5 * (errors.max() + errors.min())
        largest_error = float(np.abs(errors - shift).max())
        if largest_error <= max(1.2 * line_error, 1e-9 * time.size / rate):
            break
    row = int(np.abs(steps - median_step).argmax()) + 1
    step = steps[row - 1]
    is_uneven = abs(step - 1.0 / rate) > _MAX_INTERVAL_ERROR / rate
    if largest_error > _MAX_STAMP_ERROR / rate or is_uneven:
        text = f"row {row + 1}, {time[row]:.9g} s, is {step:.6g} s after the row before"
        allowed = "even times, or `resample` [Hz]"
        raise InputError(f"time: {text}, others are {median_step:.6g} s apart; allowed: {allowed}")
    # A first stamp in the middle of its rounding is as good as any other.
    return time[0] + (shift if largest_error > 1e-9 else 0.0) + numbers / rate, rate


def resample(time: Array, histories: Array, rate: float, bridge: float) -> tuple[Array, Array]:
    """Even times [s] and histories (n, N) at them, on straight lines, without a filter.

    NaN inside an interval longer than `bridge` [s] and than three median intervals.
    """
    steps = _intervals(time)
    count = int(np.floor((time[-1] - time[0]) * rate * (1.0 + 1e-12))) + 1
    even_time = time[0] + np.arange(count) / rate
    next_stamp = np.clip(np.searchsorted(time, even_time, side="left"), 1, time.size - 1)
    is_gap = steps[next_stamp - 1] > max(bridge, _GAP_INTERVALS * float(np.median(steps)))
    is_gap &= (even_time > time[next_stamp - 1]) & (even_time < time[next_stamp])
    lines = [np.interp(even_time, time, history) for history in histories]
    return even_time, np.where(is_gap, np.nan, np.array(lines))


def true_runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def bridge_gaps(values: Array, longest: float = np.inf) -> tuple[Array, int]:
    """A history with gaps up to the longest filled by straight lines, and samples so filled.

    A gap at either end is filled with the nearest number, only if `longest` is infinite.
    """
    missing, rows = np.isnan(values), np.arange(values.size)
    if not missing.any() or missing.all():
        return values, 0
    fill = np.zeros(values.size, dtype=bool)
    for first, end in true_runs(missing):
        is_inside = first > 0 and end < values.size
        fill[first:end] = end - first <= longest and (is_inside or longest == np.inf)
    lines = np.interp(rows, rows[~missing], values[~missing])
    return np.where(fill, lines, values), int(fill.sum())
