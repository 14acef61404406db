"""What the page rests on: parameters with their status, models, versions, seed."""

from collections.abc import Iterator, Mapping
from importlib.metadata import version

import numpy as np

from cmf_mj.core import units
from cmf_mj.core.quantity import Quantity
from cmf_mj.electronics.sensors.settings import CHANNELS, load_sensors
from cmf_mj.record.record import Record
from cmf_mj.show.report_2014.contents import PageTable, table, texts
from cmf_mj.show.report_2014.runs import CAB, HYDRAULICS, PLANTS, Runs, hydraulics_of, plant_of
from cmf_mj.studies.case import CaseResult

_STATUS = texts("status")[0].text


def _mechanics_table() -> PageTable:
    """Masses as the models have them, read from the compiled MJCF."""
    single, whole = plant_of("model"), plant_of("machine")
    payload = float(whole.model.body_subtreemass[whole.model.body("platform").id])
    cab = whole.model.body("cab/cab")
    ahead, _, up = (float(value) for value in cab.ipos)
    load = f"{units.from_si('lbf', float(single.static_load()[0])):.0f} lbf"
    centre = f"{ahead:.2f} m ahead of and {up:.2f} m above the platform's centroid"
    modal = np.linalg.eigvalsh(whole.reflected_mass())[::-1] / units.POUND_MASS
    rows = [
        ("mass on a single leg", _pounds(single.reflected_mass()[0, 0]), "stated", "7200 lbm"),
        ("load on a single leg", load, "stated", "7200 lbf"),
        ("platform and cab", _pounds(payload), "derived", "7200 lbm a leg in heave"),
        ("cab alone", _pounds(cab.mass[0]), "assumed", "the split is ours"),
        ("centre of mass of the cab", centre, "assumed", "decides surge, sway, roll and pitch"),
        (
            "masses the legs feel, mode by mode",
            f"{', '.join(f'{mass:.0f}' for mass in modal)} lbm",
            "assumed",
            "eigenvalues of the reflected mass J^-T M J^-1 at neutral",
        ),
    ]
    title = f"Mechanics: single legs, and hexapod with the {CAB.upper()}"
    note = f"{_STATUS} models/README.md has every number of the models."
    return table("parameters", rows, anchor="parameters-mechanics", title=title, note=note)


def _pounds(mass: float) -> str:
    return f"{mass / units.POUND_MASS:.0f} lbm"


def _quantity_rows(values: Mapping[str, Quantity], of: str = "") -> list[tuple[str, ...]]:
    return [
        (f"{of}{name}".replace("_", " "), f"{q.value:g} {q.unit}", q.status, q.source)
        for name, q in values.items()
    ]


def parameters() -> list[PageTable]:
    """Numbers of hydraulics, mechanics and sensors with their status."""
    tables = [
        table(
            "parameters",
            _quantity_rows(hydraulics_of(on).quantities()),
            anchor=f"parameters-{HYDRAULICS[on]}",
            title=f"Hydraulics: {HYDRAULICS[on]}",
            note=_STATUS,
        )
        for on in PLANTS
    ]
    settings = load_sensors("noisy")
    sensors = [
        row
        for channel in CHANNELS
        for row in _quantity_rows(settings.channel(channel).quantities(), f"{channel}: ")
    ]
    return [*tables, _mechanics_table(), table("parameters-sensors", sensors)]


def _records(runs: Runs) -> Iterator[Record]:
    for result in runs.results.values():
        if isinstance(result, CaseResult):
            yield result.step
        else:
            yield from result if isinstance(result, tuple) else (result,)


def provenance(runs: Runs) -> PageTable:
    """What made the page: models, versions, seed."""
    rows = [
        ("seed", str(runs.seed)),
        ("cab of the hexapod", CAB.upper()),
        ("runs", str(len(runs.results))),
    ]
    for record in _records(runs):
        meta = record.metadata
        rows.append((f"model digest, {meta['plant']}", str(meta["model_digest"])))
        rows += [(f"version, {key}", str(value)) for key, value in sorted(meta["versions"].items())]
    rows += [(f"version, {name}", version(name)) for name in ("matplotlib", "plotly", "jinja2")]
    return table("provenance-table", list(dict.fromkeys(rows)))
