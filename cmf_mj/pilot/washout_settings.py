"""Parameters of the washouts, read from `washouts.toml` or a file of the user.

A set is a table with `kind`, `classical`, `optimal` or `predictive`; its numbers have unit, status
and source.
"""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text
from cmf_mj.core.quantity import (
    Acceleration,
    Angle,
    AngularSpeed,
    Corner,
    Kind,
    Length,
    Quantity,
    Ratio,
    Speed,
    Time,
    positive_in,
)
from cmf_mj.core.settings import Loader, Name, Settings, validated
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.geometry import DOFS

WASHOUTS = ("simona", "reid_nahon", "optimal", "predictive")  #: Names of the shipped sets.
_FILE = Path(__file__).with_name("washouts.toml")

Gain = Annotated[Quantity, AfterValidator(Kind(("1",), zero=True).check)]
CornerOrZero = Annotated[Quantity, AfterValidator(Kind(("rad/s", "Hz"), zero=True).check)]
AngleIntegral = Annotated[Quantity, positive_in("rad s", "deg s")]
LengthIntegral = Annotated[Quantity, positive_in("m s")]
UsableShare = Annotated[Quantity, AfterValidator(Kind(("1",), at_most=1.0).check)]
PricePerSecond = Annotated[Quantity, AfterValidator(Kind(("1/s",), zero=True).check)]


class Inputs(Settings):
    """Limits on what a washout takes in, after the gains; all kinds have them."""

    force_limit: Acceleration  #: Largest specific force, less that of level rest, along each axis.
    rate_limit: AngularSpeed  #: Largest angular rate about each axis.


class TiltInputs(Inputs):
    """Limits of a classical washout, tilt coordination included."""

    tilt_force_limit: Acceleration  #: Largest specific force that tilt imitates.
    tilt_rate: AngularSpeed  #: Largest rate of the tilt angle.
    tilt_recovery: Time  #: Time constant with which a tilt that was held back joins its demand.


class HighPass(Settings):
    """Gain and second-order high-pass of a rotation."""

    gain: Gain  #: Share of what the aircraft does, here of its angular rate.
    natural_frequency: Corner
    damping: Ratio


class ThirdOrder(HighPass):
    """Gain of the specific force less that of level rest, and both high-passes of heave."""

    break_frequency: CornerOrZero  #: Corner of the first-order high-pass; 0 leaves it out.


class TiltCoordinated(ThirdOrder):
    """Gain and filters of surge or sway, which tilt coordination completes."""

    low_pass_frequency: Corner  #: Natural frequency of the low-pass before tilt coordination.
    low_pass_damping: Ratio


class _WashoutSet(Settings):
    """Fields of all sets."""

    name: Name
    title: str = Field(min_length=1)
    source: str = Field(min_length=1)

    _gains: ClassVar[tuple[tuple[str, str], ...]]  #: Table and key of the gains of surge to yaw.

    @property
    def gains(self) -> NDArray[np.float64]:
        """Gains of surge to yaw, (6,)."""
        return np.array([getattr(getattr(self, table), key).si for table, key in self._gains])


class ClassicalSettings(_WashoutSet):
    """A classical washout."""

    _gains: ClassVar = tuple((dof, "gain") for dof in DOFS)
    kind: Literal["classical"]
    inputs: TiltInputs
    surge: TiltCoordinated
    sway: TiltCoordinated
    heave: ThirdOrder
    roll: HighPass
    pitch: HighPass
    yaw: HighPass

    @model_validator(mode="after")
    def _tilt_in_range(self) -> "ClassicalSettings":
        for dof, axis in (("surge", self.surge), ("sway", self.sway)):
            zeta, limit = min(axis.low_pass_damping.si, 0.99), self.inputs.tilt_force_limit
            # Largest input of the low-pass over its largest output: 1 / L1 of its impulse response.
            share = np.tanh(0.5 * np.pi * zeta / np.sqrt(1.0 - zeta**2))
            largest = STANDARD_GRAVITY * share
            if not limit.si < largest:
                raise InputError(
                    f"inputs.tilt_force_limit: {limit} must be less than {largest:.3g} m/s^2: "
                    f"the low-pass of {dof} may overshoot to 1 g"
                )
        return self


class RotationCost(Settings):
    """Gain, noise model, sizes at which each part of the cost of yaw is one (Bryson's rule)."""

    gain: Gain  #: Share of the aircraft's angular rate.
    rate_error: AngularSpeed  #: Error of the rate sensed.
    angle_integral: AngleIntegral
    angle: Angle
    rate: AngularSpeed  #: Of the simulator.
    rate_bandwidth: Corner  #: Corner of the first-order noise that models the aircraft's rate.


