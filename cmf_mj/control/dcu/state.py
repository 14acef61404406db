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
from cmf_mj.core import quantity as kind
from cmf_mj.core.arrays import compiled_params, record_array, shaped
from cmf_mj.core.errors import InputError
from cmf_mj.core.filters import step_matrix
from cmf_mj.core.settings import Loader, Settings
from cmf_mj.core.units import FRAME, RATE


def _check_frames(quantity: kind.Quantity) -> kind.Quantity:
    kind.Kind(("1",), zero=True).check(quantity)
    if not (quantity.value.is_integer() and quantity.value <= 2048.0):
        raise InputError("must be a whole number of control frames, at most 2048")
    return quantity


LONGEST_TIMEOUT = 10.0  #: Longest silence that a DCU may wait for [s].

_SETTLING_RATIO = 10.0  #: How much faster than its correction the rate of the play clock settles.

_GAP_TIMES = 6.0  #: Rejoin time in units of 1 / w: (1 + x + x^2 / 2) e^-x is 0.062 there.

_Share = Annotated[kind.Quantity, AfterValidator(kind.Kind(("1",), at_most=0.9).check)]
_Frames = Annotated[kind.Quantity, AfterValidator(_check_frames)]


class DelayBreakdown(Settings):
    """Where the time from a host's stamp to the leg demand goes; `total` adds it up."""

    host_interval: kind.Time
    """Longest interval of the host for which the total holds: a frame waits for its successor."""
    interpolation_hold: kind.Wait  #: Wait beyond it: lateness of a frame that leaves no trace.
    smoothing: kind.Time  #: Delay of the filter of poses, which takes the place of the hold.
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
        """Every part at a control rate [Hz] in s, in signal order; at 2048 Hz of sum `total`."""
        return {
            "transmission": self.transmission.value / rate,
            "host_interval": self.host_interval.si,
            "interpolation_hold": self.interpolation_hold.si,
            "dcl_frame": self.dcl_frame.value / rate,
        }


class DcuLimits(Settings):
    """What a frame may hold, how gaps are closed and how silence ends; see `dcu.toml`."""

    pose_translation: kind.Length  #: Largest surge, sway and heave of a frame.
    pose_rotation: kind.Angle  #: Largest roll, pitch and yaw of a frame.
    velocity_translation: kind.Speed  #: Largest velocity of a frame and between frames.
    velocity_rotation: kind.AngularSpeed  #: Largest rate of an Euler angle of a frame and between.
    acceleration_translation: kind.Acceleration  #: Largest acceleration of a frame and between.
    acceleration_rotation: kind.AngularAcceleration  #: Largest second derivative of an Euler angle.
    overtravel_translation: kind.Length  #: How far the demand may go beyond `pose_translation`.
    overtravel_rotation: kind.Angle  #: How far the demand may go beyond `pose_rotation`.
    rejoin_velocity_translation: kind.Speed  #: Speed at which a gap of position is closed.
    rejoin_velocity_rotation: kind.AngularSpeed  #: Speed at which a gap of angle is closed.
    rejoin_time: kind.Time  #: Time in which a gap closes to 6 % of what it was: 6 / w.
    minimum_interval: kind.Time  #: Least difference of host times between accepted frames.
    timeout: kind.Time
    """Silence after which the stream is stale; longest gap between accepted frames; how long
    frame after frame may be late, or far ahead, before the play clock is set again."""
    stop_time: kind.Time  #: Time in which the velocity of an interrupted demand comes to rest.
    acceleration_fade: kind.Time  #: Time in which the acceleration of such a demand fades.
    clock_tolerance: kind.Wait  #: Mean lateness of the host that is left alone.
    clock_rate: _Share  #: Most by which the play clock runs fast or slow, at most 0.9.
    clock_time: kind.Time  #: Time constant Tc with which the play clock follows the host's.

    @model_validator(mode="after")
    def _check_times(self) -> "DcuLimits":
        if not self.minimum_interval.si < self.timeout.si <= LONGEST_TIMEOUT:
            raise InputError(
                f"timeout: {self.timeout.si} s must exceed minimum_interval, "
                f"{self.minimum_interval.si} s, and be at most {LONGEST_TIMEOUT} s"
            )
        if self.clock_time.si < 0.2:
            raise InputError(f"clock_time: {self.clock_time.si} s must be at least 0.2 s")
        return self

    def by_freedom(self, quantity: str) -> NDArray[np.float64]:
        """A quantity of all six degrees of freedom in SI, (6,), e.g. `velocity`."""
        kinds = ("translation", "rotation")
        values = [getattr(self, f"{quantity}_{suffix}").si for suffix in kinds]
        return np.repeat(values, 3)


