"""Columns of recordings that others made: CSV, Parquet, HDF5 and MAT files.

A column is a name and numbers, NaN where there is none. An array of rows by columns, as HDF5 and
MAT files hold, gives `name_1`, `name_2` and so on; a table in a table gives `table.name`, a group
of HDF5 `group/name`. A CSV file may have text above its header, units in a row below it, any of the
separators comma, semicolon, tab and blanks, a decimal comma, and comments that begin with `#`.
"""

import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError, reason, require, unknown_name
from cmf_mj.core.files import read_table
from cmf_mj.core.settings import check_file

Array = NDArray[np.float64]

_NULLS = ["", "nan", "NaN", "NAN", "NA", "N/A", "null", "-", "#N/A", "-nan", "-nan(ind)", "1.#QNAN"]
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?inf", re.ASCII)
_UNIT = re.compile(r"[\[(].*[\])]|[a-zA-Z°%]{1,4}(/s(\^?2|²)?)?|1|-|")
_LOOKED_AT = 200  #: Lines in which the header of a CSV file is looked for.


class Source(NamedTuple):
    """What a file holds."""

    path: Path
    columns: Mapping[str, Array]  #: Name to numbers, (N,).
    units: Mapping[str, str]  #: Name to unit, where the file states one beside the name.

    def column(self, name: str) -> Array:
        """A column by name; refused with the most similar one."""
        if name not in self.columns:
            raise unknown_name(f"{self.path}: column", name, self.columns)
        return self.columns[name]


def read_source(path: str | Path) -> Source:
    """All columns of numbers of a file, by its ending: .csv, .txt, .parquet, .h5, .hdf5 or .mat."""
    source = check_file(Path(path))
    reader = _READERS.get(source.suffix.lower())
    if reader is None:
        raise InputError(f"{source}: ending {source.suffix!r} is not one of {', '.join(_READERS)}")
    try:
        columns, units = reader(source)
    except (OSError, ValueError, TypeError, KeyError, pa.ArrowException) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{source}: cannot be read: {reason(error)}") from error
    lengths = [values.size for values in columns.values()]
    if not lengths:
        raise InputError(f"{source}: has no column of numbers")
    usual = max(set(lengths), key=lambda size: (lengths.count(size), size))
    kept = {name: values for name, values in columns.items() if values.size == usual}
    return Source(source, kept, units)


_Columns = tuple[dict[str, Array], dict[str, str]]


def _csv(path: Path) -> _Columns:
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = [(k + 1, line) for k, line in enumerate(text.splitlines()) if line.strip()]
    lines = [(row, line) for row, line in lines if not line.lstrip().startswith("#")]
    separator, first = _cut(path, [line for _, line in lines[:_LOOKED_AT]])
    width = len(_cells(lines[first][1], separator))
    above = [_cells(line, separator) for _, line in lines[max(first - 2, 0) : first]]
    above = [cells for cells in above if len(cells) == width]
    units: dict[str, str] = {}
    names = above[-1] if above else [f"column_{k + 1}" for k in range(width)]
    if len(above) == 2 and all(_UNIT.fullmatch(cell) for cell in names):
        names, given = above
        units = dict(zip(names, (cell.strip("[]() ") for cell in given), strict=True))
    names = _distinct(path, names)
    decimal = "," if separator != "," and re.search(r"\d,\d", lines[first][1]) else "."
    rows = [_cells(line, separator) for _, line in lines[first:]] if separator is None else None
    body = (
        "\n".join("\t".join(row) for row in rows)
        if rows
        else "\n".join(line for _, line in lines[first:])
    )
    kinds = dict.fromkeys(names, pa.string())
    table = pyarrow.csv.read_csv(
        io.BytesIO(body.encode()),
        pyarrow.csv.ReadOptions(column_names=names),
        pyarrow.csv.ParseOptions(delimiter=separator or "\t"),
        pyarrow.csv.ConvertOptions(
            column_types=kinds, null_values=_NULLS, strings_can_be_null=True, decimal_point=decimal
        ),
    )
    columns = {}
    for name in names:
        values = _numbers(table[name], decimal)
        if values is not None:
            columns[name] = values
    return columns, units


