"""What is known of one number of a machine that nobody knows exactly.

An unknown lies between bounds, or deviates from what is nominal. With u from 0 to 1, z normal and
cut off at `LIMIT` deviations, s the deviation,

    uniform     low + u (high - low)     or  x = s (2 u - 1)        normal     x = s z
    loguniform  low (high / low)^u                                  lognormal  1 + x = exp(s z)

It is the number itself (`value`), a `factor` on the nominal one, for a deviation 1 + x, or an
`offset` to it.
"""

import re
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator
from scipy import stats

from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Kind, Quantity, Status
from cmf_mj.core.settings import Settings
from cmf_mj.electronics.sensors import CHANNELS, SensorSettings
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.parameters import ACTUATOR_FIELDS, VALVE_FIELDS, VALVES, HydraulicParameters
from cmf_mj.plant.plant import Plant

Array = NDArray[np.float64]

LIMIT = 2.0
"""Deviations beyond which values of a normal distribution do not occur: such parts go back."""

LEGS = tuple(f"leg_{leg}" for leg in range(1, 7))

DERIVED = {"valve_gain": "leg_speed", "leakage": "leak_rate"}
"""Names in paths of what also depends on another number, and the field that each changes."""

LEADS = {"supply": "supply_pressure", "friction": "coulomb_friction"}
"""Names in paths of several numbers of the set, and the first field of each."""

_FACTOR_PATHS = re.compile(
    r"hydraulics\.actuators\..*\.(valve_gain|leakage)|(cab|platform)\.(inertia|density)"
    r"|payload\.density|legs\.mass|model\.body\..*\.inertia"
)

_UNITS = {
    "mass": ("kg", "lbm"),
    "centre_of_mass": ("m",),
    "second_moment": ("kg m^2", "lbm ft^2", "lbm in^2", "slug ft^2"),
    "stiction": ("1",),
}
"""Units of numbers that are no quantity of the hydraulic set."""


def _allowed_units(path: str) -> tuple[str, ...]:
    """Units that a number of bodies or hydraulics may have; of other parts none are known.

    Those of a hydraulic set are the units of the `Kind` by which the field is checked.
    """
    root, *_, name = path.split(".")
    if root in ("cab", "platform") or path == "hydraulics.stiction":
        return _UNITS.get(path.split(".")[1], ())
    field = LEADS.get(name, name)
    info = HydraulicParameters.model_fields.get(field) if root == "hydraulics" else None
    for validator in info.metadata if info else ():
        kind = getattr(getattr(validator, "func", None), "__self__", None)
        if isinstance(kind, Kind):
            return kind.units
    return ()


_NUMBERS = HydraulicParameters.model_fields.keys() - {"name", "supply", "actuators"}
_PATH = re.compile(
    rf"hydraulics\.({'|'.join(_NUMBERS)}|friction|stiction|supply)"
    rf"|hydraulics\.actuators\.(\*|[^.*]+)\.({'|'.join([*ACTUATOR_FIELDS, *DERIVED])})"
    rf"|hydraulics\.actuators\.(\*|[^.*]+)\.valve_[12*]\.({'|'.join(VALVE_FIELDS)})"
    r"|(cab|platform)\.(mass|inertia|density|centre_of_mass(\.[xyz])?|second_moment\.[xyz])"
    r"|legs\.mass|payload\.density"
    r"|model\.(body\.[^.*]+\.(mass|inertia)|geom\.[^.*]+\.friction"
    r"|joint\.[^.*]+\.(damping|stiffness|frictionloss|armature))"
    rf"|law\.({'|'.join(Law.model_fields)})(\.\w+)*"
    rf"|machine\.({'|'.join(Machine.model_fields)})(\.\w+)*"
    rf"|electronics\.({'|'.join(CHANNELS)})\.(\w+|gain_errors\.[1-6*])|effect\.\w+"
)


