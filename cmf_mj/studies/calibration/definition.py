"""What a calibration study is: free parameters with ranges, published rows, tolerances."""

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from cmf_mj.analysis.measures import Measures
from cmf_mj.analysis.published import Published, published_results
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Name, Settings, read_toml, validated

_FILE = Path(__file__).with_name("studies.toml")

Measure = Literal["phase", "gain", "damping"]
"""Frequency of -90 deg, of -3 dB from absolute 0 dB, damping ratio from a step's overshoot."""

MEASURES: dict[Measure, str] = {
    "phase": "phase_bandwidth_hz",
    "gain": "gain_bandwidth_hz",
    "damping": "damping_ratio",
}
"""Fields of `Measures` and `Published` by measure."""

ParameterName = Literal[
    "leg_speed",
    "leak_rate",
    "derivative_pole",
    "bulk_modulus",
    "drive_lag",
    "valve_lag",
    "supply_pressure",
    "payload",
]

_Measures = Annotated[tuple[Measure, ...], Field(strict=False)]


def computed(measures: Measures, measure: Measure) -> float:
    """One of the `MEASURES`."""
    return float(getattr(measures, MEASURES[measure]))


class Parameter(Settings):
    """A number of the plant or the law, and the range its source allows."""

    name: ParameterName
    """A quantity of the hydraulic set, `derivative_pole` of all laws, or `payload`, a factor."""
    unit: str
    low: float
    high: float
    free: bool = False  #: Fitted; otherwise it only enters the uncertainty.
    source: str = Field(min_length=1)  #: Where the range comes from.

    @model_validator(mode="after")
    def _ordered(self) -> "Parameter":
        if not 0.0 < self.low < self.high:
            raise InputError(
                f"{self.name}: low {self.low:g} must be above 0 and below high {self.high:g}"
            )
        return self


class Row(Settings):
    """A published result and what is done with its quantities."""

    table: str
    law: str
    of: str
    fitted: _Measures = ()
    predicted: _Measures = ()  #: Held back: computed and compared, but nothing is fitted to it.

    @property
    def published(self) -> Published:
        """The printed numbers."""
        for row in published_results():
            if (row.table, row.law, row.of, row.dof) == (self.table, self.law, self.of, "heave"):
                return row
        raise InputError(f"rows: Table {self.table} has no {self.law} of {self.of} in heave")

    def printed(self, measure: Measure) -> float:
        """A printed number, NaN where there is none."""
        value = getattr(self.published, MEASURES[measure])
        return float("nan") if value is None else float(value)


class Tolerance(Settings):
    """Deviations that count as one."""

    phase: Annotated[float, Field(gt=0.0)]  #: Relative.
    gain: Annotated[float, Field(gt=0.0)]  #: Relative.
    damping: Annotated[float, Field(gt=0.0)]  #: Absolute.


class Study(Settings):
    """One calibration."""

    name: Name
    title: str
    hydraulics: str  #: Hydraulic set: starting values, and all that is not a parameter.
    plant: Literal["hexapod", "single_legs"]
    cab: str = ""  #: Of the hexapod.
    tolerance: Tolerance  #: Scales of the residuals, and what counts as met.
    stable_cabs: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Cabs with which the velocity law must be stable in six degrees of freedom."""
    least_damping: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Least damping ratio of the velocity law's loop with each of these cabs."""
    parameters: Annotated[tuple[Parameter, ...], Field(strict=False)]
    rows: Annotated[tuple[Row, ...], Field(strict=False)]

    @model_validator(mode="after")
    def _sound(self) -> "Study":
        for row in self.rows:
            for measure in (*row.fitted, *row.predicted):
                if row.printed(measure) != row.printed(measure):
                    raise InputError(f"rows: Table {row.table} prints no {measure} of {row.law}")
            if set(row.fitted) & set(row.predicted):
                raise InputError(
                    f"rows: Table {row.table}, {row.law}: a quantity is fitted and predicted"
                )
        free = len(self.free)
        fitted = sum(len(row.fitted) for row in self.rows)
        if not 0 < free <= fitted:
            raise InputError(f"parameters: {free} are free; allowed: 1 to the {fitted} fitted")
        return self

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are fitted."""
        return tuple(parameter for parameter in self.parameters if parameter.free)

    @property
    def laws(self) -> tuple[str, ...]:
        """Laws of all rows, once each."""
        return tuple(dict.fromkeys(row.law for row in self.rows))


@lru_cache
def load_studies() -> dict[str, Study]:
    """The shipped studies by name."""
    return {
        name: validated(Study, table | {"name": name}, f"{_FILE.name}: {name}")
        for name, table in read_toml(_FILE).items()
    }


def load_study(name: str) -> Study:
    """A shipped study by name."""
    studies = load_studies()
    return studies[check_name("study", name, studies)]
