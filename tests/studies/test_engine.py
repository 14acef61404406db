"""The study engine: same bits whatever runs it, nothing lost when something dies."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from distributed import Client
from shared import cmf

from cmf_mj.analysis.measures import Measures
from cmf_mj.studies import engine
from cmf_mj.studies.engine import JOURNAL, RESULTS, Journal, Row, run_study
from cmf_mj.studies.evaluation import error_row
from cmf_mj.studies.settings import Study, StudyCase, load_study, study_table

SPECIFICATION = """
title = "test"
method = "linear"
laws = ["velocity", "position_error_rate"]
poses = [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, -60.0, 0.0, 0.0, 0.0]]
draws = 4
[mismatch.leak_rate]
path = "hydraulics.actuators.*.leak_rate"
distribution = "lognormal"
deviation = 30.0
source = "test"
[mismatch.leg_velocity]
path = "electronics.leg_velocity.gain_errors.*"
effect = "offset"
distribution = "normal"
deviation = 1.0
source = "test"
"""
CASES = 20  # two poses, five machines, two laws


BIAS = "electronics.leg_position.bias"


@pytest.fixture(scope="module")
def specification(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "small.toml"
    path.write_text(SPECIFICATION)
    return path


@pytest.fixture(scope="module")
def study(specification: Path) -> Study:
    return load_study(specification)


@pytest.fixture(scope="module")
def finished(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study run in this process, one case after the other."""
    folder = tmp_path_factory.mktemp("finished")
    run_study(study, folder, jobs=1, backend="threading")
    return folder


def bits(folder: Path) -> bytes:
    return (folder / RESULTS).read_bytes()


def lines(folder: Path) -> int:
    path = folder / JOURNAL
    return path.read_bytes().count(b"\n") if path.exists() else 0


def test_rows_stand_in_the_order_of_the_cases(finished: Path, study: Study) -> None:
    table = pq.read_table(finished / RESULTS)
    numbers = table.column("case").to_pylist()
    assert numbers == sorted(numbers)
    assert len(set(numbers)) == CASES == len(study.cases)
    assert table.schema.metadata[b"study"]
    first = table.to_pylist()[0]
    assert (first["law"], first["draw"], first["dof"]) == ("velocity", -1, "surge")


def test_a_case_that_fails_is_a_row_with_its_error(finished: Path) -> None:
    """60 in up is beyond the stroke of every leg; all other cases have six rows each."""
    rows = pq.read_table(finished / RESULTS).to_pylist()
    failed = [row for row in rows if row["error_type"]]
    assert len(failed) == CASES // 2
    assert {row["error_type"] for row in failed} == {"InputError"}
    assert all("puts leg 1 at" in row["error_message"] for row in failed)
    assert not any(row["stable"] for row in failed)
    assert len(rows) - len(failed) == 6 * CASES // 2


@pytest.mark.slow
@pytest.mark.parametrize(("backend", "jobs"), [("threading", 2), ("loky", 2)])
def test_threads_and_processes_give_the_same_bits(
    backend: engine.Backend, jobs: int, study: Study, finished: Path, tmp_path: Path
) -> None:
    seen: list[tuple[int, int]] = []
    run_study(study, tmp_path, jobs=jobs, backend=backend, progress=lambda *done: seen.append(done))
    assert bits(tmp_path) == bits(finished)
    assert seen[0] == (0, CASES)
    assert seen[-1] == (CASES, CASES)


@contextmanager
def killing(processes: Callable[[], list[int]]) -> Iterator[engine.Progress]:
    """A progress that kills the first of some processes once two tasks are done."""
    killed: list[int] = []

    def kill_one(done: int, _: int) -> None:
        if done >= 2 and not killed:
            killed.append(processes()[0])
            os.kill(killed[0], signal.SIGKILL)

    yield kill_one
    assert killed


@pytest.mark.slow
def test_a_killed_process_of_the_pool_loses_nothing(
    study: Study, finished: Path, tmp_path: Path
) -> None:
    def pool() -> list[int]:
        children = psutil.Process().children()
        return [one.pid for one in children if any("LokyProcess" in x for x in one.cmdline())]

    with killing(pool) as kill_one:
        run_study(study, tmp_path, jobs=2, backend="loky", progress=kill_one)
    assert bits(tmp_path) == bits(finished)


def deadly(case: StudyCase, shared: dict[str, Any]) -> list[Row]:
    """Stands in for evaluation: the third case takes its worker down, whenever it is tried."""
    if case.number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return engine.CASES.evaluate(case, shared)


