"""Sensors of a machine: settings, noise, `make_sensors`, `sensor_state`, and `sense` once a frame.

    truth (motion, pressures) -> leg accelerometer's gravity and swing -> channels -> readings

The true motion and what is read are both `LegFeedback`: accelerations are second derivatives of the
extension until a sensor adds what it feels of gravity.

The true motion comes from the extensions l[k] at t[k] that MuJoCo integrates. Its semi-implicit
step is a leapfrog with the mean velocity u[k] = (l[k] - l[k-1]) / h to the middle of the step.
Second order in h at t[k], the acceleration one mechanical step old:

    v[k] = u[k] + (u[k] - u[k-1]) / 2,    a[k-1] = (u[k] - u[k-1]) / h
"""

import hashlib
from pathlib import Path
from typing import Annotated, Any, NamedTuple

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
from cmf_mj.machine import models
from cmf_mj.machine.leg_motion import (
    LegAxes,
    LegAxesState,
    leg_axes_state,
    make_leg_axes,
    track,
    upward,
)
from cmf_mj.machine.machine import Machine, load_machine

SENSOR_SETS = ("ideal", "noisy")  #: Names of the shipped sets.


def _in_own_unit(zero: bool = False) -> AfterValidator:
    """Validator of a size above 0, or from 0 on, in a unit that the channel checks."""
    return AfterValidator(lambda quantity: Kind((quantity.unit,), zero=zero).check(quantity))


class ChannelSettings(Settings):
    """One kind of sensor; what is left out is ideal."""

    lowest: Quantity | None = None  #: Least reading.
    highest: Quantity | None = None  #: Largest reading.
    bias: Quantity | None = None  #: Constant error, the same for all legs or axes.
    noise_density: Annotated[Quantity, _in_own_unit(zero=True)] | None = None
    """One-sided density of the white noise of the output, per root hertz."""
    bandwidth: Corner | None = None  #: -3 dB corner of the first-order lag, below half the rate.
    resolution: Annotated[Quantity, _in_own_unit()] | None = None  #: Step between readings.
    gain_errors: list[Bias] = []  #: Relative error of the gain, one a leg or axis; none for none.

    @model_validator(mode="after")
    def _consistent(self) -> "ChannelSettings":
        if self.lowest and self.highest and self.lowest.si >= self.highest.si:
            raise InputError(f"lowest: {self.lowest} must be less than highest, {self.highest}")
        return self

    def quantities(self) -> dict[str, Quantity]:
        """The numbers common to all legs or axes that are given, by name."""
        return {name: value for name, value in self if isinstance(value, Quantity)}


def _channel(*units: str) -> AfterValidator:
    """Validator of a channel whose numbers are in one of these units."""
    allowed = {field: units for field in ("lowest", "highest", "bias", "resolution")}
    allowed["noise_density"] = tuple(f"{unit}/rtHz" for unit in units)

    def check(channel: ChannelSettings) -> ChannelSettings:
        for field, known in allowed.items():
            quantity = getattr(channel, field)
            if quantity and quantity.unit not in known:
                raise InputError(
                    f"{field}: unit {quantity.unit!r} must be one of {', '.join(known)}"
                )
        return channel

    return AfterValidator(check)


_Pressure = Annotated[ChannelSettings, _channel("psi", "Pa")]


class SensorSettings(Settings):
    """A whole set of sensors."""

    name: Name  #: Name of the set.
    gravity: bool
    """Whether the leg accelerometers sit on the rods and feel gravity and swing (Appendix C).
    Otherwise they read the second derivative of the leg extension, as the report's non-linear model
    has it."""
    leg_position: Annotated[ChannelSettings, _channel("in", "m")] = ChannelSettings()
    leg_velocity: Annotated[ChannelSettings, _channel("in/s", "m/s")] = ChannelSettings()
    leg_acceleration: Annotated[ChannelSettings, _channel("g", "in/s/s", "m/s/s")] = (
        ChannelSettings()
    )
    cap_pressure: _Pressure = ChannelSettings()
    rod_pressure: _Pressure = ChannelSettings()

    def quantities(self) -> dict[str, Quantity]:
        """The numbers of all channels, by channel and name."""
        numbers = {channel: getattr(self, channel).quantities() for channel in CHANNELS}
        return {f"{c} {name}": one for c, given in numbers.items() for name, one in given.items()}


