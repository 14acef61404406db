"""Identified models in continuous time, closed with the law and compared with the measured loop.

Series that were decimated are band-limited: the response of a discrete model on the unit circle is
the continuous one there, G(j w) = G_d(e^(j w T)) within the excited band, and `to_continuous` fits
the rational function of s that has this response.

A model of leg velocity per command is closed as in Figure 4-5, position by integration, pressures
zero, and compared with the measured loop in the terms of Table 4-1.

    H(s) = N(s) / D(s),   minimise sum_k |H(j w_k) / H_k - 1|^2

Two steps. Poles are computed without a starting guess by the linear least squares of D H = N,
repeated with the weight 1 / |D| of the time before (Sanathanan and Koerner, IEEE Trans. Automatic
Control 8 (1963) 56-58); those in the right half plane are reflected. Then poles, zeros and gain are
refined together on the complex residuals by `scipy.optimize.least_squares` with the exact Jacobian.
Poles are second-order sections s^2 + a1 s + a0 in the logarithms of a1 and a0 and so remain stable
whether they are complex or real; zeros are free.
"""

from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.identification.data import Real
from cmf_mj.analysis.identification.model import Complex, PolynomialModel
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.analysis.measures import Measures, StepMetrics, joined, measure_loop
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError

_SWEEPS = 30
"""Largest number of repetitions of the linear fit."""

_LARGEST = 60.0
"""Bound of the logarithms of a1 and a0, which are in units of the band's middle."""

_LEAST = 1e-6
"""Least a1 and a0 at the start."""


class ResponseFit(NamedTuple):
    """A transfer function fitted to a response."""

    rational: control.TransferFunction  #: N / D, continuous.
    misfit: float  #: Root of the mean of |H - H_k|^2 / |H_k|^2.


def fit_response(frequency: ArrayLike, response: ArrayLike, poles: int, zeros: int) -> ResponseFit:
    """Fit a stable rational transfer function to a response, all lines relative to their size.

    Lines [Hz], (K,), rise and lie above 0, `response` is complex, (K,); there are at most as many
    zeros as poles. Raises `InputError` for bad lines, orders out of range, too few lines.
    """
    f, h = np.asarray(frequency, dtype=float), np.asarray(response, dtype=complex)
    if f.ndim != 1 or f.shape != h.shape:
        raise InputError(f"frequency, response: {f.shape}, {h.shape}; must be one line of each")
    if f.size < 2 or not (np.isfinite(f).all() and f[0] > 0.0 and (np.diff(f) > 0.0).all()):
        raise InputError("frequency: must be finite, above 0 and rising")
    if not np.isfinite(h).all():
        raise InputError(f"response: is not finite at {f[~np.isfinite(h)][0]} Hz")
    if not 0 <= zeros <= poles:
        raise InputError(f"zeros: {zeros}; allowed with {poles} poles: 0 to {poles}")
    if 2 * f.size <= poles + zeros + 1:
        raise InputError(f"poles, zeros: {poles + zeros + 1} unknowns; {f.size} lines are too few")
    if not 1 <= poles < f.size:
        raise InputError(f"poles: {poles}; allowed with {f.size} lines: 1 to {f.size - 1}")
    scale = 2.0 * np.pi * float(np.sqrt(f[0] * f[-1]))
    s: Complex = np.asarray(2j * np.pi * f / scale, dtype=np.complex128)
    problem = _Refinement(s, h, poles, zeros)
    bound = np.full(poles + zeros + 1, np.inf)
    bound[:poles] = _LARGEST
    how: dict[str, Any] = {"method": "trf", "x_scale": "jac", "max_nfev": 2000}
    how |= {"bounds": (-bound, bound), "ftol": 1e-12, "xtol": 1e-12, "gtol": 1e-12}
    start = problem.start(_linear_fit(s, h, poles))
    fitted = optimize.least_squares(problem.errors, start, problem.jacobian, **how)
    numerator = fitted.x[poles:]
    gain = float(numerator[0])
    if gain == 0.0:
        raise InputError(f"zeros: {zeros} are too many; the highest coefficient is 0")
    rational = control.tf(
        gain * (numerator / gain) * scale ** (poles - np.arange(zeros, -1, -1.0)),
        problem.denominator(fitted.x) * scale ** np.arange(poles + 1.0),
        name="response_fit",
    )
    apart = problem.model(fitted.x) / h - 1.0
    return ResponseFit(rational, float(np.sqrt(np.mean(np.abs(apart) ** 2))))


def _linear_fit(s: Complex, h: Complex, poles: int) -> Complex:
    """Poles, those in the right half plane reflected."""
    powers = s[:, None] ** np.arange(poles, -1, -1)
    roots, weight = np.zeros(0, dtype=complex), 1.0 / np.abs(h)
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
        weight = 1.0 / (np.abs(h) * np.abs(powers @ below))
    return np.where(roots.real > 0.0, -roots.conj(), roots)


