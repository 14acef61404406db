"""Flights by script: what the pilot aims at, what the air does and what fails, over time.

Speeds are calibrated. Rotation, climb and approach follow common practice with this aircraft
(rotation at 145 kt to 15 deg, 10 deg on one engine, approach at 145 kt on 3 deg); none of it is
taken from a manual.

The pilot holds pitch, bank and heading, and moves the controls through a first-order lag:

    elevator = trim - s (k e + k_i integral(e) - k_q q),    e = pitch target - pitch
    aileron  = s (k (bank target - bank) - k_p p)
    rudder   = s (-k (heading target - heading) + k_r r)    on the ground, or to keep a heading
               -s (k sideslip + k_i integral(sideslip))     in coordinated flight

with s = min((80 m/s / airspeed)^2, 1), since control moments grow with dynamic pressure. The gains
are this project's, tuned for damped responses of the 737; they are no model of a human.
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import check_name
from cmf_mj.core.units import DEGREE, FOOT, KNOT
from cmf_mj.pilot.airframe import AIRCRAFT, RATE, AircraftState, Airframe, Controls
from cmf_mj.pilot.flight import Flight, Origin
from cmf_mj.pilot.motion import COLUMNS, MOST_RATE, PilotMotion

LAG = 0.15
"""Time constant from what the pilot wants to the control surface [s]: arm and actuator, assumed.
JSBSim's 737 moves its surfaces at once, which would jerk the cab."""

_REFERENCE_SPEED = 80.0  #: Airspeed below which the gains are largest [m/s].
_PITCH, _PITCH_INTEGRAL, _PITCH_RATE = 4.0, 2.0, 3.0
_BANK, _ROLL_RATE = 1.5, 1.0
_HEADING, _YAW_RATE = 6.0, 4.0
_SIDESLIP, _SIDESLIP_INTEGRAL = 4.0, 3.0


class Targets(NamedTuple):
    """What the pilot wants now."""

    controls: Controls
    """Throttle, brakes, gear and flaps; its elevator, aileron and rudder are added to those that
    follow the targets."""
    pitch: float | None = None  #: Attitude to hold [rad]; None leaves the elevator where it is.
    bank: float | None = 0.0  #: Attitude to hold [rad]; None leaves the ailerons where they are.
    heading: float | None = None
    """Heading to hold by the rudder [rad]; None coordinates by it where `coordinate` says so."""
    coordinate: bool = True  #: Whether the rudder takes out sideslip.


class Pilot:
    """Flies an airframe, on the ground or trimmed, after targets."""

    def __init__(self, airframe: Airframe, throttle: float) -> None:
        """Begin with neutral surfaces and a throttle, 0 to 1."""
        self._airframe, self.state = airframe, airframe.state()
        self._pitch_integral, self._sideslip_integral = 0.0, 0.0
        self._surface_demands = np.zeros(3)  # elevator, aileron, rudder
        self._positions = np.array([0.0, 0.0, 0.0, throttle])  # of the surfaces, and the throttle

    def fly(self, targets: Targets) -> None:
        """Fly one step of 1/240 s."""
        blend = -np.expm1(-1.0 / (RATE * LAG))
        self._positions += blend * (self._demand(self.state, targets) - self._positions)
        elevator, aileron, rudder, throttle = self._positions
        surfaces = {"elevator": elevator, "aileron": aileron, "rudder": rudder}
        self._airframe.step(targets.controls._replace(throttle=throttle, **surfaces))
        self.state = self._airframe.state()

    def _demand(self, state: AircraftState, targets: Targets) -> NDArray[np.float64]:
        """Elevator, aileron, rudder and throttle, (4,)."""
        scale = min((_REFERENCE_SPEED / max(state.airspeed, 1.0)) ** 2, 1.0)
        roll, pitch, heading = state.attitude
        p, q, r = state.angular_rate
        if targets.pitch is not None:
            error = targets.pitch - pitch
            self._pitch_integral += error / RATE
            nose_up = _PITCH * error + _PITCH_INTEGRAL * self._pitch_integral - _PITCH_RATE * q
            self._surface_demands[0] = -scale * nose_up
        if targets.bank is not None:
            self._surface_demands[1] = scale * (_BANK * (targets.bank - roll) - _ROLL_RATE * p)
        if targets.heading is not None:
            heading_error = _wrapped(targets.heading - heading)
            self._surface_demands[2] = scale * (-_HEADING * heading_error + _YAW_RATE * r)
        elif targets.coordinate:
            self._sideslip_integral += state.sideslip / RATE
            slip = _SIDESLIP * state.sideslip + _SIDESLIP_INTEGRAL * self._sideslip_integral
            self._surface_demands[2] = -scale * slip
        controls = targets.controls
        added = np.array([controls.elevator, controls.aileron, controls.rudder])
        surfaces = np.clip(self._surface_demands + added, -1.0, 1.0)
        return np.array([*surfaces, controls.throttle])


