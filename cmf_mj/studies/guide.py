"""A test guide: the tests that qualify a machine, its master, and what has changed since.

    title = "Quarterly"
    based_on = "part60"                  # a shipped guide; repeat what changes
    repetitions = 6                      # of each test for the master
    [tests.leg_balance]
    title = "Leg balance"
    source = "14 CFR 60, Table A2A 3.b"  # of test, measure and limit
    signal = { kind = "stepped_sines", dof = "heave", frequencies = [0.5], amplitudes = [1.0] }
    share = 0.3                          # of the machine's limits; sizes are then in proportion
    measures = ["leg_balance"]
    limits = {}                          # largest size of a measure by its name
    no_limit = "based on simulator capability"

A master is a folder: `guide.toml` says of which guide and machine it is, and which tests or
recordings are `left_out`, each with the reason; `TEST.1.parquet` and on are the repetitions, in any
form that `cmf fit` reads; their digests stand in it. A plan is a master without recordings, with a
host's frames for each test. Measures are computed when a folder is read, see `guide_check`, so that
a master of an older version is measured as the new one is.
"""

import copy
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.control.law import load_law
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Table
from cmf_mj.core.settings import Name, Settings, merged, read_toml, user_file, validated
from cmf_mj.core.threads import on_threads
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.run import Run
from cmf_mj.facility.signal import LegDemand
from cmf_mj.machine.geometry import dof_index
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.signals.signal import Command, Dof, plain
from cmf_mj.studies.case import frames_a_row
from cmf_mj.studies.fit.plan import STEP_CORNER, Workspace, named_beside, write_host
from cmf_mj.studies.measurement import MEASURES, SIGNED, Lines, lines_of

Array = NDArray[np.float64]

FILE = "guide.toml"  #: Head of a master.

_FOLDER = Path(__file__).with_name("guides")
GUIDES = tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))  #: Shipped guides.

RATE = 256  #: Samples a second of what is simulated [Hz].
BETWEEN = 10.0  #: Rest between two recordings of a plan [s].

Positive = Annotated[float, Field(gt=0.0)]
Texts = Annotated[tuple[str, ...], Field(strict=False)]


class TestSettings(Settings):
    """One test."""

    __test__ = False
    title: Annotated[str, Field(min_length=1)]
    source: Annotated[str, Field(min_length=1)]  #: Of test, measure and limit.
    conditions: str = "engaged, at neutral, nobody on board"
    signal: dict[str, Any]  #: As in scenario files, or `orthogonal_multisines`.
    dofs: Annotated[tuple[Dof, ...], Field(strict=False)] = ()  #: Run once along each.
    share: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    """Of the machine's limits that it uses; without it sizes are those of the signal."""
    law: str | None = None  #: Default that of the machine.
    measures: Texts = ()
    limits: Mapping[str, Positive] = {}  #: Largest size of measures by name.
    no_limit: str = ""  #: Why there is none.
    sought: Mapping[str, Positive] = {}
    """Changes of measures by name that repetitions shall find, of `signature [deviations]` too."""
    diagnosed: bool = False  #: Whether a diagnosis simulates it.


class GuideSettings(Settings):
    """A guide."""

    title: Annotated[str, Field(min_length=1)]
    source: str = ""
    repetitions: Annotated[int, Field(ge=2, le=1000)] = 6  #: Of each test of a master.
    false_alarm: Annotated[float, Field(gt=0.0, lt=0.5)] = 1e-3
    """Probability that a machine that has not changed is alarmed by the whole guide."""
    power: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.9
    """Probability with which a change that is sought is found."""
    tests: Annotated[Mapping[Name, TestSettings], Field(min_length=1)]


class MasterSettings(Settings):
    """Head of a master."""

    guide: GuideSettings
    machine: str
    cab: str | None = None
    hydraulics: str | None = None
    law: str | None = None
    columns: str | None = None  #: Column map of recordings; default the facility's.
    version: str = ""  #: That made it.
    simulated: bool = True
    left_out: Mapping[str, str] = {}
    """Why a test, `TEST`, was not finished, or a recording, `TEST.N`, does not count."""
    digests: Mapping[str, str] = {}  #: Of the recordings by file.

    def write(self, folder: Path) -> Path:
        """Write it into the folder of the master."""
        table = self.model_dump(mode="json", exclude_defaults=True)
        return write_text(folder / FILE, tomlkit.dumps(table))


