"""From the receiving thread to the frame loop without a lock: a ring of the latest frames.

One writer, one reader. The writer marks a slot as being written, fills it, marks it with the
frame's count and only then raises `written`. The reader checks the mark before and after it copies
a slot; if a mark is another one, the writer has lapped the reader and the frame is lost, which is
counted. Of frames faster than `LARGEST_RATE` it takes the newest and counts the rest. Neither
waits. A slot's mark and the counters are aligned 8-octet words.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.motion import copy
from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.core.arrays import check_memory
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import RATE
from cmf_mj.facility.host.stream import HostFrame

NEVER = np.iinfo(np.int64).max  #: Control frame of an empty place in a log.

LARGEST_RATE = 200
"""Frames a second that are handed over [Hz]: the DCU refuses what is faster than 100."""

_NUMBERS_OF_A_FRAME = 21  #: Control frame, sequence number, time, and three times six.
SPARE_FRAMES = 256  #: Frames that may come before `LARGEST_RATE` allows them.


class Ring(NamedTuple):
    """The latest frames, as arrays that writer and reader both hold."""

    mark: NDArray[np.int64]  #: Count of the frame in each slot, -1 while it is written, (slots,).
    sequence: NDArray[np.int64]  #: (slots,).
    time: NDArray[np.float64]  #: (slots,).
    values: NDArray[np.float64]  #: (slots, 3, 6).
    written: NDArray[np.int64]  #: Frames written so far, (1,); the writer's.
    read: NDArray[np.int64]  #: Frames read or lost so far, (1,); the reader's.
    lost: NDArray[np.int64]
    """Frames the reader came too late for or could not keep, (1,); the reader's."""
    thinned: NDArray[np.int64]
    """Frames left out because newer ones came faster than `LARGEST_RATE`, (1,); the reader's."""


def make_ring(slots: int = 256) -> Ring:
    """An empty ring; 256 slots are three seconds of an 80 Hz host."""
    if slots < 2:
        raise InputError(f"slots: {slots} must be at least 2")
    return Ring(
        mark=np.full(slots, -1),
        sequence=np.zeros(slots, dtype=np.int64),
        time=np.zeros(slots),
        values=np.zeros((slots, 3, 6)),
        written=np.zeros(1, dtype=np.int64),
        read=np.zeros(1, dtype=np.int64),
        lost=np.zeros(1, dtype=np.int64),
        thinned=np.zeros(1, dtype=np.int64),
    )


def capacity_for(frames: int, rate: int = RATE) -> int:
    """Frames that are handed over at most in a number of control frames."""
    return SPARE_FRAMES + frames * LARGEST_RATE // rate


def make_log(capacity: int) -> Arrivals:
    """An empty log for `collect`, for a number of frames."""
    if capacity < 1:
        raise InputError(f"capacity: {capacity} must be at least 1")
    check_memory("duration", f"a log of {capacity} host frames", _NUMBERS_OF_A_FRAME * capacity)
    return Arrivals(
        np.full(capacity, NEVER),
        np.zeros(capacity, dtype=np.int64),
        np.zeros(capacity),
        np.zeros((capacity, 3, 6)),
    )


def put(ring: Ring, frame: HostFrame) -> None:
    """Write a frame; called by the receiving thread alone."""
    count = int(ring.written[0])
    slot = count % ring.mark.size
    ring.mark[slot] = -1
    ring.sequence[slot] = frame.sequence
    ring.time[slot] = frame.time
    ring.values[slot, 0] = frame.pose
    ring.values[slot, 1] = frame.velocity
    ring.values[slot, 2] = frame.acceleration
    ring.mark[slot] = count
    ring.written[0] = count + 1


@compiled
def collect(ring, log, filled, frame, rate=RATE):  # type: ignore[no-untyped-def]
    """Move all new frames from the ring to the log, as arrived in this control frame.

    `filled` places of the log were in use; returns how many are now. Hand the log to `feed`
    afterwards, and keep it as the session.
    """
    slots = ring.mark.shape[0]
    written = ring.written[0]
    if written - ring.read[0] > slots:
        ring.lost[0] += written - slots - ring.read[0]
        ring.read[0] = written - slots
    room = SPARE_FRAMES + frame * LARGEST_RATE // rate - filled
    if room <= 0:
        return filled
    if written - ring.read[0] > room:
        ring.thinned[0] += written - room - ring.read[0]
        ring.read[0] = written - room
    while ring.read[0] < written:
        count = ring.read[0]
        slot = count % slots
        is_intact = filled < log.frame.shape[0] and ring.mark[slot] == count
        if is_intact:
            log.sequence[filled] = ring.sequence[slot]
            log.time[filled] = ring.time[slot]
            copy(ring.values[slot], log.values[filled])
            is_intact = ring.mark[slot] == count
        if is_intact:
            log.frame[filled] = frame
            filled += 1
        else:
            ring.lost[0] += 1
        ring.read[0] = count + 1
    return filled


def filled_log(log: Arrivals, filled: int) -> Arrivals:
    """The part of a log that is in use, as copies."""
    return Arrivals._make(column[:filled].copy() for column in log)
