"""A plant from names."""

from pathlib import Path

from cmf_mj.core.errors import check_name
from cmf_mj.machine.cab import Cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs

PLANTS = ("hexapod", "single_legs")
"""The faithful plant and the report's original one."""


def make_plant(
    plant: str = "hexapod",
    cab: str | Path | Cab = "gfd",
    hydraulics: str | Path | HydraulicParameters = "hardware",
) -> Plant:
    """Build a new plant: one of `PLANTS` with a cab, of which single legs have none."""
    check_name("plant", plant, PLANTS)
    return Hexapod(cab, hydraulics) if plant == "hexapod" else SingleLegs(hydraulics)
