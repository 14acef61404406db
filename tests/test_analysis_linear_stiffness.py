"""Compliance under a law: mass alone at high frequency, and the closed form of one mode."""

import numpy as np
import pytest

from cmf_mj import Hexapod, load_hydraulics, load_law
from cmf_mj.analysis.linear.stiffness import compliance, dynamic_stiffness
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME

PLANT = Hexapod("ifd", load_hydraulics("hardware"))
LAW = load_law("modal_plan").bound_to("ifd")


def test_far_above_all_modes_only_mass_resists() -> None:
    """C = -M_leg^-1 / w^2; the modes, up to 12 Hz, are worth (12 / 400)^2, the held force less."""
    found = compliance(PLANT, LAW, [400.0])[0]
    expected = -np.linalg.inv(PLANT.reflected_mass()) / (2.0 * np.pi * 400.0) ** 2
    held = np.sinc(400.0 * FRAME) * np.exp(-1j * np.pi * 400.0 * FRAME)
    np.testing.assert_allclose(found / held, expected, atol=0.1 * np.abs(expected).max())


@pytest.mark.parametrize(("mode", "gains"), [(0, (46.0, 6.75, 2.88)), (4, (41.0, 0.0, 0.0))])
def test_a_mode_has_the_stiffness_of_its_closed_form(mode: int, gains: tuple[float, ...]) -> None:
    """m s^2 + K (k G C + s) / (s + leak + K k G H), of docs/explanation/laws_beyond.md; what other
    modes and the two chambers' own leaks add is below a tenth."""
    own = LAW.modes["ifd"]
    shape, mass = np.array(own.shape), own.mass[mode] * units.POUND_MASS
    hertz = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 5.0])
    s = 2j * np.pi * hertz
    spring = mass * (2.0 * np.pi * own.frequency[mode]) ** 2
    lags = (1.0 + s / (2.0 * np.pi * 3.0)) * (1.0 + s / (2.0 * np.pi * 75.0))
    flow = 0.35 * units.INCH / units.PERCENT * np.exp(-1.5 * s * FRAME) / lags
    position, velocity, load = gains
    error = (position + velocity * s + 10.0 / s) * units.PERCENT / units.INCH
    damped = load * units.PERCENT / (1000.0 * units.POUND_FORCE) * s / (s + 2.0 * np.pi * 5.0)
    expected = mass * s**2 + spring * (flow * error + s) / (s + 15.0 + spring * flow * damped)
    found = shape @ compliance(PLANT, LAW, hertz) @ shape.T
    np.testing.assert_allclose(np.abs(1.0 / found[:, mode, mode]), np.abs(expected), rtol=0.1)


def test_the_shipped_law_keeps_most_of_the_stiffness_of_the_law_flown() -> None:
    """From 0.5 to 5 Hz, at neutral; 8 times as much where that law resonates."""
    hertz = np.linspace(0.5, 5.0, 19)
    flown, own = (dynamic_stiffness(PLANT, law, hertz) for law in ("velocity", LAW))
    assert (own / flown).min() > 0.7
    assert (own / flown)[10, 0] > 8.0
