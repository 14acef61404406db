"""What the controls of a page act on, and what they have in common."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

import viser

from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario.settings import Change, Scenario
from cmf_mj.show.studio.live import LiveSession

Content = TypeVar("Content")


class Desk(Protocol):
    """The page, as its controls see it."""

    client: viser.ClientHandle  #: The tab.
    live: LiveSession  #: Its session.

    def apply(self, change: Change) -> None:
        """Let something change, or show the refusal."""

    def begin(self, scenario: Scenario) -> None:
        """Begin anew; on a refusal show it and let the run go on."""

    def again(self, **settings: Any) -> None:
        """Begin anew with the present law and signal and some settings of the scenario changed."""

    def tell(self, error: Exception) -> None:
        """Show a refusal."""

    def later(self, key: str, action: Callable[[], None]) -> None:
        """Do something when the control of this key has been left alone for a moment."""


def by_hand(event: viser.GuiEvent[Any]) -> bool:
    """Whether a control was moved in the browser, and not by the page itself."""
    return event.client is not None


def picked(handle: viser.GuiDropdownHandle[str], value: str) -> None:
    """Set a dropdown, with a new option if it has no such one."""
    if value not in handle.options:
        handle.options = (*handle.options, value)
    handle.value = value


def read_upload(name: str, content: bytes, read: Callable[[Path], Content]) -> Content:
    """Read a file of the browser from its name and bytes; a refusal begins with the name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / (Path(name).name or "file")
        path.write_bytes(content)
        try:
            return read(path)
        except ValueError as error:
            text = str(error).replace(f"{folder}/", "")
            raise InputError(text if path.name in text else f"{path.name}: {text}") from None
