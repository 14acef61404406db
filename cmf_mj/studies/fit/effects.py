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
from cmf_mj.plant.hexapod import Floor, Hexapod, on_floor, on_mounts
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.fit.engine import Fitter, Look
from cmf_mj.studies.fit.likelihood import information
from cmf_mj.studies.fit.model import Residuals, minus
from cmf_mj.studies.fit.results import nominal

Array = NDArray[np.float64]

Change = Callable[[Plant, Array], Plant]
"""A machine with so much of an effect, in sizes (1,), or (legs,) where each leg has its own."""

_LEGS, _FLOOR = 0.25, 0.2
_FLOORS = np.geomspace(8.0, 32.0, 7)  #: With the machine on it, its legs rigid [Hz].
_HELPS = 10.0  #: Gain of -ln L from which an effect is said to help.


class Extra(NamedTuple):
    """A number that a machine may have beside those that are fitted."""

    path: str
    unit: str
    size: float  #: What is tried, in `unit`.
    signed: bool = False  #: Whether it may go either way.

    def on(self, sheet: Plant, legs: Sequence[str]) -> list[Change]:
        """The change to be tried, the data sheet's machine given."""
        before = np.array([nominal(sheet, self.path.replace("*", leg)) for leg in legs])
        said = {"path": self.path, "unit": self.unit, "effect": "value", "low": -1.0, "high": 1.0}
        alone = Unknowns(extra=validated(Unknown, said | {"source": "tried"}, self.path))
        size = self._size(sheet, before)

        def made(machine: Plant, added: Array) -> Plant:
            value = (before + added * size) / units.factor(self.unit)
            return alone.apply({"extra": value if "*" in self.path else float(value[0])}, machine)

        return [made]

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
    """A compliance that a hexapod may have."""

    changes: Callable[[Plant], list[Change]]  #: What gives a machine so much of it.
    path: str = ""
    signed: bool = False

    def on(self, sheet: Plant, legs: Sequence[str]) -> list[Change]:
        """The changes to be tried, the data sheet's machine given."""
        return self.changes(sheet)


def _legs(sheet: Plant) -> list[Change]:
    """Legs that yield; one size is `_LEGS` of the compliance of their oil at neutral."""
    hydraulics = sheet.hydraulics
    oil = stiffness(hydraulics.cylinder, hydraulics.oil.bulk_modulus, np.zeros(sheet.legs))
    stiff = float(oil.mean()) / _LEGS
    return [lambda machine, added: on_mounts(machine, stiff / float(added[0]))]


def _floors(sheet: Plant) -> list[Change]:
    """Floors that yield; at each frequency of `_FLOORS` the number is the inverse of their mass.

    A floor of mass m alone answers a force with 1 / m over what its frequency says, so that at one
    frequency it is nearly linear in 1 / m; one size makes it the machine's over `_FLOOR`.
    """

    def at(hertz: float) -> Change:
        def made(machine: Plant, added: Array) -> Plant:
            whole = float(machine.model.body_mass.sum())
            mass = whole / (_FLOOR * float(added[0]))
            return on_floor(machine, Floor(mass, (mass + whole) * (2.0 * np.pi * hertz) ** 2))

        return made

    return [at(float(hertz)) for hertz in _FLOORS]


EFFECTS: dict[str, Extra | Yielding] = {
    "valve overlap": Extra("hydraulics.overlap", "1", 0.01),
    "valve hysteresis": Extra("hydraulics.hysteresis", "1", 0.01),
    "unequal null bias": Extra("hydraulics.actuators.*.null_bias", "1", 0.005, signed=True),
    "viscous friction": Extra("hydraulics.viscous_friction", "N s/m", 0.05),
    "Coulomb friction": Extra("hydraulics.friction", "N", 0.02),
    "entrained gas": Extra("hydraulics.entrained_gas", "1", 0.002),
    "resistance of the supply hoses": Extra("hydraulics.supply_hose", "Pa s/m^3", 1.0),
    "a floor that yields": Yielding(_floors),
    "legs that yield": Yielding(_legs),
}
"""What a machine may have beside its numbers; of friction over a leg's static load and, viscous,
per full speed, of hoses over what there is."""


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


class _Step(NamedTuple):
    """A step of all numbers together with those of an effect."""

    change: Change
    promise: float  #: Of gain, if all were linear.
    move: Array  #: Of the numbers, (n,).
    added: Array  #: Of the effect's.


def _gain(look: Look, fitter: Fitter, extra: Extra | Yielding) -> tuple[float, Array]:
    """Gain by one step of all numbers together with those of an effect, and the numbers' part."""
    legs = fitter.model.unknowns.legs if "*" in extra.path else ("",)

    def there_at(point: tuple[Change, Array, Array]) -> Residuals | None:
        change, x, added = point
        try:
            machine = change(fitter.model.machine(x[: fitter.size]), added)
            known = fitter.model.values(x[: fitter.size])
            return fitter.model.residuals_of(machine, known, fitter.clocks_of(x))
        except (InputError, RunError):
            return None

    def all_(points: Sequence[tuple[Change, Array, Array]]) -> list[Residuals | None]:
        with ThreadPoolExecutor(fitter.jobs) as pool:
            return list(pool.map(there_at, points))

    steps = []
    for change in extra.on(fitter.model.plant, legs):
        there = [one for one in all_([(change, look.x, one) for one in np.eye(len(legs))]) if one]
        if len(there) == len(legs):
            step = _step(look, fitter, change, there)
            if extra.signed or step.added[0] > 0.0:
                steps.append(step)
    if not steps:
        return 0.0, np.zeros(fitter.size)
    best, parts = max(steps, key=lambda one: one.promise), (1.0, 0.5, 0.25)
    points = [(best.change, look.x + part * best.move, part * best.added) for part in parts]
    merits = [
        fitter.merit(x, residuals) + 0.5 * float(added @ added)
        for (_, x, added), residuals in zip(points, all_(points), strict=True)
    ]
    least = int(np.argmin(merits))
    gain = max(0.0, float(look.merit - merits[least]))
    return gain, (gain > 0.0) * parts[least] * best.move[: fitter.size]


def _step(look: Look, fitter: Fitter, change: Change, there: Sequence[Residuals]) -> _Step:
    """The step of Gauss and Newton, from what one size of each of an effect's numbers does."""
    slopes = [*look.slopes, *(minus(one, look.here) for one in there)]
    found = information(look.here, slopes, fitter.order, fitter.spacing)
    gradient = found.gradient - np.concatenate([look.x, np.zeros(len(there))])
    step = np.linalg.solve(found.matrix + np.eye(gradient.size), gradient)
    size = look.x.size
    return _Step(change, 0.5 * float(gradient @ step), step[:size], step[size:])
