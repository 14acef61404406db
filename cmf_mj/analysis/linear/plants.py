"""Linear plants of a leg: from a command to everything its sensors read, at 2048 Hz.

`leg_plant` joins models of single outputs, such as the report's, into one plant. What no model
gives follows from what one does: position is the integral of velocity and velocity of acceleration,
or the other way round the derivative. Commands are constant over a frame: the discrete plant is
exact.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import FRAME

FEEDBACK = ("leg_position", "leg_velocity", "leg_acceleration", "cap_pressure", "rod_pressure")
"""What a leg's sensors give the DCL [m, m/s, m/s^2, Pa, Pa]."""

_POSITION, _VELOCITY, _ACCELERATION = FEEDBACK[:3]


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

    @property
    def si_factor(self) -> float:
        """What the gain is multiplied with to count in SI units and command fractions."""
        return units.factor(self.output_unit) / units.factor(self.input_unit)

    def to_si(self) -> control.TransferFunction:
        """The same system in SI units, commands as fractions; labels are kept."""
        above, below = self.num_array[0, 0] * self.si_factor, self.den_array[0, 0]
        names = {"inputs": self.input_labels, "outputs": self.output_labels, "name": self.name}
        return control.tf(above, below, self.dt, **names)


class _System(NamedTuple):
    """x' = A x + B u, and one row of C and D for each output."""

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    rows: dict[str, tuple[NDArray[np.float64], float]]


def leg_plant(*models: UnitTransferFunction, frame: float = FRAME) -> control.StateSpace:
    """One leg from continuous models of different outputs of `FEEDBACK`: per frame [s], SI.

    At least one is of position, velocity or acceleration. The derivative of an output without a
    direct term is exact; with one it is the difference over a frame, since a stepped command makes
    such an output jump. Pressures without a model are zero, as in the report's loop. The input is
    `command` [fraction], the outputs are `FEEDBACK`.
    """
    system = _joined(models)
    system = _integrated(system, _ACCELERATION, _VELOCITY, unless=_POSITION)
    system = _integrated(system, _VELOCITY, _POSITION)
    if _POSITION not in system.rows:
        names = ", ".join(system.rows) or "none"
        raise InputError(f"models: {names}; one of {', '.join(FEEDBACK[:3])} is needed")
    system = _derived(system, _POSITION, _VELOCITY)
    system = _derived(system, _VELOCITY, _ACCELERATION)
    order = system.a.shape[0]
    c = np.zeros((len(FEEDBACK), order))
    d = np.zeros((len(FEEDBACK), 1))
    for name, (row, direct) in system.rows.items():
        c[FEEDBACK.index(name)], d[FEEDBACK.index(name), 0] = row, direct
    a, b, c, d, _ = signal.cont2discrete((system.a, system.b, c, d), frame, method="zoh")
    for before, after in ((_POSITION, _VELOCITY), (_VELOCITY, _ACCELERATION)):
        if after not in system.rows:
            places = FEEDBACK.index(before), FEEDBACK.index(after)
            a, b, c, d = _difference((a, b, c, d), *places, frame)
    return control.ss(a, b, c, d, frame, inputs=["command"], outputs=list(FEEDBACK), name="plant")


def _joined(models: tuple[UnitTransferFunction, ...]) -> _System:
    """All models side by side, SI, each realised and balanced separately."""
    system = _System(np.zeros((0, 0)), np.zeros((0, 1)), {})
    for model in models:
        name = model.output_labels[0]
        if name not in FEEDBACK:
            raise InputError(f"models: output {name!r} is not one of {', '.join(FEEDBACK)}")
        if name in system.rows:
            raise InputError(f"models: {name} is given twice")
        if not model.isctime():
            raise InputError(f"models: {name} is discrete; a continuous model is needed")
        si = model.to_si()
        a, b, c, d = signal.tf2ss(si.num_array[0, 0], si.den_array[0, 0])
        a, scaling = linalg.matrix_balance(a, permute=False)
        scale = np.diag(scaling)
        before, order = system.a.shape[0], a.shape[0]
        rows = {
            key: (np.append(row, np.zeros(order)), direct)
            for key, (row, direct) in system.rows.items()
        }
        rows[name] = (np.append(np.zeros(before), c[0] * scale), float(d[0, 0]))
        system = _System(
            linalg.block_diag(system.a, a), np.vstack([system.b, b / scale[:, None]]), rows
        )
    return system


def _integrated(system: _System, rate: str, integral: str, unless: str = "") -> _System:
    """Add `integral` of `rate`, where only the rate is there."""
    if rate not in system.rows or integral in system.rows or unless in system.rows:
        return system
    row, direct = system.rows[rate]
    order = row.size
    rows = {key: (np.append(kept, 0.0), d) for key, (kept, d) in system.rows.items()}
    rows[integral] = (np.append(np.zeros(order), 1.0), 0.0)
    return _System(
        np.block([[system.a, np.zeros((order, 1))], [row, np.zeros((1, 1))]]),
        np.vstack([system.b, [[direct]]]),
        rows,
    )


def _derived(system: _System, output: str, rate: str) -> _System:
    """Add `rate` as the exact derivative of an output without a direct term."""
    if rate in system.rows or output not in system.rows or system.rows[output][1] != 0.0:
        return system
    row, _ = system.rows[output]
    system.rows[rate] = (row @ system.a, float(row @ system.b[:, 0]))
    return system


def _difference(
    matrices: tuple[NDArray[np.float64], ...], output: int, rate: int, frame: float
) -> tuple[NDArray[np.float64], ...]:
    """Set the row `rate` to the difference of the row `output` over a frame; one more state."""
    a, b, c, d = matrices
    order = a.shape[0]
    a = np.block([[a, np.zeros((order, 1))], [c[output], np.zeros((1, 1))]])
    b = np.vstack([b, d[output]])
    c = np.hstack([c, np.zeros((c.shape[0], 1))])
    d = d.copy()
    c[rate] = c[output] / frame
    c[rate, -1] = -1.0 / frame
    d[rate] = d[output] / frame
    return a, b, c, d
