"""Limits of a machine: those its file states, derived where it states none, or a user's own.

A degree of freedom whose limits nobody stated has, alone from neutral, with J the Jacobian there,

    displacements    at which the first leg ends: its cylinder (mechanical), its working stroke
    rates            leg rate / max_j |J_jd|, of velocity and of acceleration
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.settings import merged, read_toml, validated
from cmf_mj.machine import models
from cmf_mj.machine.geometry import DOFS, by_kind, dof_index
from cmf_mj.machine.kinematics import excursion_envelope, pose_jacobian
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine, load_machine

_REJOIN = {
    "value": 0.5,
    "unit": "1",
    "status": "assumed",
    "source": "half closes in on the demand, half follows the demand's own acceleration",
}  #: Share of the acceleration with which a limited leg closes in on its demand, see `limits.Leg`.


def load_motion_limits(
    source: str | Path | MotionLimits | None = None, machine: str | Path | Machine = models.CMF
) -> MotionLimits:
    """Limits of a machine, or those of a TOML file, which repeats what it changes of them."""
    if isinstance(source, MotionLimits):
        return source
    limits = _machine_limits(load_machine(machine))
    if source is None or source == "default":
        return limits
    table = merged(limits.model_dump(), read_toml(Path(source)), 1)
    return validated(MotionLimits, table, str(source))


def relative_travel(machine: Machine, dof: str) -> float:
    """Operational travel of a machine over the CMF's: what a motion of the CMF is scaled by."""
    index = dof_index(dof)
    travel, cmf_travel = (
        np.abs(load_motion_limits(machine=base).operational[index]).min()
        for base in (machine, models.CMF)
    )
    return float(travel / cmf_travel)


@lru_cache
def _machine_limits(machine: Machine) -> MotionLimits:
    """Limits of a machine as its file states them and as derived."""
    stated = machine.limits.model_dump(exclude_none=True)
    leg = {"position": machine.legs.working_stroke.model_dump(), "rejoin": _REJOIN} | stated["leg"]
    derived = {} if all(dof in stated for dof in DOFS) else _derived(machine)
    return validated(MotionLimits, derived | stated | {"leg": leg}, machine.name)


def _derived(machine: Machine) -> dict[str, Any]:
    """Tables of all degrees of freedom, from geometry and legs."""
    geometry, leg = machine.geometry, machine.limits.leg
    mechanical = excursion_envelope(machine.half_stroke, geometry)
    operational = excursion_envelope(machine.working_stroke, geometry)
    arms = np.abs(pose_jacobian(np.zeros(6), geometry)).max(axis=0)
    to_end, at_rate = (
        "alone from neutral, to the legs'",
        "alone at neutral, where it uses up a leg's",
    )
    tables = {}
    for index, dof in enumerate(DOFS):
        unit, arm = by_kind(dof, "m", "rad"), float(arms[index])
        tables[dof] = {
            "mechanical": _derived_range(f"{to_end} half stroke", unit, mechanical[index]),
            "operational": _derived_range(f"{to_end} working stroke", unit, operational[index]),
            "velocity": _derived_rate(at_rate, f"{unit}/s", leg.velocity.si / arm),
            "acceleration": _derived_rate(at_rate, f"{unit}/s^2", leg.acceleration.si / arm),
        }
    return tables


def _derived_range(source: str, unit: str, ends: NDArray[np.float64]) -> dict[str, Any]:
    low, high = ends.tolist()
    return {"low": low, "high": high, "unit": unit, "status": "derived", "source": source}


def _derived_rate(source: str, unit: str, value: float) -> dict[str, Any]:
    return {"value": value, "unit": unit, "status": "derived", "source": source}