def _wrapped(angle: float) -> float:
    """An angle [rad] within half a turn of 0."""
    return float(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)


Aim = Callable[[float, AircraftState], Targets]
"""What the pilot aims at, at a time since the start [s] and in a state."""


class Script(NamedTuple):
    """A flight to be flown."""

    title: str  #: In words.
    seconds: float  #: Length [s].
    begin: Callable[[Airframe], tuple[float, Aim]]
    """Puts the aircraft where the flight begins; returns the throttle, 0 to 1, and the aim."""


_FLAPS = 0.25  #: Take-off flaps, a fraction of their travel.
_BRAKES_OFF = 2.0
_ROTATION = 145.0 * KNOT
_FAILURE = 130.0 * KNOT  #: Speed of the engine failure, past the decision to go.
_REACTION = 1.0  #: From the failure to the first rudder [s].
_FLARE = 35.0 * FOOT
_GUSTS = {3.0: ((0.0, 0.0, -9.0), 2.0), 18.0: ((0.0, 6.0, 0.0), 2.0)}
"""Velocity north, east, down [m/s] and length [s] by start [s]: from below, and from the left."""


class _Clock(dict[str, float]):
    """Times [s] at which conditions were first met."""

    def since(self, name: str, time: float, is_met: bool) -> float:
        """Time since a condition was first met [s], minus infinity before; notes it if it is."""
        if is_met:
            self.setdefault(name, time)
        return time - self.get(name, np.inf)


def _take_off(airframe: Airframe, *, failure: bool) -> tuple[float, Aim]:
    airframe.on_ground(Controls(brakes=1.0, flaps=_FLAPS))
    _, _, runway = airframe.state().attitude
    climb_pitch = (10.0 if failure else 15.0) * DEGREE
    clock = _Clock()

    def aim(time: float, state: AircraftState) -> Targets:
        failure_time = clock.since("failure", time, failure and state.airspeed > _FAILURE)
        if failure_time == 0.0:
            airframe.fail_engine(0)
        rotation_time = clock.since("rotation", time, state.airspeed > _ROTATION)
        airborne_time = clock.since("airborne", time, state.height > 15.0)
        is_reacting = time > _REACTION and not 0.0 <= failure_time <= _REACTION
        throttle, gear = float(time > _BRAKES_OFF), float(airborne_time <= 3.0)
        controls = Controls(throttle=throttle, brakes=1.0 - throttle, gear=gear, flaps=_FLAPS)
        rotation_pitch = min(2.5 * DEGREE * rotation_time, climb_pitch)
        pitch = rotation_pitch if rotation_time >= 0.0 else None
        heading = runway if is_reacting else None
        return Targets(controls, pitch, heading=heading, coordinate=False)

    return 0.0, aim


def _cruise(airframe: Airframe, height: float = 1500.0) -> tuple[Controls, float]:
    """Trimmed straight flight at 250 kt; controls and pitch."""
    controls = Controls(gear=0.0)
    throttle = airframe.in_air(controls, height=height, airspeed=250.0 * KNOT, path=0.0)
    return controls._replace(throttle=throttle), float(airframe.state().attitude[1])


def _doublets(airframe: Airframe) -> tuple[float, Aim]:
    controls, level = _cruise(airframe)
    doublets = {"elevator": (-0.10, 3.0), "aileron": (0.15, 17.0), "rudder": (-0.20, 31.0)}

    def doublet(time: float, start: float) -> float:
        return float(np.sign(start + 1.0 - time)) if start <= time < start + 2.0 else 0.0

    def aim(time: float, state: AircraftState) -> Targets:
        def is_free(surface: str) -> bool:
            _, start = doublets[surface]
            return start <= time < start + 9.0

        surfaces = {name: size * doublet(time, start) for name, (size, start) in doublets.items()}
        is_lateral_free = is_free("aileron") or is_free("rudder")
        pitch, bank = None if is_free("elevator") else level, None if is_lateral_free else 0.0
        moved_controls = controls._replace(**surfaces)
        return Targets(moved_controls, pitch, bank, coordinate=not is_lateral_free)

    return controls.throttle, aim


def _turn(airframe: Airframe) -> tuple[float, Aim]:
    controls, level = _cruise(airframe)

    def aim(time: float, state: AircraftState) -> Targets:
        share = np.clip(min((time - 3.0) / 6.0, (38.0 - time) / 6.0), 0.0, 1.0)
        powered = controls._replace(throttle=min(controls.throttle + 0.08 * share, 1.0))
        return Targets(powered, level + 1.3 * DEGREE * share, 30.0 * DEGREE * share)

    return controls.throttle, aim


