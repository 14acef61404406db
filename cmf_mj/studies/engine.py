"""The engine: runs the tasks of a study that have no result yet, on threads, processes or Dask.

Results are the same bits whatever runs them, and stand in the order of the tasks. The process that
was called keeps the journal; workers only compute, so they need no shared disk. A task that fails
is a row with its error. A worker that dies takes no result with it: its tasks run again, and one
that kills its worker every time is a row with an error too.

    study.json        what the study runs, with versions and a digest of the sources
    journal.jsonl     a line for each finished task, with its checksum, written in one piece
    results.parquet   all rows in the order of the tasks, once all are finished

An unfinished or damaged line is dropped and its task runs again. Numbers survive to the bit.
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
from cmf_mj.core.files import write_text
from cmf_mj.core.settings import parsed_json
from cmf_mj.core.tables import write_parquet
from cmf_mj.core.threads import MOST_JOBS
from cmf_mj.machine import models
from cmf_mj.studies.evaluation import error_row, evaluate
from cmf_mj.studies.settings import Study, StudyCase

SPECIFICATION, JOURNAL, RESULTS = "study.json", "journal.jsonl", "results.parquet"

Row = dict[str, Any]  #: One result: JSON values by the name of their column.

_LIBRARIES = ("mujoco", "numpy", "scipy", "numba")  #: Their versions belong to a study.
_CHECKSUM, _ENTRY = slice(None, 9), slice(9, None)  #: Bytes of a line.
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
        identity = {
            **json.loads(json.dumps(study)),
            "sources": _source_digest(),
            "versions": {name: version(name) for name in _LIBRARIES},
        }
        self.identity = json.dumps(identity, sort_keys=True)  #: What the study is, as JSON.
        self.results: dict[int, list[Row]] = {}  #: Rows of the finished tasks, by number.
        folder.mkdir(parents=True, exist_ok=True)
        self._check_study(identity)
        self._read_results()

    def _check_study(self, identity: dict[str, Any]) -> None:
        """Refuse a folder of another study; write what the study is to a new one."""
        path = self.folder / SPECIFICATION
        if not path.exists():
            if (self.folder / JOURNAL).exists():
                raise InputError(f"{self.folder}: holds a journal without its {SPECIFICATION}")
            write_text(path, json.dumps(identity, indent=1))
            return
        try:
            content = parsed_json(path.read_bytes(), str(path))
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from error
        if not isinstance(content, dict):
            raise InputError(f"{path}: is not the specification of a study")
        written, own = _entries_by_path(content), _entries_by_path(identity)
        names = sorted((written.keys() | own.keys()) - {"settings.title"})  # changes no result
        as_text = partial(json.dumps, sort_keys=True)  # where NaN is NaN
        differing = [n for n in names if as_text(written.get(n)) != as_text(own.get(n))]
        if differing:
            raise InputError(
                f"{self.folder}: holds a study that differs in {', '.join(differing)}; "
                "allowed: the same study, or another folder"
            )

    def _read_results(self) -> None:
        """Read the sound lines of the journal, and drop all others from its file."""
        path = self.folder / JOURNAL
        content = path.read_bytes() if path.exists() else b""
        *lines, unfinished_line = content.split(b"\n")
        sound_lines = [line for line in lines if self._take(line)]
        damaged_count = len(lines) - len(sound_lines)
        if unfinished_line or damaged_count:
            write_text(path, b"".join(line + b"\n" for line in sound_lines).decode())
        if damaged_count:
            text = f"{damaged_count} of {len(lines)} lines are damaged"
            print(f"cmf: {path}: {text}; their tasks run again", file=sys.stderr)

    def _take(self, line: bytes) -> bool:
        """Take the result of a line; false where the line is not as it was written."""
        if line[_CHECKSUM] != _checksum(line[_ENTRY]):
            return False
        entry = json.loads(line[_ENTRY])
        self.results[entry["task"]] = entry["rows"]
        return True

    def add(self, number: int, rows: Sequence[Row]) -> None:
        """Add the rows of a task."""
        entry = json.dumps({"task": number, "rows": rows}).encode()
        line = _checksum(entry) + entry
        with (self.folder / JOURNAL).open("ab") as file:
            file.write(line + b"\n")
            file.flush()  # all of it, or an error where the disk is full
            os.fsync(file.fileno())
        self._take(line)


def _checksum(entry: bytes) -> bytes:
    """Checksum of an entry with a space, which stand before it in its line."""
    return b"%08x " % zlib.crc32(entry)


def _entries_by_path(identity: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of an identity and of the tables in it, by path."""
    return {
        f"{name}.{key}" if key else name: entry
        for name, value in identity.items()
        for key, entry in (value.items() if isinstance(value, dict) else [("", value)])
    }


