"""Maps from the columns of a recording to channels in SI: whose names, units, signs, offsets.

    machine = "mine.toml"               # whose recording it is: a name, or a file beside this one
    bridge = 0.02                       # gaps up to this long [s] are filled with straight lines
    whole = false                       # true refuses all gaps and files that may be cut off
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
from cmf_mj.record.sources import REMARK, Source, bridged, even_clock, read_source, resampled

Array = NDArray[np.float64]

FACILITY = Path(__file__).with_name("facility.toml")
"""Map of the facility's CSV files."""

STROKES = ("leg_position", "leg_reference")  #: Channels that are within the stroke.
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
_SLOWEST = 1.0  #: Rate [Hz] below which a recording's clock has another unit.


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

    columns: str | _Names  #: A pattern with {leg}, or six names.
    unit: str | _Names  #: Of the columns; one, or six.
    scale: float = 1.0  #: Units that one of the file's counts is.
    sign: _Sign | _Signs = 1  #: Of what the file calls positive.
    offset: float | _Numbers = 0.0  #: What the file shows where the channel is zero [unit].


class MappedColumn(NamedTuple):
    """One column of a channel, which is sign (scale value - offset)."""

    name: str  #: Empty for one that was not recorded.
    unit: str
    sign: int
    scale: float
    offset: float

    def si(self, raw: Array) -> Array:
        """Its values in SI."""
        return units.to_si(self.unit, self.sign * (self.scale * raw - self.offset))


class ColumnMap(Settings):
    """What the columns of a recording are, as heads this module.

    >>> position = {"columns": "x{leg}", "unit": "mm"}
    >>> made = ColumnMap(time={"rate": 500.0}, channels={"leg_position": position})
    >>> made.columns("leg_position")[0].name
    'x1'
    """

    machine: str | None = None  #: Whose recording it is, by name or TOML file.
    bridge: Time = 0.0  #: Gaps up to this long are filled with straight lines [s].
    legs: Annotated[tuple[int | str, ...], BeforeValidator(as_tuples), _Six] = (1, 2, 3, 4, 5, 6)
    """What stands for {leg} in names, of leg 1 first; of poses, of surge first."""
    whole: bool = False
    """Whether a channel has all columns, with a number in each row, or is left out; without it
    `cmf recording check` names the gaps."""
    time: TimeColumn
    channels: dict[str, ChannelColumns] = Field(min_length=1)  #: By names of `CHANNELS`.

    @model_validator(mode="after")
    def _known(self) -> "ColumnMap":
        for name, one in self.channels.items():
            check_name("channels", name, CHANNELS)
            with within(f"channels.{name}"):
                if isinstance(one.columns, str) and "{leg}" not in one.columns:
                    allowed = "allowed: a pattern with {leg}, or six names"
                    raise InputError(f"columns: {one.columns!r} is refused; {allowed}")
                for column, si in zip(self.columns(name), _si(name), strict=True):
                    _check_unit(column.unit, si)
        return self

    def columns(self, channel: str) -> list[MappedColumn]:
        """The six columns of a channel."""
        one = self.channels[channel]
        names = one.columns
        if isinstance(names, str):
            names = tuple(names.replace("{leg}", str(leg)) for leg in self.legs)
        parts = map(_six, (names, one.unit, one.sign, one.scale, one.offset))
        return list(map(MappedColumn, *parts))


def _si(channel: str) -> list[str]:
    return ["m"] * 3 + ["rad"] * 3 if channel in POSES else [CHANNELS[channel]] * 6


def _check_unit(unit: str, si: str) -> None:
    if units.si_unit(unit) != si:
        raise InputError(f"unit: {unit!r} is {units.si_unit(unit)}; allowed: a unit of {si}")


def _six(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,) * 6


