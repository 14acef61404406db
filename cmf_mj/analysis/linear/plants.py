"""Linear plants of a leg: from a command to everything its sensors read, at 2048 Hz.

`leg_plant` makes one of a model of one output, such as the report's: position is the integral of
velocity and velocity of acceleration, or the other way round the derivative. Commands are constant
over a frame: the discrete plant is exact.
"""

from collections.abc import Sequence
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.units import FRAME

FEEDBACK = ("leg_position", "leg_velocity", "leg_acceleration", "cap_pressure", "rod_pressure")
"""What a leg's sensors give the DCL [m, m/s, m/s^2, Pa, Pa]."""


class UnitTransferFunction(control.TransferFunction):  # type: ignore[misc]
    """A SISO transfer function with units; arithmetic gives plain transfer functions.

    Its gain counts in `output_unit` per `input_unit`, units of `cmf_mj.core.units`.
    """

    def __init__(
        self,
        numerator: Sequence[float],
        denominator: Sequence[float],
        dt: float = 0.0,
        *,
        input_unit: str,
        output_unit: str,
        **keywords: Any,
    ) -> None:
        """Wrap polynomials of s, or of z with a sampling time `dt` [s], highest power first.

        `keywords` are `inputs`, `outputs` and `name` of python-control.
        """
        units.factor(input_unit), units.factor(output_unit)
        super().__init__(list(numerator), list(denominator), dt, **keywords)
        self.input_unit = input_unit
        """Unit of the input."""
        self.output_unit = output_unit
        """Unit of the output."""

    def to_si(self) -> control.TransferFunction:
        """The same system in SI units, commands as fractions; labels are kept."""
        size = units.factor(self.output_unit) / units.factor(self.input_unit)
        above, below = self.num_array[0, 0] * size, self.den_array[0, 0]
        names = {"inputs": self.input_labels, "outputs": self.output_labels, "name": self.name}
        return control.tf(above, below, self.dt, **names)


def leg_plant(model: UnitTransferFunction, *, frame: float = FRAME) -> control.StateSpace:
    """One leg from a continuous model of position, velocity or acceleration: per frame [s], SI.

    The derivative of an output without a direct term is exact; with one it is the difference over a
    frame, since a stepped command makes such an output jump. Pressures are zero, as in the report's
    loop. The input is `command` [fraction], the outputs are `FEEDBACK`.
    """
    given, allowed = model.output_labels[0], FEEDBACK[:3]
    place = FEEDBACK.index(check_name("model: output", given, allowed))
    if units.si_unit(model.output_unit) != (si_unit := ("m", "m/s", "m/s^2")[place]):
        fault = f"{model.output_unit!r} of {given} is refused; allowed: a unit of {si_unit}"
        raise InputError(f"model: output_unit: {fault}")
    if not model.isctime():
        raise InputError(f"model: {given} is discrete; a continuous model is needed")
    si = model.to_si()
    a, b, c, d = signal.tf2ss(si.num_array[0, 0], si.den_array[0, 0])
    a, scaling = linalg.matrix_balance(a, permute=False)
    scale = np.diag(scaling)
    b, rows = b / scale[:, None], {place: (c[0] * scale, float(d[0, 0]))}
    for rate in range(place, 0, -1):
        row, direct = rows[rate]
        a = np.block([[a, np.zeros((row.size, 1))], [row, np.zeros((1, 1))]])
        b, integral = np.vstack([b, [[direct]]]), np.append(np.zeros(row.size), 1.0)
        rows = {i: (np.append(kept, 0.0), d) for i, (kept, d) in rows.items()}
        rows[rate - 1] = (integral, 0.0)
    for i in range(place, len(allowed) - 1):
        if i in rows and rows[i][1] == 0.0:
            rows[i + 1] = (rows[i][0] @ a, float(rows[i][0] @ b[:, 0]))
    c, d = np.zeros((len(FEEDBACK), len(a))), np.zeros((len(FEEDBACK), 1))
    for i, (row, direct) in rows.items():
        c[i], d[i, 0] = row, direct
    a, b, c, d, _ = signal.cont2discrete((a, b, c, d), frame, method="zoh")
    for i in range(len(allowed) - 1):
        if i + 1 not in rows:
            a, b, c, d = _difference((a, b, c, d), i, i + 1, frame)
    return control.ss(a, b, c, d, frame, inputs=["command"], outputs=list(FEEDBACK), name="plant")


def _difference(
    matrices: tuple[NDArray[np.float64], ...], output: int, rate: int, frame: float
) -> tuple[NDArray[np.float64], ...]:
    """Set the row `rate` to the difference of the row `output` over a frame; one more state."""
    a, b, c, d = matrices
    a = np.block([[a, np.zeros((a.shape[0], 1))], [c[output], np.zeros((1, 1))]])
    b, c, d = np.vstack([b, d[output]]), np.pad(c, ((0, 0), (0, 1))), d.copy()
    c[rate], d[rate] = c[output] / frame, d[output] / frame
    c[rate, -1] = -1.0 / frame
    return a, b, c, d
