"""Linear plants of a leg: from its command to everything that its sensors read.

`leg_plant` makes one of a model of one output, such as the report's: position is the integral of
velocity and velocity of acceleration, or the other way round the derivative. Commands are constant
over a frame: the discrete plant is exact. `leg_model` takes one leg out of a linearised plant, and
`reduced` any part of a system between some of its signals.
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
MOTIONS = {"leg_position": "m", "leg_velocity": "m/s", "leg_acceleration": "m/s^2"}
"""The first of these, with their units; each is the derivative of the one before."""

Matrix = NDArray[np.float64]


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
        self.input_unit = input_unit  #: Unit of the input.
        self.output_unit = output_unit  #: Unit of the output.

    def to_si(self) -> control.TransferFunction:
        """The same system in SI units, commands as fractions; labels are kept."""
        factor = units.factor(self.output_unit) / units.factor(self.input_unit)
        numerator, denominator = self.num_array[0, 0] * factor, self.den_array[0, 0]
        names = {"inputs": self.input_labels, "outputs": self.output_labels, "name": self.name}
        return control.tf(numerator, denominator, self.dt, **names)


def leg_plant(model: UnitTransferFunction, *, frame: float = FRAME) -> control.StateSpace:
    """One leg from a continuous model of position, velocity or acceleration: per frame [s], SI.

    The derivative of an output without a direct term is exact; with one it is the difference over a
    frame, since a stepped command makes such an output jump. Pressures are zero, as in the report's
    loop. The input is `command` [fraction], the outputs are `FEEDBACK`.
    """
    output = model.output_labels[0]
    check_name("model: output", output, MOTIONS)
    if units.si_unit(model.output_unit) != MOTIONS[output]:
        fault = f"{model.output_unit!r} of {output} is refused; allowed: a unit of"
        raise InputError(f"model: output_unit: {fault} {MOTIONS[output]}")
    if not model.isctime():
        raise InputError(f"model: {output} is discrete; a continuous model is needed")
    si = model.to_si()
    a, b, output_row, direct = signal.tf2ss(si.num_array[0, 0], si.den_array[0, 0])
    a, scaling = linalg.matrix_balance(a, permute=False)
    scale, motion = np.diag(scaling), FEEDBACK.index(output)
    b = b / scale[:, None]
    c, d = np.zeros((len(FEEDBACK), len(a))), np.zeros((len(FEEDBACK), 1))
    c[motion], d[motion] = output_row[0] * scale, direct[0]
    for derivative in range(motion, 0, -1):
        a, b, c, d = _with_integral((a, b, c, d), derivative)
    while motion < len(MOTIONS) - 1 and d[motion, 0] == 0.0:
        c[motion + 1], d[motion + 1, 0] = c[motion] @ a, c[motion] @ b[:, 0]
        motion += 1
    a, b, c, d, _ = signal.cont2discrete((a, b, c, d), frame, method="zoh")
    for derivative in range(motion + 1, len(MOTIONS)):
        a, b, c, d = _with_difference((a, b, c, d), derivative, frame)
    return control.ss(a, b, c, d, frame, inputs=["command"], outputs=list(FEEDBACK), name="plant")


def _with_integral(matrices: tuple[Matrix, ...], motion: int) -> tuple[Matrix, ...]:
    """Set the output before a motion to the integral of the motion; one more state."""
    a, b, c, d = matrices
    a = np.block([[a, np.zeros((a.shape[0], 1))], [c[motion], np.zeros((1, 1))]])
    b, c = np.vstack([b, d[motion]]), np.pad(c, ((0, 0), (0, 1)))
    c[motion - 1, -1] = 1.0
    return a, b, c, d


def _with_difference(matrices: tuple[Matrix, ...], motion: int, frame: float) -> tuple[Matrix, ...]:
    """Set a motion to the difference of the output before it over a frame; one more state."""
    a, b, c, d = matrices
    a = np.block([[a, np.zeros((a.shape[0], 1))], [c[motion - 1], np.zeros((1, 1))]])
    b, c, d = np.vstack([b, d[motion - 1]]), np.pad(c, ((0, 0), (0, 1))), d.copy()
    c[motion], d[motion] = c[motion - 1] / frame, d[motion - 1] / frame
    c[motion, -1] = -1.0 / frame
    return a, b, c, d


def reduced(
    system: control.StateSpace,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
) -> control.StateSpace:
    """A system between some of its signals, by name, without the states that cannot matter there.

    A state is dropped where no chain of non-zero entries leads to it from an input or from it to an
    output. The others stay as they are, with their names.
    """
    columns = _signal_indices("inputs", inputs, system.input_labels)
    rows = _signal_indices("outputs", outputs, system.output_labels)
    a, b, c, d = (np.asarray(m) for m in (system.A, system.B, system.C, system.D))
    b, c, d = b[:, columns], c[rows], d[np.ix_(rows, columns)]
    links = a != 0.0
    driven_states = reachable_states(links, (b != 0.0).any(axis=1))
    read_states = reachable_states(links.T, (c != 0.0).any(axis=0))
    states = np.flatnonzero(driven_states & read_states)
    names = {
        "inputs": [system.input_labels[i] for i in columns],
        "outputs": [system.output_labels[i] for i in rows],
        "states": [system.state_labels[i] for i in states],
    }
    matrices = a[np.ix_(states, states)], b[states], c[:, states], d
    return control.ss(*matrices, system.dt, name=system.name, **names)


def _signal_indices(field: str, names: Sequence[str] | None, labels: list[str]) -> list[int]:
    """Indices of the named signals, of all by default."""
    if names is None:
        return list(range(len(labels)))
    if len(names) == 0:
        raise InputError(f"{field}: none is given; allowed: some of {', '.join(labels)}")
    return [labels.index(check_name(field, name, labels)) for name in names]


def reachable_states(links: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """All states that a chain of links, row from column, reaches."""
    while not ((after := start | links[:, start].any(axis=1)) == start).all():
        start = after
    return start


def leg_model(system: control.StateSpace, leg: int) -> control.StateSpace:
    """One leg, from 1 on, of a linearised plant, the commands of all others constant.

    The others' oil still gives way: a leg of the hexapod keeps the modes of the whole machine.
    Input `command`, outputs `FEEDBACK` with bare names; `reduced(..., outputs=[name])` of it has a
    single output.
    """
    legs = int(system.ninputs)
    if leg not in range(1, legs + 1):
        raise InputError(f"leg: {leg} is not one of 1 to {legs}")
    suffix = f"_{leg}" if legs > 1 else ""
    model = reduced(system, [f"command{suffix}"], [f"{name}{suffix}" for name in FEEDBACK])
    name = f"{system.name}_leg_{leg}"
    return control.ss(model, inputs=["command"], outputs=list(FEEDBACK), name=name)
