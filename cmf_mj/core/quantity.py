"""Numbers with unit, status and source, and the range each kind of number may take."""

from collections.abc import Mapping
from typing import Annotated, Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic.fields import FieldInfo

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Table
from cmf_mj.core.settings import Settings, as_tuples
from cmf_mj.core.units import LONGEST

ValueT = TypeVar("ValueT")

Status = Literal[
    "stated", "derived", "calibrated", "identified", "assumed", "published", "recalled"
]
"""How a number is known: `identified` from recordings of the machine, `published` by another source
than the report, `recalled` from general knowledge of the field and not checked."""


class _Sourced(Settings, Generic[ValueT]):
    """A value as a source gives it, in its unit."""

    value: ValueT  #: Value in `unit`.
    unit: str  #: Unit as published, e.g. `in/s/%`.
    status: Status  #: How the number is known.
    source: str = Field(min_length=1)  #: Where it comes from, or why it was chosen.

    @model_validator(mode="before")
    @classmethod
    def _check_table(cls, table: Any) -> Any:
        if not isinstance(table, _Sourced | Mapping):
            raise InputError("must be a table of value, unit, status and source")
        return table


class Quantity(_Sourced[float]):
    """One number as a source gives it."""

    @property
    def si(self) -> float:
        """The value in SI."""
        return units.to_si(self.unit, self.value)

    def __str__(self) -> str:
        """Value and unit."""
        return f"{self.value:g} {self.unit}"


def quantity_table(title: str, quantities: Mapping[str, Quantity]) -> Table:
    """Value, unit, status and source of every number."""
    columns = ("parameter", ("value", "g"), "unit", "status", "source")
    rows = [(name, q.value, q.unit, q.status, q.source) for name, q in quantities.items()]
    return Table(title, columns, rows)


class Quantities(_Sourced[Annotated[tuple[float, ...], BeforeValidator(as_tuples)]]):
    """Several numbers of one unit as a source gives them."""

    @property
    def si(self) -> NDArray[np.float64]:
        """The values in SI."""
        return units.to_si(self.unit, np.array(self.value))


_Point = tuple[float, float, float]


class Points(_Sourced[Annotated[tuple[_Point, ...], BeforeValidator(as_tuples)]]):
    """Points in space of one unit as a source gives them."""

    @property
    def si(self) -> NDArray[np.float64]:
        """The points in SI, (n, 3)."""
        return units.to_si(self.unit, np.array(self.value))


def positive_in(*allowed: str) -> AfterValidator:
    """Validator of an `Annotated` quantity greater than 0 in one of the units `allowed`."""
    return AfterValidator(Kind(allowed).check)


_LARGEST_SIZE = {
    **{"s": LONGEST, "m": 1e3, "m/s": 1e3, "m^2": 10.0, "m^3": 1e4, "m^3/s": 1e2},
    **{"kg": 1e7, "N": 1e8, "Pa": 1e12, "N s/m": 1e12, "kg/m^3": 1e5},
}
"""Largest size by unit in SI: ten to a thousand times that of the largest machines moved by oil,
1e5 bar of bulk modulus and a run of twelve days included."""


class Kind(NamedTuple):
    """What a quantity may be: in size at most what a machine can have, by its unit in SI."""

    units: tuple[str, ...]  #: Units it may be given in.
    signed: bool = False  #: Any sign.
    zero: bool = False  #: Zero is allowed, and switches the effect off.
    below: float = float("inf")  #: Upper bound of the SI value, excluded.
    at_most: float = float("inf")  #: Upper bound of the SI value.

    def check(self, quantity: Quantity) -> Quantity:
        """The quantity, if it has the right dimension and lies in range."""
        unit = quantity.unit
        if unit not in self.units:
            raise InputError(f"{unit!r} is refused: unit must be one of {', '.join(self.units)}")
        refusal = f"{quantity.value} {unit} is refused: must be"
        if not self.signed and self.zero and quantity.value < 0.0:
            raise InputError(f"{refusal} at least 0 {unit}")
        if not self.signed and not self.zero and quantity.value <= 0.0:
            raise InputError(f"{refusal} greater than 0 {unit}")
        size = abs(quantity.si)
        if size >= self.below:
            raise InputError(f"{refusal} less than {units.from_si(unit, self.below):g} {unit}")
        bounds = (_LARGEST_SIZE.get(name, self.at_most) for name in self.units)
        largest = min(self.at_most, *bounds)
        if size > largest:
            raise InputError(f"{refusal} at most {units.from_si(unit, largest):g} {unit}")
        return quantity


