"""A session of one browser tab: a thread that advances the closed loop to wall-clock time.

Everything that touches the run happens in the thread: whoever wants something of it asks, and the
thread does it between two parts. Nothing here knows the page. At every turn the thread runs the
frames that are due by the wall clock, never more than `LARGEST` at once: a machine that cannot keep
up falls behind, and the time given up so is counted and stated, not dropped in silence.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Collection
from concurrent.futures import Future
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.protection import Fault
from cmf_mj.core.errors import CmfError, InputError
from cmf_mj.core.units import FRAME, RATE
from cmf_mj.facility.run import Run, SignalSession
from cmf_mj.facility.session import Live
from cmf_mj.facility.settings import Change
from cmf_mj.facility.signal import HostFile
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import SingleSignal

LARGEST = 0.25  #: Wall time made up for at most in one turn [s].

_WINDOW = 2.0  #: Wall time the ratios are taken over [s].


class SessionPace(NamedTuple):
    """How a session keeps up, over the last two seconds."""

    factor: float  #: Simulated time over wall time while running; the speed is what it should be.
    capacity: float
    """Simulated time over the time the thread was busy with it, drawing included: the real-time
    factor it would reach without waiting."""
    given_up: float  #: Wall time given up since the start because the machine was too slow [s].


class Clock:
    """Wall time to control frames for one session."""

    def __init__(self, now: float) -> None:
        """Begin to count at a reading of a monotonic clock [s]."""
        self._turns: deque[tuple[float, float, float]] = deque()
        self.speed = 1.0
        """Simulated seconds in a second of wall time, as chosen."""
        self.paused = False
        """Whether time stands still."""
        self.restart(now)

    def restart(self, now: float) -> None:
        """Owe nothing and forget the account, for a new run."""
        self._last, self._owed, self._given_up = now, 0.0, 0.0
        self._turns.clear()

    def due(self, now: float) -> int:
        """Frames to run at a reading of the clock [s]."""
        elapsed, self._last = now - self._last, now
        if self.paused:
            return 0
        self._owed += elapsed
        missed = max(self._owed - LARGEST, 0.0)
        self._given_up += missed
        self._owed -= missed
        frames = int(self._owed * self.speed / FRAME)
        self._owed -= frames * FRAME / self.speed
        return frames

    def ran(self, wall: float, frames: int, busy: float) -> None:
        """Note a turn: wall time since the last [s], frames run, time to run and show them [s]."""
        self._turns.append((wall, frames * FRAME, busy))
        while sum(turn[0] for turn in self._turns) - self._turns[0][0] > _WINDOW:
            self._turns.popleft()

    @property
    def pace(self) -> SessionPace:
        """How the session keeps up; NaN before the first turn."""
        wall, simulated, busy = np.sum(self._turns, axis=0) if self._turns else (np.nan,) * 3
        return SessionPace(float(simulated / wall), float(simulated / busy), self._given_up)


TURN = 1.0 / 30.0  #: Time from picture to picture [s].

KEPT_ROWS = 76_800  #: Rows of the record a session keeps, about 90 MB: ten minutes at 128 Hz.

PLOT_RATE = 64
"""States kept for the plots in a second of simulated time [Hz]; the fastest excitation has 10."""

LONGEST = 20.0  #: Time they are kept [s].

_PART = RATE // PLOT_RATE

Answer = TypeVar("Answer")


class Mark(NamedTuple):
    """Something that happened."""

    time: float  #: When [s].
    text: str  #: What.
    harm: bool  #: Whether something failed or tripped.


def marks_of(scenario: Run, fault: Fault | None) -> tuple[Mark, ...]:
    """All that has happened to a run that did this scenario, in order of time."""
    rate = scenario.rate
    marks = [Mark(one.at, words(one.kind, one.leg, one.valve), True) for one in scenario.events]
    for change in scenario.change:
        time = change.when(rate) / rate
        marks += [Mark(time, words(one.kind, one.leg, one.valve), True) for one in change.failure]
        if texts := _texts(change):
            marks.append(Mark(time, ", ".join(texts), False))
    if fault is not None:
        text = f"tripped: {words(fault.name, fault.leg)}"
        marks.append(Mark(fault.frame / rate, text, True))
    return tuple(sorted(marks))


def words(name: str, leg: int | None, valve: int | None = None) -> str:
    """What failed or was detected, of which leg and which of its valves."""
    which = f", valve {valve}" if valve else ", all its valves" * name.startswith("valve")
    return name.replace("_", " ") + ("" if leg is None else f" of leg {leg}{which}")


def _texts(change: Change) -> list[str]:
    """What a change changes besides failures."""
    texts = [] if change.law is None else [f"law {change.law}"]
    texts += ["gain"] if change.gains else []
    for signal in () if change.signal is None else change.signal or (None,):
        if isinstance(signal, HostFile):
            texts.append("host frames " + Path(signal.file).stem.replace("-", ", "))
        elif isinstance(signal, SingleSignal):
            texts.append(f"signal {signal.kind.replace('_', ' ')} in {signal.dof}")
        else:
            texts.append("signal " + ("rest" if signal is None else signal.kind))
    if (push := change.push) is not None:
        texts.append("push" if any((*push.force, *push.torque)) else "push ends")
    return texts + ([] if change.request is None else [f"request {change.request}"])


class View(NamedTuple):
    """What a turn has to show."""

    live: Live  #: The run as it stands.
    past: Collection[Live]  #: The states of the last `LONGEST` seconds, oldest first.
    beside: Collection[Live | None]  #: Those of the second law at the same times, where it runs.
    marks: tuple[Mark, ...]  #: What has happened, in order of time.
    plant: Hexapod  #: The machine; its MuJoCo data is that of the run.
    pace: SessionPace  #: How the session keeps up.
    paused: bool  #: Whether time stands still.
    end: str  #: Why the run has ended; empty while it goes on.

    @property
    def push(self) -> NDArray[np.float64]:
        """External force on the platform, model's axes [N], (3,)."""
        plant = self.plant
        return plant.data.xfrc_applied[plant.model.body("platform").id, :3].copy()


