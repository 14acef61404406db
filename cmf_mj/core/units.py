"""The only unit converters of the project: SI inside, the field's units at the edges.

`to_si("in/s/%", 0.35)` reads a compound unit from left to right: the first factor multiplies,
each factor after a slash divides. Factors come from `scipy.constants` (CODATA and the
international yard and pound agreement); the only additions are the per cent of valve command,
the spelled-out unit of "no dimension" and the root hertz of noise densities (per cycle, not per
radian: a density d of one-sided power d^2 per Hz has the variance d^2 f over a band of f Hz).
"""

from typing import TypeVar

import numpy as np
from scipy import constants

from cmf_mj.core.errors import InputError

INCH = constants.inch
FOOT = constants.foot
KNOT = constants.knot
DEGREE = constants.degree
POUND_FORCE = constants.pound_force
POUND_MASS = constants.pound
PSI = constants.psi
STANDARD_GRAVITY = constants.g
PERCENT = 0.01
GALLON = constants.gallon
GALLON_PER_MINUTE = constants.gallon / constants.minute
LITRE_PER_MINUTE = constants.liter / constants.minute
HERTZ = 2.0 * np.pi

_FACTORS: dict[str, float] = {
    "1": 1.0,
    "m": 1.0,
    "s": 1.0,
    "kg": 1.0,
    "N": 1.0,
    "Pa": 1.0,
    "V": 1.0,
    "rad": 1.0,
    "rad/s": 1.0,
    "m s": 1.0,
    "rad s": 1.0,
    "m^3": 1.0,
    "m^2": 1.0,
    "s^2": 1.0,
    "N s": 1.0,
    "Pa s": 1.0,
    "lbf s": POUND_FORCE,
    "gal": GALLON,
    "gpm": GALLON_PER_MINUTE,
    "l": constants.liter,
    "l/min": LITRE_PER_MINUTE,
    "lpm": LITRE_PER_MINUTE,
    "mm": constants.milli,
    "kN": constants.kilo,
    "bar": constants.bar,
    "in": INCH,
    "ft": FOOT,
    "kt": KNOT,
    "in^2": INCH**2,
    "deg": DEGREE,
    "deg s": DEGREE,
    "lbf": POUND_FORCE,
    "lbm": POUND_MASS,
    "psi": PSI,
    "g": STANDARD_GRAVITY,
    "%": PERCENT,
    "Hz": HERTZ,
    "rtHz": 1.0,
}

Value = TypeVar("Value", float, np.ndarray)


def factor(unit: str) -> float:
    """Return what one `unit` is in SI (command fraction 0 to 1 for `%`, rad/s for `Hz`).

    Args:
        unit: a known unit, or known units joined by `/`, e.g. `in/s/%`.

    Raises:
        InputError: a part of the unit is not known; the message lists those that are.
    """
    if unit in _FACTORS:
        return _FACTORS[unit]
    result = 1.0
    for index, part in enumerate(unit.split("/")):
        if part not in _FACTORS:
            raise InputError(f"unit: {unit!r} is not known; use {', '.join(sorted(_FACTORS))}")
        result = result * _FACTORS[part] if index == 0 else result / _FACTORS[part]
    return result


def to_si(unit: str, value: Value) -> Value:
    """Convert `value` in `unit` to SI."""
    return value * factor(unit)


def from_si(unit: str, value: Value) -> Value:
    """Convert `value` in SI to `unit`."""
    return value / factor(unit)
