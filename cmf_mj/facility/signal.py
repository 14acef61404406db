"""Demands of a run: signals of scenario files and their sum, and tables that were made before.

As `ScenarioSignal` a step and a pulse need no `duration`, a sine without `cycles` goes on for ever,
and a multisine is faded.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.interpolate import BPoly

from cmf_mj.control.dcu.play import Arrivals
from cmf_mj.core.arrays import real, shaped
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import check_file
from cmf_mj.facility.front import Source, from_table
from cmf_mj.facility.host.stream import read_stream
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.plant.plant import Plant
from cmf_mj.signals import composite, single
from cmf_mj.signals.signal import Command, Duration, Motion, Signal, Wait, as_command, check_length


class HeldStep(single.Step):
    """A step, held for ever."""

    duration: Duration | None = None


class HeldPulse(single.Pulse):
    """A rectangular pulse."""

    duration: Duration | None = None


class OpenSine(single.Sine):
    """A sine, faded in by a raised cosine; without `cycles` it goes on for ever."""

    cycles: single.Cycles | None = None


class FadedMultisine(single.Multisine):
    """Odd random-phase multisine of whole periods."""

    fade: Wait = 1.0


class HostFile(Signal):
    """A host's frames from a CSV or Parquet file, joined by quintics."""

    kind: Literal["host"]
    file: str  #: CSV or Parquet with time and six poses, SI.
    derivatives: Literal["spline", "zero"] = "spline"
    """How velocities are made where the file has none."""

    def _check(self) -> None:
        check_file(Path(self.file))

    def command(self, seed: int = 0) -> Command:
        """Poses from the first frame's time to the last one's."""
        stream = read_stream(self.file, derivatives=self.derivatives)
        if stream.time.size < 2:
            raise InputError(f"{self.file}: {stream.time.size} frames; at least 2 are needed")
        host_time = stream.time - stream.time[0]
        length = float(host_time[-1])
        check_length(length, self.rate)
        time = np.arange(int(np.floor(length * self.rate + 1e-9)) + 1) / self.rate
        return Command(BPoly.from_derivatives(host_time, stream.values)(time), self)


ScenarioSignal = Annotated[
    HeldStep
    | HeldPulse
    | OpenSine
    | single.Chirp
    | single.Noise
    | FadedMultisine
    | composite.SevenSines
    | composite.SteppedSines
    | composite.FadedSines
    | composite.AccelerationStep
    | composite.Waypoints
    | HostFile,
    Field(discriminator="kind"),
]
"""Any signal of a scenario file, by its `kind`."""


def added(signals: Sequence[Signal], seed: int, rate: int) -> Motion:
    """The sum of signals at a control rate [Hz]; at rest at neutral without any."""
    motions = [signal.at_rate(rate).motion(seed) for signal in signals]

    def total(frames: NDArray[np.int64]) -> NDArray[np.float64]:
        poses = np.zeros((frames.size, 6))
        for motion in motions:
            poses += motion(frames)
        return poses

    return total


class _Layer(NamedTuple):
    """A motion from a frame on."""

    start: int  #: Control frame in which it begins.
    fade: int  #: Control frames over which it takes over.
    motion: Motion


class LayeredDemand:
    """Motions that take over from each other."""

    def __init__(self, motion: Motion) -> None:
        """Begin with one, in force since frame 0."""
        self._layers = [_Layer(0, 0, motion)]

    def change(self, frame: int, motion: Motion, fade: int) -> None:
        """Go over to `motion` from `frame` on, over `fade` control frames.

        `frame` is not before that of the last change; the motion's own frames count from it.
        """
        self._layers.append(_Layer(frame, fade, motion))

    def poses(self, first: int, count: int) -> NDArray[np.float64]:
        """Poses (count, 6) [m, rad] of the frames from `first` on.

        Motions that another has replaced by `first` are forgotten. So `first` is never less than
        that of the last call, but the last block may be asked for again.
        """
        frames = np.arange(first, first + count)
        while any(layer.start + layer.fade <= first for layer in self._layers[1:]):
            del self._layers[0]
        bottom, *upper_layers = self._layers
        poses = bottom.motion(frames - bottom.start)
        for layer in upper_layers:
            own_frames = frames - layer.start
            own_poses = layer.motion(own_frames)
            weight = single.quintic(np.clip(own_frames / max(layer.fade, 1), 0.0, 1.0))[:, None]
            blend = poses + weight * (own_poses - poses)
            has_begun = (own_frames >= 0)[:, None]
            has_taken_over = (own_frames >= layer.fade)[:, None]
            poses = np.where(has_taken_over, own_poses, np.where(has_begun, blend, poses))
        return poses


class LegDemand(NamedTuple):
    """A demand of leg extensions."""

    rows: ArrayLike  #: At the control rate, (N, n) [m].


class ValveCommands(NamedTuple):
    """Valve commands of an open loop."""

    rows: ArrayLike  #: Fractions, -1 to 1, positive extending, each held over its frame, (N, n).


def as_source(
    demand: Any, plant: Plant, start: ArrayLike | None
) -> tuple[Any, ArrayLike | None, dict[str, Any]]:
    """Make a source of a demand, a start, by default its first pose, and metadata of a record."""
    match demand:
        case Source() | Arrivals():
            return demand, start, _described("table")
        case LegDemand(rows):
            table = _checked_table("command", rows, plant)
            return from_table(table), start, _described("leg extensions")
        case ValveCommands(rows):
            table = _checked_table("valves", rows, plant)
            if (np.abs(table) > 1.0).any():
                row, leg = np.argwhere(np.abs(table) > 1.0)[0]
                text = f"{table[row, leg]} of leg {leg + 1} in row {row}"
                raise InputError(f"valves: {text} is not between -1 and 1")
            return from_table(table), start, _described("valve commands")
    command = as_command(demand, plant.machine.rate)
    source = from_table(pose_to_legs(command.pose, plant.machine), command.pose)
    context = {"command": command.description, "seed": command.seed}
    return source, command.pose[0] if start is None else start, context


def _described(signal: str) -> dict[str, Any]:
    return {"command": {"signal": signal}, "seed": None}


def _checked_table(name: str, rows: ArrayLike, plant: Plant) -> NDArray[np.float64]:
    table = shaped(name, np.atleast_2d(real(name, rows)), None, plant.legs)
    if not table.size:
        raise InputError(f"{name}: has no rows; allowed: at least one")
    return table
