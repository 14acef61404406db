"""Folders of models and data files, numbers of a machine in an MJCF, and masses of its parts.

A model that owns its geometry and inertia has the names of the shipped ones: sites `upper_1` to
`upper_6`, bodies `cylinder_#` and `rod_#`, slide joints `leg_#`, the body `platform`, and in the
model of a cab the body `cab` and the site `crew`. Axes are MuJoCo's, z up.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from cmf_mj.core.errors import InputError, reason
from cmf_mj.core.quantity import Kind, Quantities, Quantity
from cmf_mj.core.settings import Settings

CMF = "cmf"  #: Name of the Cockpit Motion Facility among the machines.
CABS = ("gfd", "rfd", "ifd")  #: Its three flight decks: Generic, Research and Integration.

_PACKAGE = Path(__file__).resolve().parents[1]


def directory(name: str = "models") -> Path:
    """A folder of data files: inside the wheel, or next to the package in a checkout."""
    installed = _PACKAGE / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


def model_path(name: str) -> Path:
    """A file of the models, by name: `scene.xml`, `cmf_hexapod.xml`, `single_legs.xml` ..."""
    return directory() / name


@cache
def machine_names() -> tuple[str, ...]:
    """Names of the shipped machines, the CMF first."""
    names = {path.stem for path in (directory() / "machines").glob("*.toml")}
    return (CMF, *sorted(names - {CMF}))


_LEGS = range(1, 7)


def machine_tables(path: Path) -> dict[str, Any]:
    """Tables `gimbals`, `platform` and `legs` of a machine file, from its MJCF."""
    root = _read(path)

    def length(value: Any) -> dict[str, Any]:
        return _quantity(value, "m", path, "derived")

    def position(tag: str, name: str) -> tuple[float, ...]:
        return numbers_of(element_of(root, tag, name, path), "pos")

    # The slide joint of the legs, whose range is a default of the model.
    slides = [joint for joint in root.iter("joint") if joint.get("type") == "slide"]
    slide = next(joint for joint in slides if joint.get("range"))
    _, _, rod_end_height = position("site", "rod_end_1")
    _, _, accelerometer_height = position("site", "rod_accelerometer_1")
    return {
        "gimbals": {
            "upper": length([position("site", f"upper_{leg}") for leg in _LEGS]),
            "lower": length([position("body", f"cylinder_{leg}") for leg in _LEGS]),
        },
        "platform": _body(root, "platform", path),
        "legs": {
            "half_stroke": length(numbers_of(slide, "range")[1]),
            "accelerometer": length(round(rod_end_height - accelerometer_height, 9)),
            "cylinder_mass": _body(root, "cylinder_1", path)["mass"],
            "rod_mass": _body(root, "rod_1", path)["mass"],
        },
    }


def cab_table(path: Path) -> dict[str, Any]:
    """Mass properties and station of a cab, from its MJCF."""
    root = _read(path)
    station = numbers_of(element_of(root, "site", "crew", path), "pos")
    return _body(root, "cab", path) | {"station": _quantity(station, "m", path)}


def _read(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except OSError as error:
        raise InputError(f"mjcf: {path} cannot be read: {error.strerror}") from None
    except ElementTree.ParseError as error:
        raise InputError(f"mjcf: {path} is not XML: {reason(error)}") from None


def _quantity(value: Any, unit: str, path: Path, status: str = "assumed") -> dict[str, Any]:
    """A number of a model as a machine file states it."""
    if path.is_relative_to(directory()):
        source = f"models/{path.relative_to(directory())}; models/README.md says why"
    else:
        source = f"the model {path.name}"
    return {"value": value, "unit": unit, "status": status, "source": source}


def element_of(
    root: ElementTree.Element, tag: str, name: str, path: Path | str = "the machine's"
) -> ElementTree.Element:
    """The element of that tag and name in an MJCF, which a refusal calls by its path."""
    for element in root.iter(tag):
        if element.get("name") == name:
            return element
    raise InputError(f"mjcf: {path} has no {tag} {name!r}; allowed: the names of models/")


def numbers_of(element: ElementTree.Element, name: str) -> tuple[float, ...]:
    """Numbers of an attribute of an MJCF; three zeros where it is left out."""
    return tuple(map(float, element.get(name, "0 0 0").split()))


def _body(root: ElementTree.Element, name: str, path: Path) -> dict[str, Any]:
    """Mass properties that an MJCF gives a body."""
    inertial = element_of(root, "body", name, path).find("inertial")
    if inertial is None:
        raise InputError(f"mjcf: body {name!r} of {path} has no inertial; every body needs one")
    moments = numbers_of(inertial, "diaginertia" if inertial.get("diaginertia") else "fullinertia")
    return {
        "mass": _quantity(float(inertial.get("mass", "0")), "kg", path),
        "centre_of_mass": _quantity(numbers_of(inertial, "pos"), "m", path),
        "inertia": _quantity(moments, "kg m^2", path),
    }


ROUND_OFF = 1e-9  #: Share of the largest moment by which the inequalities may fail for round-off.

_TENSOR = ((0, 3, 4), (3, 1, 5), (4, 5, 2))  #: Ixx, Iyy, Izz, Ixy, Ixz, Iyz in the tensor.
ENTRIES = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))  #: Their rows and columns there.


def _numbers_in(counts: tuple[int, ...], units: tuple[str, ...]) -> AfterValidator:
    """Validator of one of the counts of numbers, in one of the units."""

    def check(quantities: Quantities) -> Quantities:
        if quantities.unit not in units:
            allowed = ", ".join(units)
            raise InputError(f"{quantities.unit!r} is refused: unit must be one of {allowed}")
        if len(quantities.value) not in counts:
            allowed = " or ".join(map(str, counts))
            raise InputError(f"has {len(quantities.value)} values; allowed: {allowed}")
        return quantities

    return AfterValidator(check)


def _check_moments(quantities: Quantities) -> Quantities:
    least, middle, largest = np.linalg.eigvalsh(_tensor(quantities))
    fault = f"principal moments are {least:g}, {middle:g}, {largest:g} kg m^2"
    if not least > 0.0:
        raise InputError(f"{fault}; allowed: all greater than 0, a positive definite tensor")
    if least + middle < (1.0 - ROUND_OFF) * largest:
        allowed = "none greater than the sum of the others (triangle inequality)"
        raise InputError(f"{fault}; allowed: {allowed}")
    return quantities


def _tensor(inertia: Quantities) -> NDArray[np.float64]:
    entries = np.zeros(6)
    entries[: len(inertia.value)] = inertia.si
    return entries[np.array(_TENSOR)]


Mass = Annotated[Quantity, AfterValidator(Kind(("kg", "lbm")).check)]
Place = Annotated[Quantities, _numbers_in((3,), ("m", "mm", "in", "ft"))]
Inertia = Annotated[
    Quantities,
    _numbers_in((3, 6), ("kg m^2", "lbm ft^2", "lbm in^2", "slug ft^2")),
    AfterValidator(_check_moments),
]


class RigidBody(Settings):
    """Mass properties of a part of the machine."""

    mass: Mass  #: [kg or lbm].
    centre_of_mass: Place  #: Of the part, x forward, y left, z up from the platform's centroid.
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

    @classmethod
    def of(
        cls,
        masses: NDArray[np.float64],
        centres: NDArray[np.float64],
        tensors: Iterable[NDArray[np.float64]],
    ) -> "Payload":
        """Bodies (n,) that move as one: masses [kg], centres (n, 3) [m], inertia about those."""
        total = float(masses.sum())
        centre = masses @ centres / total
        inertia = np.zeros((3, 3))
        for mass, arm, tensor in zip(masses, centres - centre, tensors, strict=True):
            inertia += tensor + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return cls(total, centre, inertia)
