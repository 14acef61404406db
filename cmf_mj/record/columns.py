"""Maps from the columns of a recording to channels in SI, with names, units, signs and offsets.

    machine = "mine.toml"               # whose recording it is: a name, or a file beside this one
    bridge = 0.02                       # gaps up to this long [s] are filled with straight lines
    whole = false                       # true refuses all gaps and files that may be cut off
    legs = [1, 2, 3, 4, 5, 6]           # replace {leg} in names, for our leg 1 first

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

Legs are positive out, poses count from neutral, x forward, y right, z down; see `CHANNELS`. The
facility's CSV files have the map `facility.toml`.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from cmf_mj.core import units
from cmf_mj.core.arrays import shaped
from cmf_mj.core.errors import InputError, check_name, unknown_name, within
from cmf_mj.core.files import whole_file
from cmf_mj.core.settings import Settings, Time, as_tuples, beside, read_toml, validated
from cmf_mj.machine.machine import Machine, load_machine, recorded_machine
from cmf_mj.machine.models import CMF
from cmf_mj.record.record import Record
from cmf_mj.record.sources import REMARK, Source, bridge_gaps, even_clock, read_source, resample

Array = NDArray[np.float64]

FACILITY = Path(__file__).with_name("facility.toml")  #: Map of the facility's CSV files.

_STROKE_CHANNELS = ("leg_position", "leg_reference")  #: Channels that are within the stroke.
POSES = ("demand_pose", "platform_pose")  #: Channels of six axes, m and rad.

CHANNELS = {
    **{"leg_position": "m", "leg_velocity": "m/s", "leg_acceleration": "m/s^2"},
    **{"cap_pressure": "Pa", "rod_pressure": "Pa", "leg_reference": "m"},
    **{"compensator_output": "1", "valve_command": "1"},
    **dict.fromkeys(POSES, "m, rad"),
}
"""Channels that a map may have, with their SI units; all have six columns."""

_Six = Field(min_length=6, max_length=6)
_Names = Annotated[tuple[str, ...], BeforeValidator(as_tuples), _Six]
_Numbers = Annotated[tuple[float, ...], BeforeValidator(as_tuples), _Six]
_Sign = Literal[-1, 1]
_Signs = Annotated[tuple[_Sign, ...], BeforeValidator(as_tuples), _Six]
_Rate = Annotated[float, Field(gt=0.0, le=1e6)]
_LOWEST_RATE = 1.0  #: Rate [Hz] below which a recording's clock has another unit.


class TimeColumn(Settings):
    """Where the time of a recording is."""

    column: str | None = None  #: Name of the column; without one the samples are at `rate`.
    unit: str = "s"  #: s, ms or us.
    rate: _Rate | None = None  #: Samples a second [Hz], without a column.
    resample: _Rate | None = None  #: Samples a second [Hz] of the record, straight lines between.

    @model_validator(mode="after")
    def _consistent(self) -> "TimeColumn":
        if (self.column is None) == (self.rate is None):
            raise InputError("needs either column or rate")
        _check_unit(self.unit, "s")
        return self


class ChannelColumns(Settings):
    """Columns of one channel."""

    columns: str | _Names  #: A pattern with {leg}, or six names.
    unit: str | _Names  #: Of the columns; one, or six.
    scale: float = 1.0  #: Units that one of the file's counts is.
    sign: _Sign | _Signs = 1  #: Our sign of what the file calls positive.
    offset: float | _Numbers = 0.0  #: What the file shows where the channel is zero [unit].


class MappedColumn(NamedTuple):
    """One column of a channel, which is sign (scale value - offset)."""

    name: str  #: Empty for one that was not recorded.
    unit: str
    sign: int
    scale: float
    offset: float

    def to_si(self, raw_values: Array) -> Array:
        """Values of the file in SI."""
        return units.to_si(self.unit, self.sign * (self.scale * raw_values - self.offset))


class ColumnMap(Settings):
    """What the columns of a recording are; the head of this module shows its file.

    >>> position = {"columns": "x{leg}", "unit": "mm"}
    >>> column_map = ColumnMap(time={"rate": 500.0}, channels={"leg_position": position})
    >>> column_map.columns("leg_position")[0].name
    'x1'
    """

    machine: str | None = None  #: Whose recording it is, by name or TOML file.
    bridge: Time = 0.0  #: Gaps up to this long are filled with straight lines [s].
    legs: Annotated[tuple[int | str, ...], BeforeValidator(as_tuples), _Six] = (1, 2, 3, 4, 5, 6)
    """Replacements of {leg} in names, for leg 1 first; in poses, for surge first."""
    whole: bool = False
    """Whether each channel has all columns, with a number in each row, or is left out; if not,
    `cmf recording check` names the gaps."""
    time: TimeColumn
    channels: dict[str, ChannelColumns] = Field(min_length=1)  #: By names of `CHANNELS`.

    @model_validator(mode="after")
    def _consistent(self) -> "ColumnMap":
        for channel, channel_columns in self.channels.items():
            check_name("channels", channel, CHANNELS)
            with within(f"channels.{channel}"):
                names = channel_columns.columns
                if isinstance(names, str) and "{leg}" not in names:
                    allowed = "allowed: a pattern with {leg}, or six names"
                    raise InputError(f"columns: {names!r} is refused; {allowed}")
                for column, si_unit in zip(self.columns(channel), si_units(channel), strict=True):
                    _check_unit(column.unit, si_unit)
        return self

    def columns(self, channel: str) -> list[MappedColumn]:
        """The six columns of a channel."""
        channel_columns = self.channels[channel]
        names = channel_columns.columns
        if isinstance(names, str):
            names = tuple(names.replace("{leg}", str(leg)) for leg in self.legs)
        numbers = (channel_columns.unit, channel_columns.sign, channel_columns.offset)
        rows = zip(names, *map(_for_six_columns, numbers), strict=True)
        scale = channel_columns.scale
        return [MappedColumn(name, unit, sign, scale, offset) for name, unit, sign, offset in rows]


def si_units(channel: str) -> tuple[str, ...]:
    """SI units of the six columns of a channel."""
    return ("m",) * 3 + ("rad",) * 3 if channel in POSES else (CHANNELS[channel],) * 6


def _check_unit(unit: str, si_unit: str) -> None:
    if units.si_unit(unit) != si_unit:
        raise InputError(f"unit: {unit!r} is {units.si_unit(unit)}; allowed: a unit of {si_unit}")


def _for_six_columns(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,) * 6


def load_columns(columns: "str | Path | ColumnMap" = FACILITY) -> ColumnMap:
    """A map as it is, or of its TOML file; a machine's file in it is beside that file."""
    if isinstance(columns, ColumnMap):
        return columns
    table = read_toml(Path(columns))
    if isinstance(table.get("machine"), str):
        table["machine"] = str(beside(Path(columns).parent, table["machine"]))
    return validated(ColumnMap, table, str(columns))


