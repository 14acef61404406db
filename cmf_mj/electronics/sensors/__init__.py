"""Sensors: ideal differences of the integrated motion, and instruments with their errors.

`velocity` and `acceleration` are the truth at a control frame; `load_sensors`, `make_sensors`,
`sensor_state` and `sense` put instruments behind it.
"""

from cmf_mj.electronics.sensors.differences import acceleration, velocity
from cmf_mj.electronics.sensors.settings import (
    CHANNELS,
    SENSOR_SETS,
    ChannelSettings,
    SensorSettings,
    load_sensors,
)
from cmf_mj.electronics.sensors.suite import (
    Sensors,
    SensorState,
    Truth,
    make_sensors,
    sense,
    sense_history,
    sense_platform,
    sensor_state,
)

__all__ = [
    "CHANNELS",
    "SENSOR_SETS",
    "ChannelSettings",
    "SensorSettings",
    "SensorState",
    "Sensors",
    "Truth",
    "acceleration",
    "load_sensors",
    "make_sensors",
    "sense",
    "sense_history",
    "sense_platform",
    "sensor_state",
    "velocity",
]
