"""Parameters of the washouts, read from `washouts.toml` or a file of the user.

A set is a table with `kind`, `classical` or `optimal`; its numbers have unit, status and source.
"""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text
from cmf_mj.core.quantity import Kind, Quantity, positive_in
from cmf_mj.core.settings import Loader, Name, Settings, validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.geometry import DOFS

WASHOUTS = ("simona", "reid_nahon", "optimal", "predictive")  #: Names of the shipped sets.

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
Share = Annotated[Quantity, AfterValidator(Kind(("1",), at_most=1.0).check)]
Time = Annotated[Quantity, positive_in("s")]
Price = Annotated[Quantity, AfterValidator(Kind(("1/s",), zero=True).check)]


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

    name: Name
    title: str = Field(min_length=1)
    source: str = Field(min_length=1)

    _gains: ClassVar[tuple[tuple[str, str], ...]]  #: Table and key of the gains of surge to yaw.

    @property
    def gains(self) -> NDArray[np.float64]:
        """Gains of surge to yaw, (6,)."""
        return np.array([getattr(getattr(self, table), key).si for table, key in self._gains])


class ClassicalSettings(_Set):
    """A classical washout."""

    _gains: ClassVar = tuple((dof, "gain") for dof in DOFS)
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
            zeta, most = min(axis.low_pass_damping.si, 0.99), STANDARD_GRAVITY
            # Largest output of the low-pass over its largest input: the L1 norm of its response.
            most *= np.tanh(0.5 * np.pi * zeta / np.sqrt(1.0 - zeta**2))
            if not (limit := self.inputs.tilt_force_limit).si < most:
                fault = f"{limit} must be less than {most:.3g} m/s^2: the low-pass of {dof} may"
                raise InputError(f"inputs.tilt_force_limit: {fault} overshoot to 1 g")
        return self


class RotationSizes(Settings):
    """Sizes at which each part of the cost of yaw counts one (Bryson's rule)."""

    gain: Gain  #: Share of the aircraft's angular rate.
    rate_error: Rate  #: Error of the rate sensed.
    angle_integral: AngleIntegral
    angle: Angle
    rate: Rate  #: Rate of the simulator.
    rate_bandwidth: Corner
    """Corner of the first-order noise as which the aircraft's rate is modelled."""


class TranslationSizes(Settings):
    """Sizes of heave, likewise."""

    gain: Gain  #: Share of the aircraft's specific force, less that of level rest.
    force_error: Force  #: Error of the specific force sensed.
    position_integral: DistanceIntegral
    position: Distance
    velocity: Speed
    acceleration: Force  #: Acceleration of the simulator.
    force_bandwidth: Corner
    """Corner of the first-order noise as which the aircraft's specific force is modelled."""


class TiltingSizes(TranslationSizes):
    """Sizes of surge with pitch, or sway with roll, likewise."""

    rate_gain: Gain  #: Share of the aircraft's angular rate.
    rate_error: Rate  #: Error of the rate sensed.
    angle: Angle
    rate: Rate  #: Rate of the simulator.
    rate_bandwidth: Corner
    """Corner of the first-order noise as which the aircraft's rate is modelled."""


class OptimalSettings(_Set):
    """An optimal washout."""

    _gains: ClassVar = (
        *(("pitch_surge", "gain"), ("roll_sway", "gain"), ("heave", "gain")),
        *(("roll_sway", "rate_gain"), ("pitch_surge", "rate_gain"), ("yaw", "gain")),
    )
    kind: Literal["optimal"]
    inputs: Inputs
    pitch_surge: TiltingSizes
    roll_sway: TiltingSizes
    yaw: RotationSizes
    heave: TranslationSizes


class Prediction(Settings):
    """Horizon and constraints of a predictive washout."""

    reference: Literal["constant", "guess", "known"]  #: What is taken of the aircraft ahead.
    knots: int = Field(ge=2, le=60)  #: Of the horizon.
    iterations: int = Field(ge=1)  #: Of the solver, at most.
    horizon: Time
    guess_time: Time  #: T of the guess.
    guess_lag: Time  #: Time constant of its slope.
    guess_fade: Time  #: T_f, with which it fades.
    share: Share  #: Of travel, speed and acceleration, of legs and pose, that a plan may use.
    tilt_rate: Rate  #: Largest rate against or beyond the aircraft's, in roll and pitch.
    price: Ratio  #: Of passing a limit of legs or pose by all of itself, in units of the cost.
    tilt_price: Ratio  #: Likewise of passing the tilt rate.
    approach: Time  #: T_n, with which legs and pose come near to limits of travel and speed.
    foresight: Gain  #: What is added to it for each second ahead.
    smoothing: Time  #: In which a rate or acceleration of its size may build up: no plan rings.
    false_cue: Ratio  #: Specific force sensed against or beyond the aircraft's, over its threshold.
    false_price: Price  #: Of passing it by a threshold for a second.


class PredictiveSettings(OptimalSettings):
    """A predictive washout: sizes of the cost as for an optimal one, and a horizon."""

    kind: Literal["predictive"]  # type: ignore[assignment]
    prediction: Prediction


WashoutSettings = ClassicalSettings | OptimalSettings | PredictiveSettings
"""Parameters of any washout."""

_KINDS: dict[str, Any] = {"optimal": OptimalSettings, "predictive": PredictiveSettings}


def load_washout(source: str | Path | WashoutSettings = "simona") -> WashoutSettings:
    """Load the parameters of a washout.

    `source` is `simona`, `reid_nahon` or `optimal`; a TOML file with `base` naming one of them and
    one table of changes, merged table by table; or parameters already loaded.
    """
    if isinstance(source, ClassicalSettings | OptimalSettings):
        return source
    sets = Loader(Settings, _FILE, what="washout", names=WASHOUTS, fixed=("kind",))
    table, where = sets.table(source)
    return validated(_KINDS.get(table["kind"], ClassicalSettings), table, where)


def save_washout(settings: WashoutSettings, path: str | Path) -> Path:
    """Write parameters as a TOML file that `load_washout` reads back."""
    base = settings.kind if settings.kind in _KINDS else "simona"
    table = settings.model_dump(mode="json", exclude={"name", "kind"})
    return write_text(Path(path), tomlkit.dumps({"base": base, settings.name: table}))
