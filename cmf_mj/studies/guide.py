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
from cmf_mj.signals import CLASSES
from cmf_mj.signals.signal import Command, Dof, as_plain
from cmf_mj.studies.case import frames_a_row
from cmf_mj.studies.fit.plan import STEP_CORNER, Workspace, paths_from, write_host
from cmf_mj.studies.measurement import MEASURES, SIGNATURE_CHANNELS, Lines, signature_lines

Array = NDArray[np.float64]

FILE = "guide.toml"  #: Head of a master.

_FOLDER = Path(__file__).with_name("guides")
GUIDES = tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))  #: Shipped guides.

RATE = 256  #: Samples a second of what is simulated [Hz].
PAUSE = 10.0  #: Rest between two recordings of a plan [s].

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
        for name, test in guide.tests.items():
            for measure in test.measures:
                check_name(f"tests.{name}.measures", measure, MEASURES)
            if not test.limits and not test.no_limit:
                raise InputError(f"tests.{name}.no_limit: is missing; it says why there is none")
    return guide


class Bench(NamedTuple):
    """A guide on a machine: what its tests demand."""

    guide: GuideSettings
    plant: Hexapod
    law: str | Path
    commands: dict[str, Command]  #: By test, of several degrees of freedom by `TEST_DOF`.
    tests: dict[str, TestSettings]  #: By test.
    used_share: dict[str, float]  #: Of the machine's limits, by test.
    impossible: dict[str, str]  #: Tests that the machine cannot do, and why.

    @property
    def identity(self) -> dict[str, Any]:
        """Names of machine, cab and law."""
        law = load_law(self.law).name
        return {"machine": self.plant.machine.name, "cab": self.plant.cab, "law": law}

    def metadata(self, name: str) -> dict[str, Any]:
        """Metadata of the records of a test."""
        return {"command": self.commands[name].signal.described(), "cab": self.plant.cab}

    def legs(self, name: str, rate: float | None = None) -> Array:
        """Demand of the legs [m] in a test, (N, 6), at a rate, by default the control law's."""
        machine, pose = self.plant.machine, self.commands[name].pose
        spacing = machine.rate / (rate or machine.rate)
        frames = np.arange(int((len(pose) - 1) / spacing + 1e-6) + 1) * spacing + 1e-6
        return pose_to_legs(pose[frames.astype(int)], machine)

    def lines(self, name: str, rate: float) -> Lines:
        """Lines of a test's signature, of recordings at a rate [Hz]."""
        return signature_lines(self.legs(name, rate), rate)


COMMAND_MAKERS: dict[str, Callable[[Mapping[str, Any], Hexapod], Command]] = {}
"""Functions that make commands of further kinds of signals, by kind; other rooms add theirs."""