class DcuSettings(Settings):
    """Everything a DCU is made of."""

    delay: DelayBreakdown  #: The delays and their sum.
    dcu: DcuLimits  #: Limits, recovery and clock.

    @model_validator(mode="after")
    def _check_delay(self) -> "DcuSettings":
        if self.delay.play_delay >= self.dcu.timeout.si:
            raise InputError(
                f"timeout: {self.dcu.timeout.si} s must exceed host_interval and "
                f"interpolation_hold together, {self.delay.play_delay} s"
            )
        return self


class Dcu(NamedTuple):
    """Compiled parameters, SI; six degrees of freedom in the order of a pose."""

    host_interval: float  #: Shortest wait of a frame for its successor [s].
    hold: float  #: Wait beyond that interval [s].
    pose: NDArray[np.float64]  #: Largest pose of a frame [m, rad], (6,).
    velocity: NDArray[np.float64]  #: Largest velocity of and between frames [m/s, rad/s], (6,).
    acceleration: NDArray[np.float64]  #: Largest acceleration likewise [m/s^2, rad/s^2], (6,).
    overtravel: NDArray[np.float64]  #: How far the demand may leave `pose` [m, rad], (6,).
    smoothing_delay: float  #: Delay D of the filter of poses [s].
    gap_rate: float  #: w of a gap [1/s].
    gap_range: NDArray[np.float64]  #: L, beyond which a gap closes at its speed [m, rad], (6,).
    closing: NDArray[np.float64]  #: Next gap and derivatives of these and of sat(gap), (3, 4).
    smoothing: NDArray[np.float64]  #: Next state of the Bessel filter of it and the pose, (4, 5).
    minimum_interval: float  #: Least time between frames [s].
    timeout: float  #: Silence until stale [s].
    stop_time: float  #: Time in which velocity comes to rest [s].
    fade_time: float  #: Time in which acceleration fades [s].
    clock_tolerance: float  #: Lateness left alone [s].
    clock_rate: float  #: Most by which the play clock runs fast or slow.
    clock_time: float  #: Time constant with which the play clock follows the host's [s].
    slew_time: float  #: Time constant that smooths the rate of the play clock [s].
    line_frames: int  #: Control frames in the transport line.
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
    gap_rate = _GAP_TIMES / limits.rejoin_time.si
    bounds = ("pose", "velocity", "acceleration", "overtravel")
    poles = bessel(4, 1.0, analog=True, output="zpk", norm="delay")[1] / delay.smoothing.si
    return compiled_params(
        Dcu,
        limits,
        **{quantity: limits.by_freedom(quantity) for quantity in bounds},
        host_interval=delay.host_interval.si,
        hold=delay.interpolation_hold.si,
        smoothing_delay=delay.smoothing.si,
        fade_time=limits.acceleration_fade.si,
        slew_time=limits.clock_time.si / _SETTLING_RATIO,
        line_frames=delay.line_frames,
        frame=frame,
        gap_rate=gap_rate,
        gap_range=3.0 * limits.by_freedom("rejoin_velocity") / gap_rate,
        closing=step_matrix([0.0, 3.0 * gap_rate**2, 3.0 * gap_rate], -(gap_rate**3), frame),
        smoothing=step_matrix(np.poly(poles)[:0:-1].real, np.prod(poles).real, frame),
    )


