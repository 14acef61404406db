"""Rigid bodies a machine is made of: mass, centre of mass and inertia, as files give them.

Axes are those of the models: origin in the platform's centroid, which lies in the plane of the
upper gimbals, x forward, y left, **z up**. Inertia is about the body's own centre of mass: Ixx,
Iyy, Izz, and where there are products the tensor's entries Ixy, Ixz, Iyz.

A principal moment I_a of a rigid body is the sum of two second moments, each of them not negative;
whatever the body is made of, then,

    I_a > 0,    I_a <= I_b + I_c
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Kind, Quantities, Quantity
from cmf_mj.core.settings import Settings

ROUND_OFF = 1e-9
"""Share of the largest moment by which the inequalities may fail for round-off."""

_LENGTHS = ("m", "mm", "in", "ft")
_INERTIAS = ("kg m^2", "lbm ft^2", "lbm in^2", "slug ft^2")
_TENSOR = ((0, 3, 4), (3, 1, 5), (4, 5, 2))
"""Which of Ixx, Iyy, Izz, Ixy, Ixz, Iyz stands where in the tensor."""
ENTRIES = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
"""Rows and columns where they stand."""


def _several(quantities: Quantities, counts: tuple[int, ...], units: tuple[str, ...]) -> None:
    if quantities.unit not in units:
        allowed = ", ".join(units)
        raise InputError(f"{quantities.unit!r} is refused: unit must be one of {allowed}")
    if len(quantities.value) not in counts:
        allowed = " or ".join(map(str, counts))
        raise InputError(f"has {len(quantities.value)} values; allowed: {allowed}")


def _placed(quantities: Quantities) -> Quantities:
    _several(quantities, (3,), _LENGTHS)
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

    def turned(self) -> "RigidBody":
        """The body with x forward, y right, z down turned to x forward, y left, z up, or back."""
        x, y, z = self.centre_of_mass.value
        inertia = self.inertia.value
        if len(inertia) > len(self.centre_of_mass.value):
            inertia = (*inertia[:3], -inertia[3], -inertia[4], inertia[5])
        place = self.centre_of_mass.model_copy(update={"value": (x, -y, -z)})
        moments = self.inertia.model_copy(update={"value": inertia})
        return self.model_copy(update={"centre_of_mass": place, "inertia": moments})

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
