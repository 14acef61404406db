"""A plant from names."""

from pathlib import Path

from cmf_mj.core.errors import check_name
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs

PLANTS = ("hexapod", "single_legs")
"""The faithful plant and the report's original one."""


def make_plant(
    plant: str = "hexapod",
    cab: str | Path | Cab | None = None,
    hydraulics: str | Path | HydraulicParameters | None = None,
    machine: str | Path | Machine | None = None,
) -> Plant:
    """Build a new plant: one of `PLANTS` with a cab, of which single legs have none."""
    check_name("plant", plant, PLANTS)
    if plant == "hexapod":
        return Hexapod(cab, hydraulics, machine=machine)
    return SingleLegs(hydraulics, machine=load_cab(cab, machine).machine)
