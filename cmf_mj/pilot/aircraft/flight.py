"""Flights in memory and in files: the motion at the pilot's station and where it comes from.

A file is CSV or Parquet with the columns of `PilotMotion` and any others,

    time, specific_force_x ... _z, angular_rate_x ... _z, roll, pitch, yaw [, airspeed, height ...]

each with its unit: in a Parquet file as JSON in the schema, in a CSV file in the header, `time
[s],specific_force_x [g],angular_rate_x [deg/s] ...`. Units that `cmf_mj.core.units` knows are
converted; a column without one is in SI. The metadata are with the units in Parquet, and in the
first line of a CSV file after `# cmf_mj_flight`, as JSON.
"""

import io
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.core import units
from cmf_mj.core.arrays import FrozenDict, check_finite, frozen
from cmf_mj.core.errors import InputError, reason, unknown_name, within
from cmf_mj.core.files import read_column, read_headed, whole_file, write_parquet
from cmf_mj.core.settings import FileHeader, Settings, check_file, parsed_json, validated
from cmf_mj.pilot.host import PilotSample, pilot_samples
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


class Origin(Settings):
    """Where a flight comes from."""

    title: str  #: In words.
    aircraft: str  #: Type.
    lever_arm: Annotated[tuple[float, float, float], Field(strict=False)]
    """From the centre of gravity to the pilot's station at the start, body axes [m]."""
    source: str  #: What flew it, with its version.
    seed: int | None = None  #: Of its turbulence, where there is any.


class FlightHeader(FileHeader):
    """What the schema of a flight's Parquet file holds."""

    units: dict[str, str]  #: Column to unit.
    origin: Origin  #: Of the flight.


@dataclass(frozen=True)
class Flight:
    """A recorded flight; an `AircraftHost`."""

    motion: PilotMotion  #: At the pilot's station.
    origin: Origin  #: Where it comes from.
    others: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """More columns by name, such as `airspeed` [m/s] and `height` [m], (N,) each."""

    def __post_init__(self) -> None:
        """Freeze the other columns; lengths and numbers that are not finite are refused by name."""
        others = {name: np.array(values, dtype=float) for name, values in self.others.items()}
        for name, values in others.items():
            if values.shape != self.motion.time.shape:
                raise InputError(f"{name}: shape {values.shape}; allowed: {self.motion.time.shape}")
            check_finite(name, values)
        frozen_others = {name: frozen(values) for name, values in others.items()}
        object.__setattr__(self, "others", FrozenDict(frozen_others))

    def samples(self) -> Iterator[PilotSample]:
        """The samples one by one, as a host in aircraft mode sends them."""
        return pilot_samples(self.motion)

    def save(self, path: str | Path, *, single: bool = False) -> Path:
        """Write as CSV or Parquet, by the name's end; the file appears when it is complete.

        `single` rounds all but the time to single precision, which halves a Parquet file and
        changes a specific force by at most 1e-6 m/s^2.
        """
        target = Path(path)
        columns = {**self.motion.columns(), **self.others}
        if single:
            columns |= {n: v.astype(np.float32) for n, v in columns.items() if n != "time"}
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

    @staticmethod
    def load(path: str | Path) -> "Flight":
        """Read a flight; what is refused in file, header, columns and units is named."""
        source = Path(path)
        table, column_units, origin = _parts(source)

        def column(name: str) -> NDArray[np.float64]:
            values = read_column(source, table, name)
            with within(f"{source}: {name}"):
                return np.asarray(units.to_si(column_units.get(name, "1"), values))

        motion = PilotMotion.from_columns(column, source)
        others = {n: column(n) for n in table.column_names if n not in motion.columns()}
        with within(source):
            return Flight(motion, origin, others)


def flight_names() -> list[str]:
    """Names of the flights that ship with the project."""
    return sorted(path.stem for path in _SHIPPED.glob("*.parquet"))


def load_flight(source: str | Path) -> Flight:
    """Load a shipped flight by its name, or a CSV or Parquet file."""
    if Path(source).suffix:
        return Flight.load(source)
    if str(source) not in flight_names():
        raise unknown_name("flight", str(source), flight_names(), " nor a .csv or .parquet file")
    return Flight.load(_SHIPPED / f"{source}.parquet")


def read_columns(path: Path) -> dict[str, NDArray[np.float64]]:
    """Columns of a CSV file in SI, by the units of its header; a line with `#` above it is left."""
    text = _text(path)
    if text.startswith("#"):
        text = text.partition("\n")[2]
    table, column_units = _titled(path, text)
    columns = {}
    for name in table.column_names:
        with within(f"{path}: {name}"):
            values = read_column(path, table, name)
            columns[name] = np.asarray(units.to_si(column_units.get(name, "1"), values))
    return columns


def _text(path: Path) -> str:
    try:
        return check_file(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error


def _parts(path: Path) -> tuple[pa.Table, dict[str, str], Origin]:
    """Table, units of its columns and origin."""
    if path.suffix != ".csv":
        table, header = read_headed(path, _KEY, FlightHeader)
        return table, header.units, header.origin
    first, _, rest = _text(path).partition("\n")
    if not first.startswith(f"# {_KEY} "):
        raise InputError(
            f"{path}: row 1: is {first[:40]!r}; allowed: '# {_KEY} ' and the origin as JSON"
        )
    origin = parsed_json(first.removeprefix(f"# {_KEY} "), f"{path}: row 1")
    return *_titled(path, rest), validated(Origin, origin, f"{path}: row 1")


def _titled(path: Path, text: str) -> tuple[pa.Table, dict[str, str]]:
    """Table of a CSV text and the units of its columns."""
    try:
        table = pyarrow.csv.read_csv(io.BytesIO(text.encode()))
    except (ValueError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    matches = [_HEADER.match(cell.strip().strip('"')) for cell in table.column_names]
    if not all(matches):
        odd = table.column_names[matches.index(None)]
        raise InputError(f"{path}: header: {odd!r} is refused; allowed: name or name [unit]")
    cells = [match.groupdict() for match in matches if match]
    column_units = {str(cell["name"]): cell["unit"] or "1" for cell in cells}
    return table.rename_columns([str(cell["name"]) for cell in cells]), column_units
