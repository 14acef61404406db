"""What a pilot is subjected to, in an aircraft or in the simulator.

Axes are body axes, x forward, y right, z down. Specific force is what an accelerometer reads,

    f = a - g,    a = dv/dt of the point against inertial space,    g = T^T (0, 0, 9.80665) m/s^2

with T of Eq 2.2 from body to inertial axes: level rest gives f = (0, 0, -9.80665), free fall 0. A
point at the lever arm r from another has

    a_p = a_cg + dw/dt x r + w x (w x r),    and since g is the same at both,
    f_p = f_cg + dw/dt x r + w x (w x r)

so that specific force and acceleration may be moved alike but never mixed. `PilotMotion` holds the
specific force at the pilot's station; its constructors take the centre of gravity of an aircraft,
the platform of the simulator or a record of a run.
"""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import read_column, read_table, write_table
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine import models
from cmf_mj.machine.kinematics import FLIP
from cmf_mj.record.record import Record

AXES = ("x", "y", "z")
"""Body axes: forward, right, down."""

ANGLES = ("roll", "pitch", "yaw")
"""Euler angles, turned in the order yaw, pitch, roll."""

COLUMNS = {
    "specific_force": tuple(f"specific_force_{axis}" for axis in AXES),
    "angular_rate": tuple(f"angular_rate_{axis}" for axis in AXES),
    "attitude": ANGLES,
}
"""Names of the columns of each channel in files."""


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
        """Take copies, check them and freeze them.

        Raises:
            InputError: a shape, an order in time or a number that is not finite, named.
        """
        stamps = np.array(self.time, dtype=float)
        if stamps.ndim != 1 or stamps.size < 1:
            raise InputError(f"time: shape is {stamps.shape}; allowed: (N,)")
        _finite("time", stamps)
        late = np.diff(stamps) <= 0.0
        if late.any():
            row = int(late.argmax()) + 1
            raise InputError(f"time: row {row}: {stamps[row]} s; allowed: above the row before")
        object.__setattr__(self, "time", stamps)
        for name in COLUMNS:
            object.__setattr__(self, name, _rows(name, getattr(self, name), stamps.size))
        for name in ("time", *COLUMNS):
            getattr(self, name).setflags(write=False)

    @property
    def acceleration(self) -> NDArray[np.float64]:
        """Acceleration f + g of the station against inertial space, body axes [m/s^2], (N, 3)."""
        return self.specific_force + gravity_in_body(self.attitude)

    @property
    def rate(self) -> float:
        """Samples a second [Hz].

        Raises:
            InputError: the samples are not evenly spaced.
        """
        if self.time.size < 2:
            raise InputError(f"time: {self.time.size} samples have no rate; give at least 2")
        step = float(self.time[-1] - self.time[0]) / (self.time.size - 1)
        off = np.abs(np.diff(self.time) - step)
        if off.max() > 1e-6 * step + 4.0 * np.spacing(np.abs(self.time).max()):
            raise InputError(f"time: intervals differ from {step:.9g} s; resample the motion")
        return 1.0 / step

    def resampled(self, rate: float) -> "PilotMotion":
        """The same motion at another rate, straight lines between samples; yaw may not wrap.

        Raises:
            InputError: the rate is not above 0.
        """
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError(f"rate: {rate} Hz must be greater than 0")
        span = self.time[-1] - self.time[0]
        time = self.time[0] + np.arange(int(np.floor(span * rate + 1e-9)) + 1) / rate
        return PilotMotion(
            time, *(_interpolated(time, self.time, getattr(self, name)) for name in COLUMNS)
        )

    @staticmethod
    def from_centre_of_gravity(
        time: ArrayLike,
        *,
        angular_rate: ArrayLike,
        angular_acceleration: ArrayLike,
        attitude: ArrayLike,
        lever_arm: ArrayLike,
        specific_force: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
    ) -> "PilotMotion":
        """The motion at a station of a rigid aircraft, from that of its centre of gravity.

        Args:
            time: sample times [s], (N,).
            angular_rate: body axes [rad/s], (N, 3).
            angular_acceleration: its derivative, body axes [rad/s^2], (N, 3).
            attitude: roll, pitch, yaw [rad], (N, 3).
            lever_arm: from the centre of gravity to the station, body axes [m], (3,).
            specific_force: of the centre of gravity, body axes [m/s^2], (N, 3).
            acceleration: instead, of the centre of gravity against inertial space, body axes
                [m/s^2], (N, 3).

        Raises:
            InputError: shapes, or not exactly one of specific force and acceleration.
        """
        if (specific_force is None) == (acceleration is None):
            raise InputError("specific_force, acceleration: give exactly one of them")
        count = np.size(time)
        turned = _rows("attitude", attitude, count)
        if specific_force is not None:
            force = _rows("specific_force", specific_force, count)
        else:
            assert acceleration is not None
            force = _rows("acceleration", acceleration, count) - gravity_in_body(turned)
        rates = _rows("angular_rate", angular_rate, count)
        accelerations = _rows("angular_acceleration", angular_acceleration, count)
        moved = force + at_lever_arm(rates, accelerations, lever_arm)
        return PilotMotion(np.asarray(time, dtype=float), moved, rates, turned)

    @staticmethod
    def from_platform(
        time: ArrayLike,
        pose: ArrayLike,
        velocity: ArrayLike,
        acceleration: ArrayLike,
        station: ArrayLike,
    ) -> "PilotMotion":
        """The motion at a station on the simulator's platform.

        Args:
            time: sample times [s], (N,).
            pose: surge, sway, heave [m], roll, pitch, yaw [rad], z down, (N, 6).
            velocity: first derivative of the pose, Euler rates, (N, 6).
            acceleration: second derivative of the pose, (N, 6).
            station: from the platform's centroid, platform axes [m], (3,); `pilot_station`.

        Raises:
            InputError: shapes or numbers that are refused, named.
        """
        count = np.size(time)
        poses = _rows("pose", pose, count, 6)
        rates = _rows("velocity", velocity, count, 6)
        changes = _rows("acceleration", acceleration, count, 6)
        omega, alpha = np.empty((count, 3)), np.empty((count, 3))
        force = np.empty((count, 3))
        _platform_motion(poses, rates, changes, omega, alpha, force)
        force -= gravity_in_body(poses[:, 3:])
        force += at_lever_arm(omega, alpha, station)
        return PilotMotion(np.asarray(time, dtype=float), force, omega, poses[:, 3:])

    @staticmethod
    def from_record(record: Record) -> "PilotMotion":
        """What the crew felt in a run: MuJoCo's crew accelerometer and gyro, turned z down.

        The accelerometer of an instant stands in the record one mechanical step after it, so the
        motion is stamped that much earlier; gyro and attitude are interpolated to these times.

        Args:
            record: of a hexapod, by `simulate`, `operate` or `serve`.

        Raises:
            InputError: a channel is missing, or there are fewer than two rows.
        """
        force, gyro = record["crew_accelerometer"] * FLIP, record["platform_gyro"] * FLIP
        attitude = record["platform_pose"][:, 3:]
        if record.time.size < 2:
            raise InputError(f"record: {record.time.size} rows; at least 2 are needed")
        time = record.time[1:] - float(record.metadata["mechanical_step"])
        at = [_interpolated(time, record.time, values) for values in (gyro, attitude)]
        return PilotMotion(time, force[1:], *at)

    def save(self, path: str | Path) -> Path:
        """Write as CSV or Parquet, by the name's end; it reads back bit for bit.

        Columns: time, specific_force_x ..., angular_rate_x ..., roll, pitch, yaw, in SI.

        Raises:
            InputError: the name ends in neither.
        """
        columns = {"time": self.time}
        for name, titles in COLUMNS.items():
            columns |= dict(zip(titles, getattr(self, name).T, strict=True))
        table = pa.table({name: np.ascontiguousarray(v) for name, v in columns.items()})
        return write_table(table, Path(path))

    @staticmethod
    def load(path: str | Path) -> "PilotMotion":
        """Read what `save` wrote, or any CSV or Parquet table with its columns.

        Raises:
            InputError: file, column or number that cannot be taken, named.
        """
        source = Path(path)
        table = read_table(source)
        parts = [
            np.column_stack([read_column(source, table, title) for title in titles])
            for titles in COLUMNS.values()
        ]
        try:
            return PilotMotion(read_column(source, table, "time"), *parts)
        except ValueError as error:
            raise InputError(f"{source}: {error}") from error


