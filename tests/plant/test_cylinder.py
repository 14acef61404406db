"""Cylinder: areas, volumes, stiffness of the oil and the pressures that hold a static load."""

import numpy as np
import pytest

from cmf_mj.core import units
from cmf_mj.plant.cylinder import (
    Cylinder,
    force,
    holding_pressures,
    make_cylinders,
    stiffness,
    throttled_gain,
    volumes,
)
from cmf_mj.plant.parameters import HYDRAULICS, load_hydraulics

BETA = units.to_si("psi", 100000.0)

SUPPLY = units.to_si("psi", 1500.0)
TANK = units.to_si("psi", 40.0)


@pytest.fixture(params=HYDRAULICS)
def cylinder(request: pytest.FixtureRequest) -> Cylinder:
    return Cylinder(*make_cylinders(load_hydraulics(request.param), ["leg"])[0])


@pytest.fixture
def tight(cylinder: Cylinder) -> Cylinder:
    """The same cylinder without piston leakage."""
    return cylinder._replace(leakage=0.0)


def stall_range(cylinder: Cylinder, tank: float) -> tuple[float, float]:
    """Forces with one chamber at supply and the other at return pressure."""
    return (
        cylinder.cap_area * tank - cylinder.rod_area * SUPPLY,
        cylinder.cap_area * SUPPLY - cylinder.rod_area * tank,
    )


def test_volume_slopes_are_the_areas(cylinder: Cylinder) -> None:
    """dV_cap/dx = A_cap, dV_rod/dx = -A_rod off the ends. 1e-10: round-off over 1 mm."""
    for extension in (-0.9, -0.2, 0.0, 0.7, 0.9):
        here, there = volumes(cylinder, extension), volumes(cylinder, extension + 1e-3)
        assert (there[0] - here[0]) / 1e-3 == pytest.approx(cylinder.cap_area, rel=1e-10)
        assert (there[1] - here[1]) / 1e-3 == pytest.approx(-cylinder.rod_area, rel=1e-10)


def test_volumes_stay_positive_beyond_the_stops(cylinder: Cylinder) -> None:
    """On its stop a chamber keeps the minimum gap of oil; the other goes on growing."""
    gap, half = cylinder.minimum_gap, cylinder.half_stroke
    for beyond in (0.0, 0.01, 0.3):
        left = gap if beyond == 0.0 else 0.55 * gap
        assert volumes(cylinder, -half - beyond)[0] == pytest.approx(cylinder.cap_area * left)
        assert volumes(cylinder, half + beyond)[1] == pytest.approx(cylinder.rod_area * left)
        assert volumes(cylinder, half + beyond)[0] == pytest.approx(
            cylinder.cap_area * (2 * half + beyond), rel=1e-14
        )


def test_force_is_pressure_times_area(cylinder: Cylinder) -> None:
    """Cap pressure extends, rod pressure retracts."""
    assert force(cylinder, 2e6, 0.0) == 2e6 * cylinder.cap_area
    assert force(cylinder, 0.0, 2e6) == -2e6 * cylinder.rod_area
    assert force(cylinder, 5e6, 3e6) == pytest.approx(
        5e6 * cylinder.cap_area - 3e6 * cylinder.rod_area, rel=1e-15
    )


def test_stiffness_is_the_slope_of_the_force_of_enclosed_oil(cylinder: Cylinder) -> None:
    """-dF/dx with p + beta ln V constant in each chamber, by central differences of 1e-5 m.

    1e-7: (1e-5 m / 0.06 m)^2 at the most extended point.
    """
    for extension in (-0.9, -0.4, 0.0, 0.5, 0.9):
        step = 1e-5
        start = np.array(volumes(cylinder, extension))

        def held(moved: float, start: np.ndarray = start) -> float:
            pressures = BETA * np.log(start / np.array(volumes(cylinder, moved)))
            return float(force(cylinder, *pressures))

        slope = -(held(extension + step) - held(extension - step)) / (2 * step)
        assert float(stiffness(cylinder, BETA, extension)) == pytest.approx(slope, rel=1e-7)
    expected = BETA * (cylinder.cap_area + cylinder.rod_area) / cylinder.half_stroke
    extensions = np.array([-0.5, 0.0, 0.3])
    found = stiffness(cylinder, BETA, extensions)
    assert found[1] == pytest.approx(expected, rel=1e-14)
    assert list(found) == [float(stiffness(cylinder, BETA, x)) for x in extensions]


@pytest.mark.parametrize("leaky", [True, False])
@pytest.mark.parametrize("tank", [0.0, TANK])
def test_holding_pressures_hold_the_load(cylinder: Cylinder, leaky: bool, tank: float) -> None:
    """F = A_cap p_cap - A_rod p_rod for 101 loads from stall to stall, at pressures the supply and
    the tank can give. 1e-9 of the stall force: round-off."""
    chosen = cylinder if leaky else cylinder._replace(leakage=0.0)
    low, high = stall_range(cylinder, tank)
    loads = np.linspace(low, high, 101)
    pressures = holding_pressures(chosen, loads, SUPPLY, tank)
    assert pressures.shape == (101, 2)
    held = [force(chosen, *row) for row in pressures]
    np.testing.assert_allclose(held, loads, rtol=0, atol=1e-9 * high)
    assert pressures.min() >= tank - 1e-9 * SUPPLY
    assert pressures.max() <= SUPPLY * (1 + 1e-9)