@lru_cache
def _source_digest() -> str:
    """Digest of all sources that results can depend on: not of those that draw and print them."""
    digest = hashlib.sha256()
    paths = [(root, path) for pattern, root in _SOURCES for path in root.rglob(pattern)]
    for name, path in sorted((path.relative_to(root).as_posix(), path) for root, path in paths):
        if path.parent.name not in ("cli", "ready") and not name.startswith("show/"):
            digest.update(json.dumps([name, path.read_text(encoding="utf-8")]).encode())
    return digest.hexdigest()


Backend = Literal["threading", "loky", "dask"]
"""Threads, for compiled simulation releases the interpreter lock; processes; a Dask cluster."""

_ADDRESS = re.compile(r"(?:(?:tcp|tls|ws|wss)://)?([^/:\s]+):([0-9]{1,5})")
_ANSWER_TIME = 5.0  #: Time that a scheduler has to answer [s].

Progress = Callable[[int, int], None]  #: Called with (tasks done, tasks in all).

_DEATH_ERRORS = {"TerminatedWorkerError", "KilledWorker", "FutureCancelledError"}
"""Classes of what joblib and Dask raise where a worker dies."""


class WorkerDied(RuntimeError):
    """The process that ran a task ended: killed, out of memory, or crashed."""


class Work(NamedTuple):
    """How tasks become rows; a task holds all that a worker needs, and its `number` from 0."""

    evaluate: Callable[[Any, dict[str, Any]], list[Row]]
    """Rows of a task; the dictionary is shared by tasks that run together."""
    error_rows: Callable[[BaseException], list[Row]]  #: Rows of a task that cannot be run.
    machine_of: Callable[[Any], Hashable]
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


def evaluate_tasks(tasks: Sequence[Any], work: Work) -> list[tuple[int, list[Row]]]:
    """Number and rows of tasks that run one after the other; an error becomes rows too.

    With one thread of linear algebra, since sums in another order have other bits.
    """
    results, shared = [], dict[str, Any]()
    for task in tasks:
        try:
            with one_library_thread():
                rows = work.evaluate(task, shared)
        except Exception as error:  # whatever it is, the study goes on
            rows = work.error_rows(error)
        results.append((task.number, rows))
    return results


@dataclass(frozen=True)
class Workers:
    """What runs tasks: `jobs` threads or processes, or a Dask cluster."""

    jobs: int = 1
    backend: Backend = "loky"
    scheduler: str | None = None  #: Address of a Dask scheduler; default a local one with `jobs`.

    def __post_init__(self) -> None:
        """Refuse what does not go together, or a scheduler that does not answer."""
        whole("jobs", self.jobs, 1, MOST_JOBS)
        check_name("backend", self.backend, get_args(Backend))
        if self.backend == "dask":
            require("distributed", "cluster")
        if self.scheduler is None:
            return
        if self.backend != "dask":
            raise InputError(f"scheduler: {self.scheduler} needs backend dask, not {self.backend}")
        address = _ADDRESS.fullmatch(self.scheduler)
        if address is None:
            allowed = "allowed: an address such as tcp://host:8786"
            raise InputError(f"scheduler: {self.scheduler!r} is refused; {allowed}")
        host, port = address.groups()
        try:
            socket.create_connection((host, int(port)), _ANSWER_TIME).close()
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

    def unfinished() -> list[Any]:
        return [task for task in tasks if task.number not in journal.results]

    def report() -> None:
        if progress is not None:
            progress(len(tasks) - len(unfinished()), len(tasks))

    report()
    if not unfinished():
        return
    runs_alone = False  # the first task without a result, on a worker of its own
    dispatch: dict[str, Any] = {"batch_size": 1, "pre_dispatch": "2*n_jobs"}
    with one_library_thread(), _start_workers(workers) as worker_count:
        while remaining := unfinished():
            candidates = remaining[:1] if runs_alone else remaining
            batches = [list(batch) for _, batch in groupby(candidates, work.machine_of)]
            pool = Parallel(n_jobs=worker_count, return_as="generator_unordered", **dispatch)
            try:
                results = pool(delayed(evaluate_tasks)(batch, work) for batch in batches)
                for number, rows in chain.from_iterable(results):
                    journal.add(number, rows)
                    report()
                runs_alone = False
            except Exception as error:
                if type(error).__name__ not in _DEATH_ERRORS:
                    raise
                if runs_alone:
                    text = f"its worker died again, running alone: {type(error).__name__}"
                    journal.add(candidates[0].number, work.error_rows(WorkerDied(text)))
                    report()
                # A death that let nothing finish: find the task that brings it.
                runs_alone = not runs_alone and len(unfinished()) == len(remaining)


