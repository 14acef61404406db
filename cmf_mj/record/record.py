"""Time histories of a run: named channels in SI with units and everything needed to repeat it.

A record is immutable, down to nested metadata; it pickles and copies. Its file is a Parquet table:
a column per scalar channel, `leg_position_1` to `_6` for a channel with a leg axis, and metadata
(units, parameters, law, seed, model digest) as JSON in the schema, so that any Parquet reader opens
it. Checksums tell a damaged file from a whole one (`cmf_mj.core.tables`).
"""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from cmf_mj.core.arrays import FrozenDict, frozen, frozen_json, real, shaped
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.files import check_target
from cmf_mj.core.settings import FileHeader
from cmf_mj.core.tables import read_column, read_headed, write_parquet
from cmf_mj.core.units import si_unit, to_si
from cmf_mj.record.sources import even_clock
from cmf_mj.signals import signal_of
from cmf_mj.signals.signal import Signal

_SCHEMA_KEY = "cmf_mj"
_SYMBOL = r"(1|m|s|kg|N|Pa|J|W|V|A|K|Hz|rad)(\^[1-9])?"
_SI = re.compile(rf"{_SYMBOL}((, |/| ){_SYMBOL})*")
"""Units that a channel may have: of SI, with powers, products, quotients and one a column."""

_TABLES = "command machine_parameters cab_parameters law_parameters law_state electronics".split()
"""Optional metadata that are tables."""

_MAX_TIME_ERROR = 1e-6
"""Largest distance of a sample from its instant [s]; the facility's files tell a time to 1e-7 s."""

AnySignal = TypeVar("AnySignal", bound=Signal)


class RecordHeader(FileHeader):
    """What the schema of a record's file holds."""

    units: dict[str, str]  #: Channel name to SI unit.
    widths: dict[str, Annotated[int, Field(ge=0)]]
    """Channel name to number of columns; 0 for a channel without a leg axis."""
    metadata: dict[str, Any]  #: Of the record.


