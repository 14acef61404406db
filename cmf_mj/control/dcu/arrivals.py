"""Frames with the control frame they arrive in, and a whole stream upsampled at once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcu.acceptance import receive
from cmf_mj.control.dcu.play import step
from cmf_mj.control.dcu.settings import Dcu
from cmf_mj.control.dcu.state import DcuState
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError


class Arrivals(NamedTuple):
    """Host frames in the order in which they reach the DCU, good or bad."""

    frame: NDArray[np.int64]  #: Control frame of arrival, never falling, (N,).
    sequence: NDArray[np.int64]  #: Sequence numbers, (N,).
    time: NDArray[np.float64]  #: Host times [s], (N,).
    values: NDArray[np.float64]  #: Pose [m, rad], z down, and its two derivatives, (N, 3, 6).


@compiled
def feed(dcu, state, arrivals, cursor, frame):  # type: ignore[no-untyped-def]
    """Hand the DCU all frames that have arrived by the control frame `frame`.

    The cursor is the index of the first frame not yet handed over; returned is the next one.
    """
    while cursor < arrivals.sequence.shape[0] and arrivals.frame[cursor] <= frame:
        receive(
            dcu, state, arrivals.sequence[cursor], arrivals.time[cursor], arrivals.values[cursor]
        )
        cursor += 1
    return cursor


@allocating
def _run(dcu, state, arrivals, demand):  # type: ignore[no-untyped-def]
    cursor = 0
    for frame in range(demand.shape[0]):
        cursor = feed(dcu, state, arrivals, cursor, frame)
        step(dcu, state, demand[frame])


def upsample(dcu: Dcu, state: DcuState, arrivals: Arrivals, frames: int) -> NDArray[np.float64]:
    """Run a DCU over control frames 0 to `frames` - 1, from `resting` or as left before.

    The demand (frames, 3, 6) at 2048 Hz: pose [m, rad], z down, and its two derivatives.
    """
    count = arrivals.sequence.shape[0]
    for name, shape in (("frame", (count,)), ("time", (count,)), ("values", (count, 3, 6))):
        actual = getattr(arrivals, name).shape
        if actual != shape:
            raise InputError(f"{name}: shape is {actual}; allowed: {shape}")
    if (np.diff(arrivals.frame) < 0).any():
        raise InputError("frame: control frames of arrival must not fall")
    if frames < 1:
        raise InputError(f"frames: {frames} must be at least 1")
    demand = np.empty((frames, 3, 6))
    _run(dcu, state, arrivals, demand)
    return demand
