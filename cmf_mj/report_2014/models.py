"""The report's transfer functions by equation number, and the second-order analysis of section 3.4.

The plant of Eq 3.1 with feedback of its position, rate and acceleration (Figure 3-12) is

    G_3 = w^2 / ((1 + K_a w^2) s^2 + (2 zeta w + K_r w^2) s + (1 + K_p) w^2)           Eq 3.4

and so again of second order: with a = 1 + K_a w^2 and b = 1 + K_p

    natural frequency  w sqrt(b / a),   damping ratio  (2 zeta + K_r w) / (2 sqrt(a b)),
    gain at rest       1 / b

Eqs 3.1 to 3.3 are this with gains left at zero. Position feedback raises the frequency and lowers
the damping ratio, rate feedback damps, acceleration feedback adds mass: it lowers both.
"""

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, get_args

from pydantic import BeforeValidator, Field

from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.settings import Settings, as_tuples, read_toml, validated

_FILE = Path(__file__).with_suffix(".toml")

Variant = Literal["printed", "corrected"]
"""Which reading of an equation: as printed, or with its misprint put right."""

GAINS = ("position_gain", "rate_gain", "acceleration_gain")
"""The three gains in the order of Eqs 3.2 to 3.4."""

_USED = {"3.1": 0, "3.2": 1, "3.3": 2, "3.4": 3}  #: How many of the gains each equation has.


class FeedbackLoop(NamedTuple):
    """A plant of second order and the gains of the feedback around it (Figure 3-12)."""

    natural_frequency: float  #: w of the plant [rad/s].
    damping_ratio: float  #: zeta of the plant.
    position_gain: float = 0.0  #: K_p.
    rate_gain: float = 0.0  #: K_r [s].
    acceleration_gain: float = 0.0  #: K_a [s^2].


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


def _checked(loop: FeedbackLoop) -> tuple[float, float]:
    """The factors a and b of the module's equations."""
    if not loop.natural_frequency > 0.0:
        raise InputError(f"natural_frequency: {loop.natural_frequency} rad/s must be above 0")
    a = 1.0 + loop.acceleration_gain * loop.natural_frequency**2
    b = 1.0 + loop.position_gain
    if not a > 0.0:
        least = -1.0 / loop.natural_frequency**2
        raise InputError(f"acceleration_gain: {loop.acceleration_gain} s^2 must be above {least:g}")
    if not b > 0.0:
        raise InputError(f"position_gain: {loop.position_gain} must be above -1")
    return a, b


def feedback_model(
    number: str, loop: FeedbackLoop, variant: Variant = "corrected"
) -> UnitTransferFunction:
    """Eq 3.1, 3.2, 3.3 or 3.4 with numbers; gains that the equation lacks are ignored.

    As printed, Eq 3.2 closes the loop with a gain of 1 whatever K_p is.
    """
    used_gains = GAINS[: _USED[check_name("number", number, _USED)]]
    gains = {name: getattr(loop, name) for name in used_gains}
    if number == "3.2" and variant == "printed":
        gains["position_gain"] = 1.0
    used = FeedbackLoop(loop.natural_frequency, loop.damping_ratio, **gains)
    a, b = _checked(used)
    square = used.natural_frequency**2
    damping = 2.0 * used.damping_ratio * used.natural_frequency + used.rate_gain * square
    below, name = [a, damping, b * square], f"Eq_{number.replace('.', '_')}"
    signals = {"inputs": "command", "outputs": "position", "name": name}
    return UnitTransferFunction([square], below, 0.0, input_unit="1", output_unit="1", **signals)
