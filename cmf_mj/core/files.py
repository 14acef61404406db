"""Files that appear only when they are complete, and tables in CSV and Parquet."""

import csv
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError


@contextmanager
def whole_file(target: Path) -> Iterator[Path]:
    """A place to write at, moved to `target` if nothing went wrong and removed if it did."""
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield partial
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def in_folder(folder: Path, name: str) -> Path:
    """A file or folder of this name in a folder; refused where the name leads anywhere else."""
    if not name or Path(name).name != name or name[0] == "." or not name.isprintable():
        raise InputError(f"file: {name!r} is refused: must be a plain name, without a folder")
    return folder / name


def write_text(target: Path, text: str) -> Path:
    """Write text in UTF-8."""
    with whole_file(target) as partial:
        partial.write_text(text, encoding="utf-8")
    return target


def write_json(target: Path, content: Mapping[str, Any]) -> Path:
    """Write a mapping as indented JSON; NaN is refused."""
    return write_text(target, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_csv(
    target: Path, header: Iterable[str], rows: Iterable[Iterable[object]], digits: int = 9
) -> Path:
    """Write rows as CSV below a header, floats to so many significant digits."""
    with whole_file(target) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for row in rows:
            writer.writerow(
                f"{cell:.{digits}g}" if isinstance(cell, float) else cell for cell in row
            )
    return target


def write_table(table: pa.Table, target: Path) -> Path:
    """Write a table as CSV or Parquet, by the name's end; numbers read back bit for bit."""
    if target.suffix == ".parquet":
        return write_parquet(table, target)
    if target.suffix != ".csv":
        raise InputError(f"{target}: must end in .csv or .parquet")
    with whole_file(target) as partial:
        pyarrow.csv.write_csv(table, partial)
    return target


def write_parquet(table: pa.Table, target: Path) -> Path:
    """Write a table as Parquet, whatever the name's end."""
    with whole_file(target) as partial:
        pyarrow.parquet.write_table(table, partial, compression="zstd", use_dictionary=False)
    return target


def read_table(path: Path) -> pa.Table:
    """Read a CSV or Parquet file, by the name's end."""
    try:
        if path.suffix == ".csv":
            return pyarrow.csv.read_csv(path)
        if path.suffix == ".parquet":
            return pyarrow.parquet.read_table(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    raise InputError(f"{path}: must end in .csv or .parquet")


def read_column(
    path: Path, table: pa.Table, name: str, kind: pa.DataType | None = None
) -> NDArray[Any]:
    """A column of numbers of a table read from `path`; float64 unless `kind` says otherwise."""
    if table.column_names.count(name) != 1:
        fault = "twice" if name in table.column_names else "missing"
        raise InputError(f"{path}: {name}: column is {fault}; it has {table.column_names}")
    column = table[name]
    if column.null_count:
        row = column.is_null().to_pylist().index(True)
        raise InputError(f"{path}: {name}: row {row + 1} is empty or not a number")
    try:
        return np.array(column.cast(kind or pa.float64()).to_numpy())
    except pa.ArrowInvalid as error:
        raise InputError(f"{path}: {name}: is not a column of numbers: {error}") from error