@dataclass
class TaskRunner:
    """Runs one list of tasks after the other, numbered on from list to list."""

    journal: Journal
    make_task: Callable[..., Any]  #: Makes a task of its number, kind and case.
    work: Work
    workers: Workers
    progress: Progress | None
    task_count: int  #: Of all lists.
    done: int = 0  #: Tasks that are finished.

    def __call__(self, kind: str, cases: Sequence[tuple[Any, ...]]) -> list[list[Row]]:
        """Rows of each case."""
        first = self.done
        tasks = [self.make_task(number, kind, *case) for number, case in enumerate(cases, first)]
        self.done += len(tasks)

        def report(done: int, _: int) -> None:
            if self.progress is not None:
                self.progress(first + done, self.task_count)

        run_tasks(self.journal, tasks, self.work, self.workers, report)
        return [self.journal.results[task.number] for task in tasks]


def row_table(rows: Sequence[Row]) -> pa.Table:
    """Rows with the columns of all of them, not of the first alone; what a row lacks is null."""
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: [row.get(name) for row in rows] for name in names})


def run_study(
    study: Study, folder: str | Path, *, progress: Progress | None = None, **workers: Any
) -> pa.Table:
    """Run the cases of a study that have no result in `folder`; `workers` as for `Workers`.

    The rows, in the order of the cases, also go to `results.parquet`.
    """
    pool, cases = Workers(**workers), study.cases
    journal = Journal(Path(folder), study.identity())
    run_tasks(journal, cases, CASES, pool, progress)
    rows = [case.columns | row for case in cases for row in journal.results[case.number]]
    table = row_table(rows).replace_schema_metadata({"study": journal.identity})
    write_parquet(table, journal.folder / RESULTS)
    return table


def _machine_of(case: StudyCase) -> Hashable:
    """Key of cases whose machine is linearised once; other cases have one each."""
    if case.settings.method != "linear":
        return case.number
    return case.rung, case.case.cab, case.case.pose, case.draw


CASES = Work(
    lambda case, shared: [row.columns for row in evaluate(case, shared)],
    lambda error: [error_row(error).columns],
    _machine_of,
)
"""Work of a study of cases."""


@contextmanager
def _start_workers(workers: Workers) -> Iterator[int]:
    """Start what runs joblib's tasks; yields the number of workers."""
    if workers.backend != "dask":
        threads: dict[str, Any] = {"inner_max_num_threads": 1} if workers.backend == "loky" else {}
        with parallel_config(backend=workers.backend, n_jobs=workers.jobs, **threads):
            yield workers.jobs
        return
    options: dict[str, Any] = {"address": workers.scheduler}
    if workers.scheduler is None:
        options = {"n_workers": workers.jobs, "threads_per_worker": 1, "dashboard_address": None}
    with require("distributed", "cluster").Client(**options) as client:
        count = max(1, sum(client.nthreads().values()))
        with parallel_config(backend=workers.backend, n_jobs=count, client=client):
            yield count
