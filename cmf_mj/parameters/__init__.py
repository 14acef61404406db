"""Immutable parameter sets: each number with its unit, status and source."""

from cmf_mj.parameters.hydraulics import (
    ACTUATOR_FIELDS,
    VALVE_FIELDS,
    VALVES,
    ActuatorChanges,
    HydraulicParameters,
    ValveChanges,
)
from cmf_mj.parameters.loading import HYDRAULICS, load_hydraulics
from cmf_mj.parameters.quantity import Quantity, positive_in

__all__ = [
    "ACTUATOR_FIELDS",
    "HYDRAULICS",
    "VALVES",
    "VALVE_FIELDS",
    "ActuatorChanges",
    "HydraulicParameters",
    "Quantity",
    "ValveChanges",
    "load_hydraulics",
    "positive_in",
]
