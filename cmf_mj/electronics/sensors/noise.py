"""Gaussian noise by counter: Philox 4x64 with ten rounds, one stream a channel.

Salmon et al., *Parallel random numbers: as easy as 1, 2, 3* (2011). A block of four words is a
function of key and counter alone,

    key = (seed, digest of the channel's name),    counter = (frame, component / 4, 0, 0),

so a sample depends on seed, channel, frame and component alone: no state, no memory,
the same whatever other channels there are. Words become pairs of normals by Box and Muller.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError

_ROUNDS = 10
_WEYL = (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B)
_FIRST = np.uint64(0xD2E7470EE14C6C93)
_SECOND = np.uint64(0xCA5A826395121157)
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_SPARE = np.uint64(11)
_UNIT = 2.0**-53
_NONE = np.uint64(0)


def stream_key(seed: int, channel: str) -> tuple[int, int]:
    """Key of a channel's stream: the seed, 0 to 2^64 - 1, and 64 bits of its name's SHA-256."""
    if not 0 <= seed < 2**64:
        raise InputError(f"seed: {seed} must be between 0 and 2^64 - 1")
    return seed, int.from_bytes(hashlib.sha256(channel.encode()).digest()[:8], "little")


def key_schedule(key: tuple[int, int]) -> NDArray[np.uint64]:
    """Keys of the ten rounds, (10, 2)."""
    rows = [
        [(part + i * weyl) % 2**64 for part, weyl in zip(key, _WEYL, strict=True)]
        for i in range(_ROUNDS)
    ]
    return np.array(rows, dtype=np.uint64)


@compiled
def _product(one, two):  # type: ignore[no-untyped-def]
    """High and low word of a product of two words, from products of halves: nothing overflows."""
    a, b = one >> _HALF, one & _LOW
    c, d = two >> _HALF, two & _LOW
    low = b * d
    cross = a * d + (low >> _HALF)
    middle = b * c + (cross & _LOW)
    return a * c + (cross >> _HALF) + (middle >> _HALF), (middle << _HALF) | (low & _LOW)


@compiled
def block(keys, first, second):  # type: ignore[no-untyped-def]
    """Four words of the counter (first, second, 0, 0), lowest word first."""
    c0, c1, c2, c3 = first, second, _NONE, _NONE
    for i in range(keys.shape[0]):
        high0, low0 = _product(_FIRST, c0)
        high1, low1 = _product(_SECOND, c2)
        c0, c1, c2, c3 = high1 ^ c1 ^ keys[i, 0], low1, high0 ^ c3 ^ keys[i, 1], low0
    return c0, c1, c2, c3


@compiled
def _pair(one, two):  # type: ignore[no-untyped-def]
    radius = np.sqrt(-2.0 * np.log((np.float64(one >> _SPARE) + 1.0) * _UNIT))
    angle = 2.0 * np.pi * np.float64(two >> _SPARE) * _UNIT
    return radius * np.cos(angle), radius * np.sin(angle)


@compiled
def four_normals(keys, frame, group):  # type: ignore[no-untyped-def]
    """Standard normals of the components 4 group to 4 group + 3 at a frame."""
    w0, w1, w2, w3 = block(keys, np.uint64(frame), np.uint64(group))
    n0, n1 = _pair(w0, w1)
    n2, n3 = _pair(w2, w3)
    return n0, n1, n2, n3
