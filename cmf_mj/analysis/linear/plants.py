"""Linear plants of a leg: from a command to everything its sensors read, at 2048 Hz.

`leg_plant` joins models of single outputs, such as the report's, into one plant. What no model
gives follows from what one does: position is the integral of velocity and velocity of acceleration,
or the other way round the derivative. Commands are constant over a frame: the discrete plant is
exact.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

from cmf_mj.analysis.linear.law import FEEDBACK
from cmf_mj.analysis.linear.transfer import UnitTransferFunction
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME

_POSITION, _VELOCITY, _ACCELERATION = FEEDBACK[:3]


class _System(NamedTuple):
    """x' = A x + B u, and one row of C and D for each output."""

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    rows: dict[str, tuple[NDArray[np.float64], float]]


def leg_plant(*models: UnitTransferFunction) -> control.StateSpace:
    """One leg from models of some of its outputs.

    The derivative of an output without a direct term is exact; with one it is the difference over a
    frame, since a stepped command makes such an output jump. Pressures without a model are zero, as
    in the report's loop.

    Args:
        models: continuous, each with an output of `FEEDBACK`; at least one of position, velocity
            and acceleration.

    Returns:
        Discrete at 2048 Hz, SI: input `command` [fraction], outputs `FEEDBACK`.

    Raises:
        InputError: a model that is discrete, has another or the same output as one before, or no
            model of motion.
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
    a, b, c, d, _ = signal.cont2discrete((system.a, system.b, c, d), FRAME, method="zoh")
    for before, after in ((_POSITION, _VELOCITY), (_VELOCITY, _ACCELERATION)):
        if after not in system.rows:
            a, b, c, d = _difference((a, b, c, d), FEEDBACK.index(before), FEEDBACK.index(after))
    return control.ss(a, b, c, d, FRAME, inputs=["command"], outputs=list(FEEDBACK), name="plant")


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
    matrices: tuple[NDArray[np.float64], ...], output: int, rate: int
) -> tuple[NDArray[np.float64], ...]:
    """Set the row `rate` to the difference of the row `output` over a frame; one more state."""
    a, b, c, d = matrices
    order = a.shape[0]
    a = np.block([[a, np.zeros((order, 1))], [c[output], np.zeros((1, 1))]])
    b = np.vstack([b, d[output]])
    c = np.hstack([c, np.zeros((c.shape[0], 1))])
    d = d.copy()
    c[rate] = c[output] / FRAME
    c[rate, -1] = -1.0 / FRAME
    d[rate] = d[output] / FRAME
    return a, b, c, d
