"""Sensors of a machine: settings, `make_sensors`, `sensor_state`, and `sense` once a frame.

    truth (motion, pressures) -> leg accelerometer's gravity and swing -> channels -> readings

A channel reads, with the gain's error e, standard normal noise n (`noise`) and a first-order
low-pass H, bilinear and pre-warped to its corner,

    y = clip(step((1 + e) H(truth) + bias + sigma n)),    sigma^2 = density^2 rate / 2

A leg accelerometer feels, with n the unit vector along a leg of length L, and d `Sensors.distance`,

    f = d^2 l / dt^2 + g n . up - (L - d) |dn/dt|^2

The true motion, whose acceleration is one mechanical step late, and what is read are both
`LegFeedback`: accelerations are second derivatives of the extension until a sensor adds gravity.

The true motion comes from the extensions l[k] at t[k] that MuJoCo integrates. Its semi-implicit
step is a leapfrog with the mean velocity u[k] = (l[k] - l[k-1]) / h to the middle of the step.
Second order in h at t[k], the acceleration at t[k-1]:

    v[k] = u[k] + (u[k] - u[k-1]) / 2,    a[k-1] = (u[k] - u[k-1]) / h
"""

from pathlib import Path
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, model_validator

from cmf_mj.control.feedback import LegFeedback
from cmf_mj.core import filters
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Bias, Corner, Kind, Quantity
from cmf_mj.core.settings import Loader, Name, Settings
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.electronics.converter import in_steps
from cmf_mj.electronics.noise import four_normals, key_schedule, stream_key
from cmf_mj.machine import models
from cmf_mj.machine.leg_motion import (
    PoseTracker,
    TrackedPose,
    cosine_to_vertical,
    make_pose_tracker,
    track,
    tracked_pose,
)
from cmf_mj.machine.machine import Machine, load_machine

SENSOR_SETS = ("ideal", "noisy")  #: Names of the shipped sets.


def _magnitude(zero: bool = False) -> AfterValidator:
    """Validator of a number above 0, or from 0 on, in a unit that the channel checks."""
    return AfterValidator(lambda quantity: Kind((quantity.unit,), zero=zero).check(quantity))


class ChannelSettings(Settings):
    """One kind of sensor; what is left out is ideal."""

    lowest: Quantity | None = None  #: Least reading.
    highest: Quantity | None = None  #: Largest reading.
    bias: Quantity | None = None  #: Constant error, the same for all legs or axes.
    noise_density: Annotated[Quantity, _magnitude(zero=True)] | None = None
    """One-sided density of the white noise of the output, in the channel's unit per root hertz."""
    bandwidth: Corner | None = None  #: -3 dB corner of the first-order lag, below half the rate.
    resolution: Annotated[Quantity, _magnitude()] | None = None  #: Step between readings.
    gain_errors: list[Bias] = []  #: Relative error e, one a leg or axis; empty: exact.

    @model_validator(mode="after")
    def _consistent(self) -> "ChannelSettings":
        if self.lowest and self.highest and self.lowest.si >= self.highest.si:
            raise InputError(f"lowest: {self.lowest} must be less than highest, {self.highest}")
        return self

    def quantities(self) -> dict[str, Quantity]:
        """The numbers common to all legs or axes that are given, by name."""
        return {name: value for name, value in self if isinstance(value, Quantity)}


def _in_units(*units: str) -> AfterValidator:
    """Validator of a channel whose numbers are in one of these units."""

    def check(channel: ChannelSettings) -> ChannelSettings:
        for field, quantity in channel.quantities().items():
            allowed = units
            if field == "noise_density":
                allowed = tuple(f"{unit}/rtHz" for unit in units)
            if field != "bandwidth" and quantity.unit not in allowed:
                names = ", ".join(allowed)
                raise InputError(f"{field}: unit {quantity.unit!r} must be one of {names}")
        return channel

    return AfterValidator(check)


_Pressure = Annotated[ChannelSettings, _in_units("psi", "Pa")]


class SensorSettings(Settings):
    """A whole set of sensors."""

    name: Name  #: Name of the set.
    gravity: bool
    """Whether the leg accelerometers sit on the rods and feel gravity and swing (Appendix C).
    Otherwise they read the second derivative of the leg extension, as the report's non-linear model
    has it."""
    leg_position: Annotated[ChannelSettings, _in_units("in", "m")] = ChannelSettings()
    leg_velocity: Annotated[ChannelSettings, _in_units("in/s", "m/s")] = ChannelSettings()
    leg_acceleration: Annotated[ChannelSettings, _in_units("g", "in/s/s", "m/s/s")] = (
        ChannelSettings()
    )
    cap_pressure: _Pressure = ChannelSettings()
    rod_pressure: _Pressure = ChannelSettings()

    def quantities(self) -> dict[str, Quantity]:
        """The numbers of all channels, by channel and name."""
        channels = [(channel, getattr(self, channel).quantities()) for channel in CHANNELS]
        return {f"{name} {field}": x for name, numbers in channels for field, x in numbers.items()}


