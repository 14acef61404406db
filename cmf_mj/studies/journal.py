"""The folder of a study: what it is, the results so far, the finished table.

    study.json        what the study runs, with versions and a digest of the sources
    journal.jsonl     a line a finished case, written in one piece and flushed to the disk
    results.parquet   all rows in the order of the cases, once all are finished

A line that a killed process left half-written is no JSON; its case runs again. Numbers survive
the journal to the bit: JSON holds the shortest digits that read back the same.
"""

import json
import os
from collections.abc import Mapping, Sequence
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
        self._identify()
        self.results = _lines(folder / JOURNAL)
        """Rows of the finished cases, by number."""

    def _identify(self) -> None:
        path = self.folder / SPECIFICATION
        identity = json.loads(json.dumps(self.study.identity()))
        if not path.exists():
            if (self.folder / JOURNAL).exists():
                raise InputError(f"{self.folder}: holds a journal without its {SPECIFICATION}")
            write_text(path, json.dumps(identity, indent=1))
            return
        differing = _differences(json.loads(path.read_text(encoding="utf-8")), identity)
        if differing:
            raise InputError(
                f"{self.folder}: holds a study that differs in {', '.join(differing)}; "
                "allowed: the same study, or another folder"
            )

    @property
    def pending(self) -> list[StudyCase]:
        """Cases without a result."""
        return [case for case in self.study.cases if case.number not in self.results]

    def add(self, number: int, rows: Sequence[StudyRow]) -> None:
        """Keep what a case gave."""
        entry = {"case": number, "rows": [row.columns for row in rows]}
        text = json.dumps(entry) + "\n"
        path = self.folder / JOURNAL
        torn = path.exists() and path.stat().st_size > 0 and not _ends_a_line(path)
        handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            os.write(handle, (("\n" if torn else "") + text).encode())
            os.fsync(handle)
        finally:
            os.close(handle)
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
        """Write the finished table; what is there already is the same."""
        table = self.table()
        with whole_file(self.folder / RESULTS) as partial:
            pq.write_table(table, partial)
        return table


def read_results(folder: str | Path) -> pa.Table:
    """The results of a finished study."""
    place = Path(folder)
    if (place / RESULTS).is_file():
        return pq.read_table(place / RESULTS)
    if (place / JOURNAL).is_file():
        count = len(_lines(place / JOURNAL))
        raise InputError(f"{place}: is not finished: {count} cases are; run the study to its end")
    raise InputError(f"{place}: holds no study")


def _lines(path: Path) -> dict[int, list[dict[str, Any]]]:
    results: dict[int, list[dict[str, Any]]] = {}
    if not path.exists():
        return results
    for line in path.read_bytes().split(b"\n"):
        try:
            entry = json.loads(line)
        except ValueError:  # torn, or no text at all
            continue
        results[entry["case"]] = entry["rows"]
    return results


def _ends_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


def _differences(there: Mapping[str, Any], here: Mapping[str, Any], before: str = "") -> list[str]:
    """Paths of the entries that differ, at most two levels deep."""
    names = []
    for name in sorted(set(there) | set(here)):
        one, other = there.get(name), here.get(name)
        if one == other:
            continue
        if not before and isinstance(one, dict) and isinstance(other, dict):
            names += _differences(one, other, f"{name}.")
        else:
            names.append(f"{before}{name}")
    return names
