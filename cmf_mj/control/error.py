"""Error calculations: position error, its integral and its filtered rate (Figures 3-1, 3-5, 3-7).

With e = reference - position and T the frame:

    integral:   I[k+1] = clip(I[k] + T e_i[k], +-limit),  e_i = reference - position above the
                trigger, reference - (-37.5 in, the lower end) below it
    rates:      d = p (s - z),  z[k+1] = z[k] + T d[k]   for s = e and for s = reference

The rate of s is thus s p / (s + p), built from an integrator as in Figure 3-6. The velocity error
subtracts the measured velocity unfiltered.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.compiled import compiled
from cmf_mj.machine.machine import load_machine


class ErrorState(NamedTuple):
    """State of the error block, every array (n,), by leg or mode but for the integral."""

    integral: NDArray[np.float64]  #: Error integral by leg [m s].
    position_filter: NDArray[np.float64]  #: Derivative filter of the position error [m].
    reference_filter: NDArray[np.float64]  #: Derivative filter of the reference [m].


class ErrorCalculations(NamedTuple):
    """Compiled parameters of the error block."""

    derivative_pole: float  #: p [rad/s].
    integrator_limit: float  #: Saturation of the integral [m s].
    integrator_trigger: float  #: Position below which the integrator sees the bottom [m].
    travel: float  #: Working stroke either way [m]; the bottom is its lower end.
    frame: float  #: T [s].


def make_error_calculations(law: Law, travel: float) -> ErrorCalculations:
    """Take the error block's parameters from a law, on legs of a working stroke +-travel [m].

    The trigger is as far above their lower end as above that of the CMF's.
    """
    return ErrorCalculations(
        derivative_pole=law.derivative_pole,
        integrator_limit=law.integrator_limit * units.INCH,
        integrator_trigger=law.integrator_trigger * units.INCH
        + (load_machine().working_stroke - travel),
        travel=travel,
        frame=law.frame,
    )


@compiled
def filtered_rate(error, signal, state):  # type: ignore[no-untyped-def]
    """Rate of `signal` [1/s] and the filter's next state."""
    rate = error.derivative_pole * (signal - state)
    return rate, state + error.frame * rate


@compiled
def integrate(error, integral, reference, position):  # type: ignore[no-untyped-def]
    """Next value of the error integral of one leg [m s]."""
    counted_position = position if position > error.integrator_trigger else -error.travel
    following = integral + error.frame * (reference - counted_position)
    return min(max(following, -error.integrator_limit), error.integrator_limit)
