"""Linear systems on samples: analogue low-pass filters, first-order and zero-order holds.

An analogue low-pass H(s) of corner c becomes H(s(z)), bilinear with pre-warping, with
s = c / tan(pi c / r) * (z - 1) / (z + 1), r the sampling rate. Gain and phase at f are those of the
analogue filter at the warped frequency

    f' = c tan(pi f / r) / tan(pi c / r),

exact at 0 and at the corner. A zero at r / 2 damps contents above the corner more than the analogue
filter does.

A system dx/dt = A x + B u, y = C x + D u with u(t) a straight line from u[k] to u[k+1] over T gives

    x[k+1] = transition x[k] + previous_gain u[k] + next_gain u[k+1],    y[k] = C x[k] + D u[k]

without error, and so do its derivatives at the samples. The matrices come from one exponential
(Franklin, Powell and Workman, Digital Control of Dynamic Systems, section 6.3.2):

    exp(T [[A, B, 0], [0, 0, I / T], [0, 0, 0]]) = [[transition, constant_gain, next_gain], ...],
    previous_gain = constant_gain - next_gain

This first-order hold has no delay: its response to a sine is that of the system times sinc^2(f T),
1 within 5.2e-4 at 1 Hz and within 1.4e-5 at 1 rad/s for T = 1/80 s. `step_matrix` is of a
zero-order hold, u constant over T.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, signal

from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError


def low_pass(order: int, corner: float, rate: float) -> NDArray[np.float64]:
    """Sections b0, b1, b2, 1, a1, a2 (s, 6) of a low-pass, -3 dB at `corner` [Hz]; 0: none."""
    if order < 0:
        raise InputError(f"order: {order} must be at least 0")
    if order == 0:
        return np.empty((0, 6))
    if not 0.0 < corner < rate / 2.0:
        raise InputError(f"corner: {corner:g} Hz must be between 0 and {rate / 2.0:g} Hz")
    return np.ascontiguousarray(signal.butter(order, corner, output="sos", fs=rate))


def settled_filter_state(
    sections: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """State (n, s, 2) of filters that have held the values (n,) for a long time."""
    if sections.shape[0] == 0:
        return np.zeros((values.shape[0], 0, 2))
    return values[:, None, None] * signal.sosfilt_zi(sections)[None]


@compiled
def filter_all(sections, state, values, outputs):  # type: ignore[no-untyped-def]
    """All legs or axes (n,) through filters (s, 6) of states (n, s, 2); unchanged for s = 0.

    `outputs` is overwritten and may be `values` itself.
    """
    for i in range(values.shape[0]):
        outputs[i] = values[i]
        if sections.shape[0] > 0:
            outputs[i] = filter_value(sections, state[i], outputs[i])


@compiled
def filter_value(sections, state, value):  # type: ignore[no-untyped-def]
    """Next output of a filter; its state (s, 2) is overwritten (direct form II, transposed)."""
    for i in range(sections.shape[0]):
        output = sections[i, 0] * value + state[i, 0]
        state[i, 0] = sections[i, 1] * value - sections[i, 4] * output + state[i, 1]
        state[i, 1] = sections[i, 2] * value - sections[i, 5] * output
        value = output
    return value


class SampledSystem(NamedTuple):
    """A system of n states, m inputs and p outputs, discretised with a first-order hold."""

    transition: NDArray[np.float64]  #: (n, n).
    previous_gain: NDArray[np.float64]  #: Of the input at the sample before, (n, m).
    next_gain: NDArray[np.float64]  #: Of the input at the new sample, (n, m).
    output: NDArray[np.float64]  #: C, (p, n).
    direct: NDArray[np.float64]  #: D, (p, m).


def discretise(
    a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike, interval: float
) -> SampledSystem:
    """Discretise A (n, n), B (n, m), C (p, n) and D (p, m) to samples of T = `interval` [s]."""
    dynamics, drive, output, direct = (
        np.atleast_2d(np.array(matrix, dtype=float, order="C")) for matrix in (a, b, c, d)
    )
    (order, input_count), output_count = drive.shape, len(output)
    for name, matrix, shape in (
        ("a", dynamics, (order, order)),
        ("c", output, (output_count, order)),
        ("d", direct, (output_count, input_count)),
    ):
        if matrix.shape != shape:
            raise InputError(f"{name}: shape is {matrix.shape}; allowed: {shape}")
    if not (np.isfinite(interval) and interval > 0.0):
        raise InputError(f"interval: {interval} s must be greater than 0")
    x, u = slice(order), slice(order, order + input_count)
    du = slice(order + input_count, order + 2 * input_count)
    generator = np.zeros((du.stop, du.stop))
    generator[x, x], generator[x, u] = interval * dynamics, interval * drive
    generator[u, du] = np.eye(input_count)
    exponential = linalg.expm(generator)
    constant_gain, next_gain = exponential[x, u], exponential[x, du]
    return SampledSystem(
        transition=np.ascontiguousarray(exponential[x, x]),
        previous_gain=np.ascontiguousarray(constant_gain - next_gain),
        next_gain=np.ascontiguousarray(next_gain),
        output=output,
        direct=direct,
    )


def settled_state(system: SampledSystem, inputs: ArrayLike) -> NDArray[np.float64]:
    """State (n,) of a stable system that has had the inputs (m,) for a long time."""
    change = (system.previous_gain + system.next_gain) @ np.asarray(inputs, dtype=float)
    return np.asarray(linalg.solve(np.eye(change.size) - system.transition, change))


@compiled
def advance(system, state, previous_input, next_input, next_state):  # type: ignore[no-untyped-def]
    """Move the state (n,) in place by a sample, inputs (m,); `next_state` (n,) is work space."""
    previous_gain, next_gain = system.previous_gain, system.next_gain
    order, input_count = previous_gain.shape
    for i in range(order):
        total = 0.0
        for j in range(order):
            total += system.transition[i, j] * state[j]
        for j in range(input_count):
            total += previous_gain[i, j] * previous_input[j] + next_gain[i, j] * next_input[j]
        next_state[i] = total
    for i in range(order):
        state[i] = next_state[i]


@compiled
def write_outputs(system, state, inputs, outputs):  # type: ignore[no-untyped-def]
    """Write the outputs (p,) of a state (n,) and inputs (m,)."""
    for i in range(system.output.shape[0]):
        total = 0.0
        for j in range(state.shape[0]):
            total += system.output[i, j] * state[j]
        for j in range(inputs.shape[0]):
            total += system.direct[i, j] * inputs[j]
        outputs[i] = total


@allocating
def write_history(system, state, inputs, outputs):  # type: ignore[no-untyped-def]
    """Write outputs (N, p) of inputs (N, m); the state (n,) moves from first to last row."""
    next_state = np.empty(state.shape[0])
    for row in range(inputs.shape[0]):
        if row > 0:
            advance(system, state, inputs[row - 1], inputs[row], next_state)
        write_outputs(system, state, inputs[row], outputs[row])


def step_matrix(coefficients: ArrayLike, gain: float, interval: float) -> NDArray[np.float64]:
    """Matrix (n, n+1) of y^(n) + c[n-1] y^(n-1) + ... + c[0] y = gain u, u held constant.

    Times y, its derivatives below the n-th and u, it gives the former after one interval [s].
    """
    order = np.size(coefficients)
    matrix = np.zeros((order + 1, order + 1))
    matrix[: order - 1, 1:order] = np.eye(order - 1)
    matrix[order - 1] = [*-np.asarray(coefficients), gain]
    return np.asarray(linalg.expm(matrix * interval))[:order].copy()
