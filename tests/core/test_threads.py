import threading

import pytest

from cmf_mj.core.threads import on_threads


def test_results_stand_in_the_order_of_the_cases() -> None:
    """The first case waits for the last: all run at once, and the last is finished first."""
    last = threading.Event()
    told = []

    def work(case: int) -> int:
        if case == 0:
            assert last.wait(10.0)
        if case == 2:
            last.set()
        return case**2

    found = on_threads(
        work, range(3), jobs=3, progress=lambda done, total: told.append((done, total))
    )
    assert found == [0, 1, 4]
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_an_error_of_a_case_comes_through() -> None:
    with pytest.raises(ZeroDivisionError):
        on_threads(lambda case: 1 / case, [1, 0], jobs=1)


@pytest.mark.parametrize("jobs", [0, -1])
def test_too_few_threads_are_refused_before_anything_runs(jobs: int) -> None:
    ran: list[int] = []
    with pytest.raises(
        ValueError, match=f"jobs: {jobs} is refused; allowed: a whole number from 1"
    ):
        on_threads(ran.append, [1], jobs=jobs)
    assert not ran
