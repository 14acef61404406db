"""The layout of a record: which channels a row has, and which columns hold each.

A session makes its layout once. The compiled loop writes a row through `columns`, and `history`
takes the rows apart through `channels`.
"""

from collections import namedtuple
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.plant import Plant

CHAIN = {
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

LAW = ("leg_reference", "compensator_output")  #: Channels that an open loop has not.

_CHANNELS = CHAIN | {
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


def make_layout(plant: Plant, absent: set[str]) -> Layout:
    """The layout of a plant's records without some of the channels."""
    widths = {
        "platform": 6,
        "scalar": None,
        "legs": plant.legs,
        "energies": len(ENERGIES),
        "positions": plant.model.nq,
    }
    channels, starts, first = list[Channel](), dict.fromkeys(_CHANNELS, -1), 0
    for name, (unit, kind) in _CHANNELS.items():
        if name not in absent:
            starts[name], width = first, widths[kind]
            channels.append(Channel(name, unit, first, width))
            first += 1 if width is None else width
    columns = Columns(**starts, sensors=first)  # type: ignore[call-arg]
    for name, indices in plant.sensors.items():
        unit = _SENSOR_UNITS.get(name.split("_")[-1], "m/s^2")
        channels.append(Channel(name, unit, first, indices.size))
        first += indices.size
    return Layout(tuple(channels), columns, first)
