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
The drawing and the pilot's seat are those of the base, a cab of the same machine.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from cmf_mj.core.arrays import real
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.settings import Name, Settings, checked_name, user_set, validated
from cmf_mj.machine import models
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.machine import Machine, load_machine, recorded_machine
from cmf_mj.machine.models import ENTRIES, ROUND_OFF, Legs, Payload, RigidBody


class Cab(RigidBody):
    """A cab with the platform and the legs that carry it.

    >>> cab = cmf_mj.load_cab("gfd")
    >>> round(cab.payload.mass / 0.45359237), cab.legs.rod_mass.si
    (29920, 150.0)
    """

    name: Name  #: Name of the cab.
    base: str  #: The machine's cab whose drawing and pilot's station it has.
    platform: RigidBody  #: The platform alone.
    legs: Legs  #: Cylinders and rods.
    nominal: "Cab | None" = None
    """Cab that control laws in hydraulic modes assume; None for itself."""
    machine: Machine = Field(exclude=True, repr=False)  #: The machine it is on.

    @model_validator(mode="after")
    def _on_one_machine(self) -> "Cab":
        for part, body in (("", self), ("platform", self.platform)):
            self.machine.check_place(part, body)
        if self.nominal and self.nominal.machine != self.machine:
            raise InputError(
                f"nominal: {self.nominal.name!r} is one of machine {self.nominal.machine.name!r}; "
                f"allowed: a cab of {self.machine.name!r}"
            )
        return self

    @property
    def unchanged(self) -> bool:
        """Whether it is one of its machine's cabs, not a changed one."""
        return self.name in self.machine.cabs

    @property
    def station(self) -> NDArray[np.float64]:
        """Where the crew feels the motion, unlike the masses with z down [m], (3,)."""
        return self.machine.cabs[self.base].station.si * FLIP

    @property
    def assumed(self) -> "Cab":
        """The cab that control laws assume: `nominal`, else this one."""
        return self.nominal or self

    @property
    def payload(self) -> Payload:
        """Platform and cab as one rigid body."""
        parts = (self.platform, self)
        masses = np.array([part.mass.si for part in parts])
        centres = np.array([part.centre_of_mass.si for part in parts])
        return Payload.of(masses, centres, (part.tensor for part in parts))

    def changed(
        self,
        name: str,
        *,
        platform: Mapping[str, ArrayLike] | None = None,
        leg_mass_factor: float = 1.0,
        nominal: "Cab | None" = None,
        **cab: ArrayLike,
    ) -> "Cab":
        """A cab with other masses.

        Args:
            name: of the new cab.
            platform: `mass` [kg], `centre_of_mass` (3,) [m], `inertia` [kg m^2], (3, 3), of the
                platform, as far as they change.
            leg_mass_factor: on the masses of cylinders and rods.
            nominal: cab that control laws assume; default that of this cab, else the new one.
            **cab: as `platform`, of the cab.

        The name of one of the machine's cabs is refused, and a nominal one of another machine.

        >>> heavy = cmf_mj.load_cab("gfd").changed("heavy", mass=12000.0)
        >>> heavy.mass.si, heavy.platform.mass.si
        (12000.0, 4500.0)
        """
        checked_name(name, "cab: name")
        legs = {part: leg_mass_factor * mass.si for part, mass in self.legs}
        changes = {
            **_stated(cab, name),
            "platform": _stated(platform or {}, name),
            "legs": _stated(legs if leg_mass_factor != 1.0 else {}, name),
        }
        return _overlaid(self, name, changes | ({"nominal": nominal} if nominal else {}), name)


_SI = {"centre_of_mass": "m", "inertia": "kg m^2"}  #: Units of `Cab.changed`; all else is in kg.


