"""The studio's server: one page and one session for each browser tab."""

import threading
from concurrent.futures import Future

import viser

from cmf_mj.facility.scenario.run import ScenarioRun
from cmf_mj.facility.scenario.settings import Scenario
from cmf_mj.show.studio.choices import first_scenario
from cmf_mj.show.studio.page import Page


class Studio:
    """A running server."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = 8048, scenario: Scenario | None = None
    ) -> None:
        """Begin to serve; other machines reach it with the host `0.0.0.0`.

        The next free port is taken if `port` is in use. Each tab begins with `scenario`, by
        default `first_scenario`.
        """
        self._scenario = scenario or first_scenario()
        # Compile the loop before the first tab waits for it.
        ScenarioRun(self._scenario).advance(1)
        self._host = host
        self._lock = threading.Lock()
        self._stopped = False
        self._pages: dict[int, Future[Page]] = {}
        self._server = viser.ViserServer(host=host, port=port, label="cmf studio", verbose=False)
        self._server.scene.world_axes.visible = False
        self._server.scene.configure_environment_map(None)
        theme = {"show_logo": False, "show_share_button": False, "brand_color": (31, 84, 150)}
        self._server.gui.configure_theme(**theme)
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._disconnected)

    @property
    def url(self) -> str:
        """Where the page is."""
        host = "127.0.0.1" if self._host == "0.0.0.0" else self._host
        return f"http://{host}:{self._server.get_port()}"

    @property
    def pages(self) -> tuple[Page, ...]:
        """Pages of the tabs that are open, oldest first."""
        with self._lock:
            done = [page for page in self._pages.values() if page.done() and not page.exception()]
        return tuple(page.result() for page in done)

    def stop(self) -> None:
        """End all sessions, those still being built too, and then the server."""
        with self._lock:
            self._stopped = True
            pages = tuple(self._pages.values())
        for page in pages:
            _close(page)
        self._server.stop()

    def _connected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            if self._stopped:
                return
            page = self._pages[client.client_id] = Future()
        try:
            page.set_result(Page(client, self._scenario))
        except Exception as error:
            page.set_exception(error)
            raise
        if client.client_id not in self._server.get_clients():
            self._disconnected(client)

    def _disconnected(self, client: viser.ClientHandle) -> None:
        page = self._pages.get(client.client_id)
        if page is not None:
            _close(page)  # first: the server must not end while a session draws
            with self._lock:
                self._pages.pop(client.client_id, None)


def _close(page: "Future[Page]") -> None:
    """End a session as soon as it is built."""
    if page.exception() is None:
        page.result().live.close()
