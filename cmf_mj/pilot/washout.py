"""From the motion at a pilot's station in flight to frames of a host.

With f the specific force and w the angular rate at the station in flight, K gains and lim limits,

    f1 = lim(K f (f - f0)) + f0,    f0 = (0, 0, -g),    w1 = lim(K w w)

are what the algorithm takes in. It gives the attitude A of the simulator and the displacement d of
the pilot's station in it, each with two derivatives. The platform's centroid then moves so that the
station at the lever arm r does that, with T from simulator to inertial axes and w from here on the
simulator's angular velocity:

    p = d - (T - 1) r,    p' = d' - T (w x r),    p'' = d'' - T (w' x r + w x (w x r))

The platform turns about the pilot's head, not about its centroid, which would push the head the
wrong way at each onset of tilt. A station of (0, 0, 0) turns it about the centroid.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.arrays import shaped
from cmf_mj.core.compiled import allocating
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.host.stream import HostFrame, HostStream, make_stream
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.kinematics import rotation
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.classical import Classical, HeadMotion, Sample, make_classical
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion, body_rates, interpolated
from cmf_mj.pilot.optimal import Optimal, make_optimal
from cmf_mj.pilot.predictive import Predictive, Solves
from cmf_mj.pilot.washout_settings import (
    ClassicalSettings,
    PredictiveSettings,
    WashoutSettings,
    load_washout,
)

_SOLVER_SHARE = 0.5  #: Share of a live frame that the solver may take.
_WARM_FRAMES = 3  #: Frames before the first.
_REST = np.array([0.0, 0.0, -STANDARD_GRAVITY])  #: f0 [m/s^2].


class RunningWashout(NamedTuple):
    """What all washouts have at work; sample and head are overwritten by each frame."""

    gain: NDArray[np.float64]  #: Gains of specific force and angular rate, (6,).
    force_limit: float  #: [m/s^2].
    rate_limit: float  #: [rad/s].
    station: NDArray[np.float64]  #: r [m], (3,).
    interval: float  #: Between samples [s].
    head: HeadMotion
    sample: Sample


@allocating
def write_scaled(running, specific_force, angular_rate, force, rate):  # type: ignore[no-untyped-def]
    """Write f1 and w1, (3,) each."""
    beyond_rest = running.gain[:3] * (specific_force - _REST)
    force[:] = _REST + np.clip(beyond_rest, -running.force_limit, running.force_limit)
    rate[:] = np.clip(running.gain[3:] * angular_rate, -running.rate_limit, running.rate_limit)


@allocating
def write_euler_rates(roll, pitch, rate, euler_rates):  # type: ignore[no-untyped-def]
    """Write the Euler rates (3,) of an angular velocity (3,) in body axes."""
    level_yaw_rate = rate[1] * np.sin(roll) + rate[2] * np.cos(roll)
    euler_rates[0] = rate[0] + level_yaw_rate * np.tan(pitch)
    euler_rates[1] = rate[1] * np.cos(roll) - rate[2] * np.sin(roll)
    euler_rates[2] = level_yaw_rate / np.cos(pitch)


@allocating
def place_platform(running, motion):  # type: ignore[no-untyped-def]
    """Write pose, velocity and acceleration of the centroid, (3, 6)."""
    station, angular, linear = running.station, running.head.angular, running.head.linear
    omega, alpha = np.empty(3), np.empty(3)
    body_rates(angular[0], angular[1], angular[2], omega, alpha)
    to_inertial = rotation(angular[0, 0], angular[0, 1], angular[0, 2])
    velocity = np.cross(omega, station)
    motion[0, :3] = linear[0] - (to_inertial @ station - station)
    motion[1, :3] = linear[1] - to_inertial @ velocity
    acceleration = np.cross(alpha, station) + np.cross(omega, velocity)
    motion[2, :3] = linear[2] - to_inertial @ acceleration
    motion[:, 3:] = angular


@allocating
def predicted_attitude(running):  # type: ignore[no-untyped-def]
    """Roll and pitch at this frame, but for terms of third order in the interval."""
    span, angular = running.interval, running.head.angular
    roll = angular[0, 0] + span * (angular[1, 0] + 0.5 * span * angular[2, 0])
    pitch = angular[0, 1] + span * (angular[1, 1] + 0.5 * span * angular[2, 1])
    return roll, pitch


@allocating
def write_sample(running, specific_force, angular_rate):  # type: ignore[no-untyped-def]
    """Make the sample of a specific force and an angular rate at the pilot's station, (3,)."""
    sample, rate = running.sample, np.empty(3)
    last_euler_rates = sample.euler_rates.copy()
    write_scaled(running, specific_force, angular_rate, sample.force, rate)
    roll, pitch = predicted_attitude(running)
    write_euler_rates(roll, pitch, rate, sample.euler_rates)
    sample.slopes[:] = (sample.euler_rates - last_euler_rates) / running.interval


