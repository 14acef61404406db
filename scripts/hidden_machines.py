"""Fit machines whose numbers are hidden: `python scripts/hidden_machines.py draw`, `fit`, `score`.

`draw` makes machines by turns like the CMF, SIMONA and the laboratory hexapod, off their data
sheets by more than machines are, and records a campaign on each, in OUT/NAME. Its numbers are
sealed in OUT/NAME.truth.json, which nothing but `score` reads. `fit` fits those that have no result
yet, into OUT/NAME.fit; the same command again goes on. `score` compares: how often the 90 %
intervals hold the truth, over the numbers that the fit says can be told.
"""

import argparse
import csv
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cmf_mj.core.files import write_csv, write_json
from cmf_mj.core.units import factor
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.fit.plan import plan_campaign, record_campaign

RESULT, TIME = "numbers.csv", "time.json"  #: In the folder of a fit.


class Kind(NamedTuple):
    """A data sheet that hidden machines are off from."""

    machine: str
    law: str | None  #: That it is recorded with, without ringing; None for its own.
    other_law: str | None  #: That is held back; None for a slower one.
    friction: float  #: Largest Coulomb friction, over the static load of a leg.


KINDS = {
    "cmf": Kind("cmf", "original", "velocity", 0.02),
    "simona": Kind("simona", None, None, 0.02),
    "lab": Kind("lab", "original", "combined_rate_1_8", 80.0 / 754.0),
}


def unknowns(plant: Hexapod, friction: float) -> Unknowns:
    """What is drawn of a machine, by path; friction is the largest [N]."""
    reach = 0.05 * float(plant.machine.geometry.upper[:, :2].max())
    ranges: dict[str, dict[str, Any]] = {
        f"hydraulics.actuators.{leg}.leg_speed": {"deviation": 10.0} for leg in plant.actuators
    }
    ranges |= {
        "hydraulics.drive_lag": {"low": 0.6, "high": 1.6, "unit": "1"},
        "hydraulics.valve_lag": {"low": 0.6, "high": 1.6, "unit": "1"},
        "hydraulics.leak_rate": {"low": 0.4, "high": 2.5, "unit": "1"},
        "hydraulics.bulk_modulus": {"low": 0.6, "high": 1.5, "unit": "1"},
        "hydraulics.friction": {"low": 0.0, "high": friction, "unit": "N", "effect": "value"},
        "hydraulics.stiction": {"low": 1.0, "high": 2.0, "unit": "1", "effect": "value"},
        "cab.mass": {"deviation": 25.0},
    }
    for axis in "xyz":
        place = {"low": -reach, "high": reach, "unit": "m", "effect": "offset"}
        ranges[f"cab.centre_of_mass.{axis}"] = place
        ranges[f"cab.second_moment.{axis}"] = {"low": 0.6, "high": 1.6, "unit": "1"}
    return Unknowns({p: Unknown(path=p, source="drawn", **one) for p, one in ranges.items()})


def numbers(plant: Hexapod) -> dict[str, float]:
    """The numbers of a machine by path, in SI."""
    oil, cab = plant.parameters, plant.cab_parameters
    assert cab is not None
    size = oil.coulomb_friction.si
    said = {
        f"hydraulics.actuators.{leg}.leg_speed": oil.actuator(leg)["leg_speed"].si
        for leg in plant.actuators
    }
    for field in ("drive_lag", "valve_lag", "leak_rate", "bulk_modulus"):
        said[f"hydraulics.{field}"] = getattr(oil, field).si
    said["hydraulics.friction"] = size
    said["hydraulics.stiction"] = oil.breakaway_friction.si / size if size else 1.0
    said["cab.mass"] = cab.mass.si
    spread = 0.5 * np.trace(cab.tensor) * np.eye(3) - cab.tensor
    for i, axis in enumerate("xyz"):
        said[f"cab.centre_of_mass.{axis}"] = float(cab.centre_of_mass.si[i])
        said[f"cab.second_moment.{axis}"] = float(spread[i, i])
    return {path: float(value) for path, value in said.items()}


def draw(options: argparse.Namespace) -> None:
    """Draw machines, plan and record the campaign of each, seal the numbers."""
    out = Path(options.out)
    for i in range(options.count):
        shape = options.kinds.split(",")[i % len(options.kinds.split(","))]
        name, kind = f"{shape}{i + 1}", KINDS[shape]
        sealed = out / f"{name}.truth.json"
        if sealed.exists():
            continue
        sheet = Hexapod(machine=kind.machine)
        sheet.start()
        largest = kind.friction * float(np.abs(sheet.static_load()).mean())
        known = unknowns(sheet, largest)
        values = known.streams(options.seed, i)
        oil = known.apply(values, sheet.parameters, "hidden")
        cab = known.apply(values, load_cab(None, kind.machine), "hidden")
        folder = out / name
        if not (folder / "campaign.toml").exists():
            how = {"seconds": options.seconds, "other_law": kind.other_law}
            plan_campaign(kind.machine, None, None, kind.law, folder, **how)
        noise = int(np.random.SeedSequence(options.seed, spawn_key=(i,)).generate_state(1)[0])
        how = {"machine": kind.machine, "cab": cab, "hydraulics": oil, "seed": noise}
        record_campaign(folder, **how, jobs=options.jobs)
        write_json(sealed, {"seed": options.seed, "numbers": numbers(Hexapod(cab, oil))})
        print(f"{name}: recorded, {len(known)} numbers sealed", flush=True)


