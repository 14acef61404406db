"""A recorded run on the page: load a record, scrub it, play it."""

import threading
from collections.abc import Callable

import numpy as np
import viser
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.record.record import Record
from cmf_mj.show.studio import traces
from cmf_mj.show.studio.desk import Desk, by_hand, read_upload

_MOST = round(traces.LONGEST * traces.RATE)
"""Rows drawn at most."""

_SPEEDS = {"1/10": 0.1, "1/2": 0.5, "1": 1.0, "2": 2.0, "5": 5.0}
"""Recorded over wall time."""


class Recording:
    """A record of the hexapod, looked at by time."""

    def __init__(self, record: Record, width: int) -> None:
        """Check that the page can show the record; `width`: number of generalised positions."""
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
        return {"time": self.record.time[rows]} | {
            name: self.record[name][rows].reshape(-1, width)
            for name, width in traces.CHANNELS.items()
        }

    def _row(self, time: float) -> int:
        row = int(np.searchsorted(self.record.time, time, side="right")) - 1
        return min(max(row, 0), self.record.time.size - 1)


def read_recording(name: str, content: bytes, width: int) -> Recording:
    """A recording from a file of the browser."""
    return read_upload(name, content, lambda path: Recording(Record.load(path), width))


class ReplayPanel:
    """Upload, scrubber and player."""

    def __init__(
        self, desk: Desk, width: int, enter: Callable[[Recording], None], leave: Callable[[], None]
    ) -> None:
        """Add them to the container in force.

        `enter` takes a recording to show in the place of the live run; `leave` goes back to it.
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
            self._speed = gui.add_dropdown("replay speed", tuple(_SPEEDS), initial_value="1")
            gui.add_button("back to the live run").on_click(lambda _: self._leave(leave))
        self._slider.on_update(self._scrubbed)

        @upload.on_upload
        def _(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            file = event.target.value
            try:
                recording = read_recording(file.name, file.content, width)
            except ValueError as error:
                desk.tell(error)
                return
            self._open(file.name, recording)
            enter(recording)

    @property
    def recording(self) -> Recording | None:
        """The recording in the place of the live run, if any."""
        return self._recording

    def turn(self, elapsed: float) -> float:
        """Let the recording go on for a wall time [s], and return the time to show [s]."""
        with self._lock:
            if self._recording is None:
                return 0.0
            if self._play.value:
                end = self._recording.end
                self._time = min(self._time + _SPEEDS[self._speed.value] * elapsed, end)
                if self._time >= end:
                    self._play.value = False
            return self._time

    def show(self) -> None:
        """Move the scrubber to the time of the picture."""
        if self._recording is not None and self._play.value:
            self._slider.value = round(self._time, 2)

    def _open(self, name: str, recording: Recording) -> None:
        start, end = recording.start, recording.end
        with self._lock:
            self._slider.min, self._slider.max = start, end
            self._slider.value = self._time = start
            self._play.value = True
            self._recording = recording
        record = recording.record
        self._text.content = (
            f"**{name}**: {end - start:.1f} s at {record.rate:g} Hz, "
            f"{record.metadata.get('law') or 'no law'}, {recording.cab}, "
            f"{record.metadata.get('hydraulics')}"
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
