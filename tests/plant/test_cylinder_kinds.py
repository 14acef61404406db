"""Symmetric cylinders, one valve or two, hydrostatic and sealed friction, by closed forms."""

from functools import partial
from typing import Any

import hydraulic_equations as equations
import mujoco
import numpy as np
import pytest

import cmf_mj
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.plant.attach import attach_hydraulics
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.plant import Plant

MASS, GRAVITY = 2000.0, 9.80665


changed = partial(equations.changed, "hardware", supply="constant")


def lift(parameters: HydraulicParameters, gravity: float = GRAVITY) -> Plant:
    """A mass on one upright cylinder."""
    spec = mujoco.MjSpec.from_string(
        f"""<mujoco model="lift"><option gravity="0 0 {-gravity}"/><worldbody><body>
        <inertial pos="0 0 0" mass="{MASS}" diaginertia="1 1 1"/>
        <joint name="ram" type="slide" axis="0 0 1" range="-0.9 0.9"/></body>
        </worldbody></mujoco>"""
    )
    return attach_hydraulics(spec, ["ram"], parameters)


def steady_speed(plant: Plant, command: float, seconds: float = 2.0) -> float:
    """Speed after a constant command [m/s]."""
    rows = np.full((round(2048 * seconds), 1), command)
    return float(cmf_mj.drive(plant, rows)["leg_velocity"][-200:].mean())


SYMMETRIC: Any = {"rods": 2.0, "leak_rate": 0.0}


def test_a_symmetric_cylinder_has_equal_areas_and_centres_its_pressures() -> None:
    """p_cap + p_rod = Ps + Pt and (p_cap - p_rod) A = m g; A = pi (bore^2 - rod^2) / 4."""
    parameters = changed(**SYMMETRIC)
    area = 0.25 * np.pi * (0.1397**2 - 0.098425**2)
    assert parameters.cap_area == pytest.approx(area, rel=1e-12)
    assert parameters.rod_area == pytest.approx(area, rel=1e-12)
    cap, rod = lift(parameters).start().pressure[0]
    supply = parameters.supply_pressure.si + parameters.return_pressure.si
    assert cap + rod == pytest.approx(supply, rel=1e-9)
    assert (cap - rod) * area == pytest.approx(MASS * GRAVITY, rel=1e-9)


@pytest.mark.parametrize(("gravity", "overlap"), [(GRAVITY, 0.0), (-GRAVITY, 0.0), (GRAVITY, 0.5)])
def test_a_leaking_symmetric_cylinder_begins_with_the_opening_that_feeds_its_leak(
    gravity: float, overlap: float
) -> None:
    """A force that relaxes at the rate r loses r h (p_cap - p_rod) / (2 beta) of travel a second.
    It comes in again at e V sqrt((Ps - p) / (Ps / 2)), p the higher pressure, V the leg's speed at
    full opening, e the opening beyond the overlap.

    A law with an integral so keeps the leg still from the first frame on; one without begins with
    its valve shut, as with a tight piston. 1 %: laminar flow, oil of a volume.
    """
    p = changed(rods=2.0, leak_rate=15.0, overlap=overlap)
    plant = lift(p, gravity)
    cap, rod = plant.start().pressure[0]
    share = (p.supply_pressure.si - max(cap, rod)) / (0.5 * p.supply_pressure.si)
    lost = p.leak_rate.si * p.half_stroke.si * (cap - rod) / (2.0 * p.bulk_modulus.si)
    expected = lost / (p.leg_speed.si * np.sqrt(share)) + np.sign(gravity) * overlap / 100.0
    still = cmf_mj.simulate(plant, "velocity_integral", np.zeros((2048, 1)), legs=True)
    assert still["valve_command"][0, 0] == pytest.approx(expected, rel=1e-2)
    assert np.abs(still["leg_extension"]).max() < 1e-7
    shut = cmf_mj.simulate(plant, "velocity", np.zeros((2048, 1)), legs=True)
    assert shut["valve_opening"][0, 0] == pytest.approx(0.0, abs=1e-4)
    assert np.abs(shut["leg_extension"]).max() > 1e-5


def test_the_oil_of_a_symmetric_cylinder_is_a_spring_of_twice_one_side() -> None:
    """w^2 m = 2 beta A / h: the mode of the linearised plant with the valve shut."""
    parameters = changed(**SYMMETRIC)
    plant = lift(parameters)
    poles = np.asarray(linearize(plant).poles())
    swing = np.abs(poles[np.abs(poles.imag) > 1.0]).max()
    spring = 2.0 * parameters.bulk_modulus.si * parameters.rod_area / parameters.half_stroke.si
    assert swing == pytest.approx(np.sqrt(spring / MASS), rel=5e-3)


def test_a_symmetric_cylinder_without_load_moves_alike_both_ways() -> None:
    """Out and in at leg_speed per command, half the supply pressure across each port."""
    plant = lift(changed(**SYMMETRIC), gravity=0.0)
    speed = plant.parameters.leg_speed.si * 0.2
    out, back = steady_speed(plant, 0.2), steady_speed(plant, -0.2)
    assert out == pytest.approx(speed, rel=5e-3)
    assert back == pytest.approx(-out, rel=1e-6)


