"""Telemetry: golden packets built from the published structures, and errors put in on purpose."""

import math
import socket
import struct
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cmf_mj import InputError
from cmf_mj.facility.host.port import LOOPBACK
from cmf_mj.facility.host.stream import HostFrame
from cmf_mj.pilot.flight import flight_names, load_flight
from cmf_mj.pilot.live import LiveHost, fly_live
from cmf_mj.pilot.motion import gravity_in_body
from cmf_mj.pilot.telemetry import decode, flight_of, read_telemetry, telemetry_of
from cmf_mj.pilot.telemetry_check import Telemetry, check_telemetry

G, DEGREE = 9.80665, math.pi / 180.0


def xplane(
    acceleration: tuple[float, float, float],
    rates: tuple[float, ...] = (0.0, 0.0, 0.0),
    attitude: tuple[float, ...] = (0.0, 0.0, 0.0),
    path: tuple[float, ...] = (),
) -> bytes:
    """Rows 17 and 135: right, up, back with gravity; P Q R; pitch, roll, heading [deg]."""
    roll, pitch, yaw = (angle / DEGREE for angle in attitude)
    data = b"DATA*" + struct.pack("<i8f", 17, pitch, roll, yaw, yaw, 0, 0, 0, 0)
    data += struct.pack("<i8f", 135, *acceleration, *rates, 0, 0)
    if path:
        data += struct.pack("<i8f", 21, 0, path[1], 0, path[0], 0, 0, 0, 0)
    return data


def beamng(
    acceleration: tuple[float, float, float],
    rates: tuple[float, ...] = (0.0, 0.0, 0.0),
    attitude: tuple[float, ...] = (0.0, 0.0, 0.0),
    path: tuple[float, ...] = (0.0, 0.0),
) -> bytes:
    """Position, velocity, acceleration right, forward, up without gravity, up, angles, rates."""
    place, velocity = (0.0, 0.0, path[1]), (path[0], 0.0, 0.0)
    numbers = (*place, *velocity, *acceleration, 0.0, 0.0, 1.0, *attitude, *rates, 0.0, 0.0, 0.0)
    return struct.pack("<4s21f", b"BNG1", *numbers)


BRAKES, SPEED, TURN, UP = -4.0, 20.0, 0.2, 10.0 * DEGREE
"""Along x [m/s^2]; a flat turn to the right, v r to the right; nose up."""

STILL, LIFT, PUSH = (0.0, 0.0, 0.0), G * math.cos(UP), G * math.sin(UP)

GOLDEN = {
    "rest": ((0.0, G, 0.0), STILL, (0.0, 0.0, -G), STILL, STILL),
    "brakes": ((0.0, G, -BRAKES), (0.0, BRAKES, 0.0), (BRAKES, 0.0, -G), STILL, STILL),
    "right turn": (
        *((SPEED * TURN, G, 0.0), (SPEED * TURN, 0.0, 0.0), (0.0, SPEED * TURN, -G)),
        *((0.0, 0.0, TURN), STILL),
    ),
    "nose up": ((0.0, LIFT, -PUSH), STILL, (PUSH, 0.0, -LIFT), STILL, (0.0, UP, 0.0)),
}
"""Right, up, back with gravity as of X-Plane; right, forward, up without as of BeamNG; specific
force, angular rate and attitude of the body."""


@pytest.mark.parametrize("form", ["xplane", "beamng", "csv"])
@pytest.mark.parametrize("motion", list(GOLDEN))
def test_golden_packets_give_body_axes(motion: str, form: str) -> None:
    of_xplane, of_beamng, *body = GOLDEN[motion]
    _, rates, attitude = body
    sent = {
        "xplane": xplane(of_xplane, rates, attitude),
        "beamng": beamng(of_beamng, rates, attitude),
        "csv": ",".join(map(str, (1.5, *np.ravel(body)))).encode(),
    }
    np.testing.assert_allclose(decode(form, sent[form])[1:4], body, atol=2e-6)


