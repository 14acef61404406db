"""The folder of a study: what it is, the results so far, the finished table.

    study.json        what the study runs, with versions and a digest of the sources
    journal.jsonl     a line a finished task, written in one piece and flushed to the disk
    results.parquet   all rows in the order of the tasks, once all are finished

A line that a killed process left half-written is no JSON; its task runs again. Numbers survive
the journal to the bit: JSON holds the shortest digits that read back the same.
"""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text
from cmf_mj.machine import models

SPECIFICATION, JOURNAL, RESULTS = "study.json", "journal.jsonl", "results.parquet"

Row = dict[str, Any]
"""One result: JSON values by the name of their column."""

_ROOT = Path(__file__).resolve().parents[1]


class Journal:
    """Results of a study as they come."""

    def __init__(self, folder: Path, study: Mapping[str, Any]) -> None:
        """Open the folder of a study, new or with a part of it.

        `study` is what two runs must share for their results to stand in one table, as JSON values;
        versions and sources are added. Refuses a folder that holds another study, or the same one
        of other sources.
        """
        self.folder = folder
        libraries = ("mujoco", "numpy", "scipy", "numba")
        identity = {
            **json.loads(json.dumps(study)),
            "sources": _sources(),
            "versions": {name: version(name) for name in libraries},
        }
        self.identity = json.dumps(identity, sort_keys=True)
        """What the study is, as JSON."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / SPECIFICATION
        if path.exists():
            there, here = _entries(json.loads(path.read_text(encoding="utf-8"))), _entries(identity)
            names = sorted(there.keys() | here.keys())
            differing = [name for name in names if there.get(name) != here.get(name)]
            if differing:
                raise InputError(
                    f"{folder}: holds a study that differs in {', '.join(differing)}; "
                    "allowed: the same study, or another folder"
                )
        elif (folder / JOURNAL).exists():
            raise InputError(f"{folder}: holds a journal without its {SPECIFICATION}")
        else:
            write_text(path, json.dumps(identity, indent=1))
        self.results: dict[int, list[Row]] = {}
        """Rows of the finished tasks, by number."""
        path = folder / JOURNAL
        content = path.read_bytes() if path.exists() else b""
        if content and not content.endswith(b"\n"):  # the next line starts on its own
            with path.open("ab") as file:
                file.write(b"\n")
        for line in content.splitlines():
            with suppress(ValueError):  # torn, or no text at all
                entry = json.loads(line)
                self.results[entry["task"]] = entry["rows"]

    def add(self, number: int, rows: Sequence[Row]) -> None:
        """Keep what a task gave."""
        text = json.dumps({"task": number, "rows": rows}) + "\n"
        with (self.folder / JOURNAL).open("ab", buffering=0) as file:
            file.write(text.encode())
            os.fsync(file.fileno())
        self.results[number] = json.loads(text)["rows"]


def _entries(identity: dict[str, Any]) -> dict[str, Any]:
    """What an identity says, the entries of its tables by path."""
    return {
        f"{name}.{key}" if key else name: entry
        for name, value in identity.items()
        for key, entry in (value.items() if isinstance(value, dict) else [("", value)])
    }


@lru_cache
def _sources() -> str:
    """Digest of all sources that results can depend on: not of those that draw and print them."""
    digest = hashlib.sha256()
    paths = [*_ROOT.rglob("*.py"), *_ROOT.rglob("*.toml"), *models.directory().rglob("*.xml")]
    for path in sorted(paths):
        if path.parent.name in ("cli", "ready") or "show" in path.parts:
            continue
        digest.update(json.dumps([path.name, path.read_text(encoding="utf-8")]).encode())
    return digest.hexdigest()
