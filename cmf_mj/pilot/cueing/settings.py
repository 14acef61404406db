"""Parameters of the washouts, read from `washouts.toml` or a file of the user.

A set is a table with `kind`, `classical` or `optimal`; its numbers have unit, status and source.
"""

import json
from abc import abstractmethod
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text
from cmf_mj.core.quantity import Kind, Quantity, positive_in
from cmf_mj.core.settings import Settings, named_set, validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.kinematics import DOFS

WASHOUTS = ("simona", "reid_nahon", "optimal")
"""Names of the shipped sets."""

_FILE = Path(__file__).with_name("washouts.toml")

Gain = Annotated[Quantity, AfterValidator(Kind(("1",), zero=True).check)]
Ratio = Annotated[Quantity, positive_in("1")]
Corner = Annotated[Quantity, positive_in("rad/s", "Hz")]
Break = Annotated[Quantity, AfterValidator(Kind(("rad/s", "Hz"), zero=True).check)]
Force = Annotated[Quantity, positive_in("m/s^2", "g")]
Rate = Annotated[Quantity, positive_in("rad/s", "deg/s")]
Angle = Annotated[Quantity, positive_in("rad", "deg")]
AngleIntegral = Annotated[Quantity, positive_in("rad s", "deg s")]
Distance = Annotated[Quantity, positive_in("m", "in")]
DistanceIntegral = Annotated[Quantity, positive_in("m s")]
Speed = Annotated[Quantity, positive_in("m/s", "in/s")]
Time = Annotated[Quantity, positive_in("s")]


class Inputs(Settings):
    """Limits on what a washout takes in, after the gains; both kinds have them."""

    force_limit: Force  #: Largest specific force, less that of level rest, along each axis.
    rate_limit: Rate  #: Largest angular rate about each axis.


class TiltInputs(Inputs):
    """Limits of a classical washout, tilt coordination included."""

    tilt_force_limit: Force  #: Largest specific force that tilt imitates.
    tilt_rate: Rate  #: Largest rate of the tilt angle.
    tilt_recovery: Time  #: Time constant with which a tilt that was held back joins its demand.


class HighPass(Settings):
    """Gain and second-order high-pass of a rotation."""

    gain: Gain  #: Share of the aircraft's angular rate.
    natural_frequency: Corner
    damping: Ratio


class ThirdOrder(HighPass):
    """Gain, second-order and first-order high-pass of heave."""

    gain: Gain  #: Share of the aircraft's specific force, less that of level rest.
    break_frequency: Break  #: Corner of the first-order high-pass; 0 leaves it out.


class Tilted(ThirdOrder):
    """Gain and filters of surge or sway, which tilt coordination completes."""

    low_pass_frequency: Corner  #: Natural frequency of the low-pass before tilt coordination.
    low_pass_damping: Ratio


class _Set(Settings):
    """What all sets share."""

    name: str = Field(min_length=1)
    title: str = Field(min_length=1)
    source: str = Field(min_length=1)

    @property
    @abstractmethod
    def gains(self) -> NDArray[np.float64]:
        """Gains of surge to yaw, (6,)."""

    @abstractmethod
    def with_gains(self, gains: NDArray[np.float64]) -> "WashoutSettings":
        """The set with other gains (6,); their status is `derived`."""


def _tuned(value: float) -> dict[str, Any]:
    return {"value": value, "unit": "1", "status": "derived", "source": "set by hand or tuning"}


class ClassicalSettings(_Set):
    """A classical washout."""

    kind: Literal["classical"]
    inputs: TiltInputs
    surge: Tilted
    sway: Tilted
    heave: ThirdOrder
    roll: HighPass
    pitch: HighPass
    yaw: HighPass

    @model_validator(mode="after")
    def _tilt_in_range(self) -> "ClassicalSettings":
        for dof, axis in (("surge", self.surge), ("sway", self.sway)):
            zeta = axis.low_pass_damping.si
            # Largest output of the low-pass over its largest input: the L1 norm of its response.
            overshoot = 1.0
            if zeta < 1.0:
                overshoot = 1.0 / np.tanh(0.5 * np.pi * zeta / np.sqrt(1.0 - zeta**2))
            most = STANDARD_GRAVITY / overshoot
            if not self.inputs.tilt_force_limit.si < most:
                raise InputError(
                    f"inputs.tilt_force_limit: {self.inputs.tilt_force_limit} must be less than "
                    f"{most:.3g} m/s^2: the low-pass of {dof} may overshoot to 1 g"
                )
        return self

    @property
    def gains(self) -> NDArray[np.float64]:
        """Gains of surge to yaw, (6,)."""
        return np.array([getattr(self, dof).gain.si for dof in DOFS])

    def with_gains(self, gains: NDArray[np.float64]) -> "ClassicalSettings":
        """The set with other gains (6,); their status is `derived`."""
        table = self.model_dump()
        for dof, gain in zip(DOFS, gains, strict=True):
            table[dof]["gain"] = _tuned(float(gain))
        return validated(ClassicalSettings, table, self.name)


