"""The report's tables of results, to compare with. They never enter a computation."""

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator

from cmf_mj.core.settings import Settings, as_tuples, read_toml, validated

_FILE = Path(__file__).with_suffix(".toml")
_LAWS_OF_ROWS = {
    ("D-2", "acceleration"): "acceleration_d2",
    ("3-2", "combined_rate"): "combined_rate_1_8",
}
"""The law of `laws.toml` that a row is of, by table and printed law, where the names differ."""
_AS_PRINTED = {"acceleration": "acceleration_eq_3_6"}
"""The law with the printed filter, by the law that the report names."""
_READINGS = {
    "acceleration_eq_3_6": "acceleration",
    "acceleration_opposing": "acceleration",
    "combined_rate": "combined_rate",
    "original_as_printed": "original",
}
"""Other readings of a law's gains, compared with all rows that name the law."""

Names = Annotated[tuple[str, ...], BeforeValidator(as_tuples)]  #: A list of names of a table.


class Published(Settings):
    """One published result."""

    table: str  #: Table or section of the report.
    law: str  #: As the report names it.
    dof: str  #: Degree of freedom of the demand.
    of: Literal["hardware", "nonlinear", "linear_1", "linear_2", "linear_3"]
    """Measured on: the machine, the report's non-linear model or a linear model."""
    phase_bandwidth_hz: float | None = None
    gain_bandwidth_hz: float | None = None
    damping_ratio: float | None = None
    oscillation_hz: float | None = None  #: Of the legs after a step.
    acceleration_g: float | None = None  #: Of the legs after a step: at least this.
    not_available: Names = ()  #: Quantities that the report prints N/A for.

    @property
    def read_as(self) -> str:
        """The law of `laws.toml` whose results these are."""
        return _LAWS_OF_ROWS.get((self.table, self.law), self.law)

    @property
    def printed_as(self) -> str:
        """The law of `laws.toml` with gains and filter as printed."""
        return _AS_PRINTED.get(self.law, self.law)

    def is_of(self, law: str) -> bool:
        """Whether a law of `laws.toml` is compared with this row."""
        return law == self.read_as or _READINGS.get(law) == self.law


@lru_cache
def published_results() -> tuple[Published, ...]:
    """All rows, in the report's order."""
    rows, name = read_toml(_FILE)["result"], _FILE.name
    return tuple(validated(Published, row, f"{name}: result {i}") for i, row in enumerate(rows))


def published(law: str, dof: str, hydraulics: str) -> Published | None:
    """The published result to compare a run with, or None.

    Runs with the `report` hydraulics are compared with the report's non-linear model; others
    with the hardware where it was measured, with the non-linear model where it was not.
    """
    rows = {row.of: row for row in published_results() if row.dof == dof and row.is_of(law)}
    sources = ("nonlinear",) if hydraulics == "report" else ("hardware", "nonlinear")
    for source in sources:
        if source in rows and rows[source].phase_bandwidth_hz is not None:
            return rows[source]
    return None
