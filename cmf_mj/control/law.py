"""Control laws as data: the gain tables of the report and a user's own.

Every law is the same block with other gains (Eqs 2.3 and 2.4 as the DCL runs them),

    x[k+1] = A x[k] + B u[k],    y[k] = C x[k] + D u[k],

with one scalar state a leg and u the ten `SIGNALS`, and with it, where a law has them, a
reference model, a plan, and dynamic load pressure feedback. All of it runs leg by leg, or mode by
mode of the hydraulics. Nothing in the code knows a law by name.

A table may say `based_on = "other"`: it then holds only what differs from that law, one of its own
file or a shipped one. A title that is left out is the name.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from cmf_mj.control.coordinates import Modes, PerMode
from cmf_mj.control.feedback import LoadFeedback
from cmf_mj.control.plan import Plan
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, unknown_name
from cmf_mj.core.settings import Name, Settings, checked_name, merged, read_toml, validated
from cmf_mj.core.units import FASTEST_RATE, RATE, SLOWEST_RATE
from cmf_mj.machine.machine import Machine, load_machine

SIGNAL_UNITS = {
    "reference": units.INCH,
    "cap_pressure": 1.0,
    "rod_pressure": 1.0,
    "position": units.INCH,
    "velocity": units.INCH,
    "position_error_rate": units.INCH,
    "velocity_error": units.INCH,
    "error_integral": units.INCH,
    "acceleration": units.INCH,
    "force": units.POUND_FORCE,
}
"""SI size of the unit each signal's gain counts in (in, Pa, in/s, in s, in/s^2, lbf)."""

SIGNALS = tuple(SIGNAL_UNITS)  #: Inputs u of the compensator, in order.

_FILES = {
    "report": Path(__file__).with_name("laws.toml"),
    "beyond": Path(__file__).with_name("laws_beyond.toml"),
}
"""Shipped laws: those of the report with what this project added to its block first, and others."""

_MODES = Path(__file__).with_name("modes.toml")  #: Hydraulic modes of the facility's cabs.


class Gains(Settings):
    """Gains of the ten signals, in per cent per published unit; absent ones are 0.

    In hydraulic modes a gain may be a list of six.
    """

    reference: PerMode = 0.0
    cap_pressure: PerMode = 0.0
    rod_pressure: PerMode = 0.0
    position: PerMode = 0.0
    velocity: PerMode = 0.0
    position_error_rate: PerMode = 0.0
    velocity_error: PerMode = 0.0
    error_integral: PerMode = 0.0
    acceleration: PerMode = 0.0
    force: PerMode = 0.0


class Adaptation(Settings):
    """Adaptation of a reference model's feed-forward to the speed of the leg.

    `cmf_mj.control.reference_model` gives the equations and what bounds the values.
    """

    rate: Annotated[float, Field(ge=0.0)]
    """Rate [1/s] at which a leg that is slow by its whole speed raises the factor; 0: fixed law."""
    slope: Annotated[float, Field(gt=0.0)]  #: Weight of the position error to its rate [1/s].
    corner: Annotated[float, Field(gt=0.0)]  #: Corner of the low-pass filters H [Hz].
    level: Annotated[float, Field(gt=0.0)]  #: Feed-forward, rms, that halves the correction [%].
    dead_zone: Annotated[float, Field(ge=0.0)] = 0.0  #: Error below which nothing is learnt [in/s].
    leak: Annotated[float, Field(ge=0.0)] = 0.0  #: Rate of the return to 1, below `rate` [1/s].
    lowest: Annotated[float, Field(gt=0.0, le=1.0)]  #: Least factor.
    highest: Annotated[float, Field(ge=1.0)]  #: Largest factor.


