"""Unknowns: numbers of a machine that nobody knows exactly, by path, with what is known of each.

    path                                       the number
    hydraulics.leg_speed                       of a hydraulic set: of all actuators, oil or supply
    hydraulics.supply                          its pressure and the pressures in proportion to it
    hydraulics.friction                        Coulomb friction, and breakaway in proportion
    hydraulics.stiction                        breakaway over Coulomb friction
    hydraulics.actuators.leg_3.leg_speed       of one actuator; with * one of each
    hydraulics.actuators.*.valve_1.null_bias   of one valve; with valve_* one of each
    hydraulics.actuators.*.valve_gain          speed over the root of the supply pressure
    hydraulics.actuators.*.leakage             leak rate over the bulk modulus
    cab.mass, platform.mass, legs.mass         with the inertia, where that is no unknown too
    cab.inertia, cab.density                   the inertia alone; mass and inertia together
    cab.centre_of_mass.z                       z up; without an axis all three
    cab.second_moment.x                        integral of x^2 dm about the centre of mass, so that
                                               Ixx is that of y and z: a possible body's inertia
    payload.density                            mass and inertia of platform and cab
    law.derivative_pole                        any number of a law; machine.legs.half_stroke, any of
    electronics.leg_position.gain_errors.*     a machine; of each sensor of a channel
    model.body.torso.mass                      of a plant's MuJoCo model, with the inertia as above;
    model.joint.knee.damping                   of bodies mass and inertia, of joints damping,
    model.geom.foot.friction                   stiffness, frictionloss, armature, of geoms friction
    effect.lap                                 of `report_2014.posterior.effects`, changes no part

What is known of one is an `Unknown`. Points of the unit cube come from a sampler, `cube`, or for
each name a stream of its own, `streams`, so that an unknown added later leaves the others as they
were. Which actuators there are the plant says: `Unknowns.on(plant)`, by default the legs of a
motion base.
"""

import zlib
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict
from scipy.stats import qmc

from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.settings import Settings, read_toml, user_file, validated
from cmf_mj.electronics.sensors import SensorSettings
from cmf_mj.facility.unknown import DERIVED, LEADS, LEGS, Unknown
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.models import RigidBody
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import OF_THE_SUPPLY, VALVES, HydraulicParameters
from cmf_mj.plant.plant import Plant

Array = NDArray[np.float64]
Part = TypeVar("Part", bound=Settings | Plant)

Values = Mapping[str, Any]
"""Values of unknowns by name: numbers, or arrays where each leg or valve has its own."""

SAMPLERS = ("random", "sobol", "latin_hypercube", "corners")


def cube(sampler: str, count: int, size: int, seed: Any) -> Array:
    """Points of the unit cube, (count, size).

    Of the corners all in their order where there are no more than `count`, else random ones.

    >>> cube("corners", 4, 2, seed=0).tolist()
    [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
    """
    generator = np.random.default_rng(seed)
    match check_name("sampler", sampler, SAMPLERS):
        case "sobol":
            return np.asarray(qmc.Sobol(size, rng=generator).random(count))
        case "latin_hypercube":
            return np.asarray(qmc.LatinHypercube(size, rng=generator).random(count))
        case "corners" if count >= 2**size:
            return np.array(list(product((0.0, 1.0), repeat=size)))
        case "corners":
            return generator.choice([0.0, 1.0], (count, size))
    return generator.random((count, size))


