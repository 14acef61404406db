"""An aircraft as the host: JSBSim flown by script, and recorded flights that need no JSBSim."""

from cmf_mj.aircraft.airframe import Airframe, Controls, State
from cmf_mj.aircraft.flight import Flight, Origin, flight_names, load_flight
from cmf_mj.aircraft.pilot import Pilot, Targets
from cmf_mj.aircraft.recorder import ScriptedFlight
from cmf_mj.aircraft.scripts import SCRIPTS, Script

__all__ = [
    "SCRIPTS",
    "Airframe",
    "Controls",
    "Flight",
    "Origin",
    "Pilot",
    "Script",
    "ScriptedFlight",
    "State",
    "Targets",
    "flight_names",
    "load_flight",
]
