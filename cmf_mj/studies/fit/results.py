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

from cmf_mj.core.files import plain_path, write_text
from cmf_mj.core.result import Table
from cmf_mj.core.tables import write_csv, write_parquet
from cmf_mj.core.units import si_unit
from cmf_mj.facility.unknown import DERIVED
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.models import Legs
from cmf_mj.plant.parameters import OF_THE_SUPPLY
from cmf_mj.studies.certificate_box import WIDEST_DEVIATION, load_box
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]

FITTED = "fitted"  #: Name of the cab and of the sensors in files.
SAMPLES = 400  #: Machines drawn.


def paths(posterior: Posterior) -> tuple[str, ...]:
    """Paths of all numbers, of each leg its own, in the order of the coordinates."""
    return tuple(path for *_, path in posterior.campaign.unknowns.numbers())


def physical(posterior: Posterior, z: Array) -> Array:
    """Numbers in SI at coordinates (..., n)."""
    campaign, share = posterior.campaign, stats.norm.cdf(z)
    columns = [
        unknown.number(campaign.nominal(path)[0], unknown.at(share[..., i]))
        for i, (_, unknown, path) in enumerate(campaign.unknowns.numbers())
    ]
    return np.stack(columns, axis=-1)


def numbers(posterior: Posterior) -> Table:
    """Every number with its 90 % interval."""
    best, low, high = physical(posterior, np.vstack([posterior.z, posterior.bounds()])).tolist()
    identified = posterior.identified()
    campaign, rows = posterior.campaign, []
    for i, (_, unknown, path) in enumerate(campaign.unknowns.numbers()):
        _, unit = campaign.nominal(path)
        if unit == "SI" and unknown.effect != "factor":
            unit = si_unit(unknown.unit)
        rows.append((path, best[i], low[i], high[i], unit, "yes" if identified[i] else "no"))
    columns = ("number", ("value", ".5g"), ("low", ".5g"), ("high", ".5g"), "unit", "identifiable")
    return Table("Numbers of the machine, with 90 % intervals", columns, rows)


def save(posterior: Posterior, folder: str | Path) -> Path:
    """Write all files of a fit; returns the path of the machine's."""
    target = Path(folder)
    table = numbers(posterior)
    write_csv(plain_path(target, "numbers.csv"), table.header, table.rows)
    sampled_numbers = physical(posterior, posterior.samples(SAMPLES))
    columns = dict(zip(paths(posterior), sampled_numbers.T, strict=True))
    write_parquet(pa.table(columns), plain_path(target, "samples.parquet"))
    write_text(plain_path(target, "box.toml"), tomlkit.dumps(box(posterior)))
    if any(path.startswith("electronics.") for path in paths(posterior)):
        write_text(plain_path(target, "sensors.toml"), tomlkit.dumps(_sensors_table(posterior)))
    if posterior.campaign.plant.cab_parameters is None:
        return target
    law = posterior.applied(posterior.campaign.law)
    law = law.model_copy(update={"name": f"{law.name}_recorded"})
    save_law(law, plain_path(target, "law.toml"))
    return write_text(plain_path(target, "machine.toml"), tomlkit.dumps(_machine_table(posterior)))


def _sensors_table(posterior: Posterior) -> dict[str, Any]:
    """The file of the fitted sensors."""
    unknowns, sensors = posterior.campaign.unknowns, posterior.campaign.sensors
    assert sensors is not None
    source = _provenance(posterior)
    fitted = Unknowns({name: each.model_copy(update=source) for name, each in unknowns.items()})
    changed = fitted.apply(unknowns.at(stats.norm.cdf(posterior.z)), sensors)
    table = changed.model_dump(mode="json", exclude_none=True, exclude={"name"})
    return {"base": "ideal", FITTED: table}


