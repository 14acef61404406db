"""Flights in memory and in files: the motion at the pilot's station and where it comes from.

A file is CSV or Parquet with the columns of `PilotMotion` and any others,

    time, specific_force_x ... _z, angular_rate_x ... _z, roll, pitch, yaw [, airspeed, height ...]

each with its unit: in a Parquet file as JSON in the schema, in a CSV file in the header, `time
[s],specific_force_x [g],angular_rate_x [deg/s] ...`. Units that `cmf_mj.core.units` knows are
converted; a column without one is in SI. The origin is with the units in Parquet; CSV has none.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.core import units
from cmf_mj.core.arrays import FrozenDict, frozen, shaped
from cmf_mj.core.errors import InputError, unknown_name, within
from cmf_mj.core.settings import FileHeader, Settings, parsed_json, validated
from cmf_mj.core.tables import read_column, read_table, write_parquet, write_table
from cmf_mj.pilot.drives import DRIVES, drive
from cmf_mj.pilot.motion import COLUMNS, PilotMotion

_KEY = "cmf_mj_flight"
_HEADER = re.compile(r"^(?P<name>[^\[\]]+?)\s*(?:\[(?P<unit>[^\[\]]+)\])?$")
_UNITS = {
    "time": "s",
    **dict.fromkeys(COLUMNS["specific_force"], "m/s^2"),
    **dict.fromkeys(COLUMNS["angular_rate"], "rad/s"),
    **dict.fromkeys(COLUMNS["attitude"], "rad"),
    "airspeed": "m/s",
    "height": "m",
}
_SHIPPED = Path(__file__).parent / "flights"
_MAX_STEP = 1.0  #: Longest time from row to row of a flight in a file [s].


class Origin(Settings):
    """Where a flight comes from."""

    title: str  #: In words.
    aircraft: str = "unknown"  #: Type.
    lever_arm: Annotated[tuple[float, float, float], Field(strict=False)] = (0.0, 0.0, 0.0)
    """From the centre of gravity to the pilot's station at the start, body axes [m]."""
    source: str  #: What flew it, with its version.
    seed: int | None = None  #: Of its turbulence, where there is any.


class FlightHeader(FileHeader):
    """What the schema of a flight's Parquet file holds."""

    units: dict[str, str]  #: Column to unit.
    origin: Origin  #: Of the flight.


@dataclass(frozen=True)
class Flight:
    """A recorded flight."""

    motion: PilotMotion  #: At the pilot's station.
    origin: Origin  #: Where it comes from.
    others: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """More columns by name, such as `airspeed` [m/s] and `height` [m], (N,) each."""

    def __post_init__(self) -> None:
        """Freeze the other columns; lengths and numbers that are not finite are refused by name."""
        count = self.motion.time.size
        others = {name: frozen(shaped(name, column, count)) for name, column in self.others.items()}
        object.__setattr__(self, "others", FrozenDict(others))

    def save(self, path: str | Path) -> Path:
        """Write as CSV or Parquet, by the name's end; the file appears when it is complete."""
        target, columns = Path(path), {**self.motion.columns(), **self.others}
        column_units = {name: _UNITS.get(name, "1") for name in columns}
        if target.suffix == ".parquet":
            header = {"units": column_units, "origin": self.origin.model_dump(mode="json")}
            return write_parquet(pa.table(columns), target, (_KEY, header))
        titled = {f"{name} [{column_units[name]}]": values for name, values in columns.items()}
        return write_table(pa.table(titled), target)


def flight_names() -> list[str]:
    """Names of the flights that ship with the project."""
    return sorted(path.stem for path in _SHIPPED.glob("*.parquet"))


def all_flight_names() -> list[str]:
    """Names of flights and drives."""
    return [*flight_names(), *DRIVES]


def load_flight(source: str | Path) -> Flight:
    """Load a shipped flight or a drive by its name, a drawn one as `name:seed`, or a file."""
    drive_name, colon, seed = str(source).partition(":")
    if drive_name in DRIVES:
        if colon and not (seed.isascii() and seed.isdigit()):
            raise InputError(
                f"flight: seed {seed!r} of {drive_name}; allowed: a whole number from 0"
            )
        number = int(seed) if colon else None
        title = f"{drive_name.replace('_', ' ')} of a road vehicle"
        origin = Origin(title=title, aircraft="road vehicle", source="pilot.drives", seed=number)
        return Flight(drive(drive_name, number), origin)
    path, columns, origin = read_columns(source)
    time = columns.pop("time")
    channels = {
        channel: np.column_stack([columns.pop(name) for name in names])
        for channel, names in COLUMNS.items()
    }
    with within(path):
        motion = PilotMotion(time, **channels)
        if time.size < 2:
            raise InputError(f"time: has {time.size} row; at least 2 are needed")
        if (step := float(np.median(np.diff(time)))) > _MAX_STEP:
            raise InputError(f"time: {step:g} s from row to row; allowed: to {_MAX_STEP} s; in ms?")
        if (pitch := float(np.abs(motion.attitude[:, 1]).max())) > 0.5 * np.pi:
            raise InputError(f"pitch: {pitch:g} rad; allowed: within +-90 deg; in degrees?")
        return Flight(motion, origin, columns)


def read_columns(source: str | Path) -> tuple[Path, dict[str, NDArray[np.float64]], Origin]:
    """The file of a shipped flight or a user's, its columns in SI, which may yet make no sense."""
    path = Path(source)
    if not path.suffix:
        if str(source) not in flight_names():
            files = " nor a .csv or .parquet file"
            raise unknown_name("flight", str(source), all_flight_names(), files)
        path = _SHIPPED / f"{source}.parquet"
    table, origin = read_table(path), Origin(title=path.stem, source=path.name)
    if (raw := (table.schema.metadata or {}).get(_KEY.encode())) is not None:
        place = f"{path}: header {_KEY}"
        header = validated(FlightHeader, parsed_json(raw, place), place)
        column_units, origin = header.units, header.origin
    else:
        titles = [_column_title(path, cell) for cell in table.column_names]
        column_units = {title["name"]: title["unit"] or "1" for title in titles}
        table = table.rename_columns([title["name"] for title in titles])
    columns = {}
    for name in dict.fromkeys(["time", *sum(COLUMNS.values(), ()), *table.column_names]):
        values = read_column(path, table, name)
        with within(f"{path}: {name}"):
            columns[name] = np.asarray(units.to_si(column_units.get(name, "1"), values))
    return path, columns, origin


def _column_title(path: Path, cell: str) -> re.Match[str]:
    """Name and unit in a cell `name` or `name [unit]` of a file's header."""
    title = _HEADER.match(cell)
    if title is None:
        raise InputError(f"{path}: header: {cell!r} is refused; allowed: name or name [unit]")
    return title
