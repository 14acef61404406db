"""Host frames over UDP: a receiving thread, and a sender that keeps its time.

A datagram is one frame, little-endian and without padding:

    octet 0   4 bytes     magic CMFH
          4   uint16      version, 1
          6   uint16      length of the whole datagram, 172
          8   uint64      sequence number, at most 2^63 - 1
         16   float64     time [s]
         24   18 float64  pose [m, rad], velocity [m/s, rad/s], acceleration [m/s^2, rad/s^2]
        168   uint32      CRC-32 (zlib) of octets 0 to 167

The receiver binds to the loopback address by default and takes datagrams of one host only, by its
address and, if it is given, its port; all others are dropped and counted. What comes while the
thread does not run waits in the system's buffer, and the system counts what does not fit (Linux).
"""

import contextlib
import socket
import struct
import sys
import threading
import time
import zlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.handover import Ring, make_ring, put
from cmf_mj.facility.host.port import LOOPBACK, HostPort, check_address, check_port
from cmf_mj.facility.host.stream import HostFrame, HostStream, HostTiming

MAGIC, VERSION = b"CMFH", 1
_FRAME, _CHECKSUM = struct.Struct("<4sHHQd18d"), struct.Struct("<I")
SIZE = _FRAME.size + _CHECKSUM.size  #: Octets of a datagram.
MOST_SEQUENCE = 2**63 - 1  #: Largest sequence number.

_RECEIVE_WAIT = 0.05  #: Longest wait of the thread, which then looks whether it is to end [s].
_MEMINFO, _MEMINFO_COUNTS = 55, struct.Struct("9I")
"""SO_MEMINFO of Linux, and its numbers, the last of which counts what did not fit the buffer."""

DATAGRAM_REASONS = (
    "wrong_sender",
    "wrong_length",
    "wrong_magic",
    "wrong_version",
    "wrong_checksum",
    "wrong_sequence",
)
"""Why a datagram is refused, in the order of the tests."""


class DatagramError(InputError):
    """A datagram that is refused."""

    def __init__(self, reason: str, explanation: str) -> None:
        """Keep the reason, one of `DATAGRAM_REASONS`, and the explanation."""
        super().__init__(f"{reason}: {explanation}")
        self.reason = reason


def encode_frame(frame: HostFrame) -> bytes:
    """The datagram of a frame."""
    if not 0 <= frame.sequence <= MOST_SEQUENCE:
        raise InputError(f"sequence: {frame.sequence} is refused; allowed: 0 to {MOST_SEQUENCE}")
    motion = []
    for name in ("pose", "velocity", "acceleration"):
        values = np.asarray(getattr(frame, name), dtype=float)
        if values.shape != (6,):
            raise InputError(f"{name}: shape is {values.shape}; allowed: (6,)")
        motion += values.tolist()
    data = _FRAME.pack(MAGIC, VERSION, SIZE, frame.sequence, frame.time, *motion)
    return data + _CHECKSUM.pack(zlib.crc32(data))


def decode_frame(data: bytes) -> HostFrame:
    """The frame of a datagram; its numbers are as sent, be they finite or not."""
    if len(data) != SIZE:
        raise DatagramError("wrong_length", f"{len(data)} octets; allowed: {SIZE}")
    magic, version, length, sequence, stamp, *motion = _FRAME.unpack_from(data)
    is_intact = _CHECKSUM.unpack_from(data, _FRAME.size)[0] == zlib.crc32(data[: _FRAME.size])
    for is_right, reason, explanation in (
        (magic == MAGIC, "wrong_magic", f"{magic!r}; allowed: {MAGIC!r}"),
        (version == VERSION, "wrong_version", f"{version}; allowed: {VERSION}"),
        (length == SIZE, "wrong_length", f"field says {length}; allowed: {SIZE}"),
        (is_intact, "wrong_checksum", "octets were changed on the way"),
        (sequence <= MOST_SEQUENCE, "wrong_sequence", f"{sequence}; allowed: 0 to {MOST_SEQUENCE}"),
    ):
        if not is_right:
            raise DatagramError(reason, explanation)
    return HostFrame(sequence, stamp, *np.array(motion).reshape(3, 6))


