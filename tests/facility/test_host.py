"""Host streams, files, datagrams and sockets: what is sent arrives, bit for bit, or is counted."""

import runpy
import socket
import struct
import threading
import time as clock
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline
from shared import cmf

from cmf_mj import signals
from cmf_mj.control.dcu.play import Arrivals, upsample
from cmf_mj.control.dcu.state import make_dcu, resting
from cmf_mj.core.compiled import allocating
from cmf_mj.core.errors import InputError
from cmf_mj.facility.host import handover, udp
from cmf_mj.facility.host import stream as streams
from cmf_mj.facility.host.stream import HostFrame, HostStream
from cmf_mj.facility.host.stream import arrivals as arrivals_of
from cmf_mj.facility.host.udp import UdpReceiver, encode_frame
from cmf_mj.facility.operation import account

RATE = 2048


def wave(count: int = 40, rate: float = 80.0) -> HostStream:
    time = np.arange(count) / rate
    angle = np.outer(time, 2.0 * np.pi * np.array([0.5, 0.7, 1.0, 0.3, 0.4, 0.6]))
    return streams.make_stream(time, 0.05 * np.sin(angle))


def frame(sequence: int = 7, time: float = 1.25) -> HostFrame:
    values = np.random.default_rng(2).normal(size=(3, 6))
    return HostFrame(sequence, time, *values)


def assert_same(a: HostStream, b: HostStream) -> None:
    for left, right in zip(a, b, strict=True):
        assert left.dtype == right.dtype
        assert left.tobytes() == right.tobytes()


# Streams


def test_derivatives_of_a_quintic_are_exact() -> None:
    time = np.sort(np.random.default_rng(1).uniform(0.0, 1.0, 30))
    poly = np.polynomial.Polynomial([0.1, -0.2, 0.3, 1.0, -1.5, 0.5])
    pose = np.tile(poly(time)[:, None], 6)
    velocity, acceleration = streams.differentiate(time, pose)
    assert np.abs(velocity[:, 3] - poly.deriv()(time)).max() < 1e-9
    assert np.abs(acceleration[:, 3] - poly.deriv(2)(time)).max() < 1e-6


def test_a_stream_of_poses_is_played_as_its_spline() -> None:
    stream = wave(160, 64.0)
    compiled = make_dcu()
    demand = upsample(compiled, resting(compiled), arrivals_of(stream), 5000)
    spline = make_interp_spline(stream.time, stream.pose, k=5)
    delay = 1.0 / 64.0 + compiled.hold + compiled.line_frames / RATE
    at = np.arange(3000, 5000) / RATE - delay  # the gap of the start has closed
    for order in range(3):
        assert np.abs(demand[3000:, order] - spline(at, nu=order)).max() < 1e-9


