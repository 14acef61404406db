"""What the page rests on: parameters with their status, models, versions, seed."""

from collections.abc import Mapping
from importlib.metadata import version

import numpy as np

from cmf_mj.core import units
from cmf_mj.core.quantity import Quantity
from cmf_mj.electronics.sensors.settings import CHANNELS, load_sensors
from cmf_mj.show.report_2014.contents import PageTable, table, texts
from cmf_mj.show.report_2014.runs import CAB, HYDRAULICS, PLANTS, Runs, hydraulics_of, plant_of


def _mechanics() -> list[tuple[str, str, str, str]]:
    """Masses as the models have them, read from the compiled MJCF."""
    single, whole = plant_of("model"), plant_of("machine")
    payload = float(whole.model.body_subtreemass[whole.model.body("platform").id])
    cab = whole.model.body("cab/cab")
    ahead, _, up = (float(value) for value in cab.ipos)
    centre = f"{ahead:.2f} m ahead of and {up:.2f} m above the platform's centroid"
    load = f"{units.from_si('lbf', float(single.static_load()[0])):.0f} lbf"
    modal = np.linalg.eigvalsh(whole.reflected_mass())[::-1] / units.POUND_MASS
    eigenvalues = "eigenvalues of the reflected mass J^-T M J^-1 at neutral"
    mass, cab_mass = float(single.reflected_mass()[0, 0]), float(cab.mass[0])
    return [
        ("mass on a single leg", _pounds(mass), "stated", "7200 lbm"),
        ("load on a single leg", load, "stated", "7200 lbf"),
        ("platform and cab", _pounds(payload), "derived", "7200 lbm a leg in heave"),
        ("cab alone", _pounds(cab_mass), "assumed", "the split is ours"),
        ("centre of mass of the cab", centre, "assumed", "decides surge, sway, roll and pitch"),
        (
            "masses the legs feel, mode by mode",
            f"{', '.join(f'{part:.0f}' for part in modal)} lbm",
            *("assumed", eigenvalues),
        ),
    ]


def _pounds(mass: float) -> str:
    return f"{mass / units.POUND_MASS:.0f} lbm"


def _rows(values: Mapping[str, Quantity], of: str = "") -> list[tuple[str, ...]]:
    return [
        (f"{of}{name}".replace("_", " "), f"{q.value:g} {q.unit}", q.status, q.source)
        for name, q in values.items()
    ]


def parameters() -> list[PageTable]:
    """Numbers of hydraulics, mechanics and sensors with their status."""
    (status,) = texts("status")
    settings = load_sensors("noisy")
    sensors = [_rows(settings.channel(name).quantities(), f"{name}: ") for name in CHANNELS]
    mechanics = f"Mechanics: single legs, and hexapod with the {CAB.upper()}"
    note = f"{status} models/README.md has every number of the models."
    return [
        *(
            table(
                *("parameters", _rows(hydraulics_of(on).quantities())),
                *(f"parameters-{name}", f"Hydraulics: {name}", status),
            )
            for on, name in HYDRAULICS.items()
        ),
        table("parameters", _mechanics(), "parameters-mechanics", mechanics, note),
        table("parameters-sensors", sum(sensors, [])),
    ]


def provenance(runs: Runs) -> PageTable:
    """What made the page: models, versions, seed."""
    packages = ("cmf-mj", "mujoco", "numpy", "scipy", "numba", "control", "plotly")
    rows = [
        *(("seed", str(runs.seed)), ("cab of the hexapod", CAB.upper())),
        *((f"model digest, {name}", plant_of(on).digest) for on, name in PLANTS.items()),
        *((f"version, {name}", version(name)) for name in packages),
    ]
    return table("provenance-table", rows)