@pytest.mark.slow
def test_a_case_that_kills_every_worker_is_a_row_with_an_error(
    study: Study, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "CASES", engine.CASES._replace(evaluate=deadly))
    run_study(study, tmp_path, jobs=2, backend="loky")
    rows = pq.read_table(tmp_path / RESULTS).to_pylist()
    (lost,) = [row for row in rows if row["error_type"] == "WorkerDied"]
    assert lost["case"] == 2
    before = [row for row in pq.read_table(finished / RESULTS).to_pylist() if row["case"] != 2]
    kept = [row for row in rows if row["case"] != 2]
    assert json.dumps(kept) == json.dumps(before)


@contextmanager
def cluster() -> Iterator[tuple[str, list[int]]]:
    """A scheduler and two workers, each a process; their process numbers."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    program = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    port = 18786 + os.getpid() % 1000
    parts = [subprocess.Popen([*program, "--port", str(port), "--no-dashboard"], **quiet)]  # type: ignore[call-overload]
    address = f"tcp://127.0.0.1:{port}"
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-dashboard"]
    parts += [
        subprocess.Popen([*worker, "--nthreads", "1", "--no-nanny"], **quiet)  # type: ignore[call-overload]
        for _ in range(2)
    ]
    try:
        with Client(address, timeout=120) as client:
            client.wait_for_workers(2, timeout=120)
        yield address, [part.pid for part in parts[1:]]
    finally:
        for part in parts:
            part.kill()
        for part in parts:
            part.wait()


@pytest.mark.slow
def test_a_dask_cluster_that_loses_a_worker_loses_nothing(
    study: Study, finished: Path, tmp_path: Path
) -> None:
    with cluster() as (address, workers), killing(lambda: workers) as kill_one:
        run_study(study, tmp_path, backend="dask", scheduler=address, progress=kill_one)
    assert bits(tmp_path) == bits(finished)


def begin(specification: Path, folder: Path) -> subprocess.Popen[str]:
    """`cmf study` in another process, once its journal has a line and before its end."""
    command = [sys.executable, "-m", "cmf_mj", "study", str(specification), "--out"]
    process = subprocess.Popen(
        [*command, str(folder), "--backend", "threading"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    limit = time.monotonic() + 120.0
    while lines(folder) < 1 and process.poll() is None and time.monotonic() < limit:
        time.sleep(0.002)
    return process


def test_libraries_are_looked_for_before_threads_start(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search calls Python with the loader locked: beside an import it would never end."""
    looked: list[str] = []

    class Controller(engine.ThreadpoolController):  # type: ignore[misc]
        def __init__(self) -> None:
            looked.append(threading.current_thread().name)
            super().__init__()

    monkeypatch.setattr(engine, "ThreadpoolController", Controller)
    engine.libraries.cache_clear()
    run_study(study, tmp_path, backend="threading", jobs=2)
    assert looked == [threading.current_thread().name]


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_was(
    study: Study, specification: Path, finished: Path, tmp_path: Path
) -> None:
    """SIGKILL, and a line torn in the middle: the rest is run, the table is the same."""
    process = begin(specification, tmp_path)
    process.kill()
    process.communicate()
    kept = lines(tmp_path)
    assert 1 <= kept < CASES
    assert not (tmp_path / RESULTS).exists()
    with (tmp_path / JOURNAL).open("ab") as file:
        file.write(b'{"task": 19, "rows": [{"dof": "su')
    seen: list[int] = []
    run_study(study, tmp_path, backend="threading", progress=lambda done, _: seen.append(done))
    assert seen[0] == kept
    assert bits(tmp_path) == bits(finished)


def test_an_interrupted_run_says_how_to_go_on(
    study: Study, specification: Path, finished: Path, tmp_path: Path
) -> None:
    process = begin(specification, tmp_path)
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=120)
    assert process.returncode == 130, printed
    assert "interrupted; the same command continues" in printed
    assert 1 <= lines(tmp_path) < CASES
    again = cmf("study", specification, "--out", tmp_path, "--backend", "threading")
    assert "20 cases" in again and RESULTS in again
    assert bits(tmp_path) == bits(finished)
    with (tmp_path / "rates.csv").open(newline="") as file:
        laws = {row["law"] for row in csv.DictReader(file)}
    assert laws and all(law in (tmp_path / "rates.md").read_text() for law in laws)


