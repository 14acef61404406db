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

import contextlib
import math
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.units import DEGREE, STANDARD_GRAVITY
from cmf_mj.facility.host.handover import make_ring, put
from cmf_mj.facility.host.stream import HostFrame, make_stream
from cmf_mj.facility.host.udp import LOOPBACK, open_socket
from cmf_mj.facility.operation import serve
from cmf_mj.facility.session import Session
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.flight import Flight, Origin, read_columns
from cmf_mj.pilot.fly import RECORD_EVERY, FlightResult, flight_result, law_delay
from cmf_mj.pilot.motion import COLUMNS, MOST_RATE, PilotMotion, gravity_in_body
from cmf_mj.pilot.telemetry_check import Telemetry, check_telemetry
from cmf_mj.pilot.washout import Washout
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters

_ROW, _BEAMNG = struct.Struct("<i8f"), struct.Struct("<4s21f")


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
    if data[:4] != b"DATA" or (len(data) - 5) % _ROW.size:
        raise InputError(f"xplane: {data[:5]!r} and {len(data)} octets are not a DATA datagram")
    rows = {row[0]: row[1:] for row in _ROW.iter_unpack(data[5:])}
    if 17 not in rows or 135 not in rows:
        raise InputError(f"xplane: rows {sorted(rows)}; allowed: 17 and 135 at least")
    right, up, back, *rates = rows[135][:6]
    pitch, roll, heading = (angle * DEGREE for angle in rows[17][:3])
    row = Row(math.nan, (-back, right, -up), tuple(rates), (roll, pitch, heading))
    if 21 not in rows:
        return row
    _, height, _, *velocity = rows[21][:6]
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
    when, fx, fy, fz, p, q, r, roll, pitch, yaw, *path = numbers
    return Row(when, (fx, fy, fz), (p, q, r), (roll, pitch, yaw), *path)


_DECODERS: dict[str, Callable[[bytes], Row]] = {"xplane": _xplane, "beamng": _beamng, "csv": _line}

FORMATS = tuple(_DECODERS)  #: Names of the formats.


def decode(source_format: str, data: bytes) -> Row:
    """A datagram's row; refused if of another format, infinite, or NaN but in time and path."""
    row = _DECODERS[check_name("source_format", source_format, FORMATS)](data)
    motion = (*row.specific_force, *row.angular_rate, *row.attitude)
    others = (row.time, row.speed, row.height)
    if not all(map(math.isfinite, motion)) or any(map(math.isinf, others)):
        raise InputError(f"{source_format}: {tuple(row)} is refused; allowed: finite numbers")
    return row


def telemetry_of(
    source_format: str, datagrams: Iterator[tuple[float, bytes]]
) -> tuple[Telemetry, int]:
    """All rows of timed datagrams, and how many datagrams were refused."""
    rows, refused = [], 0
    for at, data in datagrams:
        try:
            row = decode(source_format, data)
        except InputError:
            refused += 1
            continue
        rows.append(row._replace(time=at) if math.isnan(row.time) else row)
    if not rows:
        raise InputError(f"{source_format}: no datagram of this format, and {refused} others")
    return _as_telemetry(rows), refused


def _as_telemetry(rows: list[Row]) -> Telemetry:
    return Telemetry(*map(np.array, zip(*rows, strict=True)))


def listen(
    source_format: str, port: int, seconds: float, *, bind: str = LOOPBACK
) -> tuple[Telemetry, int]:
    """What comes to a UDP port within some seconds, and how many datagrams were refused."""

    def datagrams() -> Iterator[tuple[float, bytes]]:
        with open_socket(port, bind) as opened:
            start = time.monotonic()
            while (left := start + seconds - time.monotonic()) > 0.0:
                opened.settimeout(left)
                try:
                    yield time.monotonic() - start, opened.recv(65535)
                except TimeoutError:
                    return

    return telemetry_of(source_format, datagrams())


def read_telemetry(source: str | Path) -> Telemetry:
    """A table of telemetry as it is: a CSV file, or a flight by name or file.

    Speed along the path is the column `airspeed`, which is right in still air only.
    """
    _, columns, _ = read_columns(source)
    unknown = np.full(columns["time"].size, np.nan)
    motion = (np.column_stack([columns[n] for n in names]) for names in COLUMNS.values())
    path_of = (columns.get(name, unknown) for name in ("airspeed", "height"))
    return Telemetry(columns["time"], *motion, *path_of)


def flight_of(telemetry: Telemetry, source_format: str, title: str) -> Flight:
    """Telemetry as a flight at 80 Hz, from time 0, of an aircraft that nobody named."""
    angles, time = np.unwrap(telemetry.attitude, axis=0), telemetry.time - telemetry.time[0]
    motion = PilotMotion(time, telemetry.specific_force, telemetry.angular_rate, angles)
    return Flight(motion.resampled(MOST_RATE), Origin(title=title, source=source_format))


