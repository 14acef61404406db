"""Studies of the unknown as files: ranges of numbers nobody published, and what is run with them.

A study is a TOML file with ranges, laws and cabs. A machine is a value of each unknown, drawn
between its bounds, and valves and leaks that differ from leg to leg. `values` are in the units of
the file; factors and shifts change a shipped cab. A study of effects has plants beside that: a
plant is named after its effects, `lap+coulomb`, or `NONE`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, check_name, within
from cmf_mj.core.settings import Settings, check_distinct, validated
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns, Values
from cmf_mj.machine.cab import Cab, load_cabs
from cmf_mj.machine.machine import load_machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.report_2014.posterior.effects import EFFECTS
from cmf_mj.studies.settings import study_table

NONE, AVERAGE = "none", "average"  #: The plant without effects; the average over plants.
READINGS = ("simulated", "arx")  #: Effects of how results were read: shifts of predictions.


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


class EffectSettings(PosteriorSettings):
    """What a study of effects runs; `kept` machines of each plant fly the laws."""

    effects: Annotated[dict[str, Unknown], Field(min_length=1)]
    skipped: list[str] = []  #: Of the effects, in a quick study.
    pairs: Annotated[int, Field(ge=0)]  #: Best effects that are paired.
    made_up: Annotated[int, Field(ge=0)]  #: Reports made up of each plant.

    @property
    def used(self) -> dict[str, Unknown]:
        """Effects that are not skipped."""
        return {name: self.effects[name] for name in self.effects if name not in self.skipped}

    @property
    def readings(self) -> dict[str, str]:
        """Which of `READINGS` a used effect is, by its name."""
        kinds = {name: effect_kind(effect) for name, effect in self.used.items()}
        return {name: kind for name, kind in kinds.items() if kind in READINGS}


def effect_kind(effect: Unknown) -> str:
    """Name of a linear effect or reading; nothing for a path of the machine."""
    return effect.path.partition("effect.")[2]


def effect_names(plant: str) -> list[str]:
    """Names of the effects of a plant."""
    return [] if plant == NONE else plant.split("+")


@dataclass(frozen=True)
class PosteriorStudy:
    """A study with everything it refers to loaded."""

    settings: PosteriorSettings
    laws: tuple[Law, ...]
    cabs: tuple[Cab, ...]
    hydraulics: HydraulicParameters

    def identity(self) -> dict[str, Any]:
        """What the study runs, as JSON values, see `Journal`."""
        return {
            "settings": self.settings.model_dump(mode="json"),
            "laws": [law.model_dump(mode="json") for law in self.laws],
            "cabs": [cab.model_dump(mode="json") for cab in self.cabs],
            "hydraulics": self.hydraulics.model_dump(mode="json", exclude_none=True),
        }

    def values(self, quantiles: NDArray[np.float64]) -> dict[str, float]:
        """Values of the unknowns at a point of the unit cube, (n,)."""
        return Unknowns(self.settings.unknowns).at(quantiles)

    def hydraulics_of(self, values: Values, draw: int | None) -> HydraulicParameters:
        """The hydraulic set of a machine; `draw` numbers its mismatch, None has none."""
        legs_alike = Unknowns(self.settings.unknowns).apply(values, self.hydraulics)
        mismatch = Unknowns(self.settings.mismatch)
        deviations = {} if draw is None else mismatch.streams(self.settings.seed, draw)
        return mismatch.apply(deviations, legs_alike)

    def plant(self, cab: Cab, values: Values, hydraulics: HydraulicParameters) -> Hexapod:
        """The machine with a cab and its hydraulic set; laws take the cab for the shipped one."""
        return Hexapod(Unknowns(self.settings.unknowns).apply(values, cab), hydraulics)

    def law(self, law: Law, values: Values) -> Law:
        """A law with the derivative filter of a machine."""
        return Unknowns(self.settings.unknowns).apply(values, law)


def load_posterior(
    source: str | Path | dict[str, Any],
    *,
    laws: Sequence[str | Law] | None = None,
    changes: Mapping[str, Any] | None = None,
    quick: bool = False,
    settings_type: type[PosteriorSettings] = PosteriorSettings,
) -> PosteriorStudy:
    """Load a study of the unknown, its settings of `settings_type`.

    `source` is the name of a shipped specification, a TOML file or a table; `laws` stand in for its
    laws, `changes` replace its fields; a `quick` study has the fields of its table `quick`.
    """
    table, place = study_table(source)
    quick_fields = table.pop("quick", {})
    table |= (quick_fields if quick else {}) | dict(changes or {})
    if laws is not None:
        table["laws"] = [load_law(law).name for law in laws]
    settings = validated(settings_type, table, place)
    with within(place):
        return _checked_study(settings, laws)


def load_effects(source: Any, **options: Any) -> PosteriorStudy:
    """Load a study of effects; `options` as of `load_posterior`."""
    study = load_posterior(source, settings_type=EffectSettings, **options)
    settings = effect_settings(study)
    fewest, unknowns = 2 * (len(settings.unknowns) + 1), len(settings.unknowns)
    if settings.draws < fewest:
        allowed = f"at least {fewest}, as numbers are regressed on {unknowns} unknowns"
        raise InputError(f"draws: {settings.draws} is refused; allowed: {allowed}")
    _check_bounded("effects", settings.effects)
    for name, effect in settings.effects.items():
        if kind := effect_kind(effect):
            check_name(f"effects.{name}: path: effect", kind, (*EFFECTS, *READINGS))
    return study


def effect_settings(study: PosteriorStudy) -> EffectSettings:
    """What a study of effects runs."""
    return cast("EffectSettings", study.settings)


def _check_bounded(field: str, unknowns: Mapping[str, Unknown]) -> None:
    """Refuse by name what is not one number between bounds."""
    for name, unknown in unknowns.items():
        if unknown.shape() or unknown.low is None:
            raise InputError(f"{field}.{name}: allowed: one number between bounds, low and high")


def _checked_study(settings: PosteriorSettings, laws: Sequence[str | Law] | None) -> PosteriorStudy:
    """The study of settings that fit together; bounds that no machine can have are refused."""
    _check_bounded("unknowns", settings.unknowns)
    if settings.draws & (settings.draws - 1):
        raise InputError(f"draws: {settings.draws} must be a power of 2, for Sobol's sequence")
    if settings.simulated > settings.kept:
        raise InputError(f"simulated: {settings.simulated} must be at most kept, {settings.kept}")
    loaded_laws = tuple(load_law(law) for law in (settings.laws if laws is None else laws))
    check_distinct("laws", [law.name for law in loaded_laws])
    cabs = load_cabs(settings.cabs, load_machine())
    study = PosteriorStudy(settings, loaded_laws, cabs, load_hydraulics(settings.hydraulics))
    for bound in (0.0, 1.0):
        values = study.values(np.full(len(settings.unknowns), bound))
        for cab in cabs:
            study.plant(cab, values, study.hydraulics_of(values, None))
    return study
