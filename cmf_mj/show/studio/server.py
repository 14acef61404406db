"""The studio's server: one page and one session for each browser tab."""

import threading

import viser

from cmf_mj.facility.scenario.run import ScenarioRun
from cmf_mj.facility.scenario.settings import Scenario
from cmf_mj.show.studio.choices import first_scenario
from cmf_mj.show.studio.page import Page

BRAND = (31, 84, 150)
"""Colour of buttons and sliders: the platform's blue."""


class Studio:
    """A running server."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = 8048, scenario: Scenario | None = None
    ) -> None:
        """Begin to serve.

        Args:
            host: address to listen on; other machines reach it with `0.0.0.0`.
            port: TCP port; the next free one is taken if it is in use.
            scenario: what each tab begins with; default `first_scenario`.

        Raises:
            InputError: the scenario is refused.
            OSError: the address cannot be listened on.
        """
        self._scenario = scenario or first_scenario()
        # Compile the loop before the first tab waits for it.
        ScenarioRun(self._scenario).advance(1)
        self._host = host
        self._changed = threading.Condition()
        self._stopped = False
        self._building: set[int] = set()
        self._pages: dict[int, Page] = {}
        self._gone: set[int] = set()
        self._server = viser.ViserServer(host=host, port=port, label="cmf studio", verbose=False)
        self._server.scene.world_axes.visible = False
        self._server.scene.configure_environment_map(None)
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=BRAND
        )
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
        with self._changed:
            return tuple(self._pages.values())

    def stop(self) -> None:
        """End all sessions, those still being built too, and then the server."""
        with self._changed:
            self._stopped = True
            self._changed.wait_for(lambda: not self._building)
        for page in self.pages:
            page.close()
        self._server.stop()

    def _connected(self, client: viser.ClientHandle) -> None:
        with self._changed:
            if self._stopped:
                return
            self._building.add(client.client_id)
        page = None
        try:
            page = Page(client, self._scenario)
        finally:
            with self._changed:
                self._building.remove(client.client_id)
                gone = client.client_id in self._gone
                self._gone.discard(client.client_id)
                if page is not None and not gone:
                    self._pages[client.client_id] = page
                self._changed.notify_all()
        if gone:
            page.close()

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._changed:
            page = self._pages.get(client.client_id)
            if page is None:
                self._gone.add(client.client_id)
                return
        page.close()  # first: the server must not end while a session draws
        with self._changed:
            self._pages.pop(client.client_id, None)