_FADE = (0.1, 0.5)  #: Ages of the newest sample between which it fades to rest [s].
_EXTRAPOLATION = 0.15  #: T, how long a slope counts [s].
_SLOPE_LAG = 0.03  #: Time constant of the slope [s].
_STALE = 1.0  #: Age of the newest sample from which on nothing is sent [s].
_REST = np.array([0.0, 0.0, -STANDARD_GRAVITY, 0.0, 0.0, 0.0])
"""Specific force and angular rate at rest."""


class _Host:
    """Turns telemetry into host frames, 80 a second, between parts of a session.

    f(age) = f + slope T (1 - exp(-age / T)) of the newest sample, faded to rest over `_FADE`, for
    specific force and angular rate alike. After a gap of `_STALE` the slope begins at 0.
    """

    def __init__(self, source_format: str, port: int, bind: str, washout: Washout) -> None:
        self.ring, self.refused = make_ring(), 0
        self.rows: list[Row] = []  #: What the washout got, one a frame: extrapolated and faded.
        self.frames: list[HostFrame] = []
        self._source_format, self._washout = source_format, washout
        self._row: Row | None = None
        self._came, self._steps = -math.inf, 0
        self._felt, self._slope = np.zeros(6), np.zeros(6)
        self.socket = open_socket(port, bind)
        self.socket.setblocking(False)

    def attend(self, session: Session) -> int:
        """Send a frame of the newest sample; returns the control frames until the next call."""
        now, before = session.frame / session.rate, self._came
        with contextlib.suppress(OSError):  # nothing more has come
            for _ in range(64):
                try:
                    self._row = decode(self._source_format, self.socket.recv(65535))
                    self._came = now
                except InputError:
                    self.refused += 1
        if (row := self._row) is not None and now - self._came <= _STALE:
            if self._came > before:
                felt, since = np.array([*row.specific_force, *row.angular_rate]), now - before
                if since < _STALE:
                    self._slope += (felt - self._felt - self._slope * since) / (since + _SLOPE_LAG)
                else:
                    self._slope[:] = 0.0
                self._felt = felt
            age, ahead = now - self._came, _EXTRAPOLATION
            felt = self._felt + self._slope * ahead * (1.0 - math.exp(-age / ahead))
            felt += (_REST - felt) * np.interp(age, _FADE, (0.0, 1.0))
            force, rate = felt.reshape(2, 3).tolist()
            self.rows.append(row._replace(specific_force=tuple(force), angular_rate=tuple(rate)))
            self.frames.append(self._washout.frame(felt[:3], felt[3:]))
            put(self.ring, self.frames[-1])
        self._steps += 1
        return round(self._steps * session.rate / MOST_RATE) - session.frame


def fly_live(
    source_format: str,
    port: int,
    law: str | Path | Law = "velocity",
    *,
    seconds: float,
    cab: str | Path | Cab | None = None,
    washout: str = "simona",
    bind: str = LOOPBACK,
    trial: float = 5.0,
    hydraulics: str | HydraulicParameters | None = None,
    **options: Any,
) -> FlightResult:
    """Fly what comes to a UDP port for some seconds.

    Before anything moves, what comes within the `trial` [s] is checked; an error that is found is
    refused in its words. Other arguments are as in `fly`; `options` go to `serve`. The
    result's `aircraft` is what the washout got, extrapolated and faded, at the times of the frames
    that were sent: a time without frames is left out.
    """
    telemetry, refused = listen(source_format, port, trial, bind=bind)
    if errors := check_telemetry(telemetry).errors:
        raise InputError(f"{source_format} at port {port}: {'; '.join(errors)}")
    carried = load_cab(cab)
    plant = Hexapod(carried, hydraulics)
    algorithm = Washout(washout, cab=carried, lead=law_delay(plant, law, washout))
    host = _Host(source_format, port, bind, algorithm)
    options |= {"attend": host.attend, "record_every": RECORD_EVERY}
    with host.socket:
        operation = serve(plant, law, host.ring, seconds, **options)
    if len(host.frames) < 2:
        raise InputError(f"{source_format} at port {port}: nothing came within {seconds:g} s")
    limits = load_motion_limits(options.get("limits"), carried.machine)
    _, times, *motion = (np.array(column) for column in zip(*host.frames, strict=True))
    felt = _as_telemetry(host.rows)
    angles = np.unwrap(felt.attitude, axis=0)
    aircraft = PilotMotion(times, felt.specific_force, felt.angular_rate, angles)
    ride = flight_result(plant, aircraft, make_stream(times, *motion), operation, limits)
    return ride._replace(plans=algorithm.plans, refused=refused + host.refused)