@pytest.mark.parametrize(
    ("form", "data"),
    [
        ("xplane", b"DATA"),
        ("xplane", b"RREF*" + bytes(72)),
        ("xplane", b"DATA*" + struct.pack("<i8f", 17, *range(8))),
        ("xplane", xplane((0.0, math.nan, 0.0))),
        ("beamng", beamng((0.0, 0.0, 0.0))[:-1]),
        ("beamng", b"BNG2" + bytes(84)),
        ("beamng", beamng((math.inf, 0.0, 0.0))),
        ("csv", b"1,2,3"),
        ("csv", b"1,2,3,4,5,6,7,8,9,ten"),
        ("csv", b"\xff"),
        ("csv", b"inf,2,3,4,5,6,7,8,9,10"),
        ("csv", b"1,2,3,4,5,6,7,8,9,10,inf,12"),
        ("csv", b"1,2,3,4,5,6,7,8,9,10,nan,-inf"),
        ("beamng", beamng((0.0, 0.0, 0.0), path=(math.inf, 0.0))),
        ("xplane", xplane((0.0, G, 0.0), path=(1.0, math.inf))),
        ("form", b""),
    ],
)
def test_a_datagram_of_another_form_is_refused(form: str, data: bytes) -> None:
    with pytest.raises(InputError, match=form):
        decode(form, data)


def as_packets(name: str, form: str) -> list[tuple[float, bytes]]:
    """A shipped flight as another simulator would send it, in single precision."""
    sent = read_telemetry(name)
    packets = []
    for row in zip(*sent, strict=True):
        at, force, rates, attitude, *path = row
        if form == "xplane":
            x, y, z = force
            data = xplane((y, -z, -x), tuple(rates), tuple(attitude), tuple(path))
        else:
            x, y, z = force + gravity_in_body(attitude)
            wrapped = (*attitude[:2], math.remainder(attitude[2], 2 * math.pi))
            data = beamng((y, x, -z), tuple(rates), wrapped, tuple(path))
        packets.append((float(at), data))
    return packets


Spoil = Callable[[Telemetry], Telemetry]


def spoiled(channel: str, change: Callable[[Any], Any], attitude: float = 0.0) -> Spoil:
    """A channel changed, and so many times gravity in the attitude added to it."""

    def spoil(sent: Telemetry) -> Telemetry:
        values = change(getattr(sent, channel)) + attitude * gravity_in_body(sent.attitude)
        return sent._replace(**{channel: values})

    return spoil


_force, _rate, _angle = (
    partial(spoiled, name) for name in ("specific_force", "angular_rate", "attitude")
)


def _interrupted(sent: Telemetry) -> Telemetry:
    return Telemetry._make(np.delete(values, slice(800, 840), axis=0) for values in sent)


ERRORS: dict[str, tuple[Spoil, str]] = {
    "y and z": (_force(lambda f: f[:, [0, 2, 1]]), "force y and z are swapped"),
    "p and q": (_rate(lambda w: w[:, [1, 0, 2]]), "p and q are swapped"),
    "q and r": (_rate(lambda w: w[:, [0, 2, 1]]), "q and r are swapped"),
    "g": (_force(lambda f: f / G), "the specific force is in g, not in m/s^2"),
    "deg/s": (_rate(lambda w: w / DEGREE), "the angular rates are in deg/s"),
    "deg": (_angle(lambda e: e / DEGREE), "the angles are in deg, not in rad"),
    "no gravity": (_force(lambda f: f, 1.0), "gravity is left out"),
    "gravity twice": (_force(lambda f: f, -1.0), "gravity is in twice"),
    "z up": (_force(lambda f: f * [1, 1, -1]), "force z has the wrong sign"),
    "nose down": (_rate(lambda w: w * [1, -1, 1]), "rate q has the wrong sign"),
    "pitch": (_angle(lambda e: e * [1, -1, 1]), "angle of pitch has the wrong sign"),
    "gap": (_interrupted, "a gap of 0.512 s after 9.9875 s"),
}
"""Twelve errors, and words of what is said of each."""

EXCITED: dict[str, tuple[Spoil, str]] = {
    "x": (_force(lambda f: f * [-1, 1, 1]), "force x has the wrong sign"),
    "x and y": (_force(lambda f: f[:, [1, 0, 2]]), "force x and y are swapped"),
    "p": (_rate(lambda w: w * [-1, 1, 1]), "rate p has the wrong sign"),
    "roll": (_angle(lambda e: e * [-1, 1, 1]), "angle of roll has the wrong sign"),
    "yaw": (_angle(lambda e: e * [1, 1, -1]), "angle of yaw has the wrong sign"),
}
"""Errors that only some flights can show."""


