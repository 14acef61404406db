"""Limits of a motion base as data: displacements, rates and accelerations of platform and legs.

Axes are the report's, z down.
"""

from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from cmf_mj.core import quantity, units
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Kind, Quantity, Status
from cmf_mj.core.settings import Settings
from cmf_mj.machine.geometry import DOFS


class Range(Settings):
    """A displacement range around zero as a source gives it."""

    low: float = Field(lt=0.0)  #: Lowest displacement, in `unit`.
    high: float = Field(gt=0.0)  #: Highest displacement, in `unit`.
    unit: Literal["in", "m", "mm", "deg", "rad"]  #: Unit as published.
    status: Status  #: How the range is known.
    source: str = Field(min_length=1)  #: Where it comes from, or why it was chosen.

    @property
    def si(self) -> tuple[float, float]:
        """Lowest and highest in SI."""
        return units.to_si(self.unit, self.low), units.to_si(self.unit, self.high)


SpanT = TypeVar("SpanT")
SpeedT = TypeVar("SpeedT")
AccelerationT = TypeVar("AccelerationT")


def _range_in(*allowed: str) -> AfterValidator:
    def check(value: Range) -> Range:
        if value.unit not in allowed:
            raise InputError(f"unit must be one of {', '.join(allowed)}")
        return value

    return AfterValidator(check)


class Axis(Settings, Generic[SpanT, SpeedT, AccelerationT]):
    """Limits of one degree of freedom."""

    mechanical: SpanT  #: Displacement at which the machine ends.
    operational: SpanT  #: Displacement a demand may ask for.
    velocity: SpeedT  #: Largest speed, or rate of the Euler angle, either way.
    acceleration: AccelerationT  #: Largest acceleration, or second derivative of it, either way.

    @model_validator(mode="after")
    def _check_nested(self) -> "Axis[Any, Any, Any]":
        low, high = self.operational.si  # type: ignore[attr-defined]
        lowest, highest = self.mechanical.si  # type: ignore[attr-defined]
        if not (lowest <= low and high <= highest):
            raise InputError("operational must lie within mechanical")
        return self


Translation = Axis[
    Annotated[Range, _range_in("in", "m", "mm")], quantity.Speed, quantity.Acceleration
]
"""Limits of surge, sway or heave."""
Rotation = Axis[
    Annotated[Range, _range_in("deg", "rad")], quantity.AngularSpeed, quantity.AngularAcceleration
]
"""Limits of roll, pitch or yaw."""

_RejoinShare = Annotated[Quantity, AfterValidator(Kind(("1",), at_most=1.0).check)]


class StatedLeg(Settings):
    """Limits of one leg as a machine file gives them."""

    velocity: quantity.Speed  #: Largest leg speed either way.
    acceleration: quantity.Acceleration  #: Largest leg acceleration either way.
    position: quantity.Length | None = None  #: Default the working stroke.
    rejoin: _RejoinShare | None = None  #: Default half.


class Leg(StatedLeg):
    """Limits of one leg, and how a limited motion returns to its demand."""

    position: quantity.Length  #: Largest extension and retraction from neutral.
    rejoin: _RejoinShare  #: Share of the acceleration for the way back to the demand.


class MotionLimits(Settings):
    """Displacement, velocity and acceleration limits of the platform and its legs."""

    surge: Translation
    sway: Translation
    heave: Translation
    roll: Rotation
    pitch: Rotation
    yaw: Rotation
    leg: Leg

    @property
    def axes(self) -> tuple[Translation | Rotation, ...]:
        """The six degrees of freedom in the order of a pose."""
        return tuple(getattr(self, dof) for dof in DOFS)

    @property
    def mechanical(self) -> NDArray[np.float64]:
        """Lowest and highest displacement the machine can make [m, rad], (6, 2)."""
        return np.array([axis.mechanical.si for axis in self.axes])

    @property
    def operational(self) -> NDArray[np.float64]:
        """Lowest and highest displacement a demand may ask for [m, rad], (6, 2)."""
        return np.array([axis.operational.si for axis in self.axes])

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Of the degrees of freedom [m/s, rad/s], (6,)."""
        return np.array([axis.velocity.si for axis in self.axes])

    @property
    def acceleration(self) -> NDArray[np.float64]:
        """Of the degrees of freedom [m/s^2, rad/s^2], (6,)."""
        return np.array([axis.acceleration.si for axis in self.axes])


class StatedLimits(Settings):
    """Limits as a machine file gives them; a degree of freedom left out has derived ones."""

    surge: Translation | None = None
    sway: Translation | None = None
    heave: Translation | None = None
    roll: Rotation | None = None
    pitch: Rotation | None = None
    yaw: Rotation | None = None
    leg: StatedLeg
