"""Live telemetry through washout and DCU to the cab, in real time.

80 times a second the newest sample goes through the washout, and its frame to the DCU. Samples that
are missing leave no gap in the frames: the last goes on at its slope s, by s T (1 - e^(-age / T)),
and from `_FADE[0]` on fades to rest until `_FADE[1]`; the washout brings the machine back. Without
a new sample for `_STALE` no frame is sent, and the host watchdog brings the machine down.
"""

import contextlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.host.handover import make_ring, put
from cmf_mj.facility.host.stream import HostFrame, make_stream
from cmf_mj.facility.host.udp import LOOPBACK, open_socket
from cmf_mj.facility.operation import serve
from cmf_mj.facility.session import Session
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing.washout import Washout
from cmf_mj.pilot.fly import RECORD_EVERY, FlightResult, flight_result
from cmf_mj.pilot.host import MOST_RATE
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.telemetry.check import check
from cmf_mj.pilot.telemetry.formats import Row, decode, listen
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters

_FADE = (0.1, 0.5)
"""Ages of the newest sample between which it fades to rest [s]."""

_AHEAD, _LEARN = 0.15, 0.03
"""T, and the time constant of the slope [s]."""

_STALE = 1.0
"""Age of the newest sample from which on nothing is sent [s]."""

_REST = np.array([0.0, 0.0, -STANDARD_GRAVITY, 0.0, 0.0, 0.0])
"""Specific force and angular rate at rest."""


class _Host:
    """Samples in, frames out, between parts of a session."""

    def __init__(self, form: str, port: int, bind: str, washout: Washout) -> None:
        self.ring, self.refused = make_ring(), 0
        self.rows: list[Row] = []
        self.frames: list[HostFrame] = []
        self._form, self._washout = form, washout
        self._row: Row | None = None
        self._came, self._steps = -math.inf, 0
        self._felt, self._slope = np.zeros(6), np.zeros(6)
        self.socket = open_socket(port, bind)
        self.socket.setblocking(False)

    def attend(self, session: Session) -> int:
        """Send a frame of the newest sample; the control frames until the next."""
        now, before = session.frame / session.rate, self._came
        with contextlib.suppress(OSError):  # nothing more has come
            for _ in range(64):
                try:
                    self._row = decode(self._form, self.socket.recv(65535))
                    self._came = now
                except InputError:
                    self.refused += 1
        if self._row is not None and now - self._came <= _STALE:
            if self._came > before:
                felt, since = np.array(self._row[1:7]), now - before
                if since < _STALE:
                    self._slope += (felt - self._felt - self._slope * since) / (since + _LEARN)
                self._felt = felt
            age = now - self._came
            felt = self._felt + self._slope * _AHEAD * (1.0 - math.exp(-age / _AHEAD))
            felt += (_REST - felt) * np.interp(age, _FADE, (0.0, 1.0))
            self.rows.append((self._row[0], *felt.tolist(), *self._row[7:]))
            self.frames.append(self._washout.frame(felt[:3], felt[3:]))
            put(self.ring, self.frames[-1])
        self._steps += 1
        return round(self._steps * session.rate / MOST_RATE) - session.frame


def fly_live(
    form: str,
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
    refused in the words of `check`. The others are those of `fly`, the `options` of `serve`.
    """
    telemetry, _ = listen(form, port, trial, bind=bind)
    if errors := check(telemetry).errors:
        raise InputError(f"{form} at port {port}: {'; '.join(errors)}")
    carried = load_cab(cab)
    host = _Host(form, port, bind, Washout(washout, station=carried.station))
    plant = Hexapod(carried, hydraulics)
    options |= {"attend": host.attend, "record_every": RECORD_EVERY}
    with host.socket:
        operation = serve(plant, law, host.ring, seconds, **options)
    if len(host.frames) < 2:
        raise InputError(f"{form} at port {port}: nothing came within {seconds:g} s")
    limits = load_motion_limits(options.get("limits"), carried.machine)
    _, times, *motion = (np.array(column) for column in zip(*host.frames, strict=True))
    table = np.array(host.rows)
    angles = np.unwrap(table[:, 7:10], axis=0)
    aircraft = PilotMotion(times, table[:, 1:4], table[:, 4:7], angles)
    return flight_result(plant, aircraft, make_stream(times, *motion), operation, limits)
