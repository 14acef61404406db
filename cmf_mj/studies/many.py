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

    A refusal that is one case's names its number.

    >>> poses = np.zeros((3, 200, 6))
    >>> poses[:, :, 2] = np.array([[0.001], [0.002], [0.003]])  # three depths, held
    >>> runs = cmf_mj.simulate_many(cmf_mj.Hexapod(), "velocity", poses, record_every=50)
    >>> runs["leg_extension"].shape, runs.left
    ((3, 4, 6), ('', '', ''))
    """
    named = [law] if law is None or isinstance(law, str | Law) else law
    machine = None if callable(plant) else plant.machine
    laws = [None if one is None else load_law(one, machine) for one in named]
    table = LegDemand if legs else ValveCommands if law is None else None
    how = ({"command_delay": 0} if law is None else {}) | options | {"seed": seed}
    cases = _Cases(plant, laws, commands, table, how, channels, unknowns, folder)
    if workers is not None:
        cases.write(workers, progress)
    left = on_threads(cases.run, range(cases.count), threads, progress)
    if not cases.kept:
        raise OutOfBounds(f"all {cases.count} cases: {left[0]}", 0)
    return ManyRuns(cases.time, cases.kept, cases.units, tuple(left))


class _Cases:
    """The cases of one call, on whatever they run, and what they have left so far."""

    def __init__(
        self,
        plant: Plant | Callable[[int], Plant],
        laws: Sequence[Law | None],
        commands: Any,
        table: Any,
        how: dict[str, Any],
        channels: Sequence[str],
        unknowns: Unknowns | None,
        folder: str | Path | None,
    ) -> None:
        """Refuse what cannot be run, and open the journal of the folder."""
        first = plant(0) if callable(plant) else plant
        self.plant, self.laws, self.channels = plant, laws, tuple(channels)
        self.unknowns, self.folder = unknowns, folder
        self.commands = _commands(commands, table, first.machine.rate)
        self.count = len(self.commands)
        if len(laws) not in (1, self.count):
            text = f"law: {len(laws)} for {self.count} cases; allowed: one, or one a case"
            raise InputError(text)
        if self.count == 0 or not channels:
            raise InputError("commands, channels: none is given; allowed: at least one")
        self.settings = Run(plant=first, law=laws[0], source=self.commands[0], **how)
        rows, every = len(_rows(self.commands[0])), self.settings.record_every
        self.time = np.arange(0, rows, every, dtype=np.float64) / first.machine.rate
        self.kept: dict[str, NDArray[np.float64]] = {}
        self.units: dict[str, str] = {}
        self._lock, self._spare = threading.Lock(), SimpleQueue[Plant]()
        self._journal = None if folder is None else Journal(Path(folder), self._identity(first))

    def _identity(self, first: Plant) -> dict[str, Any]:
        """What the frames of a folder are of."""
        start, unknowns = self.settings.start, dict[str, Any](self.unknowns or {})
        return {
            "plant": "one a case" if callable(self.plant) else _digest(first.describe()),
            "laws": _digest([one and one.model_dump(mode="json") for one in self.laws]),
            "commands": _digest([_rows(one).tolist() for one in self.commands]),
            "start": None if start is None else np.asarray(start).tolist(),
            "unknowns": {name: one.model_dump(mode="json") for name, one in unknowns.items()},
            "settings": self.settings.model_dump(mode="json", exclude={"plant", "law"}),
            "channels": list(self.channels),
        }

    def task(self, case: int, plant: Plant | Callable[[int], Plant]) -> "_Task":
        """A case on a plant."""
        about = {} if callable(plant) else {"plant": plant}
        law = self.laws[case % len(self.laws)]
        run = self.settings.but(law=law, source=self.commands[case], **about)
        return _Task(case, run, plant, self.unknowns, self.channels, self.folder)

    def write(self, workers: Workers, progress: Callable[[int, int], None] | None) -> None:
        """Let workers write the frames that are not there yet."""
        if self._journal is None:
            raise InputError("workers: need a folder, where they write; allowed: with folder only")
        work = Work(_written, lambda error: [{"plant": "", "left": repr(error)}], _Task.of)
        tasks = [self.task(case, self.plant) for case in range(self.count)]
        run_tasks(self._journal, tasks, work, workers, progress)

    def run(self, case: int) -> str:
        """Run a case and keep its channels; why it left its bounds, empty where it did not."""
        plant = self._machine(case)
        try:
            record = self._record(case, plant)
        except OutOfBounds as end:
            return str(end)
        except InputError as refusal:
            raise InputError(f"case {case}: {refusal}") from None
        finally:
            if isinstance(self.plant, Plant):
                self._spare.put(plant)
        with self._lock:
            for name in self.channels:
                if name not in self.kept:
                    self.kept[name] = np.full((self.count, *record[name].shape), np.nan)
                    self.units[name] = record.units[name]
        for name in self.channels:
            self.kept[name][case] = record[name]
        return ""

    def _machine(self, case: int) -> Plant:
        """A plant that no other thread runs."""
        if not isinstance(self.plant, Plant):
            return self.plant(case)
        try:
            return self._spare.get_nowait()
        except Empty:
            return copy.deepcopy(self.plant)

    def _record(self, case: int, plant: Plant) -> Record:
        """The record of a case, which the folder may have already."""
        task = self.task(case, plant)
        if self._journal is None:
            return task.record(plant)
        if case not in self._journal.results:
            rows = _written(task)
            with self._lock:
                self._journal.add(case, rows)
        (row,) = self._journal.results[case]
        if row["plant"] not in ("", _digest(plant.describe())):
            allowed = "the same plant, or another folder"
            raise InputError(f"folder: {task.path.name} is of another plant; allowed: {allowed}")
        if row["left"]:
            raise OutOfBounds(row["left"], 0)
        return Record.load(task.path)


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
