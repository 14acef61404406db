"""Analogue low-pass filters run on samples: Butterworth, bilinear with pre-warping.

An analogue filter H(s) of corner c becomes H(s(z)) with s = c / tan(pi c / r) * (z - 1) / (z + 1),
r the sampling rate. Gain and phase at f are those of the analogue filter at the warped frequency

    f' = c tan(pi f / r) / tan(pi c / r),

exact at 0 and at the corner. A zero-order hold would add half a sample of delay that an analogue
filter does not have, and is not used. The price is a zero at r / 2: contents above the corner are
damped more than by the analogue filter.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError


def low_pass(order: int, corner: float, rate: float) -> NDArray[np.float64]:
    """Second-order sections (s, 6) of a low-pass, -3 dB at the corner [Hz]; (0, 6) for order 0."""
    if order < 0:
        raise InputError(f"order: {order} must be at least 0")
    if order == 0:
        return np.empty((0, 6))
    if not 0.0 < corner < rate / 2.0:
        raise InputError(f"corner: {corner:g} Hz must be between 0 and {rate / 2.0:g} Hz")
    return np.ascontiguousarray(signal.butter(order, corner, output="sos", fs=rate))


def settled(sections: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """State (n, s, 2) of filters that have held the values (n,) for a long time."""
    if sections.shape[0] == 0:
        return np.zeros((values.shape[0], 0, 2))
    return values[:, None, None] * signal.sosfilt_zi(sections)[None]


@compiled
def filter_all(sections, state, values, passed):  # type: ignore[no-untyped-def]
    """All legs or axes (n,) through filters (s, 6) of states (n, s, 2); none pass as they are.

    `passed` is overwritten and may be `values` itself.
    """
    for i in range(values.shape[0]):
        passed[i] = values[i]
        if sections.shape[0] > 0:
            passed[i] = filtered(sections, state[i], passed[i])


@compiled
def filtered(sections, state, value):  # type: ignore[no-untyped-def]
    """Next output of a filter; its state (s, 2) is overwritten (direct form II, transposed)."""
    for i in range(sections.shape[0]):
        output = sections[i, 0] * value + state[i, 0]
        state[i, 0] = sections[i, 1] * value - sections[i, 4] * output + state[i, 1]
        state[i, 1] = sections[i, 2] * value - sections[i, 5] * output
        value = output
    return value
