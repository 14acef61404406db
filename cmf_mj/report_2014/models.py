"""The report's transfer functions by equation number."""

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import BeforeValidator, Field

from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.analysis.published import Published, published_results
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Settings, as_tuples, read_toml, validated

_FILE = Path(__file__).with_suffix(".toml")

Variant = Literal["printed", "corrected"]
"""Which reading of an equation: as printed, or with its misprint put right."""

Numbers = Annotated[tuple[float, ...], BeforeValidator(as_tuples)]  #: A list of numbers of a table.


class Correction(Settings):
    """What differs from the print, and why."""

    reason: str = Field(min_length=1)
    model: str | None = None
    numerator: Numbers | None = None
    denominator: Numbers | None = None
    formula: str | None = None


class ReportModel(Settings):
    """One numbered transfer function of the report."""

    number: str  #: Of the equation.
    model: str = ""  #: The name the report gives the set it belongs to.
    title: str  #: What it is.
    section: str  #: Where it stands.
    input: str  #: Label of the input.
    input_unit: str  #: Unit of the input.
    output: str  #: Label of the output.
    output_unit: str  #: Unit of the output.
    unit_evidence: str = ""  #: How the units are known; the report prints none.
    numerator: Numbers = ()
    """Coefficients, highest power first; empty where a formula takes parameters."""
    denominator: Numbers = ()
    rate: float | None = Field(default=None, gt=0.0)  #: Sampling rate of a discrete one [Hz].
    formula: str = ""  #: Of an equation with parameters.
    note: str = ""  #: What to know before trusting it.
    corrected: Correction | None = None  #: What the print has wrong.

    @property
    def variants(self) -> tuple[Variant, ...]:
        """`printed`, and `corrected` where there is a misprint."""
        return ("printed", "corrected") if self.corrected else ("printed",)

    def read(self, variant: Variant) -> "ReportModel":
        """The entry as printed, or with its correction put in."""
        if variant == "printed" or self.corrected is None:
            return self
        changed = self.corrected.model_dump(exclude_none=True, exclude={"reason"})
        return self.model_copy(update=changed)


@lru_cache
def report_models() -> tuple[ReportModel, ...]:
    """All transfer functions of sections 3.4 and 4, in the report's order."""
    rows = read_toml(_FILE)["model"]
    return tuple(
        validated(ReportModel, row, f"{_FILE.name}: {row.get('number', i)}")
        for i, row in enumerate(rows)
    )


def report_entry(number: str, variant: Variant = "corrected") -> ReportModel:
    """The entry of an equation; `corrected` is the print where nothing is wrong with it."""
    check_name("variant", variant, get_args(Variant))
    entries = {entry.number: entry for entry in report_models()}
    return entries[check_name("number", number, entries)].read(variant)


def report_model(number: str, variant: Variant = "corrected") -> UnitTransferFunction:
    """A transfer function of the report, e.g. `4.12`, in the report's units; `to_si` converts.

    `corrected` has a misprint put right and is else as printed. Eq 3.6 is discrete at 2048 Hz; Eqs
    3.1 to 3.4, formulas without numbers, are refused.
    """
    entry = report_entry(number, variant)
    if entry.formula:
        raise InputError(f"number: Eq {number} has no coefficients: {entry.formula}")
    signals = {"input_unit": entry.input_unit, "output_unit": entry.output_unit}
    signals |= {"inputs": entry.input, "outputs": entry.output}
    signals["name"] = f"Eq_{number.replace('.', '_')}"
    frame = 0.0 if entry.rate is None else 1.0 / entry.rate
    return UnitTransferFunction(entry.numerator, entry.denominator, frame, **signals)


HARDWARE_MODELS = {1: "4.12", 2: "4.15", 3: "4.18"}
"""Linear models 1 to 3 of Table 4-1: equations of leg velocity per command."""


def printed_table_4_1() -> dict[str, Published]:
    """Results of Table 4-1: of the hardware and, as `linear_1` to `linear_3`, of these models."""
    return {str(row.of): row for row in published_results() if row.table == "4-1"}


def hardware_velocity(number: int) -> UnitTransferFunction:
    """Leg velocity per command [in/s per %] of the report's linear model 1, 2 or 3."""
    if number not in HARDWARE_MODELS:
        raise InputError(f"number: {number} is not one of {', '.join(map(str, HARDWARE_MODELS))}")
    return report_model(HARDWARE_MODELS[number])