def _numbers(column: pa.ChunkedArray, decimal: str) -> Array | None:
    """A column of text as numbers; None where most are none, NaN where some are none."""
    text = pa.compute.utf8_trim_whitespace(column)
    if decimal == ",":
        text = pa.compute.replace_substring(text, ",", ".")
    known = pa.compute.match_substring_regex(text, r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
    numbers = pa.compute.if_else(known, text, None).cast(pa.float64())
    if (
        numbers.null_count > 0.5 * len(numbers)
        and pa.compute.any(
            pa.compute.and_(pa.compute.invert(known), pa.compute.is_valid(text))
        ).as_py()
    ):
        return None
    return np.array(pa.compute.fill_null(numbers, np.nan).to_numpy())


def _cells(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in line.strip("\r\n").split(separator)]


def _cut(path: Path, lines: list[str]) -> tuple[str | None, int]:
    """The separator, None for blanks, and the first line of numbers."""
    for separator in ("\t", ";", ",", None):
        rows = [_cells(line, separator) for line in lines]
        width = len(rows[-1]) if rows else 0
        numeric = [
            len(row) == width
            and all(_NUMBER.fullmatch(c) or c in _NULLS for c in row)
            or sum(bool(_NUMBER.fullmatch(c)) for c in row) > 0.5 * width
            for row in rows
        ]
        if width > 1 and any(numeric):
            return separator, numeric.index(True)
    raise InputError(f"{path}: no row of numbers within the first {_LOOKED_AT} lines")


def _distinct(path: Path, names: list[str]) -> list[str]:
    filled = [name or f"column_{k + 1}" for k, name in enumerate(names)]
    for name in filled:
        if filled.count(name) > 1:
            raise InputError(f"{path}: header: {name!r} names {filled.count(name)} columns")
    return filled


def _parquet(path: Path) -> _Columns:
    table = read_table(path)
    columns, units = {}, {}
    for field in table.schema:
        if pa.types.is_integer(field.type) or pa.types.is_floating(field.type):
            values = pa.compute.fill_null(table[field.name].cast(pa.float64()), np.nan)
            columns[field.name] = np.array(values.to_numpy())
        elif pa.types.is_timestamp(field.type):
            stamps = table[field.name].cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy()
            columns[field.name], units[field.name] = 1e-9 * (stamps - stamps[0]), "s"
        stated = (field.metadata or {}).get(b"unit", b"").decode()
        units |= {field.name: stated} if stated else {}
    return columns, units


def _flat(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    """Columns of an array: its longer axis is time."""
    array = np.asarray(value)
    if array.dtype.kind not in "biuf" or array.size < 2:
        return
    array = np.squeeze(array).astype(float)
    if array.ndim == 1:
        yield name, array
    elif array.ndim == 2:
        rows = array if array.shape[0] >= array.shape[1] else array.T
        yield from ((f"{name}_{k + 1}", rows[:, k].copy()) for k in range(rows.shape[1]))


def _hdf5(path: Path) -> _Columns:
    h5py = require("h5py", "hdf5")
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        stated = item.attrs.get("unit", item.attrs.get("units", ""))
        parts = item.dtype.names or ("",)
        for part in parts:
            whole = f"{name}.{part}" if part else name
            for column, values in _flat(whole, item[part] if part else item[()]):
                columns[column] = values
                if isinstance(stated, str | bytes) and stated:
                    units[column] = stated.decode() if isinstance(stated, bytes) else stated

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return columns, units


def _mat(path: Path) -> _Columns:
    from scipy.io import loadmat

    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        return _hdf5(path)
    columns: dict[str, Array] = {}

    def walk(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, one in value.items():
                if not key.startswith("__"):
                    walk(f"{name}.{key}" if name else key, one)
        elif isinstance(value, np.ndarray):
            columns.update(_flat(name, value))

    walk("", content)
    return columns, {}


_READERS = {
    **dict.fromkeys((".csv", ".txt"), _csv),
    ".parquet": _parquet,
    **dict.fromkeys((".h5", ".hdf5"), _hdf5),
    ".mat": _mat,
}
