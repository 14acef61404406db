"""The masses of the machine: its cab, the platform below it and the legs, shipped or a user's own.

A shipped cab is read from the MJCF files, which own the numbers. A user's file names one as `base`
and repeats, in a table named after the new cab, what is different:

    base = "gfd"

    [mine]                              # the cab alone, without the platform
    mass = { value = 20000, unit = "lbm", status = "assumed", source = "weighed" }
    centre_of_mass = { value = [4, 0, 36], unit = "in", status = "assumed", source = "drawing" }
    inertia = { value = [15e3, 21e3, 26e3], unit = "kg m^2", status = "assumed", source = "CAD" }

    [mine.platform]                     # the same three
    [mine.legs]
    rod_mass = { value = 150, unit = "kg", status = "assumed", source = "drawing" }

Axes are those of the models: origin in the platform's centroid, which lies in the plane of the
upper gimbals, x forward, y left, **z up**. Inertia is about the body's own centre of mass: Ixx,
Iyy, Izz, and where there are products the tensor's entries Ixy, Ixz, Iyz. Inertia that is left out
while the mass changes is that of the base in proportion to the mass; so is that of a leg's parts.
What is drawn and where the pilot sits stay as in the base.

A principal moment I_a of a rigid body is the sum of two second moments, each of them not negative;
whatever the body is made of, then,

    I_a > 0,    I_a <= I_b + I_c
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator

from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Kind, Quantities, Quantity
from cmf_mj.core.settings import Name, Settings, checked_name, user_set, validated
from cmf_mj.machine import models

ROUND_OFF = 1e-9
"""Share of the largest moment by which the inequalities may fail for round-off."""

_LENGTHS = ("m", "mm", "in", "ft")
_INERTIAS = ("kg m^2", "lbm ft^2", "lbm in^2", "slug ft^2")
_TENSOR = ((0, 3, 4), (3, 1, 5), (4, 5, 2))
"""Which of Ixx, Iyy, Izz, Ixy, Ixz, Iyz stands where in the tensor."""
_ENTRIES = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
"""Rows and columns where they stand."""
_PARTS = ("cylinder", "rod")


def _several(quantities: Quantities, counts: tuple[int, ...], units: tuple[str, ...]) -> None:
    if quantities.unit not in units:
        allowed = ", ".join(units)
        raise InputError(f"{quantities.unit!r} is refused: unit must be one of {allowed}")
    if len(quantities.value) not in counts:
        allowed = " or ".join(map(str, counts))
        raise InputError(f"has {len(quantities.value)} values; allowed: {allowed}")


def _placed(quantities: Quantities) -> Quantities:
    _several(quantities, (3,), _LENGTHS)
    height = float(quantities.si[2])
    if height < floor():
        raise InputError(
            f"is {height:g} m above the upper gimbals, below the floor; allowed: at least "
            f"{floor():g} m, z is up"
        )
    return quantities


def _possible(quantities: Quantities) -> Quantities:
    _several(quantities, (3, 6), _INERTIAS)
    least, middle, most = np.linalg.eigvalsh(_tensor(quantities))
    found = f"principal moments are {least:g}, {middle:g}, {most:g} kg m^2"
    if not least > 0.0:
        raise InputError(f"{found}; allowed: all greater than 0, a positive definite tensor")
    if least + middle < (1.0 - ROUND_OFF) * most:
        raise InputError(
            f"{found}; allowed: none greater than the sum of the others (triangle inequality)"
        )
    return quantities


def _tensor(inertia: Quantities) -> NDArray[np.float64]:
    entries = np.zeros(6)
    entries[: len(inertia.value)] = inertia.si
    return entries[np.array(_TENSOR)]


Mass = Annotated[Quantity, AfterValidator(Kind(("kg", "lbm")).check)]
Place = Annotated[Quantities, AfterValidator(_placed)]
Inertia = Annotated[Quantities, AfterValidator(_possible)]


class RigidBody(Settings):
    """Mass properties of a part of the machine."""

    mass: Mass  #: [kg or lbm].
    centre_of_mass: (
        Place  #: Of the part alone, x forward, y left, z up from the platform's centroid.
    )
    inertia: Inertia  #: About the part's centre of mass: Ixx, Iyy, Izz and Ixy, Ixz, Iyz or none.

    @property
    def tensor(self) -> NDArray[np.float64]:
        """Inertia about the centre of mass [kg m^2], (3, 3)."""
        return _tensor(self.inertia)


class Legs(Settings):
    """Masses of the parts of one leg; all six are alike."""

    cylinder_mass: Mass  #: Of a cylinder.
    rod_mass: Mass  #: Of a rod.


class Payload(NamedTuple):
    """Platform and cab as one rigid body, axes as of the module."""

    mass: float  #: [kg].
    centre: NDArray[np.float64]  #: Centre of mass [m], (3,).
    inertia: NDArray[np.float64]  #: About the centre of mass [kg m^2], (3, 3).


class Cab(RigidBody):
    """A cab with the platform and the legs that carry it.

    >>> cab = cmf_mj.load_cab("gfd")
    >>> round(cab.payload.mass / 0.45359237), cab.legs.rod_mass.si
    (29920, 150.0)
    """

    name: Name  #: Name of the cab.
    base: str  #: Shipped cab whose drawing and pilot's station it has.
    platform: RigidBody  #: The platform alone.
    legs: Legs  #: Cylinders and rods.
    taken_for: "Cab | None" = None
    """Cab that control laws in hydraulic modes take it for; None for itself."""

    @property
    def shipped(self) -> bool:
        """Whether it is one of `CABS`."""
        return self.name in models.CABS

    @property
    def known_as(self) -> "Cab":
        """The cab that control laws take it for."""
        return self.taken_for or self

    @property
    def payload(self) -> Payload:
        """Platform and cab as one rigid body."""
        parts = (self.platform, self)
        masses = np.array([part.mass.si for part in parts])
        places = np.array([part.centre_of_mass.si for part in parts])
        total = float(masses.sum())
        centre = masses @ places / total
        inertia = np.zeros((3, 3))
        for part, mass, arm in zip(parts, masses, places - centre, strict=True):
            inertia += part.tensor + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return Payload(total, centre, inertia)

    def changed(
        self,
        name: str,
        *,
        platform: Mapping[str, ArrayLike] | None = None,
        leg_mass: float = 1.0,
        taken_for: "Cab | None" = None,
        **cab: ArrayLike,
    ) -> "Cab":
        """A cab with other masses.

        Args:
            name: of the new cab.
            platform: `mass` [kg], `centre_of_mass` (3,) [m], `inertia` [kg m^2], (3, 3), of the
                platform, as far as they change.
            leg_mass: factor on the masses of cylinders and rods.
            taken_for: cab that control laws take it for; default itself.
            **cab: as `platform`, of the cab.

        Raises:
            InputError: name of a shipped cab or one that `checked_name` refuses, or a refused
                number.

        >>> heavy = cmf_mj.load_cab("gfd").changed("heavy", mass=12000.0)
        >>> heavy.mass.si, heavy.platform.mass.si
        (12000.0, 4500.0)
        """
        checked_name(name, "cab: name")
        legs = {part: leg_mass * mass.si for part, mass in self.legs}
        changes = {
            **_stated(cab, name),
            "platform": _stated(platform or {}, name),
            "legs": _stated(legs if leg_mass != 1.0 else {}, name),
        }
        made = _overlaid(self, name, changes, name)
        return made if taken_for is None else made.model_copy(update={"taken_for": taken_for})


_SI = {"centre_of_mass": "m", "inertia": "kg m^2"}
"""Units of `Cab.changed`; all else is in kg."""


def _stated(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Values in SI as a file states them."""
    table: dict[str, Any] = {}
    for field, value in values.items():
        given = np.asarray(value, dtype=float)
        if given.shape == (3, 3):
            given = given[_ENTRIES]
        table[field] = {
            "value": given.tolist(),
            "unit": _SI.get(field, "kg"),
            "status": "assumed",
            "source": source,
        }
    return table


