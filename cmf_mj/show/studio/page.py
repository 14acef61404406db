"""One browser tab: scene, controls, plots and the session they belong to."""

import threading
from collections.abc import Callable

import viser

from cmf_mj.core import units
from cmf_mj.facility.scenario.settings import Scenario
from cmf_mj.show.studio import choices, controls
from cmf_mj.show.studio.desk import Desk
from cmf_mj.show.studio.live import View
from cmf_mj.show.studio.plots import Plots
from cmf_mj.show.studio.scene import MachineScene, place_camera

_PLOTS_EVERY = 4
"""Turns from drawing of the plots to drawing: 7.5 a second."""

_STATUS_EVERY = 8
"""Turns from status to status."""


class TabClosed(Exception):
    """The tab was closed while its page was being built."""


class Page:
    """A tab with its session."""

    def __init__(
        self,
        client: viser.ClientHandle,
        scenario: Scenario,
        gone: Callable[[], bool] = lambda: False,
    ) -> None:
        """Build the page and set its session going with a scenario, unless the tab is gone."""
        self._lock = threading.Lock()
        self._turn = 0
        place_camera(client)
        self._scene = MachineScene(client, scenario.carried)
        if gone():
            raise TabClosed
        self.desk = Desk(client, scenario, self._show)
        self.live = self.desk.live
        self.desk.follow(self._show_cab)
        self._controls()
        self._panel()
        self.desk.start(scenario)

    def _controls(self) -> None:
        gui, desk = self.desk.client.gui, self.desk
        self._status = controls.run_controls(desk)
        with gui.add_folder("Signal"):
            self._signal = controls.SignalControls(desk)
        with gui.add_folder("Law"):
            controls.law_controls(desk)
        with gui.add_folder("Disturbance"):
            controls.disturbance_controls(desk)
        with gui.add_folder("Machine"):
            controls.machine_controls(desk)
        with gui.add_folder("Session"):
            controls.file_controls(desk)
        gui.main_panel.dock_right()

    def _panel(self) -> None:
        gui = self.desk.client.gui
        panel = gui.add_panel()
        with panel.add_tab("Signals"):
            self._plots = Plots(self.desk.client)
            self._leg = gui.add_dropdown("leg of the pressures", controls.LEGS)
            self._window = gui.add_dropdown("window [s]", ("5", "10", "20"), initial_value="10")
            self._drawn = gui.add_checkbox("plots on", True)
        panel.dock_left()
        panel.set_width(430)

    def _show(self, view: View) -> None:
        """Draw a turn of the session."""
        self.desk.act()
        self._turn += 1
        with self._lock:
            self._scene.show(view.live.qpos)
            self._scene.show_push(view.push / units.to_si("kN", choices.LARGEST_PUSH))
        if self._turn % _PLOTS_EVERY == 0 and self._drawn.value:
            leg = int(self._leg.value) - 1
            self._plots.show(view, float(self._window.value), self._signal.dof, leg)
        if self._turn % _STATUS_EVERY == 0:
            self._status(view)

    def _show_cab(self, scenario: Scenario) -> None:
        with self._lock:
            if self._scene.cab != scenario.carried:
                self._scene = MachineScene(self.desk.client, scenario.carried)
