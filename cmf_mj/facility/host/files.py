"""Host streams and sessions in files: CSV and Parquet tables of the same columns, SI.

time                                           [s]
surge, sway, heave, roll, pitch, yaw           pose [m, rad], z down
surge_velocity ... yaw_velocity                [m/s, rad/s]      both or neither
surge_acceleration ... yaw_acceleration        [m/s^2, rad/s^2]
sequence                                       optional
control_frame                                  sessions only
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.control.dcu.play import Arrivals, upsample
from cmf_mj.control.dcu.state import DcuSettings, load_dcu, make_dcu, resting
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import read_column, read_headed, read_table, write_parquet, write_table
from cmf_mj.core.settings import FileHeader, validated
from cmf_mj.facility.host.stream import HostStream, make_stream
from cmf_mj.machine.geometry import DOFS

_KINDS = ("", "_velocity", "_acceleration")
_SCHEMA_KEY = "cmf_mj_host"


class StreamHeader(FileHeader):
    """What the schema of a session's file holds."""

    frames: Annotated[int, Field(ge=0)]  #: Control frames of the run.
    start: Annotated[list[float], Field(min_length=6, max_length=6)]  #: Pose before.
    settings: dict[str, Any]  #: Of the DCU.


def read_stream(path: str | Path, *, derivatives: str = "spline") -> HostStream:
    """Read a stream from a CSV or Parquet file.

    Columns go by name in any order, others are ignored. `derivatives`, as in `make_stream`, says
    how to make them where the file has only poses.
    """
    source = Path(path)
    table = read_table(source)
    poses, first, second = (f"{DOFS[0]}{kind}" for kind in _KINDS)
    if (first in table.column_names) != (second in table.column_names):
        raise InputError(f"{source}: velocity and acceleration columns: give both or neither")
    time = read_column(source, table, "time")
    kinds = _KINDS if first in table.column_names else _KINDS[:1]
    motion, numbers = [_motion(source, table, kind) for kind in kinds], None
    if "sequence" in table.column_names:
        numbers = read_column(source, table, "sequence", pa.int64())
    try:
        return make_stream(time, *motion, sequence=numbers, derivatives=derivatives)
    except ValueError as error:
        raise InputError(f"{source}: {error}") from error


def _motion(source: Path, table: pa.Table, kind: str) -> NDArray[np.float64]:
    return np.column_stack([read_column(source, table, f"{dof}{kind}") for dof in DOFS])


def write_stream(stream: HostStream, path: str | Path) -> Path:
    """Write a stream as CSV or Parquet, by the name's end; it reads back bit for bit."""
    return write_table(_table(stream.sequence, stream.time, stream.values), Path(path))


@dataclass(frozen=True)
class HostSession:
    """Everything a DCU got in a run, good or bad, and all it takes to run it again."""

    arrivals: Arrivals  #: Frames with the control frame in which they reached the DCU.
    frames: int  #: Control frames of the run.
    start: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    """Pose the demand rested at before [m, rad], (6,)."""
    settings: DcuSettings = field(default_factory=load_dcu)  #: The DCU.

    def replay(self) -> NDArray[np.float64]:
        """The demand (frames, 3, 6) of the run, bit for bit."""
        compiled = make_dcu(self.settings)
        return upsample(compiled, resting(compiled, self.start), self.arrivals, self.frames)

    def save(self, path: str | Path) -> Path:
        """Write the session as Parquet; the file appears only when it is complete."""
        table = _table(self.arrivals.sequence, self.arrivals.time, self.arrivals.values)
        table = table.append_column("control_frame", pa.array(self.arrivals.frame))
        start = np.asarray(self.start, dtype=float).tolist()
        header = {"frames": self.frames, "start": start, "settings": self.settings.model_dump()}
        return write_parquet(table, Path(path), (_SCHEMA_KEY, header))

    @staticmethod
    def load(path: str | Path) -> "HostSession":
        """Read a session written by `save`; numbers come back bit for bit."""
        source = Path(path)
        table, header = read_headed(source, _SCHEMA_KEY, StreamHeader)
        frame, sequence = (
            read_column(source, table, name, pa.int64()) for name in ("control_frame", "sequence")
        )
        values = np.stack([_motion(source, table, kind) for kind in _KINDS], axis=1)
        time = read_column(source, table, "time")
        arrivals = Arrivals(frame, sequence, time, np.ascontiguousarray(values))
        settings = validated(DcuSettings, header.settings, f"{source}: settings")
        return HostSession(arrivals, header.frames, np.array(header.start), settings)


def _table(
    sequence: NDArray[np.int64], time: NDArray[np.float64], values: NDArray[np.float64]
) -> pa.Table:
    columns: dict[str, NDArray[Any]] = {"sequence": sequence, "time": time}
    names = [f"{dof}{kind}" for kind in _KINDS for dof in DOFS]
    rows = values.reshape(len(time), len(names))  # of a silent host none
    columns |= zip(names, np.ascontiguousarray(rows.T), strict=True)
    return pa.table({name: pa.array(column) for name, column in columns.items()})
