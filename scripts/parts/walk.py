"""Every command on every kind of machine: what runs, what is refused, and why.

    python scripts/machines.py walk                       # all pairs, about an hour
    python scripts/machines.py walk --pairs 24 --seed 1   # drawn, each kind and each command

Machines are those that ship, their cabs, and machines of one's own: a file that `cmf machine new`
wrote, and what it becomes with dry friction, unequal actuators, another control rate, cylinders of
equal areas, one valve a cylinder and a cab of its own. Each pair is the shortest useful run of the
command. It ends well, is refused with one message before anything is written, or is a defect; the
last end the script with status 1. Writes `machines.csv` and `machines.md`.
"""

import argparse
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomlkit
from typer.testing import CliRunner

import cmf_mj
from cmf_mj.cli.common import app
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table
from cmf_mj.facility.host.stream import from_command, write_stream
from cmf_mj.pilot.flight import Flight, load_flight
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.signals import chirp, sine

HYDRAULICS: Mapping[str, Mapping[str, tuple[float, str]]] = {
    "friction": {"coulomb_friction": (60.0, "N"), "breakaway_friction": (70.0, "N")},
    "equal_areas": {"rods": (2, "1")},
    "one_valve": {"valves": (1, "1")},
}
"""What differs in the hydraulics of machines of one's own."""

GUIDE = Path(__file__).resolve().parents[1] / "guides.toml"  #: The short test guide.

UNEQUAL: Mapping[str, Mapping[str, tuple[float, str]]] = {
    "leg_2": {"leak_rate": (4.0, "1/s")},
    "leg_5": {"drive_lag": (50.0, "Hz")},
}

COMMANDS: dict[str, str] = {
    "machine check": "machine check {name}",
    "machine build": "machine build {name}",
    "list": "list hydraulics --machine {name}",
    "linearize": "linearize {machine} {dry} --dofs heave,leg_1",
    "modes": "modes {cabs} --samples 90 --rounds 0",
    "compare": "compare {machine} --dofs heave --quick --no-records",
    "guide run": f"guide run {GUIDE} {{machine}} --repetitions 2",
    "measure": "measure swept.parquet --machine {name}",
    "identify": "identify swept.parquet --orders 2,1,1",
    "run": "run run.toml {cab}",
    "replay": "replay record.parquet",
    "operate": "operate host.csv {machine} --seconds 3",
    "serve": "serve {machine} --port 0 --seconds 1",
    "export law": "export law {machine}",
    "export library": "export library {machine}",
    "export fmu": "export fmu {machine}",
    "failure": "failure pump_lost {machine} --at 1 --after 6",
    "cue": "cue flight.csv {cab}",
    "omct": "omct {machine} --dofs heave --quick",
    "fly": "fly flight.csv {machine}",
    "learn": "learn flight.csv {machine} --trials 1",
    "play": "play run.toml {cab} --seconds 0.2 --file out/play.html",
    "tune": "tune {cabs} {dry} --form velocity --evaluations 1 --file out/law.toml",
    "certify": "certify {law} {cabs} {dry} --quick",
}
"""The shortest useful line of each command."""


class Kind(NamedTuple):
    """A kind of machine, as options name it."""

    name: str  #: Name or file.
    cab: str = ""  #: Name or file; default the machine's first.
    dry: bool = False  #: Whether its legs have dry friction.

    def words(self) -> dict[str, str]:
        """What fills the lines of commands in."""
        machine, cab = f"--machine {self.name}", f" --cab {self.cab}" if self.cab else ""
        cabs = f" --cabs {self.cab or next(iter(cmf_mj.load_machine(self.name).cabs))}"
        law = cmf_mj.load_machine(self.name).law
        return {
            **{"name": self.name, "machine": machine + cab, "cab": machine + cab},
            **{"cabs": machine + cabs, "law": law, "dry": "--friction none" if self.dry else ""},
        }


class Pair(NamedTuple):
    """A command on a machine."""

    command: str
    machine: str
    ended: str  #: `runs`, `refused` or `defect`.
    said: str  #: Why, of what does not run.
    seconds: float


PAIRS = (
    *map(Field, ("command", "machine", "ended")),
    Field("said", "reason"),
    Field("seconds", form=".1f", unit="s"),
)


def quantity(value: float, unit: str) -> dict[str, object]:
    """A number as a file states it."""
    return {"value": value, "unit": unit, "status": "assumed", "source": "a machine to walk"}


def write_machines(folder: Path) -> dict[str, Kind]:
    """Write the machines of one's own; all kinds by name."""
    runner = CliRunner()
    made = runner.invoke(app, ["machine", "new", "mine", "--file", str(folder / "mine.toml")])
    if made.exit_code:
        raise SystemExit(made.output)
    text = (folder / "mine.toml").read_text()
    kinds = {
        **{f"cmf {cab}": Kind("cmf", cab) for cab in cmf_mj.load_machine("cmf").cabs},
        **{name: Kind(name) for name in ("simona", "lab")},
        "file": Kind(str(folder / "mine.toml")),
    }

    def own(name: str, change: Mapping[str, object], part: str) -> Path:
        table = tomlkit.parse(text)
        table["name"] = name
        (table if part == "" else table[part]).update(change)
        path = folder / f"{name}.toml"
        path.write_text(tomlkit.dumps(table))
        return path

    for name, numbers in HYDRAULICS.items():
        change = {field: quantity(*pair) for field, pair in numbers.items()}
        path = own(name, change, "hydraulics")
        kinds[f"file, {name.replace('_', ' ')}"] = Kind(str(path), dry=name == "friction")
    unequal = {
        leg: {field: quantity(*pair) for field, pair in numbers.items()}
        for leg, numbers in UNEQUAL.items()
    }
    path = own("unequal", {"actuators": unequal}, "hydraulics")
    kinds["file, unequal actuators"] = Kind(str(path))
    path = own("slower", {"control_rate": quantity(1000, "Hz")}, "")
    kinds["file, 1000 Hz"] = Kind(str(path))
    cab = {"base": "payload", "heavier": {"mass": quantity(330.0, "kg")}}
    (folder / "cab.toml").write_text(tomlkit.dumps(cab))
    kinds["file, cab of a file"] = Kind(str(folder / "mine.toml"), str(folder / "cab.toml"))
    kinds["file, cab by name"] = Kind(str(folder / "mine.toml"), "payload")
    return kinds


