"""Maps from the columns of a recording to channels in SI: whose names, units, signs, offsets.

    machine = "mine.toml"               # whose recording it is: a name, or a file beside this one
    bridge = 0.02                       # gaps up to this long [s] are filled with straight lines
    legs = [1, 2, 3, 4, 5, 6]           # what stands for {leg} in names, of our leg 1 first

    [time]
    column = "t"                        # or `rate` [Hz] alone, where no column has the time
    unit = "ms"
    resample = 500                      # [Hz], where times are not even; straight lines, no filter

    [channels.leg_position]             # one table a channel of `CHANNELS`
    columns = "x{leg} [mm]"             # or a list of six names, "" for one that was not recorded
    unit = "mm"                         # or six
    scale = 1                           # units a count, where a file has counts
    sign = 1                            # or six; the channel is sign (scale value - offset)
    offset = 0                          # or six, in the unit

Legs are positive out, poses count from neutral, x forward, y right, z down; see `CHANNELS`.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name, unknown_name, within
from cmf_mj.core.settings import Settings, Time, as_tuples, beside, read_toml, validated
from cmf_mj.machine.machine import Machine
from cmf_mj.record.facility_csv import LAYOUT
from cmf_mj.record.reader import read_recording
from cmf_mj.record.record import Record
from cmf_mj.record.sources import Source, bridged, even_clock, read_source, resampled

Array = NDArray[np.float64]

FACILITY = "facility"
"""Name of the columns of the facility's CSV files and of this project's records."""

POSES = ("demand_pose", "platform_pose")  #: Channels of six axes, m and rad.

CHANNELS = {
    **{group.channel: group.si for group in LAYOUT},
    **{"leg_force": "N", **dict.fromkeys(POSES, "m, rad")},
    **{"supply_pressure": "Pa", "return_pressure": "Pa"},
}
"""Channels that a map may have, with their SI units; all but the last two have six columns."""

_SCALARS = ("supply_pressure", "return_pressure")
_Six = Field(min_length=6, max_length=6)
_Names = Annotated[tuple[str, ...], BeforeValidator(as_tuples), _Six]
_Numbers = Annotated[tuple[float, ...], BeforeValidator(as_tuples), _Six]
_Sign = Literal[-1, 1]
_Signs = Annotated[tuple[_Sign, ...], BeforeValidator(as_tuples), _Six]
_Rate = Annotated[float, Field(gt=0.0, le=1e6)]


class TimeColumn(Settings):
    """Where the time of a recording is."""

    column: str | None = None  #: Name of the column; without one the samples are at `rate`.
    unit: str = "s"  #: s, ms or us.
    rate: _Rate | None = None  #: Samples a second [Hz], without a column.
    resample: _Rate | None = None  #: Samples a second [Hz] of the record, straight lines between.

    @model_validator(mode="after")
    def _one(self) -> "TimeColumn":
        if (self.column is None) == (self.rate is None):
            raise InputError("needs either column or rate")
        _check_unit(self.unit, "s")
        return self


class ChannelColumns(Settings):
    """Columns of one channel."""

    columns: str | _Names  #: A pattern with {leg}, six names, or the name of a single column.
    unit: str | _Names  #: Of the columns; one, or six.
    scale: float = 1.0  #: Units that one of the file's counts is.
    sign: _Sign | _Signs = 1  #: Of what the file calls positive.
    offset: float | _Numbers = 0.0  #: What the file shows where the channel is zero [unit].


class ColumnMap(Settings):
    """What the columns of a recording are, as heads this module.

    >>> position = {"columns": "x{leg}", "unit": "mm"}
    >>> made = ColumnMap(time={"rate": 500.0}, channels={"leg_position": position})
    >>> made.columns("leg_position")[0][0]
    'x1'
    """

    machine: str | None = None  #: Whose recording it is, by name or TOML file.
    bridge: Time = 0.0  #: Gaps up to this long are filled with straight lines [s].
    legs: Annotated[tuple[int | str, ...], BeforeValidator(as_tuples), _Six] = (1, 2, 3, 4, 5, 6)
    """What stands for {leg} in names, of leg 1 first; of poses, of surge first."""
    time: TimeColumn
    channels: dict[str, ChannelColumns] = Field(min_length=1)  #: By names of `CHANNELS`.

    @model_validator(mode="after")
    def _known(self) -> "ColumnMap":
        for name, one in self.channels.items():
            check_name("channels", name, CHANNELS)
            with within(f"channels.{name}"):
                single = isinstance(one.columns, str) and "{leg}" not in one.columns
                if single != (name in _SCALARS):
                    allowed = (
                        "one name" if name in _SCALARS else "a pattern with {leg}, or six names"
                    )
                    raise InputError(f"columns: {one.columns!r} is refused; allowed: {allowed}")
                for (_, unit, *_), si in zip(self.columns(name), _si(name), strict=False):
                    _check_unit(unit, si)
        return self

    def columns(self, channel: str) -> list[tuple[str, str, int, float]]:
        """Name, empty for one not recorded, unit, sign and offset of each column of a channel."""
        one = self.channels[channel]
        names = one.columns
        if isinstance(names, str):
            legs = self.legs[:1] if channel in _SCALARS else self.legs
            names = tuple(names.replace("{leg}", str(leg)) for leg in legs)
        parts = [names, *(_six(part) for part in (one.unit, one.sign, one.offset))]
        return list(zip(*parts, strict=False))


def _si(channel: str) -> list[str]:
    return ["m"] * 3 + ["rad"] * 3 if channel in POSES else [CHANNELS[channel]] * 6


def _check_unit(unit: str, si: str) -> None:
    if units.si_unit(unit) != si:
        raise InputError(f"unit: {unit!r} is {units.si_unit(unit)}; allowed: a unit of {si}")


def _six(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,) * 6


def load_columns(source: "str | Path | ColumnMap") -> ColumnMap:
    """A map from its TOML file, whose machine counts from there, or as it is."""
    if isinstance(source, ColumnMap):
        return source
    table = read_toml(Path(source))
    if isinstance(table.get("machine"), str):
        table["machine"] = str(beside(Path(source).parent, table["machine"]))
    return validated(ColumnMap, table, str(source))


def read_mapped(
    path: str | Path, columns: "str | Path | ColumnMap | None", machine: Machine
) -> Record:
    """A recording as a record in SI at an even rate.

    Where a column has no number the channel is NaN, unless the map bridges it. Uneven times are
    refused with the place, unless the map resamples.

    Args:
        path: a CSV, Parquet, HDF5 or MAT file.
        columns: a map or its file; None or `facility` for the facility's CSV and own records.
        machine: whose it is.

    Metadata have the machine, and `recording`: the file, the columns not recorded as `missing`, the
    samples filled as `bridged` by column, `clock_off` [s], how far stamps are from an even clock.

    >>> from pathlib import Path
    >>> from cmf_mj.record.columns import ColumnMap, read_mapped
    >>> rows = ["t,x1,x2,x3,x4,x5,x6", "0,0,0,0,0,0,0", "2,5,5,5,5,5,5"]
    >>> file = Path("log.csv")
    >>> size = file.write_text(chr(10).join(rows))
    >>> position = {"columns": "x{leg}", "unit": "mm"}
    >>> made = ColumnMap(time={"column": "t", "unit": "ms"}, channels={"leg_position": position})
    >>> read_mapped(file, made, cmf_mj.load_machine("lab"))["leg_position"][1, 0].item()
    0.005
    >>> file.unlink()
    """
    if columns is None or columns == FACILITY:
        record = read_recording(Path(path))
        about = {} if "machine" in record.metadata else machine.known()
        return Record(record.time, record.channels, record.units, dict(record.metadata) | about)
    chosen, source = load_columns(columns), read_source(path)
    with within(source.path):
        return _mapped(source, chosen, machine)


def _mapped(source: Source, chosen: ColumnMap, machine: Machine) -> Record:
    when = chosen.time
    stamps: Array = np.arange(next(iter(source.columns.values())).size, dtype=float)
    rate, off = when.resample or when.rate, 0.0
    if when.column is not None:
        stamps = units.to_si(when.unit, source.column(when.column))
        if np.isnan(stamps).any():
            row = int(np.isnan(stamps).argmax()) + 1
            raise InputError(f"time: {when.column}: row {row} has none; allowed: a time")
    elif when.rate is not None:
        stamps = stamps / when.rate
    time = stamps
    if rate is None:
        time, rate, off = even_clock(stamps)
    channels: dict[str, Array] = {}
    missing: list[str] = []
    counts: dict[str, int] = {}
    for channel in chosen.channels:
        legs, absent = _legs(source, chosen, channel)
        missing += absent
        if when.resample is not None:
            time, legs = resampled(stamps, legs, rate, chosen.bridge)
        for k, leg in enumerate(legs):
            legs[k], count = bridged(leg, round(chosen.bridge * rate))
            counts |= {f"{channel}/{k}": count} if count else {}
        channels[channel] = legs[0] if channel in _SCALARS else legs.T
    said = {"file": source.path.name, "columns": "by map", "missing": missing}
    metadata = {"command": {"kind": "recording"}, "sample_rate": rate} | machine.known()
    metadata |= {"recording": said | {"bridged": counts, "clock_off": off}}
    return Record(time, channels, {name: CHANNELS[name] for name in channels}, metadata)


def _legs(source: Source, chosen: ColumnMap, channel: str) -> tuple[Array, list[str]]:
    """Histories of a channel in SI, (6, N), NaN for legs not recorded, and the names of these."""
    one, columns, made, missing = chosen.channels[channel], chosen.columns(channel), [], []
    lost = np.full(next(iter(source.columns.values())).size, np.nan)
    pattern = isinstance(one.columns, str)
    if pattern and not any(name in source.columns for name, *_ in columns):
        raise unknown_name(f"channels.{channel}: column", columns[0][0], source.columns)
    for k, (name, unit, sign, offset) in enumerate(columns):
        absent = not name or (pattern and name not in source.columns)
        missing += [name or f"{channel} of leg {k + 1}"] if absent else []
        raw = lost if absent else source.column(name)
        made.append(units.to_si(unit, sign * (one.scale * raw - offset)))
    return np.array(made), missing
