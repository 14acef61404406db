"""Time the closed loop against bare mj_step calls in one run; print JSON.

All times in microseconds are of a control frame or step, the least of several repetitions, with
CPU time, which other work on the machine disturbs least; ratios are medians over runs made one
after the other. Bare steps are made from compiled code like the loop's, the platform held by its
static load: `drawn` is the machine with its geoms under MuJoCo's defaults (implicitfast, islands,
warm start, timers), `headless` what the loop steps. `outside` is the share of a simulated second
that `simulate` spends outside the loop, `speed_up_two_threads` the work done by two threads over
that of one in the same time, by the clock on the wall. --start adds what a user waits for: import,
`cmf --help`, and the first comparison with nothing compiled. --exudyn adds the CPU time of the
open-loop run of `tests/crosscheck` in Exudyn over ours: with steps of one frame in both, and
with steps at which both are off by at most 1 um of leg extension. Ours takes no longer step than a
frame; Exudyn's step and time for an error follow from its order 2, error ~ step^2 ~ 1 / time^2.
--flight adds the seconds flown per second of one processor, washout, whole facility, record and
comparison of what is felt included, and that time over as many bare steps. --study adds the cost of
a linear case of the `mismatch` study, and the processor time of one process over that of two.
--exports adds the CPU time of a first FMU with nothing kept, and that of others over it.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from joblib import Parallel, delayed, parallel_config
from numba import njit
from threadpoolctl import threadpool_limits

from cmf_mj import Hexapod, load_hydraulics, load_law, signals, simulate
from cmf_mj.core.files import write_json, write_text
from cmf_mj.core.result import Table
from cmf_mj.core.units import FRAME, RATE
from cmf_mj.facility import loop
from cmf_mj.machine.cab import load_cab
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.fly import fly
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.plant import native
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.plant.native import without_sensors
from cmf_mj.studies.engine import CASES, evaluate_tasks
from cmf_mj.studies.settings import StudyCase, load_study

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from crosscheck.verification import ENGINES, in_mujoco, valve_sines, verify  # noqa: E402


@njit(nogil=True, cache=True)
def _bare(step, model, data, frames):  # type: ignore[no-untyped-def]
    for _ in range(frames):
        native.call(step, model, data)


def drawn_model() -> mujoco.MjModel:
    """The machine with its geoms and MuJoCo's default settings."""
    model = hexapod_model()
    off = mujoco.mjtDisableBit
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags &= ~int(off.mjDSBL_ISLAND | off.mjDSBL_WARMSTART)
    return model


def bare_seconds(model: mujoco.MjModel, load: np.ndarray, frames: int) -> float:
    """CPU time of mj_step alone, the platform held by its static leg forces."""
    data = mujoco.MjData(model)
    data.ctrl[:] = load
    step = native.address("mj_step")
    return _timed(lambda: _bare(step, model._address, data._address, frames))


def loop_seconds(plant: Hexapod, law: str, command: signals.Command) -> tuple[float, float]:
    """CPU time of `simulate`, recording at 128 Hz as the facility does, and of its loop alone."""
    inside, compiled = [0.0], loop.run

    def run(*arguments: object) -> object:
        begin = time.thread_time()
        result = compiled(*arguments)
        inside[0] += time.thread_time() - begin
        return result

    loop.run = run
    try:
        whole = _timed(lambda: simulate(plant, law, command, record_every=16))
    finally:
        loop.run = compiled
    return whole, inside[0]


def starting(environment: dict[str, str]) -> dict[str, float]:
    """Seconds by the clock until a fresh process has done what a user waits for."""
    compare = ["-m", "cmf_mj", "compare", "--laws", "velocity", "--dofs", "heave"]
    commands = {
        "import_s": ["-c", "import cmf_mj; cmf_mj.Hexapod"],
        "help_s": ["-m", "cmf_mj", "--help"],
        "first_compare_s": compare,
        "second_compare_s": compare,
    }
    times = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, command in commands.items():
            begin = time.perf_counter()
            subprocess.run(
                [sys.executable, *command],
                cwd=folder,
                env=environment | {"NUMBA_CACHE_DIR": f"{folder}/compiled"},
                check=True,
                capture_output=True,
            )
            times[name] = round(time.perf_counter() - begin, 2)
    return times


