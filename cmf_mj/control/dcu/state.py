"""The DCU as data: settings, compiled parameters and state.

The delay from a host's stamp to the leg demand adds up,

    total = host interval + interpolation hold + (transmission + DCL frame) / control rate

and the report finds about 0.03 s (section 3.4.2).
"""

from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, model_validator
from scipy.signal import bessel

from cmf_mj.control.dcu.motion import POSE
from cmf_mj.core.arrays import compiled_params, record_array, shaped
from cmf_mj.core.errors import InputError
from cmf_mj.core.filters import chain
from cmf_mj.core.quantity import (
    Acceleration,
    Angle,
    AngularAcceleration,
    AngularSpeed,
    Kind,
    Length,
    Quantity,
    Speed,
    Time,
    Wait,
)
from cmf_mj.core.settings import Loader, Settings
from cmf_mj.core.units import FRAME, RATE


def _whole(quantity: Quantity) -> Quantity:
    Kind(("1",), zero=True).check(quantity)
    if not (quantity.value.is_integer() and quantity.value <= 2048.0):
        raise InputError("must be a whole number of control frames, at most 2048")
    return quantity


_Share = Annotated[Quantity, AfterValidator(Kind(("1",), at_most=0.9).check)]
_Frames = Annotated[Quantity, AfterValidator(_whole)]


class DelayBreakdown(Settings):
    """Where the time from a host's stamp to the leg demand goes; `total` adds it up."""

    host_interval: Time
    """Longest interval of the host for which the total holds: a frame waits for its successor.
    A host whose mean interval is longer waits for that instead."""
    interpolation_hold: Wait
    """Wait beyond the interval: what a frame may be late, or lost, without a trace."""
    smoothing: Time
    """Delay of the filter of poses whose derivatives are left aside, in place of the hold."""
    transmission: _Frames  #: Transport from the host to the DCU, whole control frames.
    dcl_frame: _Frames  #: From the DCU to the leg demand of the DCL, whole control frames.

    @property
    def play_delay(self) -> float:
        """From arrival of a frame to its turn in the interpolation [s]."""
        return self.host_interval.si + self.interpolation_hold.si

    @property
    def line_frames(self) -> int:
        """Control frames in the transport line."""
        return round(self.transmission.value + self.dcl_frame.value)

    @property
    def total(self) -> float:
        """From a host's stamp to the leg demand at 2048 Hz [s]."""
        return self.play_delay + self.line_frames * FRAME

    def parts(self, rate: int = RATE) -> dict[str, float]:
        """Every part at a control rate [Hz] in s, in the order of the signal.

        At 2048 Hz they add up to `total`.
        """
        return {
            "transmission": self.transmission.value / rate,
            "host_interval": self.host_interval.si,
            "interpolation_hold": self.interpolation_hold.si,
            "dcl_frame": self.dcl_frame.value / rate,
        }


class DcuLimits(Settings):
    """What a frame may hold, how gaps are closed and how silence ends; see `dcu.toml`."""

    pose_translation: Length  #: Largest surge, sway and heave of a frame.
    pose_rotation: Angle  #: Largest roll, pitch and yaw of a frame.
    velocity_translation: Speed  #: Largest translational velocity of a frame and between frames.
    velocity_rotation: AngularSpeed
    """Largest rate of an Euler angle of a frame and between frames."""
    acceleration_translation: Acceleration
    """Largest translational acceleration of a frame and between frames."""
    acceleration_rotation: AngularAcceleration
    """Largest second derivative of an Euler angle of a frame and between frames."""
    overtravel_translation: Length  #: How far the demand may go beyond `pose_translation`.
    overtravel_rotation: Angle  #: How far the demand may go beyond `pose_rotation`.
    rejoin_velocity_translation: Speed  #: Speed at which a gap of position is closed.
    rejoin_velocity_rotation: AngularSpeed  #: Speed at which a gap of angle is closed.
    rejoin_time: Time  #: Time in which a gap closes to 6 % of what it was: 6 / w.
    minimum_interval: Time  #: Least difference of host times between accepted frames.
    timeout: Time
    """Silence after which the stream is stale; longest gap between accepted frames; how long
    frame after frame may be late, or far ahead, before the play clock is set again."""
    stop_time: Time  #: Time in which the velocity of an interrupted demand comes to rest.
    acceleration_fade: Time  #: Time in which the acceleration of an interrupted demand has faded.
    clock_tolerance: Wait  #: Mean lateness of the host that is left alone.
    clock_rate: _Share  #: Most by which the play clock runs fast or slow, at most 0.9.
    clock_time: Time  #: Time constant Tc with which the play clock follows the host's.

    @model_validator(mode="after")
    def _consistent(self) -> "DcuLimits":
        if not self.minimum_interval.si < self.timeout.si <= MOST_TIMEOUT:
            raise InputError(
                f"timeout: {self.timeout.si} s must exceed minimum_interval, "
                f"{self.minimum_interval.si} s, and be at most {MOST_TIMEOUT} s"
            )
        if self.clock_time.si < 0.2:
            raise InputError(f"clock_time: {self.clock_time.si} s must be at least 0.2 s")
        return self

    def pair(self, name: str) -> NDArray[np.float64]:
        """A quantity of all six degrees of freedom in SI, (6,), e.g. `velocity`."""
        values = [getattr(self, f"{name}_{kind}").si for kind in ("translation", "rotation")]
        return np.repeat(values, 3)


_SMOOTHER = 10.0  #: How much faster than its correction the rate of the play clock settles.

_GAP_TIMES = 6.0  #: Rejoin time in units of 1 / w: (1 + x + x^2 / 2) e^-x is 0.062 there.

