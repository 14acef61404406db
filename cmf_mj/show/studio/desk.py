"""What the controls of a page act on: its tab and its session."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import viser

from cmf_mj.facility.run import Run
from cmf_mj.facility.settings import Change
from cmf_mj.show.studio import choices
from cmf_mj.show.studio.live import LiveSession, View

_SETTLE = 0.3
"""Time a control is left alone before it acts [s]."""


class Desk:
    """A tab with its session, and those who show what a run begins with."""

    def __init__(
        self, client: viser.ClientHandle, scenario: Run, show: Callable[[View], None]
    ) -> None:
        """Build the session; `show` draws its turns."""
        self.client = client
        self.beside = ""
        """Law of the machine that does the same beside; empty for none."""
        self.live = LiveSession(scenario, show, self.tell)
        self._followers: list[Callable[[Run], None]] = []
        self._lock = threading.Lock()
        self._later: dict[str, tuple[float, Callable[[], None]]] = {}

    def follow(self, follower: Callable[[Run], None]) -> None:
        """Call with the scenario of each run that begins."""
        self._followers.append(follower)

    def start(self, scenario: Run) -> None:
        """Show the first run and set the session going."""
        for follower in self._followers:
            follower(scenario)
        self.live.start()

    def apply(self, change: Change) -> None:
        """Let something change, or show the refusal."""
        self.live.apply(change).add_done_callback(self._refused)

    def begin(self, scenario: Run) -> None:
        """Begin again; on a refusal show it and let the run go on."""
        paused = self.live.paused
        self.live.pause(True)  # time that a new scene takes is not to be made up for
        try:
            self.live.begin(scenario, self.beside).result()
            for follower in self._followers:
                follower(scenario)
        except (ValueError, OSError) as error:
            self.tell(error)
        finally:
            self.live.pause(paused)

    def again(self, **settings: Any) -> None:
        """Begin again with the present law and signal and some settings changed."""
        present = choices.settled(self.live.scenario().result())
        self.begin(present.model_copy(update=settings))

    def tell(self, error: Exception) -> None:
        """Show a refusal."""
        self.client.add_notification(
            "Refused", str(error), color="red", with_close_button=True, auto_close_seconds=30.0
        )

    def later(self, key: str, action: Callable[[], None]) -> None:
        """Do something when the control of this key has been left alone for a moment."""
        with self._lock:
            self._later[key] = (time.monotonic() + _SETTLE, action)

    def act(self) -> None:
        """Do what has been left alone for long enough."""
        now = time.monotonic()
        with self._lock:
            ripe = [key for key, (when, _) in self._later.items() if when <= now]
            actions = [self._later.pop(key)[1] for key in ripe]
        for action in actions:
            try:
                action()
            except ValueError as error:
                self.tell(error)

    def _refused(self, done: "Future[None]") -> None:
        error = None if done.cancelled() else done.exception()
        if isinstance(error, Exception):
            self.tell(error)


def by_hand(action: Callable[[Any], None], *handles: Any) -> None:
    """Call with a control that was moved in the browser, and not by the page itself."""

    def moved(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            action(event.target)

    for handle in handles:
        handle.on_update(moved)


def pick(handle: viser.GuiDropdownHandle[str], value: str) -> None:
    """Set a dropdown, with a new option if it has no such one."""
    if value not in handle.options:
        handle.options = (*handle.options, value)
    handle.value = value
