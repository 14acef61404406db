"""Loads the shipped hydraulic sets and a user's own.

>>> cmf_mj.load_hydraulics("report").name
'report'
"""

from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Fitting, Loader, merged, validated
from cmf_mj.machine.machine import Machine, load_machine
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


_LENGTHS, _SPEEDS, _PRESSURES = ("in", "m", "mm"), ("in/s", "m/s", "mm/s"), ("psi", "Pa", "bar")


@lru_cache
def fitting(machine: Machine) -> Fitting | None:
    """Fits shipped settings, whose numbers are the CMF's, to another machine; None for the CMF.

    Ranges, thresholds, tolerances and noise go with what they belong to: lengths with the half
    stroke, speeds with the limit of leg velocity, pressures with the supply. All else stays.
    """
    own, cmf = (
        (one.half_stroke, one.limits.leg.velocity.si, hydraulics_of(one).supply_pressure.si)
        for one in (machine, load_machine())
    )
    if own == cmf:
        return None
    scale = {
        unit: mine / its
        for units, mine, its in zip((_LENGTHS, _SPEEDS, _PRESSURES), own, cmf, strict=True)
        for unit in units
    }
    return partial(_fitted, scale, machine.name)


def _fitted(scale: dict[str, float], name: str, table: dict[str, Any]) -> dict[str, Any]:
    """A table with its quantities in proportion; tables in it likewise."""
    factor = scale.get(str(table.get("unit", "")).removesuffix("/rtHz"))
    if factor is not None:
        source = f"{table['source']}; of the CMF, here in proportion to {name}"
        return table | {"value": table["value"] * factor, "source": source}
    return {
        key: _fitted(scale, name, entry) if isinstance(entry, dict) else entry
        for key, entry in table.items()
    }
