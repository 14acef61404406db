"""What may drive the cab: a host in aircraft mode or one in direct mode, at no more than 80 Hz.

In aircraft mode a host says what the pilot's station of an aircraft is subjected to, and a washout
makes platform motion of it; in direct mode it says platform pose, velocity and acceleration
itself (section 2.3.1). Anything with the one method of a mode is a host of that mode: a recorded
flight, an aircraft flown now, a stream of frames.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.stream import HostFrame, HostStream, make_stream
from cmf_mj.pilot.motion import PilotMotion

MOST_RATE = 80.0
"""Most frames a second a host may send [Hz] (section 2.3.1)."""


class PilotSample(NamedTuple):
    """One frame of a host in aircraft mode, SI, body axes x forward, y right, z down."""

    time: float  #: [s], rising.
    specific_force: NDArray[np.float64]
    """At the pilot's station, acceleration less gravity [m/s^2], (3,)."""
    angular_rate: NDArray[np.float64]  #: [rad/s], (3,).
    attitude: NDArray[np.float64]  #: Roll, pitch, yaw [rad], yaw without wrapping, (3,).


@runtime_checkable
class AircraftHost(Protocol):
    """A host in aircraft mode."""

    def samples(self) -> Iterator[PilotSample]:
        """What the pilot is subjected to, frame by frame at no more than 80 Hz."""
        ...


@runtime_checkable
class PlatformHost(Protocol):
    """A host in direct mode."""

    def frames(self) -> Iterator[HostFrame]:
        """Platform pose, velocity and acceleration, frame by frame at no more than 80 Hz."""
        ...


def pilot_samples(motion: PilotMotion) -> Iterator[PilotSample]:
    """The samples of a motion one by one."""
    columns = (motion.time, motion.specific_force, motion.angular_rate, motion.attitude)
    for time, force, rate, attitude in zip(*columns, strict=True):
        yield PilotSample(float(time), force, rate, attitude)


def pilot_motion(host: AircraftHost) -> PilotMotion:
    """All samples of a host in aircraft mode."""
    return PilotMotion(*_columns("samples", list(host.samples())))


def host_stream(host: PlatformHost) -> HostStream:
    """All frames of a host in direct mode."""
    sequence, *columns = _columns("frames", list(host.frames()))
    return make_stream(*columns, sequence=sequence)


def _columns(name: str, frames: Sequence[PilotSample | HostFrame]) -> list[NDArray[Any]]:
    if not frames:
        raise InputError(f"{name}: the host sends none; give at least one")
    span = frames[-1].time - frames[0].time
    if span > 0.0 and (len(frames) - 1) / span > MOST_RATE * (1.0 + 1e-6):
        rate = (len(frames) - 1) / span
        raise InputError(f"time: {rate:.5g} frames a second; allowed: at most {MOST_RATE:g}")
    return [np.array(column) for column in zip(*frames, strict=True)]