class UdpReceiver(HostPort):
    """A port whose thread puts the frames of the host into a ring."""

    def __init__(
        self,
        port: int = 0,
        *,
        host: str = LOOPBACK,
        host_port: int | None = None,
        bind: str = LOOPBACK,
        ring: Ring | None = None,
    ) -> None:
        """Bind the socket to the IPv4 address `bind` and start the thread.

        Port 0 takes a free one, see `address`. Only datagrams of `host`, and of `host_port` if
        there is one, are taken. Raises `OSError` for a port that is taken.
        """
        super().__init__(port, host, host_port, bind, _RECEIVE_WAIT)
        self.ring = ring if ring is not None else make_ring()  #: Well-formed frames received.
        self._refused, self._overrun = dict.fromkeys(DATAGRAM_REASONS, 0), 0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run_thread, name="host frames", daemon=True)
        self._thread.start()

    @property
    def refused(self) -> dict[str, int]:
        """Datagrams dropped so far by reason, `overrun` by the system as its buffer was full."""
        self._read_overrun()
        return self._refused | {"overrun": self._overrun}

    @property
    def received_frames(self) -> int:
        """Frames put into the ring so far."""
        return int(self.ring.written[0])

    def close(self) -> None:
        """Take what has come, end the thread and close the socket; the ring stays as it is."""
        self._ending.set()
        self._thread.join()
        self._read_overrun()
        super().close()

    def _read_overrun(self) -> None:
        """Read the system's count of what its buffer had no room for."""
        if sys.platform == "linux" and self._socket.fileno() >= 0:
            data = self._socket.getsockopt(socket.SOL_SOCKET, _MEMINFO, _MEMINFO_COUNTS.size)
            *_, self._overrun = _MEMINFO_COUNTS.unpack(data)

    def _run_thread(self) -> None:
        """Work of the thread; when it is to end, it takes what still waits, for at most 1 s."""
        while not self._ending.is_set():
            with contextlib.suppress(OSError):  # nothing came, or an ICMP error of an earlier send
                self._store_next_frame()
        self._socket.settimeout(0.0)
        end = time.monotonic() + 1.0
        with contextlib.suppress(OSError):
            while time.monotonic() < end:
                self._store_next_frame()

    def _store_next_frame(self) -> None:
        """Put the frame of the next datagram into the ring, or count why not."""
        datagram = self.receive(SIZE + 1)  # so that a longer one is seen to be longer
        try:
            if not datagram.is_from_host:
                raise DatagramError("wrong_sender", "not the host")
            put(self.ring, decode_frame(datagram.data))
        except DatagramError as error:
            self._refused[error.reason] += 1


class SendReport(NamedTuple):
    """How a stream was sent."""

    frames: int  #: Datagrams sent.
    duration: float  #: From the first to the last [s].
    mean_lateness: float  #: Mean time of sending behind the deadlines [s].
    worst_lateness: float  #: Largest of it [s].


def send_stream(
    stream: HostStream,
    address: str,
    port: int,
    *,
    source_port: int = 0,
    timing: HostTiming = HostTiming(),  # noqa: B008 (immutable)
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> SendReport:
    """Send a stream to one IPv4 address and port in real time, by its time stamps and a timing.

    From `source_port`, 0 for a free one. Each deadline is start + what `timing.apply` gives:
    absolute, so that no lateness adds up.
    """
    check_port("port", port, 1)
    check_port("source_port", source_port, 0)
    check_address("address", address)
    stream, deadlines = timing.apply(stream)
    datagrams = [encode_frame(stream.row(index)) for index in range(stream.time.size)]
    lateness = np.zeros(stream.time.size)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("", source_port))
        start = clock()
        for index, data in enumerate(datagrams):
            deadline = start + float(deadlines[index])
            while (wait := deadline - clock()) > 0.0:
                sleep(wait)
            sender.sendto(data, (address, port))
            lateness[index] = clock() - deadline
    return SendReport(
        frames=len(datagrams),
        duration=float(deadlines[-1] - deadlines[0] + lateness[-1] - lateness[0]),
        mean_lateness=float(lateness.mean()),
        worst_lateness=float(lateness.max()),
    )


def parse_target(text: str) -> tuple[str, int]:
    """Address and port of `127.0.0.1:2048`."""
    address, colon, port = text.rpartition(":")
    if not (colon and port.isascii() and port.isdigit() and len(port) <= 5):
        raise InputError(f"to: {text!r} is refused; allowed: ADDRESS:PORT, e.g. 127.0.0.1:2048")
    check_port("to: port", int(port), 1)
    check_address("to", address)
    return address, int(port)
