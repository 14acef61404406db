"""Mismatch: actuators that differ from one another as bought and adjusted parts do.

A spread says how a number scatters from actuator to actuator, or from valve to valve. With s its
deviation, u uniform and z normal cut off at `LIMIT` deviations,

    normal       x = s z          uniform  x = s u, -1 < u < 1          lognormal  1 + x = exp(s z)

    factor       value (1 + x)                        offset   value + x

Every number has one random stream for each draw, keyed by seed, draw and name: laws and
cabs meet the same machines, so that differences between them are paired, and a spread added later
leaves the others as they were.
"""

import zlib
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import stats

from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.settings import Settings, validated
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.electronics.sensors.channel import CHANNELS, SensorSettings, load_sensors
from cmf_mj.machine.cab import Cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import (
    ACTUATOR_FIELDS,
    VALVE_FIELDS,
    VALVES,
    ActuatorChanges,
    HydraulicParameters,
)

LIMIT = 2.0
"""Deviations at which a normal distribution is cut off: parts beyond tolerance are sent back."""

VALVE_GAINS, MASSES, OIL = 0.1, 0.1, 0.2
"""Half widths of the distributions of `valve_gains` and `drawn_machine`, over the nominal."""

LEG_CHANNELS = tuple(n for n, u in CHANNELS.items() if not n.startswith("platform_"))
"""Sensors whose gain may scatter."""


