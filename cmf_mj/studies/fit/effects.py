"""Effects that a machine may have beside the numbers that are fitted, each tried.

Of each effect one more number, or one of each leg, is fitted together with all others by a step
from where the fit ended; its prior is normal, of the deviation 1 in sizes of `EFFECTS`. The gain of
-ln L says whether it would help.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.result import Field
from cmf_mj.core.settings import validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hexapod import Hexapod, on_floor, on_mounts
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.fit.engine import Fitter, Look
from cmf_mj.studies.fit.likelihood import information
from cmf_mj.studies.fit.model import Residuals, minus
from cmf_mj.studies.fit.results import nominal

Array = NDArray[np.float64]

_HELPS = 10.0  #: Gain of -ln L from which an effect is said to help.


class Extra(NamedTuple):
    """A number that a machine may have beside those that are fitted."""

    path: str
    unit: str
    size: float  #: What is tried, in `unit`.
    signed: bool = False  #: Whether it may go either way.

    def on(self, sheet: Plant, legs: Sequence[str]) -> Callable[[Plant, Array], Plant]:
        """What gives a machine so much of it, in sizes (1,) or (legs,), the data sheet's given."""
        before = np.array([nominal(sheet, self.path.replace("*", leg)) for leg in legs])
        said = {"path": self.path, "unit": self.unit, "effect": "value", "low": -1.0, "high": 1.0}
        alone = Unknowns(extra=validated(Unknown, said | {"source": "tried"}, self.path))
        size = self._size(sheet, before)

        def made(machine: Plant, added: Array) -> Plant:
            value = (before + added * size) / units.factor(self.unit)
            return alone.apply({"extra": value if "*" in self.path else float(value[0])}, machine)

        return made

    def _size(self, sheet: Plant, before: Array) -> float:
        """What is tried, in SI."""
        size = float(units.to_si(self.unit, self.size))
        cab = sheet.cab_parameters
        force = (cab.payload.mass if cab else 0.0) * STANDARD_GRAVITY / sheet.legs
        match self.path.split(".")[-1]:
            case "friction":
                return size * force
            case "viscous_friction":
                return size * force / (100.0 * sheet.parameters.leg_speed.si)
            case "supply_hose":
                return size * float(before[0])
        return size


class Yielding(NamedTuple):
    """A spring that a hexapod may stand or push on, whose compliance is the number."""

    yields: Callable[[Plant, float], Plant]  #: The machine with one of a stiffness [N/m].
    size: float  #: Stiffness that is tried, over that of a leg's oil at neutral.
    path: str = ""
    signed: bool = False

    def on(self, sheet: Plant, legs: Sequence[str]) -> Callable[[Plant, Array], Plant]:
        """What gives a machine so much of it, as `Extra.on`."""
        hydraulics = sheet.hydraulics
        oil = stiffness(hydraulics.cylinder, hydraulics.oil.bulk_modulus, np.zeros(sheet.legs))
        tried_ = self.size * float(oil.mean())
        return lambda machine, added: self.yields(machine, tried_ / float(added[0]))


EFFECTS: dict[str, Extra | Yielding] = {
    "valve overlap": Extra("hydraulics.overlap", "1", 0.01),
    "valve hysteresis": Extra("hydraulics.hysteresis", "1", 0.01),
    "unequal null bias": Extra("hydraulics.actuators.*.null_bias", "1", 0.005, signed=True),
    "viscous friction": Extra("hydraulics.viscous_friction", "N s/m", 0.05),
    "Coulomb friction": Extra("hydraulics.friction", "N", 0.02),
    "entrained gas": Extra("hydraulics.entrained_gas", "1", 0.002),
    "resistance of the supply hoses": Extra("hydraulics.supply_hose", "Pa s/m^3", 1.0),
    "a floor that yields": Yielding(on_floor, 6.0),
    "legs that yield": Yielding(on_mounts, 4.0),
}
"""What a machine may have beside its numbers; of friction over a leg's static load and, viscous,
per full speed, of hoses over what there is, of what yields in series with the oil of all legs."""


class Effect(NamedTuple):
    """An effect that was tried."""

    name: Annotated[str, Field(title="effect")]
    gain: Annotated[float, Field(title="gain of -ln L", form=".1f")]  #: By one step with it.
    shift: Array  #: What that step adds to the coordinates of the numbers, (n,).

    @property
    def helps(self) -> bool:
        """Whether it explains more than chance."""
        return self.gain > _HELPS


def tried(look: Look, fitter: Fitter) -> list[Effect]:
    """Gain of each effect that is no unknown yet, the largest first."""
    there = {one.path for one in fitter.model.unknowns.values()}
    found = [
        Effect(name, *_gain(look, fitter, extra))
        for name, extra in EFFECTS.items()
        if extra.path not in there
        and (isinstance(extra, Extra) or isinstance(fitter.model.plant, Hexapod))
    ]
    return sorted(found, key=lambda effect: -effect.gain)


def _gain(look: Look, fitter: Fitter, extra: Extra | Yielding) -> tuple[float, Array]:
    """Gain by one step of all numbers together with those of an effect, and the numbers' part."""
    none = 0.0, np.zeros(fitter.size)
    legs = fitter.model.unknowns.legs if "*" in extra.path else ("",)
    changed = extra.on(fitter.model.plant, legs)

    def there_at(point: tuple[Array, Array]) -> Residuals | None:
        x, added = point
        try:
            machine = changed(fitter.model.machine(x[: fitter.size]), added)
            known = fitter.model.values(x[: fitter.size])
            return fitter.model.residuals_of(machine, known, fitter.clocks_of(x))
        except (InputError, RunError):
            return None

    def all_(points: Sequence[tuple[Array, Array]]) -> list[Residuals | None]:
        with ThreadPoolExecutor(fitter.jobs) as pool:
            return list(pool.map(there_at, points))

    there = all_([(look.x, one) for one in np.eye(len(legs))])
    if any(one is None for one in there):
        return none
    slopes = [*look.slopes, *(minus(one, look.here) for one in there if one is not None)]
    found = information(look.here, slopes, fitter.order, fitter.spacing)
    point = np.concatenate([look.x, np.zeros(len(legs))])
    step = np.linalg.solve(found.matrix + np.eye(point.size), found.gradient - point)
    move, added = step[: look.x.size], step[look.x.size :]
    if not extra.signed and added[0] <= 0.0:
        return none
    parts = (1.0, 0.5, 0.25)
    points = [(look.x + part * move, part * added) for part in parts]
    merits = [
        fitter.merit(x, residuals) + 0.5 * float(more @ more)
        for (x, more), residuals in zip(points, all_(points), strict=True)
    ]
    best = int(np.argmin(merits))
    gain = float(look.merit - merits[best])
    return (gain, parts[best] * move[: fitter.size]) if gain > 0.0 else none