CHANNELS = tuple(name if "pressure" in name else f"leg_{name}" for name in LegFeedback._fields)
"""Kinds of sensors, fields of `SensorSettings` in the order of `LegFeedback`."""


load_sensors = Loader(
    SensorSettings,
    Path(__file__).with_name("sensors.toml"),
    what="sensors",
    names=SENSOR_SETS,
    default="ideal",
)
"""Loads a sensor set: `ideal`, `noisy`, or a file with `base` naming one of them and one table of
changes; channels are merged number by number."""


class SensorChannel(NamedTuple):
    """Compiled parameters of one kind of sensor, SI."""

    low_pass: NDArray[np.float64]  #: Sections (s, 6) of H; none for an unlimited bandwidth.
    gain: NDArray[np.float64]  #: 1 + e of each leg or axis, (n,); none where all are exact.
    lowest: float  #: Least reading [SI], -inf for none.
    highest: float  #: Largest reading [SI], inf for none.
    bias: float  #: [SI].
    deviation: float  #: Standard deviation sigma of the noise in one frame [SI].
    resolution: float  #: Step between readings [SI], 0 for none.
    keys: NDArray[np.uint64]  #: Philox keys of the ten rounds, (10, 2).


def make_channel(name: str, settings: ChannelSettings, rate: float, seed: int) -> SensorChannel:
    """Derive a channel from its settings for a rate of frames [Hz]; its name chooses the noise."""

    def number(field: str, default: float) -> float:
        quantity = getattr(settings, field)
        return default if quantity is None else float(quantity.si)

    corner = number("bandwidth", 0.0) / (2.0 * np.pi)
    return SensorChannel(
        low_pass=filters.low_pass(1 if corner else 0, corner, rate),
        gain=np.array([1.0 + error.si for error in settings.gain_errors]),
        lowest=number("lowest", -np.inf),
        highest=number("highest", np.inf),
        bias=number("bias", 0.0),
        deviation=number("noise_density", 0.0) * float(np.sqrt(rate / 2.0)),
        resolution=number("resolution", 0.0),
        keys=key_schedule(stream_key(seed, name)),
    )


