"""Spectra, fits, variances and checks that the estimators share."""

from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cmf_mj.analysis.response.estimate import (
    CONFIDENCE,
    DRIVEN,
    NEIGHBOURS,
    Complex,
    Estimate,
    Estimator,
    Real,
)
from cmf_mj.core.errors import InputError


class _Windowing(NamedTuple):
    """Options of Welch's method, as `welch_response` names them."""

    rate: float
    segment: float
    overlap: float
    window: Any
    band: tuple[float, float] | None
    pad: bool


def _segments(x: Real, y: Real, options: _Windowing) -> tuple[Real, Complex, Complex, Real]:
    """Lines, spectra (K, nu, S) and (K, ny, S) of x (nu, N) and y (ny, N), correlation (S, S)."""
    if options.segment <= 0.0 or not 0.0 <= options.overlap < 1.0:
        raise InputError(
            f"segment, overlap: {options.segment} s, {options.overlap}; "
            "allowed: above 0 s, and 0 to below 1"
        )
    size, length = x.shape[-1], round(options.segment * options.rate)
    if size < length or length < 4:
        raise InputError(
            f"segment: {options.segment} s must not exceed the record's {size / options.rate:.3f} s"
        )
    hop = max(length - int(options.overlap * length), 1)
    rest = length if options.pad else 0
    both = np.pad(np.vstack([x, y]), ((0, 0), (rest, rest)))
    measured = np.pad(np.ones(size, dtype=bool), rest)
    taper = signal.get_window(options.window, length)
    frequency = _lines(length, options.rate)
    chosen = _within(frequency, options.band, 1.5 / options.segment)
    spectra = _spectra(both, taper, hop, length)[chosen]
    nu = x.shape[0]
    correlation = _correlation(taper, hop, measured)
    return frequency[chosen], spectra[:, :nu], spectra[:, nu:], correlation


def _spectra(x: Real, window: Real, hop: int, size: int) -> Complex:
    """Spectra (F, channels, S) of the segments of x (channels, N), phases from the first sample."""
    transform = signal.ShortTimeFFT(
        window, hop, 1.0, fft_mode="onesided", mfft=size, phase_shift=None
    )
    count = (x.shape[-1] - window.size) // hop + 1
    spectra = transform.stft(x, p0=0, p1=count, k_offset=transform.m_num_mid)
    turn = np.exp(-2j * np.pi * np.outer(transform.f, hop * np.arange(count)))
    return np.asarray(np.swapaxes(spectra, 0, 1) * turn[:, None, :])


