"""Fit machines whose numbers are hidden: `python scripts/hidden_machines.py draw`, `fit`, `score`.

`draw` makes machines by turns like the CMF, SIMONA and the laboratory hexapod, off their data
sheets by more than machines are, and records a campaign on each, in OUT/NAME. Its numbers are
sealed in OUT/NAME.truth.json, which nothing but `score` reads. `fit` fits those that have no result
yet, into OUT/NAME.fit; the same command again goes on. `score` compares: how often the 90 %
intervals hold the truth, over the numbers that the fit says can be told.

`laws` tunes a law on each fit and on each truth, three searches each, and measures both on the
truth; it certifies the law with the fit's box, and looks whether the truth lies in it. `plain`
records a sweep in one axis after the other, as long and as large as the planned campaign, fits it
too, and compares the widths of the intervals.
"""

import argparse
import csv
import json
import time
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from cmf_mj.analysis.modes import nominal_modes
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.files import write_json, write_text
from cmf_mj.core.result import Table
from cmf_mj.core.settings import read_toml
from cmf_mj.core.tables import write_csv
from cmf_mj.core.units import factor
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.studies.certificate_box import Box
from cmf_mj.studies.fit.campaign import FILE
from cmf_mj.studies.fit.plan import (
    LEAD,
    PlannedRecording,
    Workspace,
    plan_campaign,
    record_campaign,
)
from cmf_mj.studies.tuning.evaluation import least_damping, linear_cab
from cmf_mj.studies.tuning.forms import Template, make_template
from cmf_mj.studies.tuning.search import Requirements, judge, search

RESULT, TIME, LAWS = "numbers.csv", "time.json", "laws.json"  #: In the folder of a fit.
SEEDS = (1, 2, 3)  #: Of the searches for a law.
SWEPT = (0.2, 10.0)  #: First and last frequency of plain sweeps [Hz].


class Hidden(NamedTuple):
    """A machine whose numbers are not shown."""

    cab: Cab
    oil: HydraulicParameters
    known: Unknowns


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
    size, path = oil.coulomb_friction.si, "hydraulics.actuators.{}.leg_speed"
    said = {path.format(leg): oil.actuator(leg)["leg_speed"].si for leg in plant.actuators}
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


def hidden(kind: Kind, seed: int, index: int) -> Hidden:
    """One machine of a seed."""
    sheet = Hexapod(machine=kind.machine)
    sheet.start()
    known = unknowns(sheet, kind.friction * float(np.abs(sheet.static_load()).mean()))
    values = known.streams(seed, index)
    oil = known.apply(values, sheet.parameters, "hidden")
    return Hidden(known.apply(values, load_cab(None, kind.machine), "hidden"), oil, known)


def draw(options: argparse.Namespace) -> None:
    """Draw machines, plan and record the campaign of each, seal the numbers."""
    out = Path(options.out)
    for i in range(options.count):
        shape = options.kinds.split(",")[i % len(options.kinds.split(","))]
        name, kind = f"{shape}{i + 1}", KINDS[shape]
        sealed = out / f"{name}.truth.json"
        if sealed.exists():
            continue
        cab, oil, known = hidden(kind, options.seed, i)
        folder = out / name
        if not (folder / "campaign.toml").exists():
            how = {"seconds": options.seconds, "other_law": kind.other_law}
            plan_campaign(kind.machine, None, None, kind.law, folder, **how)
        noise = int(np.random.SeedSequence(options.seed, spawn_key=(i,)).generate_state(1)[0])
        how = {"machine": kind.machine, "cab": cab, "hydraulics": oil, "seed": noise}
        record_campaign(folder, **how, jobs=options.jobs)
        write_json(sealed, {"seed": options.seed, "numbers": numbers(Hexapod(cab, oil))})
        print(f"{name}: recorded, {len(known)} numbers sealed", flush=True)


