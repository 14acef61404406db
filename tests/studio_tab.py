"""A tab of the studio without a browser: a plain websocket client that speaks viser's messages."""

import runpy
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import zstandard
from viser import _messages as messages
from websockets.sync.client import ClientConnection

_SOAK = runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "soak_studio.py"))

CAMERA, connected, send, soak = (_SOAK[name] for name in ("CAMERA", "connected", "send", "soak"))


def upload(tab: ClientConnection, button: str, content: bytes) -> None:
    """Load a file with the button of a uuid, as the page does it."""
    transfer = f"{button}-{time.monotonic()}"
    about = {"part_count": 1, "size_bytes": len(content)}
    send(tab, messages.FileTransferStartUpload(button, transfer, "mine.toml", "", **about))
    send(tab, messages.FileTransferPart(button, transfer, 0, content[:500_000]))


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
