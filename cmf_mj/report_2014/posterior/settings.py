"""A study of the unknown: ranges of the numbers nobody published, laws and cabs, as a TOML file.

A machine is a value of each unknown, drawn between its bounds, and valves and leaks that differ
from leg to leg. `values` are in the units of the file; factors and shifts change a shipped cab.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.settings import Settings, check_distinct, validated
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import OF_THE_SUPPLY, HydraulicParameters, load_hydraulics
from cmf_mj.studies.mismatch import Mismatch
from cmf_mj.studies.settings import study_table

HYDRAULIC = (
    *("leg_speed", "drive_lag", "valve_lag", "bulk_modulus", "leak_rate", "supply_pressure"),
)
"""Unknowns that are fields of a hydraulic set."""

CAB = (
    *("cab_mass", "cab_inertia", "cab_height", "cab_forward"),
    *("platform_mass", "platform_height", "leg_mass"),
)
"""Unknowns of cab, platform and legs: masses and inertia as factors on the shipped ones, places as
shifts of a centre of mass, up and forward [m]."""

POLE = "derivative_pole"
"""Unknown of the DCL: the corner of the derivative filter."""


class Unknown(Settings):
    """A number nobody published, and the range its evidence allows."""

    low: float  #: Lower bound, in `unit`.
    high: float  #: Upper bound.
    unit: str  #: As in the files; 1 for a factor.
    scale: Literal["linear", "log"] = "linear"  #: In which it is uniform.
    source: Annotated[str, Field(min_length=1)]  #: Why these bounds.

    def at(self, quantile: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """The value below which a share of the range lies."""
        if self.scale == "log":
            return np.asarray(self.low * (self.high / self.low) ** np.asarray(quantile))
        return np.asarray(self.low + (self.high - self.low) * np.asarray(quantile))


class PosteriorSettings(Settings):
    """What the study runs."""

    title: Annotated[str, Field(min_length=1)]
    laws: Annotated[list[str], Field(min_length=1)]  #: Names or TOML files.
    cabs: Annotated[list[str], Field(min_length=1)]  #: Shipped ones or TOML files.
    hydraulics: str = "hardware"  #: What is not unknown comes from this set.
    seed: Annotated[int, Field(ge=0)]
    rounds: Annotated[int, Field(ge=2)]  #: Rounds of drawing, see `sampling`.
    draws: Annotated[int, Field(ge=8)]  #: Machines of each round, a power of 2.
    kept: Annotated[int, Field(ge=1)]  #: Machines drawn from the posterior and measured.
    simulated: Annotated[int, Field(ge=0)]  #: Of these, simulated.
    grid: Annotated[int, Field(ge=2)]  #: Points along each side of a map.
    gains: list[float]  #: Of acceleration that are tried [%/(in/s^2)].
    corners: list[Annotated[float, Field(ge=0.0)]]
    """Corners of the accelerometer's filter that they are tried behind [Hz]; 0 for no filter."""
    unknowns: Annotated[dict[str, Unknown], Field(min_length=1)]
    mismatch: Mismatch


