"""What a tab may command: values its controls can have, and files small and seldom enough."""

import math
from typing import Any

import viser
from viser import _messages as messages

from cmf_mj.core.errors import InputError
from cmf_mj.show.studio.door import Allowance

MOST_FILE = 1_000_000
"""Largest file a tab may load [octets]; an hour of changes is a tenth of it."""

UPLOADS = (0.5, 5.0)
"""Files a tab may load a second and at once."""


def check_commands(client: viser.ClientHandle) -> None:
    """Let the controls of a tab take only what `check_value` and `check_upload` let pass.

    What is refused is told to the tab.
    """
    gui, connection = client.gui, client._websock_connection
    uploads = Allowance(*UPLOADS)

    def tell(error: InputError) -> None:
        client.add_notification("Refused", str(error), color="red", auto_close_seconds=30.0)

    async def update(client_id: Any, message: messages.GuiUpdateMessage) -> None:
        try:
            check_value(gui._gui_input_handle_from_uuid.get(message.uuid), message.updates)
        except InputError as error:
            tell(error)
        else:
            await gui._handle_gui_updates(client_id, message)

    def begin(client_id: Any, message: messages.FileTransferStartUpload) -> None:
        try:
            check_upload(message.size_bytes, message.part_count, uploads)
        except InputError as error:
            tell(error)
        else:
            gui._drop_uploads_from_client(client_id)  # one at a time
            gui._handle_file_transfer_start(client_id, message)

    connection.unregister_handler(messages.GuiUpdateMessage)
    connection.register_handler(messages.GuiUpdateMessage, update)
    connection.unregister_handler(messages.FileTransferStartUpload)
    connection.register_handler(messages.FileTransferStartUpload, begin)


def check_value(handle: Any, updates: dict[str, Any]) -> None:
    """Refuse what a control cannot be set to by hand."""
    if handle is None:
        return
    label = handle.label or "button"
    if set(updates) != {"value"}:
        raise InputError(f"{label}: {sorted(updates)} is refused; allowed: value")
    value = updates["value"]
    if (options := getattr(handle, "options", None)) is not None:
        if value not in options:
            raise InputError(f"{label}: {value!r} is refused; allowed: {', '.join(options)}")
    elif isinstance(handle.value, bool):
        if not isinstance(value, bool):
            raise InputError(f"{label}: {value!r} is refused; allowed: true, false")
    elif isinstance(handle.value, int | float):
        low, high = (getattr(handle, end, None) for end in ("min", "max"))
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (
            number
            and math.isfinite(value)
            and (low is None or value >= low)
            and (high is None or value <= high)
        ):
            span = "a number" if low is None else f"{low:g} to {high:g}"
            raise InputError(f"{label}: {value!r} is refused; allowed: {span}")
    else:
        raise InputError(f"{label}: {value!r} is refused; it has no value to set")


def check_upload(size: int, parts: int, uploads: Allowance) -> None:
    """Refuse a file that is too large, in too many parts, or too soon after others."""
    if not 0 <= size <= MOST_FILE or not 0 <= parts <= 2:
        raise InputError(f"load scenario: {size} octets are refused; allowed: {MOST_FILE} at most")
    if (wait := uploads.take(1.0)) > 0.0:
        raise InputError(f"load scenario: too many files; wait {wait:.0f} s")
