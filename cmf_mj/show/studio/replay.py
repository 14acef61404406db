"""A recorded run on the page: load a record, scrub it, play it."""

import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import viser
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.record.record import Record
from cmf_mj.show.studio import traces
from cmf_mj.show.studio.desk import Desk, by_hand

_MOST = round(traces.LONGEST * traces.RATE)
"""Rows drawn at most."""


class Recording:
    """A record of the hexapod, looked at by time."""

    def __init__(self, record: Record, width: int) -> None:
        """Check that the record can be shown.

        Args:
            record: of a run with the hexapod.
            width: generalised positions of the model.

        Raises:
            InputError: the record is of another plant or does not hold what the page shows.
        """
        plant = record.metadata.get("plant")
        if plant != "hexapod":
            raise InputError(f"plant: {plant!r} of the record cannot be shown; allowed: hexapod")
        needed = {**traces.CHANNELS, "generalised_position": width}
        for name, columns in needed.items():
            shape = record[name].shape[1:] or (1,)
            if shape != (columns,):
                raise InputError(f"{name}: has {shape[0]} columns; {columns} are needed")
        if record.time.size < 2:
            raise InputError(f"time: has {record.time.size} samples; at least 2 are needed")
        if record.metadata.get("cab") not in models.CABS:
            raise InputError(f"cab: {record.metadata.get('cab')!r} is not one of {models.CABS}")
        self.record = record
        self.cab = str(record.metadata["cab"])
        self.start, self.end = float(record.time[0]), float(record.time[-1])

    def position(self, time: float) -> NDArray[np.float64]:
        """Generalised positions of the last row at or before a time [s]."""
        return self.record["generalised_position"][self._row(time)]

    def last(self, time: float, seconds: float) -> dict[str, NDArray[np.float64]]:
        """The rows of the last `seconds` before a time, thinned out to what a plot can show."""
        stop = self._row(time) + 1
        first = int(np.searchsorted(self.record.time, time - seconds))
        rows = slice(first, stop, max(1, (stop - first) // _MOST))
        found = {"time": self.record.time[rows]}
        for name, width in traces.CHANNELS.items():
            found[name] = self.record[name][rows].reshape(-1, width)
        return found

    def _row(self, time: float) -> int:
        row = int(np.searchsorted(self.record.time, time, side="right")) - 1
        return min(max(row, 0), self.record.time.size - 1)


def read_recording(name: str, content: bytes, width: int) -> Recording:
    """A recording from a file of the browser.

    Raises:
        InputError: the file is no record of the hexapod; the message names file and field.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / (Path(name).name or "record.parquet")
        path.write_bytes(content)
        try:
            return Recording(Record.load(path), width)
        except ValueError as error:
            text = str(error).replace(f"{folder}/", "")
            raise InputError(text if path.name in text else f"{path.name}: {text}") from None


class ReplayPanel:
    """Upload, scrubber and player."""

    def __init__(
        self, desk: Desk, width: int, enter: Callable[[Recording], None], leave: Callable[[], None]
    ) -> None:
        """Add them to the container in force.

        Args:
            desk: the page.
            width: generalised positions of the model.
            enter: called with a recording to show in the place of the live run.
            leave: called to go back to it.
        """
        gui = desk.client.gui
        self._lock = threading.Lock()
        self._recording: Recording | None = None
        self._time = 0.0
        upload = gui.add_upload_button("open a recording (Parquet)", icon="file-upload")
        self._text = gui.add_markdown("A record of `cmf run`, `cmf failure`, or of this page.")
        self._folder = gui.add_folder("player", visible=False)
        with self._folder:
            self._slider = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0)
            self._play = gui.add_checkbox("play", True)
            self._speed = gui.add_dropdown("replay speed", ("1/10", "1/2", "1", "2", "5"))
            self._speed.value = "1"
            gui.add_button("back to the live run").on_click(lambda _: self._leave(leave))
        self._slider.on_update(self._scrubbed)

        @upload.on_upload
        def _(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            file = event.target.value
            try:
                found = read_recording(file.name, file.content, width)
            except ValueError as error:
                desk.tell(error)
                return
            self._open(file.name, found)
            enter(found)

    @property
    def recording(self) -> Recording | None:
        """What is shown in the place of the live run, if anything."""
        return self._recording

    def turn(self, elapsed: float) -> float:
        """Let the recording go on.

        Args:
            elapsed: wall time since the turn before [s].

        Returns:
            Time to show [s].
        """
        with self._lock:
            found = self._recording
            if found is None:
                return 0.0
            if self._play.value:
                numerator, _, denominator = self._speed.value.partition("/")
                speed = float(numerator) / float(denominator or 1.0)
                self._time = min(self._time + speed * elapsed, found.end)
                if self._time >= found.end:
                    self._play.value = False
            return self._time

    def show(self) -> None:
        """Move the scrubber to the time shown."""
        if self._recording is not None and self._play.value:
            self._slider.value = round(self._time, 2)

    def _open(self, name: str, found: Recording) -> None:
        with self._lock:
            self._slider.min, self._slider.max = found.start, found.end
            self._slider.value = self._time = found.start
            self._play.value = True
            self._recording = found
        law = found.record.metadata.get("law") or "no law"
        self._text.content = (
            f"**{name}**: {found.end - found.start:.1f} s at {found.record.rate:g} Hz, {law}, "
            f"{found.cab}, {found.record.metadata.get('hydraulics')}"
        )
        self._folder.visible = True

    def _leave(self, leave: Callable[[], None]) -> None:
        with self._lock:
            self._recording = None
        self._folder.visible = False
        self._text.content = "The live run is shown."
        leave()

    def _scrubbed(self, event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
        if by_hand(event):
            with self._lock:
                self._play.value = False
                self._time = event.target.value
