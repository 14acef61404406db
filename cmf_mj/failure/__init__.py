"""Failure study: one event during a manoeuvre, what the legs and the crew feel, how it ends.

The manoeuvre is a sine in one degree of freedom from rest to rest. The event strikes at a set
time; with protection on, the first detected fault makes an emergency stop.
"""

from cmf_mj.failure.manoeuvre import AFTER, AMPLITUDES, AT, FREQUENCY, manoeuvre
from cmf_mj.failure.measures import FALL_SPEED, FOLLOWING, STATES, FailureResult, Peak
from cmf_mj.failure.runs import run_failure, run_failures

__all__ = [
    "AFTER",
    "AMPLITUDES",
    "AT",
    "FALL_SPEED",
    "FOLLOWING",
    "FREQUENCY",
    "STATES",
    "FailureResult",
    "Peak",
    "manoeuvre",
    "run_failure",
    "run_failures",
]
