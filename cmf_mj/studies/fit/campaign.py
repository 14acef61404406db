"""A campaign: a folder of recordings of one machine, and `campaign.toml` that says what each is.

    machine = "mine.toml"               # the data sheet; files count from this one's folder
    law = "velocity"                    # the law that the machine ran
    columns = "columns.toml"            # how the files' columns are read; default the facility's

    [recordings.surge]
    file = "surge.csv"
    kind = "multisine"                  # hold, ramp, sweep, multisine, step, valves
    held_back = true                    # kept for the test of the fit, by default false
    law = "original"                    # where it is not the campaign's
    pose = "heave 5 in below neutral"

    [unknowns.mass]                     # what is not known, default `data_sheet`
    path = "cab.mass"
    deviation = 30.0
    source = "guess"

    [held.supply]                       # not known exactly either, but not fitted
    path = "hydraulics.supply_pressure"
    deviation = 10.0
    source = "gauge"

What is known beside recordings, or in their stead, stands under `[evidence]`, see `evidence`. A
file may begin with `base = "hardware"`, a shipped campaign: of evidence and deviations it repeats
only what it changes; other tables, such as `unknowns`, replace those of the base whole.
Recordings hold the demand of the legs, `leg_reference`, or of kind `valves` `valve_command`, and of
`leg_position`, `cap_pressure`, `rod_pressure` what was measured.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.settings import Name, Settings, beside, merged, read_toml, validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.electronics.chain import AnyElectronics, ElectronicsSettings
from cmf_mj.electronics.sensors import SensorSettings
from cmf_mj.facility.unknown import Unknown, nominal
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.models import CMF
from cmf_mj.plant.hexapod import make_plant
from cmf_mj.plant.parameters import hydraulics_of
from cmf_mj.plant.plant import Plant
from cmf_mj.record.columns import read_mapped
from cmf_mj.record.record import Record
from cmf_mj.studies.fit.evidence import Deviations, Evidence, EvidenceSettings, load_evidence

FILE = "campaign.toml"  #: Name of a campaign's file in its folder.

_READY = Path(__file__).with_name("ready")
SHIPPED = tuple(sorted(path.stem for path in _READY.glob("*.toml")))
"""Campaigns of this package: what the 2014 report states of its two plants."""

MEASURED = ("leg_position", "cap_pressure", "rod_pressure")  #: Channels that a fit explains.

Kind = Literal["hold", "ramp", "sweep", "multisine", "step", "valves"]


class RecordingSettings(Settings):
    """What one recording is."""

    file: str  #: In the campaign's folder.
    kind: Kind  #: What was commanded; of `valves` the valve commands are given, else the legs'.
    held_back: bool = False  #: Whether the fit must predict it unseen.
    columns: str | None = None  #: Its column map, by default the campaign's.
    law: str | None = None  #: The law it ran, by default the campaign's.
    pose: str = ""  #: About which pose, in words.
    source: str | None = None  #: Scenario that makes the demand.


class CampaignSettings(Settings):
    """The file of a campaign."""

    title: str = ""  #: What was recorded, and when.
    machine: str = CMF  #: The data sheet: the motion base by name or TOML file.
    cab: str | None = None  #: Its cab, default the first.
    hydraulics: str | None = None  #: The hydraulic set, default the machine's.
    law: str | None = None  #: The law it ran, default the machine's.
    columns: str | None = None  #: Column map of the files, default the facility's.
    electronics: AnyElectronics = ElectronicsSettings()
    """Sensors, converters and servo electronics whose lags are between machine and files."""
    clocks: bool = False
    """Whether demand and measurement were logged by two clocks: offset and skew are then fitted."""
    highest: Annotated[float, Field(gt=0.0)] = 50.0
    """Frequency up to which recordings are explained [Hz], cut at 0.4 of a recording's rate."""
    recordings: Mapping[Name, RecordingSettings] = {}
    unknowns: Mapping[Name, Unknown] = {}  #: Default those of `data_sheet`.
    held: Mapping[Name, Unknown] = {}  #: Not fitted: what they leave open widens predictions.
    evidence: Mapping[Name, EvidenceSettings] = {}
    deviations: Deviations = Deviations()  #: Of what is stated in `evidence`.
    simulated: bool = False  #: Whether what linearisation misses is found by simulation.
    plant: Literal["hexapod", "single_legs"] = "hexapod"


class Recording(NamedTuple):
    """One recording, read."""

    name: str
    settings: RecordingSettings
    record: Record
    law: Law | None  #: None for valve commands.


class Campaign(NamedTuple):
    """A campaign, read."""

    folder: Path
    settings: CampaignSettings
    plant: Plant  #: The data sheet's machine.
    unknowns: Unknowns
    recordings: tuple[Recording, ...]
    evidence: Evidence

    @property
    def sensors(self) -> SensorSettings | None:
        """Those of the data sheet; None where they are ideal."""
        chosen = self.settings.electronics
        return None if chosen is None else chosen.of(self.plant.machine).sensors

    @property
    def law(self) -> Law:
        """The law that the machine ran, as the campaign says, or the machine's."""
        return load_law(beside(self.folder, self.settings.law or self.plant.machine.law))

    def nominal(self, path: str) -> tuple[float, str]:
        """A number of the data sheet by the path of an unknown, and its unit: see `nominal`."""
        return nominal(path, self.plant, self.sensors, self.law)

    def of(self, held_back: bool) -> tuple[Recording, ...]:
        """The recordings that are held back, or those that are fitted."""
        return tuple(one for one in self.recordings if one.settings.held_back == held_back)


