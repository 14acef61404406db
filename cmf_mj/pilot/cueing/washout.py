"""From the motion at a pilot's station in flight to frames of a host.

    f1 = lim(K f (f - f0)) + f0,    f0 = (0, 0, -g),    w1 = lim(K w w)

are scaled and limited; their algorithm, classical or optimal, gives the attitude A of the simulator
and the displacement d of the pilot's station in it, each with two derivatives. The platform's
centroid then moves so that the station at the lever arm r does that:

    p = d - (T - 1) r,    p' = d' - T (w x r),    p'' = d'' - T (w' x r + w x (w x r))

The platform turns about the pilot's head, not about its centroid, which would push the head the
wrong way at each onset of tilt. A station of (0, 0, 0) turns it about the centroid.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.host.stream import HostFrame, HostStream, make_stream
from cmf_mj.machine.kinematics import rotation
from cmf_mj.pilot.cueing.classical import (
    Classical,
    ClassicalState,
    make_classical,
    move_classical,
    start_classical,
)
from cmf_mj.pilot.cueing.optimal import (
    Optimal,
    OptimalState,
    make_optimal,
    move_optimal,
    start_optimal,
)
from cmf_mj.pilot.cueing.settings import ClassicalSettings, WashoutSettings, load_washout
from cmf_mj.pilot.motion import PilotMotion, body_rates, pilot_station

HOST_RATE = 80.0
"""Frames a second of the facility's host [Hz], section 2.3.1."""


class Cueing(NamedTuple):
    """Compiled parameters."""

    gain: NDArray[np.float64]  #: Gains of specific force and angular rate, (6,).
    force_limit: float  #: [m/s^2].
    rate_limit: float  #: [rad/s].
    station: NDArray[np.float64]  #: r [m], (3,).
    interval: float  #: T [s].
    algorithm: Classical | Optimal


class CueingState(NamedTuple):
    """State, overwritten by each step."""

    angular: NDArray[np.float64]  #: Attitude of the simulator and two derivatives, (3, 3).
    linear: NDArray[np.float64]  #: Displacement of the pilot's station and two derivatives, (3, 3).
    euler_rates: NDArray[np.float64]  #: Of the last step [rad/s], (3,).
    algorithm: ClassicalState | OptimalState


def move(algorithm, state, euler_rates, slopes, force, angular, linear):  # type: ignore[no-untyped-def]
    """One sample of either algorithm; arguments as for `move_classical`."""
    chosen = move_classical if isinstance(algorithm, Classical) else move_optimal
    chosen(algorithm, state, euler_rates, slopes, force, angular, linear)


@overload(move)
def _compiled_move(algorithm, state, euler_rates, slopes, force, angular, linear):  # type: ignore[no-untyped-def]
    chosen = move_classical if algorithm.instance_class is Classical else move_optimal
    return lambda algorithm, state, euler_rates, slopes, force, angular, linear: chosen(
        algorithm, state, euler_rates, slopes, force, angular, linear
    )


@compiled
def scaled(cueing, specific_force, angular_rate, force, rate):  # type: ignore[no-untyped-def]
    """Write f1 and w1, (3,) each."""
    for axis in range(3):
        rest = -STANDARD_GRAVITY if axis == 2 else 0.0
        beyond = cueing.gain[axis] * (specific_force[axis] - rest)
        force[axis] = rest + min(max(beyond, -cueing.force_limit), cueing.force_limit)
        turned = cueing.gain[3 + axis] * angular_rate[axis]
        rate[axis] = min(max(turned, -cueing.rate_limit), cueing.rate_limit)


@compiled
def euler_rates_of(roll, pitch, rate, out):  # type: ignore[no-untyped-def]
    """Write the Euler rates (3,) of an angular velocity (3,) in body axes."""
    across = rate[1] * np.sin(roll) + rate[2] * np.cos(roll)
    out[0] = rate[0] + across * np.tan(pitch)
    out[1] = rate[1] * np.cos(roll) - rate[2] * np.sin(roll)
    out[2] = across / np.cos(pitch)


@compiled
def place(station, angular, linear, motion):  # type: ignore[no-untyped-def]
    """Write pose, velocity and acceleration of the centroid, (3, 6)."""
    omega, alpha = np.empty(3), np.empty(3)
    body_rates(angular[0], angular[1], angular[2], omega, alpha)
    turn = rotation(angular[0, 0], angular[0, 1], angular[0, 2])
    swing = np.cross(omega, station)
    arms = (turn @ station - station, turn @ swing)
    inward = turn @ (np.cross(alpha, station) + np.cross(omega, swing))
    for axis in range(3):
        motion[0, axis] = linear[0, axis] - arms[0][axis]
        motion[1, axis] = linear[1, axis] - arms[1][axis]
        motion[2, axis] = linear[2, axis] - inward[axis]
        for order in range(3):
            motion[order, 3 + axis] = angular[order, axis]


@compiled
def step(cueing, state, specific_force, angular_rate, motion):  # type: ignore[no-untyped-def]
    """One host frame.

    Args:
        cueing: `Cueing`.
        state: `CueingState`, overwritten.
        specific_force: (3,) at the pilot's station [m/s^2].
        angular_rate: (3,) [rad/s].
        motion: pose, velocity, acceleration of the platform, (3, 6), overwritten.
    """
    force, rate, euler_rates, slopes = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    scaled(cueing, specific_force, angular_rate, force, rate)
    # The attitude at this frame, but for terms of third order in the interval.
    span, angular = cueing.interval, state.angular
    roll = angular[0, 0] + span * (angular[1, 0] + 0.5 * span * angular[2, 0])
    pitch = angular[0, 1] + span * (angular[1, 1] + 0.5 * span * angular[2, 1])
    euler_rates_of(roll, pitch, rate, euler_rates)
    for axis in range(3):
        slopes[axis] = (euler_rates[axis] - state.euler_rates[axis]) / span
    state.euler_rates[:] = euler_rates
    move(cueing.algorithm, state.algorithm, euler_rates, slopes, force, angular, state.linear)
    place(cueing.station, angular, state.linear, motion)


