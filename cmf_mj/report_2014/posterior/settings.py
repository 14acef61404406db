"""A study of the unknown: ranges of the numbers nobody published, laws and cabs, as a TOML file.

A machine is a value of each unknown, drawn between its bounds, and valves and leaks that differ
from leg to leg. `values` are in the units of the file; factors and shifts change a shipped cab.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, within
from cmf_mj.core.settings import Settings, check_distinct, validated
from cmf_mj.facility.unknowns import Unknown, Unknowns
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.studies.settings import study_table


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
    gains: list[float]  #: Of acceleration that are tried [%/(in/s^2)].
    corners: list[Annotated[float, Field(ge=0.0)]]
    """Corners of the accelerometer's filter that they are tried behind [Hz]; 0 for no filter."""
    unknowns: Annotated[dict[str, Unknown], Field(min_length=1)]
    mismatch: dict[str, Unknown]  #: What scatters from leg to leg, by `draw`.


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
        return Unknowns(self.settings.unknowns).at(quantiles)

    def hydraulics_of(self, values: Mapping[str, float], draw: int | None) -> HydraulicParameters:
        """The hydraulic set of a machine; `draw` numbers its mismatch, None has none."""
        made = Unknowns(self.settings.unknowns).apply(values, self.hydraulics)
        mismatch = Unknowns(self.settings.mismatch)
        scatter = {} if draw is None else mismatch.streams(self.settings.seed, draw)
        return mismatch.apply(scatter, made)

    def plant(self, cab: Cab, values: Mapping[str, float], oil: HydraulicParameters) -> Hexapod:
        """The machine with a cab and its hydraulic set; laws take the cab for the shipped one."""
        return Hexapod(Unknowns(self.settings.unknowns).apply(values, cab), oil)

    def law(self, law: Law, values: Mapping[str, float]) -> Law:
        """A law with the derivative filter of a machine."""
        return Unknowns(self.settings.unknowns).apply(values, law)


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
    for name, one in settings.unknowns.items():
        if one.shape or one.low is None:
            raise InputError(f"unknowns.{name}: allowed: one number between bounds, low and high")
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
