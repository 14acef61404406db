"""From the motion at a pilot's station in flight to frames of a host.

With f the specific force and w the angular rate at the station in flight, K gains and lim limits,

    f1 = lim(K f (f - f0)) + f0,    f0 = (0, 0, -g),    w1 = lim(K w w)

are what the algorithm, classical or optimal, takes in. It gives the attitude A of the simulator and
the displacement d of the pilot's station in it, each with two derivatives. The platform's centroid
then moves so that the station at the lever arm r does that, with T from simulator to inertial axes
and w from here on the simulator's angular velocity:

    p = d - (T - 1) r,    p' = d' - T (w x r),    p'' = d'' - T (w' x r + w x (w x r))

The platform turns about the pilot's head, not about its centroid, which would push the head the
wrong way at each onset of tilt. A station of (0, 0, 0) turns it about the centroid.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba.extending import overload
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
from cmf_mj.pilot.classical import Classical, make_classical, move_classical
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion, body_rates, interpolated
from cmf_mj.pilot.optimal import Optimal, make_optimal, move_optimal
from cmf_mj.pilot.predictive import Predictive, Solves
from cmf_mj.pilot.washout_settings import (
    ClassicalSettings,
    PredictiveSettings,
    WashoutSettings,
    load_washout,
)

_SOLVING = 0.5  #: Share of a live frame that the solver may take.

_WARM = 3  #: Frames before the first.


class RunningWashout(NamedTuple):
    """What all washouts have at work; arrays of their state are overwritten by each frame."""

    gain: NDArray[np.float64]  #: Gains of specific force and angular rate, (6,).
    force_limit: float  #: [m/s^2].
    rate_limit: float  #: [rad/s].
    station: NDArray[np.float64]  #: r [m], (3,).
    interval: float  #: Between samples [s].
    angular: NDArray[np.float64]  #: Attitude of the simulator and two derivatives, (3, 3).
    linear: NDArray[np.float64]  #: Displacement of the pilot's station and two derivatives, (3, 3).
    euler_rates: NDArray[np.float64]  #: Of the last frame [rad/s], (3,).


def move(algorithm, *sample):  # type: ignore[no-untyped-def]
    """One sample of either algorithm, which compiled code chooses by its type, see below.

    Arguments are those of `move_classical`.
    """
    (move_classical if isinstance(algorithm, Classical) else move_optimal)(algorithm, *sample)


@overload(move)
def _compiled_move(algorithm, *sample):  # type: ignore[no-untyped-def]
    chosen = move_classical if algorithm.instance_class is Classical else move_optimal
    return lambda algorithm, *sample: chosen(algorithm, *sample)


@allocating
def scaled(running, specific_force, angular_rate, force, rate):  # type: ignore[no-untyped-def]
    """Write f1 and w1, (3,) each."""
    rest = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    beyond = running.gain[:3] * (specific_force - rest)
    force[:] = rest + np.clip(beyond, -running.force_limit, running.force_limit)
    rate[:] = np.clip(running.gain[3:] * angular_rate, -running.rate_limit, running.rate_limit)


@allocating
def euler_rates_of(roll, pitch, rate, out):  # type: ignore[no-untyped-def]
    """Write the Euler rates (3,) of an angular velocity (3,) in body axes."""
    across = rate[1] * np.sin(roll) + rate[2] * np.cos(roll)
    out[0] = rate[0] + across * np.tan(pitch)
    out[1] = rate[1] * np.cos(roll) - rate[2] * np.sin(roll)
    out[2] = across / np.cos(pitch)


@allocating
def place_platform(running, motion):  # type: ignore[no-untyped-def]
    """Write pose, velocity and acceleration of the centroid, (3, 6)."""
    station, angular, linear = running.station, running.angular, running.linear
    omega, alpha = np.empty(3), np.empty(3)
    body_rates(angular[0], angular[1], angular[2], omega, alpha)
    turn = rotation(angular[0, 0], angular[0, 1], angular[0, 2])
    swing = np.cross(omega, station)
    motion[0, :3] = linear[0] - (turn @ station - station)
    motion[1, :3] = linear[1] - turn @ swing
    motion[2, :3] = linear[2] - turn @ (np.cross(alpha, station) + np.cross(omega, swing))
    motion[:, 3:] = angular


@allocating
def coming_attitude(running):  # type: ignore[no-untyped-def]
    """Roll and pitch at this frame, but for terms of third order in the interval."""
    span, angular = running.interval, running.angular
    roll = angular[0, 0] + span * (angular[1, 0] + 0.5 * span * angular[2, 0])
    pitch = angular[0, 1] + span * (angular[1, 1] + 0.5 * span * angular[2, 1])
    return roll, pitch


@allocating
def expect(running, ahead):  # type: ignore[no-untyped-def]
    """Turn specific forces and angular rates (K, 6) into Euler rates and forces beyond rest."""
    force, rate = np.empty(3), np.empty(3)
    roll, pitch = coming_attitude(running)
    for row in range(ahead.shape[0]):
        scaled(running, ahead[row, :3], ahead[row, 3:], force, rate)
        euler_rates_of(roll, pitch, rate, ahead[row, :3])
        ahead[row, 3:] = force
        ahead[row, 5] += STANDARD_GRAVITY


@allocating
def take(running, specific_force, angular_rate, force):  # type: ignore[no-untyped-def]
    """Take in a sample at the pilot's station, (3,) each; write f1, and return the slopes of e."""
    rate, before = np.empty(3), running.euler_rates.copy()
    scaled(running, specific_force, angular_rate, force, rate)
    roll, pitch = coming_attitude(running)
    euler_rates_of(roll, pitch, rate, running.euler_rates)
    return (running.euler_rates - before) / running.interval


