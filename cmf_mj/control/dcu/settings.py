"""Settings of the DCU: its delays, what it accepts and how it recovers.

The delay from a host's stamp to the leg demand adds up,

    total = host interval + interpolation hold + (transmission + DCL frame) / 2048 Hz

and the report finds about 0.03 s (section 3.4.2).
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo, field_validator, model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.rates import FRAME
from cmf_mj.core.settings import Loader, Settings


def _checked(quantity: Quantity, field: str, allowed: tuple[str, ...]) -> Quantity:
    if quantity.unit not in allowed:
        raise InputError(f"unit must be one of {', '.join(allowed)}")
    if field in ("interpolation_hold", "transmission", "dcl_frame", "clock_tolerance"):
        if quantity.value < 0.0:
            raise InputError(f"must be at least 0 {quantity.unit}")
    elif quantity.value <= 0.0:
        raise InputError(f"must be greater than 0 {quantity.unit}")
    return quantity


class DelayBreakdown(Settings):
    """Where the time from a host's stamp to the leg demand goes; `total` adds it up."""

    host_interval: Quantity
    """Longest interval of the host for which the total holds: a frame waits for its successor.
    A host whose mean interval is longer waits for that instead."""
    interpolation_hold: Quantity
    """Wait beyond the interval: what a frame may be late, or lost, without a trace."""
    transmission: Quantity  #: Transport from the host to the DCU, whole control frames.
    dcl_frame: Quantity  #: From the DCU to the leg demand of the DCL, whole control frames.

    @field_validator("*")
    @classmethod
    def _in_range(cls, quantity: Any, info: ValidationInfo) -> Any:
        field = str(info.field_name)
        whole = field in ("transmission", "dcl_frame")
        checked = _checked(quantity, field, ("1",) if whole else ("s",))
        if whole and not (checked.value.is_integer() and checked.value <= 2048.0):
            raise InputError("must be a whole number of control frames, at most 2048")
        return checked

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
        """From a host's stamp to the leg demand [s]."""
        return self.play_delay + self.line_frames * FRAME

    def parts(self) -> dict[str, float]:
        """Every part in s, in the order of the signal; they add up to `total`."""
        return {
            "transmission": self.transmission.value * FRAME,
            "host_interval": self.host_interval.si,
            "interpolation_hold": self.interpolation_hold.si,
            "dcl_frame": self.dcl_frame.value * FRAME,
        }


class DcuLimits(Settings):
    """What a frame may hold, how gaps are closed and how silence ends; see `dcu.toml`."""

    pose_translation: Quantity  #: Largest surge, sway and heave of a frame.
    pose_rotation: Quantity  #: Largest roll, pitch and yaw of a frame.
    velocity_translation: Quantity  #: Largest translational velocity of a frame and between frames.
    velocity_rotation: Quantity  #: Largest rate of an Euler angle of a frame and between frames.
    acceleration_translation: Quantity
    """Largest translational acceleration of a frame and between frames."""
    acceleration_rotation: Quantity
    """Largest second derivative of an Euler angle of a frame and between frames."""
    overtravel_translation: Quantity  #: How far the demand may go beyond `pose_translation`.
    overtravel_rotation: Quantity  #: How far the demand may go beyond `pose_rotation`.
    rejoin_velocity_translation: Quantity  #: Speed at which a gap of position is closed.
    rejoin_velocity_rotation: Quantity  #: Speed at which a gap of angle is closed.
    rejoin_acceleration_translation: Quantity
    """Acceleration with which a gap of position is closed."""
    rejoin_acceleration_rotation: Quantity  #: Acceleration with which a gap of angle is closed.
    rejoin_time: Quantity  #: Least time in which a gap is closed.
    minimum_interval: Quantity  #: Least difference of host times between accepted frames.
    timeout: Quantity
    """Silence after which the stream is stale; longest gap between accepted frames; how long
    frame after frame may be late before the play clock is set anew."""
    stop_time: Quantity  #: Time in which the velocity of an interrupted demand comes to rest.
    acceleration_fade: Quantity
    """Time in which the acceleration of an interrupted demand has faded."""
    clock_tolerance: Quantity  #: Mean lateness of the host that is left alone.
    clock_rate: Quantity  #: Most by which the play clock runs fast or slow.
    clock_time: Quantity  #: Time constant of the play clock's correction.

    @field_validator("*")
    @classmethod
    def _in_range(cls, quantity: Any, info: ValidationInfo) -> Any:
        field = str(info.field_name)
        if field == "clock_rate":
            units: tuple[str, ...] = ("1",)
        elif field.endswith("_translation"):
            units = _LINEAR[field.split("_")[-2]]
        elif field.endswith("_rotation"):
            units = _ANGULAR[field.split("_")[-2]]
        else:
            units = ("s",)
        return _checked(quantity, field, units)

    @model_validator(mode="after")
    def _consistent(self) -> "DcuLimits":
        if self.minimum_interval.si < 2.0 * FRAME:
            raise InputError(
                f"minimum_interval: {self.minimum_interval.si} s must be at least two control "
                f"frames, {2.0 * FRAME} s"
            )
        if not self.minimum_interval.si < self.timeout.si <= MOST_TIMEOUT:
            raise InputError(
                f"timeout: {self.timeout.si} s must exceed minimum_interval, "
                f"{self.minimum_interval.si} s, and be at most {MOST_TIMEOUT} s"
            )
        if self.clock_rate.value > 0.05:
            raise InputError(f"clock_rate: {self.clock_rate.value} must be at most 0.05")
        if self.clock_time.si < 1.0:
            raise InputError(f"clock_time: {self.clock_time.si} s must be at least 1 s")
        return self

    def pair(self, name: str) -> NDArray[np.float64]:
        """A quantity of all six degrees of freedom in SI, (6,), e.g. `velocity`."""
        values = [getattr(self, f"{name}_{kind}").si for kind in ("translation", "rotation")]
        return np.repeat(values, 3)