def _again(sealed: Path) -> Hidden:
    """A machine that was drawn, from its sealed file's seed and name."""
    name = sealed.name.removesuffix(".truth.json")
    shape = name.rstrip("0123456789")
    kind = KINDS[shape]
    seed = json.loads(sealed.read_text(encoding="utf-8"))["seed"]
    return hidden(kind, seed, int(name.removeprefix(shape)) - 1)


def _fits(out: Path) -> dict[str, Path]:
    """Folders of the fits by machine."""
    names = [path.name.removesuffix(".truth.json") for path in sorted(out.glob("*.truth.json"))]
    return {name: out / f"{name}.fit" for name in names}


def fit(options: argparse.Namespace) -> None:
    """Fit each machine that has no result."""
    for name, folder in _fits(Path(options.out)).items():
        try:
            _fit(Path(options.out) / name, folder, options.jobs)
        except Exception as error:  # one machine must not keep the others from being fitted
            print(f"{name}: {type(error).__name__}: {error}", flush=True)


def _fit(campaign: Path, folder: Path, jobs: int) -> None:
    """Fit a campaign into a folder, unless that is done."""
    from cmf_mj.studies.fit import doubt, results
    from cmf_mj.studies.fit.campaign import load_campaign
    from cmf_mj.studies.fit.engine import fit as fit_campaign

    if (folder / TIME).exists():
        return
    began, used = time.monotonic(), time.process_time()
    posterior = fit_campaign(load_campaign(campaign), folder, jobs=jobs)
    results.save(posterior, folder)
    spent, held = time.process_time() - used, doubt.predict_held_back(posterior)
    off = {
        "seconds": time.monotonic() - began,
        "cpu": spent,
        "gain": max((abs(one.gain) for one in held), default=0.0),
        "phase": max((abs(one.phase) for one in held), default=0.0),
    }
    write_json(folder / TIME, off)
    print(f"{campaign.name}: fitted in {off['seconds']:.0f} s, {spent:.0f} s of CPU", flush=True)


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
        lines = compared(truth, _rows(folder))
        said = json.loads((folder / TIME).read_text(encoding="utf-8"))
        table.append((name, *summed(lines), said["gain"], said["phase"], said["seconds"]))
        every += [line | {"machine": name} for line in lines]
    keys = "machine number truth value low high identifiable holds error".split()
    write_csv(out / "score.csv", keys, [[line.get(key, "") for key in keys] for line in every])
    worst = [max(column) for column in zip(*(one[-3:] for one in table), strict=True)]
    if table:
        table.append(("all", *summed(every), *worst))
    columns = ("machine", "known", "of", "held", ("median error", ".2%"), ("gain [dB]", ".2f"))
    print(Table("", (*columns, ("phase [deg]", ".1f"), ("time [s]", ".0f")), table).markdown())


def summed(lines: list[dict[str, Any]]) -> tuple[int, int, int, float]:
    """Identifiable numbers, all, those of the first in their interval, their median error."""
    known = [line for line in lines if line["identifiable"]]
    errors = [line["error"] for line in known if np.isfinite(line["error"])]
    held = sum(line["holds"] for line in known)
    return len(known), len(lines), held, float(np.median(errors)) if errors else float("nan")


def laws(options: argparse.Namespace) -> None:
    """Tune on fit and truth, measure on the truth; certify the law with the fit's box."""
    out = Path(options.out)
    for name, folder in _fits(out).items():
        if (folder / TIME).exists() and not (folder / LAWS).exists():
            write_json(folder / LAWS, _tuned(_again(out / f"{name}.truth.json"), folder, options))
    table = {name: folder / LAWS for name, folder in _fits(out).items() if (folder / LAWS).exists()}
    found = {name: json.loads(path.read_text("utf-8")) for name, path in table.items()}
    columns = ("machine", *next(iter(found.values()), {}))
    write_csv(out / "laws.csv", columns, [(name, *one.values()) for name, one in found.items()])
    for name, one in found.items():
        print(name, *(f"{key} {value:.4g}" for key, value in one.items()), sep="  ")


