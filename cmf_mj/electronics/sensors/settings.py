"""Sensor sets: range, bias, noise, bandwidth and resolution of every channel, with their sources.

The numbers live in `sensors.toml`. Two sets are shipped: `ideal`, in which every reading is the
truth bit for bit, and `noisy`, the instruments as they may have been.
"""

from pathlib import Path

from pydantic import model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.settings import Loader, Name, Settings

SENSOR_SETS = ("ideal", "noisy")
"""Names of the shipped sets."""

CHANNELS = {
    "leg_position": ("in", "m"),
    "leg_velocity": ("in/s", "m/s"),
    "leg_acceleration": ("g", "in/s/s", "m/s/s"),
    "cap_pressure": ("psi", "Pa"),
    "rod_pressure": ("psi", "Pa"),
    "platform_gyro": ("deg/s", "rad/s"),
    "platform_accelerometer": ("g", "in/s/s", "m/s/s"),
}
"""Channels with the units their numbers may be given in."""


class ChannelSettings(Settings):
    """One kind of sensor; what is left out is ideal."""

    lowest: Quantity | None = None  #: Least reading.
    highest: Quantity | None = None  #: Largest reading.
    bias: Quantity | None = None  #: Constant error, the same for all legs or axes.
    noise_density: Quantity | None = None
    """One-sided density of the white noise of the output, per root hertz."""
    bandwidth: Quantity | None = None
    """-3 dB corner of the first-order lag, below half the frame rate."""
    resolution: Quantity | None = None  #: Step between readings.
    gain_errors: list[Quantity] = []
    """Relative error of the gain, one a leg or axis; none for none."""

    @model_validator(mode="after")
    def _consistent(self) -> "ChannelSettings":
        for field in ("noise_density", "bandwidth", "resolution"):
            quantity = getattr(self, field)
            least = 0.0 if quantity is None else quantity.value
            if least < 0.0 or (field != "noise_density" and quantity is not None and least == 0.0):
                bound = "at least 0" if field == "noise_density" else "greater than 0"
                raise InputError(f"{field}: {least:g} {quantity.unit} must be {bound}")
        for error in self.gain_errors:
            if error.unit not in ("1", "%") or abs(error.si) >= 1.0:
                raise InputError(
                    f"gain_errors: {error} must be between -1 and 1, in a unit of 1 or %"
                )
        if self.lowest and self.highest and self.lowest.si >= self.highest.si:
            raise InputError(
                f"lowest: {self.lowest.value:g} {self.lowest.unit} must be less than highest, "
                f"{self.highest.value:g} {self.highest.unit}"
            )
        return self

    def quantities(self) -> dict[str, Quantity]:
        """The numbers common to all legs or axes that are given, by name."""
        return {name: value for name, value in self if isinstance(value, Quantity)}


class SensorSettings(Settings):
    """A whole set of sensors."""

    name: Name  #: Name of the set.
    gravity: bool
    """Whether the leg accelerometers sit on the rods and feel gravity and swing (Appendix C).
    Otherwise they read the second derivative of the leg extension, as the report's non-linear model
    has it."""
    leg_position: ChannelSettings = ChannelSettings()
    leg_velocity: ChannelSettings = ChannelSettings()
    leg_acceleration: ChannelSettings = ChannelSettings()
    cap_pressure: ChannelSettings = ChannelSettings()
    rod_pressure: ChannelSettings = ChannelSettings()
    platform_gyro: ChannelSettings = ChannelSettings()
    platform_accelerometer: ChannelSettings = ChannelSettings()

    @model_validator(mode="after")
    def _units(self) -> "SensorSettings":
        for channel, units in CHANNELS.items():
            for field, quantity in self.channel(channel).quantities().items():
                allowed = _units_of(field, units)
                if quantity.unit not in allowed:
                    raise InputError(
                        f"{channel}.{field}: unit {quantity.unit!r} must be one of "
                        f"{', '.join(allowed)}"
                    )
        return self

    def channel(self, name: str) -> ChannelSettings:
        """Settings of one of `CHANNELS`."""
        return getattr(self, name)


def _units_of(field: str, units: tuple[str, ...]) -> tuple[str, ...]:
    if field == "noise_density":
        return tuple(f"{unit}/rtHz" for unit in units)
    return ("Hz", "rad/s") if field == "bandwidth" else units


load_sensors = Loader(
    SensorSettings,
    Path(__file__).with_name("sensors.toml"),
    what="sensors",
    names=SENSOR_SETS,
    default="ideal",
)
"""Loads a sensor set: `ideal`, `noisy`, or a file with `base` naming one of them and one table of
changes; channels are merged number by number."""
