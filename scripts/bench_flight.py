"""Time a flight from aircraft to cab against the time flown and bare mj_step calls; print JSON.

`real_time_factor` is seconds flown per second of one processor's time: washout, whole facility,
record and comparison of what is felt included, compilation not. `ratio` is the processor's time for
the flight over that for as many bare mj_step calls on the headless model in the same run. Least of
several repetitions each.
"""

import argparse
import json
import time

from bench import bare_seconds

from cmf_mj import Hexapod
from cmf_mj.core.units import RATE
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.fly import fly
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.plant.native import quiet, untimed


def part(motion: PilotMotion, seconds: float) -> PilotMotion:
    """The first seconds of a motion."""
    rows = motion.time <= motion.time[0] + seconds
    return PilotMotion(
        motion.time[rows],
        motion.specific_force[rows],
        motion.angular_rate[rows],
        motion.attitude[rows],
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flight", default="engine_failure")
    parser.add_argument("--law", default="velocity")
    parser.add_argument("--seconds", type=float, default=20.0, help="of the flight")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    if options.repeat < 1 or options.seconds < 1.0:
        parser.error("--repeat must be at least 1 and --seconds at least 1")
    motion = part(load_flight(options.flight).motion, options.seconds)
    fly(part(motion, 1.0), options.law)
    plant = Hexapod()
    plant.start()
    model, load = quiet(plant.model), plant.static_load()
    bare_seconds(model, load, 10)
    flights, bares = [], []
    for _ in range(options.repeat):
        begin = time.process_time()
        ride = fly(motion, options.law)
        flights.append(time.process_time() - begin)
        frames = round(float(ride.operation.record.time[-1]) * RATE)
        with untimed():
            bares.append(bare_seconds(model, load, frames))
    flown = float(ride.operation.record.time[-1])
    print(
        json.dumps(
            {
                "flight": options.flight,
                "law": options.law,
                "seconds": flown,
                "real_time_factor": flown / min(flights),
                "ratio": min(flights) / min(bares),
            },
            indent=2,
        )
    )


if __name__ == "__main__":
    main()