def data_sheet(cab: Cab, hydraulics: Any) -> Unknowns:
    """What nobody knows exactly who only has a data sheet.

    The speed of each leg, lags of drives and valves, leakage, bulk modulus, friction, and mass,
    centre of mass and inertia of what is carried, wide about what the data sheet says.
    """
    heavy = "cab" if cab.mass.si >= cab.platform.mass.si else "platform"
    numbers = hydraulics.actuator()
    weight = cab.payload.mass * STANDARD_GRAVITY / 6.0
    reach = 0.1 * float(cab.machine.geometry.upper[:, :2].max())
    wide: dict[str, Any] = {"distribution": "loguniform", "unit": "1"}
    said = {"source": "data sheets are this far from machines"}
    ranges: dict[str, dict[str, Any]] = {
        "leg_speed": {"path": "hydraulics.actuators.*.leg_speed", "deviation": 20.0},
        "drive_lag": {"path": "hydraulics.drive_lag", "low": 0.4, "high": 2.5} | wide,
        "valve_lag": {"path": "hydraulics.valve_lag", "low": 0.4, "high": 2.5} | wide,
        "leak_rate": {"path": "hydraulics.leak_rate", "low": 0.2, "high": 5.0} | wide,
        "bulk_modulus": {"path": "hydraulics.bulk_modulus", "low": 0.4, "high": 2.5} | wide,
        "mass": {"path": f"{heavy}.mass", "deviation": 40.0},
    }
    force = max(0.15 * weight, 3.0 * numbers["coulomb_friction"].si)
    value: dict[str, Any] = {"effect": "value", "low": 0.0, "high": force, "unit": "N"}
    ranges["friction"] = {"path": "hydraulics.friction"} | value
    stuck = {"path": "hydraulics.stiction", "low": 1.0, "high": 2.5, "unit": "1"}
    ranges["stiction"] = value | stuck
    place: dict[str, Any] = {"effect": "offset", "deviation": reach, "unit": "m"}
    moment: dict[str, Any] = {"low": 0.3, "high": 3.0} | wide
    for what, path, how in (
        ("centre", "centre_of_mass", place),
        ("moment", "second_moment", moment),
    ):
        ranges |= {f"{what}_{axis}": {"path": f"{heavy}.{path}.{axis}"} | how for axis in "xyz"}
    return Unknowns({name: validated(Unknown, one | said, name) for name, one in ranges.items()})


def load_campaign(folder: str | Path) -> Campaign:
    """Read a campaign and its recordings: a folder, its file, or a shipped one, see `SHIPPED`.

    Raises `InputError` that names the file, the recording and what is wrong.
    """
    where = _READY / f"{folder}.toml" if str(folder) in SHIPPED else Path(folder)
    path = where / FILE if where.is_dir() else where
    where = path.parent
    table = read_toml(path)
    if "base" in table:
        base = check_name("base", str(table.pop("base")), SHIPPED)
        before, inner = read_toml(_READY / f"{base}.toml"), ("evidence", "deviations")
        changes = {k: merged(before.get(k, {}), table[k], 1) for k in inner if k in table}
        table = before | table | changes
    settings = validated(CampaignSettings, table, str(path))
    with within(path):
        cab = load_cab(beside(where, settings.cab), beside(where, settings.machine))
        hydraulics = hydraulics_of(cab.machine, beside(where, settings.hydraulics))
        plant = make_plant(settings.plant, cab, hydraulics)
        unknowns = Unknowns(settings.unknowns) or data_sheet(cab, hydraulics)
        law = settings.law or cab.machine.law
        every = [*unknowns.items(), *settings.held.items()]
        for i, (name, one) in enumerate(every):
            for other, earlier in every[:i]:
                if name == other or one.path == earlier.path:
                    raise InputError(f"{name}: {one.path}: is unknown or held twice; allowed: once")
        recordings = [
            _recording(where, name, law, settings, cab.machine) for name in settings.recordings
        ]
        known = Unknowns({**unknowns, **settings.held}).on(plant)
        stated = load_evidence(settings.evidence, settings.deviations, law, where, plant, known)
    for name, one in {**unknowns, **settings.held}.items():
        if one.path.startswith(("machine.", "effect.", "model.")):
            allowed = "allowed: hydraulics, cab, platform, payload, legs, law, electronics"
            raise InputError(f"{path}: {name}: {one.path!r} is refused; {allowed}")
        if one.path.startswith("electronics.") and settings.electronics is None:
            said = "electronics are ideal; allowed: a set that has it, such as noisy"
            raise InputError(f"{path}: unknowns.{name}: {one.path}: {said}")
    made = Campaign(where, settings, plant, unknowns.on(plant), tuple(recordings), stated)
    if not (made.of(held_back=False) or any(not one.held_back for one in stated.statements)):
        allowed = "allowed: recordings or evidence, one of them not held back"
        raise InputError(f"{path}: has nothing to fit; {allowed}")
    return made


def _recording(
    folder: Path, name: str, law: str, settings: CampaignSettings, machine: Machine
) -> Recording:
    said = settings.recordings[name]
    with within(f"recordings.{name}"):
        columns = beside(folder, said.columns or settings.columns)
        record = read_mapped(folder / said.file, columns, machine)
        driven = said.kind == "valves"
        given = "valve_command" if driven else "leg_reference"
        for channel in (given, MEASURED[0]):
            if channel not in record.channels:
                raise InputError(f"{said.file}: {channel}: is missing; a {said.kind} needs it")
        for channel in (given, *MEASURED):
            gaps = (~np.isfinite(record.channels.get(channel, np.zeros(1)))).any(axis=-1)
            if gaps.any():
                at = record.time[int(np.argmax(gaps))]
                allowed = "allowed: numbers; let the column map bridge what is short"
                raise InputError(f"{said.file}: {channel}: has none at {at:g} s; {allowed}")
        chosen = None if driven else load_law(beside(folder, said.law or law))
    return Recording(name, said, record, chosen)
