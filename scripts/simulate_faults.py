"""Run the whole system under odd timing, and ask of each frame whether it makes sense.

One seed is one run: a machine, a law, a host with its oddities, an operator, failures, law changes,
kills and interrupted savings, on production code whose clock, network and disk the seed controls.
A run that breaks a check of `faults/checks.py` is made as simple as it still fails and printed.
"""

import argparse
import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from faults.checks import CHECKS, broken
from faults.plans import Plan, draw, simpler
from faults.runs import Run, run

MOST_SIMPLER = 60
"""Runs that the search for a simpler one may take."""


def outcome(plan: Plan, left_out: tuple[str, ...] = ()) -> tuple[Run | None, dict[str, str]]:
    """A run and the checks it breaks; an exception that nobody expected breaks `crash`."""
    try:
        done = run(plan)
        return done, dict(broken(done, left_out))
    except Exception as error:
        return None, {"crash": f"{type(error).__name__}: {error}"}


def shrunk(plan: Plan, name: str, left_out: tuple[str, ...] = ()) -> tuple[Plan, str]:
    """A simplest plan near this one that breaks the same check, and its words."""
    words, left = outcome(plan, left_out)[1].get(name, ""), MOST_SIMPLER
    smaller = True
    while smaller and left:
        smaller = False
        for other in simpler(plan):
            if not left:
                break
            left -= 1
            if told := outcome(other, left_out)[1].get(name, ""):
                plan, words, smaller = other, told, True
                break
    return plan, words


def commit() -> str:
    """The commit of this checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    here = Path(__file__).parent
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def main() -> int:
    """Run the seeds; status 1 if one breaks a check."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="of the first run")
    parser.add_argument("--seconds", type=float, default=4.0, help="length of a run")
    parser.add_argument("--runs", type=int, help="how many, with the seeds that follow; default 1")
    parser.add_argument("--minutes", type=float, help="begin runs for so long")
    parser.add_argument("--without", default="", help=f"checks left out: {', '.join(CHECKS)}")
    parser.add_argument("--plan", help="run this plan, as a failure prints it, and no seed")
    parser.add_argument("--no-shrink", action="store_true", help="print failures as they are")
    parser.add_argument("--all", action="store_true", help="go on after a failure")
    options = parser.parse_args()
    left_out = tuple(name for name in options.without.split(",") if name)
    if options.seconds < 0.1 or set(left_out) - set(CHECKS):
        parser.error("--seconds must be at least 0.1, --without a list of the checks")
    count, start, failed = Counter[str](), time.monotonic(), 0
    most = options.runs or (1 if options.minutes is None else sys.maxsize)
    for seed in range(options.seed, options.seed + (1 if options.plan else most)):
        if options.minutes is not None and time.monotonic() - start > 60.0 * options.minutes:
            break
        plan = Plan.read(options.plan) if options.plan else draw(seed, options.seconds)
        done, wrong = outcome(plan, left_out)
        count["runs"] += 1
        count.update(_counted(plan, done))
        for name, words in wrong.items():
            failed += 1
            print(f"FAILED seed {seed}, --seconds {options.seconds:g}, commit {commit()}")
            print(f"  {name}: {words}", flush=True)
            if not options.no_shrink:
                least, words = shrunk(plan, name, left_out)
                print(f"  least: {name}: {words}")
                print(f"  python scripts/simulate_faults.py --plan '{least.text()}'", flush=True)
        if wrong and not options.all:
            break
    count["seconds"] = round(time.monotonic() - start)
    print(json.dumps(count | {"failures": failed}))
    return 1 if failed else 0


def _counted(plan: Plan, done: Run | None) -> dict[str, int]:
    """What a run had in it."""
    kinds = Counter(f"{action.kind}s" for action in plan.actions)
    parts = done.parts if done else []
    return {
        **kinds,
        "oddities": len(plan.oddities),
        "interrupted_savings": bool(plan.disk),
        "control_frames": sum(part.operation.record.time.size for part in parts),
        "datagrams": done.sent if done else 0,
        "faults": sum(part.operation.record.metadata["fault"] is not None for part in parts),
    }


if __name__ == "__main__":
    sys.exit(main())
