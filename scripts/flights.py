"""Many flights: `python scripts/flights.py fuzz` and `python scripts/flights.py learn`.

`fuzz` flies random, partly absurd flights with random washouts, laws and cabs, and prints JSON.
Three in four are in aircraft mode: specific forces and rates that are sums of random sines, from a
breath to ten g and ten rad/s, through a washout with random gains up to 3. One in four is in direct
mode: poses, velocities and accelerations far beyond the machine, with jumps. Of each run is checked
that every channel is a number, that the leg references keep stroke, speed and acceleration, and
that the machine keeps its physical bounds. Faults that the protection finds are counted, and runs
in which a leg met its elastic stop are listed, not forbidden: what the law overshoots its reference
by is the law's, and some laws are unstable with some cabs.

`learn` learns the shipped flights and flies what was learnt on other machines, as `cmf learn` does.
It writes `learning.csv` and `learning.md`, a row a flight: the tracking error of the first run;
what is left of it [%] when the demand is sent earlier by the best constant lead, what is out of
reach of any demand and of one that the limits hold back, and what is left after 1, 4 and the last
trial, by the linear model after the last, and on drawn machines. A flight that is tried on those
also gets what `cmf learn` writes.
"""

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed

from cmf_mj import Hexapod, load_cab, load_hydraulics, load_law
from cmf_mj.control.law import law_names
from cmf_mj.control.states import State
from cmf_mj.core.result import Table
from cmf_mj.core.settings import validated
from cmf_mj.facility.host.stream import HostStream, differentiate, make_stream
from cmf_mj.facility.operation import operate
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.models import CABS
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import cue, within_limits
from cmf_mj.pilot.flight import flight_names, load_flight
from cmf_mj.pilot.learning import Learning, draw_machine, learn, measure_errors, rms, within_band
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion, interpolated
from cmf_mj.pilot.washout_settings import WASHOUTS, WashoutSettings, load_washout
from cmf_mj.record.record import Record
from cmf_mj.show.flight import save_learning

FORCE, TURN = 100.0, 10.0
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


def with_gains(settings: WashoutSettings, gains: np.ndarray) -> WashoutSettings:
    """A washout with other gains of surge to yaw, (6,)."""
    tables = settings.model_dump()
    for (table, key), gain in zip(settings._gains, gains, strict=True):
        tables[table][key] |= {"value": float(gain), "status": "derived"}
    return validated(type(settings), tables, settings.name)


def aircraft_stream(generator: np.random.Generator, case: Case, time: np.ndarray) -> HostStream:
    """The frames of a washout with random gains on a random motion."""
    columns = [smooth(generator, time, size) for size in (FORCE,) * 3 + (TURN,) * 3]
    force, rate = np.column_stack(columns[:3]), np.column_stack(columns[3:])
    motion = PilotMotion(time, force - [0.0, 0.0, 9.80665], rate, np.zeros((time.size, 3)))
    settings = with_gains(load_washout(case.washout), generator.uniform(0.0, 3.0, 6))
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


def fuzz_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=6.0, help="length of a flight")
    parser.add_argument("--jobs", type=int, default=1, help="threads")


def fuzz(options: argparse.Namespace) -> None:
    """Run the flights."""
    if options.count < 1 or options.seconds < 0.5:
        raise SystemExit("--count must be at least 1 and --seconds at least 0.5")
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


KNOWN, SEED = 6, 0
"""Drawn machines that a learner is made for; of all noise."""


def early(done: Learning) -> tuple[float, float]:
    """Constant lead [s] of the demand that serves best, and the share of the error that it leaves.

    The first run's response shifted by the lead, as of any linear machine.
    """
    error = done.errors[0]
    asked = done.reference.pose[-len(error) :]
    legs, moved = pose_to_legs(asked), pose_to_legs(asked - error)
    leads = np.arange(0.0, 1.0, 0.001)
    time = np.arange(len(legs)) / MOST_RATE
    left = [rms(legs - interpolated(time + lead, time, moved)) for lead in leads]
    return float(leads[np.argmin(left)]), min(left) / left[0]


