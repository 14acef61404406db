"""The studio's server: one page and one session a browser tab, with scene, controls, plots."""

import ctypes
import gc
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

import viser

from cmf_mj.facility.run import Run, SignalSession
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show.studio import controls
from cmf_mj.show.studio.desk import Desk, check_commands, ready_scenarios
from cmf_mj.show.studio.door import Door, scenario_in
from cmf_mj.show.studio.live import View
from cmf_mj.show.studio.plots import MachineScene, Plots, widen_camera

_PLOTS_EVERY, _STATUS_EVERY = 4, 8  #: Turns from drawing to drawing: 7.5 and 3.8 a second.


class TabClosed(Exception):
    """The tab was closed while its page was being built."""


class Page:
    """A tab with its session."""

    def __init__(
        self, client: viser.ClientHandle, scenario: Run, gone: Callable[[], bool] = lambda: False
    ) -> None:
        """Build the page and set its session going with a scenario, unless the tab is gone."""
        self._lock = threading.Lock()
        self._turn = 0
        widen_camera(client)
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
        self._prompt = controls.scenario_controls(desk)
        self._status = controls.run_controls(desk)
        with gui.add_folder("Signal"):
            self._shown = controls.signal_controls(desk)
        with gui.add_folder("Flight"):
            self._flying = controls.cueing_controls(desk)
        with gui.add_folder("Law"):
            controls.law_controls(desk)
        with gui.add_folder("Disturbance"):
            controls.disturbance_controls(desk)
        with gui.add_folder("Machine"):
            controls.machine_controls(desk)
        with gui.add_folder("Session"):
            controls.file_controls(desk, self._shown)
        gui.main_panel.dock_right()

    def _panel(self) -> None:
        gui = self.desk.client.gui
        panel = gui.add_panel()
        with panel.add_tab("Signals"):
            self._plots = Plots(self.desk.client)
            self._dof = gui.add_dropdown("platform", ("what moves", *DOFS), hint="its plot")
            self._leg = gui.add_dropdown("leg of the pressures", controls.LEGS, hint="cap and rod")
            self._window = gui.add_dropdown(
                "window [s]", ("5", "10", "20"), initial_value="10", hint="time that plots show"
            )
        panel.dock_left()
        panel.set_width(430)
        panel.expand()

    def _show(self, view: View) -> None:
        """Draw a turn of the session."""
        self.desk.act()
        self._turn += 1
        with self._lock:
            self._scene.show(view.live.qpos)
            self._scene.show_push(view.push)
        if self._turn % _PLOTS_EVERY == 0:
            leg = int(self._leg.value) - 1
            dof, system = self._shown()
            moves = "" if self._flying() else dof
            dof = self._dof.value if self._dof.value in DOFS else moves
            self._plots.show(view, float(self._window.value), dof, system, leg)
        if self._turn % _STATUS_EVERY == 0:
            self._status(view)
            self._prompt(view)

    def _show_cab(self, scenario: Run) -> None:
        with self._lock:
            if self._scene.cab != scenario.carried:
                self._scene = MachineScene(self.desk.client, scenario.carried, self._scene.extent)


_ARENA_MAX, _MMAP_THRESHOLD = -8, -3
"""Options of glibc's mallopt, so that the memory of sessions that ended can be given back."""


class Studio:
    """A running server."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = 8048, scenario: Run | None = None
    ) -> None:
        """Begin to serve; other machines reach it with the host `0.0.0.0` and the token in `url`.

        The next free port is taken if `port` is in use. Each tab begins with `scenario`, by
        default that of `ready_scenarios`.
        """
        if sys.platform == "linux":  # one heap for all threads, and large arrays out of it
            for option, value in ((_ARENA_MAX, 1), (_MMAP_THRESHOLD, 2**20)):
                ctypes.CDLL(None).mallopt(option, value)
        self._scenario = scenario or ready_scenarios()["studio"]
        # Compile the loop before the first tab waits for it.
        SignalSession(self._scenario).run(1)
        self._host = host
        self._lock, self._building = threading.Lock(), threading.Lock()
        self._stopped = False
        self._pages: dict[int, Page] = {}
        self._door = Door(host, ready_scenarios())
        with self._door.guards():
            self._server = viser.ViserServer(
                host=host, port=port, label="cmf studio", verbose=False
            )
        self._server.scene.world_axes.visible = False
        self._server.scene.configure_environment_map(None)
        theme = {"show_logo": False, "show_share_button": False, "brand_color": (31, 84, 150)}
        self._server.gui.configure_theme(**theme)
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._disconnected)

    @property
    def url(self) -> str:
        """Where the page is, with the token if there is one."""
        host = "127.0.0.1" if self._host == "0.0.0.0" else self._host
        host = f"[{host}]" if ":" in host else host
        token = "" if self._door.token is None else f"/?token={self._door.token}"
        return f"http://{host}:{self._server.get_port()}{token}"

    @property
    def pages(self) -> tuple[Page, ...]:
        """Pages of the tabs that are open, oldest first."""
        with self._lock:
            return tuple(self._pages.values())

    def stop(self) -> None:
        """End all sessions, those still being built too, and then the server."""
        with self._lock:
            self._stopped = True
        for page in self.pages:
            page.live.close(wait=False)
        for page in self.pages:
            page.live.close()
        with self._building:  # the server must not end while a session draws
            pass
        self._server.stop()

    def _connected(self, client: viser.ClientHandle) -> None:
        check_commands(client)
        with self._building:  # one at a time: who is gone meanwhile is not built at all
            if self._gone(client):
                return
            with suppress(TabClosed):
                page = Page(client, self._asked(client), lambda: self._gone(client))
                with self._lock:
                    if not self._gone(client):
                        self._pages[client.client_id] = page
                        return
                page.live.close()
                del page
        _give_back()

    def _asked(self, client: viser.ClientHandle) -> Run:
        """The scenario that a tab's address names, or else that of the studio."""
        open_now = self._server._websock_server._live_connections
        request = open_now[client.client_id].request if client.client_id in open_now else None
        return ready_scenarios().get(scenario_in(request.path if request else ""), self._scenario)

    def _gone(self, client: viser.ClientHandle) -> bool:
        return self._stopped or client.client_id not in self._server.get_clients()

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            page = self._pages.pop(client.client_id, None)
        if page is not None:
            page.live.close()
            del page
            _give_back()


def _give_back() -> None:
    """Give the memory of sessions that ended back to the system."""
    gc.collect()
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)
