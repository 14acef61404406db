"""Many runs side by side on threads, each to the bit the single run of `simulate` or `drive`.

The threads share one array a channel, so that memory is that of what is asked for, however many
cases there are. In a folder each case is a frame, `case_00000.parquet` and so on, which
`Record.load` and any reader of Parquet open; the journal of a study beside them says which are
finished, and what they are of. Processes and Dask write into it too, where all of them see it.
"""

import copy
import hashlib
import json
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
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
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, commanded
from cmf_mj.studies.engine import Journal, Row, Work, Workers, run_tasks


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
    folder: str | Path | None = None,
    threads: int | None = None,
    workers: Workers | None = None,
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
        folder: where to write each case as a frame. The same call again runs what is left.
        threads: how many; default one a core.
        workers: processes or a Dask cluster to write the frames of `folder`, not threads. A case
            that cannot run says so in `left`.
        progress: called with (cases done, cases in all) after each.
        **options: as for `simulate` and `drive`, the same for all cases.

    Raises:
        InputError: an argument out of range, named; with the number of the case where it is one's.

    >>> poses = np.zeros((3, 200, 6))
    >>> poses[:, :, 2] = np.array([[0.001], [0.002], [0.003]])  # three depths, held
    >>> runs = cmf_mj.simulate_many(cmf_mj.Hexapod(), "velocity", poses, record_every=50)
    >>> runs["leg_extension"].shape, runs.left
    ((3, 4, 6), ('', '', ''))
    """
    first = plant(0) if callable(plant) else plant
    named = [law] if law is None or isinstance(law, str | Law) else law
    laws = [None if one is None else load_law(one) for one in named]
    table = LegDemand if legs else ValveCommands if law is None else None
    made = _commands(commands, table, first.machine.rate)
    count = len(made)
    if len(laws) not in (1, count):
        raise InputError(f"law: {len(laws)} for {count} cases; allowed: one, or one a case")
    if count == 0 or not channels:
        raise InputError("commands, channels: none is given; allowed: at least one")
    how = ({"command_delay": 0} if law is None else {}) | options | {"seed": seed}
    settings = Run(plant=first, law=laws[0], source=made[0], **how)
    journal = None
    if folder is not None:
        identity = {
            "plant": "one a case" if callable(plant) else _digest(first.describe()),
            "laws": _digest([one and one.model_dump(mode="json") for one in laws]),
            "commands": _digest([_rows(one).tolist() for one in made]),
            "start": None if settings.start is None else np.asarray(settings.start).tolist(),
            "unknowns": {k: one.model_dump(mode="json") for k, one in (unknowns or {}).items()},
            "settings": settings.model_dump(mode="json", exclude={"plant", "law"}),
            "channels": list(channels),
        }
        journal = Journal(Path(folder), identity)
    elif workers is not None:
        raise InputError("workers: need a folder, where they write; allowed: with folder only")

    def task(case: int, chosen: Plant | Callable[[int], Plant]) -> _Task:
        about = {} if callable(chosen) else {"plant": chosen}
        one = settings.but(law=laws[case % len(laws)], source=made[case], **about)
        return _Task(case, one, chosen, unknowns, tuple(channels), folder)

    if journal is not None and workers is not None:
        work = Work(_written, lambda error: [{"plant": "", "left": repr(error)}], _Task.of)
        run_tasks(journal, [task(case, plant) for case in range(count)], work, workers, progress)
    spare: SimpleQueue[Plant] = SimpleQueue()
    lock, kept, units = threading.Lock(), {}, {}

    def machine(case: int) -> Plant:
        if not isinstance(plant, Plant):
            return plant(case)
        try:
            return spare.get_nowait()
        except Empty:
            return copy.deepcopy(plant)

    def finished(case: int, chosen: Plant) -> Record:
        """The record of a case, which the folder may have already."""
        if journal is None:
            return task(case, chosen).record(chosen)
        path, on = task(case, chosen).path, _digest(chosen.describe())
        if case not in journal.results:
            rows = _written(task(case, chosen))
            with lock:
                journal.add(case, rows)
        (row,) = journal.results[case]
        if row["plant"] not in ("", on):
            allowed = "the same plant, or another folder"
            raise InputError(f"folder: {path.name} is of another plant; allowed: {allowed}")
        if row["left"]:
            raise OutOfBounds(row["left"], 0)
        return Record.load(path)

    def run(case: int) -> str:
        chosen = machine(case)
        try:
            record = finished(case, chosen)
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
    rows, every = _rows(made[0]).shape[0], settings.record_every
    time = np.arange(0, rows, every, dtype=np.float64) / first.machine.rate
    return ManyRuns(time, kept, units, tuple(left))


class _Task(NamedTuple):
    """One case, with all that a worker needs."""

    number: int
    run: Run
    plant: Plant | Callable[[int], Plant]
    unknowns: Unknowns | None
    channels: tuple[str, ...]
    folder: str | Path | None

    @property
    def path(self) -> Path:
        """The frame that it writes."""
        return Path(self.folder or "") / f"case_{self.number:05d}.parquet"

    def of(self) -> int:
        """Its own group of tasks."""
        return self.number

    def record(self, plant: Plant) -> Record:
        """The channels of its run, and what was drawn for it."""
        run, noted = self.run.but(plant=plant), dict[str, Any]()
        if self.unknowns is not None:
            run, noted = _drawn(run, self.unknowns.on(plant), self.number)
        record, names = run.record(), self.channels
        part, unit = {n: record[n] for n in names}, {n: record.units[n] for n in names}
        return Record(record.time, part, unit, {**record.metadata, "unknowns": noted})


def _written(task: _Task, _shared: dict[str, Any] | None = None) -> list[Row]:
    """Run a case and write its frame; the row says of which plant it is, and why it has none."""
    plant = task.plant(task.number) if callable(task.plant) else task.plant
    left = ""
    try:
        task.record(plant).save(task.path)
    except OutOfBounds as end:
        left = str(end)
    return [{"plant": _digest(plant.describe()), "left": left}]


def _drawn(run: Run, unknowns: Unknowns, case: int) -> tuple[Run, dict[str, Any]]:
    """A run with values of the unknowns, and these."""
    values, plant = unknowns.streams(run.seed, case), run.plant
    assert isinstance(plant, Plant)
    parts: dict[str, Any] = {"plant": unknowns.apply(values, plant)}
    if run.law is not None:
        parts["law"] = unknowns.apply(values, load_law(run.law))
    if run.electronics is not None:
        sensors = unknowns.apply(values, run.electronics.of(plant.machine).sensors)
        parts["electronics"] = run.electronics.model_copy(update={"sensors": sensors})
    return run.but(**parts), {name: np.asarray(x).tolist() for name, x in values.items()}


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


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
