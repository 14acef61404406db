"""The report's transfer functions by equation number, misprints put right; Table 4-1 computed."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, NamedTuple, get_args

import control
from pydantic import BeforeValidator, Field

from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.analysis.published import Names, published_results
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import result
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Settings, as_tuples, read_toml, validated
from cmf_mj.report_2014.second_order import FeedbackLoop, Variant, feedback_model

_FILE = Path(__file__).with_suffix(".toml")
_GAINS_FILE = Path(__file__).with_name("gains.toml")

Numbers = Annotated[tuple[float, ...], BeforeValidator(as_tuples)]
"""A list of numbers of a table."""


class PublishedGains(Settings):
    """One set of compensator gains as printed; units as in `control/laws.toml`."""

    table: str
    law: str
    a: float
    b: Numbers  #: B, a column a signal.
    c: float
    d: Numbers  #: D, a column a signal.
    signals: Names  #: What the columns act on.


@lru_cache
def published_gains() -> tuple[PublishedGains, ...]:
    """All gain tables, in the report's order."""
    rows = read_toml(_GAINS_FILE)["gains"]
    return tuple(
        validated(PublishedGains, row, f"{_GAINS_FILE.name}: gains {i}")
        for i, row in enumerate(rows)
    )


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
    formula: str = ""  #: Of an equation with parameters, `FeedbackLoop`.
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


def report_model(
    number: str, variant: Variant = "corrected", loop: FeedbackLoop | None = None
) -> UnitTransferFunction:
    """A transfer function of the report, e.g. `4.12`, in the report's units; `to_si` converts.

    `corrected` has a misprint put right and is else as printed. `loop` gives plant and gains for
    Eqs 3.1 to 3.4 and only for them. Eq 3.6 is discrete at 2048 Hz.
    """
    entry = report_entry(number, variant)
    if entry.formula:
        if loop is None:
            raise InputError(f"loop: Eq {number} needs a FeedbackLoop: {entry.formula}")
        return feedback_model(number, loop, variant)
    if loop is not None:
        raise InputError(f"loop: Eq {number} has coefficients and takes none")
    signals = {"input_unit": entry.input_unit, "output_unit": entry.output_unit}
    signals |= {"inputs": entry.input, "outputs": entry.output}
    signals["name"] = f"Eq_{number.replace('.', '_')}"
    frame = 0.0 if entry.rate is None else 1.0 / entry.rate
    return UnitTransferFunction(entry.numerator, entry.denominator, frame, **signals)


HARDWARE_MODELS = {1: "4.12", 2: "4.15", 3: "4.18"}
"""Linear models 1 to 3 of Table 4-1: equations of leg velocity per command."""


def hardware_velocity(number: int) -> UnitTransferFunction:
    """Leg velocity per command [in/s per %] of the report's linear model 1, 2 or 3."""
    if number not in HARDWARE_MODELS:
        raise InputError(f"number: {number} is not one of {', '.join(map(str, HARDWARE_MODELS))}")
    return report_model(HARDWARE_MODELS[number])


BANDWIDTH_TOLERANCE, DAMPING_TOLERANCE = 0.03, 0.1
"""Deviations from Table 4-1 [Hz and 1] that count as agreement."""


class LawLoop(NamedTuple):
    """A law around one of the report's hardware models."""

    law: Law
    model: int  #: Linear model 1 to 3.
    loop: control.StateSpace
    measures: Measures


def law_loops(laws: Sequence[str]) -> tuple[LawLoop, ...]:
    """Every law around linear models 1 to 3, pressures zero, as in Figure 4-5."""
    loops = []
    for law in [load_law(name) for name in laws]:
        for number in HARDWARE_MODELS:
            loop = closed_loop(law, hardware_velocity(number))
            loops.append(LawLoop(law, number, loop, measure_loop(loop)))
    return tuple(loops)


class TableRow(NamedTuple):
    """One entry of Table 4-1 and the computed one."""

    model: Annotated[int, result.Field(form="#{}".format)]  #: Linear model 1 to 3.
    equation: Annotated[str, result.Field(title="Eq")]  #: Of its velocity transfer function.
    quantity: str  #: `-90 deg`, `-3 dB`, or `damping` with its reading.
    unit: Annotated[str, result.Field(printed=False)]
    published: Annotated[float, result.Field(form=".2f")]
    computed: Annotated[float, result.Field(form=".3f")]
    deviation: Annotated[float, result.Field(form="+.3f")]  #: Computed minus published.
    tolerance: Annotated[float, result.Field(printed=False)]
    """Largest deviation that counts as within."""
    within: Annotated[bool, result.Field(printed=False)]

    @property
    def allowed(self) -> str:
        """The tolerance with its unit."""
        return f"{self.tolerance:g} {self.unit if self.unit != '1' else ''}".strip()


TABLE_4_1 = (
    *result.fields_of(TableRow),
    result.Field("", "allowed", "", of="allowed"),
    result.Field("", "", of=lambda row: "within" if row.within else "OUTSIDE"),
)

_LEGEND = (
    "damping from the step's overshoot over its final value (step) or over the demand (demand), or "
    "from the gain's peak over 0 dB (peak); the report does not say which. Hardware: -90 deg {} "
    "Hz, -3 dB {} Hz, damping {}"
)


def table_4_1() -> result.Result[TableRow]:
    """Table 4-1 computed: the velocity law around linear models 1 to 3, with the printed values.

    The damping ratio stands in all three readings, the hardware under the same law in the caption.
    """
    rows = []
    printed = {str(row.of): row for row in published_results() if row.table == "4-1"}
    for number, equation in HARDWARE_MODELS.items():
        ours = measure_loop(closed_loop("velocity", hardware_velocity(number)))
        row = printed[f"linear_{number}"]
        entries = [
            ("-90 deg", "Hz", row.phase_bandwidth_hz, ours.phase_bandwidth_hz),
            ("-3 dB", "Hz", row.gain_bandwidth_hz, ours.gain_bandwidth_hz),
            ("damping, step", "1", row.damping_ratio, ours.damping_ratio),
            ("damping, demand", "1", row.damping_ratio, ours.demand_damping_ratio),
            ("damping, peak", "1", row.damping_ratio, ours.peak_damping_ratio),
        ]
        for quantity, unit, stated, computed in entries:
            value = float("nan") if stated is None else stated
            tolerance = BANDWIDTH_TOLERANCE if unit == "Hz" else DAMPING_TOLERANCE
            off = computed - value
            name = (number, equation, quantity, unit)
            rows.append(TableRow(*name, value, computed, off, tolerance, abs(off) <= tolerance))
    machine = printed["hardware"]
    widths = machine.phase_bandwidth_hz, machine.gain_bandwidth_hz
    caption = _LEGEND.format(*widths, machine.damping_ratio)
    title = "Table 4-1: velocity law around linear models 1 to 3"
    return result.Result(rows, TABLE_4_1, title, caption, grouped=True)
