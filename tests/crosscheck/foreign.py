"""Does a fit doubt machines that its model cannot be? `python tests/crosscheck/foreign.py`.

The laboratory hexapod in Exudyn, its numbers off the data sheet by `TRUTH`, is recorded in closed
loop through a part of a planned campaign, once as the model is and once with each of `LACKING`.
Each campaign is fitted with the numbers of `KNOWN`, and a row says what came of it: whether the
model is said to explain it, what each effect tried would gain, and how many of the shared numbers
lie in their 90 % intervals. What is finished in OUT is not computed again.
"""

import argparse
import csv
import sys
from pathlib import Path
from typing import Any, NamedTuple

import tomlkit

from cmf_mj.core.files import write_text
from cmf_mj.core.settings import read_toml
from cmf_mj.core.tables import write_csv
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.unknown import Unknown, nominal
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.fit import results
from cmf_mj.studies.fit.campaign import FILE, load_campaign
from cmf_mj.studies.fit.doubt import Doubt, doubt
from cmf_mj.studies.fit.engine import Posterior, fit
from cmf_mj.studies.fit.plan import plan_campaign

if __name__ == "__main__":
    sys.path.append(str(Path(__file__).resolve().parents[1]))

from crosscheck.machine import Machine, Spring  # noqa: E402
from crosscheck.recordings import recorded  # noqa: E402

RECORDINGS = ("hold", "axes_large", "all_legs", "other_pose")  #: Of the plan; the last held back.

WIDE: dict[str, Any] = {"distribution": "loguniform", "unit": "1"}
KNOWN: dict[str, dict[str, Any]] = {
    "leg_speed": {"path": "hydraulics.leg_speed", "deviation": 20.0},
    "drive_lag": {"path": "hydraulics.drive_lag", "low": 0.4, "high": 2.5} | WIDE,
    "valve_lag": {"path": "hydraulics.valve_lag", "low": 0.4, "high": 2.5} | WIDE,
    "leak_rate": {"path": "hydraulics.leak_rate", "low": 0.2, "high": 5.0} | WIDE,
    "bulk_modulus": {"path": "hydraulics.bulk_modulus", "low": 0.4, "high": 2.5} | WIDE,
    "mass": {"path": "cab.mass", "deviation": 40.0},
}
TRUTH = {
    "leg_speed": 1.06,
    "drive_lag": 0.85,
    "valve_lag": 1.2,
    "leak_rate": 1.4,
    "bulk_modulus": 0.85,
    "mass": 0.88,
}
"""Over the data sheet."""
for _axis, _place, _moment in zip("xyz", (0.02, -0.015, 0.04), (1.2, 0.85, 0.9), strict=True):
    KNOWN[f"centre_{_axis}"] = {"path": f"cab.centre_of_mass.{_axis}", "deviation": 0.1}
    KNOWN[f"centre_{_axis}"] |= {"effect": "offset", "unit": "m"}
    KNOWN[f"moment_{_axis}"] = {"path": f"cab.second_moment.{_axis}", "low": 0.3, "high": 3.0}
    KNOWN[f"moment_{_axis}"] |= WIDE
    TRUTH |= {f"centre_{_axis}": _place, f"moment_{_axis}": _moment}


class Lacking(NamedTuple):
    """What a machine has beside its numbers."""

    floor: Spring | None = None
    mounts: Spring | None = None
    overlap: float = 0.0  #: Fraction.


LACKING = {
    "none": Lacking(),
    "floor": Lacking(floor=Spring(stiffness=3.2e7, damping=1.5e4, mass=2000.0)),
    "legs": Lacking(mounts=Spring(stiffness=2e7, damping=2e3)),
    "overlap": Lacking(overlap=0.02),
}
"""A floor of 2 t that swings at 20 Hz, mounts three times as stiff as the oil, 2 % of the spool."""


def data_sheet(machine: str = "lab") -> Hexapod:
    """The laboratory hexapod, or another machine, with a constant supply."""
    oil = Hexapod(machine=machine).parameters
    return Hexapod(None, oil.model_copy(update={"supply": "constant"}), machine=machine)


