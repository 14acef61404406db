"""A tab of the studio without a browser: a plain websocket client that speaks viser's messages."""

import runpy
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import zstandard
from websockets.sync.client import ClientConnection

_SOAK = runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "soak.py"))

CAMERA, connected, send, soak = (_SOAK[name] for name in ("CAMERA", "connected", "send", "soak"))


def received(tab: ClientConnection) -> Iterator[dict[str, Any]]:
    """Messages of the studio, one by one."""
    while True:
        raw = tab.recv(timeout=60.0)
        assert isinstance(raw, bytes)
        inner = zstandard.ZstdDecompressor().decompress(
            raw[16:][: int.from_bytes(raw[8:16], "little")]
        )
        yield from msgspec.msgpack.decode(inner)["messages"]


def refusals(tab: ClientConnection) -> Iterator[str]:
    """What the tab is told to be refused, one by one; a minute at most."""
    until = time.monotonic() + 60.0
    for message in received(tab):
        assert time.monotonic() < until, "nothing more is refused"
        if message["type"] == "NotificationShowMessage":
            yield str(message["props"]["body"])