class _Refinement:
    """Residuals of N / D and their Jacobian; s is scaled to the band's middle.

    Unknowns: ln a1, ln a0 of each pair of poles, ln a of an odd pole; numerator coefficients from
    the highest power.
    """

    def __init__(self, s: Complex, h: Complex, poles: int, zeros: int) -> None:
        self.s, self.h, self.size, self.poles = s, h, np.abs(h), poles
        self.powers = s[:, None] ** np.arange(zeros, -1, -1)

    def start(self, roots: Complex) -> Real:
        """From the poles of the linear fit: the numerator by linear least squares."""
        # The section of a pair is s^2 - 2 Re p s + |p|^2; real poles pair up by size.
        real = np.sort(-roots[roots.imag == 0.0].real)
        sizes: list[float] = []
        for p in roots[roots.imag > 0.0]:
            sizes += [-2.0 * p.real, abs(p) ** 2]
        for low, high in zip(real[0::2], real[1::2], strict=False):
            sizes += [low + high, low * high]
        if real.size % 2:
            sizes.append(real[-1])
        logs = np.log(np.maximum(sizes, _LEAST))
        base = 1.0 / np.polyval(self.denominator(logs), self.s)
        table, right = self.powers * (base / self.size)[:, None], self.h / self.size
        numerator = np.linalg.lstsq(
            np.vstack([table.real, table.imag]),
            np.concatenate([right.real, right.imag]),
            rcond=None,
        )[0]
        return np.concatenate([logs, numerator])

    def sections(self, x: Real) -> list[tuple[Real, list[int]]]:
        """Sections of the denominator and the places of their unknowns."""
        pairs = [
            (np.array([1.0, np.exp(x[i]), np.exp(x[i + 1])]), [i, i + 1])
            for i in range(0, self.poles - 1, 2)
        ]
        last = self.poles - 1
        odd = [(np.array([1.0, np.exp(x[last])]), [last])] if self.poles % 2 else []
        return pairs + odd

    def denominator(self, x: Real) -> Real:
        result: Real = np.ones(1)
        for section, _ in self.sections(x):
            result = np.asarray(np.polymul(result, section), dtype=float)
        return result

    def model(self, x: Real) -> Complex:
        value = np.polyval(x[self.poles :], self.s)
        for section, _ in self.sections(x):
            value = value / np.polyval(section, self.s)
        return np.asarray(value)

    def errors(self, x: Real) -> Real:
        e = (self.model(x) - self.h) / self.size
        return np.concatenate([e.real, e.imag])

    def jacobian(self, x: Real) -> Real:
        value = self.model(x)
        slope = np.zeros((self.s.size, x.size), dtype=complex)
        for section, columns in self.sections(x):
            below = np.polyval(section, self.s)
            for power, i in zip(range(len(columns) - 1, -1, -1), columns, strict=True):
                slope[:, i] = -value * self.s**power * np.exp(x[i]) / below
        base = 1.0 / np.polyval(self.denominator(x), self.s)
        slope[:, self.poles :] = self.powers * base[:, None]
        slope /= self.size[:, None]
        return np.vstack([slope.real, slope.imag])


BAND = (0.1, 10.0)
"""Band in which a band-limited model is believed [Hz]: the report's of interest (section 4.2)."""

_LINES = 200


def to_continuous(model: PolynomialModel) -> ResponseFit:
    """Continuous transfer function with the response of a discrete model over `BAND`.

    The model, of one input and one output, was identified from band-limited series. It keeps its
    number of poles, with one zero less. The fit is relative over 200 lines evenly spaced in log
    frequency; look at its `misfit`.
    """
    if not BAND[1] < 0.5 / model.step:
        raise InputError(f"step: {model.step} s; allowed: below {0.5 / BAND[1]} s")
    frequency, count = np.geomspace(*BAND, _LINES), model.orders.na
    return fit_response(frequency, model.response(frequency)[:, 0, 0], count, count - 1)


def in_field_units(velocity: control.TransferFunction) -> UnitTransferFunction:
    """Leg velocity per command in in/s per %, of one in m/s per full command.

    Its output is named `leg_velocity`, so that `linear.loop.closed_loop` closes a degree of freedom
    with the law like a leg.
    """
    polynomials = units.from_si("in/s/%", velocity.num[0][0]), velocity.den[0][0]
    names = {"inputs": velocity.input_labels, "outputs": ["leg_velocity"], "name": velocity.name}
    return UnitTransferFunction(*polynomials, input_unit="%", output_unit="in/s", **names)


class LoopErrors(NamedTuple):
    """A model's closed loop and the measured one, in the terms of Table 4-1."""

    model: Measures
    measured: Measures  #: Without a measured step its shape is NaN.

    @property
    def phase_error(self) -> float:
        """Relative error of the -90 deg bandwidth, positive where the model is faster."""
        return self.model.phase_bandwidth_hz / self.measured.phase_bandwidth_hz - 1.0

    @property
    def gain_error(self) -> float:
        """Relative error of the -3 dB bandwidth."""
        return self.model.gain_bandwidth_hz / self.measured.gain_bandwidth_hz - 1.0


def loop_errors(
    velocity: UnitTransferFunction,
    law: str | Law,
    measured: FrequencyResponse,
    step: StepMetrics | None = None,
) -> LoopErrors:
    """Close a velocity model [in/s per %] with a law and compare it with the measured loop.

    `measured` is the response from reference to position under the same law, `step` its measured
    step. A model whose loop is unstable has its response at the measured lines and no step.
    """
    loop = closed_loop(law, velocity)
    model = measure_loop(loop, frequencies=measured.frequency)
    if not model.stable:
        model = joined(bandwidths(loop_response(loop, measured.frequency)))
    return LoopErrors(model, joined(bandwidths(measured), step))
