"""Study specifications, a TOML file in, a table of cases out; and the ladder of plants they name.

    title = "My laws, three cabs, a hundred machines"
    method = "linear"                  # or sweep, see `evaluation`
    laws = ["velocity", "my_law.toml"]
    cabs = ["gfd", "rfd", "ifd"]
    draws = 100                        # machines with mismatch, and the nominal one

A file may begin with `base = "mismatch"`, the name of a shipped specification, and repeat only what
it changes. The cases are the product of rungs, cabs, poses, draws, laws and degrees of freedom, in
this order.

The ladder from a single leg to the whole machine: each rung adds one effect.

    single_legs       six legs of 7200 lbm under 7200 lbf, constant supply, no command delay
    point_mass        the hexapod's geometry; payload a point mass at the platform centroid
    payload_inertia   the payload's inertia about its centre of mass, that still at the centroid
    centre_of_mass    the centre of mass at its height and place
    leg_inertia       cylinders and rods with their masses
    supply            pump, accumulators, manifolds and hoses instead of a constant pressure
    friction          Coulomb, breakaway and viscous friction of the `lossy` set
    electronics       noisy sensors, converters, servo electronics
    delay             one frame from the control law to the valves

With J = d(legs)/d(pose) and the payload's mass matrix M, which is diag(m, m, m, 0, 0, 0) of a
point mass, the reflected mass is M_leg = J^-T M J^-1 on every rung without leg inertia. A point
mass leaves the rotations without inertia; they follow the forces at once and compliances add:

    omega_x^2 = 1 / (m sum_i (J^-1)_xi^2 / k_i)

What MuJoCo cannot integrate at 2048 Hz is not zero but small: `SMALL_SHARE` of the payload's
inertia tensor (rotational modes near 100 Hz) and of the legs' inertia (their pins then gape by 3
micrometres, a tenth of that mass by 35).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.settings import Settings, check_distinct, read_toml, user_file, validated
from cmf_mj.facility.unknown import Unknown
from cmf_mj.machine.cab import Cab, load_cab, load_cabs
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.machine.machine import load_machine
from cmf_mj.machine.models import CMF
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, hydraulics_of, load_hydraulics
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.studies.case import Case, dof_amplitude

SMALL_SHARE = 0.01  #: Share of an inertia that is left where there should be none.

_FRICTION_FIELDS = ("coulomb_friction", "breakaway_friction", "viscous_friction")


def lump_cab(
    cab: Cab,
    *,
    inertia: float = 1.0,
    centre_of_mass: bool = True,
    leg_mass_factor: float = SMALL_SHARE,
) -> Cab:
    """Make a cab's payload one rigid body; control laws take the result for the cab as it was.

    `inertia` is a factor on the payload's tensor about its centre of mass, which without
    `centre_of_mass` lies in the platform's centroid; `leg_mass_factor` one on cylinders and rods.
    """
    payload = cab.payload
    centre = payload.centre if centre_of_mass else np.zeros(3)

    def lump(mass: float) -> dict[str, Any]:
        tensor = inertia * mass / payload.mass * payload.inertia
        return {"mass": mass, "centre_of_mass": centre, "inertia": tensor}

    return cab.changed(
        f"{cab.name}, lumped",
        platform=lump(cab.platform.mass.si),
        leg_mass_factor=leg_mass_factor,
        nominal=cab.assumed,
        **lump(cab.mass.si),
    )


@dataclass(frozen=True)
class Rung:
    """One plant and what stands between it and the law."""

    name: str
    effects: tuple[str, ...]  #: Some of `EFFECTS`.

    @property
    def is_linear(self) -> bool:
        """Whether a linearisation of it exists."""
        return "delay" in self.effects and not _NOT_LINEAR & set(self.effects)

    def hydraulics(self, base: HydraulicParameters) -> HydraulicParameters:
        """The hydraulic set of the rung."""
        changes: dict[str, object] = {} if "supply" in self.effects else {"supply": "constant"}
        if "friction" in self.effects:
            lossy = load_hydraulics("lossy")
            changes |= {name: getattr(lossy, name) for name in _FRICTION_FIELDS}
        return base.model_copy(update=changes)

    def build(self, cab: str | Path | Cab, hydraulics: HydraulicParameters) -> Plant:
        """The plant of the rung with a cab and a hydraulic set."""
        loaded_cab, parameters = load_cab(cab), self.hydraulics(hydraulics)
        if "point_mass" not in self.effects:
            return SingleLegs(parameters, machine=loaded_cab.machine)
        if "leg_inertia" in self.effects:
            return Hexapod(loaded_cab, parameters)
        inertia = 1.0 if "payload_inertia" in self.effects else SMALL_SHARE
        centre = "centre_of_mass" in self.effects
        return Hexapod(lump_cab(loaded_cab, inertia=inertia, centre_of_mass=centre), parameters)


EFFECTS = (
    *("single_legs", "point_mass", "payload_inertia", "centre_of_mass", "leg_inertia"),
    *("supply", "friction", "electronics", "delay"),
)
"""What each rung adds to the one before, which is also its name."""

LADDER = tuple(Rung(name, EFFECTS[: i + 1]) for i, name in enumerate(EFFECTS))
"""All rungs, in the order of climbing."""

_NOT_LINEAR = {"friction", "electronics"}  #: Effects that have no linearisation.
MACHINE_RUNG = Rung("machine", tuple(name for name in EFFECTS if name not in _NOT_LINEAR))
"""The hexapod as `cmf compare` runs it: ideal sensors, no friction, one frame of delay."""


def rung_named(name: str) -> Rung:
    """A rung of the ladder, or `machine`."""
    rungs = {rung.name: rung for rung in (*LADDER, MACHINE_RUNG)}
    return rungs[check_name("rungs", name, rungs)]


Method = Literal["sweep", "linear"]  #: How a case is measured, see `evaluation`.

NOMINAL = -1  #: Draw of the machine without mismatch.

_READY = Path(__file__).with_name("ready")
STUDIES = tuple(sorted(path.stem for path in _READY.glob("*.toml")))  #: Shipped specifications.


class StudySettings(Settings):
    """What a study runs."""

    title: Annotated[str, Field(min_length=1)]
    method: Method
    laws: Annotated[list[str], Field(min_length=1)]
    """Names, TOML files, or one of several laws of a file, file.toml:name."""
    cabs: list[str] = []  #: Names or TOML files, `all` alone; default the machine's first.
    dofs: Annotated[list[str], Field(min_length=1)] = list(DOFS)
    """Degrees of freedom, each a case of a `sweep`; `linear` gives all at once."""
    rungs: Annotated[list[str], Field(min_length=1)] = ["machine"]  #: Of the ladder, or `machine`.
    poses: Annotated[list[list[float]], Field(min_length=1)] = [[0.0] * 6]
    """Poses [in, deg], z down, that the motion is about."""
    machine: str = CMF  #: Motion base by name or TOML file.
    hydraulics: str | None = None  #: Set by name or TOML file; default the machine's.
    amplitude: Annotated[float, Field(gt=0.0, le=20.0)] = 0.33
    """Of sweeps in translation [in]; rotations and steps in the report's proportions."""
    quick: bool = True  #: Sweep in 30 s instead of 100 s.
    seed: Annotated[int, Field(ge=0)] = 0  #: Of the machines drawn and of sensor noise.
    draws: Annotated[int, Field(ge=0)] = 0  #: Machines with mismatch, and the nominal one.
    mismatch: dict[str, Unknown] = {}  #: What scatters from draw to draw, see `Unknowns`.