def _fits(out: Path) -> dict[str, Path]:
    """Folders of the fits by machine."""
    names = [path.name.removesuffix(".truth.json") for path in sorted(out.glob("*.truth.json"))]
    return {name: out / f"{name}.fit" for name in names}


def fit(options: argparse.Namespace) -> None:
    """Fit each machine that has no result."""
    from cmf_mj.studies.fit import doubt, results
    from cmf_mj.studies.fit.campaign import load_campaign
    from cmf_mj.studies.fit.engine import fit as fit_campaign

    out = Path(options.out)
    for name, folder in _fits(out).items():
        if (folder / TIME).exists():
            continue
        began = time.monotonic()
        try:
            posterior = fit_campaign(load_campaign(out / name), folder, jobs=options.jobs)
            results.save(posterior, folder)
        except Exception as error:  # one machine must not keep the others from being fitted
            print(f"{name}: {type(error).__name__}: {error}", flush=True)
            continue
        taken, held = time.monotonic() - began, doubt.predicted(posterior)
        off = {
            "gain": max((abs(one.gain) for one in held), default=0.0),
            "phase": max((abs(one.phase) for one in held), default=0.0),
        }
        write_json(folder / TIME, {"seconds": taken} | off)
        print(f"{name}: fitted in {taken:.0f} s", flush=True)


def compared(truth: dict[str, float], rows: list[dict[str, str]]) -> list[dict[str, Any]]:
    """Each number of a fit beside the truth; what the fit does not list is not found."""
    found = {row["number"]: row for row in rows}
    lines = []
    for number, true in truth.items():
        row = found.get(number)
        line: dict[str, Any] = {"number": number, "truth": true, "identifiable": False}
        if row is not None:
            size = factor(row["unit"])
            value, low, high = (size * float(row[key]) for key in ("value", "low", "high"))
            said = row["identifiable"].strip().lower() in ("true", "1", "yes")
            line |= {"value": value, "low": low, "high": high, "identifiable": said}
            line |= {"holds": low <= true <= high}
            line |= {"error": abs(value - true) / abs(true) if true else float("nan")}
        lines.append(line)
    return lines


def score(options: argparse.Namespace) -> None:
    """Compare the fits with the sealed numbers, in a table and OUT/score.csv."""
    out, every, table = Path(options.out), [], []
    for name, folder in _fits(out).items():
        if not (folder / TIME).exists():
            continue
        truth = json.loads((out / f"{name}.truth.json").read_text(encoding="utf-8"))["numbers"]
        with (folder / RESULT).open(encoding="utf-8", newline="") as file:
            lines = compared(truth, list(csv.DictReader(file)))
        said = json.loads((folder / TIME).read_text(encoding="utf-8"))
        table.append((name, *summed(lines), said["gain"], said["phase"], said["seconds"]))
        every += [line | {"machine": name} for line in lines]
    columns = ("machine", "number", "truth", "value", "low", "high", "identifiable", "holds")
    rows = [[line.get(key, "") for key in (*columns, "error")] for line in every]
    write_csv(out / "score.csv", (*columns, "error"), rows)
    print("machine    known  of  held  share  median error  held back [dB, deg]  time [s]")
    worst = [max(column) for column in zip(*(one[-3:] for one in table), strict=True)]
    for name, *line in [*table, ("all", *summed(every), *worst)] if table else []:
        known, of, held, error, gain, phase, taken = line
        share = f"{held / known:6.1%}" if known else "     -"
        numbers = f"{name:10} {known:5} {of:3} {held:5} {share} {error:13.2%}"
        print(f"{numbers} {gain:12.2f} {phase:6.1f} {taken:9.0f}")


def summed(lines: list[dict[str, Any]]) -> tuple[int, int, int, float]:
    """Identifiable numbers, all, those of the first in their interval, their median error."""
    known = [line for line in lines if line["identifiable"]]
    errors = [line["error"] for line in known if np.isfinite(line["error"])]
    held = sum(line["holds"] for line in known)
    return len(known), len(lines), held, float(np.median(errors)) if errors else float("nan")


def main() -> None:
    """Run the part that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parts = parser.add_subparsers(dest="part", required=True)
    for part in (draw, fit, score):
        one = parts.add_parser(part.__name__, help=part.__doc__)
        one.set_defaults(run=part)
        one.add_argument("--out", default="out/hidden", help="folder of all machines")
        one.add_argument("--jobs", type=int, default=2, help="threads or processes")
        if part is draw:
            one.add_argument("--seed", type=int, default=1, help="of all that is drawn")
            one.add_argument("--count", type=int, default=6, help="machines")
            one.add_argument("--kinds", default=",".join(KINDS), help="by turns, with commas")
            one.add_argument("--seconds", type=float, default=20.0, help="of each recording")
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