class Unknowns(dict[str, Unknown]):
    """Unknowns by name, drawn together and applied to what a machine is made of.

    >>> gains = load_unknowns("valve_gains")
    >>> values = gains.draw("random", 1, seed=1)[0]
    >>> machine = gains.apply(values, cmf_mj.load_hydraulics("hardware"), "mine")
    >>> round(machine.actuator("leg_1")["leg_speed"].value / machine.leg_speed.value, 3)
    1.002
    """

    legs: tuple[str, ...] = LEGS
    """Names of the actuators that `*` stands for."""

    def on(self, plant: Plant) -> Self:
        """The same with the actuators of a plant."""
        made = type(self)(self)
        made.legs = plant.actuators
        return made

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the values by name."""
        return {name: one.shape(len(self.legs)) for name, one in self.items()}

    def numbers(self) -> list[tuple[str, Unknown, str]]:
        """Name, as `speed 3` of several, what is known, and path of each coordinate of a point."""
        found = []
        for name, one in self.items():
            parts = one.path.split(".")
            legs = self.legs if "*" in parts else ("*",)
            valves = VALVES if "valve_*" in parts else ("valve_*",)
            axes = (".x", ".y", ".z") if parts[-1] == "centre_of_mass" else ("",)
            for i, (leg, valve, axis) in enumerate(product(legs, valves, axes), start=1):
                path = one.path.replace("valve_*", valve).replace(".*", f".{leg}") + axis
                found.append((f"{name} {i}" if one.shape() else name, one, path))
        return found

    def split(self, points: Array) -> dict[str, Array]:
        """Coordinates of points (..., n) by name, (..., numbers of it)."""
        sizes = [int(np.prod(shape)) for shape in self.shapes().values()]
        parts = np.split(points, np.cumsum(sizes), axis=-1)
        return dict(zip(self, parts[:-1], strict=True))

    def at(self, point: Array) -> dict[str, Any]:
        """Values at a point of the unit cube, (n,)."""
        parts = self.split(point).items()
        return self.shaped({name: self[name].at(part) for name, part in parts})

    def shaped(self, parts: Mapping[str, Array]) -> dict[str, Any]:
        """Values of one machine in the shapes that `apply` takes."""
        shapes = self.shapes()
        return {k: v.reshape(shapes[k]) if shapes[k] else v.item() for k, v in parts.items()}

    def draw(self, sampler: str, count: int, seed: Any) -> list[dict[str, Any]]:
        """Values of so many machines; see `cube`."""
        return [self.at(point) for point in cube(sampler, count, len(self.numbers()), seed)]

    def streams(self, seed: int, draw: int) -> dict[str, Any]:
        """Values of a machine, each name from a stream keyed by seed, draw and name."""
        values = {}
        for name, shape in self.shapes().items():
            key = np.random.SeedSequence(seed, spawn_key=(draw, zlib.crc32(name.encode())))
            values[name] = self[name].at(np.random.default_rng(key).random(shape))
        return values

    def of(self, row: Values) -> dict[str, Any]:
        """Values that are given, such as a row of a posterior's."""
        for name in self:
            check_name("row", name, row)
        return {name: row[name] for name in self}

    def apply(self, values: Values, part: Part, name: str | None = None) -> Part:
        """A plant, cab, hydraulic set, law, machine or set of sensors with these values.

        What `values` leave out changes nothing. Laws take a changed cab for the nominal one. `name`
        is that of the new part; a plant keeps its own. Raises `InputError` for a number that the
        part cannot have.
        """
        if isinstance(part, Plant):
            return cast("Part", self.on(part)._plant(values, part))
        roots = next(roots for kind, roots in _ROOTS.items() if isinstance(part, kind))
        given = self._given(values, roots)
        if all(one.effect == "factor" and np.all(x == 1.0) for one, x in given.values()):
            return part
        match part:
            case HydraulicParameters():
                made: Any = _hydraulics(given, part, name or part.name, self.legs)
            case Cab():
                made = _cab(given, part, name or f"{part.name}_drawn")
            case _:
                made = part if name is None else part.model_copy(update={"name": name})
                for path, (one, value) in given.items():
                    made = _replaced(made, path.split(".")[1:], one, value)
        return cast("Part", made)

    def _plant(self, values: Values, plant: Plant) -> Plant:
        oil, cab = self.apply(values, plant.parameters), plant.cab_parameters
        if isinstance(plant, Hexapod) and cab is not None:
            carried = self.apply(values, cab)
            if carried is not cab:
                plant = Hexapod(carried, oil, timestep=plant.model.opt.timestep)
        given = self._given(values, ("model",))
        return plant.changed(oil, lambda model: _edit(model, given))

    def _given(self, values: Values, roots: Sequence[str]) -> "_Given":
        """What is known, and the value, of each path that begins with one of these words."""
        found = {one.path: (one, values[key]) for key, one in self.items() if key in values}
        return {path: entry for path, entry in found.items() if path.partition(".")[0] in roots}