@pytest.mark.parametrize("name", flight_names())
def test_each_error_is_found_and_none_in_the_clean_flight(name: str) -> None:
    sent = read_telemetry(name)
    assert check_telemetry(sent).errors == ()
    for error, (spoil, words) in ERRORS.items():
        said = check_telemetry(spoil(sent)).errors
        assert len(said) == 1 and words in said[0], (error, said)


def test_what_a_flight_cannot_show_is_said_and_the_rest_is_found() -> None:
    """Without a roll, for one, no sign of roll can be told; with it, it is."""
    shown = dict.fromkeys(EXCITED, 0)
    for name in flight_names():
        sent = read_telemetry(name)
        unseen = check_telemetry(sent).unseen
        for error, (spoil, words) in EXCITED.items():
            found = any(words in said for said in check_telemetry(spoil(sent)).errors)
            assert found == (not any(words in one for one in unseen)), (name, error)
            shown[error] += found
    assert min(shown.values()) >= 3


@pytest.mark.parametrize("form", ["xplane", "beamng"])
def test_flights_sent_as_packets_are_clean_and_come_back(form: str) -> None:
    for name in flight_names():
        received, refused = telemetry_of(form, iter(as_packets(name, form)))
        sent = read_telemetry(name)
        assert refused == 0 and check_telemetry(received).errors == ()
        flown = flight_of(received, form, name).motion
        np.testing.assert_allclose(flown.specific_force, sent.specific_force, atol=5e-5)
        np.testing.assert_allclose(flown.attitude[:, :2], sent.attitude[:, :2], atol=1e-6)


def test_without_speed_and_height_units_and_gravity_are_still_told() -> None:
    for name in ("engine_failure", "take_off", "turn"):
        unknown = np.full(read_telemetry(name).time.size, np.nan)
        sent = read_telemetry(name)._replace(speed=unknown, height=unknown)
        assert check_telemetry(sent).errors == ()
        for error in ("g", "deg/s", "deg", "no gravity", "gravity twice", "z up"):
            spoil, words = ERRORS[error]
            assert any(words in said for said in check_telemetry(spoil(sent)).errors), (name, error)


def test_times_that_do_not_rise_are_told() -> None:
    sent = read_telemetry("turn")
    back = sent.time.copy()
    back[100] = back[98]
    assert "time does not rise at row 100" in check_telemetry(sent._replace(time=back)).errors[0]
    assert check_telemetry(Telemetry._make(values[:40] for values in sent)).errors == (
        "less than 4 s of data",
    )


@pytest.mark.parametrize("name", ["turn", "take_off", "engine_failure"])
def test_a_clock_that_is_set_back_is_the_only_error(name: str) -> None:
    """What comes after is not joined to what was 12 s earlier."""
    sent = read_telemetry(name)
    back = sent.time - np.where(np.arange(sent.time.size) < 0.6 * sent.time.size, 0.0, 12.0)
    (error,) = check_telemetry(sent._replace(time=back)).errors
    assert "time does not rise at row" in error


@pytest.mark.parametrize(("unit", "size"), [("ms", 1e-3), ("us", 1e-6)])
def test_times_in_another_unit_are_told_and_nothing_else_is(unit: str, size: float) -> None:
    sent = read_telemetry("turn")
    told = f"time steps are {0.0125 / size:g} s: is time in {unit}?"
    assert check_telemetry(sent._replace(time=sent.time / size)).errors == (told,)
    gap = _interrupted(sent)
    (found, last) = check_telemetry(gap._replace(time=gap.time / size)).errors
    assert found == check_telemetry(gap).errors[0] and last == told


def test_forces_are_turned_by_the_attitude_of_their_own_time() -> None:
    """Pushed to and fro sideways in inertial space while rolling: nothing rises or falls."""
    time = np.arange(0.0, 20.0, 0.0125)
    roll, swing = 0.5 * np.cos(math.pi * time), 5.0 * np.sin(math.pi * time)
    zero, unknown = np.zeros_like(time), np.full_like(time, np.nan)
    attitude = np.column_stack([roll, zero, zero])
    pushed = np.column_stack([zero, swing * np.cos(roll), -swing * np.sin(roll)])
    rate = np.column_stack([-0.5 * math.pi * np.sin(math.pi * time), zero, zero])
    force = pushed - gravity_in_body(attitude)
    assert check_telemetry(Telemetry(time, force, rate, attitude, unknown, unknown)).errors == ()


