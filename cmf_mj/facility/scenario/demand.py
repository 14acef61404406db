"""The demand of a run in which signals follow one another.

From the control frame k0 of a change the new motion n starts, at its own frame 0, and takes over

    p[k] <- p[k] + w (n[k - k0] - p[k]),    s = (k - k0) / F,    w = s^3 (10 - 15 s + 6 s^2)

within F frames: w and its first two derivatives rise from 0 and end at rest, so that the demand has
no jump in pose, velocity or acceleration that the two motions do not have themselves. What was in
force before goes on underneath, an earlier take-over that has not ended included. F = 0 is a jump.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.signals.composite import quintic
from cmf_mj.signals.signal import Motion


class _Layer(NamedTuple):
    start: int
    fade: int
    motion: Motion


class Demand:
    """Motions one on top of the other."""

    def __init__(self, motion: Motion) -> None:
        """Begin with one, in force since frame 0."""
        self._layers = [_Layer(0, 0, motion)]

    def change(self, frame: int, motion: Motion, fade: int) -> None:
        """Go over to another motion from frame k0, not before that of the last change, in F."""
        self._layers.append(_Layer(frame, fade, motion))

    def poses(self, first: int, count: int) -> NDArray[np.float64]:
        """Poses (count, 6) [m, rad] of the frames from `first` on."""
        frames = np.arange(first, first + count)
        done = [i for i, layer in enumerate(self._layers) if layer.start + layer.fade <= first]
        del self._layers[: max(done, default=0)]
        bottom, *above = self._layers
        poses = bottom.motion(frames - bottom.start)
        for layer in above:
            since = frames - layer.start
            new = layer.motion(since)
            s = np.clip(since / max(layer.fade, 1), 0.0, 1.0)
            weight = quintic(s)[:, None]
            blend = poses + weight * (new - poses)
            begun, over = (since >= 0)[:, None], (since >= layer.fade)[:, None]
            poses = np.where(over, new, np.where(begun, blend, poses))
        return poses