def test_a_finished_study_is_not_run_again_also_by_another_title(
    study: Study,
    specification: Path,
    finished: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, folder = bits(finished), shutil.copytree(finished, tmp_path / "study")
    monkeypatch.setattr(engine, "evaluate_tasks", None)
    run_study(study, finished)
    assert bits(finished) == before
    table = run_study(load_study(specification, changes={"title": "A better title"}), folder)
    assert table.num_rows == pq.read_table(finished / "results.parquet").num_rows


def test_another_study_is_refused_and_what_differs_is_named(
    specification: Path, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = bits(finished)
    other = load_study(specification, changes={"draws": 5, "seed": 1})
    with pytest.raises(ValueError, match="differs in settings.draws, settings.seed; allowed"):
        run_study(other, finished)
    fewer = load_study(specification, laws=["velocity"])
    with pytest.raises(ValueError, match="differs in laws, settings.laws"):
        run_study(fewer, finished)
    monkeypatch.setattr("cmf_mj.studies.engine._source_digest", lambda: "of another day")
    with pytest.raises(ValueError, match="differs in sources; allowed: the same study"):
        run_study(load_study(specification), finished)
    assert bits(finished) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"jobs": 0}, "jobs: 0 is refused; allowed: a whole number from 1"),
        ({"jobs": 2.5}, "jobs: 2.5 is refused"),
        ({"backend": "smoke"}, "backend: 'smoke' is not one of threading, loky, dask"),
        ({"scheduler": "tcp://here:1"}, "scheduler: tcp://here:1 needs backend dask, not loky"),
        (
            {"scheduler": "127.0.0.1:9", "backend": "dask"},
            "scheduler: 127.0.0.1:9: .*Dask scheduler",
        ),
        ({"scheduler": "here:99999", "backend": "dask"}, "scheduler: here:99999: .*Dask scheduler"),
    ],
)
def test_bad_arguments_are_refused_before_a_folder_is_made(
    arguments: dict[str, object], message: str, study: Study, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        run_study(study, tmp_path / "new", **arguments)  # type: ignore[arg-type]
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"laws": ["fast"]}, "law: 'fast' is not one of"),
        ({"cabs": ["bus"]}, "cab: 'bus'"),
        ({"dofs": ["up"]}, "dofs: 'up' is not one of surge"),
        ({"rungs": ["top"]}, "rungs: 'top'"),
        ({"rungs": ["friction"]}, "rungs: 'friction' has no linearisation"),
        ({"poses": [[0.0]]}, r"poses: \[0.0\] must be six numbers"),
        ({"mismatch": {}}, "draws: 4 machines are alike"),
        (
            {"mismatch": {"x": {"path": "machine.floor", "deviation": 1.0, "source": "s"}}},
            "mismatch.x: machine.floor: a study varies all but the machine",
        ),
        (
            {
                "mismatch": {
                    "x": {
                        "path": BIAS,
                        "deviation": 1.0,
                        "unit": "in",
                        "effect": "offset",
                        "source": "s",
                    }
                }
            },
            f"mismatch.x: {BIAS}: needs the method sweep",
        ),
    ],
)
def test_bad_specifications_are_refused(
    changes: dict[str, object], message: str, specification: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        load_study(specification, changes=changes)


def test_numbers_survive_the_journal_to_the_bit(study: Study, tmp_path: Path) -> None:
    journal = Journal(tmp_path, study.identity())
    row = error_row(ValueError("x"))._replace(
        measures=Measures(overshoot=np.nextafter(0.1, 1.0)), dof="surge"
    )
    journal.add(0, [row.columns])
    (again,) = Journal(tmp_path, study.identity()).results[0]
    assert again["overshoot"] == row.measures.overshoot
    assert np.isnan(again["peak_gain_db"])


def test_a_column_that_the_first_row_lacks_is_kept(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rows(case: StudyCase, _: dict[str, Any]) -> list[Row]:
        return [{"x": 1.0} | ({"later": "y"} if case.number else {})]

    monkeypatch.setattr(engine, "CASES", engine.CASES._replace(evaluate=rows))
    table = run_study(study, tmp_path, backend="threading")
    assert table["later"].to_pylist() == [None] + ["y"] * (CASES - 1)


def test_ready_studies_are_sound() -> None:
    """The ladder is 9 rungs, 9 laws, 6 degrees of freedom; the drawn machines as documented."""
    assert len(load_study("ablation").cases) == 486
    mismatch = load_study("mismatch").cases
    draws = load_study("mismatch").settings.draws
    assert len(mismatch) == 27 * (draws + 1)
    allowed = "ablation, effects, mismatch"
    with pytest.raises(ValueError, match=f"study: base: 'all' is not one of {allowed}"):
        load_study({"base": "all"})
    assert study_table({"base": "effects"})[0].keys() >= {"effects", "unknowns"}  # of its base