def _tuned(truth: Hidden, folder: Path, options: argparse.Namespace) -> dict[str, float]:
    """What laws tuned on a fit do on the machine it is of."""
    from cmf_mj.studies.certificate import certify
    from cmf_mj.studies.certificate_box import LARGEST_SCALE, load_box

    plants = {"fit": Hexapod("fitted", machine=folder / "machine.toml")}
    plants["truth"] = Hexapod(truth.cab, truth.oil)
    templates = {key: _template(plant) for key, plant in plants.items()}
    slowest: dict[str, list[float]] = {}
    found: dict[str, Law] = {}
    for key, template in templates.items():
        for seed in SEEDS:
            how: dict[str, Any] = {"seeds": (None,), "evaluations": options.laws, "seed": seed}
            law = search(template, Requirements(), **how).law
            carried = _carried(law, plants)
            performance, _ = judge(carried, templates["truth"], Requirements(), (None,))
            slowest.setdefault(key, []).append(float(performance.phase_hz.min()))
            found.setdefault(key, law)
    box, plant = load_box(folder / "box.toml"), plants["fit"]
    medians = {f"{key} [Hz]": float(np.median(one)) for key, one in slowest.items()}
    said = medians | {"ratio": medians["fit [Hz]"] / medians["truth [Hz]"]}
    said |= {f"spread {key}": float(np.ptp(one) / np.median(one)) for key, one in slowest.items()}
    recorded = load_law(folder / "law.toml")
    contacts: tuple[Contact, ...] = "none", "stuck"
    for law, friction in product((recorded, found["fit"]), contacts):
        one = certify(plant, law, folder / str(friction), box, friction=friction)
        what = f"{'recorded' if law is recorded else 'tuned'}, {friction}"
        broken = (
            one.breaking_scale if np.isfinite(one.breaking_scale) else LARGEST_SCALE
        )  # nothing breaks it
        said |= {f"{what}: proven": one.proven_scale, f"{what}: broken": broken}
    carried = _carried(found["fit"], plants)
    for name, law in {"recorded": recorded, "tuned": carried}.items():
        said[f"least damping on the truth, {name}"] = least_damping(
            law, templates["truth"].frictionless
        )
    return said | {"largest off, of the box": _off(plant, plants["truth"], box)}


def _carried(law: Law, plants: dict[str, Hexapod]) -> Law:
    """A law of a fit or the truth, with the modes it was made for, on the truth."""
    (shapes,) = (law.modes[plant.cab] for plant in plants.values() if plant.cab in law.modes)
    return law.model_copy(update={"modes": {plants["truth"].cab: shapes}})


def _template(plant: Hexapod) -> Template:
    """What a search needs of a machine with this plant's numbers, none of them its file's."""
    cab = plant.cab_parameters
    assert cab is not None
    template = make_template("tuned", "Tuned", [cab], "none")
    linear, modes = (linear_cab(plant, "none"),), {plant.cab: nominal_modes(plant)}
    how: dict[str, Any] = {"cabs": linear, "frictionless": linear, "hydraulics": plant.parameters}
    return template._replace(modes=dict(template.modes) | modes, **how)


def _off(fitted: Hexapod, truth: Hexapod, box: Box) -> float:
    """The largest distance of the truth from the fit, over the box's half width of that number."""
    found, true = numbers(fitted), numbers(truth)
    lags = "hydraulics.drive_lag", "hydraulics.valve_lag"
    if (found[lags[0]] < found[lags[1]]) != (true[lags[0]] < true[lags[1]]):  # the same loop
        true |= {lags[0]: true[lags[1]], lags[1]: true[lags[0]]}
    parts = {"valve_gain": ".leg_speed", "cab_place": ".centre_of_mass.", "cab_inertia": ".second_"}
    most = 0.0
    for name, one in box.unknowns.items():
        for path in (
            path for path in true if parts.get(name, name.replace("cab_", "cab.")) in path
        ):
            off = true[path] - found[path]
            most = max(most, abs(off / (1.0 if name == "cab_place" else found[path])) / one.half)
    return most


