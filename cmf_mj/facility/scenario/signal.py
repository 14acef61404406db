"""What a scenario demands of the platform: the signals of `cmf_mj.signals`, and two from files.

In a scenario a step and a pulse need no `duration`, a sine without `cycles` goes on for ever, and
a multisine is faded. Several signals of a scenario are added.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.interpolate import BPoly

from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.files import read_stream
from cmf_mj.record.record import Record
from cmf_mj.signals import composite, single
from cmf_mj.signals.composite import quintic
from cmf_mj.signals.signal import Command, Duration, Motion, Wait, check_length
from cmf_mj.signals.signal import Signal as AnySignal


class Step(single.Step):
    """A step, held for ever."""

    duration: Duration | None = None


class Pulse(single.Pulse):
    """A rectangular pulse."""

    duration: Duration | None = None


class Sine(single.Sine):
    """A sine, faded in by a raised cosine; without `cycles` it goes on for ever."""

    cycles: single.Cycles | None = None


class Multisine(single.Multisine):
    """Odd random-phase multisine of whole periods."""

    fade: Wait = 1.0


def _check_file(file: str) -> None:
    if not Path(file).is_file():
        raise InputError(f"{file}: cannot be read: there is no such file")


class HostFile(AnySignal):
    """A host's frames from a CSV or Parquet file, joined by quintics."""

    kind: Literal["host"]
    file: str  #: CSV or Parquet with time and six poses, SI.
    derivatives: Literal["spline", "zero"] = "spline"
    """How velocities are made where the file has none."""

    def _check(self) -> None:
        _check_file(self.file)

    def command(self, seed: int = 0) -> Command:
        """Poses from the first frame's time to the last one's."""
        stream = read_stream(self.file, derivatives=self.derivatives)
        if stream.time.size < 2:
            raise InputError(f"{self.file}: {stream.time.size} frames; at least 2 are needed")
        since = stream.time - stream.time[0]
        check_length(float(since[-1]), self.rate)
        time = np.arange(int(np.floor(since[-1] * self.rate + 1e-9)) + 1) / self.rate
        return Command(BPoly.from_derivatives(since, stream.values)(time), self)


class Recorded(AnySignal):
    """The demand of a record of an earlier run."""

    kind: Literal["recorded"]
    file: str  #: Parquet record with a `demand_pose` of every frame.

    def _check(self) -> None:
        _check_file(self.file)

    def command(self, seed: int = 0) -> Command:
        """The recorded demand."""
        record = Record.load(self.file)
        if abs(record.rate - self.rate) > 1e-9:
            raise InputError(f"{self.file}: sample_rate: {record.rate:g}; allowed: {self.rate} Hz")
        return Command(record["demand_pose"], self)


Signal = Annotated[
    Step
    | Pulse
    | Sine
    | single.Chirp
    | single.Noise
    | Multisine
    | composite.SevenSines
    | composite.SteppedSines
    | composite.FadedSines
    | composite.AccelerationStep
    | composite.Waypoints
    | HostFile
    | Recorded,
    Field(discriminator="kind"),
]
"""Any of them, by its `kind`."""


def added(parts: Sequence[AnySignal], seed: int, rate: int) -> Motion:
    """The sum of signals at a control rate [Hz]; at rest at neutral without any."""
    motions = [part.at_rate(rate).motion(seed) for part in parts]

    def total(frames: NDArray[np.int64]) -> NDArray[np.float64]:
        poses = np.zeros((frames.size, 6))
        for motion in motions:
            poses += motion(frames)
        return poses

    return total


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
