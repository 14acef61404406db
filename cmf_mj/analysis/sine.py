"""Sines in a signal, by least squares."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class SineFit(NamedTuple):
    """Sines with an offset, and what is left."""

    amplitude: NDArray[np.complex128]
    """Complex amplitudes a of Re(a e^(j angle)), (K,) or (K, n)."""
    offset: NDArray[np.float64]  #: Mean without the sines, () or (n,).
    remainder: NDArray[np.float64]  #: Values less the fit, (N,) or (N, n).


def fit_sines(values: ArrayLike, angle: ArrayLike, *, drift: bool = False) -> SineFit:
    """Fit offset + sum_k Re(a_k e^(j angle_k)) by least squares.

    `values` are one signal (N,), or several (N, n), `angle` 2 pi f t of each sine [rad], (N,) or
    (N, K); `drift` fits a straight line too.
    """
    y = np.asarray(values, dtype=np.float64)
    angles = np.asarray(angle, dtype=np.float64).reshape(y.shape[0], -1)
    count = angles.shape[1]
    columns = [np.cos(angles), np.sin(angles), np.ones((y.shape[0], 1))]
    if drift:
        columns.append(np.linspace(-1.0, 1.0, y.shape[0])[:, None])
    design = np.hstack(columns)
    fit = np.linalg.lstsq(design, y, rcond=None)[0]
    amplitude = np.asarray(fit[:count] - 1j * fit[count : 2 * count], dtype=np.complex128)
    return SineFit(amplitude, np.asarray(fit[2 * count]), y - design @ fit)