class ReferenceModel(Settings):
    """A model that the leg is to follow, and the gains that make it.

    With it, position error rate, velocity error and error integral are errors from the model.
    """

    natural_frequency: Annotated[float, Field(gt=0.0, le=50.0)]  #: Undamped natural frequency [Hz].
    damping_ratio: Annotated[float, Field(gt=0.0)]  #: Damping ratio.
    position: float = 0.0  #: Gain of model position less position [%/in].
    rate: float = 0.0  #: Gain of model velocity less velocity [%/(in/s)].
    velocity: float = 0.0  #: Feed-forward of the model's velocity [%/(in/s)].
    acceleration: float = 0.0  #: Feed-forward of the model's acceleration [%/(in/s^2)].
    adaptation: Adaptation | None = None  #: Absent: the fixed law.

    @property
    def reads_velocity(self) -> bool:
        """Whether the measured velocity acts on the command."""
        return self.rate != 0.0 or (self.adaptation is not None and self.adaptation.rate > 0.0)


class Law(Settings):
    """One control law: compensator gains and the filters of its signals.

    Gains are as published, per cent of valve command per inch, pascal, in/s, in s, in/s^2, lbf.

    >>> law = cmf_mj.load_law("velocity")
    >>> law.title, law.state_gain
    ('Velocity FB', 0.914)
    """

    name: Name  #: Name of the table.
    coordinates: Literal["legs", "hydraulic_modes"] = "legs"  #: What gains act on.
    modes: Mapping[str, Modes] = {}
    """Hydraulic modes by cab, or by plant where there is none; a law that is bound to a cab has
    those alone. A table of a law file without modes has the shipped ones, `modes.toml`."""
    rate: Annotated[int, Field(ge=SLOWEST_RATE, le=FASTEST_RATE)] = RATE
    """Control frames a second for which A, B and the accelerometer filter are given [Hz]."""
    machine: Machine = Field(default_factory=load_machine, exclude=True)
    """Motion base that it is bound to, whose stroke, areas and geometry count; default the CMF."""
    title: str = Field(min_length=1)  #: Name for figures and tables.
    source: str = ""  #: Where the gains come from.
    state_gain: Annotated[float, Field(gt=-1.0, lt=1.0)] = 0.0
    """A; the compensator's own state is stable for -1 < A < 1."""
    output_gain: float = 0.0  #: C [% per unit of state].
    input_gain: Gains = Gains()  #: B.
    direct_gain: Gains  #: D.
    derivative_pole: Annotated[float, Field(gt=0.0)] = 90.0
    """Corner p of the derivative filter s p / (s + p) [rad/s]; calibrated, the report prints
    none. Below twice the control rate, where the filter's forward integration is stable."""
    integrator_limit: Annotated[float, Field(gt=0.0)] = 50.0  #: Limit of the error integral [in s].
    integrator_trigger: Annotated[float, Field(ge=-40.0, le=37.5)] = -37.0
    """Leg position below which the integrator takes -37.5 in for it [in]: half an inch above
    the bottom stop (section 3.2.1), below which no leg comes. Legs of another working stroke have
    it as far above its lower end."""
    accelerometer_pole: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.9924
    """Pole of the accelerometer filter gain / (z - pole), Eq 3.6."""
    accelerometer_gain: float = 0.007588  #: Gain of the accelerometer filter, Eq 3.6.
    gravity_compensation: bool = True
    """Whether the law reads leg accelerations with gravity taken out (Appendix C); from ideal
    accelerometers, which feel none, nothing is taken out."""
    reference_model: ReferenceModel | None = None  #: A model to follow; absent: the demand.
    plan: Plan | None = None  #: A plan to follow, `[name.plan]`, instead of a reference model.
    load_feedback: LoadFeedback | None = None  #: Dynamic load pressure feedback.

    @model_validator(mode="after")
    def _check_coordinates(self) -> "Law":
        is_modal = self.coordinates == "hydraulic_modes"
        if is_modal != bool(self.modes):
            reason = "needs a table [modes.CAB] for each cab" if is_modal else "takes no modes"
            raise InputError(f"coordinates: {self.coordinates} {reason}")
        if self.plan is not None and self.reference_model is not None:
            raise InputError("plan: is not allowed beside a reference_model; choose one")
        if self.plan is not None and is_modal == (self.plan.frequency is not None):
            reason = "is not allowed, modes have their own" if is_modal else "is missing"
            raise InputError(f"plan.frequency: {reason}, for coordinates {self.coordinates}")
        lists = [
            f"{table}.{field}"
            for table in ("input_gain", "direct_gain", "plan", "load_feedback")
            for field, value in getattr(self, table) or ()
            if isinstance(value, tuple) and field != "pairs"
        ]
        if lists and not is_modal:
            raise InputError(f"{lists[0]}: a list needs coordinates hydraulic_modes; one number")
        return self

    @model_validator(mode="after")
    def _check_rates(self) -> "Law":
        if not self.derivative_pole < 2.0 * self.rate:
            raise InputError(
                f"derivative_pole: {self.derivative_pole:g} rad/s must be below twice the control "
                f"rate, {2.0 * self.rate:g} rad/s"
            )
        adaptation = self.reference_model.adaptation if self.reference_model else None
        if adaptation is not None and not adaptation.leak < self.rate:
            raise InputError(
                f"reference_model.adaptation.leak: {adaptation.leak:g} 1/s must be below the "
                f"control rate, {self.rate} 1/s"
            )
        return self

    def bound_to(self, cab: str) -> "Law":
        """The law with the modes of one cab alone, as the DCL, which knows its cab, runs it.

        That is `gfd`, `rfd` or `ifd`, or the name of a plant without cabs. A law in hydraulic modes
        that has none of this cab is refused.
        """
        if self.coordinates == "legs":
            return self
        if cab not in self.modes:
            raise InputError(
                f"modes: law {self.name} has none of {cab!r}; it has {', '.join(self.modes)}"
            )
        return self.model_copy(update={"modes": {cab: self.modes[cab]}})

    @property
    def frame(self) -> float:
        """Control frame T [s]."""
        return 1.0 / self.rate

    def for_machine(self, machine: Machine) -> "Law":
        """The law bound to a machine, at its control rate."""
        return self.at_rate(machine.rate).model_copy(update={"machine": machine})

    def at_rate(self, rate: int) -> "Law":
        """The same law at another control rate [Hz].

        A pole p becomes p' = p^(rate before / rate), and what enters its state is scaled by
        (1 - p') / (1 - p): the zero-order hold of the same first-order filter.

        Refused are a rate or derivative pole that the new frame does not allow, and a pole A below
        0, which has no decay in time.
        """
        if rate == self.rate:
            return self
        if self.state_gain < 0.0:
            raise InputError(
                f"state_gain: {self.state_gain} of law {self.name} is made for {self.rate} Hz "
                f"alone; it cannot run at {rate} Hz"
            )
        poles = np.array([self.state_gain, self.accelerometer_pole])
        state_pole, filter_pole = np.where(poles > 0.0, poles ** (self.rate / rate), 0.0).tolist()
        state_scale = (1.0 - state_pole) / (1.0 - self.state_gain)
        filter_scale = (1.0 - filter_pole) / (1.0 - self.accelerometer_pole)
        gains = {name: np.multiply(gain, state_scale).tolist() for name, gain in self.input_gain}
        changes = {
            "rate": rate,
            "state_gain": state_pole,
            "input_gain": gains,
            "accelerometer_pole": filter_pole,
            "accelerometer_gain": self.accelerometer_gain * filter_scale,
        }
        return validated(Law, dict(self) | changes, f"law {self.name}")

    @property
    def bound_modes(self) -> Modes | None:
        """Modes the law runs in; None for one in leg coordinates.

        A law that has those of several cabs is refused.
        """
        if self.coordinates == "legs":
            return None
        if len(self.modes) > 1:
            raise InputError(
                f"modes: law {self.name} has those of {', '.join(self.modes)}; choose one with "
                f"bound_to({next(iter(self.modes))!r})"
            )
        return next(iter(self.modes.values()))

    @property
    def reads_velocity(self) -> bool:
        """Whether the measured velocity acts on the command past the compensator."""
        if self.reference_model is not None and self.reference_model.reads_velocity:
            return True
        return self.plan is not None and bool(np.any(self.plan.velocity))


