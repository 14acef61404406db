"""What is broken at the moment: read by hydraulics and sensors every step, changed by events."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

PUMP_LOST, ACCUMULATORS_LOST, BURST_AREA, STOPPED, OVERLOAD = range(5)
"""Columns of `Faults.plant`: pump stopped (0 or 1), number of accumulators shut off, hole in the
supply manifold [m^2], emergency stop (0 or 1), extra weight on the platform [N]."""

STUCK, OFFSET, OPEN_CIRCUIT = 1.0, 2.0, 3.0
"""What a faulty position sensor does; 0 for a sound one."""


class Faults(NamedTuple):
    """State of all that can fail; all zero when nothing has."""

    plant: NDArray[np.float64]  #: (5,), see the columns.
    valve: NDArray[np.float64]  #: What each valve obeys, (n, 2), see `valve.NORMAL`.
    spool: NDArray[np.float64]  #: Value put on an overridden spool, (n, 2).
    sensor: NDArray[np.float64]  #: State of each position sensor, (n,).
    reading: NDArray[np.float64]
    """Reading of a stuck or open one, error of an offset one [m], (n,)."""


def no_faults(actuators: int) -> Faults:
    """Everything works."""
    return Faults(
        np.zeros(5),
        np.zeros((actuators, 2)),
        np.zeros((actuators, 2)),
        np.zeros(actuators),
        np.zeros(actuators),
    )