def test_one_valve_gives_the_speed_of_two_in_tandem() -> None:
    """`leg_speed` is that of all valves: the flow gain of one is that of both together; of two in
    tandem with one dead the speed halves, of one it is nothing."""
    both, one = (changed(valves=count) for count in (2.0, 1.0))
    plants = [lift(parameters) for parameters in (both, one)]
    gains = [plant.hydraulics.valve.cap_gain[0] for plant in plants]
    assert gains[1].tolist() == [gains[0].sum(), 0.0]
    speeds = [steady_speed(plant, 0.2) for plant in plants]
    assert speeds[1] == pytest.approx(speeds[0], rel=1e-9)


def test_a_sealed_cylinder_holds_a_shut_leg_and_a_hydrostatic_one_lets_it_creep() -> None:
    """The bearing's leak B p_rod lets the loaded leg with a shut valve sink; a seal's friction
    above the change of load keeps it."""
    sealed = changed(leak_rate=0.0, coulomb_friction=(900.0, "N"), breakaway_friction=(1000.0, "N"))
    creeping = changed(leak_rate=0.0, bearing_leakage=0.01)
    moved = []
    for parameters in (sealed, creeping):
        record = cmf_mj.drive(lift(parameters), np.zeros((4096, 1)))
        moved.append(float(np.ptp(record["leg_extension"])))
    assert moved[0] < 1e-6 < 1e-4 < moved[1]


def test_dead_volumes_soften_the_oil() -> None:
    """w^2 m = beta (A_cap^2 / (A_cap h + D_cap) + A_rod^2 / (A_rod h + D_rod))."""
    parameters = changed(leak_rate=0.0, cap_dead_volume=(4.0, "l"), rod_dead_volume=(9.0, "l"))
    plant = lift(parameters)
    half, oil = parameters.half_stroke.si, plant.hydraulics.oil.bulk_modulus
    sides = ((parameters.cap_area, 4e-3), (parameters.rod_area, 9e-3))
    spring = sum(oil * area**2 / (area * half + dead) for area, dead in sides)
    assert stiffness(plant.hydraulics.cylinder[0], oil, 0.0) == pytest.approx(spring, rel=1e-12)
    poles = np.asarray(linearize(plant).poles())
    swing = np.abs(poles[np.abs(poles.imag) > 1.0]).max()
    assert swing == pytest.approx(np.sqrt(spring / MASS), rel=5e-3)


@pytest.mark.parametrize("command", [0.2, -0.2])
@pytest.mark.parametrize("resistance", [0.0, 2e8])
def test_ports_and_throttle_pass_what_the_pistons_sweep(command: float, resistance: float) -> None:
    """Steady, content q = r A v leaves and enters. Equal ports then share as the squares of q, with
    R q of the throttle in series with the cap's, and lines lose R q^2."""
    ports = changed().cap_area / changed().rod_area
    sharp: Any = {"rod_port": ports, "leak_rate": 0.0, "transition_pressure": 1e-5}
    parameters = changed(cap_throttle=(resistance, "Pa s/m^3"), **sharp)
    plant = lift(parameters)
    record = cmf_mj.drive(plant, np.full((4096, 1), command))
    cap, rod = (float(record[f"{side}_pressure"][-1, 0]) for side in ("cap", "rod"))
    speed = float(record["leg_velocity"][-1, 0])
    swept = parameters.cap_area * equations.content_ratio(parameters, cap) * abs(speed)
    other = parameters.rod_area * equations.content_ratio(parameters, rod) * abs(speed)
    ends = parameters.supply_pressure.si, parameters.return_pressure.si
    high, low = (ends[0] - cap, rod - ends[1]) if command > 0.0 else (cap - ends[1], ends[0] - rod)
    assert high - resistance * swept == pytest.approx(low * (swept / other) ** 2, rel=1e-3)
    lines = np.gradient(record["energy"][:, ENERGIES.index("lines")], record.time)
    assert lines[-2] == pytest.approx(resistance * swept**2, rel=1e-3)


def test_a_tight_cylinder_starts_at_its_rest_pressure() -> None:
    """p_cap = (m g + A_rod p_rod) / A_cap; with leakage the pressures are equal all the same."""
    tight = lift(changed(leak_rate=0.0, rest_pressure=(30.0, "bar")))
    cap, rod = tight.start().pressure[0]
    areas = tight.parameters.cap_area, tight.parameters.rod_area
    assert rod == pytest.approx(30e5)
    assert cap == pytest.approx((MASS * GRAVITY + areas[1] * rod) / areas[0], rel=1e-9)
    leaking = lift(changed(rest_pressure=(30.0, "bar"))).start().pressure[0]
    assert leaking[0] == pytest.approx(leaking[1], rel=1e-9)
