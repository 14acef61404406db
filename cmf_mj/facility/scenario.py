"""Scenarios, runs as files: the shipped ones by their names, and others, read and written."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.files import write_text
from cmf_mj.core.settings import beside, read_toml, validated
from cmf_mj.facility.run import Run
from cmf_mj.machine import models
from cmf_mj.signals.signal import as_plain


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios."""
    return tuple(sorted(path.stem for path in models.directory("scenarios").glob("*.toml")))


def load_scenario(source: str | Path) -> Run:
    """A scenario; `source` is the name of a shipped one, or a TOML file.

    File names in it are relative to its folder. Errors: one line per wrong key.

    >>> scenario = cmf_mj.load_scenario("heave_sine")
    >>> scenario.law, scenario.duration
    ('velocity', 8.0)
    """
    path = Path(source)
    if path.suffix != ".toml":
        check_name("scenario", str(source), scenario_names(), " nor a .toml file")
        path = models.directory("scenarios") / f"{source}.toml"
    return scenario_of(read_toml(path), str(path), path.parent)


def scenario_of(table: Mapping[str, Any], where: str, folder: Path | None = None) -> Run:
    """A scenario from plain values, as TOML and JSON have them, lists as tuples.

    Errors call it `where`; relative file names count from `folder`, default the working folder.
    """
    for name in ("source", "start"):
        if name in table:
            raise InputError(f"{where}: {name}: cannot stand in a file; give it to `cmf_mj.Run`")
    return validated(Run, _with_absolute_files(as_plain(table), folder or Path()), where)


def save_scenario(scenario: Run, path: str | Path) -> Path:
    """Write a scenario as TOML, as `scenario_toml`; it reads back as the same run."""
    return write_text(Path(path), scenario_toml(scenario))


def scenario_toml(scenario: Run) -> str:
    """A scenario as TOML text, defaults left out.

    File names, relative to the working folder, become absolute: the text may be saved anywhere.
    """
    return tomlkit.dumps(_with_absolute_files(scenario.table(), Path()))


_KEYS = "machine cab hydraulics law protection sensors converters servo dcu limits states".split()
"""Keys that hold the name of a shipped set, or a TOML file."""


def _with_absolute_files(table: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The table with its file names absolute; relative ones count from a folder."""
    base = folder.resolve()

    def resolved(key: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return _with_absolute_files(value, base)
        if isinstance(value, list | tuple):
            return type(value)(resolved(key, entry) for entry in value)
        if key in _KEYS and isinstance(value, str):
            return str(beside(base, value))
        return str(base / value) if key == "file" and value and isinstance(value, str) else value

    return {key: resolved(key, value) for key, value in table.items()}