class Unknown(Settings):
    """A number, or one of each leg or valve, and what is known of it."""

    path: str  #: As the head of `facility.unknowns` lists them.
    distribution: Literal["uniform", "loguniform", "normal", "lognormal"] = "uniform"
    low: float | None = None  #: Lower bound, in `unit`.
    high: float | None = None  #: Upper bound.
    deviation: Annotated[float, Field(gt=0.0)] | None = None
    """In the stead of bounds: half width of a uniform distribution, standard deviation of a normal
    one before it is cut off, that of the logarithm; in `unit`."""
    unit: str = "%"  #: As in the files; 1 for a factor between bounds.
    effect: Literal["value", "factor", "offset"] = "factor"
    status: Status = "assumed"
    """How the range is known."""
    source: Annotated[str, Field(min_length=1)]  #: Where it comes from, or why it was chosen.

    @model_validator(mode="after")
    def _consistent(self) -> "Unknown":
        units.factor(self.unit)
        if not _PATH.fullmatch(self.path):
            raise InputError(
                f"path: {self.path!r} is refused; allowed: hydraulics.FIELD, "
                "hydraulics.actuators.*.FIELD, hydraulics.actuators.*.valve_*.FIELD, cab.mass "
                "and the others at the head of cmf_mj/facility/unknowns.py, with fields of theirs"
            )
        if self.effect != "factor" and _FACTOR_PATHS.fullmatch(self.path):
            raise InputError(f"effect: {self.effect!r} is refused: {self.path} takes a factor")
        if self.deviation is None and "normal" not in self.distribution:
            self._check_bounds()
        else:
            self._check_deviation()
        allowed = () if self.effect == "factor" else _allowed_units(self.path)
        if allowed and units.si_unit(self.unit) not in {*allowed, *map(units.si_unit, allowed)}:
            text = f"allowed for {self.path}: {', '.join(allowed)}"
            raise InputError(f"unit: {self.unit!r} is refused: {text}")
        return self

    def _check_bounds(self) -> None:
        """Refuse bounds that do not rise, or of a factor with a unit."""
        lower_limit = 0.0 if self.distribution == "loguniform" else -np.inf
        if self.low is None or self.high is None or not lower_limit < self.low < self.high:
            ends = "low must be less than high, and greater than 0 on a log scale"
            raise InputError(f"{self.low} to {self.high} is refused; {ends}")
        if self.effect == "factor" and self.unit != "1":
            raise InputError(f"unit: {self.unit!r} of a factor between bounds must be '1'")

    def _check_deviation(self) -> None:
        """Refuse fields that no deviation goes with, and one that makes factors of 0 or less."""
        has_only_deviation = self.deviation is not None and self.low is self.high is None
        if not has_only_deviation or self.distribution == "loguniform" or self.effect == "value":
            allowed = "uniform, normal or lognormal and the effects factor or offset"
            raise InputError(f"deviation: goes with {allowed}, without low and high")
        if self.effect == "offset":
            if self.distribution == "lognormal":
                raise InputError("distribution: 'lognormal' goes with the effect factor")
            return
        if self.unit not in ("1", "%"):
            raise InputError(f"unit: {self.unit!r} of a factor's deviation must be % or 1")
        bound = {"normal": 1.0 / LIMIT, "lognormal": np.inf}.get(self.distribution, 1.0)
        if self.half >= bound:
            text = f"{self.deviation:g} {self.unit} must be less than {bound:g}"
            raise InputError(f"deviation: {text}: factors are positive")

    @property
    def half(self) -> float:
        """The deviation in SI."""
        return units.to_si(self.unit, self.deviation or 0.0)

    def shape(self, actuators: int = len(LEGS)) -> tuple[int, ...]:
        """Shape of its values on a machine with a number of actuators."""
        legs = (actuators,) if "*" in self.path.split(".") else ()
        valves = (len(VALVES),) if ".valve_*." in self.path else ()
        return legs + valves + ((3,) if self.path.endswith(".centre_of_mass") else ())

    def at(self, quantile: ArrayLike) -> Array:
        """The value below which a share of them lies: in `unit`, a factor, an offset in SI."""
        share = np.asarray(quantile)
        if self.low is not None and self.high is not None:
            if self.distribution == "loguniform":
                value = self.low * (self.high / self.low) ** share
            else:
                value = self.low + (self.high - self.low) * share
            return units.to_si(self.unit, value) if self.effect == "offset" else np.asarray(value)
        if self.distribution == "uniform":
            offset = self.half * (2.0 * share - 1.0)
        else:
            offset = self.half * stats.truncnorm.ppf(share, -LIMIT, LIMIT)
        offset = np.expm1(offset) if self.distribution == "lognormal" else offset
        return np.asarray(1.0 + offset if self.effect == "factor" else offset)

    def number(self, nominal: Any, value: Any) -> Any:
        """A number in SI with a value of the unknown."""
        if self.effect == "value":
            return units.to_si(self.unit, value)
        return nominal * value if self.effect == "factor" else nominal + value

    def changed(self, nominal: Quantity, value: float) -> dict[str, Any]:
        """A quantity with a value of the unknown, as files state it."""
        unit = nominal.unit
        match self.effect:
            case "value":
                unit = self.unit
            case "offset":
                value = nominal.value + value * (1.0 / units.factor(unit))
            case _:
                value = nominal.value * value
        return {"value": value, "unit": unit, "status": self.status, "source": self.source}


def nominal(
    path: str, plant: Plant, sensors: SensorSettings | None = None, law: Law | None = None
) -> tuple[float, str]:
    """The number at the path of an unknown in SI, as a plant, its sensors or its law have it.

    And its unit, which is 1 of a factor, and `SI` of a law's numbers but poles, which state none.
    Sensors without the number, ideal ones, have 0 of it.
    """
    root, *rest = path.split(".")
    number: Any = None
    match root, rest:
        case "electronics", [channel, field, *leg]:
            number = getattr(getattr(sensors, channel, None), field, None)
            if leg:
                number = number[int(leg[0].removeprefix("leg_")) - 1] if number else None
            if number is None:
                return 0.0, "1"
        case "law", _:
            number = law
            for part in rest:
                number = getattr(number, part, None)
            unit = "rad/s" if rest[-1].endswith("pole") else "SI"
            return float(1.0 if number is None else number), unit
        case "hydraulics", ["stiction"]:
            coulomb = plant.parameters.coulomb_friction.si
            return (plant.parameters.breakaway_friction.si / coulomb if coulomb else 1.0), "1"
        case "hydraulics", ["actuators", actuator, *valve, field]:
            numbers = plant.parameters.actuator(actuator, *map(VALVES.index, valve))
            number = numbers.get(LEADS.get(field, field))
        case "hydraulics", [field]:
            number = plant.parameters.actuator("").get(LEADS.get(field, field))
        case "cab" | "platform", [field, *axis] if (cab := plant.cab_parameters) is not None:
            body, index = cab if root == "cab" else cab.platform, "xyz".find("".join(axis))
            match field:
                case "mass":
                    number = body.mass
                case "second_moment":
                    moments = 0.5 * np.trace(body.tensor) - np.diag(body.tensor)
                    return float(moments[index]), "kg m^2"
                case "centre_of_mass":
                    return float(body.centre_of_mass.si[index]), "m"
    return (number.si, units.si_unit(number.unit)) if isinstance(number, Quantity) else (1.0, "1")
