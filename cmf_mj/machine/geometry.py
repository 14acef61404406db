"""Degrees of freedom and gimbals of a Stewart platform, in the report's axes (z down)."""

from typing import Annotated, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, model_validator

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.quantity import Kind, Length, Points, Quantity
from cmf_mj.core.settings import Settings

DOFS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
"""Names of the six degrees of freedom, in the order of a pose."""
FLIP = np.array([1.0, -1.0, -1.0])  #: Report axes to MuJoCo axes and back, componentwise.


class Geometry(NamedTuple):
    """Gimbal positions of a Stewart platform, report axes.

    >>> cmf_mj.load_machine().geometry.neutral.round(2).tolist()
    [4.06, 4.06, 4.06, 4.06, 4.06, 4.06]
    """

    upper: NDArray[np.float64]  #: Upper gimbals A in the platform frame [m], (6, 3).
    lower: NDArray[np.float64]  #: Lower gimbals B in the inertial frame [m], (6, 3).
    neutral: NDArray[np.float64]  #: Pin-to-pin leg lengths at the pose zero [m], (6,).


def make_geometry(upper: ArrayLike, lower: ArrayLike) -> Geometry:
    """Build a `Geometry` from upper (6, 3) and lower (6, 3) gimbals [m], report axes."""
    a = np.ascontiguousarray(upper, dtype=float)
    b = np.ascontiguousarray(lower, dtype=float)
    if a.shape != (6, 3) or b.shape != (6, 3):
        raise InputError(f"upper, lower: shapes are {a.shape}, {b.shape}; both must be (6, 3)")
    return Geometry(a, b, np.linalg.norm(a - b, axis=1))


def paired_circles(
    upper: tuple[float, float], lower: tuple[float, float], height: float, forward: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gimbals in three pairs on each of two circles, report axes, (6, 3) each [m].

    `upper` and `lower` are the radius [m] and the spacing s of a pair [rad] of each circle, the
    upper one at a `height` [m] above the lower one. Upper gimbals 6 and 1 lie at the angles -s/2
    and s/2 from `forward` [rad], measured from x to y (clockwise from above), 2 and 3 at 120 deg
    and 4 and 5 at 240 deg from there; lower gimbals 1 and 2 at 60 deg, 3 and 4 at 180 deg, 5 and 6
    at 300 deg.
    """

    def circle(
        radius: float, spacing: float, middles: tuple[int, ...], sides: tuple[int, ...], z: float
    ) -> NDArray[np.float64]:
        angles = forward + np.radians(middles) + 0.5 * spacing * np.array(sides)
        return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(6, z)], axis=1)

    return (
        circle(*upper, (0, 120, 120, 240, 240, 360), (1, -1, 1, -1, 1, -1), 0.0),
        circle(*lower, (60, 60, 180, 180, 300, 300), (-1, 1, -1, 1, -1, 1), height),
    )


ChoiceT = TypeVar("ChoiceT")


def dof_index(dof: str) -> int:
    """Position of a degree of freedom in a pose."""
    return DOFS.index(check_name("dof", dof, DOFS))


def by_kind(dof: str | int, translation: ChoiceT, rotation: ChoiceT) -> ChoiceT:
    """The first for surge, sway and heave, the second for roll, pitch and yaw.

    >>> by_kind("pitch", "m/s^2", "deg/s^2")
    'deg/s^2'
    """
    index = dof_index(dof) if isinstance(dof, str) else dof
    return translation if index < 3 else rotation


def dof_unit(dof: str | int) -> str:
    """The unit of the field for a degree of freedom: in or deg.

    >>> dof_unit("heave"), dof_unit(5)
    ('in', 'deg')
    """
    return by_kind(dof, "in", "deg")


LENGTH_UNITS = ("m", "mm", "in", "ft")
_COORDINATE_FIELDS = ("upper", "lower")
_CIRCLE_FIELDS = ("upper_radius", "upper_spacing", "lower_radius", "lower_spacing", "height")
_FORMS = f"allowed: either upper and lower, or {', '.join(_CIRCLE_FIELDS)} and forward"


def _check_six(points: Points) -> Points:
    if points.unit not in LENGTH_UNITS:
        raise InputError(
            f"{points.unit!r} is refused: unit must be one of {', '.join(LENGTH_UNITS)}"
        )
    if len(points.value) != 6:
        raise InputError(f"has {len(points.value)} points; allowed: 6, one a leg")
    return points


_Points = Annotated[Points, AfterValidator(_check_six)]
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
    def _check_one_form(self) -> "Gimbals":
        coordinates = [name for name in _COORDINATE_FIELDS if getattr(self, name) is not None]
        circles = [name for name in _CIRCLE_FIELDS if getattr(self, name) is not None]
        if coordinates and (circles or self.forward):
            other = circles[0] if circles else "forward"
            raise InputError(f"{coordinates[0]}: is given with {other}; {_FORMS}")
        form = _CIRCLE_FIELDS if circles else _COORDINATE_FIELDS
        missing = sorted(set(form) - {*coordinates, *circles})
        if missing:
            name = missing[0] if coordinates or circles else "upper"
            raise InputError(f"{name}: is missing; {_FORMS}")
        return self

    def in_report_axes(self) -> tuple[NDArray[np.float64], ...]:
        """Upper and lower gimbals, z down [m], (6, 3) each."""
        if self.upper is not None and self.lower is not None:
            return self.upper.si * FLIP, self.lower.si * FLIP
        upper_radius, upper_spacing, lower_radius, lower_spacing, height = (
            getattr(self, name).si for name in _CIRCLE_FIELDS
        )
        upper, lower = (upper_radius, upper_spacing), (lower_radius, lower_spacing)
        forward = 0.0 if self.forward is None else self.forward.si
        return paired_circles(upper, lower, height, forward)


def pose_text(pose: NDArray[np.float64], form: str = ".4g") -> str:
    """A pose in in and deg, zeros left out; `neutral` if all are.

    >>> pose_text(np.array([0.0254, 0.0, 0.0, 0.0, 0.0, 0.0]))
    'surge 1 in'
    """
    parts = []
    for dof, value in zip(DOFS, pose, strict=True):
        size = format(units.from_si(dof_unit(dof), float(value)), form)
        if float(size) != 0.0:
            parts.append(f"{dof} {size} {dof_unit(dof)}")
    return ", ".join(parts) or "neutral"
