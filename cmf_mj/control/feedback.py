"""Feedback calculations: sensor signals to what the compensator reads (Figure 2-6).

    a[k+1] = pole a[k] + gain a_measured[k]          accelerometer filter, Eq 3.6
    F = (p_cap - p_rod) A,  A = 11.97 in^2           force from pressures, Eq 3.7

Eq 3.5 prints a time constant of 0.2 s; Eq 3.6 is the zero-order hold of 0.02 s and is what runs.
"""

from typing import NamedTuple

from cmf_mj import units
from cmf_mj.compiled import compiled
from cmf_mj.control.law import Law

FORCE_AREA = 11.97 * units.INCH**2
"""Area the pressure difference acts on in Eq 3.7 [m^2]: the annulus, as the report states it."""


class Feedback(NamedTuple):
    """Compiled parameters of the feedback block."""

    accelerometer_pole: float
    """Pole of Eq 3.6, per frame."""
    accelerometer_gain: float
    """Gain of Eq 3.6."""
    force_area: float
    """A of Eq 3.7 [m^2]."""


def make_feedback(law: Law) -> Feedback:
    """Take the feedback block's parameters from a law."""
    return Feedback(law.accelerometer_pole, law.accelerometer_gain, FORCE_AREA)


@compiled
def filter_acceleration(feedback, filtered, measured):  # type: ignore[no-untyped-def]
    """Next state of the accelerometer filter [m/s^2]; its output is the state itself."""
    return feedback.accelerometer_pole * filtered + feedback.accelerometer_gain * measured


@compiled
def pressure_force(feedback, cap_pressure, rod_pressure):  # type: ignore[no-untyped-def]
    """Force feedback of Eq 3.7 [N]."""
    return (cap_pressure - rod_pressure) * feedback.force_area
