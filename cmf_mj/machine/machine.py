"""A motion base as a file: some thirty numbers, each with value, unit, status and source.

    name = "mine"
    title = "a motion base of six legs"
    hydraulics = "hardware"             # a set of the CMF, or a table of what differs from one
    law = "velocity"                    # by default; a name or a TOML file

    [gimbals]                           # in three pairs on two circles, or `upper` and `lower`
    upper_radius = { value = 1.6, unit = "m", status = "published", source = "data sheet" }

    [legs]                              # strokes from neutral either way, and masses
    [platform]                          # mass, centre of mass, inertia, without cabs
    [cabs.NAME]                         # the same three of a cab, and the station of its crew
    [limits.leg]                        # velocity and acceleration of a leg; others are derived

A machine whose drawn model exists names it as `mjcf`, and so does a cab: geometry, masses and
inertia are then those of the model. Coordinates count from the platform's centroid at neutral, in
the plane of the upper gimbals, x forward, y left, **z up**. Files that a machine names lie beside
it.
"""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from cmf_mj.core.errors import InputError, within
from cmf_mj.core.quantity import Area, Kind, Length, Quantity
from cmf_mj.core.settings import Name, Settings, beside, merged, read_toml, user_file, validated
from cmf_mj.core.units import FASTEST_RATE, HERTZ, INCH, RATE, SLOWEST_RATE
from cmf_mj.machine import models
from cmf_mj.machine.geometry import LENGTH_UNITS, Geometry, Gimbals, make_geometry
from cmf_mj.machine.limits import StatedLimits
from cmf_mj.machine.models import Legs, Mass, Place, RigidBody

_SINGULAR = 1e3
"""Condition number of the Jacobian at neutral, rotations per radius of the gimbals, above which
legs do not hold the platform; 3 to 6 in usual machines."""

_BORE, _ROD = 5.5 * INCH, 3.875 * INCH  #: Diameters of the CMF's bore and rod [m] (section 2.1).


def _check_control_rate(rate: Quantity) -> Quantity:
    hertz = rate.si / HERTZ
    is_whole = abs(hertz - round(hertz)) < 1e-9
    if not (is_whole and SLOWEST_RATE <= round(hertz) <= FASTEST_RATE):
        allowed = f"a whole number from {SLOWEST_RATE} to {FASTEST_RATE} Hz"
        raise InputError(f"{rate} is refused; allowed: {allowed}")
    return rate


_Height = Annotated[Quantity, AfterValidator(Kind(LENGTH_UNITS, signed=True).check)]
_Hertz = Annotated[Quantity, AfterValidator(Kind(("Hz",)).check)]
_Rate = Annotated[_Hertz, AfterValidator(_check_control_rate)]


class LegDesign(Legs):
    """One leg, all six alike; what is left out is that of a homogeneous bar.

    Cylinder and rod are then bars of the retracted length b from gimbal to gimbal, a twentieth of
    it thick: centre at b/2 from their gimbal, inertia m b^2 / 12 across.
    """

    half_stroke: Length  #: Travel from neutral to either end of the cylinder.
    working_stroke: Length  #: Travel from neutral either way that a demand may use.
    cylinder_centre: Length | None = None  #: Centre of mass above the lower gimbal.
    rod_centre: Length | None = None  #: Centre of mass below the upper gimbal.
    accelerometer: Length | None = None  #: Below the upper gimbal; default a tenth of b.

    @model_validator(mode="after")
    def _check_strokes(self) -> "LegDesign":
        if self.working_stroke.si > self.half_stroke.si:
            raise InputError(
                f"working_stroke: {self.working_stroke} must be at most half_stroke, "
                f"{self.half_stroke}"
            )
        return self


class CabDesign(RigidBody):
    """A cab of a machine."""

    station: Place  #: Where the motion is felt: between the heads of the crew.
    mjcf: str | None = None  #: Drawn model that owns these numbers.


class SingleLeg(Settings):
    """Design point of a leg alone; see `plant.single_legs` for what is derived by default."""

    effective_mass: Mass | None = None  #: Inertia that a leg moves.
    static_load: Annotated[Quantity, AfterValidator(Kind(("lbf", "N", "kN")).check)] | None = None
    """Axial load at rest."""


class LegSizes(NamedTuple):
    """What a control law counts with of the legs that it runs on."""

    working_stroke: float  #: Travel from neutral either way that a demand may use [m].
    force_area: float  #: Area that turns a pressure difference into force (Eq 3.7) [m^2].
    cap_area: float  #: Of the piston on the cap's side [m^2].
    rod_area: float  #: Of the piston on the rod's side [m^2].
    cap_share: float  #: Cap area over both together.