_ROOTS: dict[type[Settings], tuple[str, ...]] = {
    Cab: ("cab", "platform", "legs", "payload"),
    HydraulicParameters: ("hydraulics",),
    Law: ("law",),
    Machine: ("machine",),
    SensorSettings: ("electronics",),
}
_Given = Mapping[str, tuple[Unknown, Any]]


def _edit(model: mujoco.MjModel, given: _Given) -> None:
    """Change the numbers of a MuJoCo model; a mass with its inertia, which may be unknown too."""
    for path, (one, value) in given.items():
        _, kind, name, field = path.split(".")
        try:
            entry = getattr(model, kind)(name)
        except KeyError as error:
            raise InputError(f"{path}: {error.args[0]}") from None
        number = getattr(entry, field)[: 1 if field == "friction" else None]
        before = number.copy()
        number[:] = one.number(before, value)
        if field == "mass" and f"model.body.{name}.inertia" not in given:
            entry.inertia[:] *= number / before


def _hydraulics(
    given: _Given, base: HydraulicParameters, name: str, legs: Sequence[str]
) -> HydraulicParameters:
    """A hydraulic set: first what all have in common, then what actuators have of their own."""
    table = base.model_dump(exclude_none=True)
    ratio = {"supply_pressure": 1.0, "bulk_modulus": 1.0}
    own = {path: entry for path, entry in given.items() if ".actuators." in path}
    _friction(given, base, table)
    for path, (one, value) in given.items():
        if path not in own and path not in _FRICTION:
            asked = path.split(".")[1]
            field = LEADS.get(asked, asked)
            before: Quantity = getattr(base, field)
            table[field] = one.changed(before, float(value))
            factor = one.effect == "factor"
            if field in ratio:
                ratio[field] = value if factor else Quantity(**table[field]).si / before.si
            for other in OF_THE_SUPPLY if asked == "supply" else ():
                table[other] |= {"value": float(table[other]["value"] * ratio[field])}
    scale = {"valve_gain": np.sqrt(ratio["supply_pressure"]), "leakage": ratio["bulk_modulus"]}
    for path, (one, value) in own.items():
        _, _, who, *valve, asked = path.split(".")
        names = legs if who == "*" else (who,)
        valves = VALVES if "valve_*" in valve else valve
        rows = np.reshape(value, (len(names), max(1, len(valves)))) * scale.get(asked, 1.0)
        field = DERIVED.get(asked, asked)
        for actuator, row in zip(names, rows, strict=True):
            changes = table["actuators"].setdefault(actuator, {})
            for which, x in zip(valves or [""], row, strict=True):
                before = base.actuator(actuator, VALVES.index(which) if which else None)[field]
                if before == getattr(base, field, None):
                    before = Quantity(**table[field])  # that all have in common, changed above
                at = changes.setdefault(which, {}) if which else changes
                at[field] = one.changed(before, float(x))
    return validated(HydraulicParameters, table | {"name": name}, f"{name} with unknowns")


_FRICTION = ("hydraulics.friction", "hydraulics.stiction")


def _friction(given: _Given, base: HydraulicParameters, table: dict[str, Any]) -> None:
    """Coulomb friction, and breakaway friction as many times it as before."""
    if not given.keys() & set(_FRICTION):
        return
    size, over = base.coulomb_friction, 1.0
    if size.si > 0.0:
        over = base.breakaway_friction.si / size.si
    if (found := given.get(_FRICTION[0])) is not None:
        size = Quantity(**found[0].changed(size, float(found[1])))
    if (found := given.get(_FRICTION[1])) is not None:
        over = max(1.0, float(found[0].number(over, found[1])))
    table["coulomb_friction"] = size.model_dump()
    table["breakaway_friction"] = size.model_dump() | {"value": size.value * over}


def _cab(given: _Given, base: Cab, name: str) -> Cab:
    cab, platform = _body("cab", base, given), _body("platform", base.platform, given)
    legs = given.get("legs.mass", _SAME)[1]
    return base.changed(name, platform=platform, leg_mass_factor=legs, nominal=base.assumed, **cab)


_SAME: tuple[Any, float] = (None, 1.0)  #: Of a factor that is not given.


