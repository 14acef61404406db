"""Fly a script now: a host in aircraft mode with JSBSim behind it, and its recording."""

from collections.abc import Iterator
from importlib.metadata import version

import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.pilot.aircraft.airframe import RATE, Airframe, State
from cmf_mj.pilot.aircraft.flight import Flight, Origin
from cmf_mj.pilot.aircraft.pilot import Pilot
from cmf_mj.pilot.aircraft.scripts import SCRIPTS
from cmf_mj.pilot.host import MOST_RATE, PilotSample
from cmf_mj.pilot.motion import PilotMotion

_EVERY = round(RATE / MOST_RATE)


class ScriptedFlight:
    """An aircraft that a script flies; an `AircraftHost`."""

    def __init__(self, name: str, *, aircraft: str = "737", seed: int = 1) -> None:
        """Choose what to fly; the aircraft starts with the first sample.

        Args:
            name: one of `SCRIPTS`.
            aircraft: of JSBSim; the scripts are made for the 737.
            seed: of the turbulence.

        Raises:
            InputError: unknown script.
        """
        if name not in SCRIPTS:
            raise InputError(f"flight: {name!r} is not one of {', '.join(SCRIPTS)}")
        self.name, self.aircraft, self.seed = name, aircraft, seed

    def states(self) -> Iterator[State]:
        """Fly and tell the state 80 times a second; time counts from 0.

        Raises:
            MissingExtraError: JSBSim is not installed.
            InputError: no such aircraft, or it cannot be trimmed.
        """
        script = SCRIPTS[self.name]
        airframe = Airframe(self.aircraft, seed=self.seed)
        begun = script.begin(airframe)
        pilot = Pilot(airframe, begun.throttle)
        heading = 0.0
        for step in range(round(script.seconds * RATE)):
            state = pilot.state
            if step % _EVERY == 0:
                turn = np.remainder(state.attitude[2] - heading + np.pi, 2.0 * np.pi) - np.pi
                heading += float(turn)
                attitude = np.array([*state.attitude[:2], heading])
                yield state._replace(time=step / RATE, attitude=attitude)
            pilot.fly(begun.targets(step / RATE, state))

    def samples(self) -> Iterator[PilotSample]:
        """Fly, frame by frame; errors are those of `states`."""
        for state in self.states():
            yield PilotSample(state.time, state.specific_force, state.angular_rate, state.attitude)

    def record(self) -> Flight:
        """Fly it all; errors are those of `states`."""
        states = list(self.states())
        motion = PilotMotion(
            np.array([state.time for state in states]),
            np.array([state.specific_force for state in states]),
            np.array([state.angular_rate for state in states]),
            np.array([state.attitude for state in states]),
        )
        others = {
            "airspeed": np.array([state.airspeed for state in states]),
            "height": np.array([state.height for state in states]),
        }
        x, y, z = (round(float(part), 6) for part in states[0].lever)
        origin = Origin(
            title=SCRIPTS[self.name].title,
            aircraft=self.aircraft,
            lever_arm=(x, y, z),
            source=f"JSBSim {version('jsbsim')}, script {self.name}",
            seed=self.seed,
        )
        return Flight(motion, origin, others)
