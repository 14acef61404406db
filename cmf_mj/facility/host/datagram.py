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

With a session key it is version 2, of 188 octets: octets 172 to 187 are BLAKE2s with the key, of 16
octets, of octets 0 to 171. Who has not the key cannot make one, only repeat one, which the DCU
refuses by its sequence number.
"""

import struct
import zlib
from hashlib import blake2s
from hmac import compare_digest
from pathlib import Path

import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.stream import HostFrame

MAGIC = b"CMFH"
VERSION, KEYED_VERSION = 1, 2

_BODY, _SUM = struct.Struct("<4sHHQd18d"), struct.Struct("<I")

SIZE = _BODY.size + _SUM.size

TAG = 16
"""Octets that prove the session key."""

KEY_SIZES = (16, 32)
"""Least and most octets of a session key."""

MOST_SEQUENCE = 2**63 - 1
"""Largest sequence number."""

DATAGRAM_REASONS = (
    "wrong_sender",
    "wrong_length",
    "wrong_magic",
    "wrong_version",
    "wrong_key",
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


def read_key(path: str | Path) -> bytes:
    """A session key from a file: its octets without white space at the ends, 16 to 32 of them."""
    try:
        key = Path(path).read_bytes().strip()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    least, most = KEY_SIZES
    if not least <= len(key) <= most:
        raise InputError(f"{path}: key: {len(key)} octets; allowed: {least} to {most}")
    return key


def encode(frame: HostFrame, key: bytes | None = None) -> bytes:
    """The datagram of a frame, with a session key or without."""
    if not 0 <= frame.sequence <= MOST_SEQUENCE:
        raise InputError(f"sequence: {frame.sequence} is refused; allowed: 0 to {MOST_SEQUENCE}")
    motion = []
    for name in ("pose", "velocity", "acceleration"):
        values = np.asarray(getattr(frame, name), dtype=float)
        if values.shape != (6,):
            raise InputError(f"{name}: shape is {values.shape}; allowed: (6,)")
        motion += values.tolist()
    data = _BODY.pack(MAGIC, *_form(key), frame.sequence, frame.time, *motion)
    data += _SUM.pack(zlib.crc32(data))
    return data if key is None else data + _tag(data, key)


def _form(key: bytes | None) -> tuple[int, int]:
    """Version and length."""
    return (VERSION, SIZE) if key is None else (KEYED_VERSION, SIZE + TAG)


def _tag(data: bytes, key: bytes) -> bytes:
    return blake2s(data, key=key, digest_size=TAG).digest()


def decode(data: bytes, key: bytes | None = None) -> HostFrame:
    """The frame of a datagram; its numbers are as sent, be they finite or not.

    With a session key only those made with it are taken.
    """
    version, size = _form(key)
    if len(data) != size:
        raise DatagramError("wrong_length", f"{len(data)} octets; allowed: {size}")
    data, tag = data[:SIZE], data[SIZE:]
    magic, sent, length, sequence, time, *motion = _BODY.unpack_from(data)
    if magic != MAGIC:
        raise DatagramError("wrong_magic", f"{magic!r}; allowed: {MAGIC!r}")
    if sent != version:
        raise DatagramError("wrong_version", f"{sent}; allowed: {version}")
    if length != size:
        raise DatagramError("wrong_length", f"field says {length}; allowed: {size}")
    if key is not None and not compare_digest(tag, _tag(data, key)):
        raise DatagramError("wrong_key", "the sender has not the key of this session")
    if _SUM.unpack_from(data, _BODY.size)[0] != zlib.crc32(data[: _BODY.size]):
        raise DatagramError("wrong_checksum", "octets were changed on the way")
    if sequence > MOST_SEQUENCE:
        raise DatagramError("wrong_sequence", f"{sequence}; allowed: 0 to {MOST_SEQUENCE}")
    return HostFrame(sequence, time, *np.array(motion).reshape(3, 6))
