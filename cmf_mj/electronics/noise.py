"""Noise as a function of seed, channel, frame and component, in any order and on any machine.

Philox4x64-10 (Salmon et al., Parallel random numbers, SC 2011; numpy.random.Philox) makes random
words of a key and a counter, Box and Muller's transform makes standard normals of words.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError

_ROUNDS = 10
_KEY_STEP_0, _KEY_STEP_1 = 0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B
"""Numbers that a round adds to both words of a key."""
_MULTIPLIER_0 = np.uint64(0xD2E7470EE14C6C93)  #: Of the first word of the counter.
_MULTIPLIER_1 = np.uint64(0xCA5A826395121157)  #: Of the third word.
_LOW_32 = np.uint64(0xFFFFFFFF)  #: Mask of a word's lower half.
_SHIFT_32 = np.uint64(32)  #: Takes the upper half.
_DROP_11 = np.uint64(11)  #: Bits to drop, 64 to 53 bits.
_ULP_53 = 2.0**-53  #: Spacing of 53 bits in 0 to 1.
_ZERO = np.uint64(0)


def stream_key(seed: int, channel: str) -> tuple[int, int]:
    """Key of a channel's stream: the seed, 0 to 2^64 - 1, and 64 bits of its name's SHA-256."""
    if not 0 <= seed < 2**64:
        raise InputError(f"seed: {seed} must be between 0 and 2^64 - 1")
    return seed, int.from_bytes(hashlib.sha256(channel.encode()).digest()[:8], "little")


def key_schedule(key: tuple[int, int]) -> NDArray[np.uint64]:
    """Philox keys of the ten rounds, (10, 2)."""
    first, second = key
    rows = [
        ((first + i * _KEY_STEP_0) % 2**64, (second + i * _KEY_STEP_1) % 2**64)
        for i in range(_ROUNDS)
    ]
    return np.array(rows, dtype=np.uint64)


@compiled
def _multiply(first, second):  # type: ignore[no-untyped-def]
    """High and low word of a product of two words, from products of halves: nothing overflows."""
    first_high, first_low = first >> _SHIFT_32, first & _LOW_32
    second_high, second_low = second >> _SHIFT_32, second & _LOW_32
    low = first_low * second_low
    cross = first_high * second_low + (low >> _SHIFT_32)
    middle = first_low * second_high + (cross & _LOW_32)
    high = first_high * second_high + (cross >> _SHIFT_32) + (middle >> _SHIFT_32)
    return high, (middle << _SHIFT_32) | (low & _LOW_32)


@compiled
def philox(keys, first, second):  # type: ignore[no-untyped-def]
    """Four random words of the counter (first, second, 0, 0), lowest word first."""
    c0, c1, c2, c3 = first, second, _ZERO, _ZERO
    for i in range(keys.shape[0]):
        high0, low0 = _multiply(_MULTIPLIER_0, c0)
        high1, low1 = _multiply(_MULTIPLIER_1, c2)
        c0, c1, c2, c3 = high1 ^ c1 ^ keys[i, 0], low1, high0 ^ c3 ^ keys[i, 1], low0
    return c0, c1, c2, c3


@compiled
def _box_muller(first, second):  # type: ignore[no-untyped-def]
    """Two standard normals from two words."""
    radius = np.sqrt(-2.0 * np.log((np.float64(first >> _DROP_11) + 1.0) * _ULP_53))
    angle = 2.0 * np.pi * np.float64(second >> _DROP_11) * _ULP_53
    return radius * np.cos(angle), radius * np.sin(angle)


@compiled
def four_normals(keys, frame, group):  # type: ignore[no-untyped-def]
    """Four standard normals, of the components 4 group to 4 group + 3 at a frame."""
    w0, w1, w2, w3 = philox(keys, np.uint64(frame), np.uint64(group))
    n0, n1 = _box_muller(w0, w1)
    n2, n3 = _box_muller(w2, w3)
    return n0, n1, n2, n3