class Verdict(IntEnum):
    """What `receive` makes of a frame; reasons to refuse it in the order of the tests."""

    CANDIDATE = -2  #: Waits until a second frame confirms it.
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
    """What is counted besides refused frames."""

    accepted: int = 0  #: Accepted frames.
    late: int = 0  #: Accepted frames whose turn had begun.
    missing: int = 0  #: Sequence numbers that never came.
    resynchronised: int = 0  #: Starts of a stream, jumps followed and clocks set again.
    silent: int = 0  #: Streams lost by timeout.


class PlayClock(NamedTuple):
    """The clock by which frames are played, and the host's time beside it."""

    time: float = 0.0  #: Host time since the anchor that is played now [s].
    slew: float = 0.0  #: Rate of this clock less 1.
    slew_rate: float = 0.0  #: Derivative of the slew [1/s].
    drift: float = 0.0  #: Rate of the host's clock as known so far, less 1, negative.
    anchor: float = 0.0  #: Host time at which this clock reads 0 [s].
    lateness: float = 0.0  #: Mean lateness of the host [s].
    interval: float = 0.0  #: Mean interval of the host [s].


class Stream(NamedTuple):
    """The host's stream as accepted so far, and the buffer that holds its frames."""

    newest_time: float = 0.0  #: Host time of the newest accepted frame since the anchor [s].
    newest_interval: float = 0.0  #: Interval that ends with that frame [s]; 0 where it is unknown.
    silence: float = 0.0  #: Time since a frame was accepted [s].
    late_share: float = 0.0  #: Share of frames that came late, over a second.
    untimely_age: float = 0.0  #: Time since the first of the untimely frames in a row [s].
    misfit: float = 0.0  #: How little the derivatives of moving frames fit the poses, 0 to 1.
    is_synchronised: int = 0  #: 1 while a stream is being played.
    is_stale: int = 1  #: 1 from the timeout, and from the start, until a stream is taken up.
    newest_sequence: int = 0  #: Sequence number of the newest accepted frame.
    refusals: int = 0  #: Frames refused since that frame.
    is_untimely: int = 0  #: 1 while one frame after the other is late or far ahead.
    judged_frames: int = 0  #: Moving frames with derivatives compared with poses, at most 40.
    poses_alone: int = 0  #: 1 while derivatives are left aside.
    oldest_place: int = 0  #: Place of the oldest buffered frame.
    buffered_frames: int = 0  #: Number of buffered frames.


class Candidate(NamedTuple):
    """The frame that waits for a second one to confirm it."""

    time: float = 0.0  #: Its host time [s].
    age: float = 0.0  #: Time since it came [s].
    sequence: int = 0  #: Its sequence number.
    is_waiting: int = 0  #: 1 while there is such a frame.


class Playback(NamedTuple):
    """How far the demand is on its segment, a quintic between frames or a stop."""

    elapsed: float = 0.0  #: Time since the segment began [s].
    duration: float = 0.0  #: Length of the quintic [s].
    on_quintic: int = 0  #: 1 on a quintic, 0 on a stop.
    is_stop_of_oldest: int = 0  #: 1 if the stop comes from the oldest buffered frame.
    is_filtered: int = 0  #: 1 while the demand is that of the filter of poses.
    range_age: float = 0.0  #: Time since the present second of the host's range began [s].
    stray_frames: int = 0  #: Control frames for which the demand has been beyond that range.
    line_place: int = 0  #: Place in the transport line.


CAPACITY = 64  #: Frames the buffer holds.


class HostRange(NamedTuple):
    """Where the host has been in a second, every array (6,) [m, rad]."""

    lowest: NDArray[np.float64]  #: Lowest pose.
    highest: NDArray[np.float64]  #: Highest pose.
    stop_distance: NDArray[np.float64]  #: Longest way to stop.


