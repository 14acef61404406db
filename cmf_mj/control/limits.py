"""Limit calculations: the leg demand is held within the working stroke of +-37.5 in."""

from typing import NamedTuple

from cmf_mj.core.compiled import compiled
from cmf_mj.machine import kinematics


class Limits(NamedTuple):
    """Compiled parameters of the limit block."""

    travel: float  #: Largest leg demand from neutral, either way [m].


def make_limits() -> Limits:
    """The limits of section 3.2.1."""
    return Limits(kinematics.WORKING_STROKE)


@compiled
def limit(limits, demand):  # type: ignore[no-untyped-def]
    """The demand of one leg [m], clamped."""
    return min(max(demand, -limits.travel), limits.travel)
