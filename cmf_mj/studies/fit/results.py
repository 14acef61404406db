"""What a fit leaves: numbers with intervals, the fitted machine as files, samples, a box.

    numbers.csv       each number: value, 90 % interval, unit, whether the recordings show it
    machine.toml      the machine with cab and hydraulic set, numbers of status `identified`
    box.toml          how far its numbers may be off, for `cmf certify`
    sensors.toml      the sensors, where numbers of theirs were fitted
    samples.parquet   machines that the recordings allow, a row each, a column a number

A machine's file takes the place of the data sheet's in every command.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import tomlkit
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.core.files import plain_path, write_csv, write_parquet, write_text
from cmf_mj.core.result import Table
from cmf_mj.core.units import si_unit
from cmf_mj.facility.unknown import DERIVED
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.models import Legs
from cmf_mj.plant.parameters import OF_THE_SUPPLY
from cmf_mj.studies.certificate_family import WIDEST, load_box
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]

CAB, SAMPLES = "fitted", 400  #: Name of the cab and of the sensors in files; machines drawn.


def paths(posterior: Posterior) -> tuple[str, ...]:
    """Paths of all numbers, of each leg its own, in the order of the coordinates."""
    return tuple(path for *_, path in posterior.campaign.unknowns.numbers())


def physical(posterior: Posterior, z: Array) -> Array:
    """Numbers in SI at coordinates (..., n)."""
    campaign, share = posterior.campaign, stats.norm.cdf(z)
    columns = [
        one.number(campaign.nominal(path)[0], one.at(share[..., i]))
        for i, (_, one, path) in enumerate(campaign.unknowns.numbers())
    ]
    return np.stack(columns, axis=-1)


def numbers(posterior: Posterior) -> Table:
    """Every number with its 90 % interval."""
    value = physical(posterior, np.vstack([posterior.z, posterior.bounds()])).T.tolist()
    known = ["yes" if one else "no" for one in posterior.identified()]
    campaign, rows = posterior.campaign, []
    for (_, one, path), three, found in zip(campaign.unknowns.numbers(), value, known, strict=True):
        unit = campaign.nominal(path)[1]
        if unit == "SI" and one.effect != "factor":
            unit = si_unit(one.unit)
        rows.append((path, *three, unit, found))
    columns = ("number", ("value", ".5g"), ("low", ".5g"), ("high", ".5g"), "unit", "identifiable")
    return Table("Numbers of the machine, with 90 % intervals", columns, rows)


def save(posterior: Posterior, folder: str | Path) -> Path:
    """Write all files of a fit; gives the machine's."""
    where = Path(folder)
    table = numbers(posterior)
    write_csv(plain_path(where, "numbers.csv"), table.header, table.rows)
    drawn = physical(posterior, posterior.samples(SAMPLES))
    columns = dict(zip(paths(posterior), drawn.T, strict=True))
    write_parquet(pa.table(columns), plain_path(where, "samples.parquet"))
    write_text(plain_path(where, "box.toml"), tomlkit.dumps(box(posterior)))
    if any(path.startswith("electronics.") for path in paths(posterior)):
        known, sensors = posterior.campaign.unknowns, posterior.campaign.sensors
        assert sensors is not None
        said = {name: one.model_copy(update=_provenance(posterior)) for name, one in known.items()}
        made = Unknowns(said).apply(known.at(stats.norm.cdf(posterior.z)), sensors)
        fitted = made.model_dump(mode="json", exclude_none=True, exclude={"name"})
        write_text(plain_path(where, "sensors.toml"), tomlkit.dumps({"base": "ideal", CAB: fitted}))
    if posterior.campaign.plant.cab_parameters is None:
        return where
    machine = tomlkit.dumps(_machine(posterior, where))
    return write_text(plain_path(where, "machine.toml"), machine)


def _machine(posterior: Posterior, where: Path) -> dict[str, Any]:
    """The file of the fitted machine; its law is written beside it.

    A drawn model is left out: the numbers are those of the file, the machine is drawn from them.
    """
    plant = posterior.applied(posterior.campaign.plant)
    machine, cab, oil = plant.machine, plant.cab_parameters, plant.parameters
    assert cab is not None
    table = machine.model_dump(mode="json", exclude_none=True, exclude={"mjcf"})
    law = posterior.applied(posterior.campaign.law)
    save_law(law.model_copy(update={"name": f"{law.name}_recorded"}), plain_path(where, "law.toml"))
    bodies = cab.model_dump(mode="json", exclude_none=True)
    station = machine.cabs[cab.base].model_dump(mode="json")["station"]
    parts = ("mass", "centre_of_mass", "inertia")
    flow = oil.model_dump(mode="json", exclude_none=True, exclude={"name", "half_stroke"})
    table |= {
        "name": f"{machine.name}_fitted".replace(" ", "_"),
        "title": f"{machine.title}, fitted to recordings",
        "law": "law.toml",
        "hydraulics": {"base": "hardware"} | flow,
        "platform": {part: bodies["platform"][part] for part in parts},
        "cabs": {CAB: {part: bodies[part] for part in parts} | {"station": station}},
        "legs": table["legs"] | bodies["legs"],
    }
    return _identified(posterior, table)


