"""Real time in parts: which control frames are due, and an account of those that were not run.

A tab's thread asks at every turn which frames are due by the wall clock, runs them and reports how
long it was busy. It never runs more than `LARGEST` at once: a machine that cannot keep up falls
behind, and the time given up so is counted and stated, not dropped in silence.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from cmf_mj.core.rates import FRAME

LARGEST = 0.25
"""Wall time made up for at most in one turn [s]."""

_WINDOW = 2.0
"""Wall time the ratios are taken over [s]."""


class Pace(NamedTuple):
    """How a session keeps up, over the last two seconds."""

    factor: float  #: Simulated time over wall time while running; the speed is what it should be.
    capacity: float
    """Simulated time over the time the thread was busy with it, drawing included: the real-time
    factor it would reach without waiting."""
    given_up: float  #: Wall time given up since the start because the machine was too slow [s].


class Clock:
    """Wall time to control frames for one session."""

    def __init__(self, now: float) -> None:
        """Begin to count at a reading of a monotonic clock [s]."""
        self._turns: deque[tuple[float, float, float]] = deque()
        self.speed = 1.0
        """Simulated seconds in a second of wall time, as chosen."""
        self.paused = False
        """Whether time stands still."""
        self.restart(now)

    def restart(self, now: float) -> None:
        """Owe nothing and forget the account, for a new run."""
        self._last, self._owed, self._given_up = now, 0.0, 0.0
        self._turns.clear()

    def due(self, now: float) -> int:
        """Frames to run at a reading of the clock [s]."""
        elapsed, self._last = now - self._last, now
        if self.paused:
            return 0
        self._owed += elapsed
        missed = max(self._owed - LARGEST, 0.0)
        self._given_up += missed
        self._owed -= missed
        frames = int(self._owed * self.speed / FRAME)
        self._owed -= frames * FRAME / self.speed
        return frames

    def ran(self, wall: float, frames: int, busy: float) -> None:
        """Note a turn: wall time since the last [s], frames run, time to run and show them [s]."""
        self._turns.append((wall, frames * FRAME, busy))
        while sum(turn[0] for turn in self._turns) - self._turns[0][0] > _WINDOW:
            self._turns.popleft()

    @property
    def pace(self) -> Pace:
        """How the session keeps up; NaN before the first turn."""
        wall, simulated, busy = np.sum(self._turns, axis=0) if self._turns else (np.nan,) * 3
        return Pace(float(simulated / wall), float(simulated / busy), self._given_up)
