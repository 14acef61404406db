"""What a run demands: signals, made block by block as it goes, or a table that was made before.

The module has three parts. `ScenarioSignal` is the signals of scenario files: those of
`cmf_mj.signals`, and host files. Here a step and a pulse need no `duration`, a sine without
`cycles` goes on for ever, and a multisine is faded. `added` is the sum of several.

`LayeredDemand` lets motions take over from each other as a run goes, and a feed makes blocks of
it: `TableFeed` a table, `HostFeed` the frames of a host that sends the demand every so many control
frames. Their derivatives are central differences at the control rate, at 2048 Hz exact to T^2/6
of the third and T^2/12 of the fourth.

`as_source` is what a run makes of a demand that is there from the start: a `Command`, poses,
`LegDemand` or `ValveCommands`.
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
from cmf_mj.facility.host.handover import make_log
from cmf_mj.facility.host.stream import read_stream
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine
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
        since = stream.time - stream.time[0]
        check_length(float(since[-1]), self.rate)
        time = np.arange(int(np.floor(since[-1] * self.rate + 1e-9)) + 1) / self.rate
        return Command(BPoly.from_derivatives(since, stream.values)(time), self)


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


def added(parts: Sequence[Signal], seed: int, rate: int) -> Motion:
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


class LayeredDemand:
    """Motions one on top of the other."""

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
        done = [i for i, layer in enumerate(self._layers) if layer.start + layer.fade <= first]
        del self._layers[: max(done, default=0)]
        bottom, *above = self._layers
        poses = bottom.motion(frames - bottom.start)
        for layer in above:
            since = frames - layer.start
            new = layer.motion(since)
            s = np.clip(since / max(layer.fade, 1), 0.0, 1.0)
            weight = single.quintic(s)[:, None]
            blend = poses + weight * (new - poses)
            begun, over = (since >= 0)[:, None], (since >= layer.fade)[:, None]
            poses = np.where(over, new, np.where(begun, blend, poses))
        return poses


BLOCK = 1024  #: Control frames of a block.


class TableFeed:
    """A table of one block, for a source that reads it again from the start."""

    def __init__(self, demand: LayeredDemand, machine: Machine) -> None:
        """Make the first block."""
        self._demand, self._machine = demand, machine
        self.poses, self.legs = np.zeros((BLOCK, 6)), np.zeros((BLOCK, 6))
        self.fill(0)

    def fill(self, first: int) -> None:
        """Make the block of frames from `first` on."""
        self.poses[:] = self._demand.poses(first, BLOCK)
        self.legs[:] = pose_to_legs(self.poses, self._machine)


class HostFeed:
    """The frames of a host that sends the demand every so many control frames."""

    def __init__(self, demand: LayeredDemand, rate: int, every: int, frames: int | None) -> None:
        """Make those of the first block; of an open run the log grows."""
        self._demand, self._rate, self._every = demand, rate, every
        self.log = make_log((frames or BLOCK) // every + BLOCK)
        self.fill(0)

    def fill(self, first: int) -> None:
        """Make the host frames that arrive in the block of frames from `first` on.

        Where they do not fit, a larger `log` replaces the present one. The caller passes `log` on
        to the loop after each call.
        """
        poses, every = self._demand.poses(first - 1, BLOCK + 2), self._every
        numbers = np.arange(-(-first // every), -(-(first + BLOCK) // every))
        if numbers.size and numbers[-1] >= self.log.frame.size:
            larger = make_log(2 * (int(numbers[-1]) + 1))
            for new, old in zip(larger, self.log, strict=True):
                new[: old.shape[0]] = old
            self.log = larger
        log, frames = self.log, numbers * every
        at = frames - first + 1
        before, here, after = poses[at - 1], poses[at], poses[at + 1]
        log.frame[numbers], log.sequence[numbers] = frames, numbers
        log.time[numbers] = frames / self._rate
        log.values[numbers, 0] = here
        log.values[numbers, 1] = (after - before) * (self._rate / 2.0)
        log.values[numbers, 2] = (after - 2.0 * here + before) * float(self._rate) ** 2


class LegDemand(NamedTuple):
    """A demand of leg extensions."""

    rows: ArrayLike  #: At the control rate, (N, n) [m].


class ValveCommands(NamedTuple):
    """Valve commands of an open loop."""

    rows: ArrayLike  #: Fractions, -1 to 1, positive extending, each held over its frame, (N, n).


class RunSource(NamedTuple):
    """A demand as a session takes it."""

    source: Any  #: A `Source`, or `Arrivals` of a host.
    start: ArrayLike | None  #: Where the run starts, as `Plant.start` takes it.
    context: dict[str, Any]  #: What a record says of the demand.


def as_source(given: Any, plant: Plant, start: ArrayLike | None) -> RunSource:
    """Make a source of what a run was given, to begin at `start` or at the first pose given."""
    said = "table"
    match given:
        case Source() | Arrivals() as source:
            pass
        case LegDemand(rows):
            source, said = from_table(_rows("command", rows, plant)), "leg extensions"
        case ValveCommands(rows):
            table, said = _rows("valves", rows, plant), "valve commands"
            if (np.abs(table) > 1.0).any():
                row, leg = np.argwhere(np.abs(table) > 1.0)[0]
                where = f"{table[row, leg]} of leg {leg + 1} in row {row}"
                raise InputError(f"valves: {where} is not between -1 and 1")
            source = from_table(table)
        case command:
            demanded = as_command(command, plant.machine.rate)
            legs = pose_to_legs(demanded.pose, plant.machine)
            source = from_table(legs, demanded.pose)
            context = {"command": demanded.description, "seed": demanded.seed}
            return RunSource(source, demanded.pose[0] if start is None else start, context)
    return RunSource(source, start, {"command": {"signal": said}, "seed": None})


def _rows(name: str, rows: ArrayLike, plant: Plant) -> NDArray[np.float64]:
    table = shaped(name, np.atleast_2d(real(name, rows)), None, plant.legs)
    if not table.size:
        raise InputError(f"{name}: has no rows; allowed: at least one")
    return table
