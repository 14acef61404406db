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
is that of the base in proportion to the mass. Drawing and pilot's seat are those of the base.
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
    nominal: "Cab | None" = None  #: Cab that laws in hydraulic modes assume; None for itself.
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
        """A cab of a new name with other masses.

        What changes of the cab and of its `platform` is `mass` [kg], `centre_of_mass` (3,) [m] and
        `inertia` (3, 3) [kg m^2]; `leg_mass_factor` is on the masses of cylinders and rods, and
        `nominal` is the cab that control laws assume, default that of this cab, else the new one.
        The name of one of the machine's cabs is refused, and a nominal one of another machine.

        >>> heavy = cmf_mj.load_cab("gfd").changed("heavy", mass=12000.0)
        >>> heavy.mass.si, heavy.platform.mass.si
        (12000.0, 4500.0)
        """
        checked_name(name, "cab: name")
        changes = _file_table(cab, name) | {"platform": _file_table(platform or {}, name)}
        if leg_mass_factor != 1.0:
            legs = {part: leg_mass_factor * mass.si for part, mass in self.legs}
            changes["legs"] = _file_table(legs, name)
        if nominal:
            changes["nominal"] = nominal
        return _changed_cab(self, name, changes, name)


_SI_UNITS = {
    "centre_of_mass": "m",
    "inertia": "kg m^2",
}  #: In `Cab.changed`; all else is in kg.


def _file_table(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Values in SI as a file states them."""
    table: dict[str, Any] = {}
    for field, value in values.items():
        numbers = real(f"{source}: {field}", value)
        if numbers.shape == (3, 3):
            if np.abs(numbers - numbers.T).max() > ROUND_OFF * np.abs(numbers).max():
                raise InputError(f"{source}: {field}: {numbers.tolist()} is refused: not symmetric")
            numbers = numbers[ENTRIES]
        table[field] = {
            "value": numbers.tolist(),
            "unit": _SI_UNITS.get(field, "kg"),
            "status": "assumed",
            "source": source,
        }
    return table


def _changed_cab(base: Cab, name: str, changes: Mapping[str, Any], where: str) -> Cab:
    """A cab with the base's fields but for its changes."""
    if name in base.machine.cabs:
        raise _name_refusal(where, name)
    table = _changed_fields(base, changes, where)
    for part in ("platform", "legs"):
        part_changes = changes.get(part, {})
        if isinstance(part_changes, Mapping):
            table[part] = _changed_fields(getattr(base, part), part_changes, f"{where}: {part}")
    return validated(Cab, table | {"name": name, "base": base.base}, where)


def _name_refusal(where: str, name: str) -> InputError:
    return InputError(
        f"{where}: {name!r} is the name of one of the machine's cabs; a changed one needs another"
    )


def _changed_fields(base: Settings, changes: Mapping[str, Any], where: str) -> dict[str, Any]:
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
    """Load a cab of a `machine`, default that of a loaded cab, or the CMF.

    `source` is one of the machine's cabs by name, a TOML file of the form that heads this module,
    or a loaded cab; default the machine's first. A changed cab under the name of one of the
    machine's is refused, and one of another machine.

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
            raise _name_refusal("cab", source.name)
        return source
    loaded = load_machine(models.CMF if machine is None else machine)
    names = tuple(loaded.cabs)
    if source is None or str(source) in names:
        return _unchanged_cab(loaded, names[0] if source is None else str(source))
    user = user_set("cab", names, source, fixed=("base", "nominal", "machine"))
    return _changed_cab(_unchanged_cab(loaded, user.base), user.name, user.changes, user.where)


def load_cabs(names: Sequence[str], machine: Machine) -> tuple[Cab, ...]:
    """The named cabs of a machine; `all` for all, empty for its first."""
    all_names = tuple(machine.cabs)
    chosen = all_names if list(names) == ["all"] else tuple(names) or all_names[:1]
    return tuple(load_cab(name, machine) for name in chosen)


def recorded_cab(metadata: Mapping[str, Any]) -> Cab | None:
    """The cab named in a record's metadata; None if there is none."""
    machine, parameters = recorded_machine(metadata), metadata.get("cab_parameters")
    if parameters:
        return validated(Cab, _with_machine(machine, parameters), "cab_parameters")
    return load_cab(str(metadata["cab"]), machine) if metadata.get("cab") else None


def _with_machine(machine: Machine, table: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a recorded cab, and of its nominal one, on their machine."""
    nominal = table.get("nominal")
    nominal_table = _with_machine(machine, nominal) if nominal else None
    return {**table, "nominal": nominal_table, "machine": machine}
