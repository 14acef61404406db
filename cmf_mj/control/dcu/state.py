"""State of the DCU: a few small arrays, indexed by the names below."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control.dcu.motion import (
    ACCELERATION,
    CURVE_PEAK_VELOCITY,
    FADE_PEAK_VELOCITY,
    POSE,
    SLOPE_PEAK_ACCELERATION,
    VELOCITY,
)
from cmf_mj.control.dcu.settings import Dcu
from cmf_mj.core.errors import InputError

REASONS = (
    "not_finite",
    "pose_range",
    "velocity_range",
    "acceleration_range",
    "sequence_jump",
    "repeated",
    "out_of_order",
    "time_reversed",
    "too_soon",
    "time_jump",
    "too_early",
    "unconfirmed",
)
"""Why a frame is refused, in the order of the tests; index of `DcuState.rejected`."""

(
    NOT_FINITE,
    POSE_RANGE,
    VELOCITY_RANGE,
    ACCELERATION_RANGE,
    SEQUENCE_JUMP,
    REPEATED,
    OUT_OF_ORDER,
    TIME_REVERSED,
    TOO_SOON,
    TIME_JUMP,
    TOO_EARLY,
    UNCONFIRMED,
) = range(len(REASONS))

ACCEPTED, HELD = -1, -2
"""Verdicts of `receive` beside the reasons: taken, or kept until a second frame confirms it."""

EVENTS = ("accepted", "late", "missing", "resynchronised", "silent")
"""What else is counted; index of `DcuState.events`.

accepted: frames taken. late: accepted frames whose turn had begun. missing: sequence numbers that
never came. resynchronised: starts of a stream, jumps followed and clocks set anew. silent: streams
lost by timeout.
"""

TAKEN, LATE, MISSING, RESYNCHRONISED, SILENT = range(len(EVENTS))

# Real numbers
(
    PLAY,  # play clock, host time since the anchor [s]
    SLEW,  # how much it runs fast
    SLEW_RATE,  # derivative of that [1/s]
    LATENESS,  # mean lateness of the host [s]
    INTERVAL,  # mean interval of the host [s]
    ANCHOR,  # host time at which the play clock reads 0 [s]
    NEWEST,  # host time of the newest accepted frame since the anchor [s]
    SILENCE,  # time since a frame was accepted [s]
    LOCAL,  # time since the present segment began [s]
    DURATION,  # length of the present quintic [s]
    SINCE_GAP,  # time since the gap was found [s]
    CLOSING,  # time in which the gap of position closes [s]
    HELD_TIME,  # host time of the frame held [s]
    HELD_AGE,  # time since it came [s]
    LATE_AGE,  # time since the first of the late frames in a row [s]
    REALS,
) = range(16)

# Whole numbers
(
    SYNCHRONISED,  # 1 while a stream is being played
    STALE,  # 1 from the timeout, and from the start, until a stream is taken up
    FIRST,  # place of the oldest buffered frame
    COUNT,  # buffered frames
    MOVING,  # 1 on a quintic, 0 on a stop
    USED,  # 1 if the stop comes from the oldest buffered frame
    SEQUENCE,  # number of the newest accepted frame
    REFUSED,  # frames refused since
    HOLDING,  # 1 while a frame waits for confirmation
    HELD_SEQUENCE,  # its number
    LATE_RUN,  # 1 while one frame after the other is late
    SLOT,  # place in the transport line
    WHOLES,
) = range(13)

CAPACITY = 64
"""Frames the buffer holds."""


class DcuState(NamedTuple):
    """State of a DCU; `real` and `whole` are indexed by the names of this module."""

    real: NDArray[np.float64]  #: Clocks and times, (15,).
    whole: NDArray[np.int64]  #: Flags and places, (12,).
    time: NDArray[np.float64]  #: Host times of buffered frames since the anchor [s], (64,).
    frame: NDArray[np.float64]  #: Buffered frames, (64, 3, 6): pose, velocity, acceleration.
    apart: NDArray[np.int64]
    """1 where a buffered frame does not continue the one before it, (64,)."""
    held: NDArray[np.float64]  #: The frame that waits for confirmation, (3, 6).
    polynomial: NDArray[np.float64]  #: Coefficients of the present quintic, (6, 6).
    origin: NDArray[np.float64]  #: Motion from which the present stop began, (3, 6).
    gap: NDArray[np.float64]  #: Gap that is being closed, (3, 6).
    base: NDArray[np.float64]  #: Motion before correction, (3, 6), workspace.
    motion: NDArray[np.float64]  #: Motion before limit and transport, (3, 6), workspace.
    line: NDArray[np.float64]  #: Transport line, (frames + 1, 3, 6).
    rejected: NDArray[np.int64]  #: Refused frames by `REASONS`.
    events: NDArray[np.int64]  #: Counts by `EVENTS`.

    @property
    def stale(self) -> bool:
        """Whether there is no stream: none yet, or silence beyond the timeout."""
        return bool(self.whole[STALE])

    @property
    def interval(self) -> float:
        """Mean interval of the host's frames [s]; beyond `host_interval` it adds to the delay."""
        return float(self.real[INTERVAL])

    @property
    def lateness(self) -> float:
        """Mean time by which frames come later than the play clock expects [s]."""
        return float(self.real[LATENESS])

    @property
    def rejections(self) -> dict[str, int]:
        """Refused frames by reason."""
        return dict(zip(REASONS, self.rejected.tolist(), strict=True))

    @property
    def counts(self) -> dict[str, int]:
        """What `EVENTS` lists."""
        return dict(zip(EVENTS, self.events.tolist(), strict=True))