def _make_law(name: str, table: object, tables: dict[str, Any], where: str) -> Law:
    """One law from its table, laid over that of the law it is based on but for title and source."""
    if not isinstance(table, dict):
        raise InputError(f"{where}: {table!r} is refused: a law is a table [name]")
    if "based_on" in table:
        bases: dict[str, Any] = {}
        for laws in (*(_shipped_tables(family) for family in _FILES), tables):
            bases |= {k: v for k, v in laws.items() if isinstance(v, dict) and "based_on" not in v}
        base = table["based_on"]
        if not isinstance(base, str) or base not in bases:
            raise InputError(
                f"{where}: based_on: {base!r} is refused: allowed: {', '.join(bases)}, laws which "
                "are based on none"
            )
        inherited = {k: v for k, v in bases[base].items() if k not in ("title", "source")}
        table = merged(inherited, {k: v for k, v in table.items() if k != "based_on"})
    table = {"title": name} | table | {"name": name}
    if table.get("coordinates") == "hydraulic_modes":
        table = {"modes": read_toml(_MODES)} | table
    return validated(Law, table, where)


def _read_laws(path: Path) -> dict[str, Law]:
    """All laws of a file by name."""
    tables = read_toml(path)
    for name in tables:
        checked_name(name, f"{path.name}: name of the table")
    laws = {
        name: _make_law(name, table, tables, f"{path.name}: {name}")
        for name, table in tables.items()
    }
    if not laws:
        raise InputError(f"{path.name}: holds no law; a law is a table [name]")
    return laws


