"""The box of machines that a certificate speaks of, and one of its machines as files to replay.

The box of a scale s holds the machines whose numbers are off by at most s times its values, each on
its own. A corner of it is a point of +-1.
"""

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from cmf_mj.analysis.linear.binding import bound
from cmf_mj.control.law import Law
from cmf_mj.core.files import in_folder, write_text
from cmf_mj.core.quantity import Kind, Length, Quantity
from cmf_mj.core.settings import Settings, read_toml, validated
from cmf_mj.facility.scenario.library import load_scenario
from cmf_mj.facility.scenario.run import run_scenario
from cmf_mj.machine.geometry import DOFS, FLIP
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import OF_THE_SUPPLY
from cmf_mj.studies.case import REPORT_AMPLITUDES, SMALL, swings
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Part = Annotated[Quantity, AfterValidator(Kind(("%",), at_most=0.6).check)]

COUNTS = {
    **dict.fromkeys(("drive_lag", "valve_lag", "valve_gain", "leak_rate"), 6),
    **dict.fromkeys(("bulk_modulus", "supply_pressure", "cab_mass"), 1),
    **{"cab_place": 3, "cab_inertia": 1},
}
"""How many numbers of each kind a machine has, in the order of a point of the box."""

SIZE = sum(COUNTS.values())

LARGEST = 1.3
"""Largest scale: numbers stay positive, and closed valves hold every leg."""


class Box(Settings):
    """The unit box: how far a number may be off either way."""

    title: str
    pose_share: Share  #: Of an axis alone over its operational limit.
    corner_share: Share  #: Of all axes at once.
    drive_lag: Part
    valve_lag: Part
    valve_gain: Part
    leak_rate: Part  #: Of the conductance.
    bulk_modulus: Part
    supply_pressure: Part
    cab_mass: Part
    cab_place: Length
    cab_inertia: Part

    def changes(self, points: Array) -> dict[str, Array]:
        """Relative changes (of the place: metres) of points (N, 31) by kind, (N, count)."""
        parts = np.split(points, np.cumsum(list(COUNTS.values()))[:-1], axis=1)
        return {name: getattr(self, name).si * p for name, p in zip(COUNTS, parts, strict=True)}

    def poses(self, plant: Hexapod) -> Array:
        """Neutral, the ends of each axis, and corners of all, (n, 6) [m, rad]."""
        low, high = load_motion_limits(machine=plant.machine).operational.T
        ends = np.vstack([np.diag(high), np.diag(low)]) * self.pose_share
        signs = np.array([(*s, s[1], s[0], s[2]) for s in product((-1.0, 1.0), repeat=3)])
        corners = self.corner_share * np.where(signs > 0.0, high, low)
        return np.vstack([np.zeros(6), ends, corners])


def load_box(source: str | Path | None = None) -> Box:
    """The shipped unit box, or one from a TOML file."""
    path = Path(__file__).with_name("box.toml") if source is None else Path(source)
    return validated(Box, read_toml(path), path.name)


def save_case(
    folder: Path, name: str, plant: Hexapod, law: Law, pose: Array, changes: Mapping[str, Array]
) -> Path:
    """Write a machine with its law as files, and the scenario that `cmf run` replays it by.

    The law knows the nominal cab. The run begins in the pose and steps all axes by a small step.
    """
    cab, oil = plant.cab_parameters, plant.parameters
    assert cab is not None
    f = {kind: values[0] + (kind != "cab_place") for kind, values in changes.items()}
    stiff, (high,), (heavy,) = f["bulk_modulus"][0], f["supply_pressure"], f["cab_mass"]
    known = {"status": "assumed", "source": "cmf certify"}

    def scaled(factors: Mapping[str, float]) -> dict[str, Any]:
        given = {field: getattr(oil, field) for field in factors}
        return {
            field: {"value": given[field].value * float(factor), "unit": given[field].unit, **known}
            for field, factor in factors.items()
        }

    speed, leak = f["valve_gain"] * np.sqrt(high), f["leak_rate"] * stiff
    legs = zip(speed, leak, f["drive_lag"], f["valve_lag"], strict=True)
    fields = "leg_speed", "leak_rate", "drive_lag", "valve_lag"
    hydraulics = scaled(
        {"bulk_modulus": stiff, **dict.fromkeys(("supply_pressure", *OF_THE_SUPPLY), high)}
    ) | {
        "actuators": {
            f"leg_{leg}": scaled(dict(zip(fields, one, strict=True)))
            for leg, one in enumerate(legs, start=1)
        }
    }
    place = cab.centre_of_mass.si + FLIP * f["cab_place"]
    masses = {"mass": heavy * cab.mass.si, "inertia": f["cab_inertia"][0] * cab.tensor}
    changed = cab.changed(name, centre_of_mass=place, **masses)
    modes = dict(zip((name,), bound(law, plant).modes.values(), strict=False))  # none in legs
    known_law = law.model_copy(update={"name": f"{law.name}_{name}", "modes": modes})
    save_law(known_law, in_folder(folder, "law.toml"))
    steps = [
        {"kind": "step", "dof": dof, "amplitude": [float(SMALL * size), unit], "at": 0.5}
        for dof, size, unit in zip(DOFS, REPORT_AMPLITUDES, 3 * ("m",) + 3 * ("rad",), strict=True)
    ]
    stay: dict[str, Any] = {"kind": "waypoints", "times": [0.0, 12.0], "poses": [pose.tolist()] * 2}
    files: dict[str, dict[str, Any]] = {
        "hydraulics.toml": {"base": oil.name, name: hydraulics},
        "cab.toml": {
            "base": cab.name,
            name: changed.model_dump(mode="json", include={"centre_of_mass", *masses}),
        },
        "scenario.toml": {
            "title": f"{law.title}: the machine of its certificate that breaks it",
            **{"machine": plant.machine.name, "cab": "cab.toml", "hydraulics": "hydraulics.toml"},
            **{"law": "law.toml", "duration": 12.0, "record_every": 16, "signal": [stay, *steps]},
        },
    }
    for file, table in files.items():
        write_text(folder / file, tomlkit.dumps(table))
    return folder / "scenario.toml"


def replayed(path: Path) -> float:
    """Swing of the legs left at the end of a case over its largest leg step, in the simulation."""
    try:
        return float(swings(run_scenario(load_scenario(path)))["last"])
    except FloatingPointError:  # it left the bounds of the model
        return float("inf")