def load_guide(source: str | Path) -> GuideSettings:
    """A shipped guide by name, see `GUIDES`, or a TOML file, which may be `based_on` one.

    Raises `InputError` that names file, test and what is wrong.

    >>> from cmf_mj.studies.guide import load_guide
    >>> load_guide("part60").tests["leg_balance"].no_limit
    'based on simulator capability'
    """
    shipped = _FOLDER / f"{source}.toml"
    path = shipped if str(source) in GUIDES else user_file("guide", GUIDES, source)
    table = read_toml(path)
    if "based_on" in table:
        base = check_name("based_on", str(table.pop("based_on")), GUIDES)
        table = merged(read_toml(_FOLDER / f"{base}.toml"), table, 3)
    guide = validated(GuideSettings, table, str(path))
    with within(path):
        for name, one in guide.tests.items():
            for measure in one.measures:
                check_name(f"tests.{name}.measures", measure, MEASURES)
            if not one.limits and not one.no_limit:
                raise InputError(f"tests.{name}.no_limit: is missing; it says why there is none")
    return guide


class Bench(NamedTuple):
    """A guide on a machine: what its tests demand."""

    guide: GuideSettings
    plant: Hexapod
    law: str | Path
    commands: Mapping[str, Command]  #: By test; of several degrees of freedom one each.
    of: Mapping[str, TestSettings]  #: Likewise.
    use: Mapping[str, float]  #: Share of the machine's limits that each uses.
    impossible: Mapping[str, str]  #: Tests that the machine cannot do, and why.

    @property
    def known(self) -> dict[str, Any]:
        """What identifies the machine that is tested."""
        law = load_law(self.law).name
        return {"machine": self.plant.machine.name, "cab": self.plant.cab, "law": law}

    def about(self, name: str) -> dict[str, Any]:
        """What a record of a test has to know."""
        return {"command": self.commands[name].signal.described(), "cab": self.plant.cab}

    def legs(self, name: str, rate: float | None = None) -> Array:
        """Demand of the legs [m] in a test, (N, 6), at a rate, by default the control law's."""
        machine, pose = self.plant.machine, self.commands[name].pose
        every = machine.rate / (rate or machine.rate)
        frames = np.arange(int((len(pose) - 1) / every + 1e-6) + 1) * every + 1e-6
        return pose_to_legs(pose[frames.astype(int)], machine)

    def lines(self, name: str, rate: float) -> Lines:
        """Lines of a test's signature, of recordings at a rate [Hz]."""
        return lines_of(self.legs(name, rate), rate)


MAKERS: dict[str, Callable[[Mapping[str, Any], Hexapod], Command]] = {}
"""What makes the command of a signal that is none of `composite.KINDS`, by its kind."""


def bench(
    guide: GuideSettings,
    machine: str | Path,
    cab: Any = None,
    hydraulics: Any = None,
    law: str | Path | None = None,
) -> Bench:
    """Put a machine to the tests of a guide; sizes are found within its limits.

    Raises `InputError` for a signal that cannot be made; what asks too much is `impossible`.
    """
    plant = Hexapod(cab, hydraulics, machine=machine)
    commands, of, use, impossible = {}, {}, {}, {}
    space = Workspace(plant, 1.0)
    for name, one in guide.tests.items():
        for dof in one.dofs or ("",):
            each = f"{name}_{dof}" if dof else name
            table = dict(one.signal) | ({"dof": dof} if dof else {})
            with within(f"tests.{name}.signal"):
                command, share = _command(table, one.share, space, plant)
            if share > 1.0:
                impossible[each] = f"asks for {share:.2f} times what the machine can"
            else:
                commands[each], of[each], use[each] = command, one, share
    return Bench(guide, plant, law or plant.machine.law, commands, of, use, impossible)


def _command(
    table: dict[str, Any], share: float | None, space: Workspace, plant: Hexapod
) -> tuple[Command, float]:
    """The command of a signal within its share of the machine's limits, and what it uses."""
    kind, rate = str(table.get("kind")), plant.machine.rate
    corner = STEP_CORNER if kind in ("step", "pulse", "chirp") else None
    if kind in MAKERS:
        command = MAKERS[kind](table, plant)
        return command, space.use(command.pose)
    chosen = composite.KINDS[check_name("kind", kind, [*composite.KINDS, *MAKERS])]

    def made(table: Mapping[str, Any]) -> Command:
        return validated(chosen, plain(table) | {"rate": rate}, kind).command()

    if share is not None:
        size = space.largest(lambda size: made(_sized(table, size, space)).pose, share, corner)
        table = _sized(table, size, space)
    command = made(table)
    return command, space.use(command.pose, corner)


