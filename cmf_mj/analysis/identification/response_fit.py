"""Continuous transfer functions fitted to a measured frequency response.

    H(s) = g N(s) / D(s) e^(-s tau),   minimise sum_k |H(j w_k) - H_k|^2 / sigma_k^2

Two steps. Poles are computed without a starting guess by the linear least squares of D H = N,
repeated with the weight 1 / |D| of the time before (Sanathanan and Koerner, IEEE Trans. Automatic
Control 8 (1963) 56-58); those in the right half plane are reflected and counted. Then poles, zeros,
gain and delay are refined together on the complex residuals by `scipy.optimize.least_squares` with
the exact Jacobian. Poles are second-order sections
s^2 + a1 s + a0 in the logarithms of a1 and a0 and so remain stable whether they are complex or
real; zeros are free.

sigma is the standard deviation of each line's response, such as a multiple of an `Estimate`'s
radius; without it the misfit counts relative to |H|.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from cmf_mj.analysis.identification.data import Real
from cmf_mj.analysis.identification.model import Complex
from cmf_mj.core.errors import InputError

_SWEEPS = 30
"""Largest number of repetitions of the linear fit."""

_LARGEST = 60.0
"""Bound of the logarithms of a1 and a0, which are in units of the band's middle."""


class ResponseFit(NamedTuple):
    """A transfer function fitted to a response."""

    rational: control.TransferFunction  #: g N / D, continuous, without the delay.
    delay: float  #: tau [s].
    poles: Complex  #: [rad/s], by modulus.
    zeros: Complex  #: [rad/s], by modulus.
    misfit: float  #: Root of the mean of |H - H_k|^2 / |H_k|^2.
    loss: float  #: Sum of the squared weighted residuals.
    aic: float
    bic: float
    reflected: int  #: Poles of the linear fit that had to be reflected.

    def response(self, frequency: ArrayLike) -> Complex:
        """H at `frequency` [Hz], (K,)."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequency, dtype=float))
        value = np.polyval(self.rational.num[0][0], s) / np.polyval(self.rational.den[0][0], s)
        return np.asarray(value * np.exp(-s * self.delay))


def fit_response(
    frequency: ArrayLike,
    response: ArrayLike,
    poles: int,
    zeros: int,
    *,
    deviation: ArrayLike | None = None,
    delay: float = 0.0,
    fit_delay: bool = False,
) -> ResponseFit:
    """Fit a stable rational transfer function, with a pure delay on demand, to a response.

    Lines [Hz], (K,), rise and lie above 0, `response` is complex, (K,); there are at most as many
    zeros as poles. `deviation` is the standard deviation of each line, such as
    an `Estimate`'s radius, default |response|: a relative fit. `delay` [s] is fixed, or with
    `fit_delay` where to start it; it stays at or above 0. Raises `InputError` for bad lines, orders
    out of range, too few lines.
    """
    f, h, sigma = _checked_lines(frequency, response, deviation)
    if not 0 <= zeros <= poles:
        raise InputError(f"zeros: {zeros}; allowed with {poles} poles: 0 to {poles}")
    unknowns = poles + zeros + 1 + int(fit_delay)
    if 2 * f.size <= unknowns:
        raise InputError(f"poles, zeros: {unknowns} unknowns; {f.size} lines are too few")
    if not 1 <= poles < f.size:
        raise InputError(f"poles: {poles}; allowed with {f.size} lines: 1 to {f.size - 1}")
    if not (np.isfinite(delay) and delay >= 0.0):
        raise InputError(f"delay: {delay} s must be a finite number, at least 0")
    scale = 2.0 * np.pi * float(np.sqrt(f[0] * f[-1]))
    s: Complex = np.asarray(2j * np.pi * f / scale, dtype=np.complex128)
    advanced = h * np.exp(s * delay * scale)
    roots, reflected = _linear_fit(s, advanced, sigma, poles)
    problem = _Refinement(s, h, sigma, poles, zeros, delay * scale, fit_delay)
    fitted = optimize.least_squares(
        problem.errors,
        problem.start(roots),
        problem.jacobian,
        method="trf",
        x_scale="jac",
        bounds=problem.bounds(),
        ftol=1e-12,
        xtol=1e-12,
        gtol=1e-12,
        max_nfev=2000,
    )
    gain, numerator, denominator, late = problem.parts(fitted.x)
    loss = 2.0 * float(fitted.cost)
    count = 2 * f.size
    order = np.arange(poles, -1, -1)
    rational = control.tf(
        gain * numerator * scale ** (poles - np.arange(zeros, -1, -1.0)),
        denominator * scale ** (poles - order.astype(float)),
        name="response_fit",
    )
    values = np.concatenate([np.roots(section) for section, _ in problem.sections(fitted.x)])
    by_size = np.argsort(np.abs(values), kind="stable")
    nought = np.roots(numerator)
    modelled = problem.model(fitted.x)
    return ResponseFit(
        rational,
        late / scale,
        np.asarray(values[by_size] * scale, dtype=complex),
        np.asarray(nought[np.argsort(np.abs(nought), kind="stable")] * scale, dtype=complex),
        float(np.sqrt(np.mean(np.abs(modelled / h - 1.0) ** 2))),
        loss,
        float(count * np.log(loss / count) + 2.0 * unknowns),
        float(count * np.log(loss / count) + unknowns * np.log(count)),
        reflected,
    )


def _checked_lines(
    frequency: ArrayLike, response: ArrayLike, deviation: ArrayLike | None
) -> tuple[Real, Complex, Real]:
    """Lines [Hz], response and deviation as arrays (K,) that belong together."""
    f, h = np.asarray(frequency, dtype=float), np.asarray(response, dtype=complex)
    sigma = np.abs(h) if deviation is None else np.asarray(deviation, dtype=float)
    if f.ndim != 1 or not f.shape == h.shape == sigma.shape:
        raise InputError(f"frequency, response: {f.shape}, {h.shape}; must be one line of each")
    if f.size < 2 or not (np.isfinite(f).all() and f[0] > 0.0 and (np.diff(f) > 0.0).all()):
        raise InputError("frequency: must be finite, above 0 and rising")
    if not np.isfinite(h).all():
        raise InputError(f"response: is not finite at {f[~np.isfinite(h)][0]} Hz")
    if not (np.isfinite(sigma).all() and (sigma > 0.0).all()):
        raise InputError("deviation: must be finite and greater than 0 at every line")
    return f, h, sigma


def _linear_fit(s: Complex, h: Complex, sigma: Real, poles: int) -> tuple[Complex, int]:
    """Poles in the left half plane, and how many had to be reflected into it."""
    powers = s[:, None] ** np.arange(poles, -1, -1)
    roots, weight = np.zeros(0, dtype=complex), 1.0 / sigma
    for _ in range(_SWEEPS):
        table = np.hstack([powers, -h[:, None] * powers[:, 1:]]) * weight[:, None]
        right = h * powers[:, 0] * weight
        system = np.vstack([table.real, table.imag])
        size = np.linalg.norm(system, axis=0)
        target = np.concatenate([right.real, right.imag])
        solution = np.linalg.lstsq(system / size, target, rcond=None)[0] / size
        below = np.concatenate([[1.0], solution[poles + 1 :]])
        before, roots = roots, np.sort_complex(np.roots(below))
        if before.size and np.abs(roots - before).max() < 1e-8 * np.abs(roots).max():
            break
        weight = 1.0 / (sigma * np.abs(powers @ below))
    outside = roots.real > 0.0
    return np.where(outside, -roots.conj(), roots), int(outside.sum())


class _Refinement:
    """Residuals of g N / D e^(-s tau) and their Jacobian; s is scaled to the band's middle.

    Unknowns: ln a1, ln a0 of each pair of poles, ln a of an odd pole; numerator coefficients from
    the highest power; tau.
    """

    def __init__(
        self, s: Complex, h: Complex, sigma: Real, poles: int, zeros: int, delay: float, fit: bool
    ) -> None:
        self.s, self.h, self.sigma = s, h, sigma
        self.poles, self.zeros, self.delay, self.fit_delay = poles, zeros, delay, fit

    def start(self, roots: Complex) -> Real:
        """From the poles of the linear fit: the numerator by linear least squares."""
        # The section of a pair is s^2 - 2 Re p s + |p|^2; real poles pair up by size.
        above = roots[roots.imag > 0.0]
        real = np.sort(-roots[roots.imag == 0.0].real)
        logs: list[float] = []
        floor = 1e-6
        for p in above:
            logs += [np.log(max(-2.0 * p.real, floor)), np.log(max(abs(p) ** 2, floor))]
        for low, high in zip(real[0::2], real[1::2], strict=False):
            logs += [np.log(max(low + high, floor)), np.log(max(low * high, floor))]
        if real.size % 2:
            logs.append(np.log(max(real[-1], floor)))
        denominator = self._denominator(np.array(logs))
        base = np.exp(-self.s * self.delay) / np.polyval(denominator, self.s)
        table = self.s[:, None] ** np.arange(self.zeros, -1, -1) * (base / self.sigma)[:, None]
        right = self.h / self.sigma
        numerator = np.linalg.lstsq(
            np.vstack([table.real, table.imag]),
            np.concatenate([right.real, right.imag]),
            rcond=None,
        )[0]
        return np.concatenate([logs, numerator, [self.delay] if self.fit_delay else []])

    def bounds(self) -> tuple[Real, Real]:
        """The delay is not below 0; logarithms keep within what a double can square."""
        high = np.full(self.poles + self.zeros + 1 + int(self.fit_delay), np.inf)
        high[: self.poles] = _LARGEST
        low = -high
        if self.fit_delay:
            low[-1] = -1e-12
        return low, high

    def _denominator(self, logs: Real) -> Real:
        result: Real = np.ones(1)
        for section, _ in self.sections(logs):
            result = np.asarray(np.polymul(result, section), dtype=float)
        return result

    def sections(self, x: Real) -> list[tuple[Real, list[int]]]:
        """Sections of the denominator and the places of their unknowns."""
        pairs = [
            (np.array([1.0, np.exp(x[i]), np.exp(x[i + 1])]), [i, i + 1])
            for i in range(0, self.poles - 1, 2)
        ]
        last = self.poles - 1
        odd = [(np.array([1.0, np.exp(x[last])]), [last])] if self.poles % 2 else []
        return pairs + odd

    def parts(self, x: Real) -> tuple[float, Real, Real, float]:
        """Gain, monic numerator, monic denominator, delay."""
        numerator = x[self.poles : self.poles + self.zeros + 1]
        late = float(max(x[-1], 0.0)) if self.fit_delay else self.delay
        lead = float(numerator[0])
        if lead == 0.0:
            raise InputError(f"zeros: {self.zeros} are too many; the highest coefficient is 0")
        return lead, numerator / lead, self._denominator(x[: self.poles]), late

    def model(self, x: Real) -> Complex:
        numerator = x[self.poles : self.poles + self.zeros + 1]
        late = x[-1] if self.fit_delay else self.delay
        value = np.polyval(numerator, self.s) * np.exp(-self.s * late)
        for section, _ in self.sections(x):
            value = value / np.polyval(section, self.s)
        return np.asarray(value)

    def errors(self, x: Real) -> Real:
        e = (self.model(x) - self.h) / self.sigma
        return np.concatenate([e.real, e.imag])

    def jacobian(self, x: Real) -> Real:
        value = self.model(x)
        slope = np.zeros((self.s.size, x.size), dtype=complex)
        for section, columns in self.sections(x):
            below = np.polyval(section, self.s)
            for power, i in zip(range(len(columns) - 1, -1, -1), columns, strict=True):
                slope[:, i] = -value * self.s**power * np.exp(x[i]) / below
        late = x[-1] if self.fit_delay else self.delay
        base = np.exp(-self.s * late) / np.polyval(self._denominator(x[: self.poles]), self.s)
        powers = np.arange(self.zeros, -1, -1)
        slope[:, self.poles : self.poles + self.zeros + 1] = (
            self.s[:, None] ** powers * base[:, None]
        )
        if self.fit_delay:
            slope[:, -1] = -self.s * value
        slope /= self.sigma[:, None]
        return np.vstack([slope.real, slope.imag])