@dataclass(frozen=True)
class StudyCase:
    """One line of the table of cases; everything needed to run it anywhere."""

    number: int
    rung: str
    draw: int
    case: Case  #: On the shipped plant; its degree of freedom is empty for all.
    settings: StudySettings

    @property
    def columns(self) -> dict[str, int | str | float]:
        """The case in the table of results."""
        case = self.case
        head = {"case": self.number, "method": self.settings.method, "rung": self.rung}
        pose = {f"pose_{dof}": value for dof, value in zip(DOFS, case.pose, strict=True)}
        return head | {"cab": case.cab_name} | pose | {"draw": self.draw, "law": case.law.name}


@dataclass(frozen=True)
class Study:
    """A study with everything it refers to loaded."""

    settings: StudySettings
    laws: tuple[Law, ...]
    cabs: tuple[Cab, ...]
    hydraulics: HydraulicParameters

    @property
    def cases(self) -> list[StudyCase]:
        """All cases, numbered from 0."""
        settings, translation = self.settings, self.settings.amplitude * units.INCH
        dofs = settings.dofs if settings.method == "sweep" else [""]
        cases, draws = list[StudyCase](), range(NOMINAL, settings.draws)
        for rung, cab, pose, draw in product(settings.rungs, self.cabs, settings.poses, draws):
            si_pose = tuple(units.to_si(dof_unit(i), value) for i, value in enumerate(pose))
            options: dict[str, Any] = {"quick": settings.quick, "pose": si_pose}
            for law, dof in product(self.laws, dofs):
                amplitude = dof_amplitude(dof, translation) if dof else None
                case = Case("hexapod", cab, self.hydraulics, law, dof, amplitude, **options)
                cases.append(StudyCase(len(cases), rung, draw, case, settings))
        return cases

    def identity(self) -> dict[str, Any]:
        """What the study runs, as JSON values, see `engine.Journal`."""
        return {
            "settings": self.settings.model_dump(mode="json"),
            "laws": [law.model_dump(mode="json") for law in self.laws],
            "cabs": [cab.model_dump(mode="json", exclude_none=True) for cab in self.cabs],
            "machine": self.cabs[0].machine.recorded(),
            "hydraulics": self.hydraulics.model_dump(mode="json", exclude_none=True),
        }


