"""The unit box of a certificate: how far each number of a machine may be off, and the poses.

The box of a scale s holds the machines whose numbers are off by at most s times its values, each on
its own. A point of the unit box has `DIMENSIONS` coordinates from -1 to 1, in the file's order.
"""

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Settings, read_toml, validated
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import Hexapod

Array = NDArray[np.float64]
Share = Annotated[float, Field(ge=0.0, le=1.0)]

_SHIPPED = Path(__file__).with_name("certificate.toml")
DIMENSIONS = 4 * 6 + 2 + 5  #: Numbers: four of each leg, two of the oil, five of the cab.
LARGEST_SCALE = 1.3  #: Of a box that is examined: closed valves hold every leg.
WIDEST_DEVIATION = 0.6  #: Of a factor, so that numbers stay positive at `LARGEST_SCALE`.
LEAST_SHARE = 0.05  #: Share of a number that is left of it at least.

_DIAGONAL = np.linspace(-1.0, 1.0, 17)  #: Points from a corner of a box to the opposite one.


class Box(Settings):
    """How far a number may be off, and the poses in which machines are looked at."""

    title: str
    pose_share: Share  #: Of an axis alone over its operational limit.
    corner_share: Share  #: Of all axes at once.
    unknowns: dict[str, Unknown]  #: Those of `certificate.toml`, each with a deviation.

    @model_validator(mode="after")
    def _check_unknowns(self) -> "Box":
        for name, unknown in self.unknowns.items():
            widest = WIDEST_DEVIATION if unknown.effect == "factor" else np.inf
            if unknown.distribution != "uniform" or not 0.0 < unknown.half <= widest:
                allowed = f"a uniform deviation of at most {100.0 * WIDEST_DEVIATION:g} %"
                raise InputError(f"unknowns.{name}: is refused; allowed: {allowed}")
        return self

    def changes(self, points: Array) -> dict[str, Array]:
        """Relative changes (of the place: metres) of points (N, 31) by kind, (N, count).

        Beyond a wide unit box a factor keeps `LEAST_SHARE` of its number.
        """
        coordinates = Unknowns(self.unknowns).split(points)
        changes = {name: self.unknowns[name].half * part for name, part in coordinates.items()}
        for name in changes.keys() - {"cab_place"}:
            changes[name] = np.maximum(changes[name], LEAST_SHARE - 1.0)
        return changes

    def corner_changes(self, scale: float) -> dict[str, Array]:
        """Changes of machines in the box of a scale, among them those of the widest slopes.

        Their cabs lie between opposite corners; the other numbers are at their ends.
        """
        corners = np.array(list(product((-1.0, 1.0), repeat=4)))  # mass and place of the cab
        cabs = (corners[:, None] * _DIAGONAL[:, None]).reshape(-1, 4)
        valves = np.array(list(product((-1.0, 0.0, 1.0), (-1.0, 1.0))))
        points = np.ones((len(cabs) * len(valves), DIMENSIONS))
        coordinates = Unknowns(self.unknowns).split(points)  # views: writing to them fills points
        mass, place = np.split(np.repeat(cabs, len(valves), axis=0), [1], axis=1)
        pressure, gain = np.split(np.tile(valves, (len(cabs), 1)), 2, axis=1)
        coordinates["cab_mass"][:], coordinates["cab_place"][:] = mass, place
        coordinates["supply_pressure"][:], coordinates["valve_gain"][:] = pressure, gain
        return self.changes(scale * points)

    def values(self, changes: Mapping[str, Array]) -> dict[str, Any]:
        """Values of the unknowns in a machine with changes (1, count), in axes of the cab."""
        factors = {name: change + 1.0 for name, change in changes.items()}
        return Unknowns(self.unknowns).shaped(factors | {"cab_place": FLIP * changes["cab_place"]})

    def poses(self, plant: Hexapod) -> Array:
        """Neutral, the ends of each axis, and corners of all, (n, 6) [m, rad].

        In a corner roll has the sign of sway, pitch that of surge, and yaw that of heave.
        """
        low, high = load_motion_limits(machine=plant.machine).operational.T
        ends = np.vstack([np.diag(high), np.diag(low)]) * self.pose_share
        signs = np.array([(x, y, z, y, x, z) for x, y, z in product((-1.0, 1.0), repeat=3)])
        corners = self.corner_share * np.where(signs > 0.0, high, low)
        return np.vstack([np.zeros(6), ends, corners])


def load_box(source: str | Path | None = None) -> Box:
    """The shipped unit box, or one from a TOML file, which has the same unknowns."""
    path = _SHIPPED if source is None else Path(source)
    box, shipped = (validated(Box, read_toml(file), file.name) for file in (path, _SHIPPED))
    paths = [(name, unknown.path) for name, unknown in box.unknowns.items()]
    if paths != [(name, unknown.path) for name, unknown in shipped.unknowns.items()]:
        allowed = f"allowed: {', '.join(shipped.unknowns)}, in this order, with their paths"
        raise InputError(f"{path.name}: unknowns: {', '.join(box.unknowns)} are refused; {allowed}")
    return box
