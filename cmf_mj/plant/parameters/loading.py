"""Loads the shipped hydraulic sets and a user's own.

>>> cmf_mj.load_hydraulics("report").name
'report'
"""

from functools import lru_cache
from pathlib import Path

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Loader, merged, validated
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters

HYDRAULICS = ("report", "hardware", "lossy")
"""Names of the shipped parameter sets."""


load_hydraulics = Loader(
    HydraulicParameters,
    Path(__file__).with_name("hydraulics.toml"),
    what="hydraulics",
    names=HYDRAULICS,
    default="hardware",
    levels=0,
)
"""Loads a hydraulic parameter set: `report`, `hardware`, `lossy`, or a file with `base`
naming one of them and one table of changes."""


def hydraulics_of(
    machine: Machine, source: str | Path | HydraulicParameters | None = None
) -> HydraulicParameters:
    """A hydraulic set, by default that of the machine, whose half stroke its cylinders have.

    Raises:
        InputError: as `load_hydraulics`, or a refused table of the machine.
    """
    return _own(machine) if source is None else load_hydraulics(source)


@lru_cache
def _own(machine: Machine) -> HydraulicParameters:
    if isinstance(machine.hydraulics, str):
        return load_hydraulics(machine.hydraulics)
    where, changes = f"{machine.name}: hydraulics", dict(machine.hydraulics)
    base = load_hydraulics(
        check_name(f"{where}: base", changes.pop("base", "hardware"), HYDRAULICS)
    )
    for field, owner in (("name", "machine"), ("half_stroke", "table legs")):
        if field in changes:
            raise InputError(f"{where}: {field}: is taken from the {owner}; leave it out")
    own = {"name": machine.name, "half_stroke": machine.legs.half_stroke}
    return validated(
        HydraulicParameters, merged(base.model_dump(exclude_none=True), changes, 0) | own, where
    )
