"""The clamps at both ends of a law: leg demand and valve command (sections 3.2.1 and 2.3.3)."""

from cmf_mj.core.compiled import compiled
from cmf_mj.machine.kinematics import WORKING_STROKE


@compiled
def limit(demand):  # type: ignore[no-untyped-def]
    """The demand of one leg [m], within the working stroke of +-37.5 in."""
    return min(max(demand, -WORKING_STROKE), WORKING_STROKE)


@compiled
def clamp(output):  # type: ignore[no-untyped-def]
    """Valve command of one leg as a fraction, -1 to 1."""
    return min(max(output, -1.0), 1.0)
