"""Feedback calculations: sensor signals to what the compensator reads (Figure 2-6).

    a[k+1] = pole a[k] + gain a_measured[k]          accelerometer filter, Eq 3.6
    F = (p_cap - p_rod) A,  A = 11.97 in^2 (CMF)     force from pressures, Eq 3.7

Eq 3.5 prints 0.312 / (0.2 s + 0.312); Eq 3.6 is the zero-order hold with 0.02 s and is what runs.

Where accelerometers feel gravity, the electronics hand over readings without it, unless the law
has `gravity_compensation = false`.

**Dynamic load pressure feedback**: damping from what the cylinders push, not from what they hold.

    F = A_cap p_cap - A_rod p_rod,    h = F - m a_plan,    output -= K_f (h - z)
    z[k+1] = z[k] + (1 - e^(-w T)) (h[k] - z[k]),    w = 2 pi corner

The high-pass takes the static load out. Of a mode m is its mass and a_plan its planned acceleration
(`cmf_mj.control.plan`), so that the plan is not damped; without a plan, a_plan is zero.

Source: H. E. Merritt, Hydraulic Control Systems (1967), section 6-6 (dynamic pressure feedback
valves); J. Watton, Fundamentals of Fluid Power Control (2009), for its electronic form.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.control.coordinates import Modes, PerMode, mode_mass, per_coordinate
from cmf_mj.core import units
from cmf_mj.core.compiled import compiled
from cmf_mj.core.settings import Settings
from cmf_mj.machine.machine import LegSizes


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


@compiled
def filter_acceleration(feedback, filtered, measured):  # type: ignore[no-untyped-def]
    """Next state of the accelerometer filter [m/s^2]; its output is the state itself."""
    return feedback.accelerometer_pole * filtered + feedback.accelerometer_gain * measured


@compiled
def pressure_force(feedback, cap_pressure, rod_pressure):  # type: ignore[no-untyped-def]
    """Force feedback of Eq 3.7 [N]."""
    return (cap_pressure - rod_pressure) * feedback.area


class LoadFeedback(Settings):
    """Gain and corner of dynamic load pressure feedback."""

    gain: PerMode  #: K_f [%/klbf].
    corner: Annotated[float, Field(gt=0.0, le=50.0)]  #: Corner of the high-pass [Hz].


class CompiledLoadFeedback(NamedTuple):
    """Compiled parameters, SI."""

    cap_area: float  #: A_cap [m^2].
    rod_area: float  #: A_rod [m^2].
    gain: NDArray[np.float64]  #: K_f, (n,) [1/N].
    mass: NDArray[np.float64]  #: m, (n,) [kg]; 0 where the law knows none.
    filter_gain: float  #: 1 - e^(-w T).


def make_load_feedback(
    settings: LoadFeedback | None, sizes: LegSizes, modes: Modes | None, legs: int, frame: float
) -> CompiledLoadFeedback:
    """Compile the block; None for none. Modes are those of a plan, whose forces are not damped."""
    mass = np.zeros(legs) if modes is None else mode_mass(modes)
    cap_area, rod_area = sizes.cap_area, sizes.rod_area
    if settings is None:
        return CompiledLoadFeedback(cap_area, rod_area, np.zeros(legs), mass, 0.0)
    gain = per_coordinate(settings.gain, legs) * units.PERCENT / (1000.0 * units.POUND_FORCE)
    filter_gain = float(-np.expm1(-2.0 * np.pi * settings.corner * frame))
    return CompiledLoadFeedback(cap_area, rod_area, gain, mass, filter_gain)


@compiled
def load_force(block, mode, feedback, acceleration):  # type: ignore[no-untyped-def]
    """Force h of one mode [N]; `acceleration` is the planned one."""
    cap_force = block.cap_area * feedback.cap_pressure[mode]
    rod_force = block.rod_area * feedback.rod_pressure[mode]
    return cap_force - rod_force - block.mass[mode] * acceleration


@compiled
def damp_load(block, static_force, mode, feedback, acceleration):  # type: ignore[no-untyped-def]
    """Command of one mode, fraction; its low-passed force `static_force[mode]` moves on."""
    force_change = load_force(block, mode, feedback, acceleration) - static_force[mode]
    static_force[mode] += block.filter_gain * force_change
    return -block.gain[mode] * force_change
