"""JSBSim's 737: loaded, trimmed, flown step by step, felt at the pilot's eye.

JSBSim integrates the rigid body in body axes, which are ours: x forward, y right, z down. At
the end of a step it knows the force on the body F (aerodynamic, engines, ground; not gravity), the
mass m, and inertial rate w and acceleration dw/dt of the body. With r from the centre of
gravity to the eyepoint, the specific force there is

    f = F / m + dw/dt x r + w x (w x r)

which is what JSBSim's `accelerations/a-pilot-*` say one step later: it evaluates them at the
start of a step from the forces of the step before. In structural axes (x aft, y right, z up, inch)
r = (x_cg - x, y - y_cg, z_cg - z); the centre of gravity wanders with the fuel, 0.3 mm a second.

Specific force and rate belong to the body; a seat, a neck or a bending fuselage are not modelled.
"""

import os
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, require

AIRCRAFT = "737"  #: Its folder of JSBSim.
RATE = 240  #: Steps of the flight mechanics a second [Hz]: three a host frame of 80 Hz.


class AircraftState(NamedTuple):
    """What the aircraft does at the end of a step, SI, body axes."""

    time: float  #: [s].
    specific_force: NDArray[np.float64]  #: At the eyepoint, without gravity [m/s^2], (3,).
    angular_rate: NDArray[np.float64]  #: p, q, r against the Earth [rad/s], (3,).
    attitude: NDArray[np.float64]  #: Roll, pitch, heading to the local level [rad], (3,).
    lever: NDArray[np.float64]  #: From the centre of gravity to the eyepoint [m], (3,).
    airspeed: float  #: Calibrated [m/s].
    height: float  #: Of the centre of gravity above the ground [m].
    sideslip: float  #: Angle of sideslip, positive with the wind from the right [rad].


class Controls(NamedTuple):
    """What the pilot moves, fractions of full travel."""

    elevator: float = 0.0  #: -1 to 1, positive pitches down: JSBSim's sign.
    aileron: float = 0.0  #: -1 to 1, positive rolls to the right.
    rudder: float = 0.0  #: -1 to 1, positive yaws to the left: JSBSim's sign.
    throttle: float = 0.0  #: 0 to 1, both engines.
    brakes: float = 0.0  #: 0 to 1.
    gear: float = 1.0  #: 1 down, 0 up.
    flaps: float = 0.0  #: 0 to 1.


