"""Compensator calculations: x+ = A x + B u, y = C x + D u for each leg (Figures 2-8 to 2-10)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.coordinates import spread
from cmf_mj.control.law import SIGNAL_UNITS, SIGNALS, Gains, Law
from cmf_mj.core import units
from cmf_mj.core.compiled import compiled


class Compensator(NamedTuple):
    """Compiled gains, SI: signals in m, Pa, m/s, m s, m/s^2, N; output as command fraction."""

    state_gain: NDArray[np.float64]  #: A, (n,).
    input_gain: NDArray[np.float64]  #: B, (n, 10).
    output_gain: NDArray[np.float64]  #: C, (n,) [fraction per unit of state].
    direct_gain: NDArray[np.float64]  #: D, (n, 10) [fraction per SI unit of the signal].


def make_compensator(law: Law, legs: int) -> Compensator:
    """Convert a law's published gains to SI, the same for every leg or by mode."""

    def row(gains: Gains, scale: float) -> NDArray[np.float64]:
        values = [
            spread(getattr(gains, name), legs) * scale / SIGNAL_UNITS[name] for name in SIGNALS
        ]
        return np.ascontiguousarray(np.array(values).T)

    return Compensator(
        state_gain=np.full(legs, law.state_gain),
        input_gain=row(law.input_gain, 1.0),
        output_gain=np.full(legs, law.output_gain * units.PERCENT),
        direct_gain=row(law.direct_gain, units.PERCENT),
    )


@compiled
def compensate(compensator, leg, state, signals):  # type: ignore[no-untyped-def]
    """Output y of one leg, command fraction, and its next state x; `signals` are u, (10,), SI."""
    output = compensator.output_gain[leg] * state
    following = compensator.state_gain[leg] * state
    for i in range(signals.shape[0]):
        output += compensator.direct_gain[leg, i] * signals[i]
        following += compensator.input_gain[leg, i] * signals[i]
    return output, following