def load_study(
    source: str | Path | dict[str, Any],
    *,
    laws: Sequence[str | Law] | None = None,
    changes: dict[str, Any] | None = None,
) -> Study:
    """Load a study.

    `source` is the name of a shipped specification, a TOML file or a table; `laws` stand in for its
    laws, `changes` replace its fields.
    """
    table, origin = study_table(source)
    table |= changes or {}
    with within(origin):
        machine = load_machine(table.get("machine", CMF))
        own_laws = tuple(load_law(law, machine) for law in laws or ())
        if laws is not None:
            table["laws"] = [law.name for law in own_laws]
        settings = validated(StudySettings, table, origin)
        _check_settings(settings)
        loaded_laws = own_laws or tuple(load_law(law, machine) for law in settings.laws)
        cabs = load_cabs(settings.cabs, machine)
        check_distinct("laws", [law.name for law in loaded_laws])
        check_distinct("cabs", [cab.name for cab in cabs])
        return Study(settings, loaded_laws, cabs, hydraulics_of(machine, settings.hydraulics))


def study_table(source: str | Path | dict[str, Any]) -> tuple[dict[str, Any], str]:
    """The table of a specification with that of its base, and what errors call it."""
    if isinstance(source, dict):
        origin, table = "study", dict(source)
    else:
        origin, shipped = str(source), _READY / f"{source}.toml"
        is_shipped = origin in STUDIES
        table = read_toml(shipped if is_shipped else user_file("study", STUDIES, source))
    while "base" in table:
        base = check_name(f"{origin}: base", str(table.pop("base")), STUDIES)
        table = read_toml(_READY / f"{base}.toml") | table
    return table, origin


def _check_settings(settings: StudySettings) -> None:
    for dof in settings.dofs:
        check_name("dofs", dof, DOFS)
    for pose in settings.poses:
        if len(pose) != 6:
            raise InputError(f"poses: {pose} must be six numbers, in and deg")
    is_linear = settings.method == "linear"
    for name, unknown in settings.mismatch.items():
        path = unknown.path
        if path.startswith("machine."):
            raise InputError(f"mismatch.{name}: {path}: a study varies all but the machine")
        is_electronic = path.startswith("electronics.") and not path.endswith(".gain_errors.*")
        if is_electronic and is_linear:
            raise InputError(f"mismatch.{name}: {path}: needs the method sweep")
    if settings.draws and not settings.mismatch:
        raise InputError(f"draws: {settings.draws} machines are alike without [mismatch]")
    for name in settings.rungs:
        if is_linear and not rung_named(name).is_linear:
            raise InputError(
                f"rungs: {name!r} has no linearisation; friction, electronics and a delay of 0 "
                "frames need the method sweep"
            )