class LiveSession:
    """One run at a time, in real time; beside it, if asked for, the same run with a second law."""

    def __init__(
        self, scenario: Run, show: Callable[[View], None], tell: Callable[[Exception], None]
    ) -> None:
        """Build the first run, its `duration` left aside; `start` sets it going.

        From the session's thread `show` draws each turn, and `tell` takes the error that ends a
        run. Raises `InputError` if the scenario is refused.
        """
        self._show, self._tell = show, tell
        self._requests: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._closed = threading.Event()
        self._clock = Clock(time.monotonic())
        kept = round(LONGEST * PLOT_RATE)
        self._past: deque[Live] = deque(maxlen=kept)
        self._beside_past: deque[Live | None] = deque(maxlen=kept)
        self._run = _open_run(scenario)
        self._beside: SignalSession | None = None
        self._end = ""
        self._thread = threading.Thread(target=self._go, name="studio session", daemon=True)

    def start(self) -> None:
        """Set the session going."""
        self._thread.start()

    def close(self, *, wait: bool = True) -> None:
        """End the thread, if it was started, and wait for it."""
        self._closed.set()
        if wait and self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()

    def begin(self, scenario: Run, beside: str = "") -> "Future[None]":
        """Begin again with another scenario; the run goes on if it is refused.

        With a law `beside`, a second plant does all that the first does, but with this law to the
        end. Only the first is exported and recorded.
        """

        def build() -> None:
            run, second = _open_run(scenario), None
            if beside:
                changes = tuple(map(_without_law, scenario.change))
                same = {"law": beside, "gains": {}, "change": changes}
                second = _open_run(scenario.model_copy(update=same))
            self._run, self._beside, self._end = run, second, ""
            self._past.clear()
            self._beside_past.clear()
            self._clock.restart(time.monotonic())

        return self._ask(build)

    def apply(self, change: Change) -> "Future[None]":
        """Let something change from the next control frame on."""

        def act() -> None:
            self._run.apply(change)
            if self._beside is not None:
                self._beside.apply(_without_law(change))

        return self._ask(act)

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._clock.paused

    def pause(self, paused: bool) -> None:
        """Stop time or let it go on."""
        self._ask(lambda: setattr(self._clock, "paused", paused))

    def set_speed(self, speed: float) -> None:
        """Choose the simulated seconds in a second of wall time."""
        self._ask(lambda: setattr(self._clock, "speed", speed))

    def scenario(self) -> "Future[Run]":
        """The session so far as a scenario that repeats it."""
        return self._ask(lambda: self._run.done())

    def record(self) -> "Future[Record]":
        """What the session has kept of its signals."""
        return self._ask(lambda: self._run.record())

    def marks(self) -> "Future[tuple[Mark, ...]]":
        """What has happened so far."""
        return self._ask(lambda: marks_of(self._run.done(), self._run.fault))

    def _ask(self, action: Callable[[], Answer]) -> "Future[Answer]":
        future: Future[Answer] = Future()

        def answer() -> None:
            if self._closed.is_set():
                future.cancel()
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(action())
            except Exception as error:
                future.set_exception(error)

        self._requests.put(answer)
        if self._closed.is_set():
            self._answer()
        return future

    def _answer(self) -> None:
        """Do what was asked for; after the end nothing is done any more."""
        while True:
            try:
                self._requests.get_nowait()()
            except Empty:
                return

    def _go(self) -> None:
        before = time.monotonic()
        self._clock.restart(before)
        try:
            while not self._closed.is_set():
                begun = time.monotonic()
                frames = self._turn(begun)
                now = time.monotonic()
                if frames:
                    self._clock.ran(begun - before, frames, now - begun)
                before = begun
                self._closed.wait(max(0.0, begun + TURN - now))
        except Exception as error:
            self._tell(error)
            raise
        finally:  # whoever waits, or comes later, learns that there is no session any more
            self._closed.set()
            self._answer()

    def _turn(self, now: float) -> int:
        """Answer, advance and show; the control frames run."""
        self._answer()
        due = 0 if self._end else self._clock.due(now)
        try:
            self._advance(due)
        except CmfError as error:
            self._end = str(error)
            self._tell(error)
        run, clock = self._run, self._clock
        plant, live = run.plant, run.look()
        assert isinstance(plant, Hexapod)
        marks = marks_of(run.done(), live.fault)
        if self._end:
            marks += (Mark(live.time, "the run ended", True),)
        pasts = self._past, self._beside_past
        self._show(View(live, *pasts, marks, plant, clock.pace, clock.paused, self._end))
        return due

    def _advance(self, frames: int) -> None:
        """Run control frames, keeping the state at each multiple of a part."""
        end = self._run.frame + frames
        while self._run.frame < end:
            frame = self._run.frame
            part = min(_PART - frame % _PART, end - frame)
            self._run.run(part)
            second = self._second(part)
            if self._run.frame % _PART == 0:
                self._past.append(self._run.look())
                self._beside_past.append(second)

    def _second(self, frames: int) -> Live | None:
        """Run control frames of the second law; its end is not that of the first."""
        if self._beside is None:
            return None
        try:
            self._beside.run(frames)
        except CmfError as error:
            self._beside = None
            self._tell(error)
            return None
        return self._beside.look()


def _without_law(change: Change) -> Change:
    """The same change to the run beside, which keeps its law."""
    return change.model_copy(update={"law": None, "gains": {}})


def _open_run(scenario: Run) -> SignalSession:
    """A run without end, on the hexapod."""
    if scenario.plant != "hexapod":
        raise InputError(f"plant: {scenario.plant!r} has no platform to show; allowed: hexapod")
    every = max(scenario.record_every, 16)  # 128 Hz, the facility's recorder
    begun = scenario.model_copy(update={"duration": "open", "record_every": every})
    return SignalSession(begun, keep=KEPT_ROWS * every / RATE)