def test_a_command_is_sampled_with_its_derivatives() -> None:
    command = signals.sine("pitch", 0.05, 0.5)
    stream = streams.from_command(command, 64.0)
    assert stream.time[-1] <= command.duration
    assert np.diff(stream.time) == pytest.approx(1 / 64.0)
    picked = command.pose[:: RATE // 64][: stream.time.size]
    assert np.abs(stream.pose - picked).max() < 1e-12
    again = streams.from_command(signals.step("heave", 0.0254), 80.0, derivatives="zero")
    assert set(np.unique(again.pose[:, 2])) == {0.0, 0.0254}
    assert again.pose[80, 2] == 0.0254
    assert again.pose[79, 2] == 0.0
    assert not again.velocity.any()


def test_resampling_keeps_the_motion() -> None:
    stream = wave(81, 40.0)
    finer = streams.resample(stream, 80.0)
    assert finer.time.size == 161
    back = streams.resample(finer, 40.0)
    for name in ("time", "pose", "velocity", "acceleration"):
        assert np.abs(getattr(back, name) - getattr(stream, name)).max() < 1e-10


def test_a_gap_that_memory_cannot_hold_is_refused() -> None:
    """A clock that jumps by thirty years within a file: 2e9 frames at 2 Hz."""
    stream = streams.make_stream(np.array([0.0, 0.1, 1e9]), *np.zeros((3, 3, 6)))
    with pytest.raises(ValueError, match="rate: 2 Hz makes 2e.09 frames of a stream of 1e.09 s"):
        streams.resample(stream, 2.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pose": np.zeros((10, 5))}, r"pose: shape is \(10, 5\)"),
        ({"time": np.zeros(10)}, "time: frame 1: 0.0 is refused"),
        ({"time": np.full(10, np.nan)}, r"time\[0\]: nan is not"),
        ({"pose": np.full((10, 6), np.inf)}, r"pose\[0, 0\]: inf is not"),
        ({"velocity": np.zeros((10, 6))}, "give both or neither"),
        (
            {"velocity": np.zeros((9, 6)), "acceleration": np.zeros((10, 6))},
            r"velocity: shape is \(9, 6\)",
        ),
        ({"sequence": np.arange(10)[::-1]}, "sequence: frame 1: 8 is refused"),
        ({"sequence": np.arange(10.0)}, "sequence: float64"),
        ({"derivatives": "exact"}, "'exact' is not one of spline, zero"),
        ({"time": np.arange(5.0), "pose": np.zeros((5, 6))}, "at least 6"),
    ],
)
def test_a_bad_stream_is_refused_by_name(changes: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"time": np.arange(10.0), "pose": np.zeros((10, 6))} | changes
    with pytest.raises(ValueError, match=message):
        streams.make_stream(**arguments)  # type: ignore[arg-type]


# Files


@pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
def test_a_stream_reads_back_bit_for_bit(name: str, tmp_path: Path) -> None:
    stream = wave()
    assert_same(streams.read_stream(streams.write_stream(stream, tmp_path / name)), stream)


def test_a_file_of_poses_alone_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    rows = [f"0,0,{0.001 * k},9,0,0,0,{k / 50}" for k in range(8)]
    path.write_text("\n".join(["yaw,pitch,heave,note,roll,sway,surge,time", *rows]))
    stream = streams.read_stream(path)
    assert stream.pose[:, 2] == pytest.approx(0.001 * np.arange(8))
    assert stream.velocity[:, 2] == pytest.approx(0.05)
    assert stream.sequence.tolist() == list(range(8))
    assert not streams.read_stream(path, derivatives="zero").velocity.any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,surge\n0,0\n", "sway: column is missing"),
        ("time,surge,sway,heave,roll,pitch,yaw\n0,0,0,,0,0,0\n", "heave: row 1 is empty"),
        ("time,surge,sway,heave,roll,pitch,yaw\n0,0,0,up,0,0,0\n", "heave: is not a column"),
        ("time,time,surge\n0,0,0\n", "time: column is there twice"),
        ("time,surge,sway,heave,roll,pitch,yaw\n1,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", "frame 1: 1.0"),
        ("", "cannot be read"),
    ],
)
def test_a_bad_file_is_refused_with_its_place(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        streams.read_stream(path, derivatives="zero")


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="must end in"):
        streams.read_stream(tmp_path / "run.xlsx")
    with pytest.raises(ValueError, match="must end in"):
        streams.write_stream(wave(), tmp_path / "run.txt")
    with pytest.raises(ValueError, match="none.parquet: cannot be read: there is no such file"):
        streams.read_stream(tmp_path / "none.parquet")
    path = streams.write_stream(wave(), tmp_path / "run.parquet")
    with pytest.raises(ValueError, match="control_frame: column is missing"):
        streams.read_arrivals(path)


def test_bad_frames_come_back_bit_for_bit(tmp_path: Path) -> None:
    arrivals = arrivals_of(wave(120))
    arrivals.values[30, 1, 2] = np.nan
    arrivals.values[31, 0, 0] = np.inf
    arrivals.time[40] = np.nan
    arrivals.sequence[50] = 49
    arrivals.frame[60:] += 400
    again = streams.read_arrivals(streams.write_arrivals(arrivals, tmp_path / "host.parquet"))
    for left, right in zip(arrivals, again, strict=True):
        assert left.tobytes() == right.tobytes()


# Datagrams


