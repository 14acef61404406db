"""Rows of a record: their `Layout` in channels, and `RecordRows`, which the loop writes to."""

from collections import namedtuple
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.facility.front import Source
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.plant import Plant

CHAIN_CHANNELS = {
    "demand_pose": ("m, rad", "platform"),
    "demand_velocity": ("m/s, rad/s", "platform"),
    "demand_acceleration": ("m/s^2, rad/s^2", "platform"),
    "operating_state": ("1", "scalar"),
    "host_stale": ("1", "scalar"),
    "host_late": ("1", "scalar"),
    "host_clock": ("1", "scalar"),
    "valve_gain": ("1", "scalar"),
}
"""Channels of the chain, name to unit and kind; the pose is also that of a table."""

_LAW_CHANNELS = ("leg_reference", "compensator_output")  #: Channels that an open loop has not.

_WINDOW_ROWS = 2048  #: Rows that the loop writes before the channels are taken out of them.

_CHANNELS = CHAIN_CHANNELS | {
    "leg_reference": ("m", "legs"),
    "leg_position": ("m", "legs"),
    "leg_velocity": ("m/s", "legs"),
    "leg_acceleration": ("m/s^2", "legs"),
    "leg_extension": ("m", "legs"),
    "compensator_output": ("1", "legs"),
    "valve_command": ("1", "legs"),
    "valve_opening": ("1", "legs"),
    "cap_pressure": ("Pa", "legs"),
    "rod_pressure": ("Pa", "legs"),
    "leg_force": ("N", "legs"),
    "gimbal_error": ("m", "scalar"),
    # The state of the supply, in the order of `plant.supply`.
    "supply_content": ("m^3", "scalar"),
    "return_content": ("m^3", "scalar"),
    "accumulator_oil": ("m^3", "scalar"),
    "pump_flow": ("m^3/s", "scalar"),
    "tank_content": ("m^3", "scalar"),
    "isolation": ("1", "scalar"),
    "supply_pressure": ("Pa", "scalar"),
    "return_pressure": ("Pa", "scalar"),
    "accumulator_pressure": ("Pa", "scalar"),
    "energy": ("J", "energies"),
    "generalised_position": ("m, rad, 1", "positions"),
}

_SENSOR_UNITS = {"gyro": "rad/s", "force": "N"}
"""Units of MuJoCo's sensors by the last word of their channel; m/s^2 for all others."""

Columns = namedtuple("Columns", (*_CHANNELS, "sensors"))  # type: ignore[misc]
"""First column of each channel, and of MuJoCo's sensors; meaningless where a channel is absent."""


class Channel(NamedTuple):
    """One channel of a record and where it stands in a row."""

    name: str
    unit: str
    first: int  #: First column.
    width: int | None  #: Columns; None for a scalar, which has one and no axis of its own.

    def of(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """The channel of rows, (N,) or (N, width)."""
        if self.width is None:
            return rows[:, self.first]
        return rows[:, self.first : self.first + self.width]


class Layout(NamedTuple):
    """All channels of a record, in order."""

    channels: tuple[Channel, ...]
    columns: Columns
    width: int  #: Columns of a row.


def make_layout(plant: Plant, *, has_law: bool, source: Source) -> Layout:
    """The layout of a plant's records, for a closed or open loop on a source."""
    widths = {
        "platform": 6,
        "scalar": None,
        "legs": plant.legs,
        "energies": len(ENERGIES),
        "positions": plant.model.nq,
    }
    absent = set[str]() if has_law else {*_LAW_CHANNELS}
    if not source.hosted:
        absent |= {*CHAIN_CHANNELS} - ({"demand_pose"} if source.poses.size else set())
    channels, starts, width = list[Channel](), dict.fromkeys(_CHANNELS, -1), 0
    for name, (unit, kind) in _CHANNELS.items():
        if name not in absent:
            starts[name] = width
            channels.append(Channel(name, unit, width, widths[kind]))
            width += widths[kind] or 1
    columns = Columns(**starts, sensors=width)  # type: ignore[call-arg]
    for name, indices in plant.sensors.items():
        unit = _SENSOR_UNITS.get(name.split("_")[-1], "m/s^2")
        channels.append(Channel(name, unit, width, indices.size))
        width += indices.size
    return Layout(tuple(channels), columns, width)


class RecordRows:
    """Rows of a record: all of them by channel, or the latest in a window."""

    def __init__(self, layout: Layout, count: int, *, keeps_all: bool) -> None:
        """Make room for a number of rows."""
        self._channels = layout.channels
        self._written_rows = 0
        self._histories: dict[str, NDArray[np.float64]] = {}  # none where only the latest are kept
        if keeps_all:
            for channel in layout.channels:
                shape = (count,) if channel.width is None else (count, channel.width)
                self._histories[channel.name] = np.empty(shape)
            count = min(count, _WINDOW_ROWS)
        self.window = np.empty((count, layout.width))
        """The latest rows; after the last the loop writes the first again, (N, columns)."""

    def take(self, written_rows: int) -> None:
        """Copy the rows that are new into the histories; a history that is full is read-only."""
        first, self._written_rows = self._written_rows, written_rows
        start = first % self.window.shape[0]
        new_rows = self.window[start : start + written_rows - first]
        for channel in self._channels if self._histories and new_rows.size else ():
            history = self._histories[channel.name]
            history[first:written_rows] = channel.of(new_rows)
            history.setflags(write=written_rows < history.shape[0])

    def rows(self, first: int, last: int) -> NDArray[np.float64]:
        """Copy of the rows from `first` to before `last`, which the window still holds."""
        return self.window[np.arange(first, last) % self.window.shape[0]]

    def histories(self) -> tuple[int, dict[str, NDArray[np.float64]]]:
        """Number of the first row that is kept, and the histories of the channels from there on."""
        last = self._written_rows
        if self._histories:
            return 0, {name: history[:last] for name, history in self._histories.items()}
        first = max(last - self.window.shape[0], 0)
        rows = self.rows(first, last)
        return first, {channel.name: channel.of(rows) for channel in self._channels}
