"""Many runs side by side on threads, each to the bit the single run of `simulate` or `drive`.

Memory is that of the channels that are asked for, however many cases there are.
"""

import copy
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.arrays import real
from cmf_mj.core.errors import InputError
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.run import Run
from cmf_mj.facility.session import OutOfBounds
from cmf_mj.facility.signal import LegDemand, ValveCommands
from cmf_mj.facility.unknowns import Unknowns
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
    law: str | Law | None | Sequence[str | Law],
    commands: Sequence[Command | ArrayLike] | ArrayLike,
    *,
    legs: bool = False,
    channels: Sequence[str] = ("leg_extension",),
    unknowns: Unknowns | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> ManyRuns:
    """Run thousands of cases on threads and keep some of their channels.

    Args:
        plant: any, one for all cases, of which each thread has a copy; or a function that makes the
            plant of a case by its number.
        law: for all cases, or one a case; None opens the loop, as `drive`.
        commands: one a case, all of one length: `Command`s, or arrays (cases, N, 6) of platform
            poses at the control rate [m, rad], z down; with `legs` (cases, N, n) of extensions [m];
            without a law (cases, N, n) of valve commands.
        legs: whether `commands` are extensions.
        channels: those of `simulate`'s record to keep.
        unknowns: draw plant, law and sensors of case i, by `Unknowns.on(plant).streams(seed, i)`.
        seed: of those and of noise.
        threads: how many; default one a core.
        progress: called with (cases done, cases in all) after each.
        **options: as for `simulate` and `drive`, the same for all cases.

    A refusal that is one case's names its number.

    >>> poses = np.zeros((3, 200, 6))
    >>> poses[:, :, 2] = np.array([[0.001], [0.002], [0.003]])  # three depths, held
    >>> runs = cmf_mj.simulate_many(cmf_mj.Hexapod(), "velocity", poses, record_every=50)
    >>> runs["leg_extension"].shape, runs.left
    ((3, 4, 6), ('', '', ''))
    """
    first = plant(0) if callable(plant) else plant
    table = LegDemand if legs else ValveCommands if law is None else None
    demands = _commands(commands, table, first.machine.rate)
    laws = _laws(law, first, len(demands))
    if not demands or not channels:
        raise InputError("commands, channels: none is given; allowed: at least one")
    how = ({"command_delay": 0} if law is None else {}) | options | {"seed": seed}
    settings = Run(plant=first, law=laws[0], source=demands[0], **how)
    own = threading.local()

    def work(case: int) -> dict[str, NDArray[np.float64]] | str:
        """Channels of a case, or why it left its bounds; each thread has a plant of its own."""
        if callable(plant):
            own.plant = plant(case)
        elif not hasattr(own, "plant"):
            own.plant = copy.deepcopy(plant)
        run = settings.but(plant=own.plant, law=laws[case % len(laws)], source=demands[case])
        try:
            run = run if unknowns is None else _drawn(run, unknowns.on(own.plant), case)
            record = run.record()
            part = {name: record[name].copy() for name in channels}
            units.update({name: record.units[name] for name in channels})
            return part
        except OutOfBounds as end:
            return str(end)
        except InputError as refusal:
            raise InputError(f"case {case}: {refusal}") from None

    units: dict[str, str] = {}
    found = on_threads(work, range(len(demands)), threads, progress)
    left = tuple(one if isinstance(one, str) else "" for one in found)
    ran = {case: one for case, one in enumerate(found) if not isinstance(one, str)}
    if not ran:
        raise OutOfBounds(f"all {len(demands)} cases: {left[0]}", 0)
    kept = {name: _stacked(ran, name, len(demands)) for name in channels}
    time = np.arange(0, len(_rows(demands[0])), settings.record_every) / first.machine.rate
    return ManyRuns(time, kept, units, left)


def _stacked(ran: Mapping[int, dict[str, Any]], name: str, count: int) -> NDArray[np.float64]:
    """A channel of all cases (count, ...), NaN where one did not run; taken from each."""
    parts = {case: one.pop(name) for case, one in ran.items()}
    every = np.full((count, *next(iter(parts.values())).shape), np.nan)
    for case, part in parts.items():
        every[case] = part
    return every


def _laws(
    law: str | Law | None | Sequence[str | Law], plant: Plant, count: int
) -> list[Law | None]:
    """One for all of so many cases, or one a case."""
    named = [law] if law is None or isinstance(law, str | Law) else law
    if len(named) not in (1, count):
        raise InputError(f"law: {len(named)} for {count} cases; allowed: one, or one a case")
    return [None if one is None else load_law(one, plant.machine) for one in named]


def _drawn(run: Run, unknowns: Unknowns, case: int) -> Run:
    """A run with values of the unknowns."""
    values, plant = unknowns.streams(run.seed, case), run.plant
    assert isinstance(plant, Plant)
    parts: dict[str, Any] = {"plant": unknowns.apply(values, plant)}
    if run.law is not None:
        parts["law"] = unknowns.apply(values, load_law(run.law))
    if run.electronics is not None:
        sensors = unknowns.apply(values, run.electronics.of(plant.machine).sensors)
        parts["electronics"] = run.electronics.model_copy(update={"sensors": sensors})
    return run.but(**parts)


def _rows(command: Command | LegDemand | ValveCommands) -> NDArray[np.float64]:
    return np.asarray(command.pose if isinstance(command, Command) else command.rows)


def _commands(given: Any, table: Any, rate: int) -> list[Any]:
    """As many commands as there are cases, of one length; arrays as `table` says, else poses."""
    if isinstance(given, Command):
        raise InputError("commands: is one Command; allowed: as many in a list as there are cases")
    cases = list(given) if isinstance(given, Sequence) else list(np.atleast_1d(given))
    made = [
        commanded(case, rate) if table is None else table(real("commands", case)) for case in cases
    ]
    for case, one in enumerate(made):
        if _rows(one).shape != _rows(made[0]).shape:
            allowed = f"that of the first, {_rows(made[0]).shape}"
            raise InputError(
                f"commands: case {case} has shape {_rows(one).shape}; allowed: {allowed}"
            )
    return made
