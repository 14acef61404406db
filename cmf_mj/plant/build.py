"""A plant from names."""

from pathlib import Path

from cmf_mj.core.errors import check_name
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs

PLANTS = ("hexapod", "single_legs")
"""The faithful plant and the report's original one."""


def make_plant(
    plant: str = "hexapod",
    cab: str = "gfd",
    hydraulics: str | Path | HydraulicParameters = "hardware",
) -> Plant:
    """Build a new plant.

    Args:
        plant: one of `PLANTS`.
        cab: `gfd`, `rfd` or `ifd`; single legs have none.
        hydraulics: `report`, `hardware`, `lossy`, a TOML file or a loaded set.

    Raises:
        InputError: an unknown name or refused hydraulics.
    """
    check_name("plant", plant, PLANTS)
    return Hexapod(cab, hydraulics) if plant == "hexapod" else SingleLegs(hydraulics)
