"""Live telemetry flown in the cab: samples of a UDP port become host frames, 80 a second.

Between samples specific force and angular rate go on along their slope, low-passed, and fade to
rest over `_FADE`,

    f(age) = f + slope T (1 - exp(-age / T))    of the newest sample

After a gap of `_STALE` the slope begins at 0; while the newest sample is older, nothing is sent.
"""

import contextlib
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.host.handover import make_ring, put
from cmf_mj.facility.host.port import LOOPBACK, open_socket
from cmf_mj.facility.host.stream import HostFrame, make_stream
from cmf_mj.facility.operation import serve
from cmf_mj.facility.session import Session
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.fly import RECORD_EVERY, FlightResult, flight_result, law_delay
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion
from cmf_mj.pilot.telemetry import Row, decode, listen, telemetry_of_rows
from cmf_mj.pilot.telemetry_check import check_telemetry
from cmf_mj.pilot.washout import Washout
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters

_FADE = (0.1, 0.5)  #: Ages of the newest sample between which it fades to rest [s].
_EXTRAPOLATION = 0.15  #: T, how long a slope counts [s].
_SLOPE_LAG = 0.03  #: Time constant of the slope [s].
_STALE = 1.0  #: Age of the newest sample from which on nothing is sent [s].
_DATAGRAMS = 64  #: Most that are read for a frame.
_REST = np.array([0.0, 0.0, -STANDARD_GRAVITY, 0.0, 0.0, 0.0])
"""Specific force and angular rate at rest."""


class LiveHost:
    """Turns telemetry into host frames between parts of a session."""

    def __init__(self, source_format: str, port: int, bind: str, washout: Washout) -> None:
        """Listen to a port; telemetry comes in a format of `telemetry.FORMATS`."""
        self.ring, self.refused = make_ring(), 0
        self.rows: list[Row] = []  #: What the washout got, one a frame: extrapolated and faded.
        self.frames: list[HostFrame] = []
        self._source_format, self._washout = source_format, washout
        self._newest_row: Row | None = None  #: The newest sample.
        self._newest_arrival, self._call_count = -math.inf, 0
        self._motion, self._slope = np.zeros(6), np.zeros(6)  # force and rate of the newest sample
        self.socket = open_socket(port, bind)
        self.socket.setblocking(False)

    def attend(self, session: Session) -> int:
        """Send a frame of the newest sample; returns the control frames until the next call."""
        now, last_arrival = session.frame / session.rate, self._newest_arrival
        self._receive(now)
        if self._newest_row is not None and now - self._newest_arrival <= _STALE:
            if self._newest_arrival > last_arrival:
                self._follow_slope(self._newest_row, now - last_arrival)
            self._send(self._newest_row, self._extrapolated(now - self._newest_arrival))
        self._call_count += 1
        return round(self._call_count * session.rate / MOST_RATE) - session.frame

    def _receive(self, now: float) -> None:
        """Read what has come; the newest sample counts."""
        with contextlib.suppress(OSError):  # nothing more has come
            for _ in range(_DATAGRAMS):
                try:
                    self._newest_row = decode(self._source_format, self.socket.recv(65535))
                    self._newest_arrival = now
                except InputError:
                    self.refused += 1

    def _follow_slope(self, row: Row, gap: float) -> None:
        """Take a sample in, that came `gap` [s] after the one before."""
        motion = np.array([*row.specific_force, *row.angular_rate])
        if gap < _STALE:
            self._slope += (motion - self._motion - self._slope * gap) / (gap + _SLOPE_LAG)
        else:
            self._slope[:] = 0.0
        self._motion = motion

    def _extrapolated(self, age: float) -> NDArray[np.float64]:
        """Specific force and angular rate at an age [s] of the newest sample, (6,)."""
        duration = _EXTRAPOLATION
        seat_motion = self._motion + self._slope * duration * (1.0 - math.exp(-age / duration))
        return np.asarray(seat_motion + (_REST - seat_motion) * np.interp(age, _FADE, (0.0, 1.0)))

    def _send(self, row: Row, seat_motion: NDArray[np.float64]) -> None:
        """Send a frame of a specific force and an angular rate, (6,)."""
        force, rate = seat_motion.reshape(2, 3).tolist()
        self.rows.append(row._replace(specific_force=tuple(force), angular_rate=tuple(rate)))
        self.frames.append(self._washout.frame(seat_motion[:3], seat_motion[3:]))
        put(self.ring, self.frames[-1])


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
    loaded_cab = load_cab(cab)
    plant = Hexapod(loaded_cab, hydraulics)
    algorithm = Washout(washout, cab=loaded_cab, lead=law_delay(plant, law, washout))
    host = LiveHost(source_format, port, bind, algorithm)
    options |= {"attend": host.attend, "record_every": RECORD_EVERY}
    with host.socket:
        operation = serve(plant, law, host.ring, seconds, **options)
    if len(host.frames) < 2:
        raise InputError(f"{source_format} at port {port}: nothing came within {seconds:g} s")
    limits = load_motion_limits(options.get("limits"), loaded_cab.machine)
    time, pose, velocity, acceleration = (
        np.array([getattr(frame, name) for frame in host.frames])
        for name in ("time", "pose", "velocity", "acceleration")
    )
    inputs = telemetry_of_rows(host.rows)
    angles = np.unwrap(inputs.attitude, axis=0)
    aircraft = PilotMotion(time, inputs.specific_force, inputs.angular_rate, angles)
    stream = make_stream(time, pose, velocity, acceleration)
    result = flight_result(plant, aircraft, stream, operation, limits)
    return result._replace(plans=algorithm.plans, refused=refused + host.refused)