def resting(dcu: Dcu, pose: ArrayLike | None = None) -> DcuState:
    """State of a DCU that has had no frame and rests at a pose.

    Args:
        dcu: compiled parameters.
        pose: (6,) [m, rad], z down; default neutral.

    Raises:
        InputError: the pose is not six finite numbers within the pose limits.
    """
    at = np.zeros(6) if pose is None else np.asarray(pose, dtype=float)
    if at.shape != (6,) or not (np.abs(at) <= dcu.pose).all():
        raise InputError(f"pose: {at} is refused; allowed: (6,) within +-{dcu.pose} m, rad")
    state = DcuState(
        real=np.zeros(REALS),
        whole=np.zeros(WHOLES, dtype=np.int64),
        time=np.zeros(CAPACITY),
        frame=np.zeros((CAPACITY, 3, 6)),
        apart=np.zeros(CAPACITY, dtype=np.int64),
        held=np.zeros((3, 6)),
        polynomial=np.zeros((6, 6)),
        origin=np.zeros((3, 6)),
        gap=np.zeros((3, 6)),
        base=np.zeros((3, 6)),
        motion=np.zeros((3, 6)),
        line=np.zeros((dcu.line + 1, 3, 6)),
        rejected=np.zeros(len(REASONS), dtype=np.int64),
        events=np.zeros(len(EVENTS), dtype=np.int64),
    )
    state.origin[POSE] = at
    state.line[:, POSE] = at
    state.real[CLOSING] = dcu.rejoin_time
    state.real[INTERVAL] = dcu.host_interval
    state.whole[STALE] = 1
    return state


def output_bounds(dcu: Dcu) -> NDArray[np.float64]:
    """Bounds of the demand whatever arrives, (3, 6): |pose|, |velocity|, |acceleration|.

    With V, A the limits of a frame, r the rejoin limits, Tv, Ta stop time and fade time, s the
    largest slew of the play clock, Ts its smoothing and m the overtravel:

        pose          P + m
        velocity      (1 + s) (V + 4/27 A Ta)  +  V + 0.0678 A Ta + Vr
        acceleration  (1 + s)^2 (1.5 V / Tv + A) + 2 s / Ts (V + 4/27 A Ta)
                      +  A + 3.95 V / Tv + Ar,  and 0.77 / m velocity^2 beyond P

    base first, correction after it. Every quintic between frames keeps V and A, every gap that is
    closed begins within V and A, so that the sums hold at any time.
    """
    fast = 1.0 + dcu.clock_rate
    base = dcu.velocity + FADE_PEAK_VELOCITY * dcu.acceleration * dcu.fade_time
    velocity = (
        fast * base
        + dcu.velocity
        + CURVE_PEAK_VELOCITY * dcu.acceleration * dcu.fade_time
        + dcu.rejoin_velocity
    )
    acceleration = (
        fast**2 * (1.5 * dcu.velocity / dcu.stop_time + dcu.acceleration)
        + 2.0 * dcu.clock_rate / dcu.slew_time * base
        + dcu.acceleration
        + SLOPE_PEAK_ACCELERATION * dcu.velocity / dcu.stop_time
        + dcu.rejoin_acceleration
    )
    bounds = np.empty((3, 6))
    bounds[POSE] = dcu.pose + dcu.overtravel
    bounds[VELOCITY] = velocity
    # tanh has the largest curvature 4 / (3 sqrt 3).
    bounds[ACCELERATION] = acceleration + 4.0 / np.sqrt(27.0) * velocity**2 / dcu.overtravel
    return bounds