def hidden(lacking: Lacking) -> Hexapod:
    """The machine with the true numbers, without what yields."""
    sheet = data_sheet()
    known = Unknowns({name: Unknown(**one, source="drawn") for name, one in KNOWN.items()})
    oil = known.apply(TRUTH, sheet.parameters, "hidden")
    overlap = oil.overlap.model_copy(update={"value": 100.0 * lacking.overlap})
    cab = known.apply(TRUTH, load_cab(None, "lab"), "hidden")
    return Hexapod(cab, oil.model_copy(update={"overlap": overlap}))


def record(folder: Path, lacking: Lacking) -> None:
    """Plan the campaign, record it on the Exudyn machine, and name its files."""
    oil = data_sheet().parameters.model_dump(mode="json", exclude={"name", "actuators"})
    sheet = folder.with_name("constant.toml")
    write_text(sheet, tomlkit.dumps({"base": "hardware", "constant": oil}))
    plan_campaign("lab", None, sheet, "original", folder, seconds=10.0)
    table = read_toml(folder / FILE)
    plant = hidden(lacking)
    machine = Machine(plant, floor=lacking.floor, mounts=lacking.mounts)
    kept = {}
    for number, name in enumerate(RECORDINGS):
        said = table["recordings"][name]
        run = load_scenario(folder / said["source"]).changed(plant=plant, seed=number)
        kept[name] = said | {"file": recorded(run, machine).save(folder / f"{name}.parquet").name}
    unknowns = {name: one | {"source": "data sheet"} for name, one in KNOWN.items()}
    table |= {"recordings": kept, "unknowns": unknowns}
    write_text(folder / FILE, tomlkit.dumps(table))


def held(posterior: Posterior) -> dict[str, bool]:
    """Whether the 90 % interval of each number holds the truth."""
    sheet, known = posterior.campaign.plant, posterior.campaign.unknowns
    low, high = results.physical(posterior, posterior.bounds())
    truth = {
        one.path: float(one.number(nominal(one.path, sheet)[0], TRUTH[name]))
        for name, one in known.items()
    }
    pairs = zip(posterior.names, truth.values(), low, high, strict=True)
    return {name: bool(a <= true <= b) for name, true, a, b in pairs}


def row(name: str, posterior: Posterior, doubts: Doubt) -> list[Any]:
    """What came of one machine."""
    found = held(posterior)
    missing = " ".join(number for number, inside in found.items() if not inside)
    worst = max((one.correlation for one in doubts.residuals), default=0.0)
    gains = [f"{one.name} {one.gain:.1f}" for one in doubts.effects if one.gain > 0.0]
    said = "yes" if doubts.is_explained else "no"
    ahead = doubts.predictions[0]
    held_back = f"{ahead.gain:+.2f} dB {ahead.phase:+.1f} deg"
    numbers = f"{sum(found.values())} of {len(found)}"
    return [name, said, f"{worst:.1f}", held_back, "; ".join(gains), numbers, missing]


COLUMNS = ("lacking", "explained", "correlation", "held_back", "gains", "held", "not_held")


def main() -> None:
    """Record, fit and score each machine."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/foreign"))
    parser.add_argument("--only", choices=tuple(LACKING), nargs="*", default=tuple(LACKING))
    given = parser.parse_args()
    for name in given.only:
        folder, out = given.out / name, given.out / f"{name}.fit"
        if not all((folder / f"{one}.parquet").exists() for one in RECORDINGS):
            record(folder, LACKING[name])
        if not (out / "row.csv").exists():
            posterior = fit(load_campaign(folder), out, jobs=1, progress=print)
            doubts = doubt(posterior, 1)
            posterior = doubts.widened(posterior)
            results.save(posterior, out)
            doubts.page_writer(results.numbers(posterior))(out / "fit.md")
            write_csv(out / "row.csv", COLUMNS, [row(name, posterior, doubts)])
            print(doubts.verdict, flush=True)
    files = (given.out / f"{name}.fit" / "row.csv" for name in LACKING)
    rows = [list(csv.reader(file.open()))[1] for file in files if file.exists()]
    write_csv(given.out / "foreign_machines.csv", COLUMNS, rows)


if __name__ == "__main__":
    main()