class TranslationCost(Settings):
    """Gain, noise model, sizes at which each part of the cost of heave is one (Bryson's rule)."""

    gain: Gain  #: Share of the aircraft's specific force, less that of level rest.
    force_error: Acceleration  #: Error of the specific force sensed.
    position_integral: LengthIntegral
    position: Length
    velocity: Speed
    acceleration: Acceleration  #: Of the simulator.
    force_bandwidth: Corner  #: Corner of the first-order noise that models the specific force.


class TiltCost(TranslationCost):
    """As `TranslationCost`, of surge or sway with the pitch or roll that is planned with it."""

    rate_gain: Gain  #: Share of the aircraft's angular rate.
    rate_error: AngularSpeed  #: Error of the rate sensed.
    angle: Angle
    rate: AngularSpeed  #: Of the simulator.
    rate_bandwidth: Corner  #: Corner of the first-order noise that models the aircraft's rate.


class OptimalSettings(_WashoutSet):
    """An optimal washout."""

    _gains: ClassVar = (
        ("pitch_surge", "gain"), ("roll_sway", "gain"), ("heave", "gain"),
        ("roll_sway", "rate_gain"), ("pitch_surge", "rate_gain"), ("yaw", "gain"),
    )  # fmt: skip
    kind: Literal["optimal"]
    inputs: Inputs
    pitch_surge: TiltCost
    roll_sway: TiltCost
    yaw: RotationCost
    heave: TranslationCost


class Prediction(Settings):
    """Horizon and constraints of a predictive washout."""

    reference: Literal["constant", "guess", "known"]
    """The aircraft ahead: as it is now, on along its slope, or as the flight says."""
    knots: int = Field(ge=2, le=60)  #: Instants of the horizon at which a plan is made.
    iterations: int = Field(ge=1)  #: Most iterations of the solver in a frame.
    horizon: Time  #: H, how far ahead is planned.
    guess_time: Time  #: T, the time in which a guess follows the slope.
    guess_lag: Time  #: Time constant of the low-pass on the slope of a guess.
    guess_fade: Time  #: T_f, the time constant with which a guess fades.
    share: UsableShare  #: Of travel, speed and acceleration of legs and pose, what a plan may use.
    tilt_rate: AngularSpeed  #: R, largest rate against or beyond the aircraft's in roll and pitch.
    price: Ratio  #: Linear price of passing a limit of legs or pose by its full size [cost].
    tilt_price: Ratio  #: Linear price of passing the tilt rate by its full size [cost].
    approach: Time  #: T_k now, the time constant of coming near to a limit of travel or speed.
    foresight: Gain  #: Growth of T_k for each second ahead [s/s].
    smoothing: Time  #: Time in which a rate or acceleration may build up to its size in the cost.
    false_cue: Ratio  #: S over the threshold of the specific force sensed.
    false_price: PricePerSecond  #: Price of passing S by one threshold for a second [cost/s].


class PredictiveSettings(OptimalSettings):
    """A predictive washout: sizes of the cost as for an optimal one, and a horizon."""

    kind: Literal["predictive"]  # type: ignore[assignment]
    prediction: Prediction


WashoutSettings = ClassicalSettings | OptimalSettings
"""Parameters of any washout; predictive ones are optimal ones with more."""

_KINDS: dict[str, type[WashoutSettings]] = {
    "classical": ClassicalSettings,
    "optimal": OptimalSettings,
    "predictive": PredictiveSettings,
}

_BASES = {"classical": "simona", "optimal": "optimal", "predictive": "predictive"}
"""Shipped set that a saved one of each kind changes."""


def load_washout(source: str | Path | WashoutSettings = "simona") -> WashoutSettings:
    """Load the parameters of a washout.

    `source` is one of `WASHOUTS`; a TOML file with `base` naming one of them and one table of
    changes, merged table by table; or parameters already loaded.
    """
    if isinstance(source, ClassicalSettings | OptimalSettings):
        return source
    sets = Loader(Settings, _FILE, what="washout", names=WASHOUTS, fixed=("kind",))
    table, place = sets.table(source)
    return validated(_KINDS[table["kind"]], table, place)


def save_washout(settings: WashoutSettings, path: str | Path) -> Path:
    """Write parameters as a TOML file that `load_washout` reads back."""
    table = settings.model_dump(mode="json", exclude={"name", "kind"})
    document = {"base": _BASES[settings.kind], settings.name: table}
    return write_text(Path(path), tomlkit.dumps(document))