def read_mapped(
    path: str | Path,
    columns: "str | Path | ColumnMap | None" = None,
    machine: str | Path | Machine = CMF,
) -> Record:
    """A recording as a record in SI at an even rate.

    Where a column has no number the channel is NaN, unless the map bridges it. Uneven times are
    refused with the place, unless the map resamples.

    Args:
        path: a CSV, Parquet, HDF5 or MAT file.
        columns: a map or its file; None for the facility's CSV and for this project's records.
        machine: whose it is, by name, file or loaded, where the file does not say.

    Metadata have the machine, and `recording`: the file, the columns not recorded as `missing`, the
    samples filled as `bridged` by column, `units` of the map by channel, and `last_place` [m], what
    the last decimal of the legs' demand is, 0 without one.

    >>> from pathlib import Path
    >>> from cmf_mj.record.columns import ColumnMap, read_mapped
    >>> rows = ["t,x1,x2,x3,x4,x5,x6", "0,0,0,0,0,0,0", "2,5,5,5,5,5,5"]
    >>> file = Path("log.csv")
    >>> size = file.write_text(chr(10).join(rows))
    >>> position = {"columns": "x{leg}", "unit": "mm"}
    >>> columns = ColumnMap(time={"column": "t", "unit": "ms"}, channels={"leg_position": position})
    >>> read_mapped(file, columns, cmf_mj.load_machine("lab"))["leg_position"][1, 0].item()
    0.005
    >>> file.unlink()
    """
    default = load_machine(machine)
    if columns is None and Path(path).suffix == ".parquet":
        record = Record.load(path)
        return replace(record, metadata=_with_machine(record.metadata, default))
    column_map, source = load_columns(columns or FACILITY), read_source(path)
    with within(source.path):
        metadata = _with_machine(source.metadata, default)
        if column_map.whole:
            column_map = _whole_map(source, column_map, recorded_machine(metadata).half_stroke)
        return _record(source, column_map, metadata)


def _with_machine(metadata: Mapping[str, Any], default: Machine) -> dict[str, Any]:
    return {**metadata} | ({} if "machine" in metadata else default.metadata())


def _whole_map(source: Source, column_map: ColumnMap, half_stroke: float) -> ColumnMap:
    """A map without the channels that a file has not; the others have a number in every cell."""
    present = {}
    for channel, channel_columns in column_map.channels.items():
        columns, is_travel = column_map.columns(channel), channel in _STROKE_CHANNELS
        if any(column.name in source.columns for column in columns):
            present[channel] = channel_columns
            for column in columns:
                _check_cells(source, column, half_stroke if is_travel else np.inf)
    if not source.ended:
        raise InputError("the last row has no line end and may be cut off; if it is whole, add one")
    return column_map.model_copy(update={"channels": present}) if present else column_map


