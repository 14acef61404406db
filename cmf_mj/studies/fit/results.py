"""What a fit leaves: numbers with intervals, the fitted machine as files, samples, a box.

    numbers.csv       each number: value, 90 % interval, unit, whether the recordings show it
    machine.toml      the machine with cab and hydraulic set, numbers of status `identified`
    box.toml          how far its numbers may be off, for `cmf certify`
    sensors.toml      the sensors, where numbers of theirs were fitted
    samples.parquet   machines that the recordings allow, a row each, a column a number

A machine's file takes the place of the data sheet's in every command.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import tomlkit
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.control.law import load_law
from cmf_mj.core.files import plain_path, write_csv, write_parquet, write_text
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.result import Table
from cmf_mj.electronics.sensors import SensorSettings
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.certificate_family import WIDEST, load_box
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]

CAB, SAMPLES = "fitted", 400


_FIELDS = {"friction": "coulomb_friction", "stiction": "breakaway_friction"}
_FIELDS |= {"second_moment": "inertia"}
"""What a number is named in a machine's file, where its path has another name for it."""


def paths(posterior: Posterior) -> tuple[str, ...]:
    """Paths of all numbers, of each leg its own, in the order of the coordinates."""
    return tuple(path for *_, path in posterior.campaign.unknowns.numbers())


def nominal(plant: Plant, path: str, sensors: SensorSettings | None = None) -> float:
    """A number of a machine or its sensors in SI, of gain errors 0; 1 where it is a factor."""
    root, *rest = path.split(".")
    if root == "electronics":
        known = getattr(getattr(sensors, rest[0], None), rest[1], None)
        return known.si if isinstance(known, Quantity) else 0.0
    oil, cab = plant.parameters, plant.cab_parameters
    if path == "hydraulics.stiction":
        size = oil.coulomb_friction.si
        return oil.breakaway_friction.si / size if size else 1.0
    if root == "hydraulics":
        fields = oil.actuator(rest[1]) if rest[0] == "actuators" else dict(oil)
        known = fields.get(_FIELDS.get(rest[-1], rest[-1]))
        return known.si if isinstance(known, Quantity) else 1.0
    if root not in ("cab", "platform") or cab is None:
        return 1.0
    body, axis = cab if root == "cab" else cab.platform, "xyz".find(rest[-1])
    moments = 0.5 * np.trace(body.tensor) - np.diag(body.tensor)
    each = {"mass": body.mass.si, "centre_of_mass": body.centre_of_mass.si[axis]}
    return float((each | {"second_moment": moments[axis]}).get(rest[0], 1.0))


def physical(posterior: Posterior, z: Array) -> Array:
    """Numbers in SI at coordinates (..., n)."""
    campaign, share = posterior.campaign, stats.norm.cdf(z)
    plant, sensors = campaign.plant, campaign.sensors
    columns = [
        one.number(nominal(plant, path, sensors), one.at(share[..., i]))
        for i, (_, one, path) in enumerate(campaign.unknowns.numbers())
    ]
    return np.stack(columns, axis=-1)


_UNITS = {"mass": "kg", "friction": "N", "leg_speed": "m/s", "bulk_modulus": "Pa"}
_UNITS |= {"supply_pressure": "Pa", "leak_rate": "1/s", "centre_of_mass": "m"}
_UNITS |= dict.fromkeys(("drive_lag", "valve_lag", "derivative_pole"), "rad/s")
_UNITS |= {"second_moment": "kg m^2", "bandwidth": "rad/s", "leg_position": "m"}
_UNITS |= dict.fromkeys(("cap_pressure", "rod_pressure"), "Pa")
"""SI units of numbers by the last or last but one part of their paths; of others 1."""


def numbers(posterior: Posterior) -> Table:
    """Every number with its 90 % interval."""
    value = physical(posterior, np.vstack([posterior.z, posterior.bounds()])).T.tolist()
    known = ["yes" if one else "no" for one in posterior.identified()]
    rows = []
    for path, three, found in zip(paths(posterior), value, known, strict=True):
        unit = next((_UNITS[part] for part in path.split(".")[:-3:-1] if part in _UNITS), "1")
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
        write_text(plain_path(where, "sensors.toml"), tomlkit.dumps(_sensors(posterior)))
    return save_machine(posterior, where) if posterior.campaign.plant.cab_parameters else where


