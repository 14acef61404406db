"""Learn the shipped flights and fly what was learnt on other machines, as `cmf learn` does.

Writes `learning.csv` and `learning.md`, a row a flight: the tracking error of the first run; what
is left of it [%] when the demand is sent earlier by the best constant lead, what is out of reach of
any demand and of one that the limits hold back, and what is left after 1, 4 and the last trial, by
the linear model after the last, and on drawn machines. A flight that is tried on those also gets
what `cmf learn` writes.
"""

import argparse
from pathlib import Path

import numpy as np

from cmf_mj import Hexapod, load_cab, load_hydraulics, load_law
from cmf_mj.core.result import Table
from cmf_mj.facility.host.stream import differentiate, make_stream
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import cue, within_limits
from cmf_mj.pilot.flight import flight_names, load_flight
from cmf_mj.pilot.learning import Learning, counted, drawn_machine, learn, on_others, rms
from cmf_mj.pilot.motion import MOST_RATE, interpolated
from cmf_mj.show.flight import save_learning

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
    limits = load_motion_limits(done.options.get("limits"), plant.machine)
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
    cut = rms(counted(legs - np.clip(legs, -reach, reach)))
    return cut / first, rms(counted(back)) / first


def main() -> None:
    """Learn all flights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", default=",".join(flight_names()))
    parser.add_argument("--law", default="velocity")
    parser.add_argument("--cab", default="gfd")
    parser.add_argument("--trials", type=int, default=8)
    parser.add_argument("--tried", default="turbulence", help="flown on other machines")
    parser.add_argument("--on", type=int, default=30, help="other machines")
    parser.add_argument("--out", type=Path, default=Path("out/learning"))
    options = parser.parse_args()
    cab, hydraulics, law = load_cab(options.cab), load_hydraulics("hardware"), load_law(options.law)
    machines = [drawn_machine(cab, hydraulics, SEED, n) for n in range(KNOWN + options.on)]
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
            pairs = on_others(done, machines[KNOWN:], seed=SEED + options.trials + 1)
            save_learning(done, pairs, options.out / name)
            others = np.percentile(pairs[:, 1] / pairs[:, 0], [0, 50, 100])
        shares = [
            kept,
            *out_of_reach(done, plants[0]),
            *legs,
            last.predicted / first.predicted,
            *others,
        ]
        rows.append([name, 1e3 * first.legs, 1e3 * lead, *(100.0 * x for x in shares), last.held])
        print(rows[-1], flush=True)
    table = Table("", (*columns, ("frames held", "d")), sorted(rows))
    for kind in ("csv", "md"):
        table.save(options.out / f"learning.{kind}")
    print(table.markdown())


if __name__ == "__main__":
    main()
