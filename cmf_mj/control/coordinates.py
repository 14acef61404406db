"""Coordinates of a law: the legs themselves, or the hydraulic modes of a cab.

All legs have the oil spring K near neutral, so that the shapes V that diagonalise the reflected
mass are orthonormal and diagonalise the whole hydraulics,

    M_leg = V diag(m) V^T,    M_leg l'' + K l = F    ->    m_i q_i'' + K q_i = f_i,   q = V^T l,

and valves that are alike stay alike, d = V^T c. A law in *hydraulic modes* reads q = V^T l of
demand and feedback, runs each mode as it would a leg, and hands c = V d to the valves. Away from
neutral, with the Jacobian's change, and where valves differ, modes couple again.

Source: S. H. Koekebakker, Model based control of a flight simulator motion system (2001); A. R.
Plummer, P. S. Guinzio, Modal control of an electrohydrostatic flight simulator system (2009).
"""

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Settings, as_tuples

MODES = 6  #: Hydraulic modes of a hexapod.

ORTHONORMAL = 1e-8  #: Largest entry of V^T V - 1 that passes for round-off of a table's ten digits.

_ONE_A_MODE = Field(min_length=MODES, max_length=MODES)
_ModeNumbers = Annotated[tuple[float, ...], _ONE_A_MODE]


def _check_numbers(value: Any) -> Any:
    """Refuse what is neither a number nor a list of one a mode."""
    setting = as_tuples(value)
    is_list = isinstance(setting, tuple) and len(setting) == MODES
    for number in setting if is_list else (setting,):
        if not isinstance(number, int | float) or isinstance(number, bool):
            raise InputError(f"must be a number, or a list of {MODES}")
    return setting


PerMode = Annotated[float | _ModeNumbers, BeforeValidator(_check_numbers)]
"""One number for all coordinates, or a list of six, a mode each."""

Positive = Annotated[float, Field(gt=0.0)]
_Positives = Annotated[tuple[Positive, ...], _ONE_A_MODE, BeforeValidator(as_tuples)]


def per_coordinate(value: float | tuple[float, ...], count: int) -> NDArray[np.float64]:
    """A `PerMode` setting as an array, (count,); a list of another length is refused."""
    if isinstance(value, tuple) and len(value) != count:
        raise InputError(f"modes: {len(value)} values are refused for {count} coordinates")
    return np.full(count, value, dtype=np.float64)


class Modes(Settings):
    """Hydraulic modes of one cab at neutral, lowest first."""

    source: str = ""  #: Where they come from.
    frequency: _Positives  #: Undamped natural frequencies [Hz].
    mass: _Positives  #: Mass of each mode [lbm].
    shape: Annotated[tuple[_ModeNumbers, ...], _ONE_A_MODE, BeforeValidator(as_tuples)]
    """V^T, a row a mode: leg motion, orthonormal."""
    follow_pose: bool = True  #: Whether legs carry one platform: its pose changes the mass.

    @model_validator(mode="after")
    def _check_shape(self) -> "Modes":
        rows = np.array(self.shape)
        error = float(np.abs(rows @ rows.T - np.eye(MODES)).max())
        if error > ORTHONORMAL:
            raise InputError(
                f"shape: rows are off orthonormal by {error:.3g}; allowed: {ORTHONORMAL:g}"
            )
        return self


def make_shape(modes: Modes | None, legs: int) -> NDArray[np.float64]:
    """V^T of a cab's modes, (n, n); None for the legs themselves.

    Shapes are made orthonormal to round-off, by the nearest such matrix, so that a demand comes
    back from the modes as it was.
    """
    if modes is None:
        return np.eye(legs)
    if legs != MODES:
        raise InputError(f"modes: are those of {MODES} legs; there are {legs}")
    u, _, v_transposed = np.linalg.svd(np.array(modes.shape))
    return np.ascontiguousarray(u @ v_transposed)


def mode_mass(modes: Modes) -> NDArray[np.float64]:
    """Masses of the modes [kg], (6,)."""
    return np.array(modes.mass) * units.POUND_MASS