def _gusts(airframe: Airframe) -> tuple[float, Aim]:
    controls, level = _cruise(airframe)

    def aim(time: float, state: AircraftState) -> Targets:
        if time in _GUSTS:
            velocity, length = _GUSTS[time]
            airframe.start_gust(velocity, length)
        return Targets(controls, level, coordinate=False)

    return controls.throttle, aim


def _turbulence(airframe: Airframe) -> tuple[float, Aim]:
    controls, level = _cruise(airframe, 450.0)
    airframe.start_turbulence(30.0 * KNOT, "tustin")
    return controls.throttle, lambda time, state: Targets(controls, level, coordinate=False)


def _approach(airframe: Airframe) -> tuple[float, Aim]:
    landing, path = Controls(gear=1.0, flaps=1.0), -3.0 * DEGREE
    throttle = airframe.in_air(landing, height=620.0 * FOOT, airspeed=145.0 * KNOT, path=path)
    _, level, runway = airframe.state().attitude
    airframe.start_turbulence(15.0 * KNOT, "milspec")
    clock = _Clock()

    def aim(time: float, state: AircraftState) -> Targets:
        flare_time = clock.since("flare", time, state.height < _FLARE)
        roll_out_time = clock.since("ground", time, state.height < 1.3)
        pitch = level + 4.0 * DEGREE * np.clip(flare_time / 4.0, 0.0, 1.0)
        if roll_out_time > 0.0:
            pitch = max(pitch - 2.0 * DEGREE * roll_out_time, 0.0)
        controls = landing._replace(
            throttle=throttle * float(np.clip(1.0 - flare_time / 3.0, 0.0, 1.0)),
            brakes=0.35 * float(np.clip((roll_out_time - 2.0) / 2.0, 0.0, 1.0)),
        )
        return Targets(controls, pitch, heading=runway)

    return throttle, aim


SCRIPTS = {
    "take_off": Script(
        "take-off: 2 s at rest, roll, rotation at 145 kt, climb",
        55.0,
        partial(_take_off, failure=False),
    ),
    "engine_failure": Script(
        "take-off with the left engine failing at 130 kt", 60.0, partial(_take_off, failure=True)
    ),
    "doublets": Script("doublets of elevator, ailerons and rudder at 250 kt", 45.0, _doublets),
    "turn": Script("coordinated turn with 30 deg of bank at 250 kt", 45.0, _turn),
    "gusts": Script("1-cosine gusts from below and from the left at 250 kt", 35.0, _gusts),
    "turbulence": Script("moderate turbulence (MIL-F-8785C) at 250 kt, 450 m", 40.0, _turbulence),
    "approach": Script("approach on 3 deg in light turbulence, landing, braking", 60.0, _approach),
}
"""Flights of the 737 by name."""


def script_states(name: str, seed: int = 1) -> Iterator[AircraftState]:
    """Fly one of `SCRIPTS` with JSBSim; the seed is the turbulence's.

    Yields the state 80 times a second, with time from 0 and heading without wrapping. Raises
    `MissingExtraError` without JSBSim.
    """
    check_name("flight", name, SCRIPTS)
    script, airframe = SCRIPTS[name], Airframe(seed)
    throttle, aim = script.begin(airframe)
    pilot, heading = Pilot(airframe, throttle), 0.0
    for step in range(round(script.seconds * RATE)):
        state = pilot.state
        if step % round(RATE / MOST_RATE) == 0:
            heading += _wrapped(state.attitude[2] - heading)
            attitude = np.array([*state.attitude[:2], heading])
            yield state._replace(time=step / RATE, attitude=attitude)
        pilot.fly(aim(step / RATE, state))


def fly_script(name: str, seed: int = 1) -> Flight:
    """Fly one of `SCRIPTS` to its end; as `script_states`."""
    states = list(script_states(name, seed))

    def history(field: str) -> NDArray[np.float64]:
        return np.array([getattr(state, field) for state in states])

    x, y, z = (round(float(length), 6) for length in states[0].lever)
    origin = Origin(
        title=SCRIPTS[name].title,
        aircraft=AIRCRAFT,
        lever_arm=(x, y, z),
        source=f"JSBSim {version('jsbsim')}, script {name}",
        seed=seed,
    )
    motion = PilotMotion(history("time"), **{channel: history(channel) for channel in COLUMNS})
    return Flight(motion, origin, {name: history(name) for name in ("airspeed", "height")})
