"""What the controls of a page mean, and what they act on: its tab and its session."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import cache
from pathlib import Path
from typing import Any, get_args

import viser
from viser import _messages as messages

from cmf_mj.control.law import law_on
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import merged
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import load_scenario, scenario_names, scenario_of
from cmf_mj.facility.settings import Change
from cmf_mj.facility.signal import ScenarioSignal
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.record.record import Record
from cmf_mj.show.film import FilmSettings, film
from cmf_mj.show.stage import traces_of
from cmf_mj.show.studio.live import LiveSession, Mark, View
from cmf_mj.signals.signal import SingleSignal

SIGNALS: dict[str, type[SingleSignal]] = {
    signal.kind_name(): signal
    for signal in get_args(get_args(ScenarioSignal)[0])
    if issubclass(signal, SingleSignal)
}
"""Signals the page offers by kind; a scenario file may have any other."""

GENTLE = {"frequency": 0.5, "start": 0.05, "stop": 0.5, "number": 1}
"""Settings the page begins with where the signals have other defaults [Hz], or none."""

DIRECTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
"""Directions of the push in the model's axes."""

LARGEST_PUSH = 75.0  #: Largest push of the page [% of the weight of cab and platform].


def weight(cab: Cab) -> float:
    """Of cab and platform [N]."""
    return STANDARD_GRAVITY * cab.payload.mass


def largest_amplitude(dof: str, machine: str = CMF) -> float:
    """Operational excursion of a degree of freedom that both ends have, in in or deg."""
    low, high = load_motion_limits(None, machine).operational[DOFS.index(dof)]
    return round(units.from_si(dof_unit(dof), float(min(-low, high))), 1)


def law_of(scenario: Run) -> str:
    """The law a run begins with as the page lists it: a machine's own by name, others by file."""
    name = scenario.begun_law().name
    own = law_on(scenario.carried.machine, name) == str(scenario.law)
    return name if own else str(scenario.law)


def signal_settings(kind: str) -> dict[str, Any]:
    """Settings of a kind of signal besides degree of freedom and amplitude, as the page begins.

    Those that may be left out stay so.
    """
    fields = SIGNALS[kind].model_fields.items() if kind in SIGNALS else ()
    begun = {name: GENTLE.get(name, field.default) for name, field in fields}
    basic = ("kind", "rate", "dof", "amplitude")
    return {name: value for name, value in begun.items() if name not in basic and value is not None}


def signal_table(kind: str, dof: str, amplitude: float, **settings: Any) -> list[dict[str, Any]]:
    """The signals of a scenario, none for `rest`; amplitude in in or deg."""
    if kind == "rest":
        return []
    basic = {"kind": kind, "dof": dof, "amplitude": [amplitude, dof_unit(dof)]}
    return [basic | signal_settings(kind) | settings]


@cache
def ready_scenarios() -> dict[str, Run]:
    """Shipped scenarios of the hexapod by name, and as `studio` the one of a tab without.

    That is a gentle heave of the lightest cab with the law that flew.
    """
    signal = signal_table("sine", "heave", 2.0)
    begun = {"title": "studio session", "signal": signal, "duration": "open"}
    shipped = {name: load_scenario(name) for name in scenario_names()}
    shown = {name: run for name, run in shipped.items() if run.plant == "hexapod"}
    return {"studio": scenario_of(begun, "studio")} | shown


def from_rest(scenario: Run) -> Run:
    """The same machine with the law and the signal in force at the end, from rest.

    The scenario's own failures come again; those by hand, pushes and requests are left out.
    """
    law, gains, signal = scenario.law, scenario.gains, scenario.signal
    for change in scenario.change:
        if change.law is not None:
            law, gains = change.law, {}
        gains = merged(gains, change.gains)
        signal = signal if change.signal is None else change.signal
    begun = {"law": law, "gains": gains, "signal": signal, "duration": "open"}
    return scenario.model_copy(update=begun | {"change": ()})