def test_a_datagram_is_laid_out_as_documented() -> None:
    """Against the struct module: another reading of the same table."""
    sent = frame()
    data = encode_frame(sent)
    motion = [*sent.pose, *sent.velocity, *sent.acceleration]
    body = struct.pack("<4sHHQd18d", b"CMFH", 1, 172, sent.sequence, sent.time, *motion)
    assert data == body + struct.pack("<I", zlib.crc32(body))
    assert len(data) == udp.SIZE == 172


@given(
    sequence=st.integers(0, 2**63 - 1),
    time=st.floats(),
    values=st.lists(st.floats(), min_size=18, max_size=18),
)
def test_decoding_undoes_encoding(sequence: int, time: float, values: list[float]) -> None:
    sent = HostFrame(sequence, time, *np.array(values).reshape(3, 6))
    found = udp.decode_frame(encode_frame(sent))
    assert found.sequence == sequence
    assert struct.pack("<d", found.time) == struct.pack("<d", time)
    for name in ("pose", "velocity", "acceleration"):
        assert getattr(found, name).tobytes() == getattr(sent, name).tobytes()


def forged(offset: int, octets: bytes) -> bytes:
    """A datagram with other octets and a checksum that fits them."""
    body = bytearray(encode_frame(frame())[:-4])
    body[offset : offset + len(octets)] = octets
    return bytes(body) + struct.pack("<I", zlib.crc32(body))


MALFORMED = [
    (b"", "wrong_length"),
    (encode_frame(frame())[:-1], "wrong_length"),
    (encode_frame(frame()) + b"\0", "wrong_length"),
    (forged(0, b"CMFX"), "wrong_magic"),
    (forged(4, b"\2\0"), "wrong_version"),
    (forged(6, b"\1\0"), "wrong_length"),
    (forged(8, b"\xff" * 8), "wrong_sequence"),
    (encode_frame(frame())[:-4] + b"\0\0\0\0", "wrong_checksum"),
]


@pytest.mark.parametrize(("data", "reason"), MALFORMED)
def test_a_malformed_datagram_is_refused_with_its_reason(data: bytes, reason: str) -> None:
    with pytest.raises(udp.DatagramError, match=reason) as error:
        udp.decode_frame(data)
    assert error.value.reason == reason
    assert reason in udp.DATAGRAM_REASONS