def against_exudyn(repeat: int) -> dict[str, float]:
    """Exudyn's CPU time over ours at equal step and at an equal error."""
    result = verify(parts=(1, 2, 4))
    ours, theirs = (next(r for r in result.runs if r.engine == e) for e in ENGINES)
    cab, hydraulics, valves = load_cab("gfd"), load_hydraulics("report"), valve_sines(4.0)
    least = min(in_mujoco(valves, FRAME, cab, hydraulics).cpu_time for _ in range(repeat))
    equal = theirs.cpu_time / least
    return {
        "exudyn_equal_step": round(equal, 1),
        "exudyn_at_1_um": round(equal * (theirs.extension_error / 1e-6) ** 0.5, 1),
        "exudyn_at_our_error": round(
            equal * (theirs.extension_error / ours.extension_error) ** 0.5, 1
        ),
        "our_error_um": round(ours.extension_error * 1e6, 3),
        "exudyn_error_um": round(theirs.extension_error * 1e6, 3),
    }


def flying(repeat: int, bare: Callable[[int], float]) -> dict[str, float]:
    """A flight of twenty seconds from aircraft to cab, and that over bare steps."""
    motion = load_flight("engine_failure").motion
    rows = motion.time <= motion.time[0] + 20.0
    motion = PilotMotion(*(getattr(motion, one.name)[rows] for one in fields(motion)))
    ratios, factors = [], []
    for number in range(repeat + 1):  # the first compiles
        begin = time.process_time()
        flown = float(fly(motion, "velocity").operation.record.time[-1])
        spent = time.process_time() - begin
        if number:
            factors.append(flown / spent)
            ratios.append(spent / bare(round(flown * RATE)))
    return {"flight_real_time_factor": round(max(factors), 2), "flight": round(min(ratios), 3)}


EXPORTS = """
import json, os, sys
from pathlib import Path
from cmf_mj import Hexapod, SingleLegs, load_machine
from cmf_mj.export.fmu import export_fmu
from cmf_mj.export.library import export_law, export_library
times = [sum(os.times()[:4])]
lab, out = Hexapod(machine="lab"), Path(sys.argv[1])
for work in (
    lambda: export_fmu(Hexapod(), "velocity", out / "first.fmu"),
    lambda: export_fmu(lab, lab.machine.law, out / "other.fmu", fmi=3),
    lambda: export_library(lab, None, out / "machine"),
    lambda: export_library(SingleLegs(), None, out / "legs"),
    lambda: export_law("modal_plan", out / "law"),
):
    work()
    times.append(sum(os.times()[:4]))
print(json.dumps(times))
"""


