"""The studio's door: who may open the page and its websocket.

A page of another site can make a browser send requests here, but it can forge neither `Host` nor
`Origin`. A request is let in if it names this machine as its host, its origin is the page itself,
and, where other machines can reach the studio, it knows the token of the printed address.
"""

import ipaddress
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec
import websockets.asyncio.server as websocket
from websockets import Headers
from websockets.http11 import Request, Response

MOST_TABS = 8  #: Tabs open at the same time; each has a plant, a record and a thread.

MOST_MESSAGE = 100_000  #: Largest message of a tab [octets].

COMMANDS = ("ViewerCameraMessage", "GuiUpdateMessage", "FileTransferPartAck")
"""Messages of the page that the studio answers to; others, as the request for a public address or
a file to take, are dropped."""

_COOKIE = "cmf_studio"

_HEADERS = {
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
"""Of every answer: no other site shows the page in a frame or learns its address."""

_starting = threading.Lock()


class Door:
    """Refuses requests of a studio that listens at an address."""

    def __init__(self, host: str, scenarios: Collection[str] = ()) -> None:
        """Make a token if other machines can reach the address; tabs may ask for scenarios."""
        self._scenarios = scenarios
        self._local = _is_local(host)
        self.token = None if self._local else secrets.token_urlsafe(24)
        """What a request must know, or None."""
        self._open: set[websocket.ServerConnection] = set()
        self._guarding = False

    def refusal(self, path: str, headers: Headers, tabs: int) -> tuple[HTTPStatus, str] | None:
        """Status and one line for a request that is refused while so many tabs are open."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_here(hosts[0]):
            where = "localhost or its loopback address" if self._local else "its name or address"
            return HTTPStatus.FORBIDDEN, f"host: {hosts} is refused; allowed: {where}"
        page = f"http://{hosts[0]}".lower()
        if (origins or "Upgrade" in headers) and [one.lower() for one in origins] != [page]:
            return HTTPStatus.FORBIDDEN, f"origin: {origins} is refused; allowed: {page}"
        if self.token is not None and not self._knows(path, headers):
            return HTTPStatus.FORBIDDEN, "token: is missing or wrong; use the address as printed"
        if (name := scenario_in(path)) and name not in self._scenarios:
            text = f"scenario: {name!r} is unknown; allowed: {', '.join(self._scenarios)}"
            return HTTPStatus.NOT_FOUND, text
        if tabs >= MOST_TABS and ("Upgrade" in headers or urlsplit(path).path == "/"):
            text = f"tabs: {tabs} are open; allowed: {MOST_TABS} at the same time; close one"
            return HTTPStatus.SERVICE_UNAVAILABLE, text
        return None

    @contextmanager
    def guards(self) -> Iterator[None]:
        """Refuse requests of the server of websockets that begins in this block.

        viser lets nobody set how its server answers. So `websockets`' function that begins a server
        is replaced until the block ends. Raises RuntimeError where no server began.
        """
        serve = websocket.serve

        def guarded(handler: Any, host: str, port: int, **options: Any) -> websocket.serve:
            quiet = logging.getLogger(__name__)  # what is refused is answered to who sent it
            quiet.setLevel(logging.CRITICAL)
            inner, self._guarding = options["process_request"], True
            return serve(
                handler,
                host,
                port,
                **options
                | {
                    "process_request": lambda *asked: self._answer(inner, *asked),
                    "create_connection": _connection(self._open.discard),
                    "max_size": MOST_MESSAGE,
                    "logger": quiet,
                },
            )

        with _starting:
            websocket.serve = guarded  # type: ignore[assignment, misc]
            try:
                yield
            finally:
                websocket.serve = serve  # type: ignore[misc]
        if not self._guarding:
            raise RuntimeError("viser: its server cannot be guarded; use the version tested")

    def _answer(
        self,
        inner: Callable[[websocket.ServerConnection, Request], Response | None],
        connection: websocket.ServerConnection,
        request: Request,
    ) -> Response | None:
        refused = self.refusal(request.path, request.headers, len(self._open))
        if refused is not None:
            status, text = refused
            answer: Response | None = connection.respond(status, f"cmf studio: {text}\n")
        elif (name := scenario_in(request.path)) and "Upgrade" not in request.headers:
            answer = connection.respond(HTTPStatus.FOUND, "")
            server = f"ws://{request.headers['Host']}/"  # viser's page takes its address alone
            answer.headers["Location"] = f"/?websocket={server}?scenario={name}"
        else:
            answer = inner(connection, request)
        if answer is None:
            self._open.add(connection)
            return None
        for name, value in _HEADERS.items():
            answer.headers[name] = value
        if refused is None and self.token is not None:
            cookie = f"{_COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            answer.headers["Set-Cookie"] = cookie
        return answer

    def _is_here(self, host: str) -> bool:
        """Whether a request means this machine: a site that resolves to it has another name."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if _is_local(name):
            return True
        own = socket.gethostname().lower(), socket.getfqdn().lower()
        return not self._local and (_is_address(name) or name in own)

    def _knows(self, path: str, headers: Headers) -> bool:
        given = parse_qs(urlsplit(path).query).get("token", [])
        for line in headers.get_all("Cookie"):
            try:
                given += [one.value for one in SimpleCookie(line).values() if one.key == _COOKIE]
            except CookieError:
                continue
        token = (self.token or "").encode()
        return any([secrets.compare_digest(one.encode(), token) for one in given])


def scenario_in(path: str) -> str:
    """Name of the scenario that an address asks for; empty for none."""
    return parse_qs(urlsplit(path).query).get("scenario", [""])[0]


def _connection(closed: Callable[[Any], None]) -> type[websocket.ServerConnection]:
    """Connections that pass on the commands of the page only."""

    class Connection(websocket.ServerConnection):
        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                message = await super().recv(decode)
                if _kind(message) in COMMANDS:
                    return message

        def connection_lost(self, exc: Exception | None) -> None:
            closed(self)
            super().connection_lost(exc)

    return Connection


def _kind(message: str | bytes) -> object:
    try:
        table = msgspec.msgpack.decode(message) if isinstance(message, bytes) else None
    except msgspec.DecodeError:
        return None
    return table.get("type") if isinstance(table, dict) else None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_local(name: str) -> bool:
    return name == "localhost" or (_is_address(name) and ipaddress.ip_address(name).is_loopback)
