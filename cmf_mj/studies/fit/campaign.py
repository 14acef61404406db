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

    [unknowns.mass]                     # what is not known, see `default_unknowns`
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
    unknowns: Mapping[Name, Unknown] = {}  #: Else `default_unknowns`.
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
        electronics = self.settings.electronics
        return None if electronics is None else electronics.of(self.plant.machine).sensors

    @property
    def law(self) -> Law:
        """The law that the machine ran, as the campaign says, or the machine's."""
        return load_law(beside(self.folder, self.settings.law or self.plant.machine.law))

    def nominal(self, path: str) -> tuple[float, str]:
        """A number of the data sheet by the path of an unknown, and its unit: see `nominal`."""
        return nominal(path, self.plant, self.sensors, self.law)

    def recordings_where(self, held_back: bool) -> tuple[Recording, ...]:
        """The recordings that are held back, or those that are fitted."""
        return tuple(each for each in self.recordings if each.settings.held_back == held_back)


def default_unknowns(cab: Cab, hydraulics: Any) -> Unknowns:
    """Unknown numbers of a machine of which only the data sheet is known.

    The speed of each leg, lags of drives and valves, leakage, bulk modulus, friction, and mass,
    centre of mass and inertia of what is carried, in wide ranges about the data sheet's.
    """
    unknowns = Unknowns()

    def add(name: str, path: str, **distribution: Any) -> None:
        table = {"path": path, "source": "data sheets are this far from machines"} | distribution
        unknowns[name] = validated(Unknown, table, name)

    def add_factor(name: str, path: str, low: float, high: float) -> None:
        add(name, path, low=low, high=high, distribution="loguniform", unit="1")

    add("leg_speed", "hydraulics.actuators.*.leg_speed", deviation=20.0)
    add_factor("drive_lag", "hydraulics.drive_lag", 0.4, 2.5)
    add_factor("valve_lag", "hydraulics.valve_lag", 0.4, 2.5)
    add_factor("leak_rate", "hydraulics.leak_rate", 0.2, 5.0)
    add_factor("bulk_modulus", "hydraulics.bulk_modulus", 0.4, 2.5)
    body = "cab" if cab.mass.si >= cab.platform.mass.si else "platform"
    add("mass", f"{body}.mass", deviation=40.0)
    leg_load = cab.payload.mass * STANDARD_GRAVITY / 6.0
    largest = max(0.15 * leg_load, 3.0 * hydraulics.actuator()["coulomb_friction"].si)
    add("friction", "hydraulics.friction", effect="value", low=0.0, high=largest, unit="N")
    add("stiction", "hydraulics.stiction", effect="value", low=1.0, high=2.5, unit="1")
    reach = 0.1 * float(cab.machine.geometry.upper[:, :2].max())
    for axis in "xyz":
        path = f"{body}.centre_of_mass.{axis}"
        add(f"centre_{axis}", path, effect="offset", deviation=reach, unit="m")
    for axis in "xyz":
        add_factor(f"moment_{axis}", f"{body}.second_moment.{axis}", 0.3, 3.0)
    return unknowns


def load_campaign(folder: str | Path) -> Campaign:
    """Read a campaign and its recordings: a folder, its file, or a shipped one, see `SHIPPED`.

    Raises `InputError` that names the file, the recording and what is wrong.
    """
    source = _READY / f"{folder}.toml" if str(folder) in SHIPPED else Path(folder)
    file = source / FILE if source.is_dir() else source
    home = file.parent
    settings = _read_settings(file)
    with within(file):
        cab = load_cab(beside(home, settings.cab), beside(home, settings.machine))
        hydraulics = hydraulics_of(cab.machine, beside(home, settings.hydraulics))
        plant = make_plant(settings.plant, cab, hydraulics)
        unknowns = Unknowns(settings.unknowns) or default_unknowns(cab, hydraulics)
        _check_unknowns(unknowns, settings)
        law_name = settings.law or cab.machine.law
        recordings = tuple(
            _read_recording(home, name, law_name, settings, cab.machine)
            for name in settings.recordings
        )
        all_unknowns = Unknowns({**unknowns, **settings.held}).on(plant)
        evidence = load_evidence(
            settings.evidence, settings.deviations, law_name, home, plant, all_unknowns
        )
        campaign = Campaign(home, settings, plant, unknowns.on(plant), recordings, evidence)
        fitted_numbers = [number for number in evidence.statements if not number.held_back]
        if not campaign.recordings_where(held_back=False) and not fitted_numbers:
            allowed = "allowed: recordings or evidence, one of them not held back"
            raise InputError(f"has nothing to fit; {allowed}")
    return campaign


def _read_settings(path: Path) -> CampaignSettings:
    """The file of a campaign, with what it takes from its `base`."""
    table = read_toml(path)
    if "base" in table:
        name = check_name("base", str(table.pop("base")), SHIPPED)
        base = read_toml(_READY / f"{name}.toml")
        for key in {"evidence", "deviations"} & table.keys():
            table[key] = merged(base.get(key, {}), table[key], 1)
        table = base | table
    return validated(CampaignSettings, table, str(path))


def _check_unknowns(unknowns: Unknowns, settings: CampaignSettings) -> None:
    """Refuse a name or a path that stands twice, and numbers that a fit cannot change."""
    names, paths = set[str](), set[str]()
    for name, unknown in (*unknowns.items(), *settings.held.items()):
        if name in names or unknown.path in paths:
            raise InputError(f"{name}: {unknown.path}: is unknown or held twice; allowed: once")
        names.add(name)
        paths.add(unknown.path)
        if unknown.path.startswith(("machine.", "effect.", "model.")):
            allowed = "allowed: hydraulics, cab, platform, payload, legs, law, electronics"
            raise InputError(f"{name}: {unknown.path!r} is refused; {allowed}")
        if unknown.path.startswith("electronics.") and settings.electronics is None:
            allowed = "allowed: a set that has it, such as noisy"
            raise InputError(f"unknowns.{name}: {unknown.path}: electronics are ideal; {allowed}")


def _read_recording(
    folder: Path, name: str, law_name: str, campaign: CampaignSettings, machine: Machine
) -> Recording:
    settings = campaign.recordings[name]
    file, is_valves = settings.file, settings.kind == "valves"
    with within(f"recordings.{name}"):
        columns = beside(folder, settings.columns or campaign.columns)
        record = read_mapped(folder / file, columns, machine)
        command = "valve_command" if is_valves else "leg_reference"
        for channel in (command, "leg_position"):
            if channel not in record.channels:
                raise InputError(f"{file}: {channel}: is missing; a {settings.kind} needs it")
        for channel in (command, *MEASURED):
            gaps = (~np.isfinite(record.channels.get(channel, np.zeros(1)))).any(axis=-1)
            if gaps.any():
                first_gap = record.time[int(np.argmax(gaps))]
                allowed = "allowed: numbers; let the column map bridge what is short"
                raise InputError(f"{file}: {channel}: has none at {first_gap:g} s; {allowed}")
        law = None if is_valves else load_law(beside(folder, settings.law or law_name))
    return Recording(name, settings, record, law)
