"""Fly random, partly absurd flights with random washouts, laws and cabs; print JSON.

Three flights in four are in aircraft mode: specific forces and rates that are sums of random sines,
from a breath to ten g and ten rad/s, through a washout with random gains up to 3. One in four is in
direct mode: poses, velocities and accelerations far beyond the machine, with jumps. Of each run is
checked that

    every channel is a number,
    the leg references keep the working stroke, and their speed and acceleration limits,
    the machine keeps its physical bounds: proof pressure, vacuum, the compression of the stops.

Faults that the protection finds are counted, and runs in which a leg met its elastic stop at 38 in
are listed, not forbidden: what the law overshoots its reference by is the law's, and some laws are
unstable with some cabs.
"""

import argparse
import json
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed

from cmf_mj import Hexapod
from cmf_mj.control.law import law_names
from cmf_mj.control.states import State
from cmf_mj.facility.host.stream import HostStream, make_stream
from cmf_mj.facility.operation import operate
from cmf_mj.machine.models import CABS
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import cue
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion
from cmf_mj.pilot.washout_settings import WASHOUTS, load_washout
from cmf_mj.record.record import Record

FORCE, RATE = 100.0, 10.0
"""Largest specific force [m/s^2] and angular rate [rad/s] of a flight."""


class Case(NamedTuple):
    """One flight; its number makes it again."""

    number: int
    law: str
    cab: str
    washout: str
    """A washout, or `direct`."""


class Outcome(NamedTuple):
    """What became of it."""

    case: Case
    broken: list[str]
    fault: str
    compression: float
    """How far a leg went into its stop [m]; 0 if none met one."""
    legs: float
    """Largest leg extension over the working stroke."""


def smooth(generator: np.random.Generator, time: np.ndarray, largest: float) -> np.ndarray:
    """A sum of six sines of 0.02 to 5 Hz, its peak log-uniform from a thousandth of `largest`."""
    frequency = 10.0 ** generator.uniform(np.log10(0.02), np.log10(5.0), 6)
    phase, weight = generator.uniform(0.0, 2.0 * np.pi, 6), generator.uniform(0.0, 1.0, 6)
    wave = np.sin(2.0 * np.pi * np.outer(time, frequency) + phase) @ weight
    return largest * 10.0 ** generator.uniform(-3.0, 0.0) * wave / np.abs(wave).max()


def aircraft_stream(generator: np.random.Generator, case: Case, time: np.ndarray) -> HostStream:
    """The frames of a washout with random gains on a random motion."""
    columns = [smooth(generator, time, size) for size in (FORCE,) * 3 + (RATE,) * 3]
    force, rate = np.column_stack(columns[:3]), np.column_stack(columns[3:])
    motion = PilotMotion(time, force - [0.0, 0.0, 9.80665], rate, np.zeros((time.size, 3)))
    settings = load_washout(case.washout).with_gains(generator.uniform(0.0, 3.0, 6))
    return cue(motion, settings, cab=case.cab).stream


def platform_stream(generator: np.random.Generator, time: np.ndarray) -> HostStream:
    """Random poses with random jumps and derivatives that do not belong to them."""
    sizes = (3.0, 3.0, 2.0, 1.2, 1.2, 1.2)
    pose = np.column_stack([smooth(generator, time, size) for size in sizes])
    for at in generator.integers(1, time.size, generator.integers(0, 4)):
        pose[at:] += generator.uniform(-1.0, 1.0, 6)
    velocity, acceleration = (
        np.column_stack([smooth(generator, time, size) for _ in range(6)]) for size in (5.0, 50.0)
    )
    return make_stream(time, pose, velocity, acceleration)


def faults_of(record: Record) -> list[str]:
    """What a record breaks."""
    broken = [name for name, values in record.channels.items() if not np.isfinite(values).all()]
    leg = load_motion_limits().leg
    engaged = record["operating_state"] == State.ENGAGED
    reference = record["leg_reference"][: int(engaged.argmin()) if not engaged.all() else None]
    speed = np.diff(reference, axis=0) * record.rate
    change = np.diff(speed, axis=0) * record.rate
    for name, values, limit in (
        ("leg reference", reference, leg.position.si),
        ("reference speed", speed, leg.velocity.si),
        ("reference acceleration", change, leg.acceleration.si),
    ):
        if values.size and np.abs(values).max() > limit * (1.0 + 1e-6):
            broken.append(f"{name} {np.abs(values).max():.6g} beyond {limit:.6g}")
    return broken


def run(case: Case, seconds: float) -> Outcome:
    """Fly one case."""
    generator = np.random.default_rng([2014, case.number])
    time = np.arange(round(seconds * MOST_RATE)) / MOST_RATE
    if case.washout == "direct":
        stream = platform_stream(generator, time)
    else:
        stream = aircraft_stream(generator, case, time)
    plant = Hexapod(case.cab)
    try:
        record = operate(plant, case.law, stream).record
    except FloatingPointError as error:
        return Outcome(case, [str(error)], "", float("nan"), float("nan"))
    fault = record.metadata["fault"]
    extension = float(np.abs(record["leg_extension"]).max())
    half_stroke = float(plant.hydraulics.cylinder.half_stroke.min())
    return Outcome(
        case,
        faults_of(record),
        "" if fault is None else fault["name"],
        max(extension - half_stroke, 0.0),
        extension / load_motion_limits().leg.position.si,
    )


def cases(count: int) -> list[Case]:
    """Random choices of law, cab and washout."""
    generator = np.random.default_rng(2014)
    names = law_names("all")
    chosen = []
    for number in range(count):
        washout = "direct" if number % 4 == 3 else str(generator.choice(WASHOUTS))
        law, cab = str(generator.choice(names)), str(generator.choice(CABS))
        chosen.append(Case(number, law, cab, washout))
    return chosen


def main() -> None:
    """Run the flights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=6.0, help="length of a flight")
    parser.add_argument("--jobs", type=int, default=1, help="threads")
    options = parser.parse_args()
    if options.count < 1 or options.seconds < 0.5:
        parser.error("--count must be at least 1 and --seconds at least 0.5")
    work = (delayed(run)(case, options.seconds) for case in cases(options.count))
    outcomes = Parallel(n_jobs=options.jobs, prefer="threads")(work)
    faults: dict[str, int] = {}
    for outcome in outcomes:
        if outcome.fault:
            faults[outcome.fault] = faults.get(outcome.fault, 0) + 1
    broken = [outcome for outcome in outcomes if outcome.broken]
    legs = [outcome.legs for outcome in outcomes if np.isfinite(outcome.legs)]
    print(
        json.dumps(
            {
                "flights": len(outcomes),
                "seconds": options.seconds,
                "laws": len({outcome.case.law for outcome in outcomes}),
                "cabs": len({outcome.case.cab for outcome in outcomes}),
                "broken": [{**o.case._asdict(), "why": o.broken} for o in broken],
                "faults": faults,
                "stops_met": [
                    {**o.case._asdict(), "compression_mm": 1e3 * o.compression}
                    for o in outcomes
                    if o.compression > 0.0
                ],
                "largest_leg_use": max(legs, default=None),
            },
            indent=2,
        )
    )


if __name__ == "__main__":
    main()
