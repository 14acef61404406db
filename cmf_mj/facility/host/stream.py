"""Streams of host frames: how they are made, sent with errors of timing, doubted, read and written.

Derivatives of a stream of poses are those of the quintic spline through them (not-a-knot ends).
Its pieces are what the DCU puts between two frames, so that the demand is that spline. It looks
ahead and rings at jumps: take it for histories without; a host that steps sends zero derivatives.

In files streams, and what came of them in a run, are tables of the same columns, SI:

time                                           [s]
surge, sway, heave, roll, pitch, yaw           pose [m, rad], z down
surge_velocity ... yaw_velocity                [m/s, rad/s]      both or neither
surge_acceleration ... yaw_acceleration        [m/s^2, rad/s^2]
sequence                                       optional
control_frame                                  in which it came, of a run
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BPoly, make_interp_spline

from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.core import units
from cmf_mj.core.arrays import shaped
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.tables import read_column, read_table, write_parquet, write_table
from cmf_mj.core.units import RATE
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.signals.signal import LONGEST, Command, check_positive

DERIVATIVES = ("spline", "zero")
"""How velocity and acceleration are made: of the quintic spline, or none."""

SPLINE_FRAMES = 6  #: Frames that a quintic spline needs.

_STUTTER_PERIOD = 0.5  #: Time from stutter to stutter [s].


class HostFrame(NamedTuple):
    """One frame of the host."""

    sequence: int  #: Number, rising by one from frame to frame, 0 to 2^63 - 1.
    time: float  #: Host time [s], of any origin.
    pose: NDArray[np.float64]  #: Surge, sway, heave, roll, pitch, yaw [m, rad], z down, (6,).
    velocity: NDArray[np.float64]  #: First derivative of the pose [m/s, rad/s], Euler rates, (6,).
    acceleration: NDArray[np.float64]  #: Second derivative of the pose [m/s^2, rad/s^2], (6,).


class HostStream(NamedTuple):
    """Frames of a host in the order in which it sends them."""

    sequence: NDArray[np.int64]  #: Numbers, (N,).
    time: NDArray[np.float64]  #: Host times [s], (N,).
    pose: NDArray[np.float64]  #: Poses [m, rad], z down, (N, 6).
    velocity: NDArray[np.float64]  #: First derivatives of the poses [m/s, rad/s], (N, 6).
    acceleration: NDArray[np.float64]  #: Second derivatives of the poses [m/s^2, rad/s^2], (N, 6).

    @property
    def values(self) -> NDArray[np.float64]:
        """Pose, velocity and acceleration, (N, 3, 6)."""
        return np.stack([self.pose, self.velocity, self.acceleration], axis=1)

    def row(self, index: int) -> HostFrame:
        """One frame."""
        motion = self.pose[index], self.velocity[index], self.acceleration[index]
        return HostFrame(int(self.sequence[index]), float(self.time[index]), *motion)


def make_stream(
    time: ArrayLike,
    pose: ArrayLike,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    *,
    sequence: ArrayLike | None = None,
    derivatives: str = "spline",
) -> HostStream:
    """Build a stream from rising host times (N,) [s] and poses (N, 6) [m, rad], z down.

    Without velocity and acceleration (N, 6) both are made, by `spline` or `zero`. Sequence numbers
    (N,) rise; default 0, 1, 2 ...
    """
    stamps = shaped("time", time, None)
    count = stamps.size
    if not count:
        raise InputError("time: has no frames; give at least one")
    poses = shaped("pose", pose, count, len(DOFS))
    _refuse(np.diff(stamps, prepend=-np.inf) <= 0.0, "time", stamps, "above the frame before")
    if (velocity is None) != (acceleration is None):
        raise InputError("velocity, acceleration: give both or neither")
    if velocity is None or acceleration is None:
        velocities, accelerations = differentiate(stamps, poses, derivatives)
    else:
        velocities = shaped("velocity", velocity, *poses.shape)
        accelerations = shaped("acceleration", acceleration, *poses.shape)
    numbers = np.arange(count) if sequence is None else np.array(sequence)
    if numbers.shape != (count,) or numbers.dtype.kind != "i":
        raise InputError(f"sequence: {numbers.dtype} {numbers.shape}; allowed: integers ({count},)")
    _refuse(np.diff(numbers, prepend=-1) <= 0, "sequence", numbers, "above the frame before")
    return HostStream(numbers.astype(np.int64), stamps, poses, velocities, accelerations)


def differentiate(
    time: NDArray[np.float64], pose: NDArray[np.float64], derivatives: str = "spline"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Velocity and acceleration (N, 6) of poses (N, 6): of the quintic spline, or zero.

    On a uniform grid h the spline's error is of the order h^5 f^(6) in velocity and h^4 f^(6) in
    acceleration.
    """
    if check_name("derivatives", derivatives, DERIVATIVES) == "zero":
        return np.zeros_like(pose), np.zeros_like(pose)
    if time.size < SPLINE_FRAMES:
        raise InputError(f"pose: {time.size} frames; a spline needs at least {SPLINE_FRAMES}")
    elapsed = time - time[0]
    spline = make_interp_spline(elapsed, pose, k=5)
    return spline(elapsed, nu=1), spline(elapsed, nu=2)