class Spread(Settings):
    """Scatter of one number."""

    distribution: Literal["normal", "uniform", "lognormal"]
    effect: Literal["factor", "offset"] = "factor"
    per: Literal["actuator", "valve"] = "actuator"
    deviation: Annotated[float, Field(gt=0.0, lt=100.0)]
    """Standard deviation before it is cut off, half width of a uniform one, that of the logarithm
    [%]; for an offset of full scale."""
    status: Literal["stated", "derived", "calibrated", "assumed"]  #: How it is known.
    source: Annotated[str, Field(min_length=1)]  #: Where it comes from, or why it was chosen.

    def sample(self, generator: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """X of some parts."""
        size = 0.01 * self.deviation
        if self.distribution == "uniform":
            return generator.uniform(-size, size, shape)
        normal = stats.truncnorm.rvs(-LIMIT, LIMIT, size=shape, random_state=generator)
        return size * normal if self.distribution == "normal" else np.expm1(size * normal)


class Mismatch(Settings):
    """All that scatters in a study."""

    hydraulics: dict[str, Spread] = {}  #: By field of a hydraulic set.
    sensor_gains: dict[str, Spread] = {}  #: By channel of the sensors.

    def check(self) -> None:
        """Refuse names that cannot scatter."""
        for name, spread in self.hydraulics.items():
            allowed = VALVE_FIELDS if spread.per == "valve" else ACTUATOR_FIELDS
            if name not in allowed:
                raise InputError(
                    f"mismatch.hydraulics: {name!r} cannot differ from {spread.per} to "
                    f"{spread.per}; allowed: {', '.join(allowed)}"
                )
            if spread.effect == "offset" and name != "null_bias":
                raise InputError(f"mismatch.hydraulics.{name}: effect must be factor")
        for name, spread in self.sensor_gains.items():
            check_name("mismatch.sensor_gains", name, LEG_CHANNELS)
            if spread.per != "actuator" or spread.effect != "factor":
                raise InputError(f"mismatch.sensor_gains.{name}: must be a factor per actuator")

    def draw_hydraulics(
        self, base: HydraulicParameters, actuators: tuple[str, ...], seed: int, draw: int
    ) -> HydraulicParameters:
        """A set whose actuators differ.

        The set's actuators scatter about `base`, by `seed` of the study and number `draw` of the
        machine.
        """
        nominal = base.quantities()
        changes: dict[str, dict[str, object]] = {name: {} for name in actuators}
        for field, spread in self.hydraulics.items():
            valves = VALVES if spread.per == "valve" else ("",)
            sample = spread.sample(_stream(seed, draw, field), (len(actuators), len(valves)))
            for name, row in zip(actuators, sample, strict=True):
                for valve, x in zip(valves, row, strict=True):
                    table = changes[name].setdefault(valve, {}) if valve else changes[name]
                    table[field] = _changed(nominal[field], spread, float(x), draw)  # type: ignore[index]
        table = base.model_dump(exclude_none=True) | {"actuators": changes}
        return validated(HydraulicParameters, table, f"draw {draw} of {base.name}")

    def draw_gain_errors(self, legs: int, seed: int, draw: int) -> dict[str, NDArray[np.float64]]:
        """Gain errors of the sensors, (n,) by channel."""
        return {
            name: spread.sample(_stream(seed, draw, name), (legs,))
            for name, spread in self.sensor_gains.items()
        }


def valve_gains(seed: int | None) -> NDArray[np.float64]:
    """Valve gains of six actuators over the nominal, uniform within `VALVE_GAINS`; 1 for None."""
    if seed is None:
        return np.ones(6)
    return 1.0 + VALVE_GAINS * np.random.default_rng(seed).uniform(-1.0, 1.0, 6)


def with_valve_gains(parameters: HydraulicParameters, seed: int | None) -> HydraulicParameters:
    """A hydraulic set whose legs 1 to 6 have the speeds of `valve_gains`; for None itself."""
    if seed is None:
        return parameters
    speed = parameters.leg_speed
    changes = {
        f"leg_{leg}": ActuatorChanges.model_validate(
            {"leg_speed": speed.model_copy(update={"value": speed.value * float(gain)})}
        )
        for leg, gain in enumerate(valve_gains(seed), start=1)
    }
    name = f"{parameters.name}, gains {seed}"
    return parameters.model_copy(update={"name": name, "actuators": changes})


def drawn_machine(cab: Cab, hydraulics: HydraulicParameters, seed: int, draw: int) -> Hexapod:
    """A cab on a hydraulic set that differs from the one that laws take it for.

    Uniform and independent: cab, platform and legs by `MASSES`, the bulk modulus by `OIL`, the six
    `valve_gains`.
    """
    generator = np.random.default_rng([seed, draw])
    mass, platform, legs = 1.0 + MASSES * generator.uniform(-1.0, 1.0, 3)
    oil = hydraulics.bulk_modulus
    value = oil.value * (1.0 + OIL * generator.uniform(-1.0, 1.0))
    changed = {"bulk_modulus": oil.model_copy(update={"value": value})}
    heavier = cab.changed(
        f"{cab.name}_{draw}",
        mass=mass * cab.mass.si,
        platform={"mass": platform * cab.platform.mass.si},
        leg_mass=legs,
        nominal=cab,
    )
    gains = int(generator.integers(2**32))
    return Hexapod(heavier, with_valve_gains(hydraulics.model_copy(update=changed), gains))


def with_gain_errors(errors: dict[str, NDArray[np.float64]]) -> ElectronicsSettings | None:
    """Ideal sensors but for their gains, without converters; None where there are no errors."""
    if not errors:
        return None
    table = load_sensors("ideal").model_dump(exclude_none=True)
    for name, values in errors.items():
        known = {"unit": "1", "status": "assumed", "source": "drawn"}
        table[name] = {"gain_errors": [{"value": float(error), **known} for error in values]}
    sensors = validated(SensorSettings, table | {"name": "mismatched"}, "mismatched")
    return ElectronicsSettings(sensors=sensors, converters="off")


def _stream(seed: int, draw: int, name: str) -> np.random.Generator:
    key = (draw, zlib.crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _changed(nominal: Quantity, spread: Spread, x: float, draw: int) -> dict[str, object]:
    known = {"status": spread.status, "source": f"draw {draw}"}
    if spread.effect == "offset":
        return {"value": 100.0 * x, "unit": "%", **known}
    return nominal.model_dump() | {"value": nominal.value * (1.0 + x), **known}