class Machine(Settings):
    """A motion base with six legs, as a data sheet describes it; see `load_machine`.

    >>> machine = cmf_mj.load_machine("simona")
    >>> round(machine.geometry.neutral[0].item(), 4), machine.working_stroke
    (2.7061, 0.525)
    """

    name: Name  #: Name of the machine.
    title: str = Field(min_length=1)  #: What it is, in a line.
    mjcf: str | None = None  #: Drawn model that owns geometry and inertia; default generated.
    hydraulics: str | Mapping[str, Any]  #: One of the CMF's sets, or a table with its `base`.
    law: str = "velocity"  #: Control law by default.
    dcu: str = "default"  #: Digital control unit by default.
    control_rate: _Rate | None = None  #: Frames of the control law [Hz]; default 2048.
    gimbals: Gimbals  #: Where the legs are joined.
    legs: LegDesign  #: Strokes and masses of a leg.
    platform: RigidBody  #: Without cabs.
    cabs: Mapping[Name, CabDesign] = Field(min_length=1)  #: By name, the default one first.
    limits: StatedLimits  #: Of platform and legs; see `load_motion_limits`.
    single_leg: SingleLeg = SingleLeg()  #: Design point of a leg alone.
    floor: _Height | None = None  #: Its height; default a tenth of the height below the gimbals.
    force_area: Area | None = None  #: Of pressures in Eq 3.7; default the area on the rod's side.

    def __hash__(self) -> int:
        """By name: machines of one name are compared by `==`."""
        return hash(self.name)

    @model_validator(mode="after")
    def _check_gimbals(self) -> "Machine":
        gimbals = self.geometry
        if not (gimbals.lower[:, 2].min() > gimbals.upper[:, 2].max()):
            raise InputError(
                f"gimbals: lower gimbals reach {-gimbals.lower[:, 2].min():g} m, upper ones "
                f"{-gimbals.upper[:, 2].max():g} m in height; allowed: all lower ones below all "
                "upper ones; z is up"
            )
        half, neutral = self.legs.half_stroke, float(gimbals.neutral.min())
        if neutral - half.si <= 2.0 * half.si:
            raise InputError(
                f"legs.half_stroke: {half} is refused: a retracted leg, {neutral - half.si:.4g} m "
                f"from gimbal to gimbal, must be longer than its stroke, {2.0 * half.si:.4g} m; "
                f"allowed: below {neutral / 3.0:.4g} m, a third of the neutral length"
            )
        lines = (gimbals.upper - gimbals.lower) / gimbals.neutral[:, None]
        arms = gimbals.upper / np.linalg.norm(gimbals.upper[:, :2], axis=1).mean()
        condition = float(np.linalg.cond(np.hstack([lines, np.cross(arms, lines)])))
        if not condition < _SINGULAR:
            raise InputError(
                f"gimbals: the legs do not hold the platform at neutral, condition number "
                f"{condition:.3g}; allowed: below {_SINGULAR:g}; six parallel or concurrent legs, "
                "or pairs above pairs, leave it free to move"
            )
        return self

    @model_validator(mode="after")
    def _check_cabs(self) -> "Machine":
        for name in self.cabs:
            if self.name != models.CMF and name in models.CABS:
                fault = f"is the name of a cab of {models.CMF}"
                raise InputError(f"cabs.{name}: {fault}; allowed: another name")
            for part, body in (("platform", self.platform), (f"cabs.{name}", self.cabs[name])):
                self.check_place(part, body)
        return self

    def check_place(self, part: str, body: RigidBody) -> None:
        """Refuse a `body`, the table `part`, below the floor or farther off than a leg is long.

        Its axes may then be z down, or its unit another.
        """
        field = f"{part}.centre_of_mass" if part else "centre_of_mass"
        height = float(body.centre_of_mass.si[2])
        distance, leg_length = np.linalg.norm(body.centre_of_mass.si), self.geometry.neutral.max()
        if height < self.floor_height:
            raise InputError(
                f"{field}: is {height:g} m above the upper gimbals, below the floor; allowed: at "
                f"least {self.floor_height:g} m, z is up"
            )
        if distance > leg_length:
            raise InputError(
                f"{field}: is {distance:g} m from the origin; allowed: at most {leg_length:.4g} m, "
                "the length of a leg"
            )

    @property
    def geometry(self) -> Geometry:
        """Gimbals and neutral lengths, z down."""
        return _geometry(self.gimbals)

    @property
    def rate(self) -> int:
        """Frames of the control law a second [Hz]."""
        return RATE if self.control_rate is None else round(self.control_rate.si / HERTZ)

    @property
    def frame(self) -> float:
        """Control frame T [s]."""
        return 1.0 / self.rate

    @property
    def working_stroke(self) -> float:
        """Half of the leg travel that the control law works in [m]."""
        return self.legs.working_stroke.si

    @property
    def half_stroke(self) -> float:
        """Mechanical travel of a leg from neutral either way [m]."""
        return self.legs.half_stroke.si

    @property
    def retracted(self) -> float:
        """Shortest leg from gimbal to gimbal [m]."""
        return float(self.geometry.neutral.min()) - self.half_stroke

    @property
    def leg_sizes(self) -> LegSizes:
        """Stroke, and piston areas of the table `hydraulics`, by default the CMF's."""
        table = {} if isinstance(self.hydraulics, str) else self.hydraulics

        def value_of(field: str, default: float) -> float:
            if field not in table:
                return default
            return validated(Quantity, table[field], f"hydraulics.{field}").si

        bore, rod = value_of("bore_diameter", _BORE), value_of("rod_diameter", _ROD)
        cap_rod = (value_of("rods", 1.0) - 1.0) * rod**2  # squared diameter of a rod on that side
        rod_area = 0.25 * np.pi * (bore**2 - rod**2)
        return LegSizes(
            working_stroke=self.working_stroke,
            force_area=rod_area if self.force_area is None else self.force_area.si,
            cap_area=0.25 * np.pi * (bore**2 - cap_rod),
            rod_area=rod_area,
            cap_share=(bore**2 - cap_rod) / (2.0 * bore**2 - rod**2 - cap_rod),
        )

    @property
    def accelerometer_distance(self) -> float:
        """Distance of the legs' accelerometers below the upper gimbals [m]."""
        distance = self.legs.accelerometer
        return 0.1 * self.retracted if distance is None else distance.si

    @property
    def floor_height(self) -> float:
        """Height of the floor over the platform's centroid at neutral [m], z up."""
        if self.floor is not None:
            return self.floor.si
        return -1.1 * float(self.geometry.lower[:, 2].max())

    @property
    def shipped(self) -> bool:
        """Whether it has the name of a shipped machine."""
        return self.name in models.machine_names()

    def recorded(self) -> dict[str, Any]:
        """Its numbers as a record keeps them; empty for a shipped one."""
        return {} if self.shipped else self.model_dump(mode="json", exclude_none=True)

    def metadata(self) -> dict[str, Any]:
        """Metadata of a recording on it: its name, and its numbers where it is not shipped."""
        parameters = self.recorded()
        return {"machine": self.name} | ({"machine_parameters": parameters} if parameters else {})