def from_command(
    command: Command, rate: float = 80.0, *, derivatives: str = "spline"
) -> HostStream:
    """The stream of a host that means a command, at a rate of at most the command's own [Hz].

    `spline` samples the quintic spline through the command and its derivatives; `zero` takes the
    newest pose of the command and sends no derivatives (steps, pulses).
    """
    check_positive(rate=rate)
    if rate > command.rate:
        raise InputError(f"rate: {rate} Hz must be at most {command.rate} Hz")
    frames = command.pose.shape[0]
    command_time = np.arange(frames) / command.rate
    time = np.arange(int(np.floor(command_time[-1] * rate + 1e-9)) + 1) / rate
    if derivatives != "spline":
        newest = np.minimum(np.floor(time * command.rate + 1e-6).astype(int), frames - 1)
        return make_stream(time, command.pose[newest], derivatives=derivatives)
    if frames < SPLINE_FRAMES:
        raise InputError(f"command: {frames} frames; a spline needs at least {SPLINE_FRAMES}")
    spline = make_interp_spline(command_time, command.pose, k=5)
    return make_stream(time, spline(time), spline(time, nu=1), spline(time, nu=2))


def resample(stream: HostStream, rate: float) -> HostStream:
    """The same motion in frames at another rate: quintic Hermite between those of the stream."""
    check_positive(rate=rate)
    if stream.time.size < 2:
        raise InputError(f"stream: {stream.time.size} frames; resampling needs at least 2")
    start = float(stream.time[0])
    frames = (float(stream.time[-1]) - start) * rate
    if frames > LONGEST * RATE:
        text = f"{rate:g} Hz makes {frames:.3g} frames of a stream of {frames / rate:.6g} s"
        raise InputError(f"rate: {text}; allowed: at most {LONGEST * RATE:.3g}")
    curve = BPoly.from_derivatives(stream.time - start, stream.values)
    time = np.arange(int(np.floor((stream.time[-1] - start) * rate + 1e-9)) + 1) / rate
    return make_stream(time + start, curve(time), curve(time, nu=1), curve(time, nu=2))


class HostTiming(NamedTuple):
    """Errors of a host in sending frames at the times of their stamps; by default none."""

    speed: float = 1.0  #: Stamped time over real time, above 0.
    jitter: float = 0.0  #: Largest random delay of a frame [s].
    stutter: float = 0.0  #: Pause at the begin of every half second, made up for at its end [s].
    loss: float = 0.0  #: Share of frames that are lost, below 1.
    seed: int = 0  #: Of jitter and loss.

    def apply(self, stream: HostStream) -> tuple[HostStream, NDArray[np.float64]]:
        """The frames that are sent, and the times of sending from the first stamp on [s], (N,)."""
        bounds = {"speed": 10.0, "jitter": 1.0, "stutter": _STUTTER_PERIOD, "loss": 1.0}
        for name, high in bounds.items():
            value, low = getattr(self, name), 0.01 if name == "speed" else 0.0
            if not low <= value <= high or (name == "loss" and value == 1.0):
                raise InputError(f"{name}: {value} is refused; allowed: {low} to {high:g}")
        generator = np.random.default_rng(self.seed)
        times = (stream.time - stream.time[0]) / self.speed
        times = times + self.jitter * generator.uniform(size=times.size)
        times += np.maximum(self.stutter - times % _STUTTER_PERIOD, 0.0)
        is_sent = generator.uniform(size=times.size) >= self.loss
        is_sent[0] = True
        sent_stream = HostStream._make(column[is_sent] for column in stream)
        return sent_stream, np.maximum.accumulate(times)[is_sent]


def arrivals(
    stream: HostStream,
    *,
    delay: int = 0,
    rate: int = RATE,
    timing: HostTiming = HostTiming(),  # noqa: B008 (immutable)
) -> Arrivals:
    """The stream as it reaches a DCU at a control rate [Hz], the first after `delay` frames."""
    if delay < 0:
        raise InputError(f"delay: {delay} control frames must be at least 0")
    sent_stream, times = timing.apply(stream)
    frame = np.ceil(times * rate - 1e-6).astype(np.int64) + delay
    return Arrivals(frame, sent_stream.sequence, sent_stream.time, sent_stream.values)


