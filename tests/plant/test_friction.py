"""Friction: stick below breakaway, slip above, the Stribeck curve, losses, any step."""

import numpy as np
import pytest
from scipy import integrate

from cmf_mj.core.arrays import record_array
from cmf_mj.core.errors import InputError
from cmf_mj.plant.cylinder import Friction, friction_slope, make_frictions, slide
from cmf_mj.plant.parameters import load_hydraulics

LBF, INCH = 0.45359237 * 9.80665, 0.0254
CONTACT = Friction(600.0, 0.6, 0.003, 1e-4, 500.0)


def lugre(time: float, speed: float, bristle: float = 0.0) -> float:
    """z after sliding at a held speed, by integration of dz/dt = v - |v| z / Z(v)."""
    c = CONTACT
    largest = c.presliding * (1 + c.excess * np.exp(-((speed / c.stribeck_speed) ** 2)))
    solution = integrate.solve_ivp(
        lambda _, z: speed - abs(speed) * z / largest, (0, time), [bristle], rtol=1e-10, atol=1e-14
    )
    return float(solution.y[0, -1])


@pytest.mark.parametrize("speed", [-0.2, -1e-3, 1e-5, 2e-3, 0.5])
@pytest.mark.parametrize("bristle", [-1e-4, 0.0, 5e-5])
def test_deflection_follows_its_equation(speed: float, bristle: float) -> None:
    for time in (1e-4, 1e-3, 0.05):
        found, _ = slide(CONTACT, bristle, speed, time)
        assert found == pytest.approx(lugre(time, speed, bristle), rel=1e-7, abs=1e-13)


@pytest.mark.parametrize("speed", [-0.3, 2e-4, 3e-3, 6e-3, 0.5])
def test_steady_sliding_is_on_the_stribeck_curve(speed: float) -> None:
    """F = sign(v) (Fc + (Fb - Fc) exp(-(v/vs)^2)) + b v, Fb = 960 N."""
    bristle, force = 0.0, 0.0
    for _ in range(4000):
        bristle, force = slide(CONTACT, bristle, speed, 0.01)
    curve = 600.0 + 360.0 * np.exp(-((speed / 0.003) ** 2))
    assert force == pytest.approx(np.sign(speed) * curve + 500.0 * speed, rel=1e-9)


def block(load: float, seconds: float = 8.0, mass: float = 300.0) -> tuple[float, float]:
    """(moved [m], speed [m/s]) of a block on the contact under a load that rises in 5 s: slowly,
    for the presliding creep must stay below the Stribeck speed."""
    step, x, v, bristle, force = 1 / 2048, 0.0, 0.0, 0.0, 0.0
    for k in range(round(seconds / step)):
        push = load * min(k * step / 5.0, 1.0)
        v += step * (push - force) / mass
        x += step * v
        bristle, force = slide(CONTACT, bristle, v, step)
    return x, v


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_load_below_breakaway_sticks_and_one_above_slips(sign: float) -> None:
    """960 N breaks loose. At 90 % the block stands where the bristles hold it, z = d F / Fc within
    the presliding creep; at 110 % it slides."""
    moved, speed = block(0.9 * 960.0 * sign)
    assert abs(speed) < 1e-6
    assert abs(moved) < 10 * CONTACT.presliding
    moved, speed = block(1.1 * 960.0 * sign)
    assert speed * sign > 0.1
    assert moved * sign > 0.1


def test_a_sliding_contact_takes_energy_and_never_gives_more_than_it_stored() -> None:
    """Work of friction over random motion is at least minus the bristles' elastic energy."""
    rng = np.random.default_rng(4)
    bristle, work, step = 0.0, 0.0, 1 / 2048
    stiffness = CONTACT.coulomb_friction / CONTACT.presliding
    for speed in np.repeat(rng.normal(0.0, 0.01, 400), 8):
        before = 0.5 * stiffness * bristle**2
        bristle, force = slide(CONTACT, bristle, speed, step)
        taken = force * speed * step
        work += taken
        assert taken >= 0.5 * stiffness * bristle**2 - before - 1e-3
    assert work > 1.0


