"""The engine: runs the cases of a study that have no result yet, on threads, processes or Dask.

Results are the same bits whatever runs them, and stand in the order of the cases. The process that
was asked keeps the journal; workers only compute, so they need no shared disk. A case that fails is
a row with its error. A worker that dies takes no result with it: its cases run again, and one that
kills its worker every time is a row with an error too.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, get_args

import pyarrow as pa
from control import StateSpace
from joblib import Parallel, delayed, parallel_config
from threadpoolctl import threadpool_limits

from cmf_mj.core.errors import InputError, check_name, require
from cmf_mj.studies.evaluation import StudyRow, evaluate, failed
from cmf_mj.studies.journal import Journal
from cmf_mj.studies.settings import Study, StudyCase

Backend = Literal["threading", "loky", "dask"]
"""Threads, for compiled simulation releases the interpreter lock; processes; a Dask cluster."""


class WorkerDied(RuntimeError):
    """The process that ran a case ended: killed, out of memory, or crashed."""


def attempt(cases: Sequence[StudyCase]) -> list[tuple[int, list[StudyRow]]]:
    """Run cases of one machine one after the other; what one raises becomes its row.

    With one thread of linear algebra, since sums in another order have other bits.
    """
    results = []
    shared: dict[str, StateSpace] = {}
    for case in cases:
        try:
            with threadpool_limits(limits=1):
                rows = evaluate(case, shared)
        except Exception as error:  # whatever it is, the study goes on
            rows = [failed(error)]
        results.append((case.number, rows))
    return results


def run_study(
    study: Study,
    folder: str | Path,
    *,
    jobs: int = 1,
    backend: Backend = "loky",
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pa.Table:
    """Run what is left of a study.

    Finished cases in `folder` are not run again. `jobs` threads or processes run the rest, or the
    workers of a Dask `scheduler` (its address; default a local cluster of `jobs`). `progress` is
    called with (cases done, cases in all). The rows, in the order of the cases, also go to
    `results.parquet`.
    """
    if jobs < 1:
        raise InputError(f"jobs: {jobs} must be at least 1")
    check_name("backend", backend, get_args(Backend))
    if scheduler is not None and backend != "dask":
        raise InputError(f"scheduler: {scheduler} needs the backend dask, not {backend}")
    journal = Journal(Path(folder), study)

    def keep(number: int, rows: Sequence[StudyRow]) -> None:
        journal.add(number, rows)
        report()

    def report() -> None:
        if progress is not None:
            progress(len(journal.results), len(study.cases))

    report()
    if not journal.pending:
        return journal.consolidate()
    alone = False
    with _workers(backend, jobs, scheduler) as count:
        while journal.pending:
            before = len(journal.results)
            cases = journal.pending[:1] if alone else journal.pending
            try:
                for number, rows in _results(cases, count):
                    keep(number, rows)
                alone = False
            except _deaths() as error:
                if alone:
                    text = f"its worker died again, running nothing else: {type(error).__name__}"
                    keep(cases[0].number, [failed(WorkerDied(text))])
                # A death that let nothing finish: find the case that brings it.
                alone = not alone and len(journal.results) == before
    return journal.consolidate()


def _results(
    cases: list[StudyCase], jobs: int, work: Callable[..., Any] = attempt
) -> Iterator[tuple[int, list[StudyRow]]]:
    """What cases give, as they finish.

    The laws of a machine that is linearised go to one worker together: it linearises once.
    """
    together = [list(group) for _, group in groupby(cases, _machine)]
    pool = Parallel(
        n_jobs=jobs, batch_size=1, pre_dispatch="2*n_jobs", return_as="generator_unordered"
    )
    for results in pool(delayed(work)(group) for group in together):
        yield from results


def _machine(case: StudyCase) -> object:
    if case.method != "linear":
        return case.number
    return case.rung, case.case.cab, case.case.pose, case.draw


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
def _workers(backend: Backend, jobs: int, scheduler: str | None) -> Iterator[int]:
    """Choose what runs joblib's tasks; gives their number."""
    options: dict[str, Any] = {"inner_max_num_threads": 1} if backend == "loky" else {}
    if backend != "dask":
        with parallel_config(backend=backend, n_jobs=jobs, **options):
            yield jobs
        return
    local = {"n_workers": jobs, "threads_per_worker": 1, "processes": True}
    options = {"address": scheduler} if scheduler else {**local, "dashboard_address": None}
    with require("distributed", "cluster").Client(**options) as client:
        count = max(1, sum(client.nthreads().values()))
        with parallel_config(backend=backend, n_jobs=count, client=client):
            yield count