def exporting() -> dict[str, float]:
    """CPU time of a first FMU with nothing kept [s], and the longest of four others over it."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": f"{folder}/compiled"}
        command = [sys.executable, "-c", EXPORTS, folder]
        done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    first, *others = np.diff(json.loads(done.stdout.splitlines()[-1]))
    return {"export_s": round(first, 1), "export_again": round(max(others) / first, 4)}


def studying(repeat: int) -> dict[str, float]:
    """Linear cases of four machines of the `mismatch` study in one process and in two."""
    study = load_study("mismatch", changes={"draws": 4, "cabs": ["gfd"]})
    count, cases = len(study.laws), [case for case in study.cases if case.draw >= 0]
    machines = [cases[i : i + count] for i in range(0, len(cases), count)]
    spent: dict[int, list[float]] = {1: [], 2: []}
    with threadpool_limits(1), parallel_config(backend="loky", inner_max_num_threads=1):
        for number, jobs in product(range(repeat + 1), (1, 2)):  # the first imports
            times = Parallel(n_jobs=jobs, batch_size=1)(delayed(_attempted)(m) for m in machines)
            if number:
                spent[jobs].append(sum(times))
    return {
        "study_case_s": round(min(spent[1]) / len(cases), 4),
        "study_two_processes": round(min(spent[1]) / min(spent[2]), 3),
    }


def _attempted(machine: list[StudyCase]) -> float:
    begin = time.process_time()
    evaluate_tasks(machine, CASES)
    return time.process_time() - begin


def table(result: dict[str, Any]) -> Table:
    """What was measured, in words."""
    words = {
        "drawn_us": "bare step, drawn model, MuJoCo's defaults [us]",
        "headless_us": "bare step, headless model [us]",
        "frame_us": "control frame: machine, hydraulics, control law, record [us]",
        "frame_over_drawn": "frame over drawn step",
        "frame_over_headless": "frame over headless step",
        "real_time_factor": "times real time, one core",
        "outside": "share of a simulated second outside the loop",
        "speed_up_two_threads": "two threads over one",
        "import_s": "import [s]",
        "help_s": "`cmf --help` [s]",
        "first_compare_s": "first `cmf compare --laws velocity --dofs heave`, nothing compiled [s]",
        "second_compare_s": "the same again [s]",
        "flight_real_time_factor": "seconds flown with the pilot per second of one processor",
        "flight": "a flight's time over as many bare steps of the headless model",
        "study_case_s": "a linear case of the `mismatch` study, processor time [s]",
        "study_two_processes": "processor time of one process over that of two",
        "export_s": "first FMU with nothing kept [s]",
        "export_again": "the longest of four further exports over it",
        "exudyn_equal_step": "Exudyn's CPU time over ours, steps of 1/2048 s",
        "exudyn_at_our_error": "the same at the error of our step of 1/2048 s",
        "exudyn_at_1_um": "the same at an error of at most 1 um",
    }
    rows = [(text, f"{result[name]:.3g}") for name, text in words.items() if name in result]
    return Table("", ("what", "measured"), rows)


def _timed(work: Callable[[], object]) -> float:
    begin = time.thread_time()
    work()
    return time.thread_time() - begin


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--law", default="position_error_rate")
    parser.add_argument("--seconds", type=float, default=10.0, help="simulated time of one run")
    parser.add_argument("--repeat", type=int, default=15)
    parser.add_argument("--start", action="store_true", help="also import, help, first comparison")
    parser.add_argument("--exudyn", action="store_true", help="also against Exudyn")
    parser.add_argument("--flight", action="store_true", help="also a flight")
    parser.add_argument("--study", action="store_true", help="also a study in two processes")
    parser.add_argument("--exports", action="store_true", help="also exports")
    parser.add_argument("--out", type=Path, help="folder for bench.json and the table bench.md")
    options = parser.parse_args()
    if options.repeat < 1 or options.seconds < 1.0:
        parser.error("--repeat must be at least 1 and --seconds at least 1")

    command = signals.sine("heave", 0.33 * 0.0254, 1.0, cycles=options.seconds)
    second = signals.sine("heave", 0.33 * 0.0254, 1.0, cycles=1)
    frames, law = command.pose.shape[0], load_law(options.law)
    plants = [Hexapod(), Hexapod()]
    drawn, headless = drawn_model(), without_sensors(plants[0].model)
    plants[0].start()
    load = plants[0].static_load()
    for plant in plants:
        loop_seconds(plant, options.law, second)
    bare_seconds(headless, load, 10)

    rows, shares, one, two = [], [], [], []
    with ThreadPoolExecutor(2) as pool:
        for _ in range(options.repeat):
            frame = loop_seconds(plants[0], options.law, command)[1]
            bare = bare_seconds(drawn, load, frames)
            with native.without_clock():
                rows.append((frame, bare, bare_seconds(headless, load, frames)))
            whole, inside = loop_seconds(plants[0], options.law, second)
            shares.append(1.0 - inside / whole)
            begin = time.perf_counter()
            simulate(plants[0], law, command, record_every=16)
            one.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            list(pool.map(lambda plant: simulate(plant, law, command, record_every=16), plants))
            two.append(time.perf_counter() - begin)
    times = np.array(rows)
    least = times.min(axis=0) / frames * 1e6
    ratios = np.median(times[:, :1] / times[:, 1:], axis=0)
    result = {
        **dict(zip(("frame_us", "drawn_us", "headless_us"), least.round(3).tolist(), strict=True)),
        "frame_over_drawn": round(float(ratios[0]), 4),
        "frame_over_headless": round(float(ratios[1]), 4),
        "outside": round(float(np.median(shares)), 4),
        "real_time_factor": round(FRAME / least[0] * 1e6, 1),
        "speed_up_two_threads": round(2.0 * min(one) / min(two), 3),
        "frames": frames,
        "repeat": options.repeat,
        "law": options.law,
    }
    if options.start:
        result |= starting(dict(os.environ))
    if options.flight:
        with native.without_clock():
            result |= flying(3, lambda count: bare_seconds(headless, load, count))
    if options.study:
        result |= studying(options.repeat)
    if options.exports:
        result |= exporting()
    if options.exudyn:
        result |= against_exudyn(options.repeat)
    print(json.dumps(result, indent=2))
    if options.out:
        write_json(options.out / "bench.json", result)
        write_text(options.out / "bench.md", table(result).markdown())


if __name__ == "__main__":
    main()
