"""Reads facility CSV files and says exactly what is wrong with a broken one."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.arrays import whole
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import check_file, parsed_json, validated
from cmf_mj.record.facility_csv import (
    BLOCK,
    BLOCK_WIDTH,
    LAST,
    LAYOUT,
    LEGS,
    LINE,
    NAMES,
    POSITIONS,
    RATE,
    REQUIRED,
    TIME,
    TIME_DECIMALS,
    TRAILER,
    Column,
    Trailer,
    checksum,
    stroke,
)
from cmf_mj.record.record import Record

_COMMENT = "#"
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_NOT_TEXT = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")


@dataclass
class _Table:
    """The text of a file, cut but not yet read."""

    path: Path
    header_row: int
    names: list[str]  #: Known header names in canonical form, others as in the file.
    rows: list[int]  #: Line numbers of the samples.
    lines: list[str]
    separator: str | None  #: None for blanks.
    by_name: bool
    """Whether the header names the columns; otherwise they are where the report has them."""
    trailer: Trailer | None

    def heading(self, index: int) -> str:
        """Number, spreadsheet letters and name of a column."""
        letters, rest = "", index + 1
        while rest:
            rest, digit = divmod(rest - 1, 26)
            letters = chr(ord("A") + digit) + letters
        return f"column {index + 1} ({letters}, {self.names[index] or 'no name'})"

    def cell(self, sample: int, column: int | str) -> str:
        """Where a cell is, as an editor and a spreadsheet show it, and its text."""
        index = self.names.index(column) if isinstance(column, str) else column
        text = self.lines[sample].split(self.separator)[index].strip()
        return f"{self.path}: row {self.rows[sample]}, {self.heading(index)}: {text[:40]!r}"

    def first(self, column: str, bad: NDArray[np.bool_]) -> str:
        """The first cell of a column whose sample is bad, as `cell` shows it; empty if none is."""
        return self.cell(int(np.argmax(bad)), column) if bad.any() else ""


def read_facility_csv(path: str | Path) -> Record:
    """Read a recording of the facility's form.

    Columns go by the names of `LAYOUT`, in any order and number; leg positions are the only
    ones required. A header without any of these names means the published places: the full file of
    at least 179 columns, or the block alone, 113. Separators are commas, semicolons or blanks;
    lines that begin with `#` are comments. Values that are read must be finite numbers; columns
    that are not read may hold anything.

    What a file does not carry cannot be checked: without TIME the rate is 128 Hz, and
    without the line `# cmf_mj` a column filled from another one is not noticed.

    The record is in SI at 128 Hz. In its metadata `command` is the writer's, or of the kind
    `recording`; `recording` names the file and says how its columns were identified.
    """
    table = _cut(Path(path))
    _check_header(table)
    columns = _values(table)
    _check_rows(table, columns)
    _check_values(table, columns)
    channels, channel_units = {}, {}
    for group in LAYOUT:
        if group.names[0] in columns:
            legs = np.column_stack([columns[name] for name in group.names])
            channels[group.channel] = units.to_si(group.unit, legs)
            channel_units[group.channel] = group.si
    metadata = dict(table.trailer.metadata) if table.trailer else {}
    metadata["sample_rate"] = float(RATE)
    metadata.setdefault("command", {"kind": "recording"})
    metadata["recording"] = {
        "file": table.path.name,
        "columns": "by name" if table.by_name else "by position",
        "decimals": table.trailer.decimals if table.trailer else _decimals(columns),
    }
    start = columns[TIME][0] if TIME in columns else 0.0
    return Record(start + np.arange(len(table.rows)) / RATE, channels, channel_units, metadata)


def _cut(path: Path) -> _Table:
    """Cut a file into header, samples and trailer; every sample has as many cells."""
    numbered = list(enumerate(re.split(r"\r\n|\n|\r", _text(path)), start=1))
    comments = [(row, line) for row, line in numbered if line.lstrip().startswith(_COMMENT)]
    content = [(row, line) for row, line in numbered if not line.lstrip().startswith(_COMMENT)]
    filled = [i for i, (_, line) in enumerate(content) if line.strip()]
    if not filled:
        raise InputError(f"{path}: has neither a header row nor samples")
    (header_row, header), *samples = content[filled[0] : filled[-1] + 1]
    where, separator = f"{path}: row {header_row}", _separator(header)
    names = [_canonical(cell) for cell in header.split(separator)]
    if all(_NUMBER.fullmatch(name) for name in names):
        raise InputError(
            f"{where}: {header[:40].strip()!r} is numbers; the first row must be a header"
        )
    if not samples:
        raise InputError(f"{where}: is a header; no samples follow")
    by_name = bool(set(names) & NAMES)
    if not by_name:  # a header of any text: the report skips the row
        separator = _separator(samples[0][1])
        width = len(samples[0][1].split(separator))
        names = [_canonical(cell) for cell in header.split(separator)]
        names = _published(where, names if len(names) == width else [""] * width)
    for row, line in samples:
        cells = line.split(separator) if line.strip() else []
        if len(cells) != len(names):
            raise InputError(
                f"{path}: row {row}: has {len(cells)} columns, the last being "
                f"{cells[-1].strip()[:40] if cells else ''!r}; allowed: {len(names)}, as in the "
                "header"
            )
    if row == numbered[-1][0]:
        raise InputError(
            f"{path}: row {row}, column {len(names)}: the file ends without a line end, so that "
            f"{cells[-1].strip()[:40]!r} may be cut off; if it is whole, add a line end"
        )
    rows, lines = [row for row, _ in samples], [line for _, line in samples]
    trailer = _read_trailer(path, comments)
    return _Table(path, header_row, names, rows, lines, separator, by_name, trailer)


def _text(path: Path) -> str:
    try:
        content = check_file(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not content.strip():
        raise InputError(f"{path}: is empty")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}: row {row}: byte 0x{content[error.start]:02x} is not UTF-8 text"
        ) from None
    if odd := _NOT_TEXT.search(text):
        row = text.count("\n", 0, odd.start()) + 1
        raise InputError(f"{path}: row {row}: character 0x{ord(odd[0]):02x} is not text")
    return text


def _separator(line: str) -> str | None:
    return next((mark for mark in (";", ",") if mark in line), None)


def _canonical(cell: str) -> str:
    """`dcl2dvs_fdk_leg_pos[3]`, also quoted, as DCL2DVS_FDK_LEG_POS_3."""
    name = cell.strip().strip("\"'").strip()
    known = re.sub(r"[\s_\[(]*([0-9]+)[\])]?$", r"_\1", name.upper())
    return known if known in NAMES or known in (TIME, LAST) else name


def _read_trailer(path: Path, comments: list[tuple[int, str]]) -> Trailer | None:
    trailers = [(row, line.strip()) for row, line in comments if line.strip().startswith(TRAILER)]
    if not trailers:
        return None
    row, line = trailers[-1]
    where = f"{path}: row {row}"
    if len(trailers) > 1:
        raise InputError(f"{where}: is a second line {TRAILER!r}; allowed: one")
    trailer = validated(Trailer, parsed_json(line.removeprefix(TRAILER), where), where)
    whole(f"{where}: decimals", trailer.decimals, 0, 9)
    return trailer


def _published(where: str, names: list[str]) -> list[str]:
    """Header names with those of the leg positions at their published places."""
    width, full = len(names), BLOCK - 1 + BLOCK_WIDTH
    if width != BLOCK_WIDTH and width < full:
        required = " and ".join(f"{g.name}_1 to _6" for g in LAYOUT if g.channel in REQUIRED)
        raise InputError(
            f"{where}: none of {width} columns is named as allowed: {required}; allowed without "
            f"names: {BLOCK_WIDTH} columns or at least {full}"
        )
    first = 0 if width == BLOCK_WIDTH else BLOCK - 1
    places = {first + index: name for name, index in POSITIONS.items()}
    return [places.get(index, name) for index, name in enumerate(names)]


def _check_header(table: _Table) -> None:
    """Names we know occur once, and all legs of a channel or none are there."""
    seen: dict[str, int] = {}
    where = f"{table.path}: row {table.header_row}"
    for index, name in enumerate(table.names):
        if _ours(name) and name in seen:
            raise InputError(
                f"{where}, {table.heading(index)}: column {seen[name] + 1} has that name already"
            )
        seen[name] = index
    for group in LAYOUT:
        missing = [name for name in group.names if name not in seen]
        if missing and (group.channel in REQUIRED or len(missing) < LEGS):
            raise InputError(f"{where}: the header lacks {', '.join(missing)}")


def _ours(name: str) -> bool:
    return name in NAMES or name in (TIME, LAST) or name.startswith("UNUSED_")


def _values(table: _Table) -> dict[str, Column]:
    """The columns with a known name; these, or else the whole block, are finite numbers."""
    read = {index for index, name in enumerate(table.names) if _ours(name)}
    if not table.by_name:
        first = table.names.index(next(iter(POSITIONS)))
        read |= set(range(first, first + BLOCK_WIDTH))
    indices = sorted(read)
    how: dict[str, Any] = {"delimiter": table.separator, "usecols": indices, "comments": None}
    try:
        values = np.loadtxt(table.lines, ndmin=2, **how)
    except ValueError:
        values = np.array([[np.nan]])
    if not np.isfinite(values).all():
        _refuse_number(table, indices)
    return {table.names[index]: values[:, k] for k, index in enumerate(indices)}


def _refuse_number(table: _Table, indices: list[int]) -> None:
    for sample, line in enumerate(table.lines):
        cells = line.split(table.separator)
        for index in indices:
            cell = cells[index].strip()
            if not _NUMBER.fullmatch(cell) or not np.isfinite(float(cell)):
                raise InputError(
                    f"{table.cell(sample, index)} is refused; allowed: a finite number with a "
                    "decimal point"
                )


def _check_rows(table: _Table, columns: dict[str, Column]) -> None:
    """Rows are at 128 Hz and none is missing, as far as the file shows."""
    rows = len(table.rows)
    if TIME in columns:
        time = columns[TIME]
        steps = np.diff(time, prepend=time[0] - 1.0 / RATE)
        off = np.abs(steps * RATE - 1.0) > 0.2  # a clock printed in ms is 0.13 off
        if cell := table.first(TIME, off):
            step = steps[np.argmax(off)]
            raise InputError(f"{cell} s is {step:.6g} s after the row before; allowed: 1/{RATE} s")
        span, due = time[-1] - time[0], (rows - 1) / RATE
        if abs(span - due) > 1e-3 * due + 1e-3:
            raise InputError(
                f"{table.cell(-1, TIME)} s makes the rate {(rows - 1) / span:.5g} Hz; "
                f"allowed: {RATE} Hz"
            )
    if LAST in columns:
        last = np.arange(rows) == rows - 1
        if cell := table.first(LAST, columns[LAST] != last):
            raise InputError(
                f"{cell} is refused; allowed: 1 in the last row and 0 before, so rows are missing "
                "or added"
            )
    if table.trailer and table.trailer.rows != rows:
        raise InputError(
            f"{table.path}: row {table.rows[-1]}: is sample {rows} and the last; "
            f"allowed: {table.trailer.rows} samples, as written"
        )


def _check_values(table: _Table, columns: dict[str, Column]) -> None:
    """Legs are within their stroke, and columns are as they were written."""
    trailer, line = table.trailer, TRAILER.strip()
    limit = stroke(trailer.metadata if trailer else {})
    for name in POSITIONS:
        if cell := table.first(name, np.abs(columns[name]) > limit):
            raise InputError(f"{cell} in is refused; allowed: a leg position within +-{limit:g} in")
    if trailer is None:
        return
    sums = dict(trailer.checksums)
    if sums.pop(LINE, None) != trailer.line():
        raise InputError(f"{table.path}: the line {line!r} is not as it was written")
    for name, written in sums.items():
        decimals = TIME_DECIMALS if name == TIME else trailer.decimals
        if name in columns and written != checksum(columns[name] * 10.0**decimals):
            raise InputError(
                f"{table.cell(0, name)} and below are not the values written: swapped or changed? "
                f"If that is meant, delete the line {line!r}"
            )


def _decimals(columns: dict[str, Column]) -> int:
    """Decimals that leg positions have; 15 where they have as many as a double holds."""
    values = np.stack([columns[name] for name in POSITIONS])
    return next((n for n in range(10) if np.array_equal(np.round(values, n), values)), 15)


def read_recording(path: Path) -> Record:
    """Read a recording by its ending: .csv (facility) or .parquet."""
    if path.suffix not in (".csv", ".parquet"):
        raise InputError(f"{path}: ending {path.suffix!r} is not one of .csv, .parquet")
    return read_facility_csv(path) if path.suffix == ".csv" else Record.load(path)