@lru_cache
def _geometry(gimbals: Gimbals) -> Geometry:
    return make_geometry(*gimbals.in_report_axes())


def load_machine(source: str | Path | Machine = models.CMF) -> Machine:
    """Load a machine; `source` is a shipped one's name, or a TOML file as heads this module.

    Another machine under a shipped one's name is refused.

    >>> cmf_mj.load_machine("cmf").legs.half_stroke.si
    0.9652
    """
    if isinstance(source, Machine):
        return source
    if str(source) in models.machine_names():
        return _shipped(str(source))
    path = user_file("machine", models.machine_names(), source)
    machine = read_machine(path)
    if machine.shipped:
        raise InputError(
            f"{path}: name: {machine.name!r} is the name of a shipped machine; another one needs "
            "another name"
        )
    return machine


@lru_cache
def _shipped(name: str) -> Machine:
    return read_machine(models.directory() / "machines" / f"{name}.toml")


def read_machine(path: Path) -> Machine:
    """The machine of a file, with the numbers that its models own."""
    table = read_toml(path)
    folder = path.parent.resolve()
    with within(path):
        for field in ("mjcf", "law", "dcu"):
            table |= _file_beside(folder, table, field)
        if isinstance(table.get("mjcf"), str):
            table = merged(models.machine_tables(Path(table["mjcf"])), table)
        cabs = table.get("cabs")
        if isinstance(cabs, Mapping):
            table["cabs"] = cabs = dict(cabs)
            for name, cab in cabs.items():
                if isinstance(cab, Mapping) and isinstance(cab.get("mjcf"), str):
                    cab = dict(cab) | _file_beside(folder, cab, "mjcf")
                    cabs[name] = merged(models.cab_table(Path(cab["mjcf"])), cab)
    return validated(Machine, table, str(path))


def _file_beside(folder: Path, table: Mapping[str, Any], field: str) -> dict[str, Any]:
    """A field that names a file, with its folder."""
    value = table.get(field)
    if isinstance(value, str) and value.endswith(".xml"):
        return {field: str((folder / value).resolve())}
    return {field: str(beside(folder, value))} if isinstance(value, str) else {}


def recorded_machine(metadata: Mapping[str, Any]) -> Machine:
    """The machine that the metadata of a record tell of; the CMF where they tell of none."""
    name = str(metadata.get("machine") or models.CMF)
    parameters = metadata.get("machine_parameters")
    if name in models.machine_names() or not parameters:
        return load_machine(name)
    return validated(Machine, parameters, "machine_parameters")


def geometry_of(machine: "str | Path | Machine | Geometry") -> Geometry:
    """The gimbals of a machine, or what are gimbals already."""
    return machine if isinstance(machine, Geometry) else load_machine(machine).geometry
