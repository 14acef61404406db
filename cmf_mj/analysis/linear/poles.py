"""Smaller systems of a linearised plant; its modes: poles, damping, and what takes part in them."""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.analysis.linear.loop import reached
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.core.errors import InputError, check_name

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


_KINDS = {
    "drive": ("drive",),
    "spool": ("spool",),
    "motion": ("leg_position", "leg_velocity"),
    "oil": ("cap_pressure", "rod_pressure"),
    "supply": ("supply_pressure", "return_pressure", "accumulator_oil", "pump_flow"),
}
"""Kinds of state, with the beginnings of their names."""

_INTEGRATOR = 1e-6  #: A pole of smaller modulus [rad/s] is taken as 0: round-off of eigenvalues.


class Mode(NamedTuple):
    """One real pole or one pair."""

    pole: complex  #: [rad/s], of a pair the one above the real axis.
    frequency: float  #: Modulus of the pole [rad/s].
    damping_ratio: float  #: -Re / modulus; 1 for a stable real pole, NaN for an integrator.
    participation: dict[str, float]  #: Sums of participation factors by kind of state; sum 1.
    leg_shape: NDArray[np.complex128]  #: Leg motion s, (n,), the largest 1; 0 where no leg moves.
    dof_shares: Matrix
    """Re(s^H J_j x_j) / |s|^2 of pose x = J^-1 s, (6,), sum 1, may be negative; NaN without J."""


def modes(system: control.StateSpace, jacobian: Matrix | None = None) -> tuple[Mode, ...]:
    """All modes of a linearised plant, slowest first.

    Of poles that coincide, such as those of uncoupled equal legs, only the space of all is
    determined, not the shape of one. With the `jacobian` J = d(legs)/d(pose) (6, 6), of a system of
    six legs, they have shares of degrees of freedom. Raises `InputError` for other systems.
    """
    if not system.isctime(strict=True):
        raise InputError("system: is discrete; a linearised plant, which is continuous, is needed")
    begins = {start: kind for kind, starts in _KINDS.items() for start in starts}
    kinds = []
    for label in system.state_labels:
        kind = next((kind for start, kind in begins.items() if label.startswith(start)), None)
        if kind is None:
            raise InputError(
                f"system: state {label!r} is no plant's; allowed: those that begin with "
                f"{', '.join(begins)}"
            )
        kinds.append(kind)
    rows = [i for i, one in enumerate(system.state_labels) if one.startswith("leg_position")]
    if jacobian is not None and len(rows) != len(jacobian):
        raise InputError(f"jacobian: has {len(jacobian)} legs; allowed: the system's {len(rows)}")
    matrix, (scale, _) = linalg.matrix_balance(np.asarray(system.A), permute=False, separate=True)
    poles, right = np.linalg.eig(matrix)
    poles = np.where(np.abs(poles) < _INTEGRATOR, 0.0, poles)
    factors = np.abs(right * np.linalg.inv(right).T)
    factors /= factors.sum(axis=0)
    right = right * scale[:, None]
    result = []
    for i in np.argsort(np.abs(poles), kind="stable"):
        if poles[i].imag < 0.0:
            continue
        size = float(np.abs(poles[i]))
        shape = right[rows, i]
        largest = shape[np.argmax(np.abs(shape))]
        has_motion = np.abs(largest) > 1e-12 * np.abs(right[:, i]).max()
        shape = shape / largest if has_motion else np.zeros(len(rows), dtype=complex)
        damping = float(-poles[i].real / size) if size > _INTEGRATOR else float("nan")
        parts = list(zip(factors[:, i], kinds, strict=True))
        sums = {name: float(sum(f for f, kind in parts if kind == name)) for name in _KINDS}
        dofs = np.full(6, np.nan)
        if jacobian is not None and has_motion:
            along = jacobian * np.linalg.solve(jacobian, shape)
            dofs = np.real(np.conj(shape) @ along) / float(np.sum(np.abs(shape) ** 2))
        result.append(Mode(complex(poles[i]), size, damping, sums, shape, dofs))
    return tuple(result)
