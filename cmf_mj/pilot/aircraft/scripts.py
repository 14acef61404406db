"""Flights by script: what the pilot aims at, what the air does and what fails, over time.

Speeds are calibrated. Rotation, climb and approach follow common practice with this aircraft
(rotation at 145 kt to 15 deg, 10 deg on one engine, approach at 145 kt on 3 deg); none of it is
taken from a manual.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cmf_mj.core.units import DEGREE, FOOT, KNOT
from cmf_mj.pilot.aircraft.airframe import Airframe, Controls, State
from cmf_mj.pilot.aircraft.pilot import Targets


class Begun(NamedTuple):
    """An aircraft that is ready to go."""

    targets: Callable[[float, State], Targets]
    """What the pilot aims at, at a time since the start [s] and in a state."""
    throttle: float  #: Where the throttle stands, 0 to 1.


class Script(NamedTuple):
    """A flight to be flown."""

    title: str  #: In words.
    seconds: float  #: Length [s].
    begin: Callable[[Airframe], Begun]  #: Puts the aircraft where the flight begins.


_FLAPS = 0.25
"""Take-off flaps, a fraction of their travel."""

_BRAKES_OFF = 2.0
_ROTATION = 145.0 * KNOT
_FAILURE = 130.0 * KNOT
"""Speed of the engine failure, past the decision to go."""
_REACTION = 1.0
"""From the failure to the first rudder [s]."""


def _take_off(airframe: Airframe, *, failure: bool) -> Begun:
    airframe.on_ground(Controls(brakes=1.0, flaps=_FLAPS))
    runway = airframe.state().attitude[2]
    best = (10.0 if failure else 15.0) * DEGREE
    began: dict[str, float] = {}

    def targets(time: float, state: State) -> Targets:
        if failure and state.airspeed > _FAILURE and "failure" not in began:
            began["failure"] = time
            airframe.fail_engine(0)
        if state.airspeed > _ROTATION:
            began.setdefault("rotation", time)
        if state.height > 15.0:
            began.setdefault("airborne", time)
        reacting = time > began.get("failure", 0.0) + _REACTION
        pitch = None
        if "rotation" in began:
            pitch = min(2.5 * DEGREE * (time - began["rotation"]), best)
        return Targets(
            pitch=pitch,
            heading=runway if reacting else None,
            coordinate=False,
            throttle=1.0 if time > _BRAKES_OFF else 0.0,
            brakes=0.0 if time > _BRAKES_OFF else 1.0,
            gear=0.0 if time > began.get("airborne", np.inf) + 3.0 else 1.0,
            flaps=_FLAPS,
        )

    return Begun(targets, 0.0)


def _cruise(airframe: Airframe, height: float = 1500.0) -> tuple[float, float]:
    """Trimmed straight flight at 250 kt; throttle and pitch."""
    throttle = airframe.in_air(Controls(gear=0.0), height=height, airspeed=250.0 * KNOT, path=0.0)
    return throttle, float(airframe.state().attitude[1])


def _pulse(time: float, start: float, width: float) -> float:
    """A doublet: 1 for a width [s], then -1 for a width."""
    return float(np.sign(start + width - time)) if start <= time < start + 2.0 * width else 0.0


def _doublets(airframe: Airframe) -> Begun:
    throttle, level = _cruise(airframe)

    def targets(time: float, state: State) -> Targets:
        free = [start <= time < start + 9.0 for start in (3.0, 17.0, 31.0)]
        return Targets(
            pitch=None if free[0] else level,
            bank=None if free[1] or free[2] else 0.0,
            coordinate=not (free[1] or free[2]),
            elevator=-0.10 * _pulse(time, 3.0, 1.0),
            aileron=0.15 * _pulse(time, 17.0, 1.0),
            rudder=-0.20 * _pulse(time, 31.0, 1.0),
            throttle=throttle,
        )

    return Begun(targets, throttle)


def _turn(airframe: Airframe) -> Begun:
    throttle, level = _cruise(airframe)

    def targets(time: float, state: State) -> Targets:
        share = np.clip(min((time - 3.0) / 6.0, (38.0 - time) / 6.0), 0.0, 1.0)
        bank = 30.0 * DEGREE * share
        pitch = level + 1.3 * DEGREE * share
        return Targets(pitch=pitch, bank=bank, throttle=min(throttle + 0.08 * share, 1.0))

    return Begun(targets, throttle)


_GUSTS = ((3.0, (0.0, 0.0, -9.0), 2.0), (18.0, (0.0, 6.0, 0.0), 2.0))
"""Start [s], velocity north, east, down [m/s], length [s]: from below, and from the left."""


def _gusts(airframe: Airframe) -> Begun:
    throttle, level = _cruise(airframe)
    left = list(_GUSTS)

    def targets(time: float, state: State) -> Targets:
        if left and time >= left[0][0]:
            _, velocity, length = left.pop(0)
            airframe.gust(velocity, length)
        return Targets(pitch=level, coordinate=False, throttle=throttle)

    return Begun(targets, throttle)


def _turbulence(airframe: Airframe) -> Begun:
    throttle, level = _cruise(airframe, 450.0)
    airframe.turbulence(30.0 * KNOT, "tustin")

    def targets(time: float, state: State) -> Targets:
        return Targets(pitch=level, coordinate=False, throttle=throttle)

    return Begun(targets, throttle)


_FLARE = 35.0 * FOOT


def _approach(airframe: Airframe) -> Begun:
    path = -3.0 * DEGREE
    down = Controls(gear=1.0, flaps=1.0)
    height = 620.0 * FOOT
    throttle = airframe.in_air(down, height=height, airspeed=145.0 * KNOT, path=path)
    state = airframe.state()
    level, runway = float(state.attitude[1]), float(state.attitude[2])
    airframe.turbulence(15.0 * KNOT, "milspec")
    began: dict[str, float] = {}

    def targets(time: float, state: State) -> Targets:
        if state.height < _FLARE:
            began.setdefault("flare", time)
        if state.height < 1.3:
            began.setdefault("ground", time)
        since = time - began.get("flare", np.inf)
        rolling = time - began.get("ground", np.inf)
        pitch = level + 4.0 * DEGREE * np.clip(since / 4.0, 0.0, 1.0)
        if rolling > 0.0:
            pitch = max(pitch - 2.0 * DEGREE * rolling, 0.0)
        return Targets(
            pitch=pitch,
            heading=runway,
            throttle=throttle * float(np.clip(1.0 - since / 3.0, 0.0, 1.0)),
            brakes=0.35 * float(np.clip((rolling - 2.0) / 2.0, 0.0, 1.0)),
            gear=1.0,
            flaps=1.0,
        )

    return Begun(targets, throttle)


SCRIPTS: Mapping[str, Script] = MappingProxyType(
    {
        "take_off": Script(
            "take-off: 2 s at rest, roll, rotation at 145 kt, climb",
            55.0,
            lambda airframe: _take_off(airframe, failure=False),
        ),
        "engine_failure": Script(
            "take-off with the left engine failing at 130 kt",
            60.0,
            lambda airframe: _take_off(airframe, failure=True),
        ),
        "doublets": Script("doublets of elevator, ailerons and rudder at 250 kt", 45.0, _doublets),
        "turn": Script("coordinated turn with 30 deg of bank at 250 kt", 45.0, _turn),
        "gusts": Script("1-cosine gusts from below and from the left at 250 kt", 35.0, _gusts),
        "turbulence": Script(
            "moderate turbulence (MIL-F-8785C) at 250 kt, 450 m", 40.0, _turbulence
        ),
        "approach": Script(
            "approach on 3 deg in light turbulence, landing, braking", 60.0, _approach
        ),
    }
)
"""Flights of the 737 by name."""