def plain(options: argparse.Namespace) -> None:
    """Fit sweeps of one axis after the other instead; compare the intervals, in OUT/plain.csv."""
    out, every = Path(options.out), list[dict[str, Any]]()
    for name, folder in _fits(out).items():
        if (folder / TIME).exists():
            shape = name.rstrip("0123456789")
            swept = out / f"{name}.plain"
            if not (swept / FILE).exists():
                _swept(KINDS[shape], out / name, swept)
                made = _again(out / f"{name}.truth.json")
                how: dict[str, Any] = {"machine": KINDS[shape].machine, "cab": made.cab}
                how |= {"hydraulics": made.oil}
                record_campaign(swept, **how, seed=options.seed, jobs=options.jobs)
            _fit(swept, out / f"{name}.plain.fit", options.jobs)
            truth = json.loads((out / f"{name}.truth.json").read_text(encoding="utf-8"))["numbers"]
            wide = [compared(truth, _rows(one)) for one in (out / f"{name}.plain.fit", folder)]
            ratios = [
                (b["high"] - b["low"]) / (a["high"] - a["low"]) for a, b in zip(*wide, strict=True)
            ]
            every += [
                a | {"machine": name, "ratio": r} for a, r in zip(wide[0], ratios, strict=True)
            ]
            mean = float(np.exp(np.mean(np.log(ratios))))
            print(f"{name}: intervals {mean:.3f} of those of plain sweeps, geometric mean")
    keys = "machine number truth low high holds ratio".split()
    write_csv(out / "plain.csv", keys, [[line[key] for key in keys] for line in every])


def _swept(kind: Kind, planned: Path, folder: Path) -> None:
    """Write a campaign of sweeps, as large as the planned one allows and as long."""
    said = read_toml(planned / FILE)
    one = load_scenario(planned / said["recordings"]["axes_large"]["source"])
    space, span = Workspace(Hexapod(machine=kind.machine), 0.4), float(one.duration or 0.0) - LEAD
    tables = {}
    for i, dof in enumerate(DOFS):

        def sweep(size: float, i: int = i, dof: str = dof) -> list[dict[str, Any]]:
            about = {"kind": "chirp", "dof": dof, "amplitude": float(size * space.reach[i])}
            about |= {"start": SWEPT[0], "stop": SWEPT[1], "duration": span - 0.2, "settle": 0.1}
            return [{"at": LEAD, "fade": 0.0, "signal": [about | {"fade": 0.05 * span}]}]

        how = one.table() | {"title": f"sweep in {dof}"}
        how.pop("change", None)
        run = space.run_of(PlannedRecording("sweep", "neutral", sweep), how)
        source = Path("scenarios") / f"{dof}.toml"
        text = {key: value for key, value in run.table().items() if value is not None}
        write_text(folder / source, tomlkit.dumps(text))
        tables[dof] = {"kind": "sweep", "pose": "neutral", "source": source.as_posix()}
    head = {key: said[key] for key in said if key != "recordings"}
    write_text(folder / FILE, tomlkit.dumps(head | {"recordings": tables}))


def _rows(folder: Path) -> list[dict[str, str]]:
    """Numbers of a fit as it wrote them."""
    with (folder / RESULT).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def main() -> None:
    """Run the part that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parts = parser.add_subparsers(dest="part", required=True)
    for part in (draw, fit, score, laws, plain):
        one = parts.add_parser(part.__name__, help=part.__doc__)
        one.set_defaults(run=part)
        one.add_argument("--out", default="out/hidden", help="folder of all machines")
        one.add_argument("--jobs", type=int, default=2, help="threads or processes")
        one.add_argument("--seed", type=int, default=1, help="of all that is drawn")
        if part is laws:
            one.add_argument("--laws", type=int, default=120, help="tried in each search")
        if part is draw:
            one.add_argument("--count", type=int, default=6, help="machines")
            one.add_argument("--kinds", default=",".join(KINDS), help="by turns, with commas")
            one.add_argument("--seconds", type=float, default=20.0, help="of each recording")
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
