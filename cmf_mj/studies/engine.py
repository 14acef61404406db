"""The engine: runs the tasks of a study that have no result yet, on threads, processes or Dask.

Results are the same bits whatever runs them, and stand in the order of the tasks. The process that
was asked keeps the journal; workers only compute, so they need no shared disk. A task that fails is
a row with its error. A worker that dies takes no result with it: its tasks run again, and one that
kills its worker every time is a row with an error too.
"""

import re
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, get_args

import pyarrow as pa
from joblib import Parallel, delayed, parallel_config
from threadpoolctl import threadpool_limits

from cmf_mj.core.errors import InputError, check_name, require
from cmf_mj.core.files import write_parquet
from cmf_mj.core.threads import MOST_JOBS
from cmf_mj.studies.evaluation import ROW_COLUMNS, evaluate, failed
from cmf_mj.studies.journal import RESULTS, Journal, Row
from cmf_mj.studies.settings import CASE_COLUMNS, Study, StudyCase

Backend = Literal["threading", "loky", "dask"]
"""Threads, for compiled simulation releases the interpreter lock; processes; a Dask cluster."""

_ADDRESS = re.compile(r"((tcp|tls|ws|wss)://)?[^/:\s]+:[0-9]{1,5}")

Progress = Callable[[int, int], None]
"""Called with (tasks done, tasks in all)."""

_TEXT = ("method", "rung", "cab", "law", "dof", "error_type", "error_message")
_OTHERS = {"case": pa.int64(), "draw": pa.int64(), "stable": pa.bool_()}

SCHEMA = pa.schema(
    [
        (name, pa.string() if name in _TEXT else _OTHERS.get(name, pa.float64()))
        for name in (*CASE_COLUMNS, *ROW_COLUMNS)
    ]
)
"""Columns of the results: the case's, then those of its rows."""


class WorkerDied(RuntimeError):
    """The process that ran a task ended: killed, out of memory, or crashed."""


class Task(Protocol):
    """One thing to compute, everything in it that a worker needs."""

    @property
    def number(self) -> int:
        """Its place among the tasks of the study, from 0."""


class Work(NamedTuple):
    """How tasks become rows."""

    evaluate: Callable[[Any, dict[str, Any]], list[Row]]
    """Rows of a task; the dictionary is shared by tasks that run together."""
    failed: Callable[[BaseException], list[Row]]  #: Rows of a task that cannot be run.
    machine: Callable[[Any], Hashable]
    """Neighbouring tasks of the same machine go to one worker together."""


def attempt(tasks: Sequence[Task], work: Work) -> list[tuple[int, list[Row]]]:
    """Run tasks one after the other; what one raises becomes its rows.

    With one thread of linear algebra, since sums in another order have other bits.
    """
    results = []
    shared: dict[str, Any] = {}
    for task in tasks:
        try:
            with threadpool_limits(limits=1):
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
        if not 1 <= self.jobs <= MOST_JOBS:
            raise InputError(f"jobs: {self.jobs} must be at least 1 and at most {MOST_JOBS}")
        check_name("backend", self.backend, get_args(Backend))
        if self.scheduler is not None and self.backend != "dask":
            raise InputError(
                f"scheduler: {self.scheduler} needs the backend dask, not {self.backend}"
            )
        if self.scheduler is not None and not _ADDRESS.fullmatch(self.scheduler):
            allowed = "allowed: an address such as tcp://host:8786"
            raise InputError(f"scheduler: {self.scheduler!r} is refused; {allowed}")


def run_tasks(
    journal: Journal,
    tasks: Sequence[Task],
    work: Work,
    workers: Workers,
    progress: Progress | None = None,
) -> None:
    """Run the tasks that the journal has no result of."""

    def pending() -> list[Task]:
        return [task for task in tasks if task.number not in journal.results]

    def report() -> None:
        if progress is not None:
            progress(len(tasks) - len(pending()), len(tasks))

    report()
    if not pending():
        return
    alone = False
    with _started(workers) as count:
        while left := pending():
            chosen = left[:1] if alone else left
            try:
                for number, rows in _results(chosen, work, count):
                    journal.add(number, rows)
                    report()
                alone = False
            except _deaths() as error:
                if alone:
                    text = f"its worker died again, running nothing else: {type(error).__name__}"
                    journal.add(chosen[0].number, work.failed(WorkerDied(text)))
                    report()
                # A death that let nothing finish: find the task that brings it.
                alone = not alone and len(pending()) == len(left)


def run_study(
    study: Study, folder: str | Path, *, progress: Progress | None = None, **workers: Any
) -> pa.Table:
    """Run what is left of a study.

    Finished cases in `folder` are not run again; `workers` as for `Workers`. The rows, in the order
    of the cases, also go to `results.parquet`.
    """
    how = Workers(**workers)
    journal = Journal(Path(folder), study.identity())
    cases = study.cases
    run_tasks(journal, cases, CASES, how, progress)
    columns: dict[str, list[Any]] = {name: [] for name in SCHEMA.names}
    for case in cases:
        for row in journal.results[case.number]:
            for name, value in (case.columns | row).items():
                columns[name].append(value)
    table = pa.table(columns, schema=SCHEMA.with_metadata({"study": journal.identity}))
    write_parquet(table, journal.folder / RESULTS)
    return table


def _evaluated(case: StudyCase, shared: dict[str, Any]) -> list[Row]:
    return [row.columns for row in evaluate(case, shared)]


def _failed(error: BaseException) -> list[Row]:
    return [failed(error).columns]


def _machine(case: StudyCase) -> Hashable:
    """The laws of a machine that is linearised run together: it is linearised once."""
    if case.method != "linear":
        return case.number
    return case.rung, case.case.cab, case.case.pose, case.draw


CASES = Work(_evaluated, _failed, _machine)
"""Work of a study of cases."""


def _results(tasks: Sequence[Task], work: Work, jobs: int) -> Iterator[tuple[int, list[Row]]]:
    """What tasks give, as they finish."""
    together = [list(group) for _, group in groupby(tasks, work.machine)]
    pool = Parallel(
        n_jobs=jobs, batch_size=1, pre_dispatch="2*n_jobs", return_as="generator_unordered"
    )
    for results in pool(delayed(attempt)(group, work) for group in together):
        yield from results


def _deaths() -> tuple[type[BaseException], ...]:
    """What joblib raises where a worker dies."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    deaths: tuple[type[BaseException], ...] = (TerminatedWorkerError,)
    try:
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker
    except ModuleNotFoundError:
        return deaths
    return (*deaths, KilledWorker, FutureCancelledError)


@contextmanager
def _started(workers: Workers) -> Iterator[int]:
    """Choose what runs joblib's tasks; gives their number."""
    backend, jobs = workers.backend, workers.jobs
    options: dict[str, Any] = {"inner_max_num_threads": 1} if backend == "loky" else {}
    if backend != "dask":
        with parallel_config(backend=backend, n_jobs=jobs, **options):
            yield jobs
        return
    local = {"n_workers": jobs, "threads_per_worker": 1, "processes": True}
    options = (
        {"address": workers.scheduler}
        if workers.scheduler
        else {**local, "dashboard_address": None}
    )
    with require("distributed", "cluster").Client(**options) as client:
        count = max(1, sum(client.nthreads().values()))
        with parallel_config(backend=backend, n_jobs=count, client=client):
            yield count
