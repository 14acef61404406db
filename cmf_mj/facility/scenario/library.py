"""The scenarios that are shipped: worked examples, by the name of their file."""

from pathlib import Path

from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario.settings import Scenario, load_scenario
from cmf_mj.machine import models


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios."""
    return tuple(sorted(path.stem for path in models.scenario_directory().glob("*.toml")))


def find_scenario(source: str | Path) -> Scenario:
    """A scenario by the name of a shipped one, or from a TOML file.

    Raises:
        InputError: neither, or a refused key.
    """
    text = str(source)
    if text.endswith(".toml"):
        return load_scenario(text)
    if text in scenario_names():
        return load_scenario(models.scenario_directory() / f"{text}.toml")
    raise InputError(
        f"scenario: {text!r} is neither a .toml file nor one of {', '.join(scenario_names())}"
    )
