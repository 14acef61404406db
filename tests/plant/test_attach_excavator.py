"""The excavator: statics against a closed form, holding, sinking, digging, oil and power.

The oracle is plane geometry with the numbers of models/README.md: points are complex, x forward,
y up; angles come from cylinder lengths by the law of cosines. Nothing of it is read from MuJoCo.
"""

from typing import NamedTuple

import numpy as np
import pytest
from power_balance import power_balance

from cmf_mj import attach_hydraulics, drive, load_law, simulate
from cmf_mj.machine import models
from cmf_mj.plant.cylinder import volumes
from cmf_mj.plant.events import Event
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.signals.composite import waypoints

CYLINDERS = ("boom_cylinder", "stick_cylinder", "bucket_cylinder")
G = 9.80665
_SI = "m^3/s/Pa"

FOOT, BOOM_BARREL = 0.15 + 1.80j, 0.57 + 1.13j  #: Boom pin and foot of its cylinders in the world.
BOOM_EYE, STICK_BARREL, STICK = 2.25 + 0.90j, 3.10 + 1.10j, 5.70 + 0j
"""On the boom: rod end, foot of the stick's cylinder, stick pin."""
STICK_EYE, BUCKET_BARREL, ROCKER, BUCKET = -0.75 + 0.35j, 0.30 + 0.62j, 2.46 + 0.06j, 2.90 + 0j
"""On the stick: rod end, foot of the bucket's cylinder, rocker pin, bucket pin."""
ROCKER_ARM, LINK, KNUCKLE = 0.64, 0.60, 0.45 * np.exp(1j * np.radians(100.0))
"""Rocker and link from pin to pin; link pin on the bucket."""

POSES = ([2.672977, 3.038317, 2.666641], [2.25, 2.35, 2.05], [2.80, 2.55, 1.95], [2.0, 3.4, 2.7])


def corner(a, b, opposite):
    """Angle between sides a and b of a triangle [rad]."""
    return np.arccos((a * a + b * b - opposite * opposite) / (2 * a * b))


def apex(a, b, from_a, from_b):
    """The point left of a-b at these distances from a and b."""
    return a + from_a * (b - a) / abs(b - a) * np.exp(1j * corner(from_a, abs(b - a), from_b))


class Front(NamedTuple):
    """Directions (unit, complex) of all bodies, and pins in the world."""

    boom: complex
    stick: complex
    bucket: complex
    knee: complex  #: Pin of rocker, link and bucket rod.
    knuckle: complex  #: Pin of link and bucket.


def front(lengths):
    boom_length, stick_length, bucket_length = lengths
    arm = BOOM_BARREL - FOOT
    turned = corner(abs(arm), abs(BOOM_EYE), boom_length)
    boom = np.exp(1j * (np.angle(arm) + turned - np.angle(BOOM_EYE)))
    back = STICK_BARREL - STICK
    turned = corner(abs(back), abs(STICK_EYE), stick_length)
    stick = boom * np.exp(1j * (np.angle(back) - turned - np.angle(STICK_EYE)))
    knee = apex(BUCKET_BARREL, ROCKER, bucket_length, ROCKER_ARM)
    knuckle = apex(knee, BUCKET, LINK, abs(KNUCKLE))
    pin = FOOT + boom * STICK
    bucket = stick * (knuckle - BUCKET) / KNUCKLE
    return Front(boom, stick, bucket, pin + stick * knee, pin + stick * knuckle)


def weights(lengths):
    """(mass, place) of all bodies but the boom's cylinders, then of those: barrel, rod, rod end."""
    f = front(lengths)
    pin = FOOT + f.boom * STICK
    joint = pin + f.stick * BUCKET
    stick_foot, stick_eye = FOOT + f.boom * STICK_BARREL, pin + f.stick * STICK_EYE
    bucket_foot, rocker = pin + f.stick * BUCKET_BARREL, pin + f.stick * ROCKER

    def towards(start, end):
        return (end - start) / abs(end - start)

    along_stick, along_bucket = towards(stick_foot, stick_eye), towards(bucket_foot, f.knee)
    bodies = [
        (1900.0, FOOT + f.boom * (2.70 + 0.62j)),
        (950.0, pin + f.stick * (0.95 + 0.12j)),
        (850.0, joint + f.bucket * (0.55 + 0.40j)),
        (1700.0, joint + f.bucket * (0.72 + 0.32j)),
        (180.0, stick_foot + 0.90 * along_stick),
        (120.0, stick_eye - 0.90 * along_stick),
        (110.0, bucket_foot + 0.72 * along_bucket),
        (70.0, f.knee - 0.68 * along_bucket),
        (60.0, rocker + 0.32 * towards(rocker, f.knee)),
        (50.0, f.knee + 0.30 * towards(f.knee, f.knuckle)),
    ]
    eye = FOOT + f.boom * BOOM_EYE
    along = towards(BOOM_BARREL, eye)
    return bodies, [(240.0, BOOM_BARREL + 0.80 * along), (140.0, eye - 0.75 * along)], eye