def _stated(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Values in SI as a file states them."""
    table: dict[str, Any] = {}
    for field, value in values.items():
        given = real(f"{source}: {field}", value)
        if given.shape == (3, 3):
            if np.abs(given - given.T).max() > ROUND_OFF * np.abs(given).max():
                raise InputError(f"{source}: {field}: {given.tolist()} is refused: not symmetric")
            given = given[ENTRIES]
        table[field] = {
            "value": given.tolist(),
            "unit": _SI.get(field, "kg"),
            "status": "assumed",
            "source": source,
        }
    return table


def _overlaid(base: Cab, name: str, changes: Mapping[str, Any], where: str) -> Cab:
    """A cab with what it changes in the place of what the base has."""
    if name in base.machine.cabs:
        raise _taken(where, name)
    table = _overlay(base, changes, where)
    for part in ("platform", "legs"):
        given, before = changes.get(part, {}), getattr(base, part)
        if isinstance(given, Mapping):
            table[part] = _overlay(before, given, f"{where}: {part}")
    return validated(Cab, table | {"name": name, "base": base.base}, where)


def _taken(where: str, name: str) -> InputError:
    return InputError(
        f"{where}: {name!r} is the name of one of the machine's cabs; a changed one needs another"
    )


def _overlay(base: Settings, changes: Mapping[str, Any], where: str) -> dict[str, Any]:
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
def _unchanged_cab(machine: Machine, name: str) -> Cab:
    """One of a machine's cabs."""
    design, platform, legs = machine.cabs[name], machine.platform, machine.legs
    table = {field: getattr(design, field) for field in RigidBody.model_fields} | {
        "name": name,
        "base": name,
        "platform": platform,
        "legs": Legs(cylinder_mass=legs.cylinder_mass, rod_mass=legs.rod_mass),
        "machine": machine,
    }
    return validated(Cab, table, f"{machine.name}: {name}")


def load_cab(
    source: str | Path | Cab | None = None, machine: str | Path | Machine | None = None
) -> Cab:
    """Load a cab of a machine.

    Args:
        source: one of the machine's cabs by name, a TOML file of the form that heads this module,
            or a cab loaded already; default the machine's first.
        machine: by name, TOML file or loaded; default that of a loaded cab, or the CMF.

    A changed cab under the name of one of the machine's is refused, and one of another machine.

    >>> cmf_mj.load_cab("rfd").centre_of_mass.value
    (0.05, 0.0, 0.9)
    """
    if isinstance(source, Cab):
        if machine is not None and load_machine(machine) != source.machine:
            raise InputError(
                f"cab: {source.name!r} is one of machine {source.machine.name!r}, not of "
                f"{load_machine(machine).name!r}"
            )
        if source.unchanged and source != _unchanged_cab(source.machine, source.name):
            raise _taken("cab", source.name)
        return source
    carrier = load_machine(models.CMF if machine is None else machine)
    names = tuple(carrier.cabs)
    if source is None or str(source) in names:
        return _unchanged_cab(carrier, names[0] if source is None else str(source))
    user = user_set("cab", names, source, fixed=("base", "nominal", "machine"))
    return _overlaid(_unchanged_cab(carrier, user.base), user.name, user.changes, user.where)


def load_cabs(names: Sequence[str], machine: Machine) -> tuple[Cab, ...]:
    """The named cabs of a machine; `all` for all, empty for its first."""
    known = tuple(machine.cabs)
    chosen = known if list(names) == ["all"] else tuple(names) or known[:1]
    return tuple(load_cab(name, machine) for name in chosen)


def recorded_cab(metadata: Mapping[str, Any]) -> Cab | None:
    """The cab named in a record's metadata; None if there is none."""
    machine = recorded_machine(metadata)
    if metadata.get("cab_parameters"):
        return validated(Cab, _with_machine(machine, metadata["cab_parameters"]), "cab_parameters")
    return load_cab(str(metadata["cab"]), machine) if metadata.get("cab") else None


def _with_machine(machine: Machine, table: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a recorded cab, and of its nominal one, on their machine."""
    nominal = table.get("nominal")
    on = _with_machine(machine, nominal) if nominal else None
    return {**table, "nominal": on, "machine": machine}
