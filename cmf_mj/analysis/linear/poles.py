"""Smaller systems of a linearised plant; its modes: poles, damping, and what takes part in them."""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.analysis.linear.loop import labels, reached
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.record.record import Record

Matrix = NDArray[np.float64]


def reduced(
    system: control.StateSpace,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
) -> control.StateSpace:
    """A system between some of its signals, by name, without the states that cannot matter there.

    A state is dropped where no chain of non-zero entries leads to it from an input or from it to an
    output. The others are kept as they are, with their names.
    """
    columns = _chosen("inputs", inputs, system.input_labels)
    rows = _chosen("outputs", outputs, system.output_labels)
    a, b, c, d = (np.asarray(m) for m in (system.A, system.B, system.C, system.D))
    b, c, d = b[:, columns], c[rows], d[np.ix_(rows, columns)]
    links = a != 0.0
    kept = np.flatnonzero(
        reached(links, (b != 0.0).any(axis=1)) & reached(links.T, (c != 0.0).any(axis=0))
    )
    names = {
        "inputs": [system.input_labels[i] for i in columns],
        "outputs": [system.output_labels[i] for i in rows],
        "states": [system.state_labels[i] for i in kept],
    }
    matrices = a[np.ix_(kept, kept)], b[kept], c[:, kept], d
    return control.ss(*matrices, system.dt, name=system.name, **names)


def _chosen(field: str, names: Sequence[str] | None, there: list[str]) -> list[int]:
    if names is None:
        return list(range(len(there)))
    if len(names) == 0:
        raise InputError(f"{field}: none is given; allowed: some of {', '.join(there)}")
    return [there.index(check_name(field, name, there)) for name in names]


def leg_model(system: control.StateSpace, leg: int) -> control.StateSpace:
    """One leg, from 1 on, of a linearised plant, the commands of all others constant.

    The others' oil still gives way: a leg of the hexapod keeps the modes of the whole machine.
    Input `command`, outputs `FEEDBACK` with bare names; `reduced(..., outputs=[one])` of it is a
    single output.
    """
    legs = int(system.ninputs)
    if leg not in range(1, legs + 1):
        raise InputError(f"leg: {leg} is not one of 1 to {legs}")
    end = f"_{leg}" if legs > 1 else ""
    one = reduced(system, [f"command{end}"], [f"{name}{end}" for name in FEEDBACK])
    return control.ss(
        one, inputs=["command"], outputs=list(FEEDBACK), name=f"{system.name}_leg_{leg}"
    )


_FAMILIES = {
    "drive": ("drive",),
    "spool": ("spool",),
    "motion": ("leg_position", "leg_velocity"),
    "oil": ("cap_pressure", "rod_pressure"),
    "supply": ("supply_pressure", "return_pressure", "accumulator_oil", "pump_flow"),
}
"""Kinds of state, with the beginnings of their names."""

_STILL = 1e-6  #: Pole [rad/s] of an integrator: round-off of the eigenvalues.


class Mode(NamedTuple):
    """One real pole or one pair."""

    pole: complex  #: [rad/s], of a pair the one above the real axis.
    frequency: float  #: Modulus of the pole [rad/s].
    damping_ratio: float  #: -Re / modulus; 1 for a stable real pole, NaN for an integrator.
    shares: dict[str, float]  #: Shares of drive, spool, motion, oil and supply, sum 1.
    leg_shape: NDArray[np.complex128]  #: Leg motion, (n,), the largest 1; zero where no leg moves.
    dof_shares: Matrix
    """Shares of the degrees of freedom in the leg motion, (6,); NaN where none are asked for."""


def modes(system: control.StateSpace, jacobian: Matrix | None = None) -> tuple[Mode, ...]:
    """All modes of a linearised plant, slowest first.

    Of poles that coincide, such as those of uncoupled equal legs, only the space of all is
    determined, not the shape of one. With the `jacobian` d(legs)/d(pose) (6, 6) they have shares of
    degrees of freedom.
    """
    if not system.isctime(strict=True):
        raise InputError("system: is discrete; a linearised plant, which is continuous, is needed")
    kinds = [
        next(k for k, starts in _FAMILIES.items() if n.startswith(starts))
        for n in system.state_labels
    ]
    matrix, (scale, _) = linalg.matrix_balance(np.asarray(system.A), permute=False, separate=True)
    poles, right = np.linalg.eig(matrix)
    poles = np.where(np.abs(poles) < _STILL, 0.0, poles)
    factors = np.abs(right * np.linalg.inv(right).T)
    factors /= factors.sum(axis=0)
    right = right * scale[:, None]
    legs = int(system.ninputs)
    rows = [system.state_labels.index(name) for name in labels(("leg_position",), legs)]
    result = []
    for i in np.argsort(np.abs(poles), kind="stable"):
        if poles[i].imag < 0.0:
            continue
        size = float(np.abs(poles[i]))
        shape = right[rows, i]
        most = shape[np.argmax(np.abs(shape))]
        moves = np.abs(most) > 1e-12 * np.abs(right[:, i]).max()
        shape = shape / most if moves else np.zeros(legs, dtype=complex)
        damping = float(-poles[i].real / size) if size > _STILL else float("nan")
        parts = list(zip(factors[:, i], kinds, strict=True))
        shares = {name: float(sum(f for f, kind in parts if kind == name)) for name in _FAMILIES}
        dofs = np.full(6, np.nan)
        if jacobian is not None and moves:
            along = jacobian * np.linalg.solve(jacobian, shape)
            dofs = np.real(np.conj(shape) @ along) / float(np.sum(np.abs(shape) ** 2))
        result.append(Mode(complex(poles[i]), size, damping, shares, shape, dofs))
    return tuple(result)


_TAIL = 4.0  #: Length of the steady oscillation examined [s].


def limit_cycle(record: Record) -> tuple[float, float, float]:
    """Frequency [Hz], amplitude [psi] and largest acceleration [g] of leg 1 at the end of a run.

    The frequency is NaN where the oscillation has died down.
    """
    tail = round(_TAIL * record.rate)
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[-tail:, 0])
    acceleration = float(np.abs(record["leg_acceleration"][-tail:, 0]).max())
    acceleration /= units.STANDARD_GRAVITY
    swing = difference - difference.mean()
    amplitude = float(np.ptp(swing)) / 2.0
    if amplitude < 10.0:
        return float("nan"), amplitude, acceleration
    spectrum = np.abs(np.fft.rfft(swing * np.hanning(tail)))
    return float(np.argmax(spectrum) / _TAIL), amplitude, acceleration
