"""Loads the shipped hydraulic sets and a user's own.

>>> cmf_mj.load_hydraulics("report").name
'report'
"""

from pathlib import Path

from cmf_mj.core.settings import Loader
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
