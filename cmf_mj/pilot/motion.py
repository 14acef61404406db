"""What a pilot is subjected to, in an aircraft or in the simulator.

Axes are body axes, x forward, y right, z down. Specific force is what an accelerometer reads,

    f = a - g,    a = dv/dt of the point against inertial space,    g = T^T (0, 0, 9.80665) m/s^2

with T of Eq 2.2 from body to inertial axes: level rest gives f = (0, 0, -9.80665), free fall 0. A
point at the lever arm r from another has

    a_p = a_cg + dw/dt x r + w x (w x r),    and since g is the same at both,
    f_p = f_cg + dw/dt x r + w x (w x r)

so that specific force and acceleration may be moved alike (`at_lever_arm`) but never mixed.
`PilotMotion` holds the specific force at the pilot's station, also that of a simulator's platform
or of a record of a run.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.arrays import shaped
from cmf_mj.core.compiled import allocating
from cmf_mj.core.errors import InputError
from cmf_mj.core.tables import write_table
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.host.stream import HostStream
from cmf_mj.machine.geometry import FLIP
from cmf_mj.record.record import Record

COLUMNS = {
    "specific_force": tuple(f"specific_force_{axis}" for axis in "xyz"),
    "angular_rate": tuple(f"angular_rate_{axis}" for axis in "xyz"),
    "attitude": ("roll", "pitch", "yaw"),
}
"""Names of the columns of each channel in files."""

MOST_RATE = 80.0  #: Most frames a second a host may send [Hz] (section 2.3.1).


@dataclass(frozen=True)
class PilotMotion:
    """Motion at a pilot's station; arrays are read-only."""

    time: NDArray[np.float64]  #: Sample times [s], rising, (N,).
    specific_force: NDArray[np.float64]
    """Acceleration less gravity at the pilot's station, body axes [m/s^2], (N, 3)."""
    angular_rate: NDArray[np.float64]
    """Angular velocity against inertial space, body axes [rad/s], (N, 3)."""
    attitude: NDArray[np.float64]  #: Roll, pitch, yaw [rad], (N, 3).

    def __post_init__(self) -> None:
        """Take copies and freeze them; shapes, unordered times and infinities are refused."""
        stamps = shaped("time", self.time, None)
        if not stamps.size:
            raise InputError("time: has no samples; give at least one")
        is_late = np.diff(stamps) <= 0.0
        if is_late.any():
            row = int(is_late.argmax()) + 1
            raise InputError(f"time: row {row}: {stamps[row]} s; allowed: above the row before")
        object.__setattr__(self, "time", stamps)
        for name in COLUMNS:
            object.__setattr__(self, name, shaped(name, getattr(self, name), stamps.size, 3))
        for name in ("time", *COLUMNS):
            getattr(self, name).setflags(write=False)

    @property
    def acceleration(self) -> NDArray[np.float64]:
        """Acceleration f + g of the station against inertial space, body axes [m/s^2], (N, 3)."""
        return self.specific_force + gravity_in_body(self.attitude)

    @property
    def rate(self) -> float:
        """Samples a second [Hz]; samples that are not evenly spaced are refused."""
        if self.time.size < 2:
            raise InputError(f"time: {self.time.size} samples have no rate; give at least 2")
        step = float(self.time[-1] - self.time[0]) / (self.time.size - 1)
        deviations = np.abs(np.diff(self.time) - step)
        if deviations.max() > 1e-6 * step + 4.0 * np.spacing(np.abs(self.time).max()):
            raise InputError(f"time: intervals differ from {step:.9g} s; resample the motion")
        return 1.0 / step

    def resampled(self, rate: float) -> "PilotMotion":
        """The same motion at another rate [Hz], straight between samples; yaw may not wrap."""
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError(f"rate: {rate} Hz must be greater than 0")
        span = self.time[-1] - self.time[0]
        time = self.time[0] + np.arange(int(np.floor(span * rate + 1e-9)) + 1) / rate
        channels = {name: interpolated(time, self.time, getattr(self, name)) for name in COLUMNS}
        return PilotMotion(time, **channels)

    @staticmethod
    def from_platform(stream: HostStream, station: ArrayLike) -> "PilotMotion":
        """The motion at a station on the simulator's platform that follows host frames exactly.

        The station, such as `Cab.station`, counts from the platform's centroid in platform axes,
        z down [m], (3,).
        """
        poses, velocities, accelerations = (
            np.ascontiguousarray(values)
            for values in (stream.pose, stream.velocity, stream.acceleration)
        )
        omega, alpha, centroid_acceleration = (np.empty((len(poses), 3)) for _ in range(3))
        _platform_motion(poses, velocities, accelerations, omega, alpha, centroid_acceleration)
        centroid_force = centroid_acceleration - gravity_in_body(poses[:, 3:])
        force = centroid_force + at_lever_arm(omega, alpha, station)
        return PilotMotion(stream.time, force, omega, poses[:, 3:])

    @staticmethod
    def from_record(record: Record) -> "PilotMotion":
        """What the crew felt in a run: MuJoCo's crew accelerometer and gyro, turned z down.

        The accelerometer of an instant stands in the record one mechanical step after it, so the
        motion is stamped that much earlier; gyro and attitude are interpolated to these times.
        """
        force, gyro = record["crew_accelerometer"] * FLIP, record["platform_gyro"] * FLIP
        attitude = record["platform_pose"][:, 3:]
        if record.time.size < 2:
            raise InputError(f"record: {record.time.size} rows; at least 2 are needed")
        time = record.time[1:] - float(record.metadata["mechanical_step"])
        gyro, attitude = (interpolated(time, record.time, values) for values in (gyro, attitude))
        return PilotMotion(time, force[1:], gyro, attitude)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Time and each axis of each channel by the names of `COLUMNS`, in SI, (N,) each."""
        columns = {"time": self.time}
        for channel, names in COLUMNS.items():
            columns |= zip(names, np.ascontiguousarray(getattr(self, channel).T), strict=True)
        return columns

    def save(self, path: str | Path) -> Path:
        """Write `columns` as CSV or Parquet, by the name's end; `load_flight` reads it."""
        return write_table(pa.table(self.columns()), Path(path))