_SMOOTHER = 30.0
"""How much faster than its correction the rate of the play clock settles."""

MOST_TIMEOUT = 10.0
"""Longest timeout [s]."""

_LINEAR = {
    "pose": ("in", "m"),
    "overtravel": ("in", "m"),
    "velocity": ("in/s", "m/s"),
    "acceleration": ("g", "in/s^2", "m/s^2"),
}
_ANGULAR = {
    "pose": ("deg", "rad"),
    "overtravel": ("deg", "rad"),
    "velocity": ("deg/s", "rad/s"),
    "acceleration": ("deg/s^2", "rad/s^2"),
}


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
    rejoin_velocity: NDArray[np.float64]  #: Speed at which a gap closes [m/s, rad/s], (6,).
    rejoin_acceleration: NDArray[np.float64]
    """Acceleration with which a gap closes [m/s^2, rad/s^2], (6,)."""
    rejoin_time: float  #: Least time of closing a gap [s].
    minimum_interval: float  #: Least time between frames [s].
    timeout: float  #: Silence until stale [s].
    stop_time: float  #: Time in which velocity comes to rest [s].
    fade_time: float  #: Time in which acceleration fades [s].
    clock_tolerance: float  #: Lateness left alone [s].
    clock_rate: float  #: Most by which the play clock runs fast or slow.
    clock_time: float  #: Time constant of its correction [s].
    slew_time: float  #: Time constant that smooths its rate [s].
    line: int  #: Control frames in the transport line.


load_dcu = Loader(DcuSettings, Path(__file__).with_name("dcu.toml"), what="dcu")
"""Loads the settings of a DCU: `default`, or a file with numbers of `[delay]` and `[dcu]`."""


def make_dcu(source: str | Path | DcuSettings = "default") -> Dcu:
    """Compile the settings of a DCU; arguments and errors are those of `load_dcu`."""
    settings = load_dcu(source)
    delay, limits = settings.delay, settings.dcu
    return Dcu(
        host_interval=delay.host_interval.si,
        hold=delay.interpolation_hold.si,
        pose=limits.pair("pose"),
        velocity=limits.pair("velocity"),
        acceleration=limits.pair("acceleration"),
        overtravel=limits.pair("overtravel"),
        rejoin_velocity=limits.pair("rejoin_velocity"),
        rejoin_acceleration=limits.pair("rejoin_acceleration"),
        rejoin_time=limits.rejoin_time.si,
        minimum_interval=limits.minimum_interval.si,
        timeout=limits.timeout.si,
        stop_time=limits.stop_time.si,
        fade_time=limits.acceleration_fade.si,
        clock_tolerance=limits.clock_tolerance.si,
        clock_rate=limits.clock_rate.value,
        clock_time=limits.clock_time.si,
        slew_time=limits.clock_time.si / _SMOOTHER,
        line=delay.line_frames,
    )
