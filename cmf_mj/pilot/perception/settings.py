"""Parameters of the senses, read from `perception.toml` or a file of the user."""

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Kind, Quantity, positive_in
from cmf_mj.core.settings import Loader, Settings

Time = Annotated[Quantity, positive_in("s")]
Lead = Annotated[Quantity, AfterValidator(Kind(("s",), zero=True).check)]
Gain = Annotated[Quantity, positive_in("1")]
Force = Annotated[Quantity, positive_in("m/s^2", "g")]
Rate = Annotated[Quantity, positive_in("rad/s", "deg/s")]


class Canals(Settings):
    """Semicircular canals."""

    time_constant: Time  #: T1, of cupula and central processing.
    adaptation: Time  #: T2.
    lead: Lead  #: T3; 0 leaves lead and lag out.
    lag: Time  #: T4.


class Otoliths(Settings):
    """Otoliths."""

    gain: Gain  #: Sensed over true at rest.
    lead: Time
    long_lag: Time
    short_lag: Time


class Thresholds(Settings):
    """Smallest motion noticed, along and about each body axis."""

    x: Force
    y: Force
    z: Force
    roll: Rate
    pitch: Rate
    yaw: Rate

    @property
    def specific_force(self) -> NDArray[np.float64]:
        """Along x, y, z [m/s^2], (3,)."""
        return np.array([self.x.si, self.y.si, self.z.si])

    @property
    def angular_rate(self) -> NDArray[np.float64]:
        """About x, y, z [rad/s], (3,)."""
        return np.array([self.roll.si, self.pitch.si, self.yaw.si])


class TiltThreshold(Settings):
    """Smallest pitch tilt noticed at a frequency."""

    frequency: Annotated[Quantity, positive_in("Hz", "rad/s")]
    angle: Annotated[Quantity, positive_in("deg", "rad")]


class Senses(Settings):
    """All parameters of the senses."""

    canals: Canals
    otoliths: Otoliths
    thresholds: Thresholds
    tilt: tuple[TiltThreshold, ...] = Field(strict=False)

    @model_validator(mode="after")
    def _apart(self) -> "Senses":
        if self.canals.time_constant.si == self.canals.adaptation.si:
            raise InputError("canals.adaptation: must differ from time_constant")
        return self


load_senses = Loader(Senses, Path(__file__).with_name("perception.toml"))
"""Loads the parameters of the senses."""