class Airframe:
    """A 737 in the air or on the ground."""

    def __init__(self, seed: int = 0) -> None:
        """Load the 737 that comes with JSBSim.

        Its network ports stay closed. The same seed gives the same turbulence, bit for bit.
        """
        self._failed: set[int] = set()
        os.environ.setdefault("JSBSIM_DEBUG", "0")  # JSBSim prints a banner otherwise
        library = require("jsbsim", "flight")
        self._fdm = library.FGFDMExec(library.get_default_root_dir())
        self._trim_failure = library.TrimFailureError
        self._fdm.set_dt(1.0 / RATE)
        with tempfile.TemporaryDirectory(prefix="cmf_aircraft_") as folder:
            shipped = Path(library.get_default_root_dir()) / "aircraft" / AIRCRAFT
            without_network(shipped, Path(folder) / AIRCRAFT)
            self._fdm.set_aircraft_path(folder)
            self._fdm.load_model(AIRCRAFT)
        self["simulation/randomseed"] = seed

    def __getitem__(self, name: str) -> float:
        """A property of JSBSim, in its units."""
        return float(self._fdm[name])

    def __setitem__(self, name: str, value: float) -> None:
        """Set a property of JSBSim, in its units."""
        self._fdm[name] = float(value)

    def on_ground(self, controls: Controls) -> None:
        """Stand on the ground with idling engines, after 12 s of coming to rest."""
        self._initialise({"h-agl-ft": 8.0, "vc-kts": 0.0}, controls)
        for _ in range(12 * RATE):
            self.step(controls)

    def in_air(self, controls: Controls, *, height: float, airspeed: float, path: float) -> float:
        """Fly straight, trimmed with gear and flaps of `controls`; returns the throttle.

        Height is above the ground [m], airspeed calibrated [m/s], the flight path angle positive
        climbing [rad].
        """
        start = {"h-agl-ft": units.from_si("ft", height), "vc-kts": units.from_si("kt", airspeed)}
        self._initialise(start | {"gamma-deg": units.from_si("deg", path)}, controls)
        try:
            self["simulation/do_simple_trim"] = 1.0
        except self._trim_failure as error:
            raise InputError(
                f"airspeed: {airspeed:.1f} m/s at {height:.0f} m on a path of {path:.3f} rad "
                f"cannot be trimmed with the {AIRCRAFT}: {error}"
            ) from error
        return self["fcs/throttle-cmd-norm[0]"]

    def _initialise(self, start: Mapping[str, float], controls: Controls) -> None:
        """Begin at Langley, heading north, with gear and flaps of the controls."""
        for name, value in {"lat-geod-deg": 37.08, "long-gc-deg": -76.38, **start}.items():
            self[f"ic/{name}"] = value
        for signal in ("cmd", "pos"):  # both, or the systems would move first
            self[f"gear/gear-{signal}-norm"] = controls.gear
            self[f"fcs/flap-{signal}-norm"] = controls.flaps
        self._fdm.run_ic()
        self["propulsion/set-running"] = -1.0

    def start_gust(self, velocity: tuple[float, float, float], length: float) -> None:
        """Begin a gust v (1 - cos(2 pi t / T)) / 2 of the air, T its length [s].

        The velocity v [m/s] is in local axes (north, east, down).
        """
        speed = float(np.linalg.norm(velocity))
        for phase, duration in (("startup", length / 2), ("steady", 0.0), ("end", length / 2)):
            self[f"atmosphere/cosine-gust/{phase}-duration-sec"] = duration
        self["atmosphere/cosine-gust/magnitude-ft_sec"] = units.from_si("ft", speed)
        self["atmosphere/cosine-gust/frame"] = 3.0
        for axis, direction in zip("XYZ", np.array(velocity) / speed, strict=True):
            self[f"atmosphere/cosine-gust/{axis}-velocity-ft_sec"] = direction
        self["atmosphere/cosine-gust/start"] = 1.0

    def start_turbulence(self, wind: float, model: str) -> None:
        """Turn on Dryden turbulence after MIL-F-8785C, in one of JSBSim's two discretisations.

        The mean wind 20 ft above the ground [m/s] sets its size below 2000 ft; above, it is of the
        third of seven severities.
        """
        wind_speed = units.from_si("ft", wind)
        self["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = wind_speed
        self["atmosphere/turbulence/milspec/severity"] = 3.0
        self["atmosphere/turb-type"] = {"milspec": 3.0, "tustin": 4.0}[model]

    def fail_engine(self, engine: int) -> None:
        """Let an engine, 0 the left one, spool down to idle for the rest of the flight.

        JSBSim's fuel cut takes all thrust away within one step; spooling down takes 2 s to
        4 % of the take-off thrust, which stays.
        """
        self._failed.add(engine)

    def step(self, controls: Controls) -> None:
        """Fly one step of 1/240 s."""
        for name, value in (
            ("fcs/elevator-cmd-norm", controls.elevator),
            ("fcs/aileron-cmd-norm", controls.aileron),
            ("fcs/rudder-cmd-norm", controls.rudder),
            ("fcs/throttle-cmd-norm[0]", 0.0 if 0 in self._failed else controls.throttle),
            ("fcs/throttle-cmd-norm[1]", 0.0 if 1 in self._failed else controls.throttle),
            ("fcs/left-brake-cmd-norm", controls.brakes),
            ("fcs/right-brake-cmd-norm", controls.brakes),
            ("gear/gear-cmd-norm", controls.gear),
            ("fcs/flap-cmd-norm", controls.flaps),
        ):
            self[name] = value
        self._fdm.run()

    def state(self) -> AircraftState:
        """What is felt at the end of the last step."""
        rate = self.vector("velocities/{}i-rad_sec", "pqr")
        angular_acceleration = self.vector("accelerations/{}idot-rad_sec2", "pqr")
        force = self.vector("forces/fb{}-total-lbs") / self["inertia/mass-slugs"] * units.FOOT
        structural = self.vector("metrics/eyepoint-{}-in") - self.vector("inertia/cg-{}-in")
        lever = structural * np.array([-1.0, 1.0, -1.0]) * units.INCH
        tangential = _cross(angular_acceleration, lever)
        return AircraftState(
            time=self["simulation/sim-time-sec"],
            specific_force=force + tangential + _cross(rate, _cross(rate, lever)),
            angular_rate=self.vector("velocities/{}-rad_sec", "pqr"),
            attitude=self.vector("attitude/{}-rad", ("phi", "theta", "psi")),
            lever=lever,
            airspeed=self["velocities/vc-kts"] * units.KNOT,
            height=self["position/h-agl-ft"] * units.FOOT,
            sideslip=self["aero/beta-rad"],
        )

    def vector(self, pattern: str, names: Iterable[str] = "xyz") -> NDArray[np.float64]:
        """Properties of JSBSim, in its units, whose names differ by one part."""
        return np.array([self[pattern.format(name)] for name in names])


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """As `np.cross`, bit for bit: `np.cross` itself would take half the time of a flight."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def without_network(aircraft: Path, copy: Path) -> None:
    """Copy an aircraft's folder without what would listen to or send on the network."""
    shutil.copytree(aircraft, copy)
    file = copy / f"{aircraft.name}.xml"
    tree = ElementTree.parse(file)
    root = tree.getroot()
    for element in (*root.findall("input"), *root.findall("output")):
        root.remove(element)
    tree.write(file)