@given(bit=st.integers(0, 8 * udp.SIZE - 1))
def test_any_flipped_bit_is_noticed(bit: int) -> None:
    data = bytearray(encode_frame(frame()))
    data[bit // 8] ^= 1 << bit % 8
    with pytest.raises(udp.DatagramError):
        udp.decode_frame(bytes(data))


def test_a_frame_that_does_not_fit_is_not_encoded() -> None:
    with pytest.raises(ValueError, match="sequence: -1"):
        encode_frame(frame(-1))
    with pytest.raises(ValueError, match=r"pose: shape is \(5,\)"):
        encode_frame(frame()._replace(pose=np.zeros(5)))


# Hand-over


def test_the_ring_hands_over_in_order_and_counts_what_it_lost() -> None:
    ring, log = handover.make_ring(4), handover.make_log(10)
    filled = handover.collect(ring, log, 0, 0)
    assert filled == 0
    for number in range(3):
        handover.put(ring, frame(number, float(number)))
    filled = handover.collect(ring, log, filled, 5)
    assert (filled, ring.lost[0]) == (3, 0)
    for number in range(3, 10):
        handover.put(ring, frame(number, float(number)))
    filled = handover.collect(ring, log, filled, 9)
    assert (filled, ring.lost[0]) == (7, 3)
    kept = handover.filled_log(log, filled)
    assert kept.sequence.tolist() == [0, 1, 2, 6, 7, 8, 9]
    assert kept.frame.tolist() == [5, 5, 5, 9, 9, 9, 9]
    assert (kept.values[0] == np.array(frame()[2:])).all()
    assert (log.frame[filled:] == handover.NEVER).all()
    for number in range(4):
        handover.put(ring, frame(number))
    assert handover.collect(ring, log, filled, 12) == 10
    assert ring.lost[0] == 4


def test_of_frames_that_come_too_fast_the_newest_goes_on_and_the_rest_is_counted() -> None:
    """A host of 2048 Hz for two seconds: 256 + 200 t are handed over, spread evenly, none older."""
    ring, filled = handover.make_ring(64), 0
    log = handover.make_log(handover.capacity_for(2 * RATE))
    for now in range(2 * RATE):
        handover.put(ring, frame(now, now / RATE))
        filled = handover.collect(ring, log, filled, now)
    kept = handover.filled_log(log, filled)
    waiting = int(ring.written[0] - ring.read[0])
    assert filled == pytest.approx(256 + 2 * 200, abs=1)
    assert filled + ring.thinned[0] + ring.lost[0] + waiting == 2 * RATE
    assert ring.lost[0] == 0 and waiting <= 10
    late = kept.sequence[-200:]
    assert set(np.diff(late)) <= {10, 11}  # 2048 / 200 frames, to the whole one
    assert (kept.sequence == kept.frame).all()  # what goes on is what has just come


def test_a_host_of_80_hz_is_never_thinned_and_a_burst_keeps_its_newest() -> None:
    ring, filled = handover.make_ring(512), 0
    log = handover.make_log(handover.capacity_for(20 * RATE))
    for now in range(0, 10 * RATE, 26):
        handover.put(ring, frame(now))
        filled = handover.collect(ring, log, filled, now)
    assert (filled, ring.thinned[0]) == (len(range(0, 10 * RATE, 26)), 0)
    log, filled = handover.make_log(handover.capacity_for(20 * RATE)), 0
    for number in range(400):
        handover.put(ring, frame(number))
    filled = handover.collect(ring, log, filled, 0)
    assert (filled, ring.thinned[0]) == (256, 144)
    assert handover.filled_log(log, filled).sequence.tolist() == list(range(144, 400))


def test_a_slot_under_the_writers_hand_is_lost_not_torn() -> None:
    ring, log = handover.make_ring(4), handover.make_log(10)
    for number in range(2):
        handover.put(ring, frame(number))
    ring.mark[0] = -1  # the writer has come round and is at work in slot 0
    assert handover.collect(ring, log, 0, 0) == 1
    assert ring.lost[0] == 1
    assert log.sequence[0] == 1


@allocating
def _read_until(ring, log, last):  # type: ignore[no-untyped-def]
    """Collect without pause until the writer's last frame is read or lost."""
    filled, turns = 0, 0
    while ring.read[0] < last and turns < 10**9:
        filled = handover.collect(ring, log, filled, turns)
        turns += 1
    return filled


def test_writer_and_reader_at_once_tear_no_frame() -> None:
    """A reader that never pauses beside a writer that never waits, on a ring of two slots."""
    count = 20000
    ring, log = handover.make_ring(2), handover.make_log(count)
    _read_until(ring, log, 0)  # compiled before the race
    frames = [HostFrame(n, float(n), *np.full((3, 6), float(n))) for n in range(count)]
    with ThreadPoolExecutor(1) as pool:
        reader = pool.submit(_read_until, ring, log, count)
        for sent in frames:
            handover.put(ring, sent)
        filled = reader.result(timeout=60)
    kept = handover.filled_log(log, filled)
    assert filled + ring.lost[0] == count
    assert filled > 0
    assert (np.diff(kept.sequence) > 0).all()
    assert (np.diff(kept.frame) >= 0).all()
    assert (kept.time == kept.sequence).all()
    assert (kept.values == kept.sequence[:, None, None]).all()


# Sockets


def wait_for(receiver: UdpReceiver, count: int) -> None:
    """Until that many datagrams were taken or dropped; ten seconds at most."""
    end = clock.monotonic() + 10.0
    while receiver.received_frames + sum(receiver.refused.values()) < count:
        assert clock.monotonic() < end, "datagrams did not arrive"
        clock.sleep(0.001)


def test_frames_cross_the_loopback_in_real_time() -> None:
    stream = wave(24)
    log = handover.make_log(100)
    with UdpReceiver() as receiver:
        assert receiver.address[0] == "127.0.0.1"
        report = udp.send_stream(stream, *receiver.address)
        wait_for(receiver, 24)
        assert handover.collect(receiver.ring, log, 0, 0) == 24
    assert report.frames == 24
    assert report.duration + report.worst_lateness >= 23 / 80.0 - 1e-9
    kept = handover.filled_log(log, 24)
    assert kept.values.tobytes() == stream.values.tobytes()
    assert kept.time.tobytes() == stream.time.tobytes()
    assert not any(receiver.refused.values())


def test_garbage_never_reaches_the_ring_and_is_counted() -> None:
    expected = dict.fromkeys((*udp.DATAGRAM_REASONS, "overrun"), 0)
    with UdpReceiver() as receiver, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw:
        for data, reason in MALFORMED:
            raw.sendto(data, receiver.address)
            expected[reason] += 1
        raw.sendto(encode_frame(frame()), receiver.address)
        raw.sendto(b"\0" * 5000, receiver.address)
        expected["wrong_length"] += 1
        wait_for(receiver, len(MALFORMED) + 2)
        assert receiver.received_frames == 1
        assert receiver.refused == expected


def test_other_senders_are_dropped_and_counted() -> None:
    """127.0.0.2 is another host on the same loopback; another port is another program."""
    mine, stranger, neighbour = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(3))
    with mine, stranger, neighbour:
        mine.bind(("127.0.0.1", 0))
        neighbour.bind(("127.0.0.1", 0))
        stranger.bind(("127.0.0.2", 0))
        port = mine.getsockname()[1]
        with UdpReceiver(host="127.0.0.1", host_port=port) as receiver:
            for sender in (stranger, neighbour, mine):
                sender.sendto(encode_frame(frame()), receiver.address)
            wait_for(receiver, 3)
            assert receiver.received_frames == 1
            assert receiver.refused["wrong_sender"] == 2