def _body(name: str, part: RigidBody, given: _Given) -> dict[str, Any]:
    """What changes of a body: densities scale mass and inertia, before what else is given."""
    own = {path.removeprefix(f"{name}."): entry for path, entry in given.items()}
    changes: dict[str, Any] = {}
    dense = own.get("density", _SAME)[1] * own.get("payload.density", _SAME)[1]
    if own.keys() & {"inertia", "density", "payload.density"}:
        changes["inertia"] = dense * own.get("inertia", _SAME)[1] * part.tensor
    spread = 0.5 * np.trace(part.tensor) * np.eye(3) - part.tensor
    place = np.array(part.centre_of_mass.si)
    if "centre_of_mass" in own:
        place[:] = own["centre_of_mass"][0].number(place, own["centre_of_mass"][1])
        changes["centre_of_mass"] = place
    for axis, letter in enumerate("xyz"):
        if (found := own.get(f"centre_of_mass.{letter}")) is not None:
            place[axis] = found[0].number(place[axis], found[1])
            changes["centre_of_mass"] = place
        if (found := own.get(f"second_moment.{letter}")) is not None:
            if "inertia" in own:
                raise InputError(f"{name}.inertia: allowed: it or second moments, not both")
            spread[axis, axis] = found[0].number(spread[axis, axis], found[1])
            changes["inertia"] = dense * (np.trace(spread) * np.eye(3) - spread)
    mass = dense * part.mass.si
    if "mass" in own:
        mass = own["mass"][0].number(mass, own["mass"][1])
    if mass != part.mass.si:
        changes["mass"] = mass
    return changes


def _replaced(part: Any, path: Sequence[str], one: Unknown, value: Any) -> Any:
    """Settings with the number at a path changed."""
    name, *rest = path
    field = getattr(part, name, None)
    if rest and isinstance(field, list):
        chosen = dict(enumerate(value)) if rest == ["*"] else {int(rest[0]) - 1: value}
        exact = Quantity(value=0.0, unit="1", status="assumed", source="ideal")
        every = list(field) or [exact] * (len(chosen) if rest == ["*"] else len(LEGS))
        for index, x in chosen.items():
            every[index] = Quantity(**one.changed(every[index], float(x)))
        new: Any = every
    elif rest:
        new = _replaced(field, rest, one, value)
    elif isinstance(field, Quantity):
        new = Quantity(**one.changed(field, float(value)))
    elif isinstance(field, float):
        new = one.number(field, value) if one.effect != "value" else float(value)
    else:
        raise InputError(f"{one.path}: is not a number that is given")
    return validated(type(part), dict(part) | {name: new}, one.path)


class _File(Settings):
    """A file with unknowns, among other tables."""

    model_config = ConfigDict(extra="ignore")

    unknowns: dict[str, Unknown] = {}


@cache
def _shipped() -> dict[str, Unknowns]:
    tables = read_toml(Path(__file__).with_suffix(".toml"))
    files = {name: validated(_File, {"unknowns": table}, name) for name, table in tables.items()}
    return {name: Unknowns(file.unknowns) for name, file in files.items()}


def load_unknowns(source: str | Path) -> Unknowns:
    """Shipped ones by name, `valve_gains` or `other_machines`, or `[unknowns]` of a TOML file."""
    if str(source) in _shipped():
        return _shipped()[str(source)]
    path = user_file("unknowns", tuple(_shipped()), source)
    return Unknowns(validated(_File, read_toml(path), path.name).unknowns)


def valve_gains(seed: int | None) -> Array:
    """Valve gains of six actuators over the nominal; 1 for None."""
    if seed is None:
        return np.ones(len(LEGS))
    return np.asarray(load_unknowns("valve_gains").draw("random", 1, seed)[0]["leg_speed"])


def with_valve_gains(parameters: HydraulicParameters, seed: int | None) -> HydraulicParameters:
    """A hydraulic set whose legs 1 to 6 have the speeds of `valve_gains`; for None itself."""
    name, values = f"{parameters.name}, gains {seed}", {"leg_speed": valve_gains(seed)}
    return load_unknowns("valve_gains").apply(values, parameters, name)
