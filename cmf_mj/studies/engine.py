"""The engine: runs the tasks of a study that have no result yet, on threads, processes or Dask.

Results are the same bits whatever runs them, and stand in the order of the tasks. The process that
was asked keeps the journal; workers only compute, so they need no shared disk. A task that fails is
a row with its error. A worker that dies takes no result with it: its tasks run again, and one that
kills its worker every time is a row with an error too.

The folder of a study: what it is, the results so far, the finished table.

    study.json        what the study runs, with versions and a digest of the sources
    journal.jsonl     a line a finished task with its checksum, written in one piece and flushed
    results.parquet   all rows in the order of the tasks, once all are finished

A line that a killed process left half-written, or that is damaged, is dropped and its task runs
again; of damaged lines it reports how many. Numbers survive the journal to the bit: JSON holds the
shortest digits that read back the same.
"""

import hashlib
import json
import os
import re
import socket
import sys
import zlib
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from importlib.metadata import version
from itertools import chain, groupby
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import pyarrow as pa
from joblib import Parallel, delayed, parallel_config
from threadpoolctl import ThreadpoolController

from cmf_mj.core.arrays import whole
from cmf_mj.core.errors import InputError, check_name, require
from cmf_mj.core.files import write_parquet, write_text
from cmf_mj.core.settings import parsed_json
from cmf_mj.core.threads import MOST_JOBS
from cmf_mj.machine import models
from cmf_mj.studies.evaluation import evaluate, failed
from cmf_mj.studies.settings import Study, StudyCase

SPECIFICATION, JOURNAL, RESULTS = "study.json", "journal.jsonl", "results.parquet"

Row = dict[str, Any]  #: One result: JSON values by the name of their column.

_SUM = 9  # characters of a line's checksum

_ROOT = Path(__file__).resolve().parents[1]
_SOURCES = (("*.py", _ROOT), ("*.toml", _ROOT), ("*.xml", models.directory()))


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
            try:
                content = parsed_json(path.read_bytes(), str(path))
            except OSError as error:
                raise InputError(f"{path}: cannot be read: {error.strerror}") from error
            if not isinstance(content, dict):
                raise InputError(f"{path}: is not the specification of a study")
            there, here = _entries(content), _entries(identity)
            names = sorted((there.keys() | here.keys()) - {"settings.title"})  # changes no result
            text = partial(json.dumps, sort_keys=True)  # where NaN is NaN
            differing = [name for name in names if text(there.get(name)) != text(here.get(name))]
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
        sound = [line for line in lines if self._keep(line)]
        if torn or len(sound) < len(lines):
            write_text(path, b"".join(line + b"\n" for line in sound).decode())
        if len(sound) < len(lines):
            damaged = f"{len(lines) - len(sound)} of {len(lines)} lines are damaged"
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
        with (self.folder / JOURNAL).open("ab") as file:
            file.write(line + b"\n")
            file.flush()  # all of it, or an error where the disk is full
            os.fsync(file.fileno())
        self._keep(line)


def _checksum(text: bytes) -> bytes:
    """What stands before a line, `_SUM` characters."""
    return b"%08x " % zlib.crc32(text)


def _entries(identity: Any) -> dict[str, Any]:
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
    found = [(root, path) for kind, root in _SOURCES for path in root.rglob(kind)]
    for name, path in sorted((path.relative_to(root).as_posix(), path) for root, path in found):
        if path.parent.name not in ("cli", "ready") and not name.startswith("show/"):
            digest.update(json.dumps([name, path.read_text(encoding="utf-8")]).encode())
    return digest.hexdigest()


Backend = Literal["threading", "loky", "dask"]
"""Threads, for compiled simulation releases the interpreter lock; processes; a Dask cluster."""

_ADDRESS = re.compile(r"(?:(?:tcp|tls|ws|wss)://)?([^/:\s]+):([0-9]{1,5})")

_PATIENCE = 5.0  #: Time that a scheduler has to answer [s].

Progress = Callable[[int, int], None]  #: Called with (tasks done, tasks in all).

_DEATHS = {"TerminatedWorkerError", "KilledWorker", "FutureCancelledError"}
"""What joblib and Dask raise where a worker dies."""


class WorkerDied(RuntimeError):
    """The process that ran a task ended: killed, out of memory, or crashed."""


class Work(NamedTuple):
    """How tasks become rows; a task holds all that a worker needs, and its `number` from 0."""

    evaluate: Callable[[Any, dict[str, Any]], list[Row]]
    """Rows of a task; the dictionary is shared by tasks that run together."""
    failed: Callable[[BaseException], list[Row]]  #: Rows of a task that cannot be run.
    machine: Callable[[Any], Hashable]
    """Neighbouring tasks of the same machine go to one worker together."""


@cache
def libraries() -> ThreadpoolController:
    """The libraries of linear algebra in this process, which are looked for once.

    Python calls back while the loader of libraries is locked: a thread that imports one meanwhile
    would wait for ever.
    """
    return ThreadpoolController()


@contextmanager
def one_library_thread() -> Iterator[None]:
    """Linear algebra on one thread: several on busy cores wait for each other, up to 40 times."""
    with libraries().limit(limits=1):
        yield


def attempt(tasks: Sequence[Any], work: Work) -> list[tuple[int, list[Row]]]:
    """Run tasks one after the other; what one raises becomes its rows.

    With one thread of linear algebra, since sums in another order have other bits.
    """
    results, shared = [], dict[str, Any]()
    for task in tasks:
        try:
            with libraries().limit(limits=1):
                rows = work.evaluate(task, shared)
        except Exception as error:  # whatever it is, the study goes on
            rows = work.failed(error)
        results.append((task.number, rows))
    return results


