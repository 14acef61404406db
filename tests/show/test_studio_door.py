"""Who comes through the studio's door, and what a tab may send: with a plain websocket client."""

import gc
import math
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from studio_tab import CAMERA, connected, received, refusals, send, soak
from viser import _messages as messages
from websockets import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from cmf_mj.core.errors import InputError
from cmf_mj.show.studio import door
from cmf_mj.show.studio.desk import check_value
from cmf_mj.show.studio.door import MOST_TABS, Door
from cmf_mj.show.studio.live import LiveSession
from cmf_mj.show.studio.server import Page, Studio

PAGE = "http://127.0.0.1:8048"


def wait(condition: Callable[[], object], seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "it did not come to that"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def studio() -> Iterator[Studio]:
    running = Studio(port=8462)
    yield running
    running.stop()


@pytest.fixture
def tab(studio: Studio) -> Iterator[ClientConnection]:
    """An open tab with its page, the only one."""
    wait(lambda: not studio.pages)
    with connected(studio.url) as opened:
        send(opened, CAMERA)
        wait(lambda: studio.pages)
        yield opened


def control(page: Page, label: str) -> Any:
    """A control of a page."""
    handles = page.desk.client.gui._gui_input_handle_from_uuid.values()
    return next(handle for handle in handles if handle.label == label)


def command(tab: ClientConnection, studio: Studio, label: str, **updates: object) -> None:
    """Move a control of the only page, by hand or with a forged message."""
    send(tab, messages.GuiUpdateMessage(control(studio.pages[0], label)._impl.uuid, updates))


# Requests.


@pytest.mark.parametrize(
    ("host", "origin", "upgrade", "said"),
    [
        ("127.0.0.1:8048", PAGE, True, None),
        ("127.0.0.1:8048", None, False, None),
        ("localhost:9000", "http://localhost:9000", True, None),  # through a tunnel
        ("[::1]:8048", "http://[::1]:8048", True, None),
        ("127.0.0.1:8048", None, True, "origin: [] is refused"),
        ("127.0.0.1:8048", "http://evil.test", True, "allowed: http://127.0.0.1:8048"),
        ("127.0.0.1:8048", "http://evil.test", False, "origin: "),
        ("127.0.0.1:8048", "null", True, "origin: ['null'] is refused"),
        ("127.0.0.1:8048", "http://127.0.0.1:3000", True, "origin: "),  # another program's page
        ("127.0.0.1:8048", "https://127.0.0.1:8048", True, "origin: "),
        ("evil.test:8048", "http://evil.test:8048", True, "host: ['evil.test:8048'] is refused"),
        ("127.0.0.1.evil.test", None, False, "host: "),
        ("192.168.0.7:8048", "http://192.168.0.7:8048", True, "host: "),
        ("[", None, False, "host: "),
        ("", None, False, "host: "),
    ],
)
def test_a_request_is_for_this_machine_and_from_its_own_page(
    host: str, origin: str | None, upgrade: bool, said: str | None
) -> None:
    """RFC 6454: scheme, host and port; a foreign name that resolves to loopback is not here."""
    headers = Headers(Host=host)
    if origin is not None:
        headers["Origin"] = origin
    if upgrade:
        headers["Upgrade"] = "websocket"
    refused = Door("127.0.0.1").refusal("/", headers, 0)
    assert (refused is None) == (said is None)
    if refused is not None:
        assert said is not None and said in refused[1] and "\n" not in refused[1]


def test_headers_that_come_twice_or_not_at_all_are_refused() -> None:
    twice = Headers([("Host", "127.0.0.1"), ("Host", "127.0.0.1")])
    origins = Headers([("Host", "127.0.0.1"), ("Origin", PAGE), ("Origin", PAGE)])
    for headers in (Headers(), twice, origins):
        assert Door("127.0.0.1").refusal("/", headers, 0) is not None


def test_beyond_loopback_the_token_is_asked_for_by_address_or_cookie() -> None:
    guard, headers = Door("0.0.0.0"), Headers(Host="192.168.0.7:8048")
    token = guard.token
    assert token is not None and len(token) >= 32 and token != Door("0.0.0.0").token
    assert guard.refusal(f"/?token={token}", headers, 0) is None
    for path in ("/", "/?token=", f"/?token={token}x", f"/?token={token[:-1]}", "/?token=\u00e9"):
        refused = guard.refusal(path, headers, 0)
        assert refused is not None and refused[1].startswith("token: is missing or wrong"), path
    headers["Cookie"] = f"other=1; cmf_studio={token}"
    assert guard.refusal("/", headers, 0) is None
    assert guard.refusal("/", Headers(Host="evil.test", Cookie=headers["Cookie"]), 0) is not None
    assert Door("127.0.0.1").token is Door("localhost").token is Door("::1").token is None


def test_an_address_names_a_ready_scenario_and_no_file(studio: Studio) -> None:
    wait(lambda: not studio.pages)
    with urllib.request.urlopen(f"{studio.url}/?scenario=push", timeout=30.0) as reply:
        assert reply.url == f"{studio.url}/?websocket=ws{studio.url[4:]}/?scenario=push"
        assert b"<html" in reply.read(2000)
    with connected(f"{studio.url}/?scenario=push") as tab:
        send(tab, CAMERA)
        wait(lambda: studio.pages)
        assert studio.pages[0].live.scenario().result().title == "A push on the platform"
    for name in ("surge_single_legs", "../push", "/etc/passwd", "a.toml"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(f"{studio.url}/?scenario={name}", timeout=30.0)
        assert refused.value.code == 404
        assert f"scenario: {name!r} is unknown; allowed: studio, ".encode() in refused.value.read()


def test_the_page_answers_itself_and_refuses_other_sites(studio: Studio) -> None:
    with urllib.request.urlopen(studio.url, timeout=30.0) as reply:
        assert b"<html" in reply.read(2000)
        assert reply.headers["X-Frame-Options"] == "DENY"
    with connected(studio.url) as tab:
        send(tab, CAMERA)
        wait(lambda: studio.pages)
    for origin, headers in (
        ("http://evil.test", {}),
        ("null", {}),
        ("http://evil.test:8462", {"Host": "evil.test:8462"}),
    ):
        with pytest.raises(InvalidStatus) as caught:
            connected(studio.url, origin, **headers)
        answer = caught.value.response
        assert answer.status_code == 403
        assert answer.body.startswith(b"cmf studio: ") and answer.body.count(b"\n") == 1


def test_a_studio_for_other_machines_asks_for_its_token() -> None:
    running = Studio("0.0.0.0", port=8464)
    try:
        address, _, token = running.url.partition("/?token=")
        assert len(token) >= 32
        for url in (address, f"{address}/?token=guess"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(url, timeout=30.0)
            assert refused.value.code == 403
            assert b"token: is missing or wrong" in refused.value.read()
            with pytest.raises(InvalidStatus):
                connected(url, address)
        with urllib.request.urlopen(running.url, timeout=30.0) as reply:
            cookie = reply.headers["Set-Cookie"]
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        with connected(address, Cookie=cookie.partition(";")[0]) as tab:
            send(tab, CAMERA)
            wait(lambda: running.pages)
    finally:
        running.stop()


def test_one_tab_too_many_is_refused_until_another_closes(studio: Studio) -> None:
    wait(lambda: not studio._door._open)
    tabs = [connected(studio.url) for _ in range(MOST_TABS)]
    with pytest.raises(InvalidStatus) as caught:
        connected(studio.url)
    assert caught.value.response.status_code == 503
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(studio.url, timeout=30.0)
    assert b"tabs: 8 are open" in refused.value.read()
    tabs.pop().close()
    wait(lambda: len(studio._door._open) < MOST_TABS)
    tabs.append(connected(studio.url))
    for tab in tabs:
        tab.close()


# Commands.


@pytest.mark.parametrize(
    ("label", "value", "allowed"),
    [
        ("law", "/etc/hostname.toml", "allowed: original, "),
        ("law", "../../x.toml:a", "allowed: original, "),
        ("cab", 3, "allowed: gfd, rfd, ifd"),
        ("leg", "9", "allowed: 1, 2, 3, 4, 5, 6"),
        ("speed", "1e300", "allowed: 1, 1/2"),
        ("force [%]", 1e300, "allowed: 1 to 75"),
        ("force [%]", math.nan, "allowed: 1 to 75"),
        ("force [%]", "all", "allowed: 1 to 75"),
        ("push now", "yes", "allowed: true, false"),
        ("export scenario", "x", "allowed: true, false"),
    ],
)
def test_a_forged_command_is_refused_and_the_session_goes_on(
    tab: ClientConnection, studio: Studio, label: str, value: object, allowed: str
) -> None:
    (page,) = studio.pages
    before = page.live.scenario().result()
    command(tab, studio, label, value=value)
    said = next(refusals(tab))
    assert said.startswith(label) and allowed in said and "\n" not in said
    after = page.live.scenario().result()
    assert after.model_copy(update={"duration": before.duration}) == before
    wait(lambda: page.live.scenario().result().duration > after.duration)


def test_only_the_value_of_a_control_can_be_set(tab: ClientConnection, studio: Studio) -> None:
    command(tab, studio, "law", value="force", update_cb=[])
    assert "['update_cb', 'value'] is refused" in next(refusals(tab))
    command(tab, studio, "law", value="force")
    wait(lambda: studio.pages[0].live.scenario().result().change)
    with pytest.raises(InputError, match="True is refused"):
        check_value(control(studio.pages[0], "force [%]"), {"value": True})


def test_what_the_page_has_no_use_for_is_dropped(
    tab: ClientConnection, studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    """viser would open a public address for whoever asks, and take files."""
    asked: list[bool] = []
    monkeypatch.setattr(studio._server, "request_share_url", lambda: asked.append(True))
    gui = studio.pages[0].desk.client.gui
    send(tab, messages.ShareUrlRequest())
    send(tab, messages.FileTransferStartUpload("x", "y", "a.toml", "", 1, 9))
    for raw in (b"", b"\xc1", b"\x80", b"\x93\x01\x02\x03", "text"):
        tab.send(raw)
    command(tab, studio, "law", value="force")
    wait(lambda: studio.pages[0].live.scenario().result().change)
    assert not asked and not gui._current_file_upload_states


def test_a_message_too_large_ends_its_tab_alone(tab: ClientConnection, studio: Studio) -> None:
    with connected(studio.url) as other:
        other.send(bytes(door.MOST_MESSAGE + 1))
        with pytest.raises(ConnectionClosed, match="1009"):
            next(m for m in received(other) if m is None)
    since = studio.pages[0].live.scenario().result().duration
    wait(lambda: studio.pages[0].live.scenario().result().duration > since)


# Ends.


def test_sessions_end_with_their_tabs_also_while_they_are_built(studio: Studio) -> None:
    """Nothing holds a session, its plant or its record once the tab is gone."""
    wait(lambda: not studio.pages)
    for pause in (0.0, 0.05, 0.3):
        tabs = [connected(studio.url) for _ in range(4)]
        for tab in tabs:
            send(tab, CAMERA)
        time.sleep(pause)
        for tab in tabs:
            tab.close()
    wait(lambda: not studio._server.get_clients() and not studio._building.locked())

    def alive() -> int:
        gc.collect()
        return sum(type(one) is LiveSession for one in gc.get_objects())

    wait(lambda: not studio.pages and alive() == 0)


@pytest.mark.slow
def test_memory_stays_flat_while_tabs_open_and_close() -> None:
    """What `scripts/soak.py studio` does for an hour, with 48 tabs a minute."""
    done = soak(60.0, 2.5, hurried=1, port=8466)
    assert done.spread(15.0) < 0.1
    assert done.interrupt < 30.0
