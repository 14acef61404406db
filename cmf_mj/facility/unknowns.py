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
from typing import Any, NamedTuple, Self, TypeVar, cast

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
        unknowns = type(self)(self)
        unknowns.legs = plant.actuators
        return unknowns

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the values by name."""
        return {name: unknown.shape(len(self.legs)) for name, unknown in self.items()}

    def numbers(self) -> list[tuple[str, Unknown, str]]:
        """Name, as `speed 3` of several, what is known, and path of each coordinate of a point."""
        coordinates = []
        for name, unknown in self.items():
            keys = unknown.path.split(".")
            legs = self.legs if "*" in keys else ("*",)
            valves = VALVES if "valve_*" in keys else ("valve_*",)
            axes = (".x", ".y", ".z") if keys[-1] == "centre_of_mass" else ("",)
            for number, (leg, valve, axis) in enumerate(product(legs, valves, axes), start=1):
                path = unknown.path.replace("valve_*", valve).replace(".*", f".{leg}") + axis
                title = f"{name} {number}" if unknown.shape() else name
                coordinates.append((title, unknown, path))
        return coordinates

    def split(self, points: Array) -> dict[str, Array]:
        """Coordinates of points (..., n) by name, (..., numbers of it)."""
        sizes = [int(np.prod(shape)) for shape in self.shapes().values()]
        parts = np.split(points, np.cumsum(sizes), axis=-1)
        return dict(zip(self, parts[:-1], strict=True))

    def at(self, point: Array) -> dict[str, Any]:
        """Values at a point of the unit cube, (n,)."""
        shares = self.split(point).items()
        return self.shaped({name: self[name].at(share) for name, share in shares})

    def shaped(self, parts: Mapping[str, Array]) -> dict[str, Any]:
        """Values of one machine in the shapes that `apply` takes."""
        shapes = self.shapes()
        return {n: x.reshape(shapes[n]) if shapes[n] else x.item() for n, x in parts.items()}

    def draw(self, sampler: str, count: int, seed: Any) -> list[dict[str, Any]]:
        """Values of a number of machines; see `cube`."""
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
        entries = self._entries(values, roots)
        if all(unknown.effect == "factor" and np.all(x == 1.0) for unknown, x in entries.values()):
            return part
        match part:
            case HydraulicParameters():
                changed: Any = _change_hydraulics(entries, part, name or part.name, self.legs)
            case Cab():
                changed = _change_cab(entries, part, name or f"{part.name}_drawn")
            case _:
                changed = part if name is None else part.model_copy(update={"name": name})
                for path, (unknown, value) in entries.items():
                    changed = _with_number(changed, path.split(".")[1:], unknown, value)
        return cast("Part", changed)

    def _plant(self, values: Values, plant: Plant) -> Plant:
        oil, cab = self.apply(values, plant.parameters), plant.cab_parameters
        if isinstance(plant, Hexapod) and cab is not None:
            changed_cab = self.apply(values, cab)
            if changed_cab is not cab:
                plant = Hexapod(changed_cab, oil, timestep=plant.model.opt.timestep)
        entries = self._entries(values, ("model",))
        return plant.changed(oil, lambda model: _edit_model(model, entries))

    def _entries(self, values: Values, roots: Sequence[str]) -> "_Entries":
        """Unknown and value of each path that begins with one of the roots."""
        entries = {x.path: _Entry(x, values[name]) for name, x in self.items() if name in values}
        return {path: entry for path, entry in entries.items() if path.partition(".")[0] in roots}


class _Entry(NamedTuple):
    """What is known of the number at a path, and a value of it."""

    unknown: Unknown
    value: Any


_ROOTS: dict[type[Settings], tuple[str, ...]] = {
    Cab: ("cab", "platform", "legs", "payload"),
    HydraulicParameters: ("hydraulics",),
    Law: ("law",),
    Machine: ("machine",),
    SensorSettings: ("electronics",),
}
_Entries = Mapping[str, _Entry]


def _edit_model(model: mujoco.MjModel, entries: _Entries) -> None:
    """Change the numbers of a MuJoCo model; a mass with its inertia, which may be unknown too."""
    for path, (unknown, value) in entries.items():
        _root, kind, name, field = path.split(".")
        try:
            element = getattr(model, kind)(name)
        except KeyError as error:
            raise InputError(f"{path}: {error.args[0]}") from None
        number = getattr(element, field)[: 1 if field == "friction" else None]
        nominal = number.copy()
        number[:] = unknown.number(nominal, value)
        if field == "mass" and f"model.body.{name}.inertia" not in entries:
            element.inertia[:] *= number / nominal


def _change_hydraulics(
    entries: _Entries, base: HydraulicParameters, name: str, legs: Sequence[str]
) -> HydraulicParameters:
    """A hydraulic set: first what all have in common, then what actuators have of their own."""
    table = base.model_dump(exclude_none=True)
    ratios = {"supply_pressure": 1.0, "bulk_modulus": 1.0}  # changed over nominal
    own_entries = {path: entry for path, entry in entries.items() if ".actuators." in path}
    _change_friction(entries, base, table)
    for path, (unknown, value) in entries.items():
        if path not in own_entries and path not in _FRICTION:
            name_in_path = path.split(".")[1]
            field = LEADS.get(name_in_path, name_in_path)
            nominal: Quantity = getattr(base, field)
            table[field] = unknown.changed(nominal, float(value))
            is_factor = unknown.effect == "factor"
            if field in ratios:
                ratios[field] = value if is_factor else Quantity(**table[field]).si / nominal.si
            for pressure in OF_THE_SUPPLY if name_in_path == "supply" else ():
                table[pressure] |= {"value": float(table[pressure]["value"] * ratios[field])}
    scales = {"valve_gain": np.sqrt(ratios["supply_pressure"]), "leakage": ratios["bulk_modulus"]}
    for path, (unknown, value) in own_entries.items():
        _root, _actuators, actuator, *valve, name_in_path = path.split(".")
        actuators = legs if actuator == "*" else (actuator,)
        valves = VALVES if valve == ["valve_*"] else tuple(valve) or ("",)
        values = np.reshape(value, (len(actuators), len(valves))) * scales.get(name_in_path, 1.0)
        field = DERIVED.get(name_in_path, name_in_path)
        for (own, of_valve), x in zip(product(actuators, valves), values.ravel(), strict=True):
            nominal = base.actuator(own, VALVES.index(of_valve) if of_valve else None)[field]
            if nominal == getattr(base, field, None):
                nominal = Quantity(**table[field])  # that of the set, changed above
            changes = table["actuators"].setdefault(own, {})
            changes = changes.setdefault(of_valve, {}) if of_valve else changes
            changes[field] = unknown.changed(nominal, float(x))
    return validated(HydraulicParameters, table | {"name": name}, f"{name} with unknowns")


_FRICTION = ("hydraulics.friction", "hydraulics.stiction")


def _change_friction(entries: _Entries, base: HydraulicParameters, table: dict[str, Any]) -> None:
    """Coulomb friction, and breakaway friction in the nominal or a changed ratio."""
    coulomb, stiction = map(entries.get, _FRICTION)
    if coulomb is None and stiction is None:
        return
    friction, ratio = base.coulomb_friction, 1.0
    if friction.si > 0.0:
        ratio = base.breakaway_friction.si / friction.si
    if coulomb is not None:
        friction = Quantity(**coulomb.unknown.changed(friction, float(coulomb.value)))
    if stiction is not None:
        ratio = max(1.0, float(stiction.unknown.number(ratio, stiction.value)))
    table["coulomb_friction"] = friction.model_dump()
    table["breakaway_friction"] = friction.model_dump() | {"value": friction.value * ratio}


def _change_cab(entries: _Entries, base: Cab, name: str) -> Cab:
    cab = _body_changes("cab", base, entries)
    platform, legs = (
        _body_changes("platform", base.platform, entries),
        _factor("legs.mass", entries),
    )
    return base.changed(name, platform=platform, leg_mass_factor=legs, nominal=base.assumed, **cab)


def _factor(path: str, entries: _Entries) -> Any:
    """A factor on the nominal number; 1 where it is not given."""
    return entries[path].value if path in entries else 1.0


def _body_changes(name: str, body: RigidBody, entries: _Entries) -> dict[str, Any]:
    """Changed fields of a body: densities scale mass and inertia, before its other unknowns."""
    own = {path.removeprefix(f"{name}."): entry for path, entry in entries.items()}
    changes: dict[str, Any] = {}
    density = _factor("density", own) * _factor("payload.density", own)
    if own.keys() & {"inertia", "density", "payload.density"}:
        changes["inertia"] = density * _factor("inertia", own) * body.tensor
    moments = 0.5 * np.trace(body.tensor) * np.eye(3) - body.tensor
    centre = np.array(body.centre_of_mass.si)
    if "centre_of_mass" in own:
        whole = own["centre_of_mass"]
        centre[:] = whole.unknown.number(centre, whole.value)
        changes["centre_of_mass"] = centre
    for axis, letter in enumerate("xyz"):
        if (entry := own.get(f"centre_of_mass.{letter}")) is not None:
            centre[axis] = entry.unknown.number(centre[axis], entry.value)
            changes["centre_of_mass"] = centre
        if (entry := own.get(f"second_moment.{letter}")) is not None:
            if "inertia" in own:
                raise InputError(f"{name}.inertia: allowed: it or second moments, not both")
            moments[axis, axis] = entry.unknown.number(moments[axis, axis], entry.value)
            changes["inertia"] = density * (np.trace(moments) * np.eye(3) - moments)
    mass = density * body.mass.si
    if "mass" in own:
        mass = own["mass"].unknown.number(mass, own["mass"].value)
    if mass != body.mass.si:
        changes["mass"] = mass
    return changes


def _with_number(part: Any, path: Sequence[str], unknown: Unknown, value: Any) -> Any:
    """Settings with the number at a path changed."""
    name, *deeper = path
    field = getattr(part, name, None)
    changed: Any
    if deeper and isinstance(field, list):  # gain errors of sensors: of one from 1, or of each
        values = dict(enumerate(value)) if deeper == ["*"] else {int(deeper[0]) - 1: value}
        exact = Quantity(value=0.0, unit="1", status="assumed", source="ideal")
        changed = list(field) or [exact] * (len(values) if deeper == ["*"] else len(LEGS))
        for index, x in values.items():
            changed[index] = Quantity(**unknown.changed(changed[index], float(x)))
    elif deeper:
        changed = _with_number(field, deeper, unknown, value)
    elif isinstance(field, Quantity):
        changed = Quantity(**unknown.changed(field, float(value)))
    elif isinstance(field, float):
        changed = float(value) if unknown.effect == "value" else unknown.number(field, value)
    else:
        raise InputError(f"{unknown.path}: is not a number that is given")
    return validated(type(part), dict(part) | {name: changed}, unknown.path)


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
