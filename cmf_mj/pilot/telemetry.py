"""Formats of telemetry, each turned into specific force and rates at the seat, body axes z down.

xplane   UDP `DATA` and one octet, then rows `<i8f` of 36 octets, as ticked for the network in
         Data Output: 135 acc-x right, acc-y up, acc-z back [m/s^2] with gravity (acc-y is 9.81 at
         rest), P Q R [rad/s]; 17 pitch, roll, true heading [deg]; 21, if sent, height and velocity
beamng   UDP `<4s21f`, 88 octets, of MotionSim: BNG1, position, velocity in world axes z up,
         acceleration without gravity x right, y forward, z up, up vector, roll, pitch, yaw [rad],
         their rates and accelerations
csv      a file with the columns of a flight and their units; over UDP one line of numbers in SI:
         time, specific force (3), angular rate (3), roll, pitch, yaw [, speed, height]

What could not be verified is named in `docs/how_to/telemetry.md`. Datagrams have the time of their
arrival.
"""

import math
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.units import DEGREE
from cmf_mj.facility.host.port import LOOPBACK, open_socket
from cmf_mj.pilot.flight import Flight, Origin, read_columns
from cmf_mj.pilot.motion import COLUMNS, MOST_RATE, PilotMotion, gravity_in_body
from cmf_mj.pilot.telemetry_check import Telemetry

_XPLANE_ROW, _BEAMNG = struct.Struct("<i8f"), struct.Struct("<4s21f")
_ATTITUDE, _PATH, _ACCELERATION = 17, 21, 135  #: Numbers of the rows of X-Plane that are read.


class Row(NamedTuple):
    """What one datagram says, as a row of `Telemetry`."""

    time: float  #: [s]; NaN if it is that of the arrival.
    specific_force: tuple[float, ...]  #: [m/s^2], (3,).
    angular_rate: tuple[float, ...]  #: [rad/s], (3,).
    attitude: tuple[float, ...]  #: Roll, pitch, yaw [rad], (3,).
    speed: float = math.nan  #: Along the path [m/s]; NaN if unknown.
    height: float = math.nan  #: [m]; NaN if unknown.


def _xplane(data: bytes) -> Row:
    """Rows 17, 135 and perhaps 21 of a `DATA` datagram."""
    if data[:4] != b"DATA" or (len(data) - 5) % _XPLANE_ROW.size:
        raise InputError(f"xplane: {data[:5]!r} and {len(data)} octets are not a DATA datagram")
    rows = {row[0]: row[1:] for row in _XPLANE_ROW.iter_unpack(data[5:])}
    if _ATTITUDE not in rows or _ACCELERATION not in rows:
        raise InputError(f"xplane: rows {sorted(rows)}; allowed: 17 and 135 at least")
    right, up, back, *rates = rows[_ACCELERATION][:6]
    pitch, roll, heading = (angle * DEGREE for angle in rows[_ATTITUDE][:3])
    row = Row(math.nan, (-back, right, -up), tuple(rates), (roll, pitch, heading))
    if _PATH not in rows:
        return row
    _, height, _, *velocity = rows[_PATH][:6]
    return row._replace(speed=math.hypot(*velocity), height=height)


def _beamng(data: bytes) -> Row:
    """A datagram of MotionSim: seven vectors, of which up and angular acceleration are not used."""
    if len(data) != _BEAMNG.size or data[:4] != b"BNG1":
        raise InputError(f"beamng: {data[:4]!r} and {len(data)} octets; allowed: BNG1 and 88")
    vectors = np.reshape(_BEAMNG.unpack(data)[1:], (7, 3)).tolist()
    position, velocity, (right, forward, up), _, attitude, rates, _ = vectors
    force = np.array([forward, right, -up]) - gravity_in_body(np.array(attitude))
    motion = (tuple(force.tolist()), tuple(rates), tuple(attitude))
    return Row(math.nan, *motion, math.hypot(*velocity), position[2])


