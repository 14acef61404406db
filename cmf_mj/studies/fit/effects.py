"""Effects that a machine may have beside the numbers that are fitted, each tried.

Of each effect one more number, or one of each leg, has a normal prior of the deviation 1 in sizes
of `EFFECTS`. The gain of -ln L, by one size of it or by a step of all numbers with it from where
the fit ended, says whether it would help. Numbers fitted without an effect may be far from those
with it: of the one that gains most all are fitted again.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Field
from cmf_mj.core.settings import validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.facility.unknown import Unknown, nominal
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.yielding import Floor, on_floor, on_mounts
from cmf_mj.studies.fit.iteration import LARGEST_WIDTH, Fitter, Linearised, improve
from cmf_mj.studies.fit.model import Change, difference

Array = NDArray[np.float64]

_LEG_SHARE = 0.25  #: Compliance of legs that yield, over that of their oil.
_FLOOR_SHARE = 0.2  #: Mass of the machine over that of a floor that yields.
_FLOOR_FREQUENCIES = np.geomspace(8.0, 32.0, 7)  #: With the machine on it, its legs rigid [Hz].
_REFIT_STEPS = 4  #: Most steps of a fit with an effect.
_HELPS = 10.0  #: Gain of -ln L from which an effect is said to help.


class Candidate(NamedTuple):
    """An effect that a machine may have beside the numbers that are fitted."""

    changes: Callable[[Plant, Sequence[str]], list[Change]]
    """The changes to be tried, by the data sheet's plant and its legs."""
    path: str = ""  #: Of a number; an effect without one is a part that yields, of hexapods alone.
    is_signed: bool = False  #: Whether it may go either way.


def _by_path(
    path: str, unit: str, size: Callable[[Plant], float], is_signed: bool = False
) -> Candidate:
    """The candidate of a number by its path, in SI, with the `size` that is tried."""
    table = {"path": path, "unit": unit, "effect": "value", "low": -1.0, "high": 1.0}
    unknowns = Unknowns(extra=validated(Unknown, table | {"source": "tried"}, path))

    def changes(sheet: Plant, legs: Sequence[str]) -> list[Change]:
        before = np.array([nominal(path.replace("*", leg), sheet)[0] for leg in legs])
        step = size(sheet)

        def change(machine: Plant, amount: Array) -> Plant:
            value = before + amount * step
            return unknowns.apply({"extra": value if "*" in path else float(value[0])}, machine)

        return [change]

    return Candidate(changes, path, is_signed)


def _static_load(sheet: Plant) -> float:
    """Load of a leg at rest [N]."""
    cab = sheet.cab_parameters
    return (cab.payload.mass if cab else 0.0) * STANDARD_GRAVITY / sheet.legs


def _viscous_friction(sheet: Plant) -> float:
    """A share of the static load at full speed [N s/m]."""
    return 0.05 * _static_load(sheet) / (100.0 * sheet.parameters.leg_speed.si)


def _yielding_legs(sheet: Plant, _: Sequence[str]) -> list[Change]:
    """Legs that yield; one size is `_LEG_SHARE` of the compliance of their oil at neutral."""
    hydraulics = sheet.hydraulics
    oil = stiffness(hydraulics.cylinder, hydraulics.oil.bulk_modulus, np.zeros(sheet.legs))
    mount = float(oil.mean()) / _LEG_SHARE
    return [lambda machine, amount: on_mounts(machine, mount / float(amount[0]))]


def _yielding_floors(sheet: Plant, _: Sequence[str]) -> list[Change]:
    """Floors that yield; at each of `_FLOOR_FREQUENCIES` the number is the inverse of their mass.

    A floor of mass m alone answers a force with 1 / m over what its frequency says, so that at one
    frequency it is nearly linear in 1 / m; one size makes it the machine's over `_FLOOR_SHARE`.
    """

    def on_floor_of(frequency: float, machine: Plant, amount: Array) -> Plant:
        whole = float(machine.model.body_mass.sum())
        mass = whole / (_FLOOR_SHARE * float(amount[0]))
        return on_floor(machine, Floor(mass, (mass + whole) * (2.0 * np.pi * frequency) ** 2))

    return [partial(on_floor_of, float(frequency)) for frequency in _FLOOR_FREQUENCIES]


EFFECTS = {
    "valve overlap": _by_path("hydraulics.overlap", "1", lambda _: 0.01),
    "valve hysteresis": _by_path("hydraulics.hysteresis", "1", lambda _: 0.01),
    "unequal null bias": _by_path("hydraulics.actuators.*.null_bias", "1", lambda _: 0.005, True),
    "viscous friction": _by_path("hydraulics.viscous_friction", "N s/m", _viscous_friction),
    "Coulomb friction": _by_path("hydraulics.friction", "N", lambda s: 0.02 * _static_load(s)),
    "entrained gas": _by_path("hydraulics.entrained_gas", "1", lambda _: 0.002),
    "resistance of the supply hoses": _by_path(
        "hydraulics.supply_hose", "Pa s/m^3", lambda sheet: sheet.parameters.supply_hose.si
    ),
    "a floor that yields": Candidate(_yielding_floors),
    "legs that yield": Candidate(_yielding_legs),
}
"""What a machine may have beside its numbers, with the size that is tried: of Coulomb friction a
share of a leg's static load, of viscous friction one per full speed, of hoses what there is."""


