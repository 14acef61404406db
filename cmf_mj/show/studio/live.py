"""A session of one browser tab: a thread that advances the closed loop to wall-clock time.

Everything that touches the run happens in the thread: whoever wants something of it asks, and the
thread does it between two parts. Nothing here knows the page.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import CmfError, InputError
from cmf_mj.core.rates import RATE
from cmf_mj.facility.scenario.run import ScenarioRun
from cmf_mj.facility.scenario.settings import Change, Scenario
from cmf_mj.facility.session import Live
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.show.studio import traces
from cmf_mj.show.studio.clock import Clock, Pace

TURN = 1.0 / 30.0
"""Time from picture to picture [s]."""

KEPT_ROWS = 76_800
"""Rows of the record a session keeps, about 90 MB: ten minutes at 128 Hz."""

_PART = RATE // traces.RATE

Answer = TypeVar("Answer")


class View(NamedTuple):
    """What a turn has to show."""

    live: Live  #: The run as it stands.
    push: NDArray[np.float64]  #: External force on the platform, model's axes [N], (3,).
    pace: Pace  #: How the session keeps up.
    paused: bool  #: Whether time stands still.


class Display(Protocol):
    """Who shows a session; called from its thread."""

    def show(self, view: View, kept: traces.Traces) -> None:
        """Draw a turn."""

    def tell(self, error: Exception) -> None:
        """Say that the run has ended or refused something."""


class LiveSession:
    """One run at a time, in real time."""

    def __init__(self, scenario: Scenario, display: Display) -> None:
        """Build the first run, its `duration` left aside; `start` sets it going.

        Raises:
            InputError: the scenario is refused, named by its key.
        """
        self._display = display
        self._requests: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._closed = threading.Event()
        self._clock = Clock(time.monotonic())
        self._traces = traces.Traces()
        self._run = _open_run(scenario)
        self.begun = 1
        """Runs begun so far."""
        self._ended = False
        self._thread = threading.Thread(target=self._go, name="studio session", daemon=True)

    def start(self) -> None:
        """Set the session going."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread still runs."""
        return self._thread.is_alive()

    def close(self) -> None:
        """End the thread and wait for it."""
        self._closed.set()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def begin(self, scenario: Scenario) -> "Future[None]":
        """Begin anew with another scenario; the run goes on if it is refused."""

        def build() -> None:
            self._run = _open_run(scenario)
            self.begun += 1
            self._ended = False
            self._traces.clear()
            self._clock.restart(time.monotonic())

        return self._ask(build)

    def apply(self, change: Change) -> "Future[None]":
        """Let something change from the next control frame on."""
        return self._ask(lambda: self._run.apply(change))

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

    def scenario(self) -> "Future[Scenario]":
        """The session so far as a scenario that repeats it."""
        return self._ask(lambda: self._run.scenario())

    def record(self) -> "Future[Record]":
        """What the session has kept of its signals."""
        return self._ask(lambda: self._run.record())

    def rows(self, seconds: float) -> "Future[dict[str, NDArray[np.float64]]]":
        """The latest rows the plots draw, as `Traces.last`."""
        return self._ask(lambda: self._traces.last(seconds))

    def _ask(self, action: Callable[[], Answer]) -> "Future[Answer]":
        future: Future[Answer] = Future()

        def answer() -> None:
            if self._closed.is_set():
                future.cancel()
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
        while not self._closed.is_set():
            begun = time.monotonic()
            try:
                frames = self._turn(begun)
            except Exception as error:
                self._display.tell(error)
                raise
            now = time.monotonic()
            if frames:
                self._clock.ran(begun - before, frames, now - begun)
            before = begun
            self._closed.wait(max(0.0, begun + TURN - now))
        self._answer()

    def _turn(self, now: float) -> int:
        """Answer, advance and show; the control frames run."""
        self._answer()
        due = 0 if self._ended else self._clock.due(now)
        try:
            self._advance(due)
        except CmfError as error:
            self._ended = True
            self._display.tell(error)
        plant = self._run.plant
        push = plant.data.xfrc_applied[plant.model.body("platform").id, :3].copy()
        view = View(self._run.latest(), push, self._clock.pace, self._clock.paused)
        self._display.show(view, self._traces)
        return due

    def _advance(self, frames: int) -> None:
        """Run control frames, keeping a row at each multiple of a part."""
        end = self._run.frame + frames
        while self._run.frame < end:
            frame = self._run.frame
            self._run.advance(min(_PART - frame % _PART, end - frame))
            if self._run.frame % _PART == 0:
                self._keep()

    def _keep(self) -> None:
        live = self._run.latest()
        plant = self._run.plant
        assert isinstance(plant, Hexapod)
        self._traces.append(
            live.time,
            {
                "demand_pose": live.demand,
                "platform_pose": plant.pose_of(live.qpos),
                "leg_force": live.force,
                "valve_command": live.valve_command,
                "cap_pressure": live.cap_pressure,
                "rod_pressure": live.rod_pressure,
                "supply_pressure": live.supply_pressure,
                "return_pressure": live.return_pressure,
            },
        )


def _open_run(scenario: Scenario) -> ScenarioRun:
    """A run without end, on the hexapod."""
    if scenario.plant != "hexapod":
        raise InputError(f"plant: {scenario.plant!r} has no platform to show; allowed: hexapod")
    keep = KEPT_ROWS * scenario.record_every / RATE
    return ScenarioRun(scenario.model_copy(update={"duration": "open"}), keep=keep)