MOST_TIMEOUT = 10.0  #: Longest timeout [s].


class DcuSettings(Settings):
    """Everything a DCU is made of."""

    delay: DelayBreakdown  #: The delays and their sum.
    dcu: DcuLimits  #: Limits, recovery and clock.

    @model_validator(mode="after")
    def _in_time(self) -> "DcuSettings":
        if self.delay.play_delay >= self.dcu.timeout.si:
            raise InputError(
                f"timeout: {self.dcu.timeout.si} s must exceed host_interval and "
                f"interpolation_hold together, {self.delay.play_delay} s"
            )
        return self


class Dcu(NamedTuple):
    """Compiled parameters, SI; six degrees of freedom in the order of a pose."""

    host_interval: float  #: Shortest wait of a frame for its successor [s].
    hold: float  #: Wait beyond it [s].
    pose: NDArray[np.float64]  #: Largest pose of a frame [m, rad], (6,).
    velocity: NDArray[np.float64]
    """Largest velocity of a frame and between frames [m/s, rad/s], (6,)."""
    acceleration: NDArray[np.float64]
    """Largest acceleration of a frame and between frames [m/s^2, rad/s^2], (6,)."""
    overtravel: NDArray[np.float64]  #: How far the demand may leave `pose` [m, rad], (6,).
    smoothing_delay: float  #: Delay D of the filter of poses [s].
    gap_rate: float  #: w of a gap [1/s].
    gap_range: NDArray[np.float64]  #: L, beyond which a gap closes at its speed [m, rad], (6,).
    closing: NDArray[np.float64]
    """Gap and its derivatives a frame on, from themselves and the gap within +-L, (3, 4)."""
    smoothing: NDArray[np.float64]
    """Bessel filter a frame on, from its output, three derivatives and the pose, (4, 5)."""
    minimum_interval: float  #: Least time between frames [s].
    timeout: float  #: Silence until stale [s].
    stop_time: float  #: Time in which velocity comes to rest [s].
    fade_time: float  #: Time in which acceleration fades [s].
    clock_tolerance: float  #: Lateness left alone [s].
    clock_rate: float  #: Most by which the play clock runs fast or slow.
    clock_time: float  #: Time constant with which it follows the host's [s].
    slew_time: float  #: Time constant that smooths its rate [s].
    line: int  #: Control frames in the transport line.
    frame: float  #: T [s].


load_dcu = Loader(DcuSettings, Path(__file__).with_name("dcu.toml"), what="dcu")
"""Loads the settings of a DCU: `default`, or a file with numbers of `[delay]` and `[dcu]`."""


def make_dcu(source: str | Path | DcuSettings = "default", frame: float = FRAME) -> Dcu:
    """Compile the settings of a DCU for a control frame [s]; errors are those of `load_dcu`.

    Frames of the host must be at least two control frames apart.
    """
    settings = load_dcu(source)
    delay, limits = settings.delay, settings.dcu
    if not frame > 0.0:
        raise InputError(f"frame: {frame} s must be greater than 0")
    if limits.minimum_interval.si < 2.0 * frame:
        raise InputError(
            f"minimum_interval: {limits.minimum_interval.si} s must be at least two control "
            f"frames, {2.0 * frame} s"
        )
    rate = _GAP_TIMES / limits.rejoin_time.si
    poles = bessel(4, 1.0, analog=True, output="zpk", norm="delay")[1] / delay.smoothing.si
    return compiled_params(
        Dcu,
        limits,
        **{name: limits.pair(name) for name in ("pose", "velocity", "acceleration", "overtravel")},
        host_interval=delay.host_interval.si,
        hold=delay.interpolation_hold.si,
        smoothing_delay=delay.smoothing.si,
        fade_time=limits.acceleration_fade.si,
        slew_time=limits.clock_time.si / _SMOOTHER,
        line=delay.line_frames,
        frame=frame,
        gap_rate=rate,
        gap_range=3.0 * limits.pair("rejoin_velocity") / rate,
        closing=chain([0.0, 3.0 * rate**2, 3.0 * rate], -(rate**3), frame),
        smoothing=chain(np.poly(poles)[:0:-1].real, np.prod(poles).real, frame),
    )


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


CAPACITY = 64  #: Frames the buffer holds.


class HostRange(NamedTuple):
    """Where the host has been, every array (6,) [m, rad]."""

    least: NDArray[np.float64]  #: Least pose.
    most: NDArray[np.float64]  #: Largest pose.
    stop: NDArray[np.float64]  #: Longest way to stop.


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
    second: HostRange  #: Where the host has been in this second.
    earlier: HostRange  #: And in the one before.
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


def resting(dcu: Dcu, pose: ArrayLike | None = None) -> DcuState:
    """State of a DCU that has had no frame and rests at a pose (6,), by default neutral."""
    at = np.zeros(6) if pose is None else shaped("pose", pose, 6)
    if (np.abs(at) > dcu.pose).any():
        raise InputError(f"pose: {at} is refused; allowed: within +-{dcu.pose} m, rad")
    state = DcuState(
        clocks=record_array(Clocks, [Clocks(interval=dcu.host_interval)]),
        events=record_array(Events, [Events()]),
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
        second=HostRange(at.copy(), at.copy(), np.zeros(6)),
        earlier=HostRange(at.copy(), at.copy(), np.zeros(6)),
        base=np.zeros((3, 6)),
        motion=np.zeros((3, 6)),
        line=np.zeros((dcu.line + 1, 3, 6)),
        rejected=np.zeros(len(REASONS), dtype=np.int64),
    )
    state.origin[POSE] = at
    state.smoothed[POSE] = at
    state.line[:, POSE] = at
    return state