@compiled
def read_channel(channel, state, frame, truth, reading):  # type: ignore[no-untyped-def]
    """Readings (n,) of a frame, whose number chooses the noise; `reading` may be `truth` itself."""
    count = truth.shape[0]
    filters.filter_all(channel.low_pass, state, truth, reading)
    if channel.gain.shape[0] > 0:
        for i in range(count):
            reading[i] *= channel.gain[i]
    if channel.bias != 0.0:
        for i in range(count):
            reading[i] += channel.bias
    if channel.deviation > 0.0:
        for group in range((count + 3) // 4):
            normals = four_normals(channel.keys, frame, group)
            for k in range(min(4, count - 4 * group)):
                reading[4 * group + k] += channel.deviation * normals[k]
    for i in range(count):
        if channel.resolution > 0.0:
            reading[i] = in_steps(reading[i], channel.resolution) * channel.resolution
        reading[i] = min(max(reading[i], channel.lowest), channel.highest)


class Sensors(NamedTuple):
    """Compiled parameters of all sensors."""

    channels: Any  #: `LegFeedback` of a `SensorChannel` each.
    gravity: bool  #: Whether the leg accelerometers feel gravity and swing.
    axes: PoseTracker
    distance: float  #: d, from an upper gimbal down to the accelerometer [m].
    rate: float  #: Frames a second [Hz].


class SensorState(NamedTuple):
    """States of the channels' filters, and directions of the legs."""

    filters: LegFeedback  #: (n, s, 2) each.
    legs: TrackedPose  #: The legs as tracked from true positions.
    direction_before: NDArray[np.float64]  #: Directions of the legs one frame ago, (6, 3).


def make_sensors(
    settings: SensorSettings, rate: float, seed: int = 0, machine: str | Machine = models.CMF
) -> Sensors:
    """Derive a machine's sensors from a set, for a rate of frames [Hz].

    Each channel has its own noise.
    """
    carrier = load_machine(machine)
    channels = [make_channel(name, getattr(settings, name), rate, seed) for name in CHANNELS]
    return Sensors(
        LegFeedback(*cast("Any", channels)),
        settings.gravity,
        make_pose_tracker(carrier),
        carrier.accelerometer_distance,
        rate,
    )


def sensor_state(sensors: Sensors, truth: LegFeedback) -> SensorState:
    """State of sensors that have seen the truth, (n,) each, at rest for a long time.

    Gravity on the legs needs six, at positions that a pose has.
    """
    count = truth.position.shape[0]
    for name, channel in zip(CHANNELS, sensors.channels, strict=True):
        gains = channel.gain.shape[0]
        if gains not in (0, count):
            raise InputError(f"{name}.gain_errors: {gains} are given; allowed: {count} or none")
    if sensors.gravity and truth.position.shape != (6,):
        text = f"shape is {truth.position.shape}; gravity along the legs needs (6,)"
        allowed = "electronics 'inertial', which feel none"
        raise InputError(f"position: {text}; allowed: {allowed}")
    legs = tracked_pose(sensors.axes, truth.position if sensors.gravity else np.zeros(6))
    gravity = [gravity_along(legs, leg) for leg in range(6)] if sensors.gravity else 0.0
    inputs = truth._replace(acceleration=truth.acceleration + gravity)
    pairs = zip(sensors.channels, inputs, strict=True)
    settled = (filters.settled_filter_state(channel.low_pass, values) for channel, values in pairs)
    return SensorState(LegFeedback(*settled), legs, legs.direction.copy())


@compiled
def true_velocity(mean, mean_before):  # type: ignore[no-untyped-def]
    """v[k] = (3 u[k] - u[k-1]) / 2 [m/s] from the mean velocities of the last two steps."""
    return 1.5 * mean - 0.5 * mean_before


@compiled
def true_acceleration(mean, mean_before, step):  # type: ignore[no-untyped-def]
    """a[k-1] = (u[k] - u[k-1]) / h [m/s^2], one step late, from the same."""
    return (mean - mean_before) / step


@compiled
def gravity_along(legs, leg):  # type: ignore[no-untyped-def]
    """Gravity g n . up [m/s^2] along a leg, which its accelerometer feels at rest."""
    return STANDARD_GRAVITY * cosine_to_vertical(legs, leg)


@compiled
def _feel_gravity(sensors, state, position, acceleration):  # type: ignore[no-untyped-def]
    """Add what leg accelerometers feel of gravity and swing at the true positions."""
    legs, direction_before = state.legs, state.direction_before
    track(sensors.axes, legs, position)
    for leg in range(6):
        squared_turn_rate = 0.0
        for i in range(3):
            turn_rate = (legs.direction[leg, i] - direction_before[leg, i]) * sensors.rate
            squared_turn_rate += turn_rate * turn_rate
            direction_before[leg, i] = legs.direction[leg, i]
        acceleration[leg] += gravity_along(legs, leg)
        acceleration[leg] -= (legs.length[leg] - sensors.distance) * squared_turn_rate


@compiled
def sense(sensors, state, frame, truth, reading):  # type: ignore[no-untyped-def]
    """One frame, whose number chooses the noise; `truth` and `reading` must be different arrays."""
    channels, states = sensors.channels, state.filters
    read_channel(channels.position, states.position, frame, truth.position, reading.position)
    read_channel(channels.velocity, states.velocity, frame, truth.velocity, reading.velocity)
    acceleration = reading.acceleration
    for leg in range(acceleration.shape[0]):
        acceleration[leg] = truth.acceleration[leg]
    if sensors.gravity:
        _feel_gravity(sensors, state, truth.position, acceleration)
    read_channel(channels.acceleration, states.acceleration, frame, acceleration, acceleration)
    cap, rod = truth.cap_pressure, truth.rod_pressure
    read_channel(channels.cap_pressure, states.cap_pressure, frame, cap, reading.cap_pressure)
    read_channel(channels.rod_pressure, states.rod_pressure, frame, rod, reading.rod_pressure)


@allocating
def at_frame(histories, frame):  # type: ignore[no-untyped-def]
    """The `LegFeedback` of one frame, as views of histories (N, n)."""
    return LegFeedback(
        histories.position[frame],
        histories.velocity[frame],
        histories.acceleration[frame],
        histories.cap_pressure[frame],
        histories.rod_pressure[frame],
    )


@allocating
def _sense_frames(sensors, state, truth, reading):  # type: ignore[no-untyped-def]
    for frame in range(truth.position.shape[0]):
        sense(sensors, state, frame, at_frame(truth, frame), at_frame(reading, frame))


def sense_history(sensors: Sensors, truth: LegFeedback) -> LegFeedback:
    """Readings of whole histories (N, n), frame 0 first, the sensors at rest before it."""
    histories = LegFeedback(*(np.array(c, dtype=float, order="C") for c in truth))
    state = sensor_state(sensors, LegFeedback(*(channel[0] for channel in histories)))
    reading = LegFeedback(*(np.empty_like(channel) for channel in histories))
    _sense_frames(sensors, state, histories, reading)
    return reading