def _refuse(is_bad: ArrayLike, name: str, values: NDArray[Any], allowed: str) -> None:
    if np.any(is_bad):
        index = int(np.argmax(is_bad))
        raise InputError(f"{name}: frame {index}: {values[index]} is refused; allowed: {allowed}")


LONGEST_INTERVAL = 0.25  #: Longest time between frames that a host can drive the DCU with [s].

_SHORTEST_INTERVAL = 1e-3  #: Shortest time that a host is likely to have between frames [s].

_TIME_UNITS = {"ms": 1e-3, "us": 1e-6}  #: Other units of time that hosts count in [s].


def unit_doubts(
    time: NDArray[np.float64], pose: NDArray[np.float64], machine: str | Machine = CMF
) -> list[str]:
    """One line for each quantity that would fit in another unit and does not in its own.

    Frames have times (N,) [s] and poses (N, 6) [m, rad]. A median interval beyond
    `LONGEST_INTERVAL` is doubted if it fits in ms or us; a pose beyond the machine's operational
    limit if it would be within that in inches or degrees.
    """
    doubts = []
    stamps = time[np.isfinite(time)]
    interval = float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0
    for unit, seconds in _TIME_UNITS.items():
        fits_unit = _SHORTEST_INTERVAL <= interval * seconds <= LONGEST_INTERVAL
        if interval > LONGEST_INTERVAL and fits_unit:
            doubts.append(
                f"time: {interval:g} s from frame to frame; host times are in s: is this {unit}?"
            )
    limits = np.abs(load_motion_limits(None, machine).operational).max(axis=1)
    for dof, values, limit in zip(DOFS, pose.T, limits, strict=True):
        largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
        unit = dof_unit(dof)
        if limit < largest and units.to_si(unit, largest) <= limit:
            si = "m" if unit == "in" else "rad"
            doubts.append(
                f"{dof}: up to {largest:g} {si}, beyond {limit:.3g} {si}; "
                f"poses are in m and rad: is this {unit}?"
            )
    return doubts


_NAME_ENDS = ("", "_velocity", "_acceleration")
_ARRIVAL_FRAME = "control_frame"  #: Column that sessions alone have.


def read_stream(path: str | Path, *, derivatives: str = "spline") -> HostStream:
    """Read a stream from a CSV or Parquet file.

    Columns go by name in any order, others are ignored. `derivatives`, as in `make_stream`, says
    how to make them where the file has only poses.
    """
    source = Path(path)
    table = read_table(source)
    has_velocities = "surge_velocity" in table.column_names
    if has_velocities != ("surge_acceleration" in table.column_names):
        raise InputError(f"{source}: velocity and acceleration columns: give both or neither")
    time = read_column(source, table, "time")
    ends = _NAME_ENDS if has_velocities else ("",)
    motion, numbers = [_motion(source, table, end) for end in ends], None
    if "sequence" in table.column_names:
        numbers = read_column(source, table, "sequence", pa.int64())
    try:
        return make_stream(time, *motion, sequence=numbers, derivatives=derivatives)
    except ValueError as error:
        raise InputError(f"{source}: {error}") from error


def _motion(source: Path, table: pa.Table, end: str) -> NDArray[np.float64]:
    return np.column_stack([read_column(source, table, f"{dof}{end}") for dof in DOFS])


def write_stream(stream: HostStream, path: str | Path) -> Path:
    """Write a stream as CSV or Parquet, by the name's end; it reads back bit for bit."""
    return write_table(_table(stream.sequence, stream.time, stream.values), Path(path))


def write_arrivals(frames: Arrivals, path: str | Path) -> Path:
    """Write what a DCU got in a run, good or bad, as Parquet; `operate` runs it again."""
    table = _table(frames.sequence, frames.time, frames.values)
    return write_parquet(table.append_column(_ARRIVAL_FRAME, pa.array(frames.frame)), Path(path))


def read_arrivals(path: str | Path) -> Arrivals:
    """Read what `write_arrivals` wrote; numbers come back bit for bit."""
    source = Path(path)
    table = read_table(source)
    frame = read_column(source, table, _ARRIVAL_FRAME, pa.int64())
    sequence = read_column(source, table, "sequence", pa.int64())
    values = np.stack([_motion(source, table, end) for end in _NAME_ENDS], axis=1)
    time = read_column(source, table, "time")
    return Arrivals(frame, sequence, time, np.ascontiguousarray(values))


def _table(
    sequence: NDArray[np.int64], time: NDArray[np.float64], values: NDArray[np.float64]
) -> pa.Table:
    columns: dict[str, NDArray[Any]] = {"sequence": sequence, "time": time}
    names = [f"{dof}{end}" for end in _NAME_ENDS for dof in DOFS]
    rows = values.reshape(len(time), len(names))  # of a silent host none
    columns |= zip(names, np.ascontiguousarray(rows.T), strict=True)
    return pa.table({name: pa.array(column) for name, column in columns.items()})