_SETTLE = 0.8  #: Time a control is left alone, or a number typed, before it acts [s].


class Desk:
    """A tab with its session, and those who show what a run begins with."""

    def __init__(
        self, client: viser.ClientHandle, scenario: Run, show: Callable[[View], None]
    ) -> None:
        """Build the session; `show` draws its turns."""
        self.client = client
        self.carried = scenario.carried  #: The cab of the run, with its machine.
        self.beside = ""  #: Law of the machine that does the same beside; empty for none.
        self.wait = False  #: Whether the run that begins stands still: its first prompt is read.
        self.live = LiveSession(scenario, show, self.tell)
        self.on_demand: list[Callable[[], None]] = []  #: Called when a demand by hand takes over.
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
        self.live.pause(self.wait)
        self.live.start()

    def apply(self, change: Change) -> None:
        """Let something change, or show the refusal."""
        self.live.apply(change).add_done_callback(self._refused)

    def begin(self, scenario: Run) -> None:
        """Begin again; on a refusal show it and let the run go on."""
        paused, self.wait = self.live.paused, False
        self.live.pause(True)  # time that a new scene takes is not to be made up for
        try:
            self.live.begin(scenario, self.beside).result()
            self.carried = scenario.carried
            for follower in self._followers:
                follower(scenario)
        except (ValueError, OSError) as error:
            self.tell(error)
        finally:
            self.live.pause(paused or self.wait)

    def again(self, **settings: Any) -> None:
        """Begin again with the present law and signal and some settings changed."""
        present = from_rest(self.live.scenario().result())
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


def session_page(record: Record, path: Path, marks: Sequence[Mark], system: str) -> Path:
    """Write a page that plays what a session has kept, in one of `UNITS`.

    Its title is the law it began with and what happened since, but for signals, which its traces
    show.
    """
    said = [f"{one.time:.1f} s: {one.text}" for one in marks if not one.text.startswith("signal")]
    title = "\n".join([str(record.metadata["law"]), *said])
    begun = FilmSettings(start=float(record.time[0]))  # of a long session the end is kept
    return film([record], path, begun, titles=[title], traces=[traces_of(record, system)])


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


def check_commands(client: viser.ClientHandle) -> None:
    """Let the controls of a tab take only what `check_value` lets pass, and show the rest."""
    gui, connection = client.gui, client._websock_connection

    async def update(client_id: Any, message: messages.GuiUpdateMessage) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid)
        try:
            check_value(handle, message.updates)
        except InputError as error:
            client.add_notification("Refused", str(error), color="red", auto_close_seconds=30.0)
            if handle is not None:  # or what was refused stays in its field, and is sent clamped
                back = messages.GuiUpdateMessage(message.uuid, {"value": handle.value})
                gui._websock_interface.queue_message(back)
        else:
            await gui._handle_gui_updates(client_id, message)

    connection.unregister_handler(messages.GuiUpdateMessage)
    connection.register_handler(messages.GuiUpdateMessage, update)


def check_value(handle: Any, updates: dict[str, Any]) -> None:
    """Refuse what a control cannot be set to by hand."""
    if handle is None:
        return
    label = handle.label or "button"
    if set(updates) != {"value"}:
        raise InputError(f"{label}: {sorted(updates)} is refused; allowed: value")
    value = updates["value"]
    if (options := getattr(handle, "options", None)) is not None:
        fine, allowed = value in options, ", ".join(options)
    elif isinstance(handle.value, bool):
        fine, allowed = isinstance(value, bool), "true, false"
    elif isinstance(handle.value, int | float):
        low, high = (getattr(handle, end, None) for end in ("min", "max"))
        fine = isinstance(value, int | float) and not isinstance(value, bool)
        fine = fine and math.isfinite(value) and (low is None or low <= value <= high)
        allowed = "a number" if low is None else f"{low:g} to {high:g}"
    else:
        fine, allowed = False, "nothing"
    if not fine:
        raise InputError(f"{label}: {value!r} is refused; allowed: {allowed}")
