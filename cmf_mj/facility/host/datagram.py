"""The host's datagram: one frame, 172 octets, little-endian, without padding.

octet   type      field
0       4 bytes   magic "CMFH"
4       uint16    version, 1
6       uint16    length of the whole datagram, 172
8       uint64    sequence number, at most 2^63 - 1
16      float64   host time [s]
24      6 float64 pose [m, rad], z down
72      6 float64 velocity
120     6 float64 acceleration
168     uint32    CRC-32 (zlib, IEEE 802.3) of octets 0 to 167
"""

import zlib

import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.stream import HostFrame

MAGIC = b"CMFH"
VERSION = 1

LAYOUT = np.dtype(
    [
        ("magic", "S4"),
        ("version", "<u2"),
        ("length", "<u2"),
        ("sequence", "<u8"),
        ("time", "<f8"),
        ("pose", "<f8", 6),
        ("velocity", "<f8", 6),
        ("acceleration", "<f8", 6),
        ("checksum", "<u4"),
    ]
)
"""The layout above as a NumPy type."""

SIZE = LAYOUT.itemsize

MOST_SEQUENCE = 2**63 - 1
"""Largest sequence number."""

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


def encode(frame: HostFrame) -> bytes:
    """The datagram of a frame."""
    if not 0 <= frame.sequence <= MOST_SEQUENCE:
        raise InputError(f"sequence: {frame.sequence} is refused; allowed: 0 to {MOST_SEQUENCE}")
    row = np.zeros((), dtype=LAYOUT)
    row["magic"], row["version"], row["length"] = MAGIC, VERSION, SIZE
    row["sequence"], row["time"] = frame.sequence, frame.time
    for name in ("pose", "velocity", "acceleration"):
        values = np.asarray(getattr(frame, name), dtype=float)
        if values.shape != (6,):
            raise InputError(f"{name}: shape is {values.shape}; allowed: (6,)")
        row[name] = values
    row["checksum"] = zlib.crc32(row.tobytes()[:-4])
    return row.tobytes()


def decode(data: bytes) -> HostFrame:
    """The frame of a datagram; its numbers are as sent, be they finite or not."""
    if len(data) != SIZE:
        raise DatagramError("wrong_length", f"{len(data)} octets; allowed: {SIZE}")
    row = np.frombuffer(data, dtype=LAYOUT)[0]
    if data[:4] != MAGIC:
        raise DatagramError("wrong_magic", f"{data[:4]!r}; allowed: {MAGIC!r}")
    if row["version"] != VERSION:
        raise DatagramError("wrong_version", f"{row['version']}; allowed: {VERSION}")
    if row["length"] != SIZE:
        raise DatagramError("wrong_length", f"field says {row['length']}; allowed: {SIZE}")
    if row["checksum"] != zlib.crc32(data[:-4]):
        raise DatagramError("wrong_checksum", "octets were changed on the way")
    if row["sequence"] > MOST_SEQUENCE:
        raise DatagramError("wrong_sequence", f"{row['sequence']}; allowed: 0 to {MOST_SEQUENCE}")
    return HostFrame(
        int(row["sequence"]),
        float(row["time"]),
        np.array(row["pose"]),
        np.array(row["velocity"]),
        np.array(row["acceleration"]),
    )