def _check_one_or_two(quantity: Quantity) -> Quantity:
    if quantity.value not in (1.0, 2.0):
        raise InputError(f"{quantity.value:g} is refused: must be 1 or 2")
    return quantity


_LENGTH, _PRESSURE = ("in", "m", "mm"), ("psi", "Pa", "bar")
_FORCE, _VOLUME, _FLOW = ("lbf", "N", "kN"), ("gal", "m^3", "l"), ("gpm", "m^3/s", "l/min", "lpm")
_CONDUCTANCE = ("gpm/psi", "m^3/s/Pa", "lpm/bar")
_RESISTANCE = ("psi/gpm", "Pa s/m^3", "bar/lpm")

Length = Annotated[Quantity, AfterValidator(Kind(_LENGTH).check)]
Travel = Annotated[Quantity, AfterValidator(Kind(_LENGTH, zero=True).check)]
Area = Annotated[Quantity, AfterValidator(Kind(("in^2", "m^2")).check)]
Pressure = Annotated[Quantity, AfterValidator(Kind(_PRESSURE).check)]
Gauge = Annotated[Quantity, AfterValidator(Kind(_PRESSURE, zero=True).check)]
Corner = Annotated[Quantity, AfterValidator(Kind(("Hz", "rad/s")).check)]
LegSpeed = Annotated[Quantity, AfterValidator(Kind(("in/s/%", "m/s/%", "mm/s/%")).check)]
Speed = Annotated[Quantity, AfterValidator(Kind(("in/s", "m/s", "mm/s")).check)]
Rate = Annotated[Quantity, AfterValidator(Kind(("1/s",), zero=True).check)]
Acceleration = Annotated[
    Quantity, AfterValidator(Kind(("g", "m/s^2", "in/s^2", "m/s/s", "in/s/s")).check)
]
Angle = Annotated[Quantity, AfterValidator(Kind(("deg", "rad")).check)]
AngularSpeed = Annotated[Quantity, AfterValidator(Kind(("deg/s", "rad/s")).check)]
AngularAcceleration = Annotated[Quantity, AfterValidator(Kind(("deg/s^2", "rad/s^2")).check)]
Time = Annotated[Quantity, AfterValidator(Kind(("s",)).check)]
Wait = Annotated[Quantity, AfterValidator(Kind(("s",), zero=True).check)]
Voltage = Annotated[Quantity, AfterValidator(Kind(("V",)).check)]
Force = Annotated[Quantity, AfterValidator(Kind(_FORCE, zero=True).check)]
Viscous = Annotated[Quantity, AfterValidator(Kind(("lbf s/in", "N s/m"), zero=True).check)]
Volume = Annotated[Quantity, AfterValidator(Kind(_VOLUME).check)]
DeadVolume = Annotated[Quantity, AfterValidator(Kind(_VOLUME, zero=True).check)]
Flow = Annotated[Quantity, AfterValidator(Kind(_FLOW).check)]
Conductance = Annotated[Quantity, AfterValidator(Kind(_CONDUCTANCE, zero=True).check)]
Resistance = Annotated[Quantity, AfterValidator(Kind(_RESISTANCE).check)]
Line = Annotated[Quantity, AfterValidator(Kind(_RESISTANCE, zero=True).check)]
Ratio = Annotated[Quantity, AfterValidator(Kind(("1",)).check)]
Share = Annotated[Quantity, AfterValidator(Kind(("1", "%"), zero=True, below=1.0).check)]
Bias = Annotated[Quantity, AfterValidator(Kind(("1", "%"), signed=True, below=1.0).check)]
Opening = Annotated[Quantity, AfterValidator(Kind(("1", "%"), at_most=1.0).check)]
Exponent = Annotated[Quantity, AfterValidator(Kind(("1",), at_most=1.67).check)]
Count = Annotated[Quantity, AfterValidator(Kind(("1",), zero=True).check)]
OneOrTwo = Annotated[Count, AfterValidator(_check_one_or_two)]
Density = Annotated[Quantity, AfterValidator(Kind(("kg/m^3",)).check)]


def optional(field: FieldInfo) -> Any:
    """The annotation of a field, its range check included, or None."""
    return Annotated[field.annotation, *field.metadata] | None
