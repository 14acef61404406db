"""Real time: each control frame begins when its time has come, and its computing time is logged.

The compiled loop reads the system's monotonic clock and sleeps through the C library, called like
MuJoCo by its address. A run without frames to log is not paced.
"""

import ctypes
import sys
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.arrays import check_memory
from cmf_mj.core.compiled import compiled, inlined
from cmf_mj.core.units import FRAME
from cmf_mj.plant.native import call

_SPIN = 100e-6  #: Time before a frame that is waited out awake [s]; sleeping wakes late.


class Pace(NamedTuple):
    """Clock and log of a paced run."""

    gettime: int  #: Address of clock_gettime.
    nanosleep: int  #: Address of nanosleep.
    clock: int  #: Number of the monotonic clock.
    timespec: NDArray[np.int64]  #: Seconds and nanoseconds, workspace, (2,).
    unslept: NDArray[np.int64]  #: What a signal left of a sleep, workspace, (2,).
    origin: NDArray[np.float64]  #: When frame 0 began [s]; NaN before, (1,).
    busy: NDArray[np.float64]  #: Computing time of each frame [s], (N,).
    late: NDArray[np.float64]  #: How late each frame began [s], (N,).
    frame: float  #: T [s].


def make_pace(frames: int = 0, frame: float = FRAME) -> Pace:
    """Pace for a number of frames of some length [s]; of none it neither waits nor logs."""
    timespec, unslept = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    origin, busy, late = np.full(1, np.nan), np.zeros(frames), np.zeros(frames)
    pace = Pace(0, 0, 0, timespec, unslept, origin, busy, late, frame)
    if not frames:
        return pace
    if sys.platform == "win32":
        raise OSError("real time: needs a system with clock_gettime and nanosleep")
    check_memory("seconds", f"the times of {frames} control frames", 2 * frames)
    library = ctypes.CDLL(None)
    gettime, nanosleep = (
        ctypes.cast(function, ctypes.c_void_p).value or 0
        for function in (library.clock_gettime, library.nanosleep)
    )
    return pace._replace(gettime=gettime, nanosleep=nanosleep, clock=time.CLOCK_MONOTONIC)


@compiled
def _now(pace):  # type: ignore[no-untyped-def]
    call(pace.gettime, pace.clock, pace.timespec.ctypes.data)
    return pace.timespec[0] + 1e-9 * pace.timespec[1]


@compiled
def _wait_and_log(pace, frame):  # type: ignore[no-untyped-def]
    now = _now(pace)
    if np.isnan(pace.origin[0]):
        pace.origin[0] = now - frame * pace.frame
    due = pace.origin[0] + frame * pace.frame
    if due - now > _SPIN:
        wait = int((due - now - _SPIN) * 1e9)
        pace.timespec[0], pace.timespec[1] = wait // 1_000_000_000, wait % 1_000_000_000
        call(pace.nanosleep, pace.timespec.ctypes.data, pace.unslept.ctypes.data)
        now = _now(pace)
    while now < due:
        now = _now(pace)
    pace.late[frame] = now - due
    pace.busy[frame] = -now  # `end_frame` adds the time at which the computing ends


@inlined
def begin_frame(pace, frame):  # type: ignore[no-untyped-def]
    """Wait for a frame's time, if the run is paced."""
    if pace.busy.shape[0] > 0:
        _wait_and_log(pace, frame)


@inlined
def end_frame(pace, frame):  # type: ignore[no-untyped-def]
    """Log a frame's computing time, if the run is paced."""
    if pace.busy.shape[0] > 0:
        pace.busy[frame] += _now(pace)
