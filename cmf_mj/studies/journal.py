"""The folder of a study: what it is, the results so far, the finished table.

    study.json        what the study runs, with versions and a digest of the sources
    journal.jsonl     a line a finished case, written in one piece and flushed to the disk
    results.parquet   all rows in the order of the cases, once all are finished

A line that a killed process left half-written is no JSON; its case runs again. Numbers survive
the journal to the bit: JSON holds the shortest digits that read back the same.
"""

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file, write_text
from cmf_mj.studies.evaluation import ROW_COLUMNS, StudyRow
from cmf_mj.studies.settings import CASE_COLUMNS, Study, StudyCase

SPECIFICATION, JOURNAL, RESULTS = "study.json", "journal.jsonl", "results.parquet"

_TEXT = ("method", "rung", "cab", "law", "dof", "error_type", "error_message")
_OTHERS = {"case": pa.int64(), "draw": pa.int64(), "stable": pa.bool_()}

SCHEMA = pa.schema(
    [
        (name, pa.string() if name in _TEXT else _OTHERS.get(name, pa.float64()))
        for name in (*CASE_COLUMNS, *ROW_COLUMNS)
    ]
)
"""Columns of the results: the case's, then those of its rows."""


class Journal:
    """Results of a study as they come."""

    def __init__(self, folder: Path, study: Study) -> None:
        """Open the folder of a study, new or with a part of it.

        Refuses a folder that holds another study, or the same one of other sources.
        """
        self.folder = folder
        self.study = study
        folder.mkdir(parents=True, exist_ok=True)
        identity, path = json.loads(json.dumps(study.identity())), folder / SPECIFICATION
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
        self.results: dict[int, list[dict[str, Any]]] = {}
        """Rows of the finished cases, by number."""
        path = folder / JOURNAL
        content = path.read_bytes() if path.exists() else b""
        if content and not content.endswith(b"\n"):  # the next line starts on its own
            with path.open("ab") as file:
                file.write(b"\n")
        for line in content.splitlines():
            with suppress(ValueError):  # torn, or no text at all
                entry = json.loads(line)
                self.results[entry["case"]] = entry["rows"]

    @property
    def pending(self) -> list[StudyCase]:
        """Cases without a result."""
        return [case for case in self.study.cases if case.number not in self.results]

    def add(self, number: int, rows: Sequence[StudyRow]) -> None:
        """Keep what a case gave."""
        text = json.dumps({"case": number, "rows": [row.columns for row in rows]}) + "\n"
        with (self.folder / JOURNAL).open("ab", buffering=0) as file:
            file.write(text.encode())
            os.fsync(file.fileno())
        self.results[number] = json.loads(text)["rows"]

    def table(self) -> pa.Table:
        """All rows so far, in the order of the cases."""
        columns: dict[str, list[Any]] = {name: [] for name in SCHEMA.names}
        for case in self.study.cases:
            for row in self.results.get(case.number, []):
                for name, value in (case.columns | row).items():
                    columns[name].append(value)
        identity = json.dumps(self.study.identity(), sort_keys=True)
        return pa.table(columns, schema=SCHEMA.with_metadata({"study": identity}))

    def consolidate(self) -> pa.Table:
        """Write the finished table."""
        table = self.table()
        with whole_file(self.folder / RESULTS) as partial:
            pq.write_table(table, partial)
        return table


def _entries(identity: dict[str, Any]) -> dict[str, Any]:
    """What an identity says, the entries of its tables by path."""
    return {
        f"{name}.{key}" if key else name: entry
        for name, value in identity.items()
        for key, entry in (value.items() if isinstance(value, dict) else [("", value)])
    }
