"""Loads the shipped hydraulic sets and a user's own."""

from pathlib import Path

from cmf_mj.parameters.hydraulics import HydraulicParameters
from cmf_mj.settings import read_toml, validated

HYDRAULICS = ("report", "hardware", "lossy")
"""Names of the shipped parameter sets."""

_FILE = Path(__file__).with_name("hydraulics.toml")


def load_hydraulics(source: str | Path | HydraulicParameters = "hardware") -> HydraulicParameters:
    """Load a hydraulic parameter set.

    Args:
        source: `report`, `hardware`, `lossy`, the path of a TOML file with `base` naming one of
            them and one table of changes, or a set already loaded.

    Raises:
        ValueError: unknown set, unreadable file or a refused field; each is named.
    """
    if isinstance(source, HydraulicParameters):
        return source
    shipped = read_toml(_FILE)
    if str(source) in HYDRAULICS:
        name = str(source)
        table = shipped["common"] | shipped[name]
        return validated(HydraulicParameters, table | {"name": name}, f"{_FILE.name}: {name}")
    path = Path(source)
    if path.suffix != ".toml":
        raise ValueError(
            f"hydraulics: {str(source)!r} is not one of {', '.join(HYDRAULICS)} nor a .toml file"
        )
    own = read_toml(path)
    base = own.pop("base", None)
    if base not in HYDRAULICS:
        raise ValueError(f"{path}: base: {base!r} is not one of {', '.join(HYDRAULICS)}")
    if len(own) != 1 or not isinstance(next(iter(own.values())), dict):
        raise ValueError(f"{path}: has the tables {sorted(own)}; exactly one is allowed")
    name, changes = next(iter(own.items()))
    if "name" in changes:
        raise ValueError(f"{path}: {name}: name: is taken from the table; leave it out")
    table = shipped["common"] | shipped[base] | changes | {"name": name}
    return validated(HydraulicParameters, table, f"{path}: {name}")