def test_what_the_system_drops_is_counted_and_what_waits_is_taken_at_the_end() -> None:
    """More than the buffer holds, while the thread has no turn."""
    with UdpReceiver() as receiver, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw:
        take, count = receiver._store_next_frame, 40_000
        begun = threading.Event()

        def held() -> None:
            begun.set()
            closing.wait()
            take()

        closing = threading.Event()
        receiver._store_next_frame = held  # type: ignore[method-assign]
        raw.sendto(b"", receiver.address)
        assert begun.wait(10.0)
        for _ in range(count):
            raw.sendto(bytes(100), receiver.address)
        receiver._store_next_frame = take  # type: ignore[method-assign]
        receiver._ending.set()
        closing.set()
    dropped = receiver.refused
    assert dropped["overrun"] > 0 and dropped["wrong_length"] > 100
    assert sum(dropped.values()) + receiver.received_frames == count + 1


def test_a_flood_of_garbage_loses_no_frame_of_the_host_and_is_counted() -> None:
    """A short one of `scripts/soak.py host`, ten minutes of it are in speed.md."""
    script = Path(__file__).parents[2] / "scripts" / "soak.py"
    done = runpy.run_path(str(script))["flood"](3.0, 2000.0)
    counts = account(done.operation, done.received, done.dropped)
    assert done.received + sum(done.dropped.values()) == done.good + done.garbage
    assert done.good - done.received <= done.dropped["overrun"]
    assert counts["lost"] == counts["thinned"] == 0
    assert counts["wrong_sender"] > 0.5 * done.garbage
    assert counts["received"] == counts["early"] + counts["after_end"] + (
        done.operation.arrivals.frame.size
    )


def test_other_units_are_said_and_the_right_ones_are_not() -> None:
    stream = wave(200)
    assert streams.unit_doubts(stream.time, stream.pose) == []
    (text,) = streams.unit_doubts(1e3 * stream.time, stream.pose)
    assert text == "time: 12.5 s from frame to frame; host times are in s: is this ms?"
    assert streams.unit_doubts(1e6 * stream.time, stream.pose)[0].endswith("is this us?")
    turned = stream.pose * [1, 1, 1, 57.3, 57.3, 57.3]
    lines = streams.unit_doubts(stream.time, turned)
    assert [line.split(":")[0] for line in lines] == ["roll", "pitch", "yaw"]
    assert all(line.endswith("is this deg?") for line in lines)
    assert streams.unit_doubts(stream.time, stream.pose * [39.37, 1, 1, 1, 1, 1])[0].endswith("in?")
    bad = np.full((3, 6), np.nan)
    assert streams.unit_doubts(np.array([np.nan, 0.0, np.inf]), bad) == []
    assert streams.unit_doubts(np.zeros(0), np.zeros((0, 6))) == []


