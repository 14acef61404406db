"""Tables in CSV and Parquet, written with checksums and read with checks.

A Parquet file of this project has the library's checksum of every page, and in its schema the
SHA-256 of names, types, values and header of the whole table. A reader refuses a file that differs
from it. Tables that others write have none, and CSV has no place for one.
"""

import csv
import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError, reason
from cmf_mj.core.files import whole_file
from cmf_mj.core.settings import Model, check_file, parsed_json, validated

_DIGEST = b"cmf_mj_sha256"


def write_csv(
    target: Path, header: Iterable[str], rows: Iterable[Iterable[object]], digits: int = 9
) -> Path:
    """Write a CSV file to read, floats with so many digits; `write_table` keeps every digit."""
    with whole_file(target) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for row in rows:
            writer.writerow(
                f"{cell:.{digits}g}" if isinstance(cell, float) else cell for cell in row
            )
    return target


def write_table(table: pa.Table, target: Path) -> Path:
    """Write a table as CSV or Parquet, by the name's end, doubles with every digit.

    CSV does not keep types: 1.0 comes back as an integer, single precision as double.
    """
    if target.suffix == ".parquet":
        return write_parquet(table, target)
    if target.suffix != ".csv":
        raise InputError(f"{target}: must end in .csv or .parquet")
    with whole_file(target) as partial:
        pyarrow.csv.write_csv(table, partial)
    return target


def write_parquet(
    table: pa.Table,
    target: Path,
    header: tuple[str, Mapping[str, Any]] | None = None,
    **options: Any,
) -> Path:
    """Write a table as Parquet with checksums, whatever the name's end.

    `header` is a key of the schema and what stands there as JSON; `options` are more of pyarrow.
    """
    if header is not None:
        key, content = header
        table = table.replace_schema_metadata({key: json.dumps(content)})
    metadata = table.schema.metadata or {}
    table = table.replace_schema_metadata({**metadata, _DIGEST: _digest(table)})
    fixed = {"compression": "zstd", "use_dictionary": False, "write_page_checksum": True}
    with whole_file(target) as partial:
        pyarrow.parquet.write_table(table, partial, **(fixed | options))
    return target


def read_table(path: Path) -> pa.Table:
    """Read a CSV or Parquet file, by the name's end; Parquet of this project is as it was written.

    Names of CSV columns are lower-cased and stripped, but not a unit in brackets behind them.
    """
    if path.suffix == ".parquet":
        return _read_parquet(path)
    if path.suffix != ".csv":
        raise InputError(f"{path}: must end in .csv or .parquet")
    check_file(path)
    try:
        table = pyarrow.csv.read_csv(path)
        return table.rename_columns([_column_name(name) for name in table.column_names])
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error


def _column_name(title: str) -> str:
    """A column's name in lower case, with its unit as it is."""
    name, bracket, unit = title.strip(' "').partition("[")
    return f"{name.lower()}{bracket}{unit}"


def read_headed(path: Path, key: str, model: type[Model]) -> tuple[pa.Table, Model]:
    """A Parquet table with the header that `write_parquet` wrote at a key of its schema."""
    table = _read_parquet(path)
    raw = (table.schema.metadata or {}).get(key.encode())
    if raw is None:
        raise InputError(f"{path}: is Parquet, but carries no {key} header")
    where = f"{path}: header {key}"
    return table, validated(model, parsed_json(raw, where), where)


def _read_parquet(path: Path) -> pa.Table:
    check_file(path)
    try:
        table = pyarrow.parquet.read_table(path, page_checksum_verification=True)
        written_digest = (table.schema.metadata or {}).get(_DIGEST)
        is_changed = written_digest is not None and written_digest != _digest(table)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(f"{path}: is not a readable Parquet file: {reason(error)}") from error
    if is_changed:
        raise InputError(
            f"{path}: is damaged or changed: it does not hold what its {_DIGEST.decode()} says"
        )
    return table


def _digest(table: pa.Table) -> bytes:
    """SHA-256 of names, types and values of the columns, and of the header with its units.

    Metadata of single columns, which this project does not write, are not in it.
    """
    header = sorted((k, v) for k, v in (table.schema.metadata or {}).items() if k != _DIGEST)
    digest = hashlib.sha256(repr((header, table.num_rows)).encode())
    for name, column in zip(table.column_names, table.columns, strict=True):
        digest.update(repr((name, str(column.type), column.null_count)).encode())
        if column.null_count:
            digest.update(column.is_null().to_numpy().tobytes())
        if pa.types.is_primitive(column.type):
            digest.update(np.ascontiguousarray(column.drop_null().to_numpy()).data)
        else:
            digest.update(repr(column.to_pylist()).encode())
    return digest.hexdigest().encode()


def read_column(
    path: Path, table: pa.Table, name: str, kind: pa.DataType | str | None = "double"
) -> NDArray[Any]:
    """A column of numbers of a table read from `path`, cast to `kind`; None: no cast."""
    if table.column_names.count(name) != 1:
        names = table.column_names
        fault = "there twice" if name in names else "missing"
        columns = f"columns of the file: {', '.join(names)[:1000]}"
        raise InputError(f"{path}: {name}: column is {fault}; {columns}")
    column = table[name]
    if column.null_count:
        row = column.is_null().to_pylist().index(True)
        raise InputError(f"{path}: {name}: row {row + 1} is empty or not a number")
    try:
        if kind is not None and pa.types.is_temporal(column.type):
            raise pa.ArrowInvalid(f"it holds {column.type}")
        values = np.array((column if kind is None else column.cast(kind)).to_numpy())
    except pa.ArrowException as error:
        raise InputError(f"{path}: {name}: is not a column of numbers: {reason(error)}") from error
    if values.dtype.kind not in "biuf":
        raise InputError(f"{path}: {name}: is not a column of numbers: it holds {column.type}")
    return values
