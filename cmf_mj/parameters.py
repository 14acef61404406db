"""Immutable hydraulic parameter sets: each number with its unit, status and source.

The numbers live in `hydraulics.toml`; this module names them, checks them and derives from them.
Two sets are shipped: `report` (the report's non-linear model) and `hardware` (the machine as
flown). Symbols: Ac, Ar cap and rod area, h half stroke, beta effective bulk modulus, Ps supply
pressure.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from cmf_mj import units
from cmf_mj.settings import Settings, read_toml, validated

HYDRAULICS = ("report", "hardware")
"""Names of the shipped parameter sets."""

_FILE = Path(__file__).with_name("hydraulics.toml")


class Quantity(Settings):
    """One number as a source gives it."""

    value: float
    """Value in `unit`."""
    unit: str
    """Unit as published, e.g. `in/s/%`."""
    status: Literal["stated", "derived", "calibrated", "assumed"]
    """How the number is known."""
    source: str = Field(min_length=1)
    """Where it comes from, or why it was chosen."""

    @field_validator("unit")
    @classmethod
    def _known(cls, unit: str) -> str:
        units.factor(unit)
        return unit

    @property
    def si(self) -> float:
        """The value in SI."""
        return units.to_si(self.unit, self.value)


def positive_in(*allowed: str) -> AfterValidator:
    """Validator of an `Annotated` quantity greater than 0 in one of the units `allowed`."""

    def check(quantity: Quantity) -> Quantity:
        if quantity.unit not in allowed:
            raise ValueError(f"unit must be one of {', '.join(allowed)}")
        if quantity.value <= 0.0:
            raise ValueError(f"must be greater than 0 {quantity.unit}")
        return quantity

    return AfterValidator(check)


class HydraulicParameters(Settings):
    """Parameters of one actuator with its valve, and of the supply."""

    name: str
    """Name of the set."""
    bore_diameter: Quantity
    """Diameter of the cylinder bore."""
    rod_diameter: Quantity
    """Diameter of the rod; smaller than the bore."""
    half_stroke: Quantity
    """Half of the mechanical stroke, the chamber lengths at neutral."""
    minimum_gap: Quantity
    """Chamber length below which its volume is held constant."""
    bulk_modulus: Quantity
    """Effective bulk modulus: the lumped compliance of oil, hoses and barrel."""
    drive_lag: Quantity
    """Corner of the servo drive's first-order lag."""
    valve_lag: Quantity
    """Corner of the spool's first-order lag."""
    supply_pressure: Quantity
    """Constant supply pressure, gauge."""
    return_pressure: Quantity
    """Constant return pressure, gauge."""
    transition_pressure: Quantity
    """Pressure difference at which orifice flow turns from laminar to turbulent."""
    leg_speed: Quantity
    """Steady leg speed per command with half the supply pressure across each port."""
    leak_rate: Quantity
    """Rate lambda at which piston leakage relaxes a force built up by displacing the leg at
    neutral; the leg mode of frequency w has the damping ratio lambda / (2 w)."""

    @field_validator("*")
    @classmethod
    def _in_range(cls, quantity: Any, info: ValidationInfo) -> Any:
        field = str(info.field_name)
        if field == "name":
            return quantity
        if quantity.unit not in _UNITS[field]:
            raise ValueError(f"unit must be one of {', '.join(_UNITS[field])}")
        if field in ("return_pressure", "leak_rate"):
            if quantity.value < 0.0:
                raise ValueError(f"must be at least 0 {quantity.unit}")
        elif quantity.value <= 0.0:
            raise ValueError(f"must be greater than 0 {quantity.unit}")
        return quantity

    @model_validator(mode="after")
    def _consistent(self) -> "HydraulicParameters":
        for small, large in (
            ("rod_diameter", "bore_diameter"),
            ("minimum_gap", "half_stroke"),
            ("return_pressure", "supply_pressure"),
        ):
            less, more = getattr(self, small), getattr(self, large)
            if less.si >= more.si:
                raise ValueError(
                    f"{small}: {less.value:g} {less.unit} must be less than {large}, "
                    f"{more.value:g} {more.unit}"
                )
        return self

    @property
    def cap_area(self) -> float:
        """Ac, area of the piston on the cap side [m^2]."""
        return np.pi / 4.0 * self.bore_diameter.si**2

    @property
    def rod_area(self) -> float:
        """Ar, annulus on the rod side [m^2]."""
        return np.pi / 4.0 * (self.bore_diameter.si**2 - self.rod_diameter.si**2)

    @property
    def speed_gain(self) -> float:
        """Gain k of leg speed = k u sqrt(dp) [m/s/sqrt(Pa)]: leg_speed at dp = (Ps - Pt) / 2."""
        half_drop = 0.5 * (self.supply_pressure.si - self.return_pressure.si)
        return self.leg_speed.si / float(np.sqrt(half_drop))

    @property
    def leakage(self) -> float:
        """Laminar piston leakage L [m^3/s/Pa], flow = L (p_cap - p_rod).

        A force built up by displacing the leg at neutral begins to relax at the rate
        4 beta L / (h (Ac + Ar)), which is `leak_rate` and damps the leg mode.
        """
        area = self.cap_area + self.rod_area
        return self.leak_rate.si * self.half_stroke.si * area / (4.0 * self.bulk_modulus.si)

    def quantities(self) -> dict[str, Quantity]:
        """All numbers by name, in the order of the class."""
        return {n: getattr(self, n) for n in type(self).model_fields if n != "name"}


