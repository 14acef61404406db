"""Files that appear only when they are complete, folders of one run, tables in CSV and Parquet.

A Parquet file of this project has the library's checksum of every page, and in its schema the
SHA-256 of names, types, values and header of the whole table. A reader refuses a file that differs
from it. Tables that others write have none, and CSV has no place for one.
"""

import csv
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError, reason
from cmf_mj.core.settings import DEVICE, Model, check_file, parsed_json, validated

try:
    import fcntl
except ImportError:  # Windows has no locks of folders
    fcntl = None  # type: ignore[assignment]

_DIGEST = b"cmf_mj_sha256"


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


def plain_path(folder: Path, name: str) -> Path:
    """The path of a plain file name in a folder; refused where the name leads anywhere else."""
    named = Path(name).name == name and not name.startswith(".") and name.isprintable()
    if not name or not named or DEVICE.match(name):
        raise InputError(f"file: {name!r} is refused: must be a plain name, without a folder")
    return folder / name


def check_target(target: Path, field: str = "file", shown: Path | None = None) -> Path:
    """A file that can be written, found out without writing it; its folder may be missing yet.

    A refusal names the `field`, and the path `shown`, such as the folder, or else the target.
    """
    try:
        there = next(path for path in target.absolute().parents if os.path.exists(path))
        fault = "is a folder; allowed: a file" if target.is_dir() else ""
        if not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
            fault = f"{there} is not a folder that can be written to"
    except (OSError, ValueError) as error:
        fault = reason(error)
    if fault:
        raise InputError(f"{field}: {str(shown or target)!r} is refused: {fault}")
    return target


@contextmanager
def exclusive_folder(folder: Path) -> Iterator[Path]:
    """A folder that this run alone writes to; made, and removed again if it stays empty.

    The lock is the system's and on the folder itself, so that it ends with the process however
    that ends. What a process that has ended left half-written is removed. A file system without
    locks gives none.
    """
    check_target(folder / "any", "out", folder)
    made: list[Path] = []
    held = -1
    try:
        try:
            for path in (*reversed(folder.parents), folder):
                if not os.path.exists(path):
                    with suppress(FileExistsError):  # another run was faster
                        path.mkdir()
                        made.append(path)
            if fcntl:
                held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            made.clear()
            fault = "another run writes to it; allowed: another folder, or to wait"
            raise InputError(f"out: {str(folder)!r} is refused: {fault}") from None
        except OSError as error:
            if held < 0:
                raise InputError(f"out: {str(folder)!r} is refused: {error.strerror}") from None
        try:
            _sweep(folder)
            yield folder
        finally:
            _sweep(folder)
    finally:
        with suppress(OSError):  # not empty
            for path in reversed(made):
                path.rmdir()
        if held >= 0:
            os.close(held)


def _sweep(folder: Path) -> None:
    """Remove what this process and those that have ended began here and one folder below."""
    for partial in (*folder.glob(".*.part"), *folder.glob("*/.*.part")):
        _, number, _ = partial.name.rsplit(".", 2)
        if number.isdecimal() and not _is_another(int(number)):
            partial.unlink(missing_ok=True)


def _is_another(process: int) -> bool:
    """Whether another process may have this number; on Windows, where to ask ends it, all may."""
    try:
        if fcntl:
            os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # of another user, or no number of a process
        return True
    return process != os.getpid()


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
    table: pa.Table, target: Path, header: tuple[str, Mapping[str, Any]] | None = None, **how: Any
) -> Path:
    """Write a table as Parquet with checksums, whatever the name's end.

    `header` is a key of the schema and what stands there as JSON; `how` are more options of
    pyarrow.
    """
    if header is not None:
        table = table.replace_schema_metadata({header[0]: json.dumps(header[1])})
    known = table.schema.metadata or {}
    table = table.replace_schema_metadata({**known, _DIGEST: _digest(table)})
    options = {"compression": "zstd", "use_dictionary": False, "write_page_checksum": True} | how
    with whole_file(target) as partial:
        pyarrow.parquet.write_table(table, partial, **options)
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
        parts = (name.strip(' "').partition("[") for name in table.column_names)
        return table.rename_columns(["".join((name.lower(), *unit)) for name, *unit in parts])
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error


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
        written = (table.schema.metadata or {}).get(_DIGEST)
        changed = written is not None and written != _digest(table)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(f"{path}: is not a readable Parquet file: {reason(error)}") from error
    if changed:
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
        there = table.column_names
        fault = "there twice" if name in there else "missing"
        said = f"column is {fault}; columns of the file: {', '.join(there)[:1000]}"
        raise InputError(f"{path}: {name}: {said}")
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