def gravity_in_body(attitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gravity g = T^T (0, 0, 9.80665) of attitudes (..., 3) [rad], body axes [m/s^2], (..., 3)."""
    roll, pitch = attitude[..., 0], attitude[..., 1]
    axes = (-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch))
    return STANDARD_GRAVITY * np.stack(axes, axis=-1)


def at_lever_arm(
    angular_rate: NDArray[np.float64],
    angular_acceleration: NDArray[np.float64],
    lever_arm: ArrayLike,
) -> NDArray[np.float64]:
    """dw/dt x r + w x (w x r) of rates and their derivatives (N, 3), body axes [m/s^2], (N, 3)."""
    arm = shaped("lever_arm", lever_arm, 3)
    centripetal = np.cross(angular_rate, np.cross(angular_rate, arm))
    return np.asarray(np.cross(angular_acceleration, arm) + centripetal)


@allocating
def body_rates(angles, rates, accelerations, omega, alpha):  # type: ignore[no-untyped-def]
    """Write angular velocity and acceleration in body axes of a motion in Euler angles.

    p = R' - Y' sin P,  q = P' cos R + Y' sin R cos P,  r = -P' sin R + Y' cos R cos P

    with R, P, Y roll, pitch, yaw; all vectors (3,).
    """
    cos_roll, sin_roll = np.cos(angles[0]), np.sin(angles[0])
    cos_pitch, sin_pitch = np.cos(angles[1]), np.sin(angles[1])
    roll_rate, pitch_rate, yaw_rate = rates[0], rates[1], rates[2]
    omega[0] = roll_rate - yaw_rate * sin_pitch
    omega[1] = pitch_rate * cos_roll + yaw_rate * sin_roll * cos_pitch
    omega[2] = -pitch_rate * sin_roll + yaw_rate * cos_roll * cos_pitch
    alpha[0] = accelerations[0] - accelerations[2] * sin_pitch - yaw_rate * pitch_rate * cos_pitch
    alpha[1] = accelerations[1] * cos_roll + accelerations[2] * sin_roll * cos_pitch
    sine_slope = roll_rate * cos_roll * cos_pitch - pitch_rate * sin_roll * sin_pitch
    alpha[1] += -pitch_rate * roll_rate * sin_roll + yaw_rate * sine_slope
    alpha[2] = -accelerations[1] * sin_roll + accelerations[2] * cos_roll * cos_pitch
    cosine_fall = roll_rate * sin_roll * cos_pitch + pitch_rate * cos_roll * sin_pitch
    alpha[2] += -pitch_rate * roll_rate * cos_roll - yaw_rate * cosine_fall


@allocating
def turn_to_body(angles, vector, out):  # type: ignore[no-untyped-def]
    """Write T^T v: a vector (3,) of inertial axes in body axes."""
    cos_roll, sin_roll = np.cos(angles[0]), np.sin(angles[0])
    cos_pitch, sin_pitch = np.cos(angles[1]), np.sin(angles[1])
    cos_yaw, sin_yaw = np.cos(angles[2]), np.sin(angles[2])
    x, y = cos_yaw * vector[0] + sin_yaw * vector[1], -sin_yaw * vector[0] + cos_yaw * vector[1]
    x, z = cos_pitch * x - sin_pitch * vector[2], sin_pitch * x + cos_pitch * vector[2]
    out[0], out[1], out[2] = x, cos_roll * y + sin_roll * z, -sin_roll * y + cos_roll * z


@allocating
def _platform_motion(poses, rates, accelerations, omega, alpha, centroid_acceleration):  # type: ignore[no-untyped-def]
    for row in range(poses.shape[0]):
        angles = poses[row, 3:]
        body_rates(angles, rates[row, 3:], accelerations[row, 3:], omega[row], alpha[row])
        turn_to_body(angles, accelerations[row, :3], centroid_acceleration[row])


def interpolated(
    new_time: NDArray[np.float64], time: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Columns of `values` (N, n) on straight lines between their times, at new ones, (K, n)."""
    return np.column_stack([np.interp(new_time, time, column) for column in values.T])
