"""Recordings at 128 Hz in the facility's CSV layout.

The facility's file has one header row, then one row a sample. The report (Appendix A) reads the
block BO2..FW, columns 67 to 179, and publishes the meaning of twelve of its columns:

    block columns 1-6 (file 67-72):     DCL2DVS_FDK_LEG_POS, feedback leg positions [in]
    block columns 63-68 (file 129-134): DCL2DVS_DMD_LEG_POS, demanded leg positions [in]

Everything else is this project's choice: the leg number after a name, the names, units and places
of the other channels (`LAYOUT`), TIME [s] in column 1 and LAST_ROW, 1 in the last row only, in
column 2. A column with nothing to hold is named UNUSED_<column> and holds zeros, so that any reader
of numbers finds the block. Metadata are one comment line after the last row, `# cmf_mj {...}`:
before the header they would move the block away from row 2. That line also has a checksum a column,
and of itself; who edits values by hand deletes it.

The resolution of a file is 10^-decimals in each column's unit: 1e-6 in by default.
"""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.arrays import whole
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file
from cmf_mj.core.settings import FileHeader
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.record.record import Record

Column = NDArray[np.float64]

RATE = 128
"""Samples a second of the facility's recorder [Hz]."""
BLOCK = 67
"""First file column of the block the report reads, 1-based: BO."""
BLOCK_WIDTH = 113
"""Columns of the block: BO to FW."""
LEGS = 6


class Group(NamedTuple):
    """Six neighbouring columns, one a leg."""

    channel: str  #: Channel of the record.
    name: str  #: Header name without the leg number.
    first: int  #: Column of leg 1 in the block, 1-based.
    unit: str  #: Unit in the file.
    si: str  #: Unit in the record.

    @property
    def names(self) -> list[str]:
        """Header names, leg 1 to 6."""
        return [f"{self.name}_{leg + 1}" for leg in range(LEGS)]


LAYOUT = (
    Group("leg_position", "DCL2DVS_FDK_LEG_POS", 1, "in", "m"),
    Group("leg_velocity", "DCL2DVS_FDK_LEG_VEL", 7, "in/s", "m/s"),
    Group("leg_acceleration", "DCL2DVS_FDK_LEG_ACC", 13, "in/s^2", "m/s^2"),
    Group("cap_pressure", "DCL2DVS_FDK_CAP_PRS", 19, "psi", "Pa"),
    Group("rod_pressure", "DCL2DVS_FDK_ROD_PRS", 25, "psi", "Pa"),
    Group("leg_reference", "DCL2DVS_DMD_LEG_POS", 63, "in", "m"),
    Group("compensator_output", "DCL2DVS_CMP_CMD", 69, "%", "1"),
    Group("valve_command", "DCL2DVS_VLV_CMD", 75, "%", "1"),
)
"""Columns of the block. Only the two groups of positions are published; the rest is ours."""
REQUIRED = ("leg_position", "leg_reference")
"""Channels no recording is without; their places, names and unit are the published ones."""
TIME, LAST, LINE = "TIME", "LAST_ROW", "line"
"""Header names of the first two columns; key of the trailer's own checksum."""
TIME_DECIMALS = 7
NAMES = {name for group in LAYOUT for name in group.names}
"""All header names of legs."""
POSITIONS = {
    name: group.first - 1 + leg
    for group in LAYOUT
    if group.channel in REQUIRED
    for leg, name in enumerate(group.names)
}
"""Places of the published columns in the block, from 0."""
TRAILER = "# cmf_mj "
"""How the comment line after the last row begins."""


class Trailer(FileHeader):
    """What the comment line after the last row holds."""

    rows: int
    decimals: int
    checksums: dict[str, int]  #: Of the columns, and of this line without it as `line`.
    metadata: dict[str, Any]

    def line(self) -> int:
        """Checksum of everything else here."""
        columns = {name: value for name, value in self.checksums.items() if name != LINE}
        rest = [self.rows, self.decimals, columns, self.metadata]
        return zlib.crc32(json.dumps(rest, sort_keys=True).encode())


def stroke(metadata: Mapping[str, Any]) -> float:
    """Largest leg position either way [in] of the machine that metadata name."""
    return round(units.from_si("in", recorded_machine(metadata).half_stroke), 9)


def checksum(counts: Column) -> int:
    """Of a column in units of its last decimal."""
    return zlib.crc32(np.rint(counts).astype("<i8").tobytes())


def write_facility_csv(record: Record, path: str | Path, *, decimals: int = 6) -> Path:
    """Write a record as the facility's recorder would; the file appears only when complete.

    The record has six legs at a multiple of 128 Hz. Samples are picked, not filtered: every
    (rate / 128)-th, from the first. Channels without a column in `LAYOUT` are left out. Values have
    0 to 9 decimals; the time has 7 and is exact.
    """
    target = Path(path)
    whole("decimals", decimals, 0, 9)
    every = record.rate / RATE
    if not (every >= 1.0 and every.is_integer()):
        raise InputError(
            f"sample_rate: {record.rate} Hz is refused; allowed: a multiple of {RATE} Hz"
        )
    picked = slice(None, None, round(every))
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
            counts = np.rint(values * 10.0**decimals)
            index = BLOCK + group.first + leg - 2
            names[index], formats[index] = group.names[leg], f"%.{decimals}f"
            columns.append(counts / 10.0**decimals + 0.0)
            checksums[names[index]] = checksum(counts)
    metadata = dict(record.metadata) | {"sample_rate": float(RATE)}
    trailer = Trailer(rows=time.size, decimals=decimals, checksums=checksums, metadata=metadata)
    checksums[LINE] = trailer.line()
    footer = TRAILER + json.dumps(trailer.model_dump() | {"checksums": checksums})
    how = {"fmt": ",".join(formats), "header": ",".join(names), "footer": footer, "comments": ""}
    with whole_file(target) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        np.savetxt(file, np.column_stack(columns), **how)
    return target


def _legs(record: Record, group: Group, picked: slice) -> Column:
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
