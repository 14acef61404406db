"""The only unit converters of the project: SI inside, the field's units at the edges.

`to_si("in/s/%", 0.35)` reads a compound unit from left to right: the first factor multiplies,
each factor after a slash divides. Factors come from `scipy.constants` (CODATA and the
international yard and pound agreement); the only additions are the per cent of valve command,
the spelled-out unit of "no dimension" and the root hertz of noise densities (per cycle, not per
radian: a density d of one-sided power d^2 per Hz has the variance d^2 f over a band of f Hz).

Below stand the facility's control rate and frame, in which its time is counted.
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
HERTZ = 2.0 * np.pi

_SI = (
    *("1", "m", "s", "kg", "N", "Pa", "V", "rad", "rad/s", "m^2", "m^3", "s^2"),
    *("m s", "rad s", "N s", "Pa s", "rtHz", "kg m^2"),
)

_FACTORS: dict[str, float] = {
    **dict.fromkeys(_SI, 1.0),
    "lbf s": POUND_FORCE,
    "gal": GALLON,
    "gpm": GALLON_PER_MINUTE,
    "l": constants.liter,
    **dict.fromkeys(("l/min", "lpm"), constants.liter / constants.minute),
    "mm": constants.milli,
    "cm": constants.centi,
    "ms": constants.milli,
    "us": constants.micro,
    "kN": constants.kilo,
    "bar": constants.bar,
    "kPa": constants.kilo,
    "MPa": constants.mega,
    "in": INCH,
    "ft": FOOT,
    "kt": KNOT,
    "in^2": INCH**2,
    "deg": DEGREE,
    "deg s": DEGREE,
    "lbf": POUND_FORCE,
    "lbm": POUND_MASS,
    "lbm ft^2": POUND_MASS * FOOT**2,
    "lbm in^2": POUND_MASS * INCH**2,
    "slug ft^2": constants.slug * FOOT**2,
    "psi": PSI,
    "g": STANDARD_GRAVITY,
    "%": PERCENT,
    "Hz": HERTZ,
}

_SI_NAMES = {
    **dict.fromkeys(("mm", "cm", "in", "ft"), "m"),
    **dict.fromkeys(("bar", "kPa", "MPa", "psi"), "Pa"),
    **{"kN": "N", "lbf": "N", "lbm": "kg", "deg": "rad", "%": "1", "ms": "s", "us": "s"},
    **{"kt": "m/s", "g": "m/s^2", "Hz": "rad/s", "in^2": "m^2", "gal": "m^3", "l": "m^3"},
    **dict.fromkeys(("gpm", "l/min", "lpm"), "m^3/s"),
    **{"lbf s": "N s", "deg s": "rad s"},
    **dict.fromkeys(("lbm ft^2", "lbm in^2", "slug ft^2"), "kg m^2"),
}
"""SI units by the part of a unit; parts that are SI units themselves are left out."""

ValueT = TypeVar("ValueT", float, np.ndarray)


def is_known(unit: str) -> bool:
    """Whether `factor` knows a unit."""
    return unit in _FACTORS or all(part in _FACTORS for part in unit.split("/"))


def factor(unit: str) -> float:
    """What one `unit` is in SI; known units may be joined by `/`, as in `in/s/%`.

    That of `%` is a fraction, 0.01, and that of `Hz` 2 pi rad/s.
    """
    if unit in _FACTORS:
        return _FACTORS[unit]
    result = 1.0
    for index, part in enumerate(unit.split("/")):
        if part not in _FACTORS:
            raise InputError(f"unit: {unit!r} is not known; use {', '.join(sorted(_FACTORS))}")
        result = result * _FACTORS[part] if index == 0 else result / _FACTORS[part]
    return result


def si_unit(unit: str) -> str:
    """The SI unit that `factor` converts to.

    >>> si_unit("in/s^2"), si_unit("gpm/psi"), si_unit("psi/gpm")
    ('m/s^2', 'm^3/s/Pa', 'Pa s/m^3')
    """
    factor(unit)
    if unit in _SI_NAMES:
        return _SI_NAMES[unit]
    numerator, denominator = list[str](), list[str]()
    for index, part in enumerate(unit.split("/")):
        multiplied, *divided = _SI_NAMES.get(part, part).split("/")
        numerator += divided if index > 0 else [multiplied]
        denominator += [multiplied] if index > 0 else divided
    product = " ".join(part for part in numerator if part != "1") or "1"
    return "/".join([product, *(part for part in denominator if part != "1")])


def to_si(unit: str, value: ValueT) -> ValueT:
    """Convert `value` in `unit` to SI."""
    return value * factor(unit)


def from_si(unit: str, value: ValueT) -> ValueT:
    """Convert `value` in SI to `unit`."""
    return value / factor(unit)


RATE = 2048  #: Control frames a second [Hz]; the facility's DCL runs at 2048 Hz.

SLOWEST_RATE, FASTEST_RATE = 200, 10_000  #: Control rates that a machine may have [Hz].

FRAME = 1.0 / RATE  #: Control frame [s]; exact in binary.

MOST_FRAMES = 2**31  #: Control frames of the longest run: whole numbers of 32 bits count them.

LONGEST = MOST_FRAMES * FRAME  #: Its length [s]: 2^20 s, twelve days.
