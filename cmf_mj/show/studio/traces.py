"""The last seconds of a session, as the plots draw them: a ring of rows that never grows."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

LONGEST = 20.0
"""Time kept [s]."""

RATE = 64
"""Rows a second of simulated time [Hz]; the fastest excitation has 10 Hz."""

CHANNELS = {
    "demand_pose": 6,
    "platform_pose": 6,
    "leg_force": 6,
    "valve_command": 6,
    "cap_pressure": 6,
    "rod_pressure": 6,
    "supply_pressure": 1,
    "return_pressure": 1,
}
"""What is kept, with its columns; names and units of `Record`."""


class Traces:
    """Time and channels of the last `LONGEST` seconds."""

    def __init__(self) -> None:
        """Begin empty."""
        self._rows = np.empty((round(LONGEST * RATE), 1 + sum(CHANNELS.values())))
        self._count = 0

    def clear(self) -> None:
        """Forget everything."""
        self._count = 0

    def append(self, time: float, values: Mapping[str, ArrayLike]) -> None:
        """Keep one row: the time of the run [s] and a value of every channel."""
        row = self._rows[self._count % self._rows.shape[0]]
        np.concatenate([[time], *(np.atleast_1d(values[name]) for name in CHANNELS)], out=row)
        self._count += 1

    def last(self, seconds: float) -> dict[str, NDArray[np.float64]]:
        """The latest rows in order: `time` (N,) and each channel (N, width)."""
        size = self._rows.shape[0]
        count = min(self._count, size, round(seconds * RATE))
        rows = self._rows[np.arange(self._count - count, self._count) % size]
        ends = np.cumsum(list(CHANNELS.values()))[:-1]
        columns = np.split(rows[:, 1:], ends, axis=1)
        return {"time": rows[:, 0], **dict(zip(CHANNELS, columns, strict=True))}
