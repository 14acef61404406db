"""Sealed changes of hidden machines: `python scripts/guides.py`, again to go on.

Machines by turns, NAME or NAME@SEED, off their data sheets, get a master of a guide. Then each is
checked: some have changed in a number or two, of which the check knows nothing, the others not at
all. The rows, a check each, are appended to OUT/checks.jsonl and written to OUT/guide_checks.csv.
The diagnosis linearises the data sheet's machine, not the hidden.
"""

import argparse
import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cmf_mj.core.tables import write_csv
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.run import Run
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.studies.diagnosis import Number, diagnose, find_slopes, moved_machine, numbers_of
from cmf_mj.studies.guide import FILE, Bench, load_guide, make_bench, make_head, run_guide
from cmf_mj.studies.guide_check import compare, load_master

MACHINES = ("cmf", "simona", "lab")
KINDS = (
    *("valve gain", "oil", "seal", "friction", "position gain", "payload place"),
    *("two", "position gain", "two", "valve gain"),
)
"""What changes in the checks of a machine, in turn."""
FIELDS = (
    "machine",
    "check",
    "changed",
    "found",
    "named",
    "probability",
    "truth",
    "size",
    "seconds",
)
OFF = {
    "valve gain": 0.6,
    "seal": 0.3,
    "oil": 1.0,
    "drive lag": 1.0,
    "payload mass": 0.6,
    "payload place": 0.2,
}
"""How far hidden machines are off their data sheets: deviations in the sizes of `numbers_of`."""


class Way(NamedTuple):
    """How machines come to a bench and are recorded."""

    bench: Callable[..., Bench] = make_bench  #: From guide and machine.
    record: Callable[[Run], Record] = Run.record


def sealed(
    kind: str, numbers: tuple[Number, ...], draw: np.random.Generator
) -> dict[Number, float]:
    """A change: numbers and how far they moved."""
    if kind == "two":
        first, second = draw.choice(KINDS[:6], 2, replace=False)
        return sealed(first, numbers, draw) | sealed(second, numbers, draw)
    sizes = {
        "valve gain": np.log(0.95),
        "oil": np.log(draw.uniform(0.65, 0.85)),
        "seal": np.log(draw.uniform(2.0, 3.0)),
        "friction": 1.0,  # once more, or where there is none 1 % of a leg's load
        "position gain": draw.choice([-1.0, 1.0]) * draw.uniform(0.003, 0.006),
        "payload place": draw.choice([-1.0, 1.0]) * draw.uniform(0.4, 1.0),
    }
    chosen = [one for one in numbers if one.name.startswith(kind) and one.name[-1] != "z"]
    one = chosen[int(draw.integers(len(chosen)))]
    in_steps = kind in ("friction", "payload place")
    return {one: float(sizes[kind]) / (1.0 if in_steps else one.step)}


def hidden(plant: Hexapod, draw: np.random.Generator) -> Hexapod:
    """A machine off its data sheet."""
    moved = {
        one: size * float(draw.uniform(-1.0, 1.0))
        for one in numbers_of(plant)
        for kind, size in OFF.items()
        if one.name.startswith(kind)
    }
    made: Hexapod = moved_machine(plant, ElectronicsSettings(), moved)["plant"]
    return made


