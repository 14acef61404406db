"""All sensors of a machine: `make_sensors`, `sensor_state`, and `sense` once a frame.

    truth (motion, pressures) -> leg accelerometer's gravity and swing -> channels -> readings

The true motion and what is read are both `LegFeedback`: accelerations are second derivatives of the
extension until a sensor adds what it feels of gravity.

The true motion comes from the extensions l[k] at t[k] that MuJoCo integrates. Its semi-implicit
step is a leapfrog with the mean velocity u[k] = (l[k] - l[k-1]) / h to the middle of the step.
Second order in h at t[k], the acceleration one mechanical step old:

    v[k] = u[k] + (u[k] - u[k-1]) / 2,    a[k-1] = (u[k] - u[k-1]) / h
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.feedback import LegFeedback
from cmf_mj.core import filters
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.electronics.channel import (
    CHANNELS,
    SensorChannel,
    SensorSettings,
    make_channel,
    read,
)
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

_FIELDS = {name.removeprefix("leg_"): name for name in CHANNELS}
"""Fields of `Sensors` and `SensorState` to channels."""

_STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, STANDARD_GRAVITY])
"""Angular velocity and specific force of a level platform at rest."""


class Sensors(NamedTuple):
    """Compiled parameters of all sensors."""

    position: SensorChannel
    velocity: SensorChannel
    acceleration: SensorChannel
    cap_pressure: SensorChannel
    rod_pressure: SensorChannel
    platform_gyro: SensorChannel
    platform_accelerometer: SensorChannel
    gravity: bool  #: Whether the leg accelerometers feel gravity and swing.
    axes: LegAxes
    distance: float  #: d, from an upper gimbal down to the accelerometer [m].
    rate: float  #: Frames a second [Hz].


class SensorState(NamedTuple):
    """States of the channels' filters (n, s, 2), and the legs as tracked."""

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    cap_pressure: NDArray[np.float64]
    rod_pressure: NDArray[np.float64]
    platform_gyro: NDArray[np.float64]
    platform_accelerometer: NDArray[np.float64]
    axes: LegAxesState
    before: NDArray[np.float64]  #: Directions of the legs one frame ago, (6, 3).


def make_sensors(
    settings: SensorSettings, rate: float, seed: int = 0, machine: str | Machine = models.CMF
) -> Sensors:
    """Derive a machine's sensors from a set, for a rate of frames [Hz].

    Each channel has its own noise.
    """
    carrier = load_machine(machine)
    channels = {
        field: make_channel(name, getattr(settings, name), rate, seed)
        for field, name in _FIELDS.items()
    }
    return Sensors(
        **channels,
        gravity=settings.gravity,
        axes=make_leg_axes(carrier),
        distance=carrier.accelerometer_distance,
        rate=rate,
    )


def sensor_state(
    sensors: Sensors,
    truth: LegFeedback,
    gyro: NDArray[np.float64] | None = None,
    accelerometer: NDArray[np.float64] | None = None,
) -> SensorState:
    """State of sensors that have seen the truth, (n,) each, at rest for a long time.

    The platform's angular velocity (3,) [rad/s] and specific force (3,) [m/s^2] are by default
    those of a level platform. Gravity on the legs needs six, at positions that a pose has.
    """
    for field, name in _FIELDS.items():
        gains = getattr(sensors, field).gain.shape[0]
        count = 3 if name.startswith("platform_") else truth.position.shape[0]
        if gains not in (0, count):
            raise InputError(f"{name}.gain_errors: {gains} are given; allowed: {count} or none")
    if sensors.gravity and truth.position.shape != (6,):
        raise InputError(
            f"position: shape is {truth.position.shape}; gravity along the legs needs (6,)"
        )
    axes = leg_axes_state(sensors.axes, truth.position if sensors.gravity else np.zeros(6))
    acceleration = np.array(truth.acceleration, dtype=float)
    if sensors.gravity:
        acceleration -= STANDARD_GRAVITY * axes.direction[:, 2]
    values = truth._asdict() | {
        "acceleration": acceleration,
        "platform_gyro": _STILL[:3] if gyro is None else gyro,
        "platform_accelerometer": _STILL[3:] if accelerometer is None else accelerometer,
    }
    filled = {
        field: filters.settled_filter(
            getattr(sensors, field).low_pass, np.asarray(values[field], float)
        )
        for field in _FIELDS
    }
    return SensorState(**filled, axes=axes, before=axes.direction.copy())


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
    """Leg sensors, one frame, whose number chooses the noise; truth and reading stay apart."""
    read(sensors.position, state.position, frame, truth.position, reading.position)
    read(sensors.velocity, state.velocity, frame, truth.velocity, reading.velocity)
    for leg in range(truth.acceleration.shape[0]):
        reading.acceleration[leg] = truth.acceleration[leg]
    if sensors.gravity:
        track(sensors.axes, state.axes, truth.position)
        for leg in range(6):
            turning = 0.0
            for i in range(3):
                change = (state.axes.direction[leg, i] - state.before[leg, i]) * sensors.rate
                turning += change * change
                state.before[leg, i] = state.axes.direction[leg, i]
            reading.acceleration[leg] += STANDARD_GRAVITY * upward(state.axes, leg)
            reading.acceleration[leg] -= (state.axes.length[leg] - sensors.distance) * turning
    read(
        sensors.acceleration, state.acceleration, frame, reading.acceleration, reading.acceleration
    )
    read(sensors.cap_pressure, state.cap_pressure, frame, truth.cap_pressure, reading.cap_pressure)
    read(sensors.rod_pressure, state.rod_pressure, frame, truth.rod_pressure, reading.rod_pressure)


@allocating
def sense_platform(sensors, state, frame, gyro, accelerometer, gyro_reading, accelerometer_reading):  # type: ignore[no-untyped-def]
    """Platform's rate gyros and accelerometers, one frame; (3,) each."""
    read(sensors.platform_gyro, state.platform_gyro, frame, gyro, gyro_reading)
    read(
        sensors.platform_accelerometer,
        state.platform_accelerometer,
        frame,
        accelerometer,
        accelerometer_reading,
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
def _histories(sensors, state, truth, reading, platform, platform_reading):  # type: ignore[no-untyped-def]
    for frame in range(truth.position.shape[0]):
        sense(sensors, state, frame, at_frame(truth, frame), at_frame(reading, frame))
        seen, felt = platform[frame], platform_reading[frame]
        sense_platform(sensors, state, frame, seen[:3], seen[3:], felt[:3], felt[3:])


def sense_history(
    sensors: Sensors, truth: LegFeedback, platform: NDArray[np.float64] | None = None
) -> tuple[LegFeedback, NDArray[np.float64]]:
    """Readings of whole histories (N, n), frame 0 first, the sensors at rest before it.

    Given and returned with it are angular velocity and specific force of the platform (N, 6), by
    default at rest.
    """
    histories = LegFeedback(*(np.array(c, dtype=float, order="C") for c in truth))
    first = LegFeedback(*(channel[0] for channel in histories))
    still = np.tile(_STILL, (histories.position.shape[0], 1))
    moving = still if platform is None else np.ascontiguousarray(platform)
    state = sensor_state(sensors, first, moving[0, :3], moving[0, 3:])
    reading, felt = LegFeedback(*(np.empty_like(c) for c in histories)), np.empty_like(moving)
    _histories(sensors, state, histories, reading, moving, felt)
    return reading, felt
