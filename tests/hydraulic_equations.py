"""The hydraulics' documented equations, written apart from the package, for the tests."""

import numpy as np

from cmf_mj.parameters import HydraulicParameters
from cmf_mj.plant.hydraulics import advance, forces, make_hydraulics, rest

FRAME = 1.0 / 2048.0
MASS = 7200 * 0.45359237  # lbm in kg, exact by definition
WEIGHT = MASS * 9.80665  # lbf is the weight of a pound at standard gravity

EQ_4_1 = np.roots([1, 491.9, 1.481e4, 2.488e6, 4.526e7, 8.755e6, 4.32e4])
"""Poles of Eq 4.1 from its printed denominator: -471.24, -0.807 +- 70.999j, -18.85, -0.190, ..."""


def with_leak_rate(parameters: HydraulicParameters, rate: float) -> HydraulicParameters:
    table = parameters.model_dump()
    table["leak_rate"]["value"] = rate
    return HydraulicParameters.model_validate(table)


def without_leakage(parameters: HydraulicParameters) -> HydraulicParameters:
    return with_leak_rate(parameters, 0.0)


def rates(
    p: HydraulicParameters, state: np.ndarray, command: float, x: float, v: float
) -> np.ndarray:
    """d/dt (drive, opening, p_cap, p_rod), written from the documented equations alone."""
    drive, opening, cap, rod = state
    bore, stem = p.bore_diameter.value * 0.0254, p.rod_diameter.value * 0.0254
    cap_area, rod_area = np.pi / 4 * bore**2, np.pi / 4 * (bore**2 - stem**2)
    half, gap = p.half_stroke.value * 0.0254, p.minimum_gap.value * 0.0254
    psi = 0.45359237 * 9.80665 / 0.0254**2
    supply, tank = p.supply_pressure.value * psi, p.return_pressure.value * psi
    beta, transition = p.bulk_modulus.value * psi, p.transition_pressure.value * psi
    speed = p.leg_speed.value * 0.0254 * 100 / np.sqrt((supply - tank) / 2)
    leakage = p.leak_rate.value * half * (cap_area + rod_area) / (4 * beta)

    def phi(drop: float) -> float:
        return drop / (drop**2 + transition**2) ** 0.25

    if opening >= 0:
        cap_flow = speed * cap_area * opening * phi(supply - cap)
        rod_flow = -speed * rod_area * opening * phi(rod - tank)
    else:
        cap_flow = speed * cap_area * opening * phi(cap - tank)
        rod_flow = -speed * rod_area * opening * phi(supply - rod)
    leak = leakage * (cap - rod)
    return np.array(
        [
            2 * np.pi * p.drive_lag.value * (command - drive),
            2 * np.pi * p.valve_lag.value * (drive - opening),
            beta / (cap_area * max(half + x, gap)) * (cap_flow - leak - cap_area * v),
            beta / (rod_area * max(half - x, gap)) * (rod_flow + leak + rod_area * v),
        ]
    )


def one_step(parameters: HydraulicParameters, step: float, z: np.ndarray) -> np.ndarray:
    """Leapfrog of one 7200 lbm leg with `advance`: z = (drive, opening, p_cap, p_rod, x, v)."""
    hydraulics = make_hydraulics(parameters)
    load = np.empty(1)
    state = z[None, :4].copy()
    forces(hydraulics, state, load)
    v = z[5] + step * (load[0] - WEIGHT) / MASS
    x = z[4] + step * v
    advance(hydraulics, state, np.zeros(1), z[4:5], np.array([x]), step)
    return np.array([*state[0], x, v])


def jacobian(function, at: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Central differences, each column by its own scale."""
    columns = []
    for i, size in enumerate(scale):
        nudge = np.zeros(at.size)
        nudge[i] = size
        columns.append((function(at + nudge) - function(at - nudge)) / (2 * size))
    return np.column_stack(columns)


SCALE = np.array([1e-5, 1e-5, 1e3, 1e3, 1e-5, 1e-4])
"""Steps of the finite differences for (drive, opening, p_cap, p_rod, x, v), SI."""


def neutral(parameters: HydraulicParameters) -> np.ndarray:
    state = rest(make_hydraulics(parameters), np.array([WEIGHT]))
    return np.array([*state[0], 0.0, 0.0])