def _sized(table: Mapping[str, Any], size: float, space: Workspace) -> dict[str, Any]:
    """A signal with its sizes in parts of what the machine reaches along each axis."""

    def reach(dof: str) -> float:
        return size * float(space.reach[dof_index(dof)])

    found = dict(table)
    for field in {"amplitude", "amplitudes", "acceleration"} & table.keys():
        sizes = table[field]
        if isinstance(sizes, Mapping):
            found[field] = {dof: part * reach(dof) for dof, part in sizes.items()}
        else:
            found[field] = (np.array(sizes) * reach(str(table["dof"]))).tolist()
    return found


def plan_guide(on: Bench, head: MasterSettings, folder: str | Path) -> Table:
    """Write the head of a master and the host's frames of each test; gives order and times."""
    target = _fresh(folder)
    rows, end, again = [], 0.0, on.guide.repetitions
    for number, (name, command) in enumerate(on.commands.items(), start=1):
        held = command.signal.kind in ("step", "pulse")
        write_host(command, target / f"host/{name}.csv", held=held)
        end += again * (command.duration + BETWEEN)
        row = (number, name, command.duration, again, 100.0 * on.use[name], end / 60.0)
        rows.append((*row, f"{name}.1.csv to {name}.{again}.csv"))
    head.write(target)
    columns = [
        *("", "test", ("length [s]", ".1f"), "repetitions", ("use [%]", ".0f")),
        *(("done after [min]", ".0f"), "record as"),
    ]
    caption = ". ".join(f"{name}: {why}" for name, why in on.impossible.items())
    table = Table(f"Order of the tests: {on.guide.title}", columns, rows, caption)
    table.save(target / "plan.md")
    return table


def _fresh(folder: str | Path) -> Path:
    target = Path(folder)
    if (target / FILE).exists():
        raise InputError(f"folder: {target} holds a guide's master, which is kept; name another")
    return target


def head_of(on: Bench, folder: str | Path = "", **named: Any) -> MasterSettings:
    """The head of a master, to stand in a folder, of a guide on a machine.

    Machine, cab, hydraulics and law are `named`, or files from here.
    """
    given = {key: str(value) for key, value in named.items() if value is not None}
    head = {"guide": on.guide.model_dump(), "version": version("cmf-mj")}
    return validated(MasterSettings, head | named_beside(given, Path(folder)), FILE)


def simulated(
    on: Bench,
    name: str,
    plant: Hexapod | None = None,
    electronics: ElectronicsSettings | None = None,
    *,
    shift: Array | None = None,
    seed: int = 0,
    record: Callable[[Run], Record] = Run.record,
) -> Record:
    """One repetition of a test on a machine, by default that of the guide.

    `shift` is what position sensors read too much [m], (6,): the machine follows the demand less
    it, and the reading shows it again. Another engine may `record`. Raises `OutOfBounds`.
    """
    plant = copy.deepcopy(on.plant if plant is None else plant)
    offset = np.zeros(plant.legs) if shift is None else shift
    legs = on.legs(name) - offset
    every = frames_a_row(plant.machine, RATE)
    start = legs_to_pose(legs[0], plant.machine)
    how: dict[str, Any] = {"law": on.of[name].law or on.law, "source": LegDemand(legs)}
    how |= {"start": start, "electronics": electronics, "seed": seed, "record_every": every}
    run = record(Run(plant=plant, **how))
    channels = {key: run[key] for key in ("leg_reference", *SIGNED)}
    channels |= {key: channels[key] + offset for key in ("leg_reference", "leg_position")}
    known = {key: run.metadata[key] for key in ("sample_rate", "law")} | plant.machine.known()
    units = {key: run.units[key] for key in channels}
    return Record(run.time, channels, units, known | on.about(name))


def run_guide(
    on: Bench,
    head: MasterSettings,
    folder: str | Path,
    *,
    repetitions: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **machine: Any,
) -> Path:
    """Record every test on a simulated machine with noisy electronics, a seed a repetition.

    `machine` is what `simulated` takes, of a machine that is not as the guide has it.
    """
    target = _fresh(folder)
    machine = {"electronics": ElectronicsSettings()} | machine
    again = repetitions or on.guide.repetitions
    cases = [(name, number) for name in on.commands for number in range(1, again + 1)]

    def made(case: tuple[str, int]) -> tuple[str, str]:
        name, number = case
        key = (list(on.commands).index(name), number)
        noise = int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0])
        with within(name):
            record = simulated(on, name, seed=noise, **machine)
        return record.save(target / f"{name}.{number}.parquet").name, record.digest

    target.mkdir(parents=True, exist_ok=True)
    digests = dict(on_threads(made, cases, jobs, progress))
    return head.model_copy(update={"digests": digests}).write(target)