def test_leakage_ends_at_equal_pressures(cylinder: Cylinder) -> None:
    """No pressure difference, no leakage flow: p = F / (A_cap - A_rod), 610.5 psi at 7200 lbf
    with the areas above, 7200 / (23.758 - 11.965)."""
    load = units.to_si("lbf", 7200.0)
    cap, rod = holding_pressures(cylinder, load, SUPPLY, 0.0)[0]
    assert cylinder.leakage > 0.0
    assert cap == pytest.approx(rod, rel=1e-12)
    assert units.from_si("psi", cap) == pytest.approx(7200 / (23.758 - 11.965), rel=1e-4)


def test_without_leakage_the_valve_null_is_taken(tight: Cylinder) -> None:
    """p_cap + p_rod = Ps + Pt wherever both fit between return and supply pressure."""
    low, high = stall_range(tight, TANK)
    loads = np.linspace(low, high, 41)
    pressures = holding_pressures(tight, loads, SUPPLY, TANK)
    np.testing.assert_allclose(pressures.sum(axis=1), SUPPLY + TANK, rtol=1e-12)


def test_loads_that_equal_pressures_cannot_hold_are_clipped(cylinder: Cylinder) -> None:
    """A pull, and a push above (A_cap - A_rod) Ps, need unequal pressures even with leakage: one
    chamber then sits on return or supply pressure."""
    above = 0.5 * (cylinder.cap_area - cylinder.rod_area + cylinder.cap_area) * SUPPLY
    push = holding_pressures(cylinder, above, SUPPLY, 0.0)[0]
    assert push[0] == pytest.approx(SUPPLY, rel=1e-12)
    assert 0.0 < push[1] < SUPPLY
    pull = holding_pressures(cylinder, -0.5 * cylinder.rod_area * SUPPLY, SUPPLY, 0.0)[0]
    assert pull[0] == pytest.approx(0.0, abs=1e-9 * SUPPLY)
    assert pull[1] == pytest.approx(0.5 * SUPPLY, rel=1e-12)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_load_beyond_stall_is_refused(cylinder: Cylinder, side: int) -> None:
    """Stall forces A_cap Ps and -A_rod Ps at return pressure 0; the message names the leg, its
    load and the range."""
    low, high = -cylinder.rod_area * SUPPLY, cylinder.cap_area * SUPPLY
    limit = high if side > 0 else low
    holding_pressures(cylinder, [0.0, limit * (1 - 1e-12)], SUPPLY, 0.0)
    with pytest.raises(ValueError) as caught:
        holding_pressures(cylinder, [0.0, 1.01 * limit], SUPPLY, 0.0)
    message = str(caught.value)
    for part in ("leg 2", f"{1.01 * limit:.0f} N", f"{low:.0f} to {high:.0f} N"):
        assert part in message
    with pytest.raises(ValueError, match="leg 1: nan"):
        holding_pressures(cylinder, float("nan"), SUPPLY, 0.0)


def test_one_load_and_one_extension_a_cylinder() -> None:
    pair = make_cylinders(load_hydraulics("hardware"), ["one", "other"])
    both = holding_pressures(pair, 1e4, SUPPLY, TANK)
    assert both.shape == (2, 2)
    assert stiffness(pair, BETA, 0.1).shape == (2,)
    assert both.tolist() == holding_pressures(pair[0], [1e4, 1e4], SUPPLY, TANK).tolist()
    for wrong in (np.zeros(3), np.zeros((2, 2)), "abc"):
        with pytest.raises(ValueError, match="load: "):
            holding_pressures(pair, wrong, SUPPLY, TANK)
        with pytest.raises(ValueError, match="extension: "):
            stiffness(pair, BETA, wrong)
    with pytest.raises(ValueError, match=r"load: shape is \(2, 2\)"):
        holding_pressures(pair[0], np.zeros((2, 2)), SUPPLY, TANK)


def test_leakage_relaxes_the_force_of_a_displaced_leg_at_the_leak_rate() -> None:
    """dF/dt = -lambda F right after a displacement at neutral: there p_cap : p_rod = 1 : -1, so
    dF/dt = -2 beta L / h (p_cap - p_rod) with F = (A_cap + A_rod) p_cap."""
    parameters = load_hydraulics("hardware")
    cylinder = Cylinder(*make_cylinders(parameters, ["leg"])[0])
    pressure = 1e6
    held = force(cylinder, pressure, -pressure)
    cap_volume, rod_volume = volumes(cylinder, 0.0)
    # L counts content, of which a volume at mid pressure, 750 psi, holds exp(750 psi / beta).
    flow = cylinder.leakage * 2 * pressure / np.exp(750.0 / 100000.0)
    cap_rate = -BETA * flow / cap_volume
    rod_rate = BETA * flow / rod_volume
    assert force(cylinder, cap_rate, rod_rate) == pytest.approx(
        -parameters.leak_rate.si * held, rel=1e-7
    )


def test_cushion_is_an_orifice_in_series_with_the_valve() -> None:
    """1/G^2 = 1/g^2 + (e/G_stop)^2, e = 0 at the cushion's edge and 1 at the stop."""
    parameters = load_hydraulics("lossy")
    cylinder = Cylinder(*make_cylinders(parameters, ["leg"])[0])
    length, full = parameters.cushion_length.si, 3.0
    stop = parameters.cushion_opening.si * full
    for gap, e in ((length, 0.0), (0.5 * length, 0.5), (0.0, 1.0), (-0.01, 1.0)):
        found = throttled_gain(cylinder, gap, 2.0, full)
        assert 1 / found**2 == pytest.approx(1 / 4.0 + (e / stop) ** 2, rel=1e-12)
    assert throttled_gain(cylinder, 2 * length, 2.0, full) == 2.0
    assert throttled_gain(cylinder, 0.0, 0.0, full) == 0.0
