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
