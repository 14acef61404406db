"""Scenarios, runs as files: the shipped ones by their names, and others, read and written."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.files import write_text
from cmf_mj.core.settings import read_toml, validated
from cmf_mj.facility.run import Run
from cmf_mj.machine import models
from cmf_mj.signals.signal import plain


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios."""
    return tuple(sorted(path.stem for path in models.directory("scenarios").glob("*.toml")))


def load_scenario(source: str | Path) -> Run:
    """A scenario; `source` is the name of a shipped one, or a TOML file.

    Names of files in it count from its folder; a refusal has one line a key, with what is allowed.

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
    """A scenario from plain values, lists included, as TOML and JSON have them.

    Errors call it `where`; relative file names count from `folder`, default the working folder.
    """
    for name in ("source", "start"):
        if name in table:
            raise InputError(f"{where}: {name}: is in no file; a program gives it to `cmf_mj.Run`")
    return validated(Run, _located(plain(table), (folder or Path()).resolve()), where)


def save_scenario(scenario: Run, path: str | Path) -> Path:
    """Write a scenario as TOML, defaults left out; it reads back equal."""
    return write_text(Path(path), scenario_toml(scenario))


def scenario_toml(scenario: Run) -> str:
    """A scenario as TOML text, defaults left out."""
    return tomlkit.dumps(scenario.table())


_FILES = (
    *("machine", "cab", "hydraulics", "law", "protection", "sensors", "converters", "servo"),
    *("dcu", "limits", "states"),
)
"""Keys that hold a name or a TOML file."""


def _located(table: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The table with its file names counted from a folder."""

    def one(key: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return _located(value, folder)
        if isinstance(value, tuple):
            return tuple(one("", entry) for entry in value)
        named = key in _FILES and isinstance(value, str) and ".toml" in value
        text = isinstance(value, str) and value
        return str(folder / value) if named or (key == "file" and text) else value

    return {key: one(key, value) for key, value in table.items()}