@dataclass(frozen=True)
class Workers:
    """What runs tasks: `jobs` threads or processes, or a Dask cluster."""

    jobs: int = 1
    backend: Backend = "loky"
    scheduler: str | None = None
    """Address of a running Dask scheduler; default a local cluster of `jobs`."""

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        whole("jobs", self.jobs, 1, MOST_JOBS)
        check_name("backend", self.backend, get_args(Backend))
        if self.backend == "dask":
            require("distributed", "cluster")
        if self.scheduler is not None:
            if self.backend != "dask":
                raise InputError(
                    f"scheduler: {self.scheduler} needs backend dask, not {self.backend}"
                )
            if not (address := _ADDRESS.fullmatch(self.scheduler)):
                allowed = "allowed: an address such as tcp://host:8786"
                raise InputError(f"scheduler: {self.scheduler!r} is refused; {allowed}")
            try:
                socket.create_connection((address[1], int(address[2])), _PATIENCE).close()
            except (OSError, OverflowError) as error:
                allowed = "allowed: the address of a Dask scheduler that runs"
                raise InputError(f"scheduler: {self.scheduler}: {error}; {allowed}") from error


def run_tasks(
    journal: Journal,
    tasks: Sequence[Any],
    work: Work,
    workers: Workers,
    progress: Progress | None = None,
) -> None:
    """Run the tasks that the journal has no result of."""

    def pending() -> list[Any]:
        return [task for task in tasks if task.number not in journal.results]

    def report() -> None:
        if progress is not None:
            progress(len(tasks) - len(pending()), len(tasks))

    report()
    if not pending():
        return
    alone = False
    how: dict[str, Any] = {"batch_size": 1, "pre_dispatch": "2*n_jobs"}
    with libraries().limit(limits=1), _started(workers) as count:
        while left := pending():
            chosen = left[:1] if alone else left
            together = [list(group) for _, group in groupby(chosen, work.machine)]
            pool = Parallel(n_jobs=count, return_as="generator_unordered", **how)
            try:
                results = pool(delayed(attempt)(group, work) for group in together)
                for number, rows in chain.from_iterable(results):
                    journal.add(number, rows)
                    report()
                alone = False
            except Exception as error:
                if type(error).__name__ not in _DEATHS:
                    raise
                if alone:
                    text = f"its worker died again, running alone: {type(error).__name__}"
                    journal.add(chosen[0].number, work.failed(WorkerDied(text)))
                    report()
                # A death that let nothing finish: find the task that brings it.
                alone = not alone and len(pending()) == len(left)


@dataclass
class Asker:
    """Runs one list of tasks after the other, numbered through, each with what went before."""

    journal: Journal
    task: Callable[..., Any]  #: Makes one of its number, kind and case.
    work: Work
    how: Workers
    progress: Progress | None
    every: int  #: Tasks in all.
    done: int = 0

    def __call__(self, kind: str, cases: Sequence[tuple[Any, ...]]) -> list[list[Row]]:
        """Rows of each case."""
        tasks = [self.task(self.done + i, kind, *case) for i, case in enumerate(cases)]
        before, self.done = self.done, self.done + len(tasks)

        def tell(count: int, _: int) -> None:
            if self.progress is not None:
                self.progress(before + count, self.every)

        run_tasks(self.journal, tasks, self.work, self.how, tell)
        return [self.journal.results[task.number] for task in tasks]


def row_table(rows: Sequence[Row]) -> pa.Table:
    """Rows with the columns of all of them, not of the first alone; what a row lacks is null."""
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: [row.get(name) for row in rows] for name in names})


def run_study(
    study: Study, folder: str | Path, *, progress: Progress | None = None, **workers: Any
) -> pa.Table:
    """Run what is left of a study.

    Finished cases in `folder` are not run again; `workers` as for `Workers`. The rows, in the order
    of the cases, also go to `results.parquet`.
    """
    how, cases = Workers(**workers), study.cases
    journal = Journal(Path(folder), study.identity())
    run_tasks(journal, cases, CASES, how, progress)
    rows = [case.columns | row for case in cases for row in journal.results[case.number]]
    table = row_table(rows).replace_schema_metadata({"study": journal.identity})
    write_parquet(table, journal.folder / RESULTS)
    return table


def _machine(case: StudyCase) -> Hashable:
    """The laws of a machine that is linearised run together: it is linearised once."""
    if case.study.method != "linear":
        return case.number
    return case.rung, case.case.cab, case.case.pose, case.draw


CASES = Work(
    lambda case, shared: [row.columns for row in evaluate(case, shared)],
    lambda error: [failed(error).columns],
    _machine,
)
"""Work of a study of cases."""


@contextmanager
def _started(workers: Workers) -> Iterator[int]:
    """Choose what runs joblib's tasks; gives their number."""
    backend, jobs = workers.backend, workers.jobs
    options: dict[str, Any] = {"inner_max_num_threads": 1} if backend == "loky" else {}
    if backend != "dask":
        with parallel_config(backend=backend, n_jobs=jobs, **options):
            yield jobs
        return
    options = {"n_workers": jobs, "threads_per_worker": 1, "dashboard_address": None}
    if workers.scheduler:
        options = {"address": workers.scheduler}
    with require("distributed", "cluster").Client(**options) as client:
        count = max(1, sum(client.nthreads().values()))
        with parallel_config(backend=backend, n_jobs=count, client=client):
            yield count