def pilot_station(cab: str = "gfd") -> NDArray[np.float64]:
    """Site `crew` of a cab from the platform's centroid, platform axes, z down [m], (3,).

    Raises:
        InputError: unknown cab.
    """
    root = ElementTree.parse(models.cab_path(cab)).getroot()
    site = next(element for element in root.iter("site") if element.get("name") == "crew")
    return np.array(site.get("pos", "0 0 0").split(), dtype=float) * FLIP


def gravity_in_body(attitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gravity g = T^T (0, 0, 9.80665) of attitudes (..., 3) [rad], body axes [m/s^2], (..., 3)."""
    roll, pitch = attitude[..., 0], attitude[..., 1]
    parts = (-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch))
    return STANDARD_GRAVITY * np.stack(parts, axis=-1)


def at_lever_arm(
    angular_rate: NDArray[np.float64],
    angular_acceleration: NDArray[np.float64],
    lever_arm: ArrayLike,
) -> NDArray[np.float64]:
    """dw/dt x r + w x (w x r), body axes [m/s^2], (N, 3).

    Args:
        angular_rate: w [rad/s], (N, 3).
        angular_acceleration: dw/dt [rad/s^2], (N, 3).
        lever_arm: r [m], (3,).

    Raises:
        InputError: the lever arm is not three finite numbers.
    """
    arm = np.asarray(lever_arm, dtype=float)
    if arm.shape != (3,) or not np.isfinite(arm).all():
        raise InputError(f"lever_arm: {arm} is refused; allowed: three finite numbers [m]")
    inward = np.cross(angular_rate, np.cross(angular_rate, arm))
    return np.asarray(np.cross(angular_acceleration, arm) + inward)


@compiled
def body_rates(angles, rates, accelerations, omega, alpha):  # type: ignore[no-untyped-def]
    """Write angular velocity and acceleration in body axes of a motion in Euler angles.

    p = R' - Y' sin P,  q = P' cos R + Y' sin R cos P,  r = -P' sin R + Y' cos R cos P

    Args:
        angles: R, P, Y: roll, pitch, yaw [rad], (3,).
        rates: their first derivatives [rad/s], (3,).
        accelerations: their second derivatives [rad/s^2], (3,).
        omega: (3,) overwritten [rad/s].
        alpha: (3,) overwritten [rad/s^2].
    """
    cr, sr = np.cos(angles[0]), np.sin(angles[0])
    cp, sp = np.cos(angles[1]), np.sin(angles[1])
    roll, pitch, yaw = rates[0], rates[1], rates[2]
    omega[0] = roll - yaw * sp
    omega[1] = pitch * cr + yaw * sr * cp
    omega[2] = -pitch * sr + yaw * cr * cp
    alpha[0] = accelerations[0] - accelerations[2] * sp - yaw * pitch * cp
    alpha[1] = accelerations[1] * cr + accelerations[2] * sr * cp
    alpha[1] += -pitch * roll * sr + yaw * (roll * cr * cp - pitch * sr * sp)
    alpha[2] = -accelerations[1] * sr + accelerations[2] * cr * cp
    alpha[2] += -pitch * roll * cr - yaw * (roll * sr * cp + pitch * cr * sp)


@compiled
def turn_to_body(angles, vector, out):  # type: ignore[no-untyped-def]
    """Write T^T v: a vector (3,) of inertial axes in body axes."""
    cr, sr = np.cos(angles[0]), np.sin(angles[0])
    cp, sp = np.cos(angles[1]), np.sin(angles[1])
    cy, sy = np.cos(angles[2]), np.sin(angles[2])
    x, y, z = cy * vector[0] + sy * vector[1], -sy * vector[0] + cy * vector[1], vector[2]
    x, z = cp * x - sp * z, sp * x + cp * z
    out[0], out[1], out[2] = x, cr * y + sr * z, -sr * y + cr * z


@compiled
def _platform_motion(poses, rates, accelerations, omega, alpha, centroid):  # type: ignore[no-untyped-def]
    for row in range(poses.shape[0]):
        angles = poses[row, 3:]
        body_rates(angles, rates[row, 3:], accelerations[row, 3:], omega[row], alpha[row])
        turn_to_body(angles, accelerations[row, :3], centroid[row])


def _interpolated(
    at: NDArray[np.float64], time: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.column_stack([np.interp(at, time, column) for column in values.T])


def _finite(name: str, values: NDArray[np.float64]) -> None:
    bad = ~np.isfinite(values.reshape(values.shape[0], -1)).all(axis=1)
    if bad.any():
        row = int(bad.argmax())
        raise InputError(f"{name}: row {row}: {values[row]} is refused; allowed: finite numbers")


def _rows(name: str, values: ArrayLike, count: int, width: int = 3) -> NDArray[np.float64]:
    array = np.array(values, dtype=float, order="C")
    if array.shape != (count, width):
        raise InputError(f"{name}: shape is {array.shape}; allowed: ({count}, {width})")
    _finite(name, array)
    return array
