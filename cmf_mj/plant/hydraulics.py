"""Composes valve, cylinder and supply into n actuators and advances them one mechanical step.

The mechanics hands over where the legs were at the two ends of the step. Since a chamber obeys

    d/dt (p + beta ln V) = (beta / V) (q_port -+ q_leak),

the displacement enters exactly, through the volumes, and only the flows are integrated: by the
two-stage singly diagonally implicit Runge-Kutta method of Alexander (1977),

    gamma = 1 - 1/sqrt(2),  stages at gamma t and t,

second order and L-stable, so that a chamber near its stop or with no pressure across its port,
whose rates reach 1e5 1/s, is as harmless as one in mid-stroke. Each stage solves the two chamber
pressures by Newton iteration with the exact 2 by 2 Jacobian.

State, (n, 4): drive output, opening (fractions), cap pressure, rod pressure [Pa].
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.compiled import compiled
from cmf_mj.parameters import HydraulicParameters
from cmf_mj.plant.cylinder import Cylinder, force, holding_pressures, make_cylinder, volumes
from cmf_mj.plant.supply import Supply, make_supply
from cmf_mj.plant.valve import Valve, lag_weights, lags, make_valve, port_flows

DRIVE, OPENING, CAP, ROD = 0, 1, 2, 3
"""Columns of the state."""

_GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
_TOLERANCE = 1.0
"""Last Newton change accepted [Pa]; convergence is quadratic, the error left is below 1e-6 Pa."""
_ITERATIONS = 30


class Hydraulics(NamedTuple):
    """Compiled parameters of n equal actuators on one supply."""

    valve: Valve
    cylinder: Cylinder
    supply: Supply


def make_hydraulics(parameters: HydraulicParameters) -> Hydraulics:
    """Derive all elements from a parameter set."""
    return Hydraulics(make_valve(parameters), make_cylinder(parameters), make_supply(parameters))


def rest(hydraulics: Hydraulics, load: NDArray[np.float64]) -> NDArray[np.float64]:
    """State (n, 4) that holds the static loads [N] with closed valves."""
    supply = hydraulics.supply
    state = np.zeros((load.shape[0], 4))
    state[:, CAP:] = holding_pressures(
        hydraulics.cylinder, load, supply.pressure, supply.return_pressure
    )
    return state


@compiled
def _stage(hydraulics, opening, cap_volume, rod_volume, cap_known, rod_known, weight, cap, rod):  # type: ignore[no-untyped-def]
    """Solve p - known = weight (beta / V) Q(p) for both chambers, from the guess (cap, rod).

    Returns:
        (p_cap, p_rod), and the rates (beta / V) Q of both chambers [Pa/s].
    """
    cylinder = hydraulics.cylinder
    cap_rate = cylinder.bulk_modulus / cap_volume
    rod_rate = cylinder.bulk_modulus / rod_volume
    leak = cylinder.leakage
    for _ in range(_ITERATIONS):
        cap_flow, rod_flow, cap_slope, rod_slope = port_flows(
            hydraulics.valve, opening, hydraulics.supply, cap, rod
        )
        leakage = leak * (cap - rod)
        cap_error = cap - cap_known - weight * cap_rate * (cap_flow - leakage)
        rod_error = rod - rod_known - weight * rod_rate * (rod_flow + leakage)
        cap_cross = weight * cap_rate * leak
        rod_cross = weight * rod_rate * leak
        cap_own = 1.0 - weight * cap_rate * cap_slope + cap_cross
        rod_own = 1.0 - weight * rod_rate * rod_slope + rod_cross
        determinant = cap_own * rod_own - cap_cross * rod_cross
        cap_change = (rod_own * cap_error + cap_cross * rod_error) / determinant
        rod_change = (cap_own * rod_error + rod_cross * cap_error) / determinant
        cap -= cap_change
        rod -= rod_change
        if abs(cap_change) + abs(rod_change) < _TOLERANCE:
            break
    return cap, rod, (cap - cap_known) / weight, (rod - rod_known) / weight


@compiled
def advance(hydraulics, state, command, before, after, step):  # type: ignore[no-untyped-def]
    """Advance all actuators by one mechanical step, in place.

    Args:
        hydraulics: parameters.
        state: (n, 4), overwritten.
        command: (n,) command fractions held over the step.
        before: (n,) extensions at the start [m].
        after: (n,) extensions at the end [m].
        step: length of the step [s].
    """
    cylinder = hydraulics.cylinder
    beta = cylinder.bulk_modulus
    weight = _GAMMA * step
    inner_lags = lag_weights(hydraulics.valve, weight)
    outer_lags = lag_weights(hydraulics.valve, step)
    for leg in range(state.shape[0]):
        drive, opening = state[leg, 0], state[leg, 1]
        cap, rod = state[leg, 2], state[leg, 3]
        cap_start, rod_start = volumes(cylinder, before[leg])

        _, opening_inner = lags(inner_lags, command[leg], drive, opening)
        cap_inner, rod_inner = volumes(cylinder, before[leg] + _GAMMA * (after[leg] - before[leg]))
        cap_known = cap + beta * np.log(cap_start / cap_inner)
        rod_known = rod + beta * np.log(rod_start / rod_inner)
        cap_guess, rod_guess, cap_rate, rod_rate = _stage(
            hydraulics, opening_inner, cap_inner, rod_inner, cap_known, rod_known, weight, cap, rod
        )

        drive, opening = lags(outer_lags, command[leg], drive, opening)
        cap_end, rod_end = volumes(cylinder, after[leg])
        rest_of_step = step - weight
        cap_known = cap + rest_of_step * cap_rate + beta * np.log(cap_start / cap_end)
        rod_known = rod + rest_of_step * rod_rate + beta * np.log(rod_start / rod_end)
        cap, rod, _, _ = _stage(
            hydraulics,
            opening,
            cap_end,
            rod_end,
            cap_known,
            rod_known,
            weight,
            cap_guess,
            rod_guess,
        )
        state[leg, 0], state[leg, 1] = drive, opening
        state[leg, 2], state[leg, 3] = cap, rod


@compiled
def forces(hydraulics, state, out):  # type: ignore[no-untyped-def]
    """Axial forces of all actuators [N], (n,), written to `out`."""
    for leg in range(state.shape[0]):
        out[leg] = force(hydraulics.cylinder, state[leg, 2], state[leg, 3])
