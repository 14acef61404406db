"""The scenarios that are shipped: worked examples, by the name of their file."""

from pathlib import Path

from cmf_mj.core.errors import check_name
from cmf_mj.core.settings import read_toml
from cmf_mj.facility.scenario.settings import Scenario, scenario_of
from cmf_mj.machine import models


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios."""
    return tuple(sorted(path.stem for path in models.directory("scenarios").glob("*.toml")))


def load_scenario(source: str | Path) -> Scenario:
    """A scenario by the name of a shipped one, or from a TOML file.

    Args:
        source: the name, or a file; names of files in it count from its folder.

    Raises:
        InputError: an unknown name, an unreadable file, or one line a refused key with what is
            allowed.

    >>> scenario = cmf_mj.load_scenario("heave_sine")
    >>> scenario.law, scenario.duration
    ('velocity', 8.0)
    """
    path = Path(source)
    if path.suffix != ".toml":
        check_name("scenario", str(source), scenario_names(), " nor a .toml file")
        path = models.directory("scenarios") / f"{source}.toml"
    return scenario_of(read_toml(path), str(path), path.parent)
