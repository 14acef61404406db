"""One run of the whole system: production code from the host's port to the file of the record.

Only the clock, the network and the disk are the run's: `serve` runs unpaced, the doors read a
`Line` in place of their socket, and a disk that is full, or a process that is killed while it
writes, ends the first saving.
"""

import errno
import hashlib
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pyarrow.parquet
import tomlkit
from numpy.typing import NDArray

from cmf_mj import Hexapod
from cmf_mj.cli.machine import new_command
from cmf_mj.control.law import load_law
from cmf_mj.control.states import Request, State, StateSettings, load_state_settings
from cmf_mj.core.errors import RunError
from cmf_mj.core.files import exclusive_folder
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.host import moog, port, udp
from cmf_mj.facility.operation import Operation, serve
from cmf_mj.facility.session import Session
from cmf_mj.pilot import live
from cmf_mj.pilot.washout import Washout
from cmf_mj.plant.events import default_event
from cmf_mj.plant.parameters import fitting
from cmf_mj.record.record import Record
from faults.hosts import HOST, Array, Line, MoogLine, datagrams
from faults.plans import Action, Plan

ELECTRONICS = {
    "": None,
    "ideal": ElectronicsSettings(sensors="ideal", converters="off"),
    "noisy": ElectronicsSettings(),
}


class Part(NamedTuple):
    """One process: from its start until it ends or is killed."""

    first: float  #: When it began [s].
    operation: Operation
    frames: NDArray[np.int64]  #: Control frames at whose pressures somebody looked, (M,).
    pressure: Array  #: True pressures there, (M, 6, 2) [Pa].
    received: int  #: Frames that the door put into its ring.


class Run(NamedTuple):
    """What became of a plan."""

    plan: Plan
    plant: Hexapod
    parts: list[Part]
    sent: int  #: Datagrams that arrived.
    end: State  #: Operating state at the end.
    stopped: str  #: What the run stopped itself for; empty if it did not.
    damage: str  #: What an interrupted saving has damaged; empty for nothing.

    def digest(self) -> str:
        """SHA-256 of all that was recorded."""
        whole = hashlib.sha256()
        for part in self.parts:
            for name, values in sorted(part.operation.record.channels.items()):
                whole.update(name.encode() + np.ascontiguousarray(values).tobytes())
        return whole.hexdigest()


class _Killed(BaseException):
    """The process ends here, whatever it was at."""


@lru_cache(maxsize=4)
def _machine_file(rate: int) -> str:
    """A file of `cmf machine new`, at a control rate [Hz]."""
    path = Path(tempfile.mkdtemp()) / "mine.toml"
    with patch("cmf_mj.cli.machine.show"):
        new_command("mine", path)
    table = tomlkit.parse(path.read_text(encoding="utf-8"))
    source = {"status": "assumed", "source": "the seed"}
    table["control_rate"] = tomlkit.inline_table()
    table["control_rate"].update({"value": float(rate), "unit": "Hz"} | source)
    path.write_text(_headed(tomlkit.dumps(table)), encoding="utf-8")
    return str(path)


def _headed(text: str) -> str:
    """The control rate before the first table."""
    lines = text.splitlines()
    (line,) = (line for line in lines if line.startswith("control_rate"))
    return "\n".join([line, *(other for other in lines if other != line)]) + "\n"


@lru_cache(maxsize=8)
def _plant(machine: str, hydraulics: str, rate: int) -> Hexapod:
    name, _, cab = machine.partition("/")
    source = _machine_file(rate) if name == "new" else name
    return Hexapod(cab or None, hydraulics or None, machine=source)


def _states(plant: Hexapod) -> StateSettings:
    """The machine's, with fades of a second at least, so that a short run sees many of them."""
    table = load_state_settings(None, fitting(plant.machine)).model_dump()
    for name in ("raise", "engage", "hold", "return", "fault"):
        table[f"{name}_time"] |= {"value": 1.0, "unit": "s"}
    for name in ("speed", "acceleration"):
        table[name]["value"] *= 4.0
    return StateSettings.model_validate(table)


class _Door(NamedTuple):
    ring: Any
    attend: Callable[[Session], int]


@contextmanager
def _door(plan: Plan, line: Line, plant: Hexapod) -> Iterator[_Door]:
    """The production door of the plan's kind, with the line in place of its socket."""
    cab = plant.cab_parameters
    with ExitStack() as patches:
        for module in (live, port):
            patches.enter_context(patch.object(module, "open_socket", lambda *_: line))
        if plan.door == "moog":
            base = patches.enter_context(moog.MoogServer(host_port=HOST[1]))
            yield _Door(base.ring, base.attend)
        elif plan.door == "telemetry":
            washout = Washout("simona", cab=cab)
            host = live.LiveHost("csv", 0, HOST[0], washout)
            yield _Door(host.ring, host.attend)
        else:
            idle = SimpleNamespace(start=lambda: None, join=lambda: None)
            threads = SimpleNamespace(Thread=lambda **_: idle, Event=threading.Event)
            patches.enter_context(patch.object(udp, "threading", threads))
            receiver = patches.enter_context(udp.UdpReceiver(host_port=HOST[1]))

            def attend(session: Session) -> int:
                while line.next <= line.now:
                    receiver._store_next_frame()
                return 1

            yield _Door(receiver.ring, attend)


