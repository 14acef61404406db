"""Many runs side by side on threads, each to the bit the single run of `simulate`.

The threads share one array a channel, so that memory is that of what is asked for, however many
cases there are.
"""

import copy
import threading
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.session import OutOfBounds
from cmf_mj.facility.simulate import simulate
from cmf_mj.plant.plant import Plant
from cmf_mj.signals.signal import Command, commanded


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