def _overlaid(base: Cab, name: str, changes: Mapping[str, Any], where: str) -> Cab:
    """A cab with what it changes in the place of what the base has."""
    if name in models.CABS:
        raise InputError(
            f"{where}: {name!r} is the name of a shipped cab; a changed one needs another"
        )
    table = _body(base, changes, where)
    for part in ("platform", "legs"):
        given, before = changes.get(part, {}), getattr(base, part)
        if isinstance(given, Mapping):
            table[part] = _body(before, given, f"{where}: {part}")
    return validated(Cab, table | {"name": name, "base": base.base}, where)


def _body(base: Settings, changes: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Fields of a part of the machine, its inertia in proportion to a mass that changes alone."""
    table = dict(base) | dict(changes)
    if isinstance(base, RigidBody) and "mass" in changes and "inertia" not in changes:
        try:
            ratio = validated(Quantity, changes["mass"], where).si / base.mass.si
        except InputError:  # refused with the other fields
            return table
        if ratio > 0.0 and ratio != 1.0:
            table["inertia"] = base.inertia.model_copy(
                update={
                    "value": tuple(ratio * moment for moment in base.inertia.value),
                    "source": f"in proportion to the mass: {base.inertia.source}",
                }
            )
    return table


@lru_cache
def floor() -> float:
    """Height of the hall's floor over the platform's centroid at neutral [m], from its MJCF."""
    hall = ElementTree.parse(models.model_path("scene.xml")).getroot()
    return float(_numbers(_named(hall, "geom", "floor"), "pos")[2])


@lru_cache
def _machine() -> ElementTree.Element:
    return ElementTree.parse(models.model_path("cmf_hexapod.xml")).getroot()


def _named(root: ElementTree.Element, tag: str, name: str) -> ElementTree.Element:
    return next(element for element in root.iter(tag) if element.get("name") == name)


def _numbers(element: ElementTree.Element, name: str) -> tuple[float, ...]:
    return tuple(map(float, element.get(name, "").split()))


def _inertial(root: ElementTree.Element, body: str, where: str) -> dict[str, Any]:
    """Mass properties that an MJCF gives a body."""
    inertial = _named(root, "body", body).find("inertial")
    assert inertial is not None
    about = {"status": "assumed", "source": f"models/{where}; models/README.md says why"}
    return {
        "mass": {"value": _numbers(inertial, "mass")[0], "unit": "kg", **about},
        "centre_of_mass": {"value": _numbers(inertial, "pos"), "unit": "m", **about},
        "inertia": {"value": _numbers(inertial, "diaginertia"), "unit": "kg m^2", **about},
    }


@lru_cache
def _shipped(name: str) -> Cab:
    path = models.cab_path(name)
    machine, file = _machine(), f"cabs/{path.name}"
    parts = {part: _inertial(machine, f"{part}_1", "cmf_hexapod.xml") for part in _PARTS}
    table = _inertial(ElementTree.parse(path).getroot(), "cab", file) | {
        "name": name,
        "base": name,
        "platform": _inertial(machine, "platform", "cmf_hexapod.xml"),
        "legs": {f"{part}_mass": body["mass"] for part, body in parts.items()},
    }
    return validated(Cab, table, file)


def load_cab(source: str | Path | Cab = "gfd") -> Cab:
    """Load a cab.

    Args:
        source: `gfd`, `rfd` or `ifd`, a TOML file of the form that heads this module, or a cab
            loaded already.

    Raises:
        InputError: no such cab, unreadable file, a refused field with what is allowed, or a
            changed cab under a shipped one's name.

    >>> cmf_mj.load_cab("rfd").centre_of_mass.value
    (0.05, 0.0, 0.9)
    """
    if isinstance(source, Cab):
        if source.shipped and source != _shipped(source.name):
            raise InputError(
                f"cab: {source.name!r} is the name of a shipped cab; a changed one needs another"
            )
        return source
    if str(source) in models.CABS:
        return _shipped(str(source))
    user = user_set("cab", models.CABS, source, fixed=("base", "taken_for"))
    return _overlaid(_shipped(user.base), user.name, user.changes, user.where)


def recorded_cab(metadata: Mapping[str, Any]) -> Cab | None:
    """The cab that the metadata of a record tell of; None where they tell of none."""
    if metadata.get("cab_parameters"):
        return validated(Cab, metadata["cab_parameters"], "cab_parameters")
    return load_cab(metadata["cab"]) if metadata.get("cab") else None