class _Attendant:
    """Moves the clock, attends to the door, and does what the operator does by hand."""

    def __init__(self, plan: Plan, line: Line, door: _Door, first: float) -> None:
        self.frames: list[int] = []
        self.pressure: list[Array] = []
        self.session: Session | None = None
        self._plan, self._line, self._door, self._first, self._due = plan, line, door, first, 0
        self._todo = [a for a in plan.actions if a.at >= first and self._by_hand(a)]

    def _by_hand(self, action: Action) -> bool:
        parks = self._plan.door == "moog" and action.kind == "request" and action.what == "off"
        return action.kind == "law" or parks

    def attend(self, session: Session) -> int:
        self.session = session
        plan, line, rate = self._plan, self._line, session.rate
        line.now = self._first + session.frame / rate
        if session.frame:
            self.frames.append(session.frame - 1)
            self.pressure.append(session.dynamics.state.pressure.copy())
        while self._todo and self._todo[0].at <= line.now:
            action = self._todo.pop(0)
            if action.kind == "law":
                session.engage(load_law(action.what))
            else:
                line.word = moog.Word.PARK  # type: ignore[attr-defined]
        if plan.way_out and line.now >= plan.seconds:
            self._engage(session)
        if session.frame >= self._due:
            wait = self._door.attend(session)
            if plan.door == "native":
                wait = int(np.ceil(min((line.next - line.now) * rate, plan.piece)))
            self._due = session.frame + max(wait, 1)
        stops = [self._due, session.frame + plan.piece]
        stops += [int(np.ceil((a.at - self._first) * rate)) for a in self._todo[:1]]
        return max(min(stops) - session.frame, 1)

    def _engage(self, session: Session) -> None:
        """The operator's way back; a Moog client says itself what is said from off and fault."""
        progress = session.source.progress[0]
        if progress.state == State.FAULT:
            wanted = Request.RESET
        else:
            wanted = Request.ENGAGE
        if self._plan.door != "moog" or progress.state not in (State.FAULT, State.OFF):
            progress.request = wanted.value


def _part(plan: Plan, plant: Hexapod, line: Line, first: float, last: float) -> tuple[Part, State]:
    electronics = ELECTRONICS[plan.electronics]
    if electronics is not None:
        electronics = electronics.model_copy(update={"seed": plan.seed})
    requests = [
        (a.at - first, Request[a.what.upper()])
        for a in plan.actions
        if a.kind == "request" and first <= a.at and (plan.door != "moog" or a.what != "off")
    ]
    events = []
    for a in plan.actions:
        if a.kind == "event":
            leg = a.where if a.what.startswith(("valve", "sensor")) else None
            events.append(default_event(a.what, max(a.at - first, 0.0), leg=leg))
    with _door(plan, line, plant) as door:
        attendant = _Attendant(plan, line, door, first)
        operation = serve(
            plant,
            plan.law or plant.machine.law,
            door.ring,
            last - first,
            attend=attendant.attend,
            paced=False,
            begin=State[plan.begin.upper()],
            requests=requests,
            events=events,
            states=_states(plant),
            electronics=electronics,
            record_every=1,
        )
        received = int(door.ring.written[0])
    looked = np.array(attendant.frames), np.array(attendant.pressure)
    state = State(int(operation.record["operating_state"][-1]))
    return Part(first, operation, *looked, received), state


def run(plan: Plan) -> Run:
    """Run a plan: a kill ends a part, and the machine goes on in a new process."""
    plant = _plant(plan.machine, plan.hydraulics, plan.control_rate)
    end = plan.seconds + plan.way_out
    coming = datagrams(plan, end + 0.1)
    line = (MoogLine if plan.door == "moog" else Line)(coming)
    kills = [a.at for a in plan.actions if a.kind == "kill" and 0.05 < a.at < plan.seconds]
    parts: list[Part] = []
    stopped, state = "", State[plan.begin.upper()]
    try:
        for first, last in pairwise([0.0, *kills, end]):
            part, state = _part(plan, plant, line, first, last)
            parts.append(part)
    except RunError as error:
        stopped = str(error)
    damage = _saved(parts[-1].operation.record, plan) if parts and plan.disk else ""
    return Run(plan, plant, parts, len(line.taken), state, stopped, damage)


@contextmanager
def _interrupted(plan: Plan) -> Iterator[None]:
    """A disk that is full, or a process that is killed, at some octet of the next file."""
    write, rng = pyarrow.parquet.write_table, np.random.default_rng([plan.seed, 5])

    def cut(table: Any, where: Path, **how: Any) -> None:
        write(table, where, **how)
        content = Path(where).read_bytes()
        Path(where).write_bytes(content[: int(rng.integers(len(content) + 1))])
        if plan.disk == "kill":
            raise _Killed
        raise OSError(errno.ENOSPC, "No space left on device")

    with ExitStack() as patches:
        patches.enter_context(patch.object(pyarrow.parquet, "write_table", cut))
        if plan.disk == "kill":  # who is killed cleans up nothing
            patches.enter_context(patch.object(Path, "unlink", lambda *_, **__: None))
        try:
            yield
        except (OSError, _Killed):
            return
    raise AssertionError("the saving was not interrupted")


def _saved(record: Record, plan: Plan) -> str:
    """Save as a process that is interrupted, one that is not, and one that is; what is wrong."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        target = folder / "run" / "record.parquet"
        with _interrupted(plan):
            record.save(target)
        if target.exists():
            return "a record that was not whole took its name"
        with exclusive_folder(target.parent):
            record.save(target)
        for again in (False, True):
            if again:
                with _interrupted(plan):
                    record.save(target)
            loaded = Record.load(target)
            for channel, values in record.channels.items():
                if loaded[channel].tobytes() != values.tobytes():
                    return f"{channel} came back with other bits"
            with exclusive_folder(target.parent):
                left = [path.name for path in target.parent.iterdir()]
            if left != [target.name]:
                return f"the next process found {left}"
    return ""