@dataclass(frozen=True)
class PosteriorStudy:
    """A study with everything it refers to loaded."""

    settings: PosteriorSettings
    laws: tuple[Law, ...]
    cabs: tuple[Cab, ...]
    hydraulics: HydraulicParameters

    def identity(self) -> dict[str, Any]:
        """What the study runs, as JSON values, see `journal`."""
        return {
            "settings": self.settings.model_dump(mode="json"),
            "laws": [law.model_dump(mode="json") for law in self.laws],
            "cabs": [cab.model_dump(mode="json") for cab in self.cabs],
            "hydraulics": self.hydraulics.model_dump(mode="json", exclude_none=True),
        }

    def values(self, quantiles: NDArray[np.float64]) -> dict[str, float]:
        """Values of the unknowns at a point of the unit cube, (n,)."""
        unknowns = self.settings.unknowns.items()
        return {name: float(one.at(q)) for (name, one), q in zip(unknowns, quantiles, strict=True)}

    def hydraulics_of(self, values: Mapping[str, float], draw: int | None) -> HydraulicParameters:
        """The hydraulic set of a machine; `draw` numbers its mismatch, None has none."""
        table = self.hydraulics.model_dump(exclude_none=True)
        for name in HYDRAULIC:
            if name in values:
                table[name] |= {"value": values[name], "unit": self.settings.unknowns[name].unit}
        supply = Quantity.model_validate(table["supply_pressure"])
        for name in OF_THE_SUPPLY:
            table[name]["value"] *= supply.si / self.hydraulics.supply_pressure.si
        made = validated(HydraulicParameters, table, "machine")
        if draw is None:
            return made
        legs = tuple(f"leg_{leg}" for leg in range(1, 7))
        return self.settings.mismatch.draw_hydraulics(made, legs, self.settings.seed, draw)

    def plant(self, cab: Cab, values: Mapping[str, float], oil: HydraulicParameters) -> Hexapod:
        """The machine with a cab and its hydraulic set; laws take the cab for the shipped one."""
        factor = {name: values.get(name, 1.0) for name in CAB}
        shift = {name: values.get(name, 0.0) for name in CAB}
        mass, platform = factor["cab_mass"], cab.platform
        place = np.array([shift["cab_forward"], 0.0, shift["cab_height"]])
        above = np.array([0.0, 0.0, shift["platform_height"]])
        carried = cab.changed(
            f"{cab.name}_drawn",
            mass=mass * cab.mass.si,
            inertia=mass * factor["cab_inertia"] * cab.tensor,
            centre_of_mass=np.array(cab.centre_of_mass.si) + place,
            platform={
                "mass": factor["platform_mass"] * platform.mass.si,
                "inertia": factor["platform_mass"] * platform.tensor,
                "centre_of_mass": np.array(platform.centre_of_mass.si) + above,
            },
            leg_mass=factor["leg_mass"],
            nominal=cab,
        )
        return Hexapod(carried, oil)

    def law(self, law: Law, values: Mapping[str, float]) -> Law:
        """A law with the derivative filter of a machine."""
        return law.model_copy(update={POLE: values[POLE]}) if POLE in values else law


def load_posterior(
    source: str | Path | dict[str, Any],
    *,
    laws: Sequence[str | Law] | None = None,
    changes: Mapping[str, Any] | None = None,
    quick: bool = False,
) -> PosteriorStudy:
    """Load a study of the unknown.

    `source` is the name of a shipped specification, a TOML file or a table; `laws` stand in for its
    laws, `changes` replace its fields; a `quick` study has the fields of its table `quick`.
    """
    table, where = study_table(source)
    fewer = table.pop("quick", {})
    table |= (fewer if quick else {}) | dict(changes or {})
    if laws is not None:
        table["laws"] = [load_law(law).name for law in laws]
    settings = validated(PosteriorSettings, table, where)
    with within(where):
        return _checked(settings, laws)


def _checked(settings: PosteriorSettings, laws: Sequence[str | Law] | None) -> PosteriorStudy:
    settings.mismatch.check()
    for name, unknown in settings.unknowns.items():
        check_name("unknowns", name, (*HYDRAULIC, *CAB, POLE))
        if not unknown.low < unknown.high or (unknown.scale == "log" and unknown.low <= 0.0):
            raise InputError(
                f"unknowns.{name}: {unknown.low:g} to {unknown.high:g} is refused; low must be "
                "less than high, and greater than 0 on a log scale"
            )
    if settings.draws & (settings.draws - 1):
        raise InputError(f"draws: {settings.draws} must be a power of 2, for Sobol's sequence")
    if settings.simulated > settings.kept:
        raise InputError(f"simulated: {settings.simulated} must be at most kept, {settings.kept}")
    chosen = tuple(load_law(law) for law in (settings.laws if laws is None else laws))
    check_distinct("laws", [law.name for law in chosen])
    cabs = tuple(load_cab(cab) for cab in settings.cabs)
    study = PosteriorStudy(settings, chosen, cabs, load_hydraulics(settings.hydraulics))
    for end in (0.0, 1.0):  # bounds that no machine can have are refused here
        values = study.values(np.full(len(settings.unknowns), end))
        for cab in cabs:
            study.plant(cab, values, study.hydraulics_of(values, None))
    return study