CHANNELS = tuple(SensorSettings.model_fields)[2:]
"""Kinds of sensors, in the order of `LegFeedback`."""


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
    lowest: float  #: Least reading, -inf for none.
    highest: float  #: Largest reading, inf for none.
    bias: float
    deviation: float  #: Standard deviation sigma of the noise in one frame.
    resolution: float  #: Step between readings, 0 for none.
    keys: NDArray[np.uint64]  #: Round keys of the noise, (10, 2).


def make_channel(name: str, settings: ChannelSettings, rate: float, seed: int) -> SensorChannel:
    """Derive a channel from its settings for a rate of frames [Hz]; its name chooses the noise."""

    def size(field: str, absent: float) -> float:
        quantity = getattr(settings, field)
        return absent if quantity is None else float(quantity.si)

    corner = size("bandwidth", 0.0) / (2.0 * np.pi)
    return SensorChannel(
        low_pass=filters.low_pass(1 if corner else 0, corner, rate),
        gain=np.array([1.0 + error.si for error in settings.gain_errors]),
        lowest=size("lowest", -np.inf),
        highest=size("highest", np.inf),
        bias=size("bias", 0.0),
        deviation=size("noise_density", 0.0) * float(np.sqrt(rate / 2.0)),
        resolution=size("resolution", 0.0),
        keys=key_schedule(stream_key(seed, name)),
    )


@compiled
def read(channel, state, frame, truth, reading):  # type: ignore[no-untyped-def]
    """Readings (n,) of one frame, whose number chooses the noise; may overwrite the truth."""
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


_ROUNDS = 10
_WEYL = (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B)
_FIRST = np.uint64(0xD2E7470EE14C6C93)
_SECOND = np.uint64(0xCA5A826395121157)
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_SPARE = np.uint64(11)
_UNIT = 2.0**-53
_NONE = np.uint64(0)


def stream_key(seed: int, channel: str) -> tuple[int, int]:
    """Key of a channel's stream: the seed, 0 to 2^64 - 1, and 64 bits of its name's SHA-256."""
    if not 0 <= seed < 2**64:
        raise InputError(f"seed: {seed} must be between 0 and 2^64 - 1")
    return seed, int.from_bytes(hashlib.sha256(channel.encode()).digest()[:8], "little")


def key_schedule(key: tuple[int, int]) -> NDArray[np.uint64]:
    """Keys of the ten rounds, (10, 2)."""
    rows = [
        [(part + i * weyl) % 2**64 for part, weyl in zip(key, _WEYL, strict=True)]
        for i in range(_ROUNDS)
    ]
    return np.array(rows, dtype=np.uint64)


@compiled
def _product(one, two):  # type: ignore[no-untyped-def]
    """High and low word of a product of two words, from products of halves: nothing overflows."""
    a, b = one >> _HALF, one & _LOW
    c, d = two >> _HALF, two & _LOW
    low = b * d
    cross = a * d + (low >> _HALF)
    middle = b * c + (cross & _LOW)
    return a * c + (cross >> _HALF) + (middle >> _HALF), (middle << _HALF) | (low & _LOW)


@compiled
def block(keys, first, second):  # type: ignore[no-untyped-def]
    """Four words of the counter (first, second, 0, 0), lowest word first."""
    c0, c1, c2, c3 = first, second, _NONE, _NONE
    for i in range(keys.shape[0]):
        high0, low0 = _product(_FIRST, c0)
        high1, low1 = _product(_SECOND, c2)
        c0, c1, c2, c3 = high1 ^ c1 ^ keys[i, 0], low1, high0 ^ c3 ^ keys[i, 1], low0
    return c0, c1, c2, c3


@compiled
def _pair(one, two):  # type: ignore[no-untyped-def]
    radius = np.sqrt(-2.0 * np.log((np.float64(one >> _SPARE) + 1.0) * _UNIT))
    angle = 2.0 * np.pi * np.float64(two >> _SPARE) * _UNIT
    return radius * np.cos(angle), radius * np.sin(angle)


@compiled
def four_normals(keys, frame, group):  # type: ignore[no-untyped-def]
    """Standard normals of the components 4 group to 4 group + 3 at a frame."""
    w0, w1, w2, w3 = block(keys, np.uint64(frame), np.uint64(group))
    n0, n1 = _pair(w0, w1)
    n2, n3 = _pair(w2, w3)
    return n0, n1, n2, n3