_LENGTH, _PRESSURE, _CORNER = ("in", "m"), ("psi", "Pa"), ("Hz", "rad/s")

_UNITS: dict[str, tuple[str, ...]] = {
    "bore_diameter": _LENGTH,
    "rod_diameter": _LENGTH,
    "half_stroke": _LENGTH,
    "minimum_gap": _LENGTH,
    "bulk_modulus": _PRESSURE,
    "drive_lag": _CORNER,
    "valve_lag": _CORNER,
    "supply_pressure": _PRESSURE,
    "return_pressure": _PRESSURE,
    "transition_pressure": _PRESSURE,
    "leg_speed": ("in/s/%", "m/s/%"),
    "leak_rate": ("1/s",),
}
"""Units each quantity may be given in."""


def load_hydraulics(source: str | Path | HydraulicParameters = "hardware") -> HydraulicParameters:
    """Load a hydraulic parameter set.

    Args:
        source: `report`, `hardware`, the path of a TOML file with `base = "report"|"hardware"`
            and one table of changed quantities, or a set already loaded.

    Raises:
        ValueError: unknown set, unreadable file or a refused field; each is named.
    """
    if isinstance(source, HydraulicParameters):
        return source
    shipped = read_toml(_FILE)
    if str(source) in HYDRAULICS:
        name = str(source)
        table = shipped["common"] | shipped[name]
        return validated(HydraulicParameters, table | {"name": name}, f"{_FILE.name}: {name}")
    path = Path(source)
    if path.suffix != ".toml":
        raise ValueError(
            f"hydraulics: {str(source)!r} is neither {' nor '.join(HYDRAULICS)} nor a .toml file"
        )
    own = read_toml(path)
    base = own.pop("base", None)
    if base not in HYDRAULICS:
        raise ValueError(f"{path}: base: {base!r} is not one of {', '.join(HYDRAULICS)}")
    if len(own) != 1 or not isinstance(next(iter(own.values())), dict):
        raise ValueError(f"{path}: has the tables {sorted(own)}; exactly one is allowed")
    name, changes = next(iter(own.items()))
    if "name" in changes:
        raise ValueError(f"{path}: {name}: name: is taken from the table; leave it out")
    table = shipped["common"] | shipped[base] | changes | {"name": name}
    return validated(HydraulicParameters, table, f"{path}: {name}")