def _line(data: bytes) -> Row:
    """A line of 10 or 12 numbers in the order of `Row`."""
    try:
        numbers = tuple(float(part) for part in data.decode().split(","))
    except ValueError as error:
        raise InputError(f"csv: {data[:40]!r} is not a line of numbers") from error
    if len(numbers) not in (10, 12):
        raise InputError(f"csv: {len(numbers)} numbers; allowed: 10, or 12 with speed and height")
    stamp, fx, fy, fz, p, q, r, roll, pitch, yaw, *speed_and_height = numbers
    return Row(stamp, (fx, fy, fz), (p, q, r), (roll, pitch, yaw), *speed_and_height)


_DECODERS: dict[str, Callable[[bytes], Row]] = {"xplane": _xplane, "beamng": _beamng, "csv": _line}

FORMATS = tuple(_DECODERS)  #: Names of the formats.


def decode(source_format: str, data: bytes) -> Row:
    """A datagram's row; refused if of another format, infinite, or NaN but in time and path."""
    row = _DECODERS[check_name("source_format", source_format, FORMATS)](data)
    motion = (*row.specific_force, *row.angular_rate, *row.attitude)
    may_be_unknown = (row.time, row.speed, row.height)
    if not all(map(math.isfinite, motion)) or any(map(math.isinf, may_be_unknown)):
        raise InputError(f"{source_format}: {tuple(row)} is refused; allowed: finite numbers")
    return row


def telemetry_of(
    source_format: str, datagrams: Iterator[tuple[float, bytes]]
) -> tuple[Telemetry, int]:
    """All rows of timed datagrams, and how many datagrams were refused."""
    rows, refused = [], 0
    for arrival, data in datagrams:
        try:
            row = decode(source_format, data)
        except InputError:
            refused += 1
            continue
        rows.append(row._replace(time=arrival) if math.isnan(row.time) else row)
    if not rows:
        raise InputError(f"{source_format}: no datagram of this format, and {refused} others")
    return telemetry_of_rows(rows), refused


def telemetry_of_rows(rows: list[Row]) -> Telemetry:
    """Rows in the order of time as telemetry."""
    columns = {name: np.array([getattr(row, name) for row in rows]) for name in Row._fields}
    return Telemetry(**columns)


def listen(
    source_format: str, port: int, seconds: float, *, bind: str = LOOPBACK
) -> tuple[Telemetry, int]:
    """What comes to a UDP port within some seconds, and how many datagrams were refused."""

    def datagrams() -> Iterator[tuple[float, bytes]]:
        with open_socket(port, bind) as opened_socket:
            start = time.monotonic()
            while (remaining := start + seconds - time.monotonic()) > 0.0:
                opened_socket.settimeout(remaining)
                try:
                    yield time.monotonic() - start, opened_socket.recv(65535)
                except TimeoutError:
                    return

    return telemetry_of(source_format, datagrams())


def read_telemetry(source: str | Path) -> Telemetry:
    """A table of telemetry as it is: a CSV file, or a flight by name or file.

    Speed along the path is the column `airspeed`, which is right in still air only.
    """
    _, columns, _ = read_columns(source)
    unknown = np.full(columns["time"].size, np.nan)
    motion = {
        channel: np.column_stack([columns[name] for name in names])
        for channel, names in COLUMNS.items()
    }
    speed, height = columns.get("airspeed", unknown), columns.get("height", unknown)
    return Telemetry(columns["time"], **motion, speed=speed, height=height)


def flight_of(telemetry: Telemetry, source_format: str, title: str) -> Flight:
    """Telemetry as a flight at 80 Hz, from time 0, of an aircraft that nobody named."""
    angles, time = np.unwrap(telemetry.attitude, axis=0), telemetry.time - telemetry.time[0]
    motion = PilotMotion(time, telemetry.specific_force, telemetry.angular_rate, angles)
    return Flight(motion.resampled(MOST_RATE), Origin(title=title, source=source_format))
