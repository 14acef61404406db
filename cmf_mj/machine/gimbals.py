"""Gimbals of a machine file: six coordinates each, or three pairs on each of two circles."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Kind, Length, Points, Quantity
from cmf_mj.core.settings import Settings
from cmf_mj.machine.geometry import paired_circles

LENGTHS = ("m", "mm", "in", "ft")
_COORDINATES = ("upper", "lower")
_CIRCLES = ("upper_radius", "upper_spacing", "lower_radius", "lower_spacing", "height")


def _six(points: Points) -> Points:
    if points.unit not in LENGTHS:
        raise InputError(f"{points.unit!r} is refused: unit must be one of {', '.join(LENGTHS)}")
    if len(points.value) != 6:
        raise InputError(f"has {len(points.value)} points; allowed: 6, one a leg")
    return points


_Points = Annotated[Points, AfterValidator(_six)]
_Spacing = Annotated[Quantity, AfterValidator(Kind(("deg", "rad"), below=2.0 * np.pi / 3.0).check)]
_Direction = Annotated[Quantity, AfterValidator(Kind(("deg", "rad"), signed=True).check)]


class Gimbals(Settings):
    """Where the legs are joined: coordinates, or three pairs on each of two circles.

    The circles are those of `geometry.paired_circles`.
    """

    upper: _Points | None = None  #: Upper gimbals at neutral, legs 1 to 6.
    lower: _Points | None = None  #: Lower gimbals.
    upper_radius: Length | None = None  #: Of the circle through the upper gimbals.
    upper_spacing: _Spacing | None = None  #: Angle between the two gimbals of an upper pair.
    lower_radius: Length | None = None  #: Of the circle through the lower gimbals.
    lower_spacing: _Spacing | None = None  #: Angle between the two gimbals of a lower pair.
    height: Length | None = None  #: Of the upper circle above the lower one at neutral.
    forward: _Direction | None = None
    """Direction of the middle of upper gimbals 6 and 1, clockwise from above; default ahead."""

    @model_validator(mode="after")
    def _either(self) -> "Gimbals":
        ways = [[name for name in way if getattr(self, name) is not None] for way in _WAYS]
        if all(ways) or (ways[0] and self.forward):
            raise InputError(f"{ways[0][0]}: is given with {(ways[1] or ['forward'])[0]}; {_WAY}")
        for way, given in zip(_WAYS, ways, strict=True):
            missing = sorted(set(way) - set(given))
            if given and missing:
                raise InputError(f"{missing[0]}: is missing; {_WAY}")
        if not any(ways):
            raise InputError(f"upper: is missing; {_WAY}")
        return self

    def in_report_axes(self, turn: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Upper and lower gimbals, z down [m], (6, 3) each; `turn` are the file's axes in it."""
        if self.upper is not None and self.lower is not None:
            return self.upper.si * turn, self.lower.si * turn
        upper_radius, upper_spacing, lower_radius, lower_spacing, height = (
            getattr(self, name).si for name in _CIRCLES
        )
        forward = 0.0 if self.forward is None else self.forward.si
        return paired_circles(
            (upper_radius, upper_spacing), (lower_radius, lower_spacing), height, forward
        )


_WAYS = (_COORDINATES, _CIRCLES)
_WAY = f"allowed: either {' and '.join(_COORDINATES)}, or {', '.join(_CIRCLES)} and forward"
