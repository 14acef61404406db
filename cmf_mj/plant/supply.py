"""Hydraulic supply: constant supply and return pressure shared by all actuators."""

from typing import NamedTuple

from cmf_mj.parameters import HydraulicParameters


class Supply(NamedTuple):
    """Compiled parameters of the supply."""

    pressure: float
    """Ps [Pa], gauge."""
    return_pressure: float
    """Pt [Pa], gauge."""


def make_supply(parameters: HydraulicParameters) -> Supply:
    """Derive the supply from a parameter set."""
    return Supply(parameters.supply_pressure.si, parameters.return_pressure.si)
