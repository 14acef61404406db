"""Time the closed loop against bare mj_step calls in one run; print JSON.

`frame_us` and `bare_us` are microseconds per control frame of the closed loop and of mj_step alone
on the same model, holding its static load, the least of several repetitions; the bare calls are
made from compiled code like the loop's. `ratio` is the median over pairs of runs made one after
the other, which other work on the machine disturbs least. `speed_up_two_threads` is the work
done by two threads over that of one in the same time.
"""

import argparse
import json
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

from cmf_mj import Hexapod, signals, simulate
from cmf_mj.core.rates import FRAME
from cmf_mj.plant import native


@njit(nogil=True, cache=True)
def _bare(step, model, data, frames):  # type: ignore[no-untyped-def]
    for _ in range(frames):
        native.call(step, model, data)


def bare_seconds(plant: Hexapod, frames: int) -> float:
    """Time of mj_step alone, the platform held by its static leg forces."""
    plant.start()
    plant.data.ctrl[:] = plant.static_load()
    mechanics = plant.mechanics()
    step = native.address("mj_step")
    begin = time.perf_counter()
    _bare(step, mechanics.model, mechanics.data, frames)
    return time.perf_counter() - begin


def loop_seconds(plant: Hexapod, law: str, command: signals.Command) -> float:
    """Time of the closed loop, recording at 128 Hz as the facility does."""
    begin = time.perf_counter()
    simulate(plant, law, command, record_every=16)
    return time.perf_counter() - begin


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--law", default="position_error_rate")
    parser.add_argument("--seconds", type=float, default=10.0, help="simulated time of one run")
    parser.add_argument("--repeat", type=int, default=15)
    options = parser.parse_args()
    if options.repeat < 1 or options.seconds < 1.0:
        parser.error("--repeat must be at least 1 and --seconds at least 1")

    command = signals.sine("heave", 0.33 * 0.0254, 1.0, cycles=options.seconds)
    frames = command.pose.shape[0]
    plants = [Hexapod(), Hexapod()]
    loop_seconds(plants[0], options.law, signals.sine("heave", 0.001, 10.0))
    bare_seconds(plants[0], 10)

    loops, bares, pairs = [], [], []
    with ThreadPoolExecutor(2) as pool:
        for _ in range(options.repeat):
            loops.append(loop_seconds(plants[0], options.law, command))
            bares.append(bare_seconds(plants[0], frames))
            begin = time.perf_counter()
            list(pool.map(lambda plant: loop_seconds(plant, options.law, command), plants))
            pairs.append(time.perf_counter() - begin)
    loop, bare, pair = min(loops), min(bares), min(pairs)
    print(
        json.dumps(
            {
                "frame_us": round(loop / frames * 1e6, 3),
                "bare_us": round(bare / frames * 1e6, 3),
                "ratio": round(float(np.median(np.array(loops) / np.array(bares))), 4),
                "ratio_of_least": round(loop / bare, 4),
                "real_time_factor": round(frames * FRAME / loop, 2),
                "speed_up_two_threads": round(2.0 * loop / pair, 3),
                "frames": frames,
                "repeat": options.repeat,
                "law": options.law,
            },
            indent=2,
        )
    )


if __name__ == "__main__":
    main()
