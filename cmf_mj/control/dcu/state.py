"""State of the DCU: a few small arrays, and records with named fields."""

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control.dcu.motion import POSE
from cmf_mj.control.dcu.settings import Dcu
from cmf_mj.core.errors import InputError


class Verdict(IntEnum):
    """What `receive` makes of a frame: taken, kept, or refused, in the order of the tests."""

    HELD = -2  #: Kept until a second frame confirms it.
    ACCEPTED = -1
    NOT_FINITE = 0
    POSE_RANGE = 1
    VELOCITY_RANGE = 2
    ACCELERATION_RANGE = 3
    SEQUENCE_JUMP = 4
    REPEATED = 5
    OUT_OF_ORDER = 6
    TIME_REVERSED = 7
    TOO_SOON = 8
    TIME_JUMP = 9
    TOO_EARLY = 10
    UNCONFIRMED = 11


REASONS = tuple(verdict.name.lower() for verdict in sorted(Verdict) if verdict >= 0)
"""Why a frame is refused; index of `DcuState.rejected`."""


class Events(NamedTuple):
    """What else is counted, besides refused frames."""

    accepted: int = 0  #: Frames taken.
    late: int = 0  #: Accepted frames whose turn had begun.
    missing: int = 0  #: Sequence numbers that never came.
    resynchronised: int = 0  #: Starts of a stream, jumps followed and clocks set again.
    silent: int = 0  #: Streams lost by timeout.


class Clocks(NamedTuple):
    """Clocks, flags and places."""

    play: float = 0.0  #: Play clock, host time since the anchor [s].
    slew: float = 0.0  #: How much it runs fast.
    slew_rate: float = 0.0  #: Derivative of that [1/s].
    lateness: float = 0.0  #: Mean lateness of the host [s].
    interval: float = 0.0  #: Mean interval of the host [s].
    anchor: float = 0.0  #: Host time at which the play clock reads 0 [s].
    newest: float = 0.0  #: Host time of the newest accepted frame since the anchor [s].
    silence: float = 0.0  #: Time since a frame was accepted [s].
    local: float = 0.0  #: Time since the present segment began [s].
    duration: float = 0.0  #: Length of the present quintic [s].
    drift: float = 0.0  #: Rate of the host's clock as known so far, less 1, negative.
    misfit: float = 0.0  #: How little the derivatives of moving frames fit the poses, 0 to 1.
    late_share: float = 0.0  #: Share of frames that came late, over a second.
    window: float = 0.0  #: Time since the present second of the host's range began [s].
    before: float = 0.0  #: Interval from the frame before the newest accepted one [s].
    held_time: float = 0.0  #: Host time of the frame held [s].
    held_age: float = 0.0  #: Time since it came [s].
    late_age: float = 0.0  #: Time since the first of the untimely frames in a row [s].
    synchronised: int = 0  #: 1 while a stream is being played.
    stale: int = 1  #: 1 from the timeout, and from the start, until a stream is taken up.
    first: int = 0  #: Place of the oldest buffered frame.
    buffered: int = 0  #: Number of buffered frames.
    moving: int = 0  #: 1 on a quintic, 0 on a stop.
    used: int = 0  #: 1 if the stop comes from the oldest buffered frame.
    sequence: int = 0  #: Number of the newest accepted frame.
    refused: int = 0  #: Frames refused since.
    holding: int = 0  #: 1 while a frame waits for confirmation.
    held_sequence: int = 0  #: Its number.
    late_run: int = 0  #: 1 while one frame after the other is late or far ahead.
    judged: int = 0  #: Moving frames whose derivatives were compared with the poses, at most 40.
    poses: int = 0  #: 1 while derivatives are left aside.
    smoothing: int = 0  #: 1 while the demand is that of the filter of poses.
    beyond: int = 0  #: Control frames for which the demand has been beyond the host's range.
    slot: int = 0  #: Place in the transport line.


CAPACITY = 64
"""Frames the buffer holds."""


class DcuState(NamedTuple):
    """State of a DCU."""

    clocks: np.recarray[Any, Any]  #: `Clocks`, (1,).
    events: np.recarray[Any, Any]  #: Counts of `Events`, (1,).
    time: NDArray[np.float64]  #: Host times of buffered frames since the anchor [s], (64,).
    frame: NDArray[np.float64]  #: Buffered frames, (64, 3, 6): pose, velocity, acceleration.
    apart: NDArray[np.int64]
    """1 where a buffered frame does not continue the one before it, (64,)."""
    held: NDArray[np.float64]  #: The frame that waits for confirmation, (3, 6).
    polynomial: NDArray[np.float64]  #: Coefficients of the present quintic, (6, 6).
    origin: NDArray[np.float64]  #: Motion from which the present stop began, (3, 6).
    gap: NDArray[np.float64]  #: Gap that is being closed, (3, 6).
    input: NDArray[np.float64]  #: Pose at the play clock, straight between frames, (6,).
    smoothed: NDArray[np.float64]  #: Bessel filter of it: pose and three derivatives, (4, 6).
    step: NDArray[np.float64]  #: Newest accepted pose less the one before, (6,).
    range: NDArray[np.float64]
    """Of this second and the one before: least and largest pose and the way to stop, (2, 3, 6)."""
    base: NDArray[np.float64]  #: Motion before correction, (3, 6), workspace.
    motion: NDArray[np.float64]  #: Motion before limit and transport, (3, 6), workspace.
    line: NDArray[np.float64]  #: Transport line, (frames + 1, 3, 6).
    rejected: NDArray[np.int64]  #: Refused frames by `REASONS`.

    @property
    def rejections(self) -> dict[str, int]:
        """Refused frames by reason."""
        return dict(zip(REASONS, self.rejected.tolist(), strict=True))

    @property
    def counts(self) -> dict[str, int]:
        """Counts of `Events` by name."""
        return dict(zip(Events._fields, self.events[0].item(), strict=True))


def _record(values: NamedTuple) -> np.recarray[Any, Any]:
    """One record with the fields, their types and values of a named tuple, (1,)."""
    fields = [(name, type(value)) for name, value in values._asdict().items()]
    return np.array([tuple(values)], dtype=fields).view(np.recarray)


def resting(dcu: Dcu, pose: ArrayLike | None = None) -> DcuState:
    """State of a DCU that has had no frame and rests at a pose (6,), by default neutral."""
    at = np.zeros(6) if pose is None else np.asarray(pose, dtype=float)
    if at.shape != (6,) or not (np.abs(at) <= dcu.pose).all():
        raise InputError(f"pose: {at} is refused; allowed: (6,) within +-{dcu.pose} m, rad")
    state = DcuState(
        clocks=_record(Clocks(interval=dcu.host_interval)),
        events=_record(Events()),
        time=np.zeros(CAPACITY),
        frame=np.zeros((CAPACITY, 3, 6)),
        apart=np.zeros(CAPACITY, dtype=np.int64),
        held=np.zeros((3, 6)),
        polynomial=np.zeros((6, 6)),
        origin=np.zeros((3, 6)),
        gap=np.zeros((3, 6)),
        input=at.copy(),
        smoothed=np.zeros((4, 6)),
        step=np.zeros(6),
        range=np.zeros((2, 3, 6)),
        base=np.zeros((3, 6)),
        motion=np.zeros((3, 6)),
        line=np.zeros((dcu.line + 1, 3, 6)),
        rejected=np.zeros(len(REASONS), dtype=np.int64),
    )
    state.origin[POSE] = at
    state.smoothed[POSE] = at
    state.range[:, :2] = at
    state.line[:, POSE] = at
    return state