@allocating
def step(running, algorithm, specific_force, angular_rate, motion):  # type: ignore[no-untyped-def]
    """One host frame of a compiled algorithm; overwrites the platform's motion, (3, 6)."""
    force = np.empty(3)
    slopes = take(running, specific_force, angular_rate, force)
    move(algorithm, running.euler_rates, slopes, force, running.angular, running.linear)
    place_platform(running, motion)


@allocating
def _run(running, algorithm, specific_force, angular_rate, motion):  # type: ignore[no-untyped-def]
    place_platform(running, motion[0])
    for row in range(1, specific_force.shape[0]):
        step(running, algorithm, specific_force[row], angular_rate[row], motion[row])


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
        self.settings = load_washout(settings)
        carried = load_cab(cab)
        self.station = carried.station
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError(f"rate: {rate} Hz must be greater than 0")
        self.rate, most = rate, self.settings.inputs
        self.predictive: Predictive | None = None
        self._algorithm: Classical | Optimal | Predictive
        if isinstance(self.settings, PredictiveSettings):
            bounds = load_motion_limits(limits, carried.machine)
            self.predictive = Predictive(self.settings, 1.0 / rate, carried, bounds, lead)
            self._algorithm = self.predictive
        elif isinstance(self.settings, ClassicalSettings):
            self._algorithm = make_classical(self.settings, 1.0 / rate)
        else:
            self._algorithm = make_optimal(self.settings, 1.0 / rate)
        self._running = RunningWashout(
            self.settings.gains,
            most.force_limit.si,
            most.rate_limit.si,
            self.station,
            1.0 / rate,
            *(np.empty((3, 3)), np.empty((3, 3)), np.empty(3)),
        )
        self._sequence: int | None = None
        self.solving = _SOLVING
        """Share of a live frame that the solver may take; 0 counts its iterations alone."""
        if self.predictive is not None:  # the first frames compile and allocate: now, not in flight
            rest = np.array([0.0, 0.0, -STANDARD_GRAVITY]), np.zeros(3)
            self.start(*rest)
            for _ in range(_WARM):
                self._step(*rest, np.empty((3, 6)))
            self.predictive.solves = Solves([], [], [])
            self._sequence = None

    def run(self, motion: PilotMotion) -> HostStream:
        """The host's frames of a flight, one a sample; `motion` is resampled to the rate.

        The algorithm's frames: `within_limits` brings them within the machine's limits.
        """
        flown, own = self.flown(motion), self.predictive
        self.start(flown.specific_force[0], flown.angular_rate[0])
        out = np.empty((flown.time.size, 3, 6))
        if own is None:
            _run(self._running, self._algorithm, flown.specific_force, flown.angular_rate, out)
        else:
            own.bound(0.0)
            place_platform(self._running, out[0])
            whole, ahead = np.hstack([flown.specific_force, flown.angular_rate]), None
            since, known = flown.time + own.lead, own.reference == "known"
            felt = interpolated(since, flown.time, whole) if known else whole
            for row in range(1, len(out)):
                if known:
                    ahead = interpolated(since[row - 1] + own.times[2:], flown.time, whole)
                self._step(felt[row, :3], felt[row, 3:], out[row], ahead)
        return make_stream(flown.time, out[:, 0], out[:, 1], out[:, 2])

    def _step(
        self,
        specific_force: NDArray[np.float64],
        angular_rate: NDArray[np.float64],
        motion: NDArray[np.float64],
        ahead: NDArray[np.float64] | None = None,
    ) -> None:
        """One host frame; what is known `ahead`, at the knots 2 .. N (N - 1, 6), is overwritten."""
        running, own, force = self._running, self.predictive, np.empty(3)
        if own is None:
            step(running, self._algorithm, specific_force, angular_rate, motion)
            return
        if ahead is not None:
            expect(running, ahead)
        take(running, specific_force, angular_rate, force)
        own.move(running.euler_rates, force, running.angular, running.linear, ahead)
        place_platform(running, motion)

    @property
    def plans(self) -> str | None:
        """For the operator: how a predictive washout kept its frames; None of others."""
        own = self.predictive
        return None if own is None else own.solves.report(1.0 / self.rate)

    def flown(self, motion: PilotMotion) -> PilotMotion:
        """A motion at the frames of the host, from time 0."""
        since = replace(motion, time=motion.time - motion.time[0])
        if motion.time.size < 2 or abs(motion.rate - self.rate) <= 1e-6 * self.rate:
            return since
        return since.resampled(self.rate)

    def start(self, specific_force: ArrayLike, angular_rate: ArrayLike) -> HostFrame:
        """Settle on a specific force (3,) and an angular rate (3,); the first frame."""
        running, force, rate = self._running, np.empty(3), np.empty(3)
        felt = shaped("specific_force", specific_force, 3), shaped("angular_rate", angular_rate, 3)
        scaled(running, *felt, force, rate)
        # The attitude depends on the force only, the Euler rates on the attitude.
        for roll, pitch in ((0.0, 0.0), running.angular[0, :2]):
            euler_rates_of(roll, pitch, rate, running.euler_rates)
            self._algorithm.start(running.euler_rates, force, running.angular, running.linear)
        self._sequence = 0
        motion = np.empty((3, 6))
        place_platform(running, motion)
        return HostFrame(0, 0.0, *motion)

    def frame(self, specific_force: ArrayLike, angular_rate: ArrayLike) -> HostFrame:
        """The next frame, for a live aircraft; the first call starts.

        Specific force [m/s^2] and angular rate [rad/s] are at the pilot's station, body axes, (3,).
        """
        own, motion = self.predictive, np.empty((3, 6))
        if own is not None and own.reference == "known":
            raise InputError(
                "prediction.reference: 'known' needs a flight; allowed: constant, guess"
            )
        if self._sequence is None:
            if own is not None:
                own.bound(self.solving / self.rate)
            return self.start(specific_force, angular_rate)
        felt = shaped("specific_force", specific_force, 3), shaped("angular_rate", angular_rate, 3)
        self._step(*felt, motion)
        self._sequence += 1
        return HostFrame(self._sequence, self._sequence / self.rate, *motion)