def save_machine(posterior: Posterior, where: Path) -> Path:
    """Write the fitted machine, its law beside it.

    A drawn model is left out: the numbers are those of the file, the machine is drawn from them.
    """
    plant = fitted(posterior)
    machine, cab, oil = plant.machine, plant.cab_parameters, plant.parameters
    assert cab is not None
    table = machine.model_dump(mode="json", exclude_none=True, exclude={"mjcf"})
    name = f"{machine.name}_fitted".replace(" ", "_")
    law = load_law(posterior.campaign.settings.law or machine.law)
    save_law(law.model_copy(update={"name": f"{law.name}_recorded"}), plain_path(where, "law.toml"))
    bodies = cab.model_dump(mode="json", exclude_none=True)
    station = machine.cabs[cab.base].model_dump(mode="json")["station"]
    parts = ("mass", "centre_of_mass", "inertia")
    fit_ = {part: bodies[part] for part in parts}
    flow = oil.model_dump(mode="json", exclude_none=True, exclude={"name", "half_stroke"})
    table |= {
        "name": name,
        "title": f"{machine.title}, fitted to recordings",
        "law": "law.toml",
        "hydraulics": {"base": "hardware"} | flow,
        "platform": {part: bodies["platform"][part] for part in parts},
        "cabs": {CAB: fit_ | {"station": station}},
        "legs": table["legs"] | bodies["legs"],
    }
    return write_text(
        plain_path(where, "machine.toml"), tomlkit.dumps(_identified(posterior, table))
    )


def fitted(posterior: Posterior) -> Plant:
    """The plant with the fitted numbers."""
    known = posterior.campaign.unknowns
    return known.apply(known.at(stats.norm.cdf(posterior.z)), posterior.campaign.plant)


def _sensors(posterior: Posterior) -> dict[str, Any]:
    """The file of the sensors with the fitted numbers."""
    campaign, said = posterior.campaign, _source(posterior)
    known = {name: one.model_copy(update=said) for name, one in campaign.unknowns.items()}
    fit_ = Unknowns(known).on(campaign.plant)
    assert campaign.sensors is not None
    made = fit_.apply(fit_.at(stats.norm.cdf(posterior.z)), campaign.sensors, CAB)
    return {"base": "ideal", CAB: made.model_dump(mode="json", exclude_none=True, exclude={"name"})}


def _source(posterior: Posterior) -> dict[str, Any]:
    """Status and source of what was fitted."""
    made = (f"{one.name} {one.record.digest}" for one in posterior.campaign.of(held_back=False))
    return {"status": "identified", "source": f"fitted to recordings {', '.join(made)}"}


def _identified(posterior: Posterior, table: dict[str, Any]) -> dict[str, Any]:
    """The file's numbers that were fitted, with status and source."""
    said = _source(posterior)
    bodies = {"hydraulics": table["hydraulics"], "platform": table["platform"]}
    for path in paths(posterior):
        root, *rest = path.split(".")
        if root == "electronics":
            continue
        at: Any = bodies.get(root, table["cabs"][CAB])
        for part in rest[: None if root == "hydraulics" else 1]:
            at = at.get(_FIELDS.get(part, part), {})
        at |= said
    return table


_OF_BOX = {
    "drive_lag": ".drive_lag",
    "valve_lag": ".valve_lag",
    "valve_gain": ".leg_speed",
    "leak_rate": ".leak_rate",
    "bulk_modulus": ".bulk_modulus",
    "cab_mass": ".mass",
    "cab_place": ".centre_of_mass.",
    "cab_inertia": ".second_moment.",
}
"""What of the machine a number of the box stands for, as part of its path."""


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
    listed, unit = paths(posterior), load_box().model_dump(mode="json", exclude_defaults=True)
    source = f"{100 * share:g} % of the machines that the recordings allow, all numbers together"
    for name, part in _OF_BOX.items():
        place = name == "cab_place"
        widths = [(off if place else 100.0 * ratio)[i] for i, p in enumerate(listed) if part in p]
        if widths:
            width = float(f"{max(1e-4, *map(float, widths)):.4g}")
            unit["unknowns"][name] |= {"deviation": width, "source": source}
    return unit | {"title": "What the recordings leave open"}
