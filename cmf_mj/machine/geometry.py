"""Gimbals of a Stewart platform, in the report's axes, and which way those lie in MuJoCo's."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.errors import InputError

DOFS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
"""Names of the six degrees of freedom, in the order of a pose."""

FLIP = np.array([1.0, -1.0, -1.0])
"""Report axes to MuJoCo axes and back, componentwise."""


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

    With radius R and spacing s of a pair, upper gimbals 6 and 1 lie at the angles -s/2 and s/2 from
    `forward`, measured from x to y (clockwise from above), 2 and 3 at 120 deg and 4 and 5 at 240
    deg from there; lower gimbals 1 and 2 at 60 deg, 3 and 4 at 180 deg, 5 and 6 at 300 deg.

    Args:
        upper: radius [m] and spacing of a pair [rad] of the upper gimbals.
        lower: those of the lower gimbals.
        height: of the upper circle above the lower one at neutral [m].
        forward: direction of the middle of upper gimbals 6 and 1 [rad].
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
