"""Feedback calculations: sensor signals to what the compensator reads (Figure 2-6).

    a[k+1] = pole a[k] + gain a_measured[k]          accelerometer filter, Eq 3.6
    F = (p_cap - p_rod) A,  A = 11.97 in^2 (CMF)     force from pressures, Eq 3.7

Eq 3.5 prints a time constant of 0.2 s; Eq 3.6 is the zero-order hold of 0.02 s and is what runs.

White noise in the accelerometer leaves its filter smaller by gain / sqrt(1 - pole^2), which for a
gain of 1 - pole is sqrt((1 - pole) / (1 + pole)).

Where accelerometers feel gravity, the DCL knows it along the legs (Appendix C) and takes it out for
the fault detection, and for the law unless that chose `gravity_compensation = false`,

    a = a_measured - g n . up,

with the legs' directions n from the measured positions through its own kinematics. A law of gain
K_a that reads g n . up = 0.832 g at neutral has K_a 0.832 g b / (1 - a) in its command for good,
with filter pole a and gain b.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.machine.gravity import leg_axes_state, make_leg_axes, track, upward
from cmf_mj.machine.kinematics import MachineOrGimbals


class LegFeedback(NamedTuple):
    """What the sensors hand to the DCL, every array (n,)."""

    position: NDArray[np.float64]  #: Leg extension from neutral [m].
    velocity: NDArray[np.float64]  #: Leg velocity [m/s].
    acceleration: NDArray[np.float64]  #: Leg acceleration [m/s^2].
    cap_pressure: NDArray[np.float64]  #: Cap pressure [Pa].
    rod_pressure: NDArray[np.float64]  #: Rod pressure [Pa].


class Feedback(NamedTuple):
    """Compiled parameters of the feedback block."""

    accelerometer_pole: float  #: Pole of Eq 3.6, per frame.
    accelerometer_gain: float  #: Gain of Eq 3.6.
    gravity_compensation: bool  #: Whether the law reads accelerations without gravity.
    area: float  #: A that the pressure difference acts on [m^2].


def make_feedback(law: Law, area: float) -> Feedback:
    """Take the feedback block's parameters from a law, with the area of Eq 3.7 [m^2]."""
    return Feedback(law.accelerometer_pole, law.accelerometer_gain, law.gravity_compensation, area)


@compiled
def filter_acceleration(feedback, filtered, measured):  # type: ignore[no-untyped-def]
    """Next state of the accelerometer filter [m/s^2]; its output is the state itself."""
    return feedback.accelerometer_pole * filtered + feedback.accelerometer_gain * measured


@compiled
def pressure_force(feedback, cap_pressure, rod_pressure):  # type: ignore[no-untyped-def]
    """Force feedback of Eq 3.7 [N]."""
    return (cap_pressure - rod_pressure) * feedback.area


def noise_gain(law: Law) -> float:
    """Rms of white noise behind the accelerometer filter over that before it."""
    return float(law.accelerometer_gain / np.sqrt(1.0 - law.accelerometer_pole**2))


@compiled
def find_gravity(axes, state, position, gravity):  # type: ignore[no-untyped-def]
    """Write g n . up [m/s^2], which accelerometers feel, at measured extensions (6,) [m]."""
    track(axes, state, position)
    for leg in range(6):
        gravity[leg] = units.STANDARD_GRAVITY * upward(state, leg)


@allocating
def _histories(axes, state, position, gravity):  # type: ignore[no-untyped-def]
    for frame in range(position.shape[0]):
        find_gravity(axes, state, position[frame], gravity[frame])


def gravity_history(
    position: NDArray[np.float64], machine: MachineOrGimbals = models.CMF
) -> NDArray[np.float64]:
    """Gravity along six legs at measured extensions (N, 6) [m], as the DCL finds it [m/s^2]."""
    if position.shape[1:] != (6,):
        raise InputError(
            f"position: shape is {position.shape[1:]}; gravity along the legs needs (6,)"
        )
    axes, gravity = make_leg_axes(machine), np.empty(position.shape)
    position = np.ascontiguousarray(position)
    _histories(axes, leg_axes_state(axes, position[0]), position, gravity)
    return gravity