class Effect(NamedTuple):
    """An effect that was tried."""

    name: Annotated[str, Field(title="effect")]
    gain: Annotated[float, Field(title="gain of -ln L", form=".1f")]
    shift: Array  #: Coordinates of the numbers with it, less those without, (n,).

    @property
    def helps(self) -> bool:
        """Whether it explains more than chance."""
        return self.gain > _HELPS


class _Point(NamedTuple):
    """Numbers with those of an effect."""

    fitter: Fitter
    x: Array  #: Of the numbers and the effect.
    cost: float


def try_effects(end: Linearised, fitter: Fitter) -> list[Effect]:
    """Gain of each effect that is no unknown yet, the largest first, from the `end` of the fit."""
    unknown_paths = {unknown.path for unknown in fitter.model.unknowns.values()}
    is_hexapod = isinstance(fitter.model.plant, Hexapod)
    points = {
        name: _best_point(end, fitter, candidate)
        for name, candidate in EFFECTS.items()
        if candidate.path not in unknown_paths and (candidate.path or is_hexapod)
    }
    if points:
        best = min(points, key=lambda name: points[name].cost)
        if end.cost - points[best].cost > _HELPS:
            points[best] = _refit(points[best])
    numbers = slice(fitter.model.size)
    effects = [
        Effect(name, end.cost - point.cost, point.x[numbers] - end.x[numbers])
        for name, point in points.items()
    ]
    return sorted(effects, key=lambda effect: -effect.gain)


def _best_point(end: Linearised, fitter: Fitter, candidate: Candidate) -> _Point:
    """The best point with an effect, or without it where the fit ended."""
    legs = fitter.model.unknowns.legs if "*" in candidate.path else ("",)
    size = fitter.model.size
    without_effect = np.insert(end.x, size, np.zeros(len(legs)))
    best, largest_gain = _Point(fitter, without_effect, end.cost), 0.0
    for change in candidate.changes(fitter.model.plant, legs):
        fitter_with = fitter.with_effect(
            change if candidate.is_signed else partial(_positive_effect, change)
        )
        unit_points = [np.insert(end.x, size, unit) for unit in np.eye(len(legs))]
        residuals = [each for each in fitter_with.residuals_at(unit_points) if each is not None]
        if len(residuals) < len(legs):
            continue
        by_effect = [difference(each, end.residuals) for each in residuals]
        derivatives = [*end.derivatives[:size], *by_effect, *end.derivatives[size:]]
        linearised = fitter_with.linearised(without_effect, end.residuals, derivatives)
        points, costs = unit_points[:1], [fitter_with.cost(unit_points[0], residuals[0])]
        move = np.linalg.solve(linearised.hessian, linearised.gradient)
        gain = linearised.predicted_gain
        if gain > largest_gain and (candidate.is_signed or move[size] > 0.0):
            largest_gain = gain
            moved = [without_effect + part * move for part in (1.0, 0.5, 0.25)]
            points += moved
            costs += map(fitter_with.cost, moved, fitter_with.residuals_at(moved))
        least = int(np.argmin(costs))
        if costs[least] < best.cost:
            best = _Point(fitter_with, points[least], costs[least])
    return best


def _positive_effect(change: Change, machine: Plant, amount: Array) -> Plant:
    """A machine with an effect that it has or has not: less than nothing of it is refused."""
    if amount[0] <= 0.0:
        raise InputError(f"effect: {amount[0]:g} of it is refused; allowed: more than 0")
    return change(machine, amount)


def _refit(point: _Point) -> _Point:
    """Fit all numbers again with an effect, from `point` or from what pressures at rest weigh."""
    fitter, x, model = point.fitter, point.x, point.fitter.model
    starts = []
    for amount in (1.0, 2.0):
        start = np.full(x.size, amount)
        start[: model.size] = model.weigh()
        start[x.size - model.clocks :] = x[x.size - model.clocks :]
        starts.append(start)
    costs = [point.cost, *map(fitter.cost, starts, fitter.residuals_at(starts))]
    x, width = [x, *starts][int(np.argmin(costs))], np.full(x.size, LARGEST_WIDTH)
    for _ in range(_REFIT_STEPS):
        row = improve(fitter, x, width)
        x, width = np.array(row["x"]), np.array(row["width"])
        if row["done"]:
            break
    return _Point(fitter, x, row["merit"])
