"""Double-acting cylinder: force, chamber volumes, stiffness and the pressures of a held load.

With x the leg extension from neutral and h the half stroke (no dead volume),

    F = A_cap p_cap - A_rod p_rod,    V_cap = A_cap (h + x),    V_rod = A_rod (h - x)
    V dp/dt = beta (q - dV/dt),       leakage q = L (p_cap - p_rod) from cap to rod

so the oil is a spring of stiffness K(x) = beta (A_cap / (h + x) + A_rod / (h - x)), and K(0) over
7200 lbm is (71.00 rad/s)^2, the leg mode of Eq 4.1.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.compiled import compiled
from cmf_mj.parameters import HydraulicParameters


class Cylinder(NamedTuple):
    """Compiled parameters of one cylinder."""

    cap_area: float
    """A_cap [m^2]."""
    rod_area: float
    """A_rod [m^2]."""
    half_stroke: float
    """h [m]."""
    minimum_gap: float
    """Chamber length below which the volume is held [m]."""
    bulk_modulus: float
    """beta [Pa]."""
    leakage: float
    """L [m^3/s/Pa]."""


def make_cylinder(parameters: HydraulicParameters) -> Cylinder:
    """Derive the cylinder from a parameter set."""
    return Cylinder(
        cap_area=parameters.cap_area,
        rod_area=parameters.rod_area,
        half_stroke=parameters.half_stroke.si,
        minimum_gap=parameters.minimum_gap.si,
        bulk_modulus=parameters.bulk_modulus.si,
        leakage=parameters.leakage,
    )


@compiled
def force(cylinder, cap_pressure, rod_pressure):  # type: ignore[no-untyped-def]
    """Axial force on the rod, positive extending [N]."""
    return cylinder.cap_area * cap_pressure - cylinder.rod_area * rod_pressure


@compiled
def volumes(cylinder, extension):  # type: ignore[no-untyped-def]
    """Chamber volumes (V_cap, V_rod) [m^3] at an extension from neutral [m]."""
    cap = max(cylinder.half_stroke + extension, cylinder.minimum_gap)
    rod = max(cylinder.half_stroke - extension, cylinder.minimum_gap)
    return cylinder.cap_area * cap, cylinder.rod_area * rod


def stiffness(cylinder: Cylinder, extension: ArrayLike) -> NDArray[np.float64]:
    """K(x), stiffness of the enclosed oil [N/m], one value per extension [m]."""
    x = np.asarray(extension, dtype=float)
    cap = np.maximum(cylinder.half_stroke + x, cylinder.minimum_gap)
    rod = np.maximum(cylinder.half_stroke - x, cylinder.minimum_gap)
    return cylinder.bulk_modulus * (cylinder.cap_area / cap + cylinder.rod_area / rod)


def holding_pressures(
    cylinder: Cylinder, load: ArrayLike, supply: float, tank: float
) -> NDArray[np.float64]:
    """Pressures (n, 2) of cap and rod that hold static loads with the valve closed.

    Piston leakage ends at p_cap = p_rod = F / (A_cap - A_rod); without leakage any pair with the
    right force stays, and the valve's own null p_cap + p_rod = Ps + Pt is taken. The pair is kept
    between return and supply pressure as far as the load allows.

    Args:
        cylinder: parameters.
        load: axial leg forces [N], (n,), positive pressing the leg together.
        supply: supply pressure [Pa].
        tank: return pressure [Pa].

    Raises:
        ValueError: a load is beyond the stall forces; the message names leg, load and range.
    """
    loads = np.atleast_1d(np.asarray(load, dtype=float))
    cap_area, rod_area = cylinder.cap_area, cylinder.rod_area
    low = cap_area * tank - rod_area * supply
    high = cap_area * supply - rod_area * tank
    for leg, value in enumerate(loads, start=1):
        if not low <= value <= high:
            raise ValueError(
                f"static load of leg {leg}: {value:.0f} N cannot be held by a supply of "
                f"{supply:.0f} Pa; allowed: {low:.0f} to {high:.0f} N"
            )
    if cylinder.leakage > 0.0:
        rod = loads / (cap_area - rod_area)
    else:
        rod = (cap_area * (supply + tank) - loads) / (cap_area + rod_area)
    # p_rod must lie in [tank, supply] and so must p_cap = (F + A_rod p_rod) / A_cap.
    least = np.maximum(tank, (cap_area * tank - loads) / rod_area)
    most = np.minimum(supply, (cap_area * supply - loads) / rod_area)
    rod = np.clip(rod, least, most)
    return np.column_stack([(loads + rod_area * rod) / cap_area, rod])