@dataclass(frozen=True, repr=False, eq=False)
class Record:
    """Labelled time histories of one run; equal where all samples, to the bit, and metadata are.

    >>> record = cmf_mj.simulate(cmf_mj.SingleLegs(), "velocity", np.zeros((4, 6)))
    >>> record["leg_position"].shape, record.units["leg_position"]
    ((4, 6), 'm')
    """

    time: NDArray[np.float64]  #: Sample times [s], (N,).
    channels: Mapping[str, NDArray[np.float64]]
    """Channel name to (N,) or (N, k) values in SI, read-only."""
    units: Mapping[str, str]  #: Channel name to SI unit.
    metadata: Mapping[str, Any]
    """Plant, law, command, seed, versions and model digest; plain JSON values."""

    def __post_init__(self) -> None:
        """Freeze the histories, copying those that may be written, and check that they match."""
        histories = {name: frozen(real(name, values)) for name, values in self.channels.items()}
        object.__setattr__(self, "time", frozen(real("time", self.time)))
        if self.time.ndim != 1:
            raise InputError(f"time: shape is {self.time.shape}; allowed: (N,)")
        count = self.time.size
        for name, values in histories.items():
            if values.shape[:1] != (count,) or values.ndim > 2 or 0 in values.shape[1:]:
                allowed = f"({count},) or ({count}, k) as times are, k above 0"
                raise InputError(f"{name}: shape is {values.shape}; allowed: {allowed}")
        if set(self.units) != set(self.channels):
            unmatched = sorted(set(self.units) ^ set(self.channels))
            raise InputError(f"units: every channel needs one unit; check {', '.join(unmatched)}")
        for name, unit in self.units.items():
            if not _SI.fullmatch(unit):
                raise InputError(f"units: {name}: {unit!r} is refused; allowed: of SI, such as m/s")
        for name in _TABLES:
            value = self.metadata.get(name)
            if not isinstance(value, Mapping | None):
                raise InputError(f"metadata: {name}: {value!r} is refused; allowed: a table")
        object.__setattr__(self, "channels", FrozenDict(histories))
        object.__setattr__(self, "units", FrozenDict(self.units))
        object.__setattr__(self, "metadata", frozen_json(dict(self.metadata)))

    def __eq__(self, other: object) -> bool:
        """Whether times, channels, units and metadata are the same; a NaN equals itself."""
        if not isinstance(other, Record):
            return NotImplemented
        if (self.units, self.metadata) != (other.units, other.metadata):
            return False
        pairs = [(self.time, other.time), *((self[name], other[name]) for name in self.channels)]
        return all(a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in pairs)

    def __hash__(self) -> int:
        """Hash of the samples."""
        return hash(self.digest)

    @staticmethod
    def from_arrays(
        time: ArrayLike,
        channels: Mapping[str, ArrayLike],
        units: Mapping[str, str],
        metadata: Mapping[str, Any] | None = None,
    ) -> "Record":
        """A record of histories from anywhere, in the field's units.

        Args:
            time: even times [s], (N,); refused with the row where they are not.
            channels: name to (N,) or (N, k) values.
            units: name to unit, of SI or known to `core.units`.
            metadata: what else is known; the rate is added.

        >>> record = cmf_mj.Record.from_arrays([0, 0.5], {"speed": [1, 2]}, {"speed": "in/s"})
        >>> record["speed"].tolist(), record.units["speed"], record.rate
        ([0.0254, 0.0508], 'm/s', 2.0)
        """
        even_time, rate = even_clock(shaped("time", time, None))
        histories = {name: real(name, values) for name, values in channels.items()}
        si_units = dict(units)
        for name, unit in units.items():
            if not _SI.fullmatch(unit):
                si_units[name] = si_unit(unit)
            if name in histories and unit != si_units[name]:
                histories[name] = to_si(unit, histories[name])
        metadata = {"command": {"kind": "recording"}} | dict(metadata or {})
        return Record(even_time, histories, si_units, metadata | {"sample_rate": rate})

    def __reduce__(self) -> tuple[Any, ...]:
        """What pickle makes the record of again, so that its arrays are frozen."""
        return Record, (self.time, dict(self.channels), dict(self.units), dict(self.metadata))

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """A channel by name; an unknown name is refused with the list of the channels."""
        return self.channels[check_name("channel", name, self.channels)]

    def __repr__(self) -> str:
        """What was run, for how long, and the channels."""
        metadata, signal = self.metadata, self.signal
        words = (metadata.get("plant"), metadata.get("law"), signal.kind, signal.axis)
        size = f"{self.time.size} samples at {metadata.get('sample_rate', '?')} Hz"
        text = ", ".join([*(str(word) for word in words if word), size])
        return f"<Record: {text}; {', '.join(self.channels)}>"

    @property
    def digest(self) -> str:
        """Eight digits of the SHA-256 of the samples."""
        checksum = hashlib.sha256(np.ascontiguousarray(self.time).tobytes())
        for name in sorted(self.channels):
            checksum.update(name.encode() + np.ascontiguousarray(self[name]).tobytes())
        return checksum.hexdigest()[:8]

    @property
    def signal(self) -> Signal:
        """The signal that was demanded, of the metadata's `command`."""
        return signal_of(self.metadata.get("command") or {})

    @property
    def excitation(self) -> Signal:
        """The signal, refused where it has more than half the sampling rate."""
        signal = self.signal
        frequencies = (*(signal.band or ()), *(dwell.frequency for dwell in signal.dwells))
        highest = max(frequencies, default=0.0)
        if highest > 0.5 * self.rate:
            text = f"{self.rate:g} samples a second cannot hold {highest:g} Hz of the {signal.kind}"
            raise InputError(f"record_every: {text}; allowed: at least {2.0 * highest:g} a second")
        return signal

    def signal_as(self, kind: type[AnySignal]) -> AnySignal:
        """The signal, refused if it is not of one kind."""
        signal = self.signal
        if not isinstance(signal, kind):
            name = kind.kind_name().replace("_", " ")
            subject = f"{name} are" if name.endswith("s") else f"a {name} is"
            raise InputError(f"record: its command is a {signal.kind}; {subject} needed")
        return signal

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]; refused where there is none, or the times do not have it."""
        rate, time = self.metadata.get("sample_rate", np.nan), self.time
        is_number = isinstance(rate, int | float) and not isinstance(rate, bool)
        if not (is_number and 0.0 < rate < np.inf):
            raise InputError(f"sample_rate: {rate!r} Hz is refused; allowed: a number above 0")
        if time.size == 0:
            raise InputError("record: has no samples; allowed: at least 1")
        is_on_time = np.abs(time - time[0] - np.arange(time.size) / rate) < _MAX_TIME_ERROR
        if not is_on_time.all():
            sample = int(np.argmin(is_on_time))
            raise InputError(f"time: sample {sample} at {time[sample]} s is not at {rate} Hz")
        return float(rate)

    def save(self, path: str | Path) -> Path:
        """Write the record to `path` as Parquet; the file appears only when it is complete."""
        target = check_target(Path(path))
        columns, widths = {"time": np.ascontiguousarray(self.time)}, dict[str, int]()
        for name, values in self.channels.items():
            widths[name] = values.shape[1] if values.ndim > 1 else 0
            histories = values.T if widths[name] else [values]
            for column, history in zip(_column_names(name, widths[name]), histories, strict=True):
                if column in columns:
                    raise InputError(f"{name}: its column {column} belongs to another channel")
                columns[column] = np.ascontiguousarray(history)
        header = {"units": dict(self.units), "widths": widths, "metadata": dict(self.metadata)}
        encoding = {"column_encoding": "BYTE_STREAM_SPLIT"}
        return write_parquet(pa.table(columns), target, (_SCHEMA_KEY, header), **encoding)

    @staticmethod
    def load(path: str | Path) -> "Record":
        """Read a record that `save` wrote to `path`; values come back bit for bit.

        A damaged file, or one that is no record of this project, is refused.
        """
        source = Path(path)
        table, header = read_headed(source, _SCHEMA_KEY, RecordHeader)

        def column(name: str) -> NDArray[np.float64]:
            return read_column(source, table, name, None)

        channels = {}
        for name, width in header.widths.items():
            histories = [column(column_name) for column_name in _column_names(name, width)]
            channels[name] = np.column_stack(histories) if width else histories[0]
        with within(source):
            return Record(column("time"), channels, header.units, header.metadata)


def _column_names(channel: str, width: int) -> list[str]:
    """Names of the columns of a channel in a file; 0 is the width of a channel with no leg axis."""
    return [f"{channel}_{number}" for number in range(1, width + 1)] or [channel]
