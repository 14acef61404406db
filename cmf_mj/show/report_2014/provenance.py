"""Sections on what the page rests on: parameters with their status, models, versions, seed."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version

import numpy as np

from cmf_mj.core import units
from cmf_mj.core.quantity import Quantity
from cmf_mj.electronics.sensors.settings import CHANNELS, load_sensors
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.show.report_2014.blocks import Content, PageTable, Section, TableRow
from cmf_mj.show.report_2014.runs import CAB, HYDRAULICS, On, Runs, hydraulics_of, plant_of
from cmf_mj.studies.comparison import CaseResult

_PLANTS: tuple[On, ...] = ("model", "machine")
_STATUS = (
    "Stated: printed in the report; derived: follows from printed numbers; calibrated: fitted to "
    "printed results; assumed: nobody published it."
)


def _mechanics_table() -> PageTable:
    """Masses as the models have them, read from the compiled MJCF."""
    single, whole = (plant_of(on) for on in _PLANTS)
    payload = float(whole.model.body_subtreemass[whole.model.body("platform").id])
    cab = whole.model.body("cab/cab")
    ahead, _, up = (float(value) for value in cab.ipos)
    rows = (
        (
            "mass on a single leg",
            _pounds(float(single.reflected_mass()[0, 0])),
            "stated",
            "7200 lbm",
        ),
        (
            "load on a single leg",
            f"{units.from_si('lbf', float(single.static_load()[0])):.0f} lbf",
            "stated",
            "7200 lbf",
        ),
        ("platform and cab", _pounds(payload), "derived", "7200 lbm a leg in heave"),
        ("cab alone", _pounds(float(cab.mass[0])), "assumed", "the split is ours"),
        (
            "centre of mass of the cab",
            f"{ahead:.2f} m ahead of and {up:.2f} m above the platform's centroid",
            "assumed",
            "decides surge, sway, roll and pitch",
        ),
        _modal_row(whole),
    )
    return PageTable(
        "parameters-mechanics",
        f"Mechanics: single legs, and hexapod with the {CAB.upper()}",
        ("parameter", "value", "status", "source"),
        tuple(TableRow(row) for row in rows),
        f"{_STATUS} models/README.md has every number of the models.",
    )


def _pounds(mass: float) -> str:
    return f"{mass / units.POUND_MASS:.0f} lbm"


def _modal_row(plant: Plant) -> tuple[str, str, str, str]:
    masses = np.linalg.eigvalsh(plant.reflected_mass())[::-1] / units.POUND_MASS
    text = ", ".join(f"{mass:.0f}" for mass in masses)
    source = "eigenvalues of the reflected mass J^-T M J^-1 at neutral"
    return ("masses the legs feel, mode by mode", f"{text} lbm", "assumed", source)


def _sensor_table() -> PageTable:
    settings = load_sensors("noisy")
    rows = tuple(
        TableRow(
            (f"{channel}: {name}".replace("_", " "), f"{q.value:g} {q.unit}", q.status, q.source)
        )
        for channel in CHANNELS
        for name, q in settings.channel(channel).quantities().items()
    )
    return PageTable(
        "parameters-sensors",
        "Sensors of Figures 3-15 and 3-16: noisy",
        ("number", "value", "status", "source"),
        rows,
    )


def _parameter_table(name: str, values: Mapping[str, Quantity]) -> PageTable:
    rows = tuple(
        TableRow((key.replace("_", " "), f"{q.value:g} {q.unit}", q.status, q.source))
        for key, q in values.items()
    )
    return PageTable(
        f"parameters-{name}",
        f"Hydraulics: {name}",
        ("parameter", "value", "status", "source"),
        rows,
        _STATUS,
    )


def parameters(content: Content) -> Section:
    """Numbers of hydraulics, mechanics and sensors with their status."""
    tables = [_parameter_table(HYDRAULICS[on], hydraulics_of(on).quantities()) for on in _PLANTS]
    tables += [_mechanics_table(), _sensor_table()]
    return Section("parameters", "Parameters and their status", tuple(tables))


def _records(runs: Runs) -> Sequence[Record]:
    found = []
    for result in runs.results.values():
        kept = (
            result
            if isinstance(result, tuple) and not isinstance(result, CaseResult)
            else (result,)
        )
        found += [item.step if isinstance(item, CaseResult) else item for item in kept]
    return found


def provenance(content: Content) -> Section:
    """What made the page: models, versions, seed."""
    rows: dict[tuple[str, ...], None] = {
        ("seed", str(content.runs.seed)): None,
        ("cab of the hexapod", CAB.upper()): None,
        ("runs", str(len(content.runs.results))): None,
    }
    for record in _records(content.runs):
        meta = record.metadata
        rows[(f"model digest, {meta['plant']}", str(meta["model_digest"]))] = None
        for key, value in sorted(meta["versions"].items()):
            rows[(f"version, {key}", str(value))] = None
    for package in ("matplotlib", "plotly", "jinja2"):
        rows[(f"version, {package}", version(package))] = None
    table = PageTable(
        "provenance-table", "Made by", ("", ""), tuple(TableRow(cells) for cells in rows)
    )
    return Section("provenance", "Models, versions and seed", (table,))
