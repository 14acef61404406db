"""The folder of a study: what it is, the results so far, the finished table.

    study.json        what the study runs, with versions and a digest of the sources
    journal.jsonl     a line a finished task with its checksum, written in one piece and flushed
    results.parquet   all rows in the order of the tasks, once all are finished

A line that a killed process left half-written, or that is damaged, is dropped and its task runs
again; of damaged lines it is told how many. Numbers survive the journal to the bit: JSON holds the
shortest digits that read back the same.
"""

import hashlib
import json
import os
import sys
import zlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text
from cmf_mj.core.settings import parsed_json
from cmf_mj.machine import models

SPECIFICATION, JOURNAL, RESULTS = "study.json", "journal.jsonl", "results.parquet"

Row = dict[str, Any]
"""One result: JSON values by the name of their column."""

_SUM = 9  # characters of a line's checksum

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
            there, here = _entries(_specification(path)), _entries(identity)
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
        *lines, torn = content.split(b"\n")
        whole = [line for line in lines if self._keep(line)]
        if torn or len(whole) < len(lines):
            write_text(path, b"".join(line + b"\n" for line in whole).decode())
        if len(whole) < len(lines):
            damaged = f"{len(lines) - len(whole)} of {len(lines)} lines are damaged"
            print(f"cmf: {path}: {damaged}; their tasks run again", file=sys.stderr)

    def _keep(self, line: bytes) -> bool:
        """Keep the result of a line, if it is as it was written."""
        text = line[_SUM:]
        if line[:_SUM] != _checksum(text):
            return False
        entry = json.loads(text)
        self.results[entry["task"]] = entry["rows"]
        return True

    def add(self, number: int, rows: Sequence[Row]) -> None:
        """Keep what a task gave."""
        text = json.dumps({"task": number, "rows": rows}).encode()
        line = _checksum(text) + text
        with (self.folder / JOURNAL).open("ab", buffering=0) as file:
            file.write(line + b"\n")
            os.fsync(file.fileno())
        self._keep(line)


def _checksum(text: bytes) -> bytes:
    """What stands before a line, `_SUM` characters."""
    return b"%08x " % zlib.crc32(text)


def _specification(path: Path) -> dict[str, Any]:
    try:
        content = parsed_json(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: is not the specification of a study")
    return content


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
