"""A pilot: holds pitch, bank and heading, and moves the controls through a first-order lag.

    elevator = trim - s (k e + k_i integral(e) - k_q q),    e = pitch target - pitch
    aileron  = s (k (bank target - bank) - k_p p)
    rudder   = s (-k (heading target - heading) + k_r r)    on the ground, or to keep a heading
               -s (k sideslip + k_i integral(sideslip))     in coordinated flight

with s = min((80 m/s / airspeed)^2, 1), since control moments grow with dynamic pressure. The gains
are this project's, tuned for damped responses of the 737; they are no model of a human.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.pilot.aircraft.airframe import RATE, Airframe, Controls, State

LAG = 0.15
"""Time constant from what the pilot wants to the control surface [s]: arm and actuator, assumed.
JSBSim's 737 moves its surfaces at once, which would jerk the cab."""

_REFERENCE_SPEED = 80.0
_PITCH, _PITCH_INTEGRAL, _PITCH_RATE = 4.0, 2.0, 3.0
_BANK, _ROLL_RATE = 1.5, 1.0
_HEADING, _YAW_RATE = 6.0, 4.0
_SIDESLIP, _SIDESLIP_INTEGRAL = 4.0, 3.0


class Targets(NamedTuple):
    """What the pilot wants now."""

    pitch: float | None = None  #: Attitude to hold [rad]; None leaves the elevator where it is.
    bank: float | None = 0.0  #: Attitude to hold [rad]; None leaves the ailerons where they are.
    heading: float | None = None
    """Heading to hold by the rudder [rad]; None coordinates by it where `coordinate` says so."""
    coordinate: bool = True  #: Whether the rudder takes out sideslip.
    elevator: float = 0.0
    """Added to the elevator, a fraction of its travel, positive pitches down."""
    aileron: float = 0.0  #: Added to the ailerons, positive rolls to the right.
    rudder: float = 0.0  #: Added to the rudder, positive yaws to the left.
    throttle: float = 0.0  #: 0 to 1.
    brakes: float = 0.0  #: 0 to 1.
    gear: float = 0.0  #: 1 down, 0 up.
    flaps: float = 0.0  #: 0 to 1.


class Pilot:
    """Flies an airframe after targets."""

    def __init__(self, airframe: Airframe, throttle: float = 0.0) -> None:
        """Take the controls as they are.

        Args:
            airframe: on the ground or trimmed.
            throttle: where the throttle stands, 0 to 1.
        """
        self._airframe = airframe
        self._state = airframe.state()
        self._pitch_integral, self._sideslip_integral = 0.0, 0.0
        self._surfaces = np.zeros(3)
        self._moved = np.array([0.0, 0.0, 0.0, throttle])

    @property
    def state(self) -> State:
        """The state after the last step."""
        return self._state

    def fly(self, targets: Targets) -> None:
        """Fly one step of 1/240 s."""
        demanded = self._demanded(self._state, targets)
        blend = -np.expm1(-1.0 / (RATE * LAG))
        self._moved += blend * (demanded - self._moved)
        elevator, aileron, rudder, throttle = self._moved
        self._airframe.step(
            Controls(
                elevator, aileron, rudder, throttle, targets.brakes, targets.gear, targets.flaps
            )
        )
        self._state = self._airframe.state()

    def _demanded(self, state: State, targets: Targets) -> NDArray[np.float64]:
        scale = min((_REFERENCE_SPEED / max(state.airspeed, 1.0)) ** 2, 1.0)
        roll, pitch, heading = state.attitude
        p, q, r = state.angular_rate
        if targets.pitch is not None:
            error = targets.pitch - pitch
            self._pitch_integral += error / RATE
            pull = _PITCH * error + _PITCH_INTEGRAL * self._pitch_integral - _PITCH_RATE * q
            self._surfaces[0] = -scale * pull
        if targets.bank is not None:
            self._surfaces[1] = scale * (_BANK * (targets.bank - roll) - _ROLL_RATE * p)
        if targets.heading is not None:
            away = np.remainder(targets.heading - heading + np.pi, 2.0 * np.pi) - np.pi
            self._surfaces[2] = scale * (-_HEADING * away + _YAW_RATE * r)
        elif targets.coordinate:
            self._sideslip_integral += state.sideslip / RATE
            slip = _SIDESLIP * state.sideslip + _SIDESLIP_INTEGRAL * self._sideslip_integral
            self._surfaces[2] = -scale * slip
        added = (targets.elevator, targets.aileron, targets.rudder)
        surfaces = np.clip(self._surfaces + added, -1.0, 1.0)
        return np.array([*surfaces, targets.throttle])