def _check_cells(source: Source, column: MappedColumn, bound: float) -> None:
    """Refuse a column with a cell that has no number below a bound in SI."""
    is_wrong, unit = ~(np.abs(column.to_si(source.column(column.name))) < bound), column.unit
    if is_wrong.any():
        allowed = f"allowed: a number within {units.from_si(unit, bound):.6g} {unit}"
        allowed += f" of {column.offset:g}" if column.offset else ""
        raise InputError(f"{column.name}: row {int(is_wrong.argmax()) + 1} has no such; {allowed}")


def write_facility_csv(record: Record, path: str | Path) -> Path:
    """Write what `FACILITY` maps, at the record's rate and with six decimals, and the metadata."""
    column_map, columns, target = load_columns(), {}, Path(path)
    for channel in column_map.channels:
        if channel in record.channels:
            histories = shaped(channel, record[channel], None, 6)
            for leg, column in enumerate(column_map.columns(channel)):
                columns[column.name] = units.from_si(column.unit, histories[:, leg])
    rows = np.column_stack([record.time, *columns.values()])
    header = ",".join([str(column_map.time.column), *columns])
    footer = REMARK + json.dumps(dict(record.metadata) | {"sample_rate": record.rate})
    formats = ["%.9f"] + ["%.6f"] * len(columns)
    with whole_file(target) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        np.savetxt(file, rows, formats, ",", header=header, footer=footer, comments="")
    return target


def _record(source: Source, column_map: ColumnMap, metadata: dict[str, Any]) -> Record:
    clock, bridge = column_map.time, column_map.bridge
    stamps = _stamps(source, clock)
    time, rate = stamps, clock.resample or clock.rate
    if rate is None:
        time, rate = even_clock(stamps)
    channels, missing, bridged = dict[str, Array](), list[str](), dict[str, int]()
    for channel in column_map.channels:
        histories, missing_columns = _histories(source, column_map, channel)
        missing += missing_columns
        if clock.resample is not None:
            time, histories = resample(stamps, histories, rate, bridge)
        for k, history in enumerate(histories):
            histories[k], samples = bridge_gaps(history, round(bridge * rate))
            if samples:
                bridged[f"{channel}/{k}"] = samples
        channels[channel] = histories.T
    recording: dict[str, Any] = {"file": source.path.name, "missing": missing, "bridged": bridged}
    recording["units"] = {name: column_map.columns(name)[0].unit for name in channels}
    recording["last_place"] = _last_place(source, column_map, "leg_reference")
    metadata = {"command": {"kind": "recording"}, **metadata, "sample_rate": rate}
    channel_units = {name: CHANNELS[name] for name in channels}
    return Record(time, channels, channel_units, metadata | {"recording": recording})


def _stamps(source: Source, clock: TimeColumn) -> Array:
    """Times of the samples [s], (N,), as the file has them; refused where they are too slow."""
    if clock.column is None:
        rows = next(iter(source.columns.values())).size
        stamps = np.arange(rows, dtype=float) / (clock.rate or 1.0)
    else:
        stamps = units.to_si(clock.unit, source.column(clock.column))
        if np.isnan(stamps).any():
            row = int(np.isnan(stamps).argmax()) + 1
            raise InputError(f"time: {clock.column}: row {row} has none; allowed: a time")
    interval = np.median(np.diff(stamps)) if stamps.size > 1 else 0.0
    if interval * _LOWEST_RATE > 1.0:
        text = f"{1.0 / interval:.3g} samples a second by unit {clock.unit!r}"
        raise InputError(f"time: {text} is refused; allowed: at least {_LOWEST_RATE:g}")
    return stamps


def _last_place(source: Source, column_map: ColumnMap, channel: str) -> float:
    """The last decimal of a channel's columns in SI, 0 where they fill a double or are 0."""
    places = [0.0]
    for column in column_map.columns(channel) if channel in column_map.channels else ():
        raw = source.columns.get(column.name, np.zeros(0))
        raw = raw[np.isfinite(raw) & (raw != 0.0)]
        for decimals in range(10 if raw.size else 0):
            if np.array_equal(np.round(raw, decimals), raw):
                places.append(units.factor(column.unit) * abs(column.scale) * 10.0**-decimals)
                break
    return max(places)


def _histories(source: Source, column_map: ColumnMap, channel: str) -> tuple[Array, list[str]]:
    """Histories of a channel in SI, (6, N), NaN for legs not recorded, and the names of these."""
    columns, histories, missing = column_map.columns(channel), [], []
    no_numbers = np.full(next(iter(source.columns.values())).size, np.nan)
    has_pattern = isinstance(column_map.channels[channel].columns, str)
    if has_pattern and not any(column.name in source.columns for column in columns):
        raise unknown_name(f"channels.{channel}: column", columns[0].name, source.columns)
    for leg, column in enumerate(columns, start=1):
        is_missing = not column.name or (has_pattern and column.name not in source.columns)
        if is_missing:
            missing.append(column.name or f"{channel} of leg {leg}")
        histories.append(column.to_si(no_numbers if is_missing else source.column(column.name)))
    return np.array(histories), missing