def load_columns(source: "str | Path | ColumnMap" = FACILITY) -> ColumnMap:
    """A map from its TOML file, whose machine counts from there, or as it is."""
    if isinstance(source, ColumnMap):
        return source
    table = read_toml(Path(source))
    if isinstance(table.get("machine"), str):
        table["machine"] = str(beside(Path(source).parent, table["machine"]))
    return validated(ColumnMap, table, str(source))


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
    >>> made = ColumnMap(time={"column": "t", "unit": "ms"}, channels={"leg_position": position})
    >>> read_mapped(file, made, cmf_mj.load_machine("lab"))["leg_position"][1, 0].item()
    0.005
    >>> file.unlink()
    """
    on = load_machine(machine)
    if columns is None and Path(path).suffix == ".parquet":
        record = Record.load(path)
        return replace(record, metadata=_known(record.metadata, on))
    chosen, source = load_columns(columns or FACILITY), read_source(path)
    with within(source.path):
        known = _known(source.metadata, on)
        if chosen.whole:
            chosen = _whole(source, chosen, recorded_machine(known).half_stroke)
        return _mapped(source, chosen, known)


def _known(metadata: Mapping[str, Any], machine: Machine) -> dict[str, Any]:
    """Metadata with a machine, where they have none."""
    return {**metadata} | ({} if "machine" in metadata else machine.metadata())


def _whole(source: Source, chosen: ColumnMap, stroke: float) -> ColumnMap:
    """A map without the channels that a file has not; the others have a number in every cell."""
    names = {one: {column.name for column in chosen.columns(one)} for one in chosen.channels}
    there = {one: chosen.channels[one] for one in names if names[one] & {*source.columns}}
    for channel in there:
        most = stroke if channel in STROKES else np.inf
        for one in chosen.columns(channel):
            odd = ~(np.abs(one.si(source.column(one.name))) < most)
            if odd.any():
                allowed = f"allowed: a number within {units.from_si(one.unit, most):.6g} {one.unit}"
                allowed += f" of {one.offset:g}" if one.offset else ""
                raise InputError(f"{one.name}: row {int(odd.argmax()) + 1} has no such; {allowed}")
    if not source.ended:
        raise InputError("the last row has no line end and may be cut off; if it is whole, add one")
    return chosen.model_copy(update={"channels": there or chosen.channels})


def write_facility_csv(record: Record, path: str | Path) -> Path:
    """Write the channels of a record that `FACILITY` maps, and its metadata; six decimals.

    The rate stays; the facility's recorder has 128 Hz.
    """
    chosen, columns, target = load_columns(), {}, Path(path)
    for channel in (name for name in chosen.channels if name in record.channels):
        legs = shaped(channel, record[channel], None, 6).T
        for one, leg in zip(chosen.columns(channel), legs, strict=True):
            columns[one.name] = units.from_si(one.unit, leg)
    rows = np.column_stack([record.time, *columns.values()])
    header = ",".join([str(chosen.time.column), *columns])
    footer = REMARK + json.dumps(dict(record.metadata) | {"sample_rate": record.rate})
    how: dict[str, Any] = {"delimiter": ",", "header": header, "footer": footer, "comments": ""}
    with whole_file(target) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        np.savetxt(file, rows, ["%.9f"] + ["%.6f"] * len(columns), **how)
    return target


def _mapped(source: Source, chosen: ColumnMap, known: dict[str, Any]) -> Record:
    when = chosen.time
    stamps: Array = np.arange(next(iter(source.columns.values())).size, dtype=float)
    rate = when.resample or when.rate
    if when.column is not None:
        stamps = units.to_si(when.unit, source.column(when.column))
        if np.isnan(stamps).any():
            row = int(np.isnan(stamps).argmax()) + 1
            raise InputError(f"time: {when.column}: row {row} has none; allowed: a time")
    elif when.rate is not None:
        stamps = stamps / when.rate
    time, spacing = stamps, np.median(np.diff(stamps)) if stamps.size > 1 else 0.0
    if spacing * _SLOWEST > 1.0:
        by = f"{1.0 / spacing:.3g} samples a second by unit {when.unit!r}"
        raise InputError(f"time: {by} is refused; allowed: at least {_SLOWEST:g}")
    if rate is None:
        time, rate = even_clock(stamps)
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
        channels[channel] = legs.T
    said: dict[str, Any] = {"file": source.path.name, "missing": missing, "bridged": counts}
    said["units"] = {name: _six(one.unit)[0] for name, one in chosen.channels.items()}
    said["last_place"] = _last_place(source, chosen, "leg_reference")
    metadata = {"command": {"kind": "recording"}, **known, "sample_rate": rate, "recording": said}
    return Record(time, channels, {name: CHANNELS[name] for name in channels}, metadata)


def _last_place(source: Source, chosen: ColumnMap, channel: str) -> float:
    """What the last decimal of a channel's columns is in SI, 0 where they fill a double.

    Columns with no number but zero do not tell.
    """
    places = [0.0]
    for one in chosen.columns(channel) if channel in chosen.channels else ():
        raw = source.columns.get(one.name, np.zeros(0))
        raw = raw[np.isfinite(raw) & (raw != 0.0)]
        fits = (n for n in range(10) if raw.size and np.array_equal(np.round(raw, n), raw))
        count = units.factor(one.unit) * abs(one.scale)
        places.append(next((count * 10.0**-n for n in fits), 0.0))
    return max(places)


def _legs(source: Source, chosen: ColumnMap, channel: str) -> tuple[Array, list[str]]:
    """Histories of a channel in SI, (6, N), NaN for legs not recorded, and the names of these."""
    columns, made, missing = chosen.columns(channel), [], []
    lost = np.full(next(iter(source.columns.values())).size, np.nan)
    pattern = isinstance(chosen.channels[channel].columns, str)
    if pattern and not any(column.name in source.columns for column in columns):
        raise unknown_name(f"channels.{channel}: column", columns[0].name, source.columns)
    for k, column in enumerate(columns):
        absent = not column.name or (pattern and column.name not in source.columns)
        missing += [column.name or f"{channel} of leg {k + 1}"] if absent else []
        made.append(column.si(lost if absent else source.column(column.name)))
    return np.array(made), missing