def test_a_csv_with_units_is_read(tmp_path: Path) -> None:
    path = load_flight("turn").save(tmp_path / "turn.csv")
    received = read_telemetry(path)
    np.testing.assert_array_equal(received.specific_force, read_telemetry("turn").specific_force)
    path.write_text(path.read_text().replace("roll", "bank"))
    with pytest.raises(InputError, match="roll: column is missing"):
        read_telemetry(path)


def sending(packets: list[bytes], port: int) -> threading.Event:
    """Send packets at 80 Hz over and over until the event is set."""
    ended = threading.Event()

    def send() -> None:
        with socket.socket(type=socket.SOCK_DGRAM) as sender:
            start, number = time.monotonic(), 0
            while not ended.wait(max(start + number / 80 - time.monotonic(), 0.0)):
                sender.sendto(packets[number % len(packets)], ("127.0.0.1", port))
                number += 1

    threading.Thread(target=send, daemon=True).start()
    return ended


def free_port() -> int:
    with socket.socket(type=socket.SOCK_DGRAM) as tried:
        tried.bind(("127.0.0.1", 0))
        return int(tried.getsockname()[1])


def flown(port: int) -> Any:
    """A flight of 2 s; a stall of the test's own sender, refused as a gap, is tried again twice."""
    for _ in range(2):
        try:
            return fly_live("xplane", port, seconds=2.0, trial=4.5)
        except InputError as error:
            if "a gap of" not in str(error):
                raise
    return fly_live("xplane", port, seconds=2.0, trial=4.5)


def test_live_telemetry_drives_the_cab_and_bad_telemetry_does_not() -> None:
    """At rest with a brake that is pulled slowly and let go: real time, some seconds."""
    pulled = [1.0 - math.cos(2 * math.pi * k / 800) for k in range(800)]
    port = free_port()
    packets = [xplane((0.0, G, pull)) for pull in pulled]
    ended = sending(
        [packet for k in range(8) for packet in (*packets[100 * k :][:100], b"?")], port
    )
    try:
        ride = flown(port)
        assert ride.fault is None
        assert ride.stream.time.size > 100
        assert ride.operation.counts["accepted"] > 0
        assert ride.refused >= 3  # of 4.5 s and 2 s, one in 101
    finally:
        ended.set()
    port = free_port()
    ended = sending([xplane((0.0, 1.0, pull / G)) for pull in pulled], port)
    try:
        with pytest.raises(InputError, match="in g, not in m/s"):
            fly_live("xplane", port, seconds=2.0, trial=4.5)
    finally:
        ended.set()


def attended(arrivals: dict[int, float], steps: int) -> list[float]:
    """Force x that a live host makes, 80 steps a second, of rows of a force at some steps."""
    washout = SimpleNamespace(frame=lambda force, rate: HostFrame(0, 0.0, *np.zeros((3, 6))))
    host = LiveHost("csv", 0, LOOPBACK, washout)  # type: ignore[arg-type]
    made = []
    with host.socket, socket.socket(type=socket.SOCK_DGRAM) as sender:
        for step in range(steps):
            if step in arrivals:
                line = f"{step / 80},{arrivals[step]},0,{-G},0,0,0,0,0,0"
                sender.sendto(line.encode(), host.socket.getsockname())
            before = len(host.rows)
            host.attend(SimpleNamespace(frame=round(step * 25.6), rate=2048))  # type: ignore[arg-type]
            made += [row.specific_force[0] for row in host.rows[before:]]
    assert host.refused == 0
    return made


def test_after_a_gap_no_slope_is_left() -> None:
    """8 m/s^3 for 0.5 s, nothing for 2.5 s, then a force of 0: it stays 0."""
    rising = {step: 0.1 * step for step in range(40)}
    made = attended({**rising, 240: 0.0}, 248)
    assert made[38] == pytest.approx(3.8, abs=0.01) and len(made) < 140
    assert made[-8:] == [0.0] * 8


def test_a_slope_is_extrapolated_between_samples() -> None:
    """f + slope T (1 - exp(-age / T)) with T = 0.15 s, in the steps after the last sample."""
    made = attended({step: 0.1 * step for step in range(40)}, 44)
    ages = np.arange(1, 5) / 80.0
    np.testing.assert_allclose(made[-4:], 3.9 + 8.0 * 0.15 * (1 - np.exp(-ages / 0.15)), rtol=0.01)