def potential(lengths):
    """Potential energy [J]."""
    bodies, boom_cylinders, _ = weights(lengths)
    return sum(mass * G * place.imag for mass, place in bodies + boom_cylinders)


def slopes(energy, lengths, step=1e-5):
    """Slope of an energy with each length [N]."""
    return [
        (energy(lengths + step * unit) - energy(lengths - step * unit)) / (2 * step)
        for unit in np.eye(3)
    ]


def boom_force(lengths):
    """Force of the boom's cylinders by moments about their foot and about the boom's."""
    bodies, boom_cylinders, eye = weights(lengths)
    along = (eye - BOOM_BARREL) / abs(eye - BOOM_BARREL)
    # The cylinders lie on their foot and on the rod end: across, a lever; along, the rod's weight.
    lying = sum(m * G * (place - BOOM_BARREL).real for m, place in boom_cylinders)
    across = -lying / abs(eye - BOOM_BARREL)
    arm = eye - FOOT
    load = sum(m * G * (place - FOOT).real for m, place in bodies)
    moment_across = (arm.conjugate() * (across * 1j * along)).imag
    moment_along = (arm.conjugate() * along).imag
    return (load - moment_across) / moment_along + boom_cylinders[1][0] * G * along.imag


def excavator(hydraulics=None):
    return attach_hydraulics(
        models.model_path("excavator.xml"),
        CYLINDERS,
        models.model_path("excavator_hydraulics.toml") if hydraulics is None else hydraulics,
        payload=["load"],
    )


def leaking(tmp_path, **lines):
    """The shipped parameter file with leaks, each (value, unit), in the boom's cylinders only."""
    text = models.model_path("excavator_hydraulics.toml").read_text()
    text = text.replace("leak_rate = { value = 1.0", "leak_rate = { value = 0.0")
    table = "[excavator.actuators.boom_cylinder]\n"
    own = "".join(
        f'{name} = {{ value = {value}, unit = "{unit}", status = "assumed", source = "test" }}\n'
        for name, (value, unit) in lines.items()
    )
    file = tmp_path / "own.toml"
    file.write_text(text.replace(table, table + own))
    return file


@pytest.fixture(scope="module")
def plant():
    return excavator()


@pytest.fixture(scope="module")
def path(plant):
    table = np.genfromtxt(models.model_path("excavator_cycle.csv"), delimiter=",", names=True)
    lengths = np.column_stack([table[name] for name in plant.actuators])
    return waypoints(table["time"], lengths - plant.neutral)


@pytest.fixture(scope="module")
def cycle(plant, path):
    law = load_law(models.model_path("excavator_laws.toml"))
    return simulate(plant, law, path, legs=True, start=plant.configuration(path[0]))


# Geometry and statics


@pytest.mark.parametrize("lengths", POSES)
def test_joint_angles_follow_from_cylinder_lengths(plant, lengths):
    qpos = plant.configuration(np.array(lengths) - plant.neutral)
    angle = {n: qpos[plant.model.joint(n).qposadr[0]] for n in ("boom", "stick", "bucket")}
    f = front(lengths)
    assert angle["boom"] == pytest.approx(np.angle(f.boom), abs=1e-5)
    assert angle["stick"] == pytest.approx(np.angle(f.stick / f.boom), abs=1e-5)
    assert angle["bucket"] == pytest.approx(np.angle(f.bucket / f.stick), abs=1e-5)
    for site, place in (("link", f.knee), ("bucket", FOOT + f.boom * STICK + f.stick * BUCKET)):
        found = plant.data.body(site).xpos
        assert found == pytest.approx([place.real, 0.0, place.imag], abs=1e-5)


@pytest.mark.parametrize("lengths", POSES)
def test_static_forces_are_the_slope_of_the_potential_energy(plant, lengths):
    plant.start(plant.configuration(np.array(lengths) - plant.neutral))
    assert plant.static_load() == pytest.approx(slopes(potential, lengths), rel=1e-4, abs=20.0)


def test_the_machine_moves_through_its_whole_range_closed(plant):
    """All corners of the three strokes can be put together, and the supply holds the load there."""
    ends = 0.98 * plant.hydraulics.cylinder.half_stroke
    for signs in np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(-1, 3):
        state = plant.start(plant.configuration(signs * ends))
        assert plant.extensions() == pytest.approx(signs * ends, abs=1e-9)
        assert np.abs(plant.data.efc_pos[: plant.data.ne]).max() < 1e-9
        assert (state.pressure <= plant.hydraulics.supply.pressure * (1 + 1e-12)).all()


# Holding