def checks(options: argparse.Namespace) -> Iterator[tuple[str, int, str]]:
    """Machine, number and kind of each check; a change first, then two of nothing."""
    machines = options.machines.split(",")
    for turn in range(max(options.changes, options.nothings // 2)):
        for machine in machines:
            if turn < options.changes:
                yield machine, turn, KINDS[turn % len(KINDS)]
            for other in range(2):
                if 2 * turn + other < options.nothings:
                    yield machine, 1000 + 2 * turn + other, ""


def run(options: argparse.Namespace, way: Way) -> None:
    """Make what is missing."""
    out, guide = Path(options.out), load_guide(options.guide)
    journal = out / "checks.jsonl"
    rows = (
        [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    )
    done = {(row["machine"], row["check"]) for row in rows}
    known: dict[str, Any] = {}
    for machine, number, kind in checks(options):
        if (machine, number) in done:
            continue
        if machine not in known:
            known[machine] = _master(out, machine, guide, options, way)
        began = time.monotonic()
        row = _check(out / f"{machine}.{number}", kind, number, known[machine], options, way)
        rows.append(
            {"machine": machine, "check": number} | row | {"seconds": time.monotonic() - began}
        )
        with journal.open("a", encoding="utf-8") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(json.dumps(rows[-1]), flush=True)
    rows.sort(key=lambda row: (row["machine"], row["check"]))
    write_csv(out / "guide_checks.csv", FIELDS, ([row[key] for key in FIELDS] for row in rows))
    print(*(f"{name}: {value}" for name, value in summed(rows).items()), sep="\n")


def summed(rows: list[Mapping[str, Any]]) -> dict[str, int]:
    """How many changes there were, found and named rightly, and how often nothing was alarmed."""
    changes = [row for row in rows if row["changed"]]
    nothings = [row for row in rows if not row["changed"]]
    return {
        "changes": len(changes),
        "found": sum(row["found"] for row in changes),
        "named": sum(row["named"] == row["changed"] for row in changes),
        "nothings": len(nothings),
        "alarmed": sum(row["found"] for row in nothings),
    }


def _master(
    out: Path, named: str, guide: Any, options: argparse.Namespace, way: Way
) -> tuple[Any, ...]:
    """A hidden machine, its seed, the bench of its data sheet and its head, master and slopes."""
    machine, _, own = named.partition("@")
    on, seed = way.bench(guide, machine), int(own or options.seed)
    key = MACHINES.index(machine) if machine in MACHINES else 99
    plant = hidden(on.plant, np.random.default_rng([seed, key]))
    head, folder = make_head(on, machine=machine), out / named
    if not (folder / FILE).exists():
        how = {"jobs": options.jobs, "plant": plant, "record": way.record}
        run_guide(on, head, folder, seed=seed, **how)
    master = load_master(folder, bench=on)
    return plant, seed, on, head, master, find_slopes(master, options.jobs)


def _check(
    folder: Path,
    kind: str,
    number: int,
    known: tuple[Any, ...],
    options: argparse.Namespace,
    way: Way,
) -> dict[str, Any]:
    """Record a machine that may have changed, check it, and ask why."""
    plant, seed, on, head, master, slope = known
    draw = np.random.default_rng([seed, number, len(on.plant.machine.name)])
    moved = sealed(kind, numbers_of(on.plant), draw) if kind else {}
    machine = moved_machine(plant, ElectronicsSettings(), moved)
    again = {"repetitions": options.repetitions, "jobs": options.jobs, "record": way.record}
    run_guide(on, head, folder, seed=int(draw.integers(1, 2**31)), **again, **machine)
    since = load_master(folder, bench=on)
    found = any(row.verdict in ("changed", "beyond its limit") for row in compare(master, since))
    causes = diagnose(master, since, slope, options.jobs) if found else []
    shutil.rmtree(folder)
    names = [one.name for one in numbers_of(on.plant) if one in moved]
    return {
        "changed": " and ".join(names),
        "found": found,
        "named": causes[0].numbers if causes else "",
        "probability": causes[0].probability if causes else None,
        "truth": ", ".join(f"{one.name} {x:+.3f}" for one, x in moved.items()),
        "size": causes[0].size if causes else "",
    }


def main(way: Way | None = None, **defaults: Any) -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="out/guides", help="folder of all")
    parser.add_argument("--guide", default=str(Path(__file__).with_suffix(".toml")), help="or name")
    parser.add_argument("--machines", default=",".join(MACHINES), help="by turns, with commas")
    parser.add_argument("--changes", type=int, default=10, help="of each machine")
    parser.add_argument("--nothings", type=int, default=20, help="of each machine")
    parser.add_argument("--repetitions", type=int, default=2, help="of a check")
    parser.add_argument("--seed", type=int, default=1, help="of all that is drawn")
    parser.add_argument("--jobs", type=int, default=1, help="threads")
    parser.set_defaults(**defaults)
    run(parser.parse_args(), way or Way())


if __name__ == "__main__":
    main()