def _provenance(posterior: Posterior) -> dict[str, Any]:
    """Status and source of what was fitted: recordings, and who states the evidence."""
    campaign = posterior.campaign
    files = [f"{one.name} {one.record.digest}" for one in campaign.of(held_back=False)]
    fitted_to = {one.evidence for one in campaign.evidence.statements if not one.held_back}
    stated = [one.source for name, one in campaign.settings.evidence.items() if name in fitted_to]
    kinds = (("recordings ", files), ("what is stated in ", stated))
    source = " and ".join(kind + ", ".join(dict.fromkeys(each)) for kind, each in kinds if each)
    return {"status": "identified", "source": f"fitted to {source}"}


_FIELDS = {name: (field,) for name, field in DERIVED.items()} | {
    "supply": ("supply_pressure", *OF_THE_SUPPLY),
    "friction": ("coulomb_friction", "breakaway_friction"),
    "stiction": ("breakaway_friction",),
    "density": ("mass", "inertia"),
    "second_moment": ("inertia",),
}
"""What a number changes in a machine's file, where its path has another name for it."""


def _identified(posterior: Posterior, table: dict[str, Any]) -> dict[str, Any]:
    """The file's numbers that were fitted, with status and source."""
    provenance = _provenance(posterior)
    bodies = {"cab": [table["cabs"][CAB]], "platform": [table["platform"]]}
    bodies["payload"] = bodies["cab"] + bodies["platform"]
    for path in paths(posterior):
        root, *rest = path.split(".")
        if root == "hydraulics":
            entry: Any = table["hydraulics"]
            for part in rest[:-1]:
                entry = entry[part]
            changed = [entry[field] for field in _FIELDS.get(rest[-1], rest[-1:])]
        elif root == "legs":
            changed = [table["legs"][field] for field in Legs.model_fields]
        else:
            fields = _FIELDS.get(rest[0], rest[:1])
            changed = [body[field] for body in bodies.get(root, ()) for field in fields]
        for quantity in changed:
            quantity |= provenance
    return table


_OF_BOX = {
    "drive_lag": r"hydraulics\.(.*\.)?drive_lag",
    "valve_lag": r"hydraulics\.(.*\.)?valve_lag",
    "valve_gain": r"hydraulics\.(.*\.)?(leg_speed|valve_gain)",
    "leak_rate": r"hydraulics\.(.*\.)?(leak_rate|leakage)",
    "bulk_modulus": r"hydraulics\.bulk_modulus",
    "supply_pressure": r"hydraulics\.supply(_pressure)?",
    "cab_mass": r"cab\.(mass|density)|payload\.density",
    "cab_place": r"cab\.centre_of_mass\.[xyz]",
    "cab_inertia": r"cab\.(inertia|density|second_moment\.[xyz])|payload\.density",
}
"""Paths of the machine that a number of the box stands for."""


def box(posterior: Posterior, share: float = 0.99) -> dict[str, Any]:
    """A box that holds all numbers together with a probability, as `cmf certify --box` takes it.

    Of n numbers each has the share 1 - (1 - share) / n. The larger half width counts, in %. Lags
    keep their order, since a loop is the same with two of them exchanged.
    """
    each = 1.0 - (1.0 - share) / len(posterior.names)
    ends = posterior.bounds(each, exchange=False)
    bounds, best = physical(posterior, ends), physical(posterior, posterior.z)
    off = np.abs(bounds - best).max(axis=0)
    ratio = np.minimum(off / np.maximum(np.abs(best), 1e-12), WIDEST)
    listed, table = paths(posterior), load_box().model_dump(mode="json", exclude_defaults=True)
    source = f"{100 * share:g} % of the machines that the recordings allow, all numbers together"
    for name, pattern in _OF_BOX.items():
        size = off if name == "cab_place" else 100.0 * ratio
        widths = [float(size[i]) for i, p in enumerate(listed) if re.fullmatch(pattern, p)]
        if widths:
            width = float(f"{max(1e-4, *widths):.4g}")
            table["unknowns"][name] |= {"deviation": width, "source": source}
    return table | {"title": "What the recordings leave open"}