@allocating
def write_inputs(running, known):  # type: ignore[no-untyped-def]
    """Overwrite specific forces and angular rates (K, 6) by `Sample.inputs` of each."""
    force, rate = np.empty(3), np.empty(3)
    roll, pitch = predicted_attitude(running)
    for row in range(known.shape[0]):
        write_scaled(running, known[row, :3], known[row, 3:], force, rate)
        write_euler_rates(roll, pitch, rate, known[row, :3])
        force[2] += STANDARD_GRAVITY
        known[row, 3:] = force


class Washout:
    """A washout at work, frame by frame or on a whole flight.

    It starts as if the first sample had lasted for a long time: tilted for a sustained specific
    force, at rest.
    """

    def __init__(
        self,
        settings: str | WashoutSettings = "simona",
        *,
        cab: str | Path | Cab | None = None,
        rate: float = MOST_RATE,
        limits: MotionLimits | None = None,
        lead: float = 0.0,
    ) -> None:
        """Discretise the filters of a set by name, TOML file or loaded parameters.

        `rate` is in frames a second [Hz]. A predictive washout knows the legs of the cab's machine
        and their limits, by default the machine's, and is ahead of it by the delay `lead` of its
        law [s], see `law_delay`.
        """
        self.settings, carrier = load_washout(settings), load_cab(cab)
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError(f"rate: {rate} Hz must be greater than 0")
        self.station, self.rate, interval = carrier.station, rate, 1.0 / rate
        inputs = self.settings.inputs
        self.predictive: Predictive | None = None
        self._running = RunningWashout(
            gain=self.settings.gains,
            force_limit=inputs.force_limit.si,
            rate_limit=inputs.rate_limit.si,
            station=self.station,
            interval=interval,
            head=HeadMotion(np.empty((3, 3)), np.empty((3, 3))),
            sample=Sample(np.empty(3), np.empty(3), np.empty(3)),
        )
        self._sequence: int | None = None
        self.solving = _SOLVER_SHARE
        """Share of a live frame that the solver may take; 0 counts its iterations alone."""
        if isinstance(self.settings, PredictiveSettings):
            bounds = load_motion_limits(limits, carrier.machine)
            self.predictive = Predictive(self.settings, interval, carrier, bounds, lead)
            self._algorithm: Classical | Optimal | Predictive = self.predictive
            self._warm_up(self.predictive)
        elif isinstance(self.settings, ClassicalSettings):
            self._algorithm = make_classical(self.settings, interval)
        else:
            self._algorithm = make_optimal(self.settings, interval)

    def _warm_up(self, predictive: Predictive) -> None:
        """Compile and allocate now, in frames at rest, and not in flight."""
        at_rest = np.concatenate([_REST, np.zeros(3)])
        self.start(_REST, np.zeros(3))
        for _ in range(_WARM_FRAMES):
            self._step(at_rest, np.empty((3, 6)))
        predictive.solves = Solves([], [], [])
        self._sequence = None

    def run(self, motion: PilotMotion) -> HostStream:
        """The host's frames of a flight, one a sample; `motion` is resampled to the rate.

        The algorithm's frames: `within_limits` brings them within the machine's limits.
        """
        flown, predictive = self.flown(motion), self.predictive
        self.start(flown.specific_force[0], flown.angular_rate[0])
        frames = np.empty((flown.time.size, 3, 6))
        place_platform(self._running, frames[0])
        samples = np.hstack([flown.specific_force, flown.angular_rate])
        if predictive is not None:
            predictive.solver.limit_time(0.0)
        if predictive is None or predictive.reference != "known":
            for row in range(1, len(frames)):
                self._step(samples[row], frames[row])
        else:
            led = flown.time + predictive.lead
            station_motion = interpolated(led, flown.time, samples)
            for row in range(1, len(frames)):
                known = interpolated(led[row - 1] + predictive.times[2:], flown.time, samples)
                self._step(station_motion[row], frames[row], known)
        return make_stream(flown.time, frames[:, 0], frames[:, 1], frames[:, 2])

    def _step(
        self,
        station_motion: NDArray[np.float64],
        motion: NDArray[np.float64],
        known: NDArray[np.float64] | None = None,
    ) -> None:
        """One frame of specific force and angular rate (6,); overwrites the platform's motion.

        What is `known` ahead, at the knots 2 .. N, (N - 1, 6), is overwritten.
        """
        if known is not None:
            write_inputs(self._running, known)
        write_sample(self._running, station_motion[:3], station_motion[3:])
        self._algorithm.move(self._running.sample._replace(known=known), self._running.head)
        place_platform(self._running, motion)

    @property
    def plans(self) -> str | None:
        """For the operator: how a predictive washout kept its frames; None of others."""
        predictive = self.predictive
        return None if predictive is None else predictive.solves.report(1.0 / self.rate)

    def flown(self, motion: PilotMotion) -> PilotMotion:
        """A motion at the frames of the host, from time 0."""
        from_start = replace(motion, time=motion.time - motion.time[0])
        if motion.time.size < 2 or abs(motion.rate - self.rate) <= 1e-6 * self.rate:
            return from_start
        return from_start.resampled(self.rate)

    def start(self, specific_force: ArrayLike, angular_rate: ArrayLike) -> HostFrame:
        """Settle on a specific force (3,) and an angular rate (3,); the first frame."""
        running, rate, motion = self._running, np.empty(3), np.empty((3, 6))
        sample, head = running.sample, running.head
        station_motion = _checked_motion(specific_force, angular_rate)
        write_scaled(running, station_motion[:3], station_motion[3:], sample.force, rate)
        sample.slopes[:] = 0.0
        # The attitude depends on the force only, the Euler rates on the attitude.
        write_euler_rates(0.0, 0.0, rate, sample.euler_rates)
        self._algorithm.start(sample, head)
        write_euler_rates(head.angular[0, 0], head.angular[0, 1], rate, sample.euler_rates)
        self._algorithm.start(sample, head)
        self._sequence = 0
        place_platform(running, motion)
        return HostFrame(0, 0.0, *motion)

    def frame(self, specific_force: ArrayLike, angular_rate: ArrayLike) -> HostFrame:
        """The next frame, for a live aircraft; the first call starts.

        Specific force [m/s^2] and angular rate [rad/s] are at the pilot's station, body axes, (3,).
        """
        predictive, motion = self.predictive, np.empty((3, 6))
        if predictive is not None and predictive.reference == "known":
            raise InputError(
                "prediction.reference: 'known' needs a flight; allowed: constant, guess"
            )
        if self._sequence is None:
            if predictive is not None:
                predictive.solver.limit_time(self.solving / self.rate)
            return self.start(specific_force, angular_rate)
        self._step(_checked_motion(specific_force, angular_rate), motion)
        self._sequence += 1
        return HostFrame(self._sequence, self._sequence / self.rate, *motion)


def _checked_motion(specific_force: ArrayLike, angular_rate: ArrayLike) -> NDArray[np.float64]:
    """Specific force (3,) and angular rate (3,), checked, as one, (6,)."""
    force = shaped("specific_force", specific_force, 3)
    return np.concatenate([force, shaped("angular_rate", angular_rate, 3)])
