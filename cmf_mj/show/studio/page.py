"""One browser tab: scene, controls, plots and the session they belong to."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import viser

from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.facility.scenario.settings import Change, Scenario, overlaid_law
from cmf_mj.show.studio import choices, traces
from cmf_mj.show.studio.bode import BodePanel
from cmf_mj.show.studio.controls import (
    DisturbanceControls,
    MachineControls,
    RunControls,
    SignalControls,
)
from cmf_mj.show.studio.files import FileControls
from cmf_mj.show.studio.law_controls import LawControls
from cmf_mj.show.studio.live import LiveSession, View
from cmf_mj.show.studio.plots import Plots
from cmf_mj.show.studio.replay import Recording, ReplayPanel
from cmf_mj.show.studio.scene import MachineScene, place_camera

_PLOTS_EVERY = 4
"""Turns from drawing of the plots to drawing: 7.5 a second."""

_STATUS_EVERY = 8
"""Turns from status to status."""

_SETTLE = 0.3
"""Time a control is left alone before it acts [s]."""

_WINDOWS = ("5", "10", "20")
"""Lengths of the plots [s]."""

_PANEL_WIDTH = 430
"""Of the plots [px]."""


class Page:
    """A tab with its session: what the controls see as their desk."""

    def __init__(self, client: viser.ClientHandle, scenario: Scenario) -> None:
        """Build the page and set its session going with a scenario."""
        self.client = client
        self._lock = threading.RLock()
        self._later: dict[str, tuple[float, Callable[[], None]]] = {}
        self._turn = 0
        self._before = time.monotonic()
        place_camera(client)
        self._cab: str = scenario.cab
        self._scene = MachineScene(client, scenario.cab)
        self.live = LiveSession(scenario, self)
        self._controls()
        self._panel()
        self._sync(scenario)
        self.live.start()

    def close(self) -> None:
        """End the session; the tab is gone."""
        self._bode.close()
        self.live.close()

    # What controls ask for.

    def apply(self, change: Change) -> None:
        """Let something change, or show the refusal."""
        self.live.apply(change).add_done_callback(self._refused)

    def begin(self, scenario: Scenario) -> None:
        """Begin anew; on a refusal show it and let the run go on."""
        paused = self.live.paused
        self.live.pause(True)  # time that the new scene takes is not to be made up for
        try:
            self.live.begin(scenario).result()
            self._show_cab(scenario.cab)
            self._sync(scenario)
        except (ValueError, OSError) as error:
            self.tell(error)
        finally:
            self.live.pause(paused)

    def again(self, **settings: Any) -> None:
        """Begin anew with the present law and signal and some settings changed."""
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

    # What the session shows.

    def show(self, view: View, kept: traces.Traces) -> None:
        """Draw a turn."""
        now = time.monotonic()
        elapsed, self._before = now - self._before, now
        self._act(now)
        self._turn += 1
        replayed = self._replay.turn(elapsed)
        recording = self._replay.recording
        with self._lock:
            if recording is None:
                self._scene.show(view.live.qpos)
                self._scene.show_push(view.push / units.to_si("kN", choices.LARGEST_PUSH))
            else:
                self._scene.show(recording.position(replayed))
        if self._turn % _PLOTS_EVERY == 0 and self._drawn.value:
            seconds = float(self._window.value)
            rows = kept.last(seconds) if recording is None else recording.last(replayed, seconds)
            self._plots.show(rows, self._signal.dof, int(self._leg.value) - 1)
            self._replay.show()
        if self._turn % _STATUS_EVERY == 0:
            self._status.show(view)

    def _act(self, now: float) -> None:
        with self._lock:
            ripe = [key for key, (when, _) in self._later.items() if when <= now]
            actions = [self._later.pop(key)[1] for key in ripe]
        for action in actions:
            action()

    def _controls(self) -> None:
        gui = self.client.gui
        self._status = RunControls(self)
        with gui.add_folder("Signal"):
            self._signal = SignalControls(self)
        with gui.add_folder("Law"):
            self._law = LawControls(self)
        with gui.add_folder("Disturbance"):
            self._disturbance = DisturbanceControls(self)
        with gui.add_folder("Machine"):
            self._machine = MachineControls(self)
        with gui.add_folder("Session"):
            FileControls(self)
        gui.main_panel.dock_right()

    def _panel(self) -> None:
        gui = self.client.gui
        panel = gui.add_panel()
        with panel.add_tab("Signals"):
            self._plots = Plots(self.client)
            self._leg = gui.add_dropdown("leg of the pressures", tuple("123456"))
            self._window = gui.add_dropdown("window [s]", _WINDOWS, initial_value="10")
            self._drawn = gui.add_checkbox("plots on", True)
            self._shadows = gui.add_checkbox("shadows", False, hint="needs a GPU in the browser")
            self._shadows.on_update(lambda event: self._scene.cast_shadows(event.target.value))
        with panel.add_tab("Bode"):
            self._bode = BodePanel(self, lambda: self._signal.dof)
        with panel.add_tab("Recording"):
            self._replay = ReplayPanel(self, self._scene.width, self._enter, self._leave)
        panel.dock_left()
        panel.set_width(_PANEL_WIDTH)

    def _enter(self, recording: Recording) -> None:
        self.live.pause(True)
        self._show_cab(recording.cab, live=False)

    def _leave(self) -> None:
        self._show_cab(self._cab)
        self.live.pause(False)

    def _show_cab(self, cab: str, *, live: bool = True) -> None:
        with self._lock:
            if self._scene.cab != cab:
                self._scene = MachineScene(self.client, cab, shadows=self._shadows.value)
            if live:
                self._cab = cab

    def _sync(self, scenario: Scenario) -> None:
        """Show in the controls what a run begins with."""
        self._machine.sync(scenario)
        self._signal.sync(scenario)
        self._disturbance.sync(scenario)
        self._law.sync(scenario.law, overlaid_law(load_law(scenario.law), scenario.gains))

    def _refused(self, done: "Future[None]") -> None:
        error = None if done.cancelled() else done.exception()
        if isinstance(error, Exception):
            self.tell(error)
