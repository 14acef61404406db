"""Oil: density, its slope, enthalpy and stored energy against quadrature and closed forms."""

import numpy as np
import pytest
from hydraulic_equations import ATMOSPHERE, changed, content_ratio, slope
from power_balance import stored
from scipy import integrate

from cmf_mj.plant.oil import density, enthalpy, least_pressure, make_oil
from cmf_mj.plant.parameters import HYDRAULICS, load_hydraulics

PRESSURES = [-1.01e5, -9e4, -3e4, -10.0, 0.0, 5e3, 1e5, 3e6, 1e7, 4e7]


@pytest.mark.parametrize("name", HYDRAULICS)
@pytest.mark.parametrize("pressure", PRESSURES)
def test_density_is_that_of_the_equations(name: str, pressure: float) -> None:
    p = load_hydraulics(name)
    assert density(make_oil(p), pressure)[0] == pytest.approx(content_ratio(p, pressure), rel=1e-12)


@pytest.mark.parametrize("name", HYDRAULICS)
@pytest.mark.parametrize("pressure", [q for q in PRESSURES if q != 0.0])
def test_density_slope_is_the_derivative(name: str, pressure: float) -> None:
    """Five-point difference over a share of the absolute pressure; the corner at 0 is left out."""
    oil = make_oil(load_hydraulics(name))
    step = min(1e-3 * (pressure + ATMOSPHERE), 0.2 * abs(pressure))
    found = slope(lambda at: density(oil, at)[0], pressure, step)
    assert density(oil, pressure)[1] == pytest.approx(found, rel=1e-5)


def test_entrained_gas_softens_oil_at_low_pressure() -> None:
    """Effective modulus 1 / (1 / beta + e / (n pa)) at the atmosphere."""
    p = load_hydraulics("lossy")
    oil, plain = make_oil(p), make_oil(load_hydraulics("hardware"))
    share, n = 0.005, p.gas_exponent.value
    ratio, rise = density(oil, 1e-6)
    assert ratio == pytest.approx(1 / (1 + share), rel=1e-9)
    compliance = 1 / plain.bulk_modulus + share / (n * ATMOSPHERE)
    assert rise / ratio**2 == pytest.approx(compliance, rel=1e-6)


def test_a_torn_volume_keeps_its_absolute_pressure_above_zero() -> None:
    """Half full: r = 1/2 needs gas of half the volume, pa c / (p + pa) = 1: almost vacuum."""
    oil = make_oil(load_hydraulics("hardware"))
    pressure = -ATMOSPHERE + 1e-6 * ATMOSPHERE
    assert density(oil, pressure)[0] == pytest.approx(0.5, rel=1e-3)
    pressures = np.linspace(least_pressure(oil), 1e5, 20001)
    ratios = np.array([density(oil, p) for p in pressures])
    assert (np.diff(ratios[:, 0]) > 0.0).all() and (ratios > 0.0).all()


def test_without_gas_there_is_no_floor() -> None:
    oil = make_oil(changed("hardware", cavitation_gas=0.0))
    assert least_pressure(oil) == -np.inf
    assert density(oil, -1e6)[0] == pytest.approx(np.exp(-1e6 / oil.bulk_modulus), rel=1e-8)


@pytest.mark.parametrize("exponent", [1.0, 1.4])
@pytest.mark.parametrize("name", ["hardware", "lossy"])
@pytest.mark.parametrize("pressure", [-3e4, 1e5, 7e6, 3e7])
def test_enthalpy_is_the_integral_of_specific_volume(
    name: str, exponent: float, pressure: float
) -> None:
    """h = int 1/r dp by quadrature; 1e-6: 1 - z + z^2/2 against 1/(1 + z + z^2/2), z^3/4, and the
    trace released below the atmosphere."""
    p = changed(name, gas_exponent=exponent)
    expected, _ = integrate.quad(lambda q: 1 / content_ratio(p, q), 0.0, pressure, epsrel=1e-11)
    z = abs(pressure) / p.bulk_modulus.si
    assert enthalpy(make_oil(p), pressure) == pytest.approx(expected, rel=1e-6 + z**3)


@pytest.mark.parametrize("name", ["hardware", "lossy"])
@pytest.mark.parametrize("pressure", [2e5, 7e6, 2e7])
def test_stored_energy_is_the_work_of_filling(name: str, pressure: float) -> None:
    """U = C int p d(-1/r), the work to squeeze the content from the atmosphere to p; of a liquid
    about V p^2 / (2 beta)."""
    p = load_hydraulics(name)
    oil, volume = make_oil(p), 0.02
    content = volume * content_ratio(p, pressure)

    def squeezed(q: float) -> float:
        """-p d(1/r)/dp: work to squeeze a unit of content."""
        return -q * slope(lambda at: 1 / content_ratio(p, at), q, 1e-4 * (q + ATMOSPHERE))

    work, _ = integrate.quad(squeezed, 0.0, pressure, epsrel=1e-8, limit=200)
    assert stored(oil, content, pressure, volume) == pytest.approx(content * work, rel=2e-4)
    assert stored(oil, volume, 0.0, volume) == 0.0
    simple = volume * pressure**2 / (2 * oil.bulk_modulus)
    if name == "hardware":
        assert stored(oil, content, pressure, volume) == pytest.approx(simple, rel=3e-2)
