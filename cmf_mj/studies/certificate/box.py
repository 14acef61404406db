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
from pydantic import Field, model_validator

from cmf_mj.analysis.linear.binding import bound
from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import in_folder, write_text
from cmf_mj.core.settings import Settings, read_toml, validated
from cmf_mj.facility.scenario.library import load_scenario
from cmf_mj.facility.scenario.run import run_scenario
from cmf_mj.facility.unknowns import Unknown, Unknowns
from cmf_mj.machine.geometry import DOFS, FLIP
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.case import REPORT_AMPLITUDES, SMALL, swings
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]
Share = Annotated[float, Field(ge=0.0, le=1.0)]

KINDS = {
    "drive_lag": ("hydraulics.actuators.*.drive_lag", 6),
    "valve_lag": ("hydraulics.actuators.*.valve_lag", 6),
    "valve_gain": ("hydraulics.actuators.*.valve_gain", 6),
    "leak_rate": ("hydraulics.actuators.*.leakage", 6),
    "bulk_modulus": ("hydraulics.bulk_modulus", 1),
    "supply_pressure": ("hydraulics.supply", 1),
    "cab_mass": ("cab.mass", 1),
    "cab_place": ("cab.centre_of_mass", 3),
    "cab_inertia": ("cab.inertia", 1),
}
"""Paths of the unknowns and how many numbers each has, in the order of a point of the box."""

SIZE = sum(count for _, count in KINDS.values())

WIDEST = 0.6
"""Largest deviation of a factor: at `LARGEST`, numbers stay positive."""

LARGEST = 1.3
"""Largest scale: numbers stay positive, and closed valves hold every leg."""


class Box(Settings):
    """The unit box: how far a number may be off either way."""

    title: str
    pose_share: Share  #: Of an axis alone over its operational limit.
    corner_share: Share  #: Of all axes at once.
    unknowns: dict[str, Unknown]  #: Those of `KINDS`, each with a deviation.

    @model_validator(mode="after")
    def _whole(self) -> "Box":
        paths = [(name, one.path) for name, one in self.unknowns.items()]
        if paths != [(name, path) for name, (path, _) in KINDS.items()]:
            allowed = f"allowed: {', '.join(KINDS)}, in this order, with their paths"
            raise InputError(f"unknowns: {', '.join(self.unknowns)} are refused; {allowed}")
        for name, one in self.unknowns.items():
            most = WIDEST if one.effect == "factor" else np.inf
            if one.distribution != "uniform" or not 0.0 < one.half <= most:
                allowed = f"a uniform deviation of at most {100.0 * WIDEST:g} %"
                raise InputError(f"unknowns.{name}: is refused; allowed: {allowed}")
        return self

    def changes(self, points: Array) -> dict[str, Array]:
        """Relative changes (of the place: metres) of points (N, 31) by kind, (N, count)."""
        parts = Unknowns(self.unknowns).split(points)
        return {name: self.unknowns[name].half * part for name, part in parts.items()}

    def values(self, changes: Mapping[str, Array]) -> dict[str, Any]:
        """Values of the unknowns in a machine with changes (1, count), in axes of the cab."""
        found = {name: change + 1.0 for name, change in changes.items()}
        return Unknowns(self.unknowns).shaped(found | {"cab_place": FLIP * changes["cab_place"]})

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
    folder: Path,
    name: str,
    plant: Hexapod,
    law: Law,
    pose: Array,
    box: Box,
    changes: Mapping[str, Array],
) -> Path:
    """Write a machine with its law as files, and the scenario that `cmf run` replays it by.

    The law knows the nominal cab. The run begins in the pose and steps all axes by a small step.
    """
    cab, oil, tables = plant.cab_parameters, plant.parameters, []
    assert cab is not None
    for part in (oil, cab):
        changed = Unknowns(box.unknowns).apply(box.values(changes), part, name)
        before, after = (
            one.model_dump(mode="json", exclude_none=True, exclude={"nominal", "name"})
            for one in (part, changed)
        )
        tables.append({field: value for field, value in after.items() if value != before[field]})
    modes = dict(zip((name,), bound(law, plant).modes.values(), strict=False))  # none in legs
    known_law = law.model_copy(update={"name": f"{law.name}_{name}", "modes": modes})
    save_law(known_law, in_folder(folder, "law.toml"))
    steps = [
        {"kind": "step", "dof": dof, "amplitude": [float(SMALL * size), unit], "at": 0.5}
        for dof, size, unit in zip(DOFS, REPORT_AMPLITUDES, 3 * ("m",) + 3 * ("rad",), strict=True)
    ]
    stay: dict[str, Any] = {"kind": "waypoints", "times": [0.0, 12.0], "poses": [pose.tolist()] * 2}
    files: dict[str, dict[str, Any]] = {
        "hydraulics.toml": {"base": oil.name, name: tables[0]},
        "cab.toml": {"base": cab.name, name: tables[1]},
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
