"""Writes a record in the facility's CSV layout."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file
from cmf_mj.record.layout import (
    BLOCK,
    BLOCK_WIDTH,
    LAST,
    LAYOUT,
    LEGS,
    LINE,
    RATE,
    REQUIRED,
    TIME,
    TIME_DECIMALS,
    TRAILER,
    Group,
    Trailer,
    checksum,
    stroke,
)
from cmf_mj.record.record import Record


def write_facility_csv(record: Record, path: str | Path, *, decimals: int = 6) -> Path:
    """Write a record as the facility's recorder would; the file appears only when complete.

    The record has six legs at a multiple of 128 Hz. Samples are picked, not filtered: every
    (rate / 128)-th, from the first. Channels without a column in `LAYOUT` are left out. Values have
    0 to 9 decimals; the time has 7 and is exact.
    """
    target = Path(path)
    if decimals not in range(10):
        raise InputError(f"decimals: {decimals} is refused; allowed: 0 to 9")
    picked = slice(None, None, _every(record))
    time = record.time[picked]
    names = [f"UNUSED_{i + 1}" for i in range(BLOCK - 1 + BLOCK_WIDTH)]
    formats = ["0"] * len(names)
    names[:2], formats[:2] = [TIME, LAST], ["%.7f", "%d"]
    last = np.zeros(time.size)
    last[-1] = 1.0
    columns, checksums = [time, last], {TIME: checksum(time * 10.0**TIME_DECIMALS)}
    for group in LAYOUT:
        if group.channel not in record.channels and group.channel not in REQUIRED:
            continue
        for leg, values in enumerate(_legs(record, group, picked).T):
            whole = np.rint(values * 10.0**decimals)
            index = BLOCK + group.first + leg - 2
            names[index], formats[index] = group.names[leg], f"%.{decimals}f"
            columns.append(whole / 10.0**decimals + 0.0)
            checksums[names[index]] = checksum(whole)
    metadata = dict(record.metadata) | {"sample_rate": float(RATE)}
    trailer = Trailer(rows=time.size, decimals=decimals, checksums=checksums, metadata=metadata)
    checksums[LINE] = trailer.line()
    footer = json.dumps(trailer.model_dump() | {"checksums": checksums})
    with whole_file(target) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        np.savetxt(
            file,
            np.column_stack(columns),
            fmt=",".join(formats),
            header=",".join(names),
            footer=TRAILER + footer,
            comments="",
        )
    return target


def _every(record: Record) -> int:
    """How many samples of the record are one of the recorder."""
    rate = float(record.metadata.get("sample_rate", np.nan))
    every = rate / RATE
    if not (every >= 1.0 and every.is_integer()):
        raise InputError(f"sample_rate: {rate} Hz is refused; allowed: a multiple of {RATE} Hz")
    if record.time.size == 0:
        raise InputError("record: has no samples")
    off = np.abs(record.time - record.time[0] - np.arange(record.time.size) / rate)
    if not off.max() < 1e-6:
        sample = int(np.argmax(~(off < 1e-6)))
        raise InputError(f"time: sample {sample} at {record.time[sample]} s is not at {rate} Hz")
    return round(every)


def _legs(record: Record, group: Group, picked: slice) -> NDArray[np.float64]:
    """A channel in the file's unit, (N, 6), checked."""
    values = record[group.channel]
    if values.ndim != 2 or values.shape[1] != LEGS:
        raise InputError(f"{group.channel}: shape is {values.shape}; allowed: (N, {LEGS})")
    values = units.from_si(group.unit, values[picked])
    limit = stroke(record.metadata) if group.channel in REQUIRED else np.inf
    bad = ~(np.isfinite(values) & (np.abs(values) <= limit))
    if bad.any():
        sample, leg = np.argwhere(bad)[0]
        allowed = f"+-{limit:g} {group.unit}" if np.isfinite(limit) else "finite values"
        raise InputError(
            f"{group.channel}: {values[sample, leg]} {group.unit} at sample {sample}, "
            f"leg {leg + 1}, is refused; allowed: {allowed}"
        )
    return values
