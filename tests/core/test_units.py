"""The SI unit that a compound one converts to."""

import pytest

from cmf_mj.core.units import si_unit


@pytest.mark.parametrize(
    ("unit", "si"),
    [
        ("psi/gpm", "Pa s/m^3"),
        ("bar/lpm", "Pa s/m^3"),
        ("kPa/gpm", "Pa s/m^3"),
        ("V/g", "V s^2/m"),
        ("m/Hz", "m s/rad"),
        ("%/kt", "s/m"),
        ("kt/g", "m s^2/s/m"),
        ("%/in/s^2", "1/m/s^2"),
        ("in/s/%", "m/s"),
        ("g", "m/s^2"),
        ("l/min", "m^3/s"),
    ],
)
def test_every_slash_divides_from_left_to_right(unit: str, si: str) -> None:
    assert si_unit(unit) == si
