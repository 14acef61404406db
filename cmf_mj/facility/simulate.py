"""Runs of a plant that was built: on a command, on valve commands, and many side by side.

`simulate` closes the loop of command, DCL, valves, cylinders, mechanics and sensors; `drive` opens
it at the valves. All are the one loop of `loop.run`, whose docstring gives the order. Each case of
many is `simulate`'s run, to the bit; the threads share one array a channel, so that memory is that
of what is asked for, however many cases there are.
"""

import copy
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.threads import on_threads
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.run import Run
from cmf_mj.facility.session import OutOfBounds
from cmf_mj.facility.signal import LegDemand, ValveCommands
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, commanded

OPTIONS = ("start", "events", "record_every", "command_delay")
"""Fields of `Run` that are options here."""


def simulate(
    plant: Plant,
    law: str | Law,
    command: Command | ArrayLike,
    *,
    legs: bool = False,
    protection: str | Path | ProtectionSettings | None = None,
    electronics: ElectronicsSettings | None = None,
    **options: Any,
) -> Record:
    """Run a control law on a plant and record all signals.

    The run starts at rest at the first pose of the command, in static equilibrium, with the DCL
    engaged there. The same arguments give the same bits on one kind of processor.

    Args:
        plant: `Hexapod`, `SingleLegs`, or any `Plant`; its mechanical step must divide the
            control frame.
        law: name, TOML file or loaded `Law`.
        command: a `Command`, platform poses (N, 6) at the control rate [m, rad], z down, or with
            `legs` extensions of the actuators (N, n) [m].
        legs: whether `command` are extensions.
        protection: conditions that make an emergency stop, `default` or a TOML file; the metadata
            tell the `fault` and its time. Default none.
        electronics: sensors, converters and servo electronics; default ideal, to the bit.
        **options: `start`, by default the command's first pose, with `legs` the model's `qpos0`
            (`plant.configuration` gives that of extensions); `events` on the time line;
            `record_every`, keep one frame in this many; `command_delay`, frames from a DCL frame
            to its command at the valves, by default 1.

    Returns:
        Channels of the demand, the legs, the hydraulics, the supply, `energy` passed since the
        start (columns `plant.hydraulics.ENERGIES`), the sensors, `generalised_position` (MuJoCo's
        qpos, to replay), the platform's true pose and `gimbal_error`, the largest distance between
        the halves of a closed gimbal since the row before. `leg_position` is what the sensors
        read, `leg_extension` what is true.

    Raises:
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.

    >>> command = cmf_mj.signals.sine("surge", 0.01, frequency=2.0, cycles=1)
    >>> record = cmf_mj.simulate(cmf_mj.Hexapod(), "velocity", command)
    >>> bool(record["gimbal_error"].max() < 1e-5)
    True
    """
    check_options(plant, options, OPTIONS)
    source = LegDemand(cast("ArrayLike", command)) if legs else command
    guarded: dict[str, Any] = {"protection": protection, "electronics": electronics}
    return Run(plant=plant, law=law, source=source, **options, **guarded).record()


def drive(plant: Plant, valves: ArrayLike, **options: Any) -> Record:
    """Run a plant open loop on given valve commands and record all signals.

    Args:
        plant: any `Plant`.
        valves: valve commands as fractions, -1 to 1, positive extending, (N, n), each held
            over its control frame.
        **options: as for `simulate`; `command_delay` is that from a row to the valves, by
            default 0.

    Returns:
        The channels of `simulate` without those of demand and DCL.

    Raises:
        InputError: an argument out of range, named.
        OutOfBounds: the state left its physical bounds; leg, time and value are named.

    >>> record = cmf_mj.drive(cmf_mj.SingleLegs(), np.full((200, 6), 0.1))
    >>> bool((record["leg_extension"][-1] > 0.0).all())
    True
    """
    check_options(plant, options, OPTIONS)
    run = Run(plant=plant, law=None, source=ValveCommands(valves), **{"command_delay": 0} | options)
    return run.record()


def check_options(plant: object, options: Mapping[str, Any], allowed: Sequence[str]) -> None:
    """Refuse what is no plant, and what is no option, by its name."""
    if not isinstance(plant, Plant):
        raise InputError(f"plant: {plant!r} is refused; allowed: a Plant, such as Hexapod('gfd')")
    for name in options:
        check_name("option", name, allowed)