@compiled
def _run(cueing, state, specific_force, angular_rate, motion):  # type: ignore[no-untyped-def]
    place(cueing.station, state.angular, state.linear, motion[0])
    for row in range(1, specific_force.shape[0]):
        step(cueing, state, specific_force[row], angular_rate[row], motion[row])


class Washout:
    """A washout at work, frame by frame or on a whole flight.

    It starts as if the first sample had lasted for a long time: tilted for a sustained specific
    force, at rest.
    """

    def __init__(
        self,
        settings: str | WashoutSettings = "simona",
        *,
        station: ArrayLike | None = None,
        rate: float = HOST_RATE,
    ) -> None:
        """Discretise the filters.

        Args:
            settings: name, TOML file or loaded parameters, see `load_washout`.
            station: pilot's station from the platform's centroid [m], (3,); default that of the
                `gfd` cab, `pilot_station`.
            rate: frames a second [Hz].

        Raises:
            InputError: a parameter that is refused, named.
        """
        self.settings = load_washout(settings)
        arm = np.array(pilot_station() if station is None else station, dtype=float)
        if arm.shape != (3,) or not np.isfinite(arm).all():
            raise InputError(f"station: {arm} is refused; allowed: three finite numbers [m]")
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError(f"rate: {rate} Hz must be greater than 0")
        self.station, self.rate = arm, rate
        self._cueing = _compile(self.settings, arm, 1.0 / rate)
        self._state: CueingState | None = None
        self._sequence = 0

    def run(self, motion: PilotMotion) -> HostStream:
        """The host's frames of a flight, one a sample; `motion` is resampled to the rate.

        The algorithm's frames: `envelope.within_limits` brings them within the machine's limits.
        """
        flown = self.flown(motion)
        self.start(flown.specific_force[0], flown.angular_rate[0])
        out = np.empty((flown.time.size, 3, 6))
        _run(self._cueing, self._state, flown.specific_force, flown.angular_rate, out)
        return make_stream(flown.time, out[:, 0], out[:, 1], out[:, 2])

    def flown(self, motion: PilotMotion) -> PilotMotion:
        """A motion at the frames of the host, from time 0."""
        since = replace(motion, time=motion.time - motion.time[0])
        if motion.time.size < 2 or abs(motion.rate - self.rate) <= 1e-6 * self.rate:
            return since
        return since.resampled(self.rate)

    def start(self, specific_force: ArrayLike, angular_rate: ArrayLike) -> HostFrame:
        """Settle on a specific force (3,) and an angular rate (3,); the first frame."""
        self._state = _start(self._cueing, *_inputs(specific_force, angular_rate))
        self._sequence = 0
        motion = np.empty((3, 6))
        place(self.station, self._state.angular, self._state.linear, motion)
        return HostFrame(0, 0.0, *motion)

    def frame(self, specific_force: ArrayLike, angular_rate: ArrayLike) -> HostFrame:
        """The next frame, for a live aircraft; the first call starts.

        Args:
            specific_force: at the pilot's station, body axes [m/s^2], (3,).
            angular_rate: body axes [rad/s], (3,).

        Raises:
            InputError: shapes or numbers that are refused.
        """
        if self._state is None:
            return self.start(specific_force, angular_rate)
        motion = np.empty((3, 6))
        step(self._cueing, self._state, *_inputs(specific_force, angular_rate), motion)
        self._sequence += 1
        return HostFrame(self._sequence, self._sequence / self.rate, *motion)


def _inputs(*inputs: ArrayLike) -> list[NDArray[np.float64]]:
    vectors = []
    for name, values in zip(("specific_force", "angular_rate"), inputs, strict=True):
        array = np.array(values, dtype=float)
        if array.shape != (3,) or not np.isfinite(array).all():
            raise InputError(f"{name}: {array} is refused; allowed: three finite numbers")
        vectors.append(array)
    return vectors


def _compile(settings: WashoutSettings, station: NDArray[np.float64], interval: float) -> Cueing:
    algorithm: Classical | Optimal
    if isinstance(settings, ClassicalSettings):
        algorithm = make_classical(settings, interval)
    else:
        algorithm = make_optimal(settings, interval)
    limits = settings.inputs
    return Cueing(
        settings.gains, limits.force_limit.si, limits.rate_limit.si, station, interval, algorithm
    )


def _start(
    cueing: Cueing, specific_force: NDArray[np.float64], angular_rate: NDArray[np.float64]
) -> CueingState:
    force, rate, euler_rates = np.empty(3), np.empty(3), np.empty(3)
    scaled(cueing, specific_force, angular_rate, force, rate)
    # The attitude depends on the force only, the Euler rates on the attitude.
    angular, linear, zero = np.empty((3, 3)), np.empty((3, 3)), np.zeros(3)
    for guess in (np.zeros(3), angular[0]):
        euler_rates_of(guess[0], guess[1], rate, euler_rates)
        state: ClassicalState | OptimalState
        if isinstance(cueing.algorithm, Classical):
            state = start_classical(cueing.algorithm, euler_rates, force)
        else:
            state = start_optimal(cueing.algorithm, euler_rates, force)
        # At rest a step with the same inputs changes nothing; it reads the outputs.
        move(cueing.algorithm, state, euler_rates, zero, force, angular, linear)
    return CueingState(angular, linear, euler_rates, state)