class Sensors(NamedTuple):
    """Compiled parameters of all sensors."""

    channels: Any  #: `LegFeedback` of a `SensorChannel` each.
    gravity: bool  #: Whether the leg accelerometers feel gravity and swing.
    axes: LegAxes
    distance: float  #: d, from an upper gimbal down to the accelerometer [m].
    rate: float  #: Frames a second [Hz].


class SensorState(NamedTuple):
    """States of the channels' filters, and the legs as tracked."""

    filters: LegFeedback  #: (n, s, 2) each.
    axes: LegAxesState
    before: NDArray[np.float64]  #: Directions of the legs one frame ago, (6, 3).


def make_sensors(
    settings: SensorSettings, rate: float, seed: int = 0, machine: str | Machine = models.CMF
) -> Sensors:
    """Derive a machine's sensors from a set, for a rate of frames [Hz].

    Each channel has its own noise.
    """
    carrier = load_machine(machine)
    channels: Any = [make_channel(c, getattr(settings, c), rate, seed) for c in CHANNELS]
    return Sensors(
        LegFeedback(*channels),
        settings.gravity,
        make_leg_axes(carrier),
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
        raise InputError(
            f"position: shape is {truth.position.shape}; gravity along the legs needs (6,); "
            "allowed: electronics 'inertial', which feel none"
        )
    axes = leg_axes_state(sensors.axes, truth.position if sensors.gravity else np.zeros(6))
    felt = -STANDARD_GRAVITY * axes.direction[:, 2] if sensors.gravity else 0.0
    values = truth._replace(acceleration=truth.acceleration + felt)
    return SensorState(
        LegFeedback(
            *(
                filters.settled_filter(channel.low_pass, value)
                for channel, value in zip(sensors.channels, values, strict=True)
            )
        ),
        axes,
        axes.direction.copy(),
    )


@compiled
def true_velocity(mean, mean_before):  # type: ignore[no-untyped-def]
    """v[k] [m/s] from the mean velocities of the last two steps."""
    return 1.5 * mean - 0.5 * mean_before


@compiled
def true_acceleration(mean, mean_before, step):  # type: ignore[no-untyped-def]
    """a[k-1] [m/s^2] from the mean velocities of the last two steps."""
    return (mean - mean_before) / step


@compiled
def sense(sensors, state, frame, truth, reading):  # type: ignore[no-untyped-def]
    """One frame, whose number chooses the noise; truth and reading stay apart."""
    channels, passed = sensors.channels, state.filters
    read(channels.position, passed.position, frame, truth.position, reading.position)
    read(channels.velocity, passed.velocity, frame, truth.velocity, reading.velocity)
    felt = reading.acceleration
    for leg in range(felt.shape[0]):
        felt[leg] = truth.acceleration[leg]
    if sensors.gravity:
        track(sensors.axes, state.axes, truth.position)
        for leg in range(6):
            turning = 0.0
            for i in range(3):
                change = (state.axes.direction[leg, i] - state.before[leg, i]) * sensors.rate
                turning += change * change
                state.before[leg, i] = state.axes.direction[leg, i]
            felt[leg] += STANDARD_GRAVITY * upward(state.axes, leg)
            felt[leg] -= (state.axes.length[leg] - sensors.distance) * turning
    read(channels.acceleration, passed.acceleration, frame, felt, felt)
    read(
        channels.cap_pressure, passed.cap_pressure, frame, truth.cap_pressure, reading.cap_pressure
    )
    read(
        channels.rod_pressure, passed.rod_pressure, frame, truth.rod_pressure, reading.rod_pressure
    )


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
def _histories(sensors, state, truth, reading):  # type: ignore[no-untyped-def]
    for frame in range(truth.position.shape[0]):
        sense(sensors, state, frame, at_frame(truth, frame), at_frame(reading, frame))


def sense_history(sensors: Sensors, truth: LegFeedback) -> LegFeedback:
    """Readings of whole histories (N, n), frame 0 first, the sensors at rest before it."""
    histories = LegFeedback(*(np.array(c, dtype=float, order="C") for c in truth))
    state = sensor_state(sensors, LegFeedback(*(channel[0] for channel in histories)))
    reading = LegFeedback(*(np.empty_like(channel) for channel in histories))
    _histories(sensors, state, histories, reading)
    return reading
