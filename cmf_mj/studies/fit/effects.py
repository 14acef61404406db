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
from cmf_mj.studies.fit.iteration import WIDTH, Fitter, Linearised, improved
from cmf_mj.studies.fit.model import Change, minus

Array = NDArray[np.float64]

_LEGS, _FLOOR = 0.25, 0.2
_FLOORS = np.geomspace(8.0, 32.0, 7)  #: With the machine on it, its legs rigid [Hz].
_AGAIN = 4  #: Most steps of a fit with an effect.
_HELPS = 10.0  #: Gain of -ln L from which an effect is said to help.


class Extra(NamedTuple):
    """What a machine may have beside the numbers that are fitted."""

    on: Callable[[Plant, Sequence[str]], list[Change]]
    """The changes to be tried, by the data sheet's machine and its legs."""
    path: str = ""  #: Of a number; what has none yields, of hexapods alone.
    signed: bool = False  #: Whether it may go either way.


def _number(path: str, unit: str, size: Callable[[Plant], float], signed: bool = False) -> Extra:
    """A number by its path, with the size that is tried; its unit is of SI."""
    said = {"path": path, "unit": unit, "effect": "value", "low": -1.0, "high": 1.0}
    alone = Unknowns(extra=validated(Unknown, said | {"source": "tried"}, path))

    def on(sheet: Plant, legs: Sequence[str]) -> list[Change]:
        before = np.array([nominal(path.replace("*", leg), sheet)[0] for leg in legs])
        step = size(sheet)

        def made(machine: Plant, added: Array) -> Plant:
            value = before + added * step
            return alone.apply({"extra": value if "*" in path else float(value[0])}, machine)

        return [made]

    return Extra(on, path, signed)


def _load(sheet: Plant, share: float) -> float:
    """A share of a leg's static load [N]."""
    cab = sheet.cab_parameters
    return share * ((cab.payload.mass if cab else 0.0) * STANDARD_GRAVITY / sheet.legs)


def _legs(sheet: Plant, _: Sequence[str]) -> list[Change]:
    """Legs that yield; one size is `_LEGS` of the compliance of their oil at neutral."""
    hydraulics = sheet.hydraulics
    oil = stiffness(hydraulics.cylinder, hydraulics.oil.bulk_modulus, np.zeros(sheet.legs))
    stiff = float(oil.mean()) / _LEGS
    return [lambda machine, added: on_mounts(machine, stiff / float(added[0]))]


def _floors(sheet: Plant, _: Sequence[str]) -> list[Change]:
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


EFFECTS = {
    "valve overlap": _number("hydraulics.overlap", "1", lambda _: 0.01),
    "valve hysteresis": _number("hydraulics.hysteresis", "1", lambda _: 0.01),
    "unequal null bias": _number("hydraulics.actuators.*.null_bias", "1", lambda _: 0.005, True),
    "viscous friction": _number(
        *("hydraulics.viscous_friction", "N s/m"),
        lambda sheet: _load(sheet, 0.05) / (100.0 * sheet.parameters.leg_speed.si),
    ),
    "Coulomb friction": _number("hydraulics.friction", "N", lambda sheet: _load(sheet, 0.02)),
    "entrained gas": _number("hydraulics.entrained_gas", "1", lambda _: 0.002),
    "resistance of the supply hoses": _number(
        *("hydraulics.supply_hose", "Pa s/m^3"), lambda sheet: sheet.parameters.supply_hose.si
    ),
    "a floor that yields": Extra(_floors),
    "legs that yield": Extra(_legs),
}
"""What a machine may have beside its numbers; of friction over a leg's static load and, viscous,
per full speed, of hoses over what there is."""


class Effect(NamedTuple):
    """An effect that was tried."""

    name: Annotated[str, Field(title="effect")]
    gain: Annotated[float, Field(title="gain of -ln L", form=".1f")]
    shift: Array  #: What the coordinates of the numbers are with it, less those without, (n,).

    @property
    def helps(self) -> bool:
        """Whether it explains more than chance."""
        return self.gain > _HELPS


class _Point(NamedTuple):
    """Numbers with those of an effect."""

    fitter: Fitter
    x: Array  #: Of the numbers and the effect.
    cost: float


def tried(end: Linearised, fitter: Fitter) -> list[Effect]:
    """Gain of each effect that is no unknown yet, the largest first, from the `end` of the fit."""
    there = {one.path for one in fitter.model.unknowns.values()}
    points = {
        name: _best(end, fitter, extra)
        for name, extra in EFFECTS.items()
        if extra.path not in there and (extra.path or isinstance(fitter.model.plant, Hexapod))
    }
    if points:
        most = min(points, key=lambda name: points[name].cost)
        if end.cost - points[most].cost > _HELPS:
            points[most] = _fitted(points[most])
    mine = slice(fitter.model.size)
    found = [
        Effect(name, end.cost - one.cost, one.x[mine] - end.x[mine]) for name, one in points.items()
    ]
    return sorted(found, key=lambda effect: -effect.gain)


def _best(end: Linearised, fitter: Fitter, extra: Extra) -> _Point:
    """The best of what is tried with an effect, and else none of it, where the fit ended."""
    legs = fitter.model.unknowns.legs if "*" in extra.path else ("",)
    size = fitter.model.size
    none = np.insert(end.x, size, np.zeros(len(legs)))
    best, most = _Point(fitter, none, end.cost), 0.0
    for change in extra.on(fitter.model.plant, legs):
        with_ = fitter.having(change if extra.signed else partial(_some, change))
        points = [np.insert(end.x, size, one) for one in np.eye(len(legs))]
        there = [one for one in with_.all(points) if one is not None]
        if len(there) < len(legs):
            continue
        derivatives = [*end.derivatives[:size], *(minus(one, end.residuals) for one in there)]
        derivatives += end.derivatives[size:]
        whole = with_.linearised(none, end.residuals, derivatives)
        points, costs = points[:1], [with_.cost(points[0], there[0])]
        move = np.linalg.solve(whole.hessian, whole.gradient)
        if whole.predicted_gain > most and (extra.signed or move[size] > 0.0):
            most = whole.predicted_gain
            points += [none + part * move for part in (1.0, 0.5, 0.25)]
            costs += map(with_.cost, points[1:], with_.all(points[1:]))
        least = int(np.argmin(costs))
        if costs[least] < best.cost:
            best = _Point(with_, points[least], costs[least])
    return best


def _some(change: Change, machine: Plant, added: Array) -> Plant:
    """A machine with an effect that it has or has not: less than nothing of it is refused."""
    if added[0] <= 0.0:
        raise InputError(f"effect: {added[0]:g} of it is refused; allowed: more than 0")
    return change(machine, added)


def _fitted(point: _Point) -> _Point:
    """The numbers fitted again with an effect, from the best there is or what is weighed."""
    fitter, x, model = point.fitter, point.x, point.fitter.model
    starts = [x]
    for amount in (1.0, 2.0):
        starts.append(np.full(x.size, amount))
        starts[-1][: model.size] = model.weighed()
        starts[-1][x.size - model.clocks :] = x[x.size - model.clocks :]
    costs = [point.cost, *map(fitter.cost, starts[1:], fitter.all(starts[1:]))]
    x, width = starts[int(np.argmin(costs))], np.full(x.size, WIDTH[1])
    for _ in range(_AGAIN):
        row = improved(fitter, x, width)
        x, width = np.array(row["x"]), np.array(row["width"])
        if row["done"]:
            break
    return _Point(fitter, x, row["merit"])