def write_inputs(folder: Path, kind: Kind) -> None:
    """What lines read: a scenario, its record, a host's file and a short flight."""
    scenario = {"machine": kind.name, "duration": 1.5, "record_every": 8}
    motion = {"kind": "sine", "dof": "heave", "amplitude": [4.0, "mm"], "frequency": 2.0}
    table = {"title": "A sine", **scenario, "signal": [motion | {"cycles": 2.0}]}
    (folder / "run.toml").write_text(tomlkit.dumps(table))
    plant = cmf_mj.Hexapod(cmf_mj.load_cab(kind.cab or None, kind.name))
    law = cmf_mj.load_law(plant.machine.law)
    command = sine("heave", 0.004, 2.0, cycles=4.0)
    record = cmf_mj.simulate(plant, law, command, record_every=8)
    record.save(folder / "record.parquet")
    swept = cmf_mj.simulate(plant, law, chirp("heave", 0.002, duration=24.0), record_every=8)
    swept.save(folder / "swept.parquet")
    write_stream(from_command(command), folder / "host.csv")
    flight = load_flight("turn")
    short = flight.motion.time < flight.motion.time[0] + 6.0
    parts = {one.name: getattr(flight.motion, one.name)[short] for one in fields(flight.motion)}
    Flight(PilotMotion(**parts), flight.origin).save(folder / "flight.csv")


def walk(kinds: Mapping[str, Kind], chosen: list[tuple[str, str]], folder: Path) -> Iterator[Pair]:
    """Run pairs of machine and command."""
    runner, before = CliRunner(), ""
    for name, command in sorted(chosen, key=lambda pair: list(kinds).index(pair[0])):
        kind = kinds[name]
        if name != before:
            write_inputs(folder, kind)
            before = name
        shutil.rmtree(folder / "out", ignore_errors=True)
        line = COMMANDS[command].format(**kind.words()).split()
        begun = time.monotonic()
        with chdir(folder):
            ended = runner.invoke(app, line)
        took, said = time.monotonic() - begun, " ".join(ended.output.split()[-60:])
        said = said.replace(f"{folder}/", "")
        if ended.exit_code == 0 or (ended.exit_code == 1 and command == "machine check"):
            yield Pair(command, name, "runs", "", took)
        elif ended.exit_code == 2 and "cmf: " in ended.output and not (folder / "out").exists():
            yield Pair(command, name, "refused", said.partition("cmf: ")[2], took)
        else:
            yield Pair(command, name, "defect", said or repr(ended.exception), took)


def drawn(kinds: Mapping[str, Kind], count: int, seed: int) -> list[tuple[str, str]]:
    """At least `count` pairs in which each kind and each command is."""
    generator, pairs = np.random.default_rng(seed), set[tuple[str, str]]()
    names, commands = list(kinds), list(COMMANDS)
    while len(pairs) < count:
        rows, columns = (generator.permutation(len(one)) for one in (names, commands))
        for i in range(max(len(names), len(commands))):
            pairs.add((names[rows[i % len(names)]], commands[columns[i % len(commands)]]))
    return sorted(pairs)


def summary(rows: Sequence[Pair]) -> Table:
    """A row for each command, and below it one for each reason for which it refuses machines."""
    table, kinds = [], list(dict.fromkeys(row.machine for row in rows))
    for command in dict.fromkeys(row.command for row in rows):
        by_reason: dict[tuple[str, str], list[str]] = {}
        for row in rows:
            if row.command == command:
                by_reason.setdefault((row.ended, row.said), []).append(row.machine)
        for number, ((ended, said), machines) in enumerate(sorted(by_reason.items(), reverse=True)):
            where = "all" if len(machines) == len(kinds) else "; ".join(machines)
            table.append((command if number == 0 else "", ended, where, said))
    return Table("", ("command", "ended", "machines", "reason"), table)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--machines", help="kinds with commas between; default all")
    parser.add_argument("--commands", help="commands with commas between; default all")
    parser.add_argument("--pairs", type=int, help="how many to draw; default all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/walk"))


def run(options: argparse.Namespace) -> None:
    """Walk and write the table."""
    out = options.out.resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        kinds = write_machines(folder)
        names = options.machines.split("; ") if options.machines else list(kinds)
        commands = options.commands.split(",") if options.commands else list(COMMANDS)
        chosen = [(name, command) for name in names for command in commands]
        if options.pairs:
            chosen = drawn(kinds, options.pairs, options.seed)
        rows = []
        for pair in walk(kinds, chosen, folder):
            rows.append(pair)
            print(f"{pair.seconds:6.1f} s  {pair.ended:8s}{pair.command:22s}{pair.machine}")
            print(f"{'':18s}{pair.said}" if pair.said else "", end="\n" if pair.said else "")
    Result(rows, PAIRS, "Commands on machines").save(out / "machines.csv")
    write_text(out / "machines.md", summary(rows).markdown())
    raise SystemExit(any(pair.ended == "defect" for pair in rows))