def _correlation(window: Real, hop: int, measured: NDArray[np.bool_]) -> Real:
    """Correlation (S, S) between segments of white noise that is there where `measured`."""
    frames = np.lib.stride_tricks.sliding_window_view(measured, window.size)[::hop]
    count = frames.shape[0]
    correlation = np.zeros((count, count))
    for m in range(min(count, -(-window.size // hop))):
        product = np.zeros(window.size)
        product[m * hop :] = window[m * hop :] * window[: window.size - m * hop]
        k = np.arange(count - m)
        correlation[k, k + m] = correlation[k + m, k] = frames[: count - m] @ product
    return correlation / np.sum(window**2)


def _periods(name: str, x: ArrayLike, rate: float, period: float, transient: int) -> Complex:
    """Spectra (..., P, F) of the whole periods of x (..., N) after the transient ones."""
    try:
        history = np.atleast_2d(np.asarray(x, dtype=float))
    except ValueError as error:
        raise InputError(f"{name}: realisations must be of one length") from error
    size = round(period * rate)
    if size < 3 or abs(size - period * rate) > 1e-6:
        raise InputError(f"period: {period} s is not a whole number of samples at {rate} Hz")
    count = history.shape[-1] // size
    if not 0 <= transient < count:
        raise InputError(
            f"transient: {transient} of the record's {count} periods leave none; allowed: 0 to "
            f"{count - 1}"
        )
    whole = history[..., transient * size : count * size]
    return np.asarray(np.fft.rfft(whole.reshape(*whole.shape[:-1], -1, size), axis=-1))


def _stacked(spectra: Complex) -> Complex:
    """Runs' spectra (E, channels, P, F) as (F, channels, E P)."""
    runs, channels, periods, lines = spectra.shape
    return spectra.transpose(3, 1, 0, 2).reshape(lines, channels, runs * periods)


class _Fit(NamedTuple):
    response: Complex  # (K, ny, nu)
    coherence: Real  # (K, ny)
    radius: Real  # (K, ny, nu)
    averages: Real  # (K,)


def _fit(x: Complex, y: Complex, correlation: Real) -> _Fit:
    """Y = H X by least squares on each line; x (K, nu, S), y (K, ny, S), correlation (S, S)."""
    inputs, count = x.shape[1:]
    if count < inputs:
        raise InputError(f"inputs: {count} averages cannot tell {inputs} inputs apart")
    size = np.linalg.norm(x, axis=2, keepdims=True)
    if not np.all(size > 0.0):
        raise InputError(f"inputs: input {np.argwhere(size <= 0.0)[0][1] + 1} is zero at a line")
    basis, triangle = np.linalg.qr(_adjoint(x / size))  # (K, S, nu), (K, nu, nu)
    if np.abs(np.diagonal(triangle, axis1=1, axis2=2)).min() < 1e-6:
        raise InputError("inputs: not independent of each other; drive them in as many runs")
    inverse = np.linalg.inv(triangle)
    response = y @ basis @ _adjoint(inverse) / np.swapaxes(size, 1, 2)
    unexplained = np.sum(np.abs(y - response @ x) ** 2, axis=2)  # (K, ny)
    total = np.sum(np.abs(y) ** 2, axis=2)
    spread = np.tensordot(correlation, basis, axes=(1, 1)).transpose(1, 0, 2)  # R e
    inner = _adjoint(basis) @ spread
    left = np.trace(correlation) - np.trace(inner, axis1=1, axis2=2).real
    square = np.sum(correlation**2) - 2.0 * np.sum(np.abs(spread) ** 2, axis=(1, 2))
    square += np.sum(np.abs(inner) ** 2, axis=(1, 2))
    known = (left > 1e-9 * count) & (count > inputs)
    n = np.where(known, left**2 / np.where(known, square, 1.0), 0.0)
    noise = unexplained / np.where(known, left, 1.0)[:, None]
    gain = np.einsum("kij,kjl,kil->ki", inverse, inner, np.conj(inverse)).real / size[:, :, 0] ** 2
    radius = _radius(noise[:, :, None] * gain[:, None, :], n[:, None, None])
    return _Fit(response, 1.0 - _share(unexplained, total, 1.0), radius, n + 1.0)


def _adjoint(a: Complex) -> Complex:
    return np.conj(np.swapaxes(a, -1, -2))


def _single(frequency: Real, fit: _Fit) -> Estimate:
    response, radius = fit.response[:, 0, 0], fit.radius[:, 0, 0]
    return _frozen(Estimate(frequency, response, fit.coherence[:, 0], radius, fit.averages))


def _radius(variance: Real, averages: ArrayLike) -> Real:
    """95 % radius of a complex mean of this variance, itself known from n averages; n = 0: inf."""
    n = np.broadcast_to(np.asarray(averages, dtype=float), variance.shape)
    known = n > 0.0
    safe = np.where(known, n, 1.0)
    with np.errstate(over="ignore"):
        fisher = safe * np.expm1(-np.log(1.0 - CONFIDENCE) / safe)
    return np.where(known, np.sqrt(fisher * np.where(known, variance, 0.0)), np.inf)


def _variance(squares: Real, count: int) -> Real:
    """Variance of a mean of `count` values from the sum of squared deviations; NaN for one."""
    return squares / (count * (count - 1)) if count > 1 else np.full_like(squares, np.nan)


def _near(power: Real, chosen: Real, fitted: Real) -> tuple[Real, Real]:
    """Mean of `power` over the lines next to each chosen one that no sine lies on, and how many."""
    order = np.arange(power.size)
    free = order[(np.abs(order[:, None] - fitted) > 0.75).all(axis=1) & (order > 0)]
    near = [free[np.argsort(np.abs(free - line), kind="stable")[:NEIGHBOURS]] for line in chosen]
    means = [float(power[lines].mean()) if lines.size else np.nan for lines in near]
    return np.array(means), np.array([float(lines.size) for lines in near])


def _with_harmonics(chosen: Real, harmonics: int, resolution: float, top: float) -> Real:
    """The chosen frequencies, then those of their harmonics that are clear of all others."""
    sines = list(chosen)
    for frequency in np.outer(np.arange(2, harmonics + 1), chosen).ravel():
        clear = min(abs(frequency - other) for other in sines) > 0.5 * resolution
        if clear and frequency < top - 0.5 * resolution:
            sines.append(frequency)
    return np.array(sines)


def _pair(x: ArrayLike, y: ArrayLike) -> tuple[Real, Real]:
    xs, ys = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if xs.ndim != 1 or xs.shape != ys.shape:
        raise InputError(f"x, y: shapes are {xs.shape}, {ys.shape}; both must be (N,)")
    return xs, ys


def _runs(name: str, values: ArrayLike) -> Real:
    history = np.asarray(values, dtype=float)
    if history.ndim not in (2, 3):
        raise InputError(f"{name}: shape is {history.shape}; allowed: (N, n) or (runs, N, n)")
    return history if history.ndim == 3 else history[None]


def _known(estimator: str) -> None:
    if estimator not in get_args(Estimator):
        raise InputError(f"estimator: {estimator!r} is not one of {', '.join(get_args(Estimator))}")


def _lines(size: int, rate: float) -> Real:
    """Frequencies of the real transform of `size` samples [Hz], (size // 2 + 1,)."""
    return np.asarray(np.arange(size // 2 + 1) * (rate / size), dtype=np.float64)


def _within(frequency: Real, band: tuple[float, float] | None, above: float) -> NDArray[np.bool_]:
    low, high = band if band is not None else (0.0, np.inf)
    slack = 1e-9 * frequency[-1]
    return (frequency > above) & (frequency >= low - slack) & (frequency <= high + slack)


def _driven(power: Real) -> NDArray[np.intp]:
    inner = np.concatenate([[0.0], power[1:]])
    lines = np.flatnonzero(inner > DRIVEN**2 * inner.max())
    if lines.size == 0:
        raise InputError("x: no line is driven; the input does not move")
    return lines


def _orders(lines: ArrayLike, size: int) -> NDArray[np.intp]:
    orders = np.asarray(lines)
    if orders.ndim != 1 or orders.size == 0 or not np.issubdtype(orders.dtype, np.integer):
        raise InputError(f"lines: {lines!r} must be a list of whole numbers")
    if orders.min() < 1 or orders.max() >= size:
        raise InputError(f"lines: {orders.min()} to {orders.max()}; allowed: 1 to {size - 1}")
    return np.sort(orders)


def _share(part: Real, whole: Real, empty: float = 0.0) -> Real:
    """Part over whole, 0 to 1, and `empty` where there is nothing."""
    some = whole > 0.0
    return np.where(some, np.clip(part / np.where(some, whole, 1.0), 0.0, 1.0), empty)


def _scaled(variance: Real | None, factor: Real) -> Real | None:
    return None if variance is None else variance * factor**2


def _between(frequency: Real, known: Real, values: ArrayLike) -> Complex:
    parts = np.asarray(values)
    if known.size == 0:
        return np.full(frequency.size, np.nan + 0j)
    options = {"left": np.nan, "right": np.nan}
    real = np.interp(frequency, known, parts.real, **options)
    return real + 1j * np.interp(frequency, known, parts.imag, **options)


def _frozen(estimate: Estimate) -> Estimate:
    for values in estimate[:-1]:
        if isinstance(values, np.ndarray):
            values.setflags(write=False)
    return estimate
