"""What the controls of a page act on."""

from collections.abc import Callable
from typing import Any, Protocol

import viser

from cmf_mj.facility.scenario.settings import Change, Scenario
from cmf_mj.show.studio.live import LiveSession


class Desk(Protocol):
    """The page, as its controls see it."""

    client: viser.ClientHandle  #: The tab.
    live: LiveSession  #: Its session.

    def apply(self, change: Change) -> None:
        """Let something change; a refusal is shown."""

    def begin(self, scenario: Scenario) -> None:
        """Begin anew; a refusal is shown and the run goes on."""

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
    """Set a dropdown, with an option of its own if it has no such one."""
    if value not in handle.options:
        handle.options = (*handle.options, value)
    handle.value = value