class DcuState(NamedTuple):
    """State of a DCU; a motion (3, 6) is pose [m, rad], velocity and acceleration."""

    clock: np.recarray[Any, Any]  #: `PlayClock`, (1,).
    stream: np.recarray[Any, Any]  #: `Stream`, (1,).
    candidate: np.recarray[Any, Any]  #: `Candidate`, (1,).
    playback: np.recarray[Any, Any]  #: `Playback`, (1,).
    events: np.recarray[Any, Any]  #: Counts of `Events`, (1,).
    buffer_time: NDArray[np.float64]  #: Host times of buffered frames since the anchor [s], (64,).
    buffer_motion: NDArray[np.float64]  #: Motions of buffered frames, (64, 3, 6).
    buffer_jump: NDArray[np.int64]  #: 1 where a frame does not continue the one before it, (64,).
    candidate_motion: NDArray[np.float64]  #: Motion of the candidate, (3, 6).
    pose_step: NDArray[np.float64]  #: Newest accepted pose less the one before, (6,).
    polynomial: NDArray[np.float64]  #: Coefficients of the present quintic, (6, 6).
    stop_origin: NDArray[np.float64]  #: Motion from which the present stop began, (3, 6).
    gap: NDArray[np.float64]  #: Gap that is being closed, (3, 6).
    line_pose: NDArray[np.float64]  #: Pose at the play clock, straight between frames, (6,).
    filtered: NDArray[np.float64]  #: Bessel filter of it: pose and three derivatives, (4, 6).
    present_range: HostRange  #: Where the host has been in this second.
    previous_range: HostRange  #: Where it was in the second before.
    base: NDArray[np.float64]  #: Motion before the gap is added, (3, 6), workspace.
    motion: NDArray[np.float64]  #: Motion before limit and transport, (3, 6), workspace.
    transport_line: NDArray[np.float64]  #: Motions on their way to the DCL, (frames + 1, 3, 6).
    rejected: NDArray[np.int64]  #: Refused frames by `REASONS`.

    @property
    def rejections(self) -> dict[str, int]:
        """Refused frames by reason."""
        return dict(zip(REASONS, self.rejected.tolist(), strict=True))

    @property
    def counts(self) -> dict[str, int]:
        """Counts of `Events` by name."""
        return {name: int(self.events[0][name]) for name in Events._fields}


def resting(dcu: Dcu, pose: ArrayLike | None = None) -> DcuState:
    """State of a DCU that has had no frame and rests at a pose (6,), by default neutral."""
    start = np.zeros(6) if pose is None else shaped("pose", pose, 6)
    if (np.abs(start) > dcu.pose).any():
        raise InputError(f"pose: {start} is refused; allowed: within +-{dcu.pose} m, rad")
    at_rest = np.zeros((3, 6))
    at_rest[POSE] = start
    return DcuState(
        clock=record_array(PlayClock, [PlayClock(interval=dcu.host_interval)]),
        stream=record_array(Stream, [Stream()]),
        candidate=record_array(Candidate, [Candidate()]),
        playback=record_array(Playback, [Playback()]),
        events=record_array(Events, [Events()]),
        buffer_time=np.zeros(CAPACITY),
        buffer_motion=np.zeros((CAPACITY, 3, 6)),
        buffer_jump=np.zeros(CAPACITY, dtype=np.int64),
        candidate_motion=np.zeros((3, 6)),
        pose_step=np.zeros(6),
        polynomial=np.zeros((6, 6)),
        stop_origin=at_rest.copy(),
        gap=np.zeros((3, 6)),
        line_pose=start.copy(),
        filtered=np.vstack([at_rest, np.zeros(6)]),
        present_range=HostRange(start.copy(), start.copy(), np.zeros(6)),
        previous_range=HostRange(start.copy(), start.copy(), np.zeros(6)),
        base=np.zeros((3, 6)),
        motion=np.zeros((3, 6)),
        transport_line=np.tile(at_rest, (dcu.line_frames + 1, 1, 1)),
        rejected=np.zeros(len(REASONS), dtype=np.int64),
    )