def test_the_result_does_not_depend_on_the_step() -> None:
    """At a held speed the deflection is exact: one step or a thousand, 1e-12 of d."""
    whole = slide(CONTACT, -5e-5, 4e-3, 0.02)
    bristle, force = -5e-5, 0.0
    for _ in range(1000):
        bristle, force = slide(CONTACT, bristle, 4e-3, 2e-5)
    assert bristle == pytest.approx(whole[0], abs=1e-12 * CONTACT.presliding * 1e3)
    assert force == pytest.approx(whole[1], rel=1e-9)


def test_numbers_come_from_the_set() -> None:
    contact = make_frictions(load_hydraulics("lossy"), ["a", "b"])[1]
    assert contact.coulomb_friction == pytest.approx(150 * LBF, rel=1e-12)
    assert contact.excess == pytest.approx(250 / 150 - 1, rel=1e-12)
    assert contact.viscous_friction == pytest.approx(10 * LBF / INCH, rel=1e-12)
    assert contact.presliding == pytest.approx(0.004 * INCH, rel=1e-12)
    assert contact.stribeck_speed == pytest.approx(0.1 * INCH, rel=1e-12)


def first_harmonic(size: float, hertz: float, kind: Friction = CONTACT) -> tuple[float, float]:
    """Force of a sine x = size sin(w t) as (stiffness, damping without b), from a period."""
    count, omega = 20_000, 2.0 * np.pi * hertz
    time = np.arange(2 * count) / (count * hertz)
    position, bristle, force = size * np.sin(omega * time), 0.0, np.zeros(2 * count)
    for k in range(1, 2 * count):
        speed = (position[k] - position[k - 1]) * count * hertz
        bristle, force[k] = slide(kind, bristle, speed, 1.0 / (count * hertz))
    last, angle = force[count:], omega * time[count:]
    sine, cosine = (2.0 * np.mean(last * part) / size for part in (np.sin(angle), np.cos(angle)))
    return float(sine), float(cosine / omega) - kind.viscous_friction


@pytest.mark.parametrize("excess", [0.0, 0.6])
def test_sliding_damps_as_its_describing_function(excess: float) -> None:
    """4 Fc / (pi V) where there is no Stribeck curve; 25 mm are 250 times the presliding travel.
    The slowest sine slides at twice the Stribeck speed."""
    kind = CONTACT._replace(excess=excess)
    for hertz in (0.04, 0.2, 2.0):
        speed = 0.025 * 2.0 * np.pi * hertz
        slope = friction_slope(record_array(Friction, [kind]), speed)
        assert slope.stiffness[0] == 0.0
        assert first_harmonic(0.025, hertz, kind)[1] == pytest.approx(slope.damping[0], rel=0.01)
        plain = 4.0 * 600.0 / (np.pi * speed)
        assert (slope.damping[0] == pytest.approx(plain, rel=1e-12)) == (excess == 0.0)


def test_a_contact_that_sticks_is_a_spring_with_a_damper() -> None:
    """A hundredth of the presliding travel."""
    slope = friction_slope(record_array(Friction, [CONTACT]), "stuck")
    stiffness, damping = first_harmonic(1e-6, 1.0)
    assert stiffness == pytest.approx(slope.stiffness[0], rel=0.01)
    assert damping == pytest.approx(slope.damping[0], rel=0.1)  # what hysteresis is left damps too
    assert slope.stiffness[0] == pytest.approx(600.0 / 1e-4)


@pytest.mark.parametrize("contact", ["slides", 0.0, -1.0, np.nan, np.inf])
def test_other_contacts_are_refused(contact: float) -> None:
    with pytest.raises(InputError, match="friction: .* is refused; allowed: 'none'"):
        friction_slope(make_frictions(load_hydraulics("lossy"), ["leg_1"]), contact)