def make_bench(
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
    bench = Bench(guide, plant, law or plant.machine.law, {}, {}, {}, {})
    workspace = Workspace(plant, 1.0)
    for name, test in guide.tests.items():
        for dof in test.dofs or ("",):
            test_name = f"{name}_{dof}" if dof else name
            table = dict(test.signal) | ({"dof": dof} if dof else {})
            with within(f"tests.{name}.signal"):
                command, share = _make_command(table, test.share, workspace, plant)
            if share > 1.0:
                text = f"asks for {share:.2f} times what the machine can"
                bench.impossible[test_name] = text
            else:
                bench.commands[test_name], bench.tests[test_name] = command, test
                bench.used_share[test_name] = share
    return bench


def _make_command(
    table: dict[str, Any], share: float | None, workspace: Workspace, plant: Hexapod
) -> tuple[Command, float]:
    """The command of a signal within its share of the machine's limits, and the share it uses."""
    kind, rate = str(table.get("kind")), plant.machine.rate
    corner = STEP_CORNER if kind in ("step", "pulse", "chirp") else None
    if kind in COMMAND_MAKERS:
        command = COMMAND_MAKERS[kind](table, plant)
        return command, workspace.used_share(command.pose)
    signal = CLASSES[check_name("kind", kind, [*CLASSES, *COMMAND_MAKERS])]

    def make(size: float | None) -> Command:
        scaled = table if size is None else _scaled_table(table, size, workspace)
        return validated(signal, as_plain(scaled) | {"rate": rate}, kind).command()

    size = None
    if share is not None:
        size = workspace.largest_size(lambda size: make(size).pose, share, corner)
    command = make(size)
    return command, workspace.used_share(command.pose, corner)


def _scaled_table(table: Mapping[str, Any], size: float, workspace: Workspace) -> dict[str, Any]:
    """A signal with its sizes in parts of what the machine reaches along each axis."""

    def reach(dof: str) -> float:
        return size * float(workspace.reach[dof_index(dof)])

    scaled = dict(table)
    for field in {"amplitude", "amplitudes", "acceleration"} & table.keys():
        parts = table[field]
        if isinstance(parts, Mapping):
            scaled[field] = {dof: part * reach(dof) for dof, part in parts.items()}
        else:
            scaled[field] = (np.array(parts) * reach(str(table["dof"]))).tolist()
    return scaled


def plan_guide(bench: Bench, head: MasterSettings, folder: str | Path) -> Table:
    """Write the head of a master and the host's frames of each test; returns order and times."""
    target = _new_folder(folder)
    rows, elapsed, repetitions = [], 0.0, bench.guide.repetitions
    for number, (name, command) in enumerate(bench.commands.items(), start=1):
        is_held = command.signal.kind in ("step", "pulse")
        write_host(command, target / f"host/{name}.csv", is_held=is_held)
        elapsed += repetitions * (command.duration + PAUSE)
        use, files = 100.0 * bench.used_share[name], f"{name}.1.csv to {name}.{repetitions}.csv"
        rows.append((number, name, command.duration, repetitions, use, elapsed / 60.0, files))
    head.write(target)
    columns: list[str | tuple[str, str]]
    columns = ["", "test", ("length [s]", ".1f"), "repetitions", ("use [%]", ".0f")]
    columns += [("done after [min]", ".0f"), "record as"]
    caption = ". ".join(f"{name}: {reason}" for name, reason in bench.impossible.items())
    table = Table(f"Order of the tests: {bench.guide.title}", columns, rows, caption)
    table.save(target / "plan.md")
    return table


def _new_folder(folder: str | Path) -> Path:
    target = Path(folder)
    if (target / FILE).exists():
        raise InputError(f"folder: {target} holds a guide's master, which is kept; name another")
    return target


def make_head(bench: Bench, folder: str | Path = "", **sources: Any) -> MasterSettings:
    """The head of a master, to stand in a folder, of a guide on a machine.

    `sources` of machine, cab, hydraulics and law are names, or files from here.
    """
    texts = {key: str(source) for key, source in sources.items() if source is not None}
    head = {"guide": bench.guide.model_dump(), "version": version("cmf-mj")}
    return validated(MasterSettings, head | paths_from(Path(folder), texts), FILE)


def simulate_test(
    bench: Bench,
    name: str,
    plant: Hexapod | None = None,
    electronics: ElectronicsSettings | None = None,
    *,
    shift: Array | None = None,
    seed: int = 0,
    record: Callable[[Run], Record] = Run.record,
) -> Record:
    """One repetition of a test on a machine, by default that of the guide.

    `shift` is the error of position sensors [m], (6,): the machine follows the demand less it, and
    the reading shows it again. Another engine may `record`. Raises `OutOfBounds`.
    """
    plant = copy.deepcopy(bench.plant if plant is None else plant)
    offset = np.zeros(plant.legs) if shift is None else shift
    legs = bench.legs(name) - offset
    start, row_frames = legs_to_pose(legs[0], plant.machine), frames_a_row(plant.machine, RATE)
    settings: dict[str, Any] = {"law": bench.tests[name].law or bench.law, "start": start}
    settings |= {"electronics": electronics, "seed": seed, "record_every": row_frames}
    full_record = record(Run(plant=plant, source=LegDemand(legs), **settings))
    channels = {key: full_record[key] for key in ("leg_reference", *SIGNATURE_CHANNELS)}
    channels |= {key: channels[key] + offset for key in ("leg_reference", "leg_position")}
    units = {key: full_record.units[key] for key in channels}
    metadata = {key: full_record.metadata[key] for key in ("sample_rate", "law")}
    metadata |= plant.machine.metadata() | bench.metadata(name)
    return Record(full_record.time, channels, units, metadata)


def run_guide(
    bench: Bench,
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

    `machine` is what `simulate_test` takes, of a machine that is not as the guide has it.
    """
    target = _new_folder(folder)
    machine = {"electronics": ElectronicsSettings()} | machine
    numbers = range(1, (repetitions or bench.guide.repetitions) + 1)
    cases = [(name, number) for name in bench.commands for number in numbers]

    def record_case(case: tuple[str, int]) -> tuple[str, str]:
        name, number = case
        key = (list(bench.commands).index(name), number)
        (noise_seed,) = np.random.SeedSequence(seed, spawn_key=key).generate_state(1)
        with within(name):
            record = simulate_test(bench, name, seed=int(noise_seed), **machine)
        return record.save(target / f"{name}.{number}.parquet").name, record.digest

    target.mkdir(parents=True, exist_ok=True)
    digests = dict(on_threads(record_case, cases, jobs, progress))
    return head.model_copy(update={"digests": digests}).write(target)
