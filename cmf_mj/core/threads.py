"""Cases run side by side on threads, and the guard of what one thread alone may use.

Compiled loops release the interpreter lock, so that threads share the processor's cores.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from joblib import Parallel, delayed

from cmf_mj.core.arrays import whole
from cmf_mj.core.errors import InputError

MOST_JOBS = 1024  #: Most threads or processes of one command.

CaseT = TypeVar("CaseT")
ResultT = TypeVar("ResultT")


class OneAtATime:
    """Lets one thread in, `with` it, and refuses others until it leaves; a copy starts unlocked."""

    def __init__(self, refusal: str) -> None:
        """Refuse with this message."""
        self._refusal, self._lock = refusal, threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles take the message alone."""
        return OneAtATime, (self._refusal,)

    def __enter__(self) -> None:
        """Go in, or raise `InputError`."""
        if not self._lock.acquire(blocking=False):
            raise InputError(self._refusal)

    def __exit__(self, *_: object) -> None:
        """Leave."""
        self._lock.release()


def on_threads(
    work: Callable[[CaseT], ResultT],
    cases: Sequence[CaseT],
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[ResultT]:
    """Results of all cases, in their order, on `jobs` threads, by default one a core.

    The work on a case must share nothing that it changes with other cases. `progress` is called
    from the calling thread with (cases done, cases in all), after each and all before it.
    """
    if jobs is not None:
        whole("jobs", jobs, 1, MOST_JOBS)
    results: list[ResultT] = []
    pool = Parallel(n_jobs=jobs or -1, backend="threading", return_as="generator")
    for result in pool(delayed(work)(case) for case in cases):
        results.append(result)
        if progress is not None:
            progress(len(results), len(cases))
    return results
