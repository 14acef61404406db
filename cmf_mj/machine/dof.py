"""Degrees of freedom by name: place in a pose, and what depends on translation or rotation."""

from typing import TypeVar

from cmf_mj.core.errors import check_name
from cmf_mj.machine.geometry import DOFS

Choice = TypeVar("Choice")


def dof_index(dof: str) -> int:
    """Position of a degree of freedom in a pose."""
    return DOFS.index(check_name("dof", dof, DOFS))


def by_kind(dof: str | int, translation: Choice, rotation: Choice) -> Choice:
    """The first for surge, sway and heave, the second for roll, pitch and yaw.

    >>> by_kind("pitch", "m/s^2", "deg/s^2")
    'deg/s^2'
    """
    index = dof_index(dof) if isinstance(dof, str) else dof
    return translation if index < 3 else rotation


def dof_unit(dof: str | int) -> str:
    """The unit of the field for a degree of freedom: in or deg.

    >>> dof_unit("heave"), dof_unit(5)
    ('in', 'deg')
    """
    return by_kind(dof, "in", "deg")