@cache
def _shipped_tables(family: str) -> dict[str, Any]:
    """The tables of a shipped file, read once; not to be changed."""
    return read_toml(_FILES[family])


@cache
def _shipped_laws() -> dict[str, Law]:
    """All shipped laws, made once; not to be changed."""
    return {name: law for path in _FILES.values() for name, law in _read_laws(path).items()}


def law_names(family: Literal["report", "beyond", "all"] = "report") -> tuple[str, ...]:
    """Names of the shipped laws of a family.

    `report`: its own in its order and then what this project added; `beyond`: others; or `all`.

    >>> cmf_mj.law_names()[:3]
    ('original', 'original_as_printed', 'velocity')
    """
    if family == "all":
        return law_names() + law_names("beyond")
    return tuple(_shipped_tables(family))


def law_source(machine: Machine, name: str) -> str:
    """What loads a law by name or file, the machine's own by the name in its file."""
    if name in law_names("all") or ".toml" in name:
        return name
    return machine.law if name == load_law(machine.law).name else name


def load_law(source: str | Path | Mapping[str, Any] | Law, machine: Machine | None = None) -> Law:
    """Load a control law.

    Args:
        source: name of a shipped law, path of a TOML file holding one law, `file.toml:name` for
            one of several, the keys of such a table as a dictionary (and `name`, by default
            `custom`), or a law already loaded.
        machine: whose own law goes by its name, too.

    >>> cmf_mj.load_law("acceleration").title, cmf_mj.load_law("velocity").source
    ('Acceleration FB (+)', 'Table 2-5')
    """
    if isinstance(source, Law):
        return source
    if isinstance(source, Mapping):
        name = source.get("name", "custom")
        if isinstance(name, str):
            checked_name(name, "law: name")
        return _make_law(name, dict(source), {}, f"law {name}")
    text = str(source) if machine is None else law_source(machine, str(source))
    if text in law_names("all"):
        return _shipped_laws()[text]
    stem, suffix, selector = text.rpartition(".toml")
    name = selector.removeprefix(":")
    if not suffix or (selector and name == selector):
        raise unknown_name("law", text, law_names("all"), " nor a .toml file")
    laws = _read_laws(Path(stem + ".toml"))
    if selector:
        if name not in laws:
            raise InputError(f"law: {name!r} is not in {stem}.toml; it has {', '.join(laws)}")
        return laws[name]
    if len(laws) > 1:
        raise InputError(
            f"law: {text} holds {', '.join(laws)}; choose one with {text}:{next(iter(laws))}"
        )
    return next(iter(laws.values()))
