"""What the supply can carry: one manoeuvre judged, and the largest motion at each frequency."""

from cmf_mj.capacity.asymptotes import Asymptotes, asymptotes, full_speed
from cmf_mj.capacity.envelope import (
    FREQUENCIES,
    LIMITS,
    QUICK_FREQUENCIES,
    Envelope,
    EnvelopePoint,
    largest_sine,
    performance_envelope,
)
from cmf_mj.capacity.manoeuvre import SIGNALS, manoeuvre, read_poses
from cmf_mj.capacity.verdict import LEAST_PRESSURE, CapacityResult, capacity, least_allowed

__all__ = [
    "FREQUENCIES",
    "LEAST_PRESSURE",
    "LIMITS",
    "QUICK_FREQUENCIES",
    "SIGNALS",
    "Asymptotes",
    "CapacityResult",
    "Envelope",
    "EnvelopePoint",
    "asymptotes",
    "capacity",
    "full_speed",
    "largest_sine",
    "least_allowed",
    "manoeuvre",
    "performance_envelope",
    "read_poses",
]