class Sizes(Settings):
    """Sizes at which each part of an optimal washout's cost counts one (Bryson's rule)."""


class RotationSizes(Sizes):
    """Cost of yaw."""

    gain: Gain  #: Share of the aircraft's angular rate.
    rate_error: Rate  #: Error of the rate sensed.
    angle_integral: AngleIntegral
    angle: Angle
    rate: Rate  #: Rate of the simulator.
    rate_bandwidth: Corner
    """Corner of the first-order noise that the aircraft's rate is taken for."""


class TranslationSizes(Sizes):
    """Cost of heave."""

    gain: Gain  #: Share of the aircraft's specific force, less that of level rest.
    force_error: Force  #: Error of the specific force sensed.
    position_integral: DistanceIntegral
    position: Distance
    velocity: Speed
    acceleration: Force  #: Acceleration of the simulator.
    force_bandwidth: Corner
    """Corner of the first-order noise that the aircraft's specific force is taken for."""


class TiltingSizes(TranslationSizes):
    """Cost of surge with pitch, or sway with roll."""

    rate_gain: Gain  #: Share of the aircraft's angular rate.
    rate_error: Rate  #: Error of the rate sensed.
    angle: Angle
    rate: Rate  #: Rate of the simulator.
    rate_bandwidth: Corner
    """Corner of the first-order noise that the aircraft's rate is taken for."""


class OptimalSettings(_Set):
    """An optimal washout."""

    kind: Literal["optimal"]
    inputs: Inputs
    pitch_surge: TiltingSizes
    roll_sway: TiltingSizes
    yaw: RotationSizes
    heave: TranslationSizes

    @property
    def gains(self) -> NDArray[np.float64]:
        """Gains of surge to yaw, (6,)."""
        surge, sway = self.pitch_surge, self.roll_sway
        order = (surge.gain, sway.gain, self.heave.gain, sway.rate_gain, surge.rate_gain)
        return np.array([gain.si for gain in (*order, self.yaw.gain)])

    def with_gains(self, gains: NDArray[np.float64]) -> "OptimalSettings":
        """The set with other gains (6,); their status is `derived`."""
        table = self.model_dump()
        fields = ("gain", "gain", "gain", "rate_gain", "rate_gain", "gain")
        modes = ("pitch_surge", "roll_sway", "heave", "roll_sway", "pitch_surge", "yaw")
        for mode, field, gain in zip(modes, fields, gains, strict=True):
            table[mode][field] = _tuned(float(gain))
        return validated(OptimalSettings, table, self.name)


WashoutSettings = ClassicalSettings | OptimalSettings
"""Parameters of any washout."""

_KINDS: dict[str, type[ClassicalSettings] | type[OptimalSettings]] = {
    "classical": ClassicalSettings,
    "optimal": OptimalSettings,
}


def load_washout(source: str | Path | WashoutSettings = "simona") -> WashoutSettings:
    """Load the parameters of a washout.

    Args:
        source: `simona`, `reid_nahon`, `optimal`; a TOML file with `base` naming one of them and
            one table of changes, merged table by table; or parameters already loaded.

    Raises:
        InputError: unknown set, unreadable file or a refused field; each is named.
    """
    if isinstance(source, ClassicalSettings | OptimalSettings):
        return source
    table, where = named_set("washout", WASHOUTS, _FILE, source, fixed=("kind",))
    return validated(_KINDS[table["kind"]], table, where)


def save_washout(settings: WashoutSettings, path: str | Path) -> Path:
    """Write parameters as a TOML file that `load_washout` reads back."""
    target = Path(path)
    base = "optimal" if settings.kind == "optimal" else "simona"
    lines = [f'base = "{base}"', "", f"[{_quoted(settings.name)}]"]
    tables = settings.model_dump(exclude={"name", "kind"})
    lines += [f"{key} = {_quoted(text)}" for key, text in tables.items() if isinstance(text, str)]
    for key, table in tables.items():
        if isinstance(table, dict):
            lines += ["", f"[{_quoted(settings.name)}.{key}]"]
            lines += [f"{name} = {_inline(quantity)}" for name, quantity in table.items()]
    write_text(target, "\n".join(lines) + "\n")
    return target


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _inline(quantity: dict[str, Any]) -> str:
    parts = (
        f"{key} = {_quoted(part) if isinstance(part, str) else repr(part)}"
        for key, part in quantity.items()
    )
    return f"{{ {', '.join(parts)} }}"