def test_the_command_line_says_so_before_the_run(tmp_path: Path) -> None:
    stream = wave(8)
    path = streams.write_stream(stream._replace(time=1e3 * stream.time), tmp_path / "run.csv")
    said = cmf("operate", path, "--out", "", "--seconds", "nan", code=2)
    assert "time: 12.5 s from frame to frame" in said.replace("\n", " ")


@pytest.mark.parametrize(
    ("timing", "late"),
    [({}, 0.001), ({"stutter": 0.05}, 0.0), ({"jitter": 0.1}, 0.0)],
)
def test_deadlines_are_absolute(timing: dict[str, float], late: float) -> None:
    """A clock that is late at each sleep: no frame is later than that, so none adds up.

    The duration counts from the first datagram, by a clock that only sleeping moves.
    """
    now, sent = 0.0, [0.0]

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds + late
        sent.append(now)

    how = {"timing": streams.HostTiming(**timing), "clock": lambda: now, "sleep": sleep}
    with UdpReceiver() as receiver:
        report = udp.send_stream(wave(200), *receiver.address, **how)
    assert report.worst_lateness == pytest.approx(late)
    assert report.duration == pytest.approx(sent[-1] - sent[1 if timing else 0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"port": 70000}, "port: 70000"),
        ({"host_port": -1}, "host_port: -1"),
        ({"host_port": 0}, "host_port: 0 is refused; allowed: 1 to 65535"),
        ({"host": "localhost"}, "host: 'localhost' is not an IPv4 address"),
        ({"bind": "::1"}, "bind: '::1'"),
        ({"bind": "192.0.2.1"}, "bind: '192.0.2.1' is no address of this machine"),
    ],
)
def test_bad_sockets_are_refused_by_name(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        UdpReceiver(**arguments)  # type: ignore[arg-type]


def test_bad_ports_to_send_from_and_to_are_refused_by_name() -> None:
    for source, port, message in ((70000, 2048, "source_port: 70000"), (0, 0, "port: 0")):
        with pytest.raises(InputError, match=message):
            udp.send_stream(wave(8), "127.0.0.1", port, source_port=source)
    for port in ("0", "70000", "9" * 5000, "+1", ""):
        with pytest.raises(InputError, match="^to: "):
            udp.parse_target(f"127.0.0.1:{port}")


def test_a_port_in_use_is_an_error_at_once() -> None:
    with UdpReceiver() as receiver, pytest.raises(OSError):
        UdpReceiver(receiver.address[1])


def test_the_command_line_sends_a_file(tmp_path: Path) -> None:
    path = streams.write_stream(wave(17, 40.0), tmp_path / "run.csv")
    with UdpReceiver() as receiver:
        target = f"127.0.0.1:{receiver.address[1]}"
        assert "33 frames in " in cmf("host", path, "--to", target, "--rate", "80")
        wait_for(receiver, 33)
        assert receiver.received_frames == 33
    for arguments, message in (
        (["nothing.csv", "--to", "127.0.0.1:2048"], "nothing.csv: cannot be read"),
        ([path, "--to", "127.0.0.1"], "ADDRESS:PORT"),
        ([path, "--to", "127.0.0.1:0"], "port: 0"),
        ([path, "--to", "127.0.0.1:2048", "--rate", "0"], "greater than or equal to 1"),
    ):
        assert message in cmf("host", *arguments, code=2)


def test_no_frames_of_a_silent_host_are_kept(tmp_path: Path) -> None:
    number, none = np.arange(0), np.zeros((0, 3, 6))
    path = tmp_path / "host.parquet"
    streams.write_arrivals(Arrivals(number, number, number / 80.0, none), path)
    assert streams.read_arrivals(path).values.shape == none.shape
