"""What does a study cost, and what do two processes gain? Prints JSON.

Runs the linear cases of the `mismatch` study in one process and in two, in turn, and compares wall
time and processor time. `efficiency` is the wall time of one over twice that of two: it needs two
free cores. `cpu_efficiency`, the processor time of one over that of two, does not.
"""

import argparse
import json
import os
import time

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before NumPy: one process is to be one core

import numpy as np  # noqa: E402
from joblib import Parallel, delayed, parallel_config  # noqa: E402

from cmf_mj.studies.engine import CASES, attempt  # noqa: E402
from cmf_mj.studies.settings import StudyCase, load_study  # noqa: E402


def timed(machine: list[StudyCase]) -> float:
    """Processor time of the cases of one machine [s]."""
    begin = time.process_time()
    attempt(machine, CASES)
    return time.process_time() - begin


def main() -> None:
    """Parse the arguments and measure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=12, help="machines of each run")
    parser.add_argument("--repeat", type=int, default=3, help="pairs of runs")
    options = parser.parse_args()
    study = load_study(
        "mismatch", changes={"draws": options.machines, "cabs": ["gfd"], "simulate_every": 0}
    )
    count = len(study.laws)
    cases = [case for case in study.cases if case.draw >= 0]
    machines = [cases[i : i + count] for i in range(0, len(cases), count)]
    wall: dict[int, list[float]] = {1: [], 2: []}
    spent: dict[int, list[float]] = {1: [], 2: []}
    with parallel_config(backend="loky", inner_max_num_threads=1):
        for jobs in (1, 2):  # imports and caches
            Parallel(n_jobs=jobs, batch_size=1)(delayed(timed)(m) for m in machines[:2])
        for _ in range(options.repeat):
            for jobs in (1, 2):
                begin = time.perf_counter()
                found = Parallel(n_jobs=jobs, batch_size=1)(delayed(timed)(m) for m in machines)
                wall[jobs].append(time.perf_counter() - begin)
                spent[jobs].append(sum(found))
    ratios = np.array(wall[1]) / np.array(wall[2])
    print(
        json.dumps(
            {
                "cases": len(cases),
                "efficiency": round(float(np.median(ratios)) / 2.0, 3),
                "cpu_efficiency": round(min(spent[1]) / min(spent[2]), 3),
                "cpu_seconds_a_case": round(min(spent[1]) / len(cases), 4),
                "minutes_for_1000_cases_on_two_cores": round(
                    1000.0 * min(spent[2]) / len(cases) / 120.0, 2
                ),
            }
        )
    )


if __name__ == "__main__":
    main()