def test_a_leaking_boom_sinks_at_the_computed_rate(tmp_path):
    """The bearing drains both chambers, which the piston's larger leak keeps at one pressure p.

    Their content C = V r(p), r = exp(p / beta), falls by B (p - Pt); p = F / D with D = A_cap -
    A_rod. As the boom sinks its load changes by F' and the oil with it, so that

        v = B (p - Pt) / (r (D + V F' / (beta D)))
    """
    plant = excavator(leaking(tmp_path, leak_rate=(15.0, "1/s"), bearing_leakage=(2e-14, _SI)))
    record = drive(plant, np.zeros((20 * 2048, 3)), record_every=32)
    start, end = np.searchsorted(record.time, [10.0, 19.5])
    sunk = record["leg_extension"][start, 0] - record["leg_extension"][end, 0]
    lengths = record["leg_extension"][[start, end]].mean(axis=0) + plant.neutral
    cylinder, tank = plant.hydraulics.cylinder[0], plant.hydraulics.supply.return_pressure
    difference, beta = cylinder.cap_area - cylinder.rod_area, plant.hydraulics.oil.bulk_modulus
    step = np.array([1e-3, 0.0, 0.0])
    slope = (boom_force(lengths + step) - boom_force(lengths - step)) / 2e-3
    pressure = boom_force(lengths) / difference
    volume = sum(volumes(cylinder, lengths[0] - plant.neutral[0]))
    rate = cylinder.bearing_leakage * (pressure - tank) / np.exp(pressure / beta)
    rate /= difference + volume * slope / (beta * difference)
    assert sunk / (record.time[end] - record.time[start]) == pytest.approx(rate, rel=0.01)
    assert sunk > 4e-4


# Digging


def test_the_cycle_is_followed_within_30_mm(plant, path, cycle):
    error = np.abs(cycle["leg_extension"] - path)
    assert error.max() < 0.030
    assert error[-1].max() < 0.010
    assert np.ptp(cycle["leg_extension"], axis=0).min() > 0.5
    assert plant.data.warning.number.sum() == 0
    assert np.abs(plant.data.efc_pos[: plant.data.ne]).max() < 1e-4


def test_the_supply_sags_as_much_as_the_pumps_swing_back(plant, cycle):
    """P = Ps - w (Q + T dQ/dt) / Qm - Rp Q; all three cylinders move fast at 3 s."""
    own, flow = plant.parameters, cycle["pump_flow"]
    asked = flow + own.pump_lag.si * np.gradient(flow, cycle.time)
    expected = own.supply_pressure.si - own.pump_droop.si * asked / own.pump_flow.si
    expected -= own.pump_line.si * flow
    running = asked > 1e-5
    assert cycle["supply_pressure"][running] == pytest.approx(expected[running], abs=0.02e5)
    fast = np.searchsorted(cycle.time, 3.0)
    assert cycle["supply_pressure"][fast] < 285e5
    assert (np.abs(cycle["leg_velocity"][fast]) > 0.01).all()
    still = np.searchsorted(cycle.time, 6.0)
    assert cycle["supply_pressure"][still] > 319e5


def test_oil_and_energy_are_accounted_for(plant, cycle):
    balance = power_balance(plant, cycle)
    assert balance.oil == pytest.approx(balance.oil[0], rel=1e-9)
    # Near its stop, from 7 s on, the bucket's piston works on a volume that stays.
    given, open_by = balance.delivered[-1], np.abs(balance.residual)
    assert given > 1e6
    assert open_by[cycle.time <= 7.0].max() < 2e-8 * given
    assert open_by.max() < 5e-5 * given
    # What reaches the rods lifts the machine; at rest between two strokes nothing is in its motion.
    friction = cycle["energy"][:, ENERGIES.index("friction")]
    for time in (6.0, 10.5, 14.5):
        row = np.argmin(np.abs(cycle.time - time))
        lengths = cycle["leg_extension"][[0, row]] + plant.neutral
        lifted = potential(lengths[1]) - potential(lengths[0])
        assert balance.work[row] - friction[row] == pytest.approx(lifted, abs=1e3)
        assert abs(lifted) > 10e3


def test_more_in_the_bucket_raises_the_pressure_that_holds_it(plant):
    """A weight W at height y(L) of the load presses the cylinders with W dy/dL more."""
    weight = 10e3
    record = drive(
        plant,
        np.zeros((6 * 2048, 3)),
        events=[Event(at=1.0, kind="overload", size=(weight, "N"))],
        record_every=16,
    )

    def energy(lengths):
        return potential(lengths) + weight * weights(lengths)[0][3][1].imag

    last = slice(-2 * 2048 // 16, None)
    lengths = record["leg_extension"][last].mean(axis=0) + plant.neutral
    expected = slopes(energy, lengths)
    assert record["leg_force"][last].mean(axis=0) == pytest.approx(expected, rel=0.01, abs=200.0)
    assert expected[0] > slopes(potential, lengths)[0] + 50e3