class ManyRuns(NamedTuple):
    """Channels of all cases."""

    time: NDArray[np.float64]  #: Of the rows [s], (rows,).
    channels: dict[str, NDArray[np.float64]]
    """By name, (cases, rows, ...); NaN in cases that left their bounds."""
    units: dict[str, str]  #: Of the channels.
    left: tuple[str, ...]  #: Why a case left its bounds; empty where it did not.

    def __getitem__(self, name: str) -> NDArray[np.float64]:  # type: ignore[override]
        """A channel by name."""
        if name not in self.channels:
            raise InputError(f"channels: {name!r} was not kept; it has {', '.join(self.channels)}")
        return self.channels[name]


def simulate_many(
    plant: Plant | Callable[[int], Plant],
    law: str | Law | Sequence[str | Law],
    commands: Sequence[Command] | ArrayLike,
    *,
    channels: Sequence[str] = ("leg_extension",),
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> ManyRuns:
    """Run thousands of cases on threads and keep some of their channels.

    Args:
        plant: one for all cases, of which each thread has a copy; or a function that makes the
            plant of a case by its number.
        law: for all cases, or one a case.
        commands: platform poses (cases, N, 6) at 2048 Hz [m, rad], z down, or as many commands
            of one length.
        channels: those of `simulate`'s record to keep.
        threads: how many; default one a core.
        progress: called with (cases done, cases in all) after each.
        **options: as for `simulate`, the same for all cases.

    Raises:
        InputError: an argument out of range, named; with the number of the case where it is one's.

    >>> poses = np.zeros((3, 200, 6))
    >>> poses[:, :, 2] = np.array([[0.001], [0.002], [0.003]])  # three depths, held
    >>> runs = cmf_mj.simulate_many(cmf_mj.Hexapod(), "velocity", poses, record_every=50)
    >>> runs["leg_extension"].shape, runs.left
    ((3, 4, 6), ('', '', ''))
    """
    first = plant(0) if callable(plant) else plant
    check_options(first, options, OPTIONS)
    laws = [load_law(one) for one in ([law] if isinstance(law, str | Law) else law)]
    made, rate = _commands(commands, first.machine.rate), first.machine.rate
    count = len(made)
    if len(laws) not in (1, count):
        raise InputError(f"law: {len(laws)} for {count} cases; allowed: one, or one a case")
    if count == 0 or not channels:
        raise InputError("commands, channels: none is given; allowed: at least one")
    spare: SimpleQueue[Plant] = SimpleQueue()
    lock, kept, units = threading.Lock(), {}, {}

    def machine(case: int) -> Plant:
        if not isinstance(plant, Plant):
            return plant(case)
        try:
            return spare.get_nowait()
        except Empty:
            return copy.deepcopy(plant)

    def run(case: int) -> str:
        chosen = machine(case)
        try:
            record = simulate(chosen, laws[case % len(laws)], made[case], **options)
        except OutOfBounds as end:
            return str(end)
        except InputError as refusal:
            raise InputError(f"case {case}: {refusal}") from None
        finally:
            if isinstance(plant, Plant):
                spare.put(chosen)
        with lock:
            for name in channels:
                if name not in kept:
                    kept[name] = np.full((count, *record[name].shape), np.nan)
                    units[name] = record.units[name]
        for name in channels:
            kept[name][case] = record[name]
        return ""

    left = on_threads(run, range(count), threads, progress)
    if not kept:
        raise OutOfBounds(f"all {count} cases: {left[0]}", 0)
    every = options.get("record_every", 1)
    time = np.arange(0, made[0].pose.shape[0], every, dtype=np.float64) / rate
    return ManyRuns(time, kept, units, tuple(left))


def _commands(given: Sequence[Command] | ArrayLike, rate: int) -> list[Command]:
    """As many commands as there are cases, of one length."""
    if isinstance(given, Command):
        raise InputError("commands: is one Command; allowed: as many in a list as there are cases")
    cases = list(given) if isinstance(given, Sequence) else list(np.atleast_1d(given))
    made = [commanded(case, rate) for case in cases]
    for case, one in enumerate(made):
        if one.pose.shape != made[0].pose.shape:
            allowed = f"that of the first, {made[0].pose.shape}"
            raise InputError(
                f"commands: case {case} has shape {one.pose.shape}; allowed: {allowed}"
            )
    return made
