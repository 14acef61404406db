"""Loads the shipped hydraulic sets and a user's own."""

from pathlib import Path

from cmf_mj.core.settings import named_set, validated
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters

HYDRAULICS = ("report", "hardware", "lossy")
"""Names of the shipped parameter sets."""

_FILE = Path(__file__).with_name("hydraulics.toml")


def load_hydraulics(source: str | Path | HydraulicParameters = "hardware") -> HydraulicParameters:
    """Load a hydraulic parameter set.

    Args:
        source: `report`, `hardware`, `lossy`, the path of a TOML file with `base` naming one of
            them and one table of changes, or a set already loaded.

    Raises:
        InputError: unknown set, unreadable file or a refused field; each is named.
    """
    if isinstance(source, HydraulicParameters):
        return source
    table, where = named_set("hydraulics", HYDRAULICS, _FILE, source, levels=0)
    return validated(HydraulicParameters, table, where)
