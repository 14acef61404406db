"""Flights in memory and in files: the motion at the pilot's station and where it comes from.

A file is CSV or Parquet with the columns of `PilotMotion` and any others,

    time, specific_force_x ... _z, angular_rate_x ... _z, roll, pitch, yaw [, airspeed, height ...]

each with its unit: in a Parquet file as JSON in the schema, in a CSV file in the header, `time
[s],specific_force_x [g],angular_rate_x [deg/s] ...`. Units that `cmf_mj.core.units` knows are
converted; a column without one is in SI. The origin is with the units in Parquet, and in the first
line of a CSV file after `# cmf_mj_flight`, as JSON; a file may do without.
"""

import io
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.core import units
from cmf_mj.core.arrays import FrozenDict, frozen, shaped
from cmf_mj.core.errors import InputError, reason, unknown_name, within
from cmf_mj.core.files import read_column, read_table, whole_file, write_parquet
from cmf_mj.core.settings import FileHeader, Settings, check_file, parsed_json, validated
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

_SLOWEST = 1.0  #: Longest time from row to row of a flight in a file [s].


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
        others = {name: frozen(shaped(name, one, count)) for name, one in self.others.items()}
        object.__setattr__(self, "others", FrozenDict(others))

    def save(self, path: str | Path) -> Path:
        """Write as CSV or Parquet, by the name's end; the file appears when it is complete."""
        target = Path(path)
        columns = {**self.motion.columns(), **self.others}
        column_units = {name: _UNITS.get(name, "1") for name in columns}
        origin = self.origin.model_dump(mode="json")
        if target.suffix == ".parquet":
            header = {"units": column_units, "origin": origin}
            return write_parquet(pa.table(columns), target, (_KEY, header))
        if target.suffix != ".csv":
            raise InputError(f"{target}: must end in .csv or .parquet")
        titled = {f"{name} [{column_units[name]}]": values for name, values in columns.items()}
        with whole_file(target) as partial, partial.open("wb") as file:
            file.write(f"# {_KEY} {json.dumps(origin)}\n".encode())
            pyarrow.csv.write_csv(pa.table(titled), file)
        return target


def flight_names() -> list[str]:
    """Names of the flights that ship with the project."""
    return sorted(path.stem for path in _SHIPPED.glob("*.parquet"))


def names() -> list[str]:
    """Names of flights and drives."""
    return [*flight_names(), *DRIVES]


def load_flight(source: str | Path) -> Flight:
    """Load a shipped flight or a drive by its name, a drawn one as `name:seed`, or a file."""
    kind, drawn, seed = str(source).partition(":")
    if kind in DRIVES:
        if drawn and not (seed.isascii() and seed.isdigit()):
            raise InputError(f"flight: seed {seed!r} of {kind}; allowed: a whole number from 0")
        number = int(seed) if drawn else None
        title = f"{kind.replace('_', ' ')} of a road vehicle"
        origin = Origin(title=title, aircraft="road vehicle", source="pilot.drives", seed=number)
        return Flight(drive(kind, number), origin)
    path, columns, origin = read_columns(source)
    time = columns.pop("time")
    channels = [np.column_stack([columns.pop(n) for n in names]) for names in COLUMNS.values()]
    with within(path):
        motion = PilotMotion(time, *channels)
        if time.size < 2:
            raise InputError(f"time: has {time.size} row; at least 2 are needed")
        if (step := float(np.median(np.diff(time)))) > _SLOWEST:
            raise InputError(f"time: {step:g} s from row to row; allowed: to {_SLOWEST} s; in ms?")
        if (pitch := float(np.abs(motion.attitude[:, 1]).max())) > 0.5 * np.pi:
            raise InputError(f"pitch: {pitch:g} rad; allowed: within +-90 deg; in degrees?")
        return Flight(motion, origin, columns)


def read_columns(source: str | Path) -> tuple[Path, dict[str, NDArray[np.float64]], Origin]:
    """The file of a shipped flight or a user's, its columns in SI, which may yet make no sense."""
    path = Path(source)
    if not path.suffix:
        if str(source) not in flight_names():
            files = " nor a .csv or .parquet file"
            raise unknown_name("flight", str(source), names(), files)
        path = _SHIPPED / f"{source}.parquet"
    table, column_units, origin = (_csv if path.suffix == ".csv" else _parquet)(path)
    columns = {}
    for name in dict.fromkeys(["time", *sum(COLUMNS.values(), ()), *table.column_names]):
        values = read_column(path, table, name)
        with within(f"{path}: {name}"):
            columns[name] = np.asarray(units.to_si(column_units.get(name, "1"), values))
    return path, columns, origin or Origin(title=path.stem, source=path.name)


Parts = tuple[pa.Table, dict[str, str], Origin | None]  #: Table, units of its columns, origin.


def _parquet(path: Path) -> Parts:
    table = read_table(path)
    raw = (table.schema.metadata or {}).get(_KEY.encode())
    if raw is None:
        return table, {}, None
    where = f"{path}: header {_KEY}"
    header = validated(FlightHeader, parsed_json(raw, where), where)
    return table, header.units, header.origin


def _csv(path: Path) -> Parts:
    origin: Any = None
    try:
        text = check_file(path).read_text(encoding="utf-8-sig")
        if text.startswith("#"):
            first, _, text = text.partition("\n")
            if first.startswith(f"# {_KEY} "):
                origin = parsed_json(first.removeprefix(f"# {_KEY} "), f"{path}: row 1")
                origin = validated(Origin, origin, f"{path}: row 1")
        table = pyarrow.csv.read_csv(io.BytesIO(text.encode()))
    except InputError:
        raise
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    names, column_units = [], {}
    for cell in table.column_names:
        if (title := _HEADER.match(cell.strip(' "'))) is None:
            raise InputError(f"{path}: header: {cell!r} is refused; allowed: name or name [unit]")
        names.append(title["name"].lower())
        column_units[names[-1]] = title["unit"] or "1"
    return table.rename_columns(names), column_units, origin