def _machine_table(posterior: Posterior) -> dict[str, Any]:
    """The file of the fitted machine, whose law is `law.toml` beside it.

    The MJCF is left out: the numbers are those of the file, and the machine is drawn from them.
    """
    plant = posterior.applied(posterior.campaign.plant)
    machine, cab = plant.machine, plant.cab_parameters
    assert cab is not None
    table = machine.model_dump(mode="json", exclude_none=True, exclude={"mjcf"})
    bodies = cab.model_dump(mode="json", exclude_none=True)
    station = machine.cabs[cab.base].model_dump(mode="json")["station"]
    inertial = ("mass", "centre_of_mass", "inertia")
    unwritten = {"name", "half_stroke"}
    hydraulics = plant.parameters.model_dump(mode="json", exclude_none=True, exclude=unwritten)
    table |= {
        "name": f"{machine.name}_fitted".replace(" ", "_"),
        "title": f"{machine.title}, fitted to recordings",
        "law": "law.toml",
        "hydraulics": {"base": "hardware"} | hydraulics,
        "platform": {part: bodies["platform"][part] for part in inertial},
        "cabs": {FITTED: {part: bodies[part] for part in inertial} | {"station": station}},
        "legs": table["legs"] | bodies["legs"],
    }
    _mark_identified(posterior, table)
    return table


def _provenance(posterior: Posterior) -> dict[str, Any]:
    """Status and source of what was fitted: recordings, and who states the evidence."""
    campaign = posterior.campaign
    recordings = campaign.recordings_where(held_back=False)
    files = [f"{recording.name} {recording.record.digest}" for recording in recordings]
    fitted = {number.evidence for number in campaign.evidence.statements if not number.held_back}
    evidence = campaign.settings.evidence
    sources = dict.fromkeys(evidence[name].source for name in evidence if name in fitted)
    texts = [f"recordings {', '.join(dict.fromkeys(files))}"] if files else []
    texts += [f"what is stated in {', '.join(sources)}"] if sources else []
    return {"status": "identified", "source": f"fitted to {' and '.join(texts)}"}


_FIELDS = {name: (field,) for name, field in DERIVED.items()} | {
    "supply": ("supply_pressure", *OF_THE_SUPPLY),
    "friction": ("coulomb_friction", "breakaway_friction"),
    "stiction": ("breakaway_friction",),
    "density": ("mass", "inertia"),
    "second_moment": ("inertia",),
}
"""What a number changes in a machine's file, where its path has another name for it."""


def _mark_identified(posterior: Posterior, table: dict[str, Any]) -> None:
    """Write status and source to the numbers of a machine's `table` that were fitted."""
    provenance = _provenance(posterior)
    bodies = {"cab": [table["cabs"][FITTED]], "platform": [table["platform"]]}
    bodies["payload"] = bodies["cab"] + bodies["platform"]
    for path in paths(posterior):
        root, *groups, last = path.split(".")
        if root == "hydraulics":
            entry: Any = table["hydraulics"]
            for group in groups:
                entry = entry[group]
            changed = [entry[field] for field in _FIELDS.get(last, (last,))]
        elif root == "legs":
            changed = [table["legs"][field] for field in Legs.model_fields]
        else:
            body_field = groups[0] if groups else last
            fields = _FIELDS.get(body_field, (body_field,))
            changed = [body[field] for body in bodies.get(root, ()) for field in fields]
        for quantity in changed:
            quantity |= provenance


_BOX_PATHS = {
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
"""Patterns of the machine's paths that a number of the box stands for."""


def box(posterior: Posterior, share: float = 0.99) -> dict[str, Any]:
    """A box that holds all numbers together with a probability, as `cmf certify --box` takes it.

    Of n numbers each has the share 1 - (1 - share) / n. The larger half width counts, in %. Lags
    keep their order, since a loop is the same with two of them exchanged.
    """
    share_each = 1.0 - (1.0 - share) / len(posterior.names)
    z_bounds = posterior.bounds(share_each, exchange=False)
    bounds, best = physical(posterior, z_bounds), physical(posterior, posterior.z)
    half_width = np.abs(bounds - best).max(axis=0)
    ratio = np.minimum(half_width / np.maximum(np.abs(best), 1e-12), WIDEST_DEVIATION)
    table = load_box().model_dump(mode="json", exclude_defaults=True)
    source = f"{100 * share:g} % of the machines that the recordings allow, all numbers together"
    for name, pattern in _BOX_PATHS.items():
        deviations = half_width if name == "cab_place" else 100.0 * ratio
        matches = [re.fullmatch(pattern, path) is not None for path in paths(posterior)]
        if any(matches):
            largest = max(1e-4, float(deviations[matches].max()))
            deviation = float(f"{largest:.4g}")
            table["unknowns"][name] |= {"deviation": deviation, "source": source}
    return table | {"title": "What the recordings leave open"}