def out_of_reach(done: Learning, plant: Hexapod) -> tuple[float, float]:
    """Shares of the first error that stay, of a machine with the static gain G_0 of its legs.

    Within the stroke h a leg ends at G_0 h: what r asks beyond stays missed, whatever is sent. And
    what the limits of host frames hold back of r / G_0, the demand that would be followed.
    """
    limits = load_motion_limits(None, plant.machine)
    asked, static = done.reference, np.abs(np.diagonal(done.learner.responses[0, 0]))
    legs = pose_to_legs(asked.pose, plant.machine)
    reach = static * limits.leg.position.si
    wanted = legs_to_pose(legs / static, plant.machine)
    rates = differentiate(asked.time, wanted - asked.pose)
    motion = (asked.velocity + rates[0], asked.acceleration + rates[1])
    sent = make_stream(asked.time, wanted, *motion)
    held = within_limits(sent, limits, plant.machine)[0]
    back = static * (legs / static - pose_to_legs(held.pose, plant.machine))
    first = done.trials[0].legs
    cut = rms(within_band(legs - np.clip(legs, -reach, reach)))
    return cut / first, rms(within_band(back)) / first


def learn_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--flights", default=",".join(flight_names()))
    parser.add_argument("--law", default="velocity")
    parser.add_argument("--cab", default="gfd")
    parser.add_argument("--trials", type=int, default=8)
    parser.add_argument("--tried", default="turbulence", help="flown on other machines")
    parser.add_argument("--on", type=int, default=30, help="other machines")
    parser.add_argument("--out", type=Path, default=Path("out/learning"))


def learn_flights(options: argparse.Namespace) -> None:
    """Learn all flights."""
    cab, hydraulics, law = load_cab(options.cab), load_hydraulics("hardware"), load_law(options.law)
    machines = [draw_machine(cab, hydraulics, SEED, n) for n in range(KNOWN + options.on)]
    plants = [Hexapod(cab, hydraulics), *machines[:KNOWN]]
    percent = ["left with lead [%]", "beyond stroke", "held back"]
    percent += ["trial 1", "trial 4", f"trial {options.trials}", "linear"]
    spread = ("others: least", "median", "most")
    columns = ["flight", ("first [mm]", ".1f"), ("lead [ms]", ".0f")]
    columns += [(name, ".1f") for name in (*percent, *spread)]
    rows = []
    for name in options.flights.split(","):
        asked = cue(load_flight(name).motion, cab=cab).stream
        done = learn(asked, law, plants, trials=options.trials, seed=SEED)
        first, last = done.trials[0], done.trials[-1]
        shown = [done.trials[min(at, options.trials)] for at in (1, 4, options.trials)]
        legs = [one.legs / first.legs for one in shown]
        lead, kept = early(done)
        others = np.full(3, np.nan)
        if name in options.tried.split(","):
            seed, both = SEED + options.trials + 1, (done.reference, done.demand)
            flown = [
                [rms(measure_errors(done.reference, sent, law, plant, seed).legs) for sent in both]
                for plant in machines[KNOWN:]
            ]
            save_learning(done, options.out / name)
            without, learnt = np.transpose(flown)
            others = np.percentile(learnt / without, [0, 50, 100])
        shares = [
            kept,
            *out_of_reach(done, plants[0]),
            *legs,
            last.predicted / first.predicted,
            *others,
        ]
        percents = (100.0 * x for x in shares)
        rows.append([name, 1e3 * first.legs, 1e3 * lead, *percents, last.held_frames])
        print(rows[-1], flush=True)
    table = Table("", (*columns, ("frames held", "d")), sorted(rows))
    for kind in ("csv", "md"):
        table.save(options.out / f"learning.{kind}")
    print(table.markdown())


def main() -> None:
    """Fly them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    what = parser.add_subparsers(dest="what", required=True)
    fuzz_options(what.add_parser("fuzz", help="random flights"))
    learn_options(what.add_parser("learn", help="learn the shipped flights"))
    options = parser.parse_args()
    (fuzz if options.what == "fuzz" else learn_flights)(options)


if __name__ == "__main__":
    main()
