"""Discrete polynomial models of several inputs and outputs, with what is known of their error.

Each output i has one denominator, common to all inputs j, with n_a coefficients, n_b coefficients
an input and a delay of n_k samples:

    A_i(q) y_i[k] = sum_j B_ij(q) u_j[k] + noise
    A = 1 + a_1 q^-1 + ... + a_na q^-na,   B = b_1 q^-nk + ... + b_nb q^-(nk + nb - 1)

The noise enters as white e[k] on the right (`equation`: ARX, Eqs 4.8, 4.9) or as y = B/A u + v
(`output`: output error). The parameters of a row are a_1 .. a_na, then b of
the first input, of the second and so on; `covariances` holds one matrix a row in that order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal, stats

from cmf_mj.analysis.identification.data import LABELS, Experiment, Real
from cmf_mj.core.errors import InputError

Complex = NDArray[np.complex128]

STABILITY = 1e-9
"""Distance from the unit circle below which a pole counts as on it, not outside."""

AT_NYQUIST = 0.1
"""Distance from -1 within which a real pole is at the Nyquist frequency."""


class Orders(NamedTuple):
    """Orders of an ARX or output-error model."""

    na: int  #: Coefficients of A besides its leading 1, at least 1.
    nb: int  #: Coefficients of each B, at least 1.
    nk: int = 1  #: Delay from input to output [samples], at least 0.

    def check(self) -> "Orders":
        """Refuse orders out of range, by their name."""
        for name, least in (("na", 1), ("nb", 1), ("nk", 0)):
            value = getattr(self, name)
            if value != int(value) or value < least:
                raise InputError(f"{name}: {value} must be a whole number, at least {least}")
        return self

    @property
    def lag(self) -> int:
        """Samples before the first that the model can explain."""
        return max(self.na, self.nk + self.nb - 1)

    def parameters(self, inputs: int) -> int:
        """Parameters of a row."""
        return self.na + self.nb * inputs


class Root(NamedTuple):
    """A pole or zero with its standard deviations."""

    value: complex  #: In the z plane.
    covariance: Real  #: Of real and imaginary part, (2, 2); NaN where nothing is known.


@dataclass(frozen=True)
class PolynomialModel:
    """A discrete model B/A of nu inputs and ny outputs."""

    orders: Orders
    denominators: Real  #: A of each row, (ny, na + 1), leading 1.
    numerators: Real  #: B with its leading zeros, (ny, nu, nk + nb).
    step: float  #: Sampling interval [s].
    covariances: Real  #: Of the parameters of each row, (ny, p, p).
    noise_variance: Real  #: Of e or v, (ny,), in squares of the outputs' units.
    noise: Literal["equation", "output"]  #: Where the noise enters.
    method: str  #: How the model was fitted: arx or oe.
    samples: int  #: Samples the fit used.
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    reflected: tuple[complex, ...] = ()
    """Poles outside the unit circle that were reflected into it, as fitted."""
    converged: bool = True
    """Whether an iteration ended by its tolerance, not by its largest number of steps."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("denominators", "numerators", "covariances", "noise_variance"):
            getattr(self, name).setflags(write=False)

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return int(self.numerators.shape[1])

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return int(self.numerators.shape[0])

    def parameters(self, row: int = 0) -> Real:
        """Parameters of a row: a, then b of each input, (p,)."""
        return np.concatenate(
            [self.denominators[row, 1:], self.numerators[row, :, self.orders.nk :].ravel()]
        )

    def standard_errors(self, row: int = 0) -> Real:
        """Standard deviations of the parameters of a row, (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariances[row])))

    def poles(self, row: int = 0) -> tuple[Root, ...]:
        """Poles of a row with their covariances, to first order in those of the parameters."""
        na = self.orders.na
        return _roots(self.denominators[row], self.covariances[row][:na, :na])

    def zeros(self, row: int = 0, column: int = 0) -> tuple[Root, ...]:
        """Zeros from an input to an output with their covariances."""
        b = self.numerators[row, column, self.orders.nk :]
        at = self.orders.na + self.orders.nb * column + np.arange(b.size)
        covariance = self.covariances[row][np.ix_(at, at)]
        lead = b[0]
        if lead == 0.0:
            return _roots(b, np.full((b.size - 1, b.size - 1), np.nan))
        # The roots are those of b / b_1: take the covariance of the ratios.
        ratios = np.hstack([-b[1:, None] / lead**2, np.eye(b.size - 1) / lead])
        return _roots(b / lead, ratios @ covariance @ ratios.T)

    @property
    def unstable_poles(self) -> tuple[complex, ...]:
        """Poles outside the unit circle, of all rows."""
        roots = [np.roots(a) for a in self.denominators]
        return tuple(complex(p) for r in roots for p in r if abs(p) > 1.0 + STABILITY)

    @property
    def nyquist_poles(self) -> tuple[float, ...]:
        """Real poles within `AT_NYQUIST` of -1, which alternate: no continuous system has them."""
        roots = np.concatenate([np.roots(a) for a in self.denominators])
        return tuple(float(p.real) for p in roots if p.imag == 0.0 and abs(p + 1.0) < AT_NYQUIST)

    def stabilised(self) -> "PolynomialModel":
        """Poles p outside the unit circle put at 1 / conj(p), gain kept at every frequency.

        |B/A| on the unit circle does not change; the phase does. The poles as fitted are kept in
        `reflected`; covariances become NaN. A stable model is returned as it is.
        """
        unstable = self.unstable_poles
        if not unstable:
            return self
        a, b = self.denominators.copy(), self.numerators.copy()
        for row in range(self.outputs):
            roots = np.roots(a[row]).astype(complex)
            outside = np.abs(roots) > 1.0 + STABILITY
            b[row] /= np.prod(np.abs(roots[outside]))
            roots[outside] = 1.0 / np.conj(roots[outside])
            a[row] = np.poly(roots).real
        unknown = np.full_like(self.covariances, np.nan)
        return replace(self, denominators=a, numerators=b, covariances=unknown, reflected=unstable)

    def transfer_function(self, row: int = 0, column: int = 0) -> control.TransferFunction:
        """One input to one output as a python-control transfer function in z, with labels."""
        a, b = self.denominators[row], self.numerators[row, column]
        above, below = (np.pad(part, (0, max(a.size, b.size) - part.size)) for part in (b, a))
        names = {"inputs": [self.input_names[column]], "outputs": [self.output_names[row]]}
        return control.tf(above, below, self.step, name=self.method, **names)

    def simulate(self, inputs: ArrayLike) -> Real:
        """Outputs (N, ny) of inputs (N, nu) from rest."""
        u = np.asarray(inputs, dtype=float)
        if u.ndim != 2 or u.shape[1] != self.inputs:
            raise InputError(f"inputs: shape is {u.shape}; allowed: (N, {self.inputs})")
        return np.column_stack(
            [
                sum(
                    signal.lfilter(self.numerators[i, j], self.denominators[i], u[:, j])
                    for j in range(self.inputs)
                )
                for i in range(self.outputs)
            ]
        )

    def free_responses(self, row: int, samples: int) -> Real:
        """Responses (samples, na) to unit values of the row's states: any start is a sum of them.

        They are the responses of 1/A to an impulse 0 to na - 1 samples after the start.
        """
        impulse = np.zeros(samples)
        impulse[0] = 1.0
        first = signal.lfilter([1.0], self.denominators[row], impulse)
        return np.column_stack(
            [np.concatenate([np.zeros(i), first[: samples - i]]) for i in range(self.orders.na)]
        )

    def predicted(self, experiment: Experiment) -> Real:
        """One-step predictions with past outputs (N, ny); `orders.lag` rows lack some of these."""
        self.check(experiment)
        past = [
            signal.lfilter(np.concatenate([[0.0], -a[1:]]), [1.0], experiment.output[:, i])
            + sum(
                signal.lfilter(self.numerators[i, j], [1.0], experiment.input[:, j])
                for j in range(self.inputs)
            )
            for i, a in enumerate(self.denominators)
        ]
        return np.column_stack(past)

    def check(self, experiment: Experiment) -> None:
        """Refuse an experiment of other signals or another rate."""
        for field in ("input_names", "output_names"):
            have, need = getattr(experiment, field), getattr(self, field)
            if have != need:
                raise InputError(f"{field}: {', '.join(have)}; the model's are {', '.join(need)}")
        if abs(experiment.step / self.step - 1.0) > 1e-9:
            raise InputError(f"step: {experiment.step} s; the model's is {self.step} s")

    def response(self, frequency: ArrayLike) -> Complex:
        """Frequency response (K, ny, nu) at `frequency` [Hz]."""
        delay = self._delay(frequency)
        numerator = np.einsum("kl,ijl->kij", delay[:, : self.numerators.shape[2]], self.numerators)
        denominator = delay[:, : self.denominators.shape[1]] @ self.denominators.T
        return np.asarray(numerator / denominator[:, :, None])

    def response_covariance(self, frequency: ArrayLike, row: int = 0, column: int = 0) -> Real:
        """Covariance (K, 2, 2) of real and imaginary part of one response, to first order."""
        na, nb, nk = self.orders
        delay = self._delay(frequency)
        a = delay[:, : na + 1] @ self.denominators[row]
        g = self.response(frequency)[:, row, column]
        slope = np.zeros((g.size, self.covariances.shape[1]), dtype=complex)
        slope[:, :na] = -delay[:, 1 : na + 1] * (g / a)[:, None]
        first = na + nb * column
        slope[:, first : first + nb] = delay[:, nk : nk + nb] / a[:, None]
        parts = np.stack([slope.real, slope.imag], axis=1)
        return np.asarray(parts @ self.covariances[row] @ np.swapaxes(parts, 1, 2))

    def _delay(self, frequency: ArrayLike) -> Complex:
        """q^-l at the frequencies, (K, longest + 1)."""
        angle = 2.0 * np.pi * np.atleast_1d(np.asarray(frequency, dtype=float)) * self.step
        longest = max(self.denominators.shape[1], self.numerators.shape[2])
        return np.asarray(np.exp(-1j * np.outer(angle, np.arange(longest))))


def _roots(polynomial: Real, covariance: Real) -> tuple[Root, ...]:
    """Roots of a monic polynomial whose other coefficients have this covariance.

    dp/da_i = -p^(n - i) / A'(p) for a simple root.
    """
    degree = polynomial.size - 1
    slope = np.polyder(polynomial)
    roots = []
    for p in np.roots(polynomial):
        steep = np.polyval(slope, p)
        if steep == 0.0:
            roots.append(Root(complex(p), np.full((2, 2), np.nan)))
            continue
        change = -(p ** np.arange(degree - 1, -1, -1)) / steep
        parts = np.stack([change.real, change.imag])
        roots.append(Root(complex(p), np.asarray(parts @ covariance @ parts.T)))
    return tuple(roots)


class FittedRow(NamedTuple):
    """What a fit says of one row of a model."""

    parameters: Real  #: a, then b of each input, (p,).
    covariance: Real  #: (p, p).
    variance: float  #: Of e or v.
    converged: bool = True


def from_rows(
    orders: Orders, rows: Sequence[FittedRow], like: Experiment, *, method: str, samples: int
) -> PolynomialModel:
    """Build a model from its fitted rows and an experiment's labels."""
    theta = np.stack([row.parameters for row in rows])
    b = theta[:, orders.na :].reshape(theta.shape[0], like.input.shape[1], orders.nb)
    return PolynomialModel(
        orders=orders,
        denominators=np.hstack([np.ones((theta.shape[0], 1)), theta[:, : orders.na]]),
        numerators=np.concatenate([np.zeros((*b.shape[:2], orders.nk)), b], axis=2),
        step=like.step,
        covariances=np.stack([row.covariance for row in rows]),
        noise_variance=np.array([row.variance for row in rows]),
        noise="equation" if method == "arx" else "output",
        method=method,
        samples=samples,
        **{name: getattr(like, name) for name in LABELS},
        converged=all(row.converged for row in rows),
    )


CONFIDENCE = 0.99
"""Probability of the bounds of a right model."""


def fit_percentage(measured: ArrayLike, modelled: ArrayLike) -> Real:
    """Fit of each output (ny,) in per cent: 100 is perfect, 0 no better than the mean.

    A model that leaves the finite numbers has -inf; an output that does not move is refused.
    """
    y, model = np.asarray(measured, dtype=float), np.asarray(modelled, dtype=float)
    if y.shape != model.shape:
        raise InputError(f"modelled: shape is {model.shape}; measured has {y.shape}")
    y, model = (x[:, None] if x.ndim == 1 else x for x in (y, model))
    spread = np.linalg.norm(y - y.mean(axis=0), axis=0)
    if not (spread > 0.0).all():
        raise InputError("measured: an output does not move; a fit to it is not defined")
    with np.errstate(over="ignore", invalid="ignore"):
        missed = np.linalg.norm(y - model, axis=0) / spread
    return np.asarray(100.0 * (1.0 - np.where(np.isnan(missed), np.inf, missed)))


def simulated(model: PolynomialModel, experiment: Experiment) -> Real:
    """Outputs (N, ny) of the model, driven by the inputs alone.

    The initial state of every row is fitted to the measured output by least squares, as `compare`
    does; `PolynomialModel.simulate` begins at rest.
    """
    model.check(experiment)
    outputs = model.simulate(experiment.input)
    for row in range(model.outputs):
        free = model.free_responses(row, experiment.samples)
        missing = experiment.output[:, row] - outputs[:, row]
        if np.isfinite(free).all() and np.isfinite(missing).all():
            outputs[:, row] += free @ np.linalg.lstsq(free, missing, rcond=None)[0]
    return outputs


def simulation_fit(model: PolynomialModel, experiment: Experiment) -> Real:
    """Fit of each output (ny,) of the simulated model in per cent."""
    return fit_percentage(experiment.output, simulated(model, experiment))


def residuals(model: PolynomialModel, experiment: Experiment) -> Real:
    """What the model leaves of the outputs, (N - lag, ny): e (`equation`) or v (`output`)."""
    modelled = simulated if model.noise == "output" else PolynomialModel.predicted
    return (experiment.output - modelled(model, experiment))[model.orders.lag :]


class Residuals(NamedTuple):
    """Correlations of the residual of one output, with the bounds of a right model."""

    lags: Real  #: 0 to the largest [samples], (L,).
    auto: Real  #: R_ee / R_ee(0), (L,).
    auto_bound: float
    cross: Real  #: R_eu / sqrt(R_ee(0) R_uu(0)) for each input, (nu, L).
    cross_bound: Real  #: (nu,).

    @property
    def cross_outside(self) -> Real:
        """Share of the lags at which the cross-correlation exceeds its bound, (nu,)."""
        return np.asarray(np.mean(np.abs(self.cross) > self.cross_bound[:, None], axis=1))


def residual_analysis(
    model: PolynomialModel, experiment: Experiment, *, lags: int = 40
) -> Residuals:
    """Correlate the residuals of a model's first output with themselves and with the inputs."""
    e = residuals(model, experiment)[:, 0]
    if not 1 <= lags < e.size:
        raise InputError(f"lags: {lags}; allowed: 1 to {e.size - 1}")
    u = experiment.input[model.orders.lag :]
    e, u = e - e.mean(), u - u.mean(axis=0)
    size = float(np.sqrt(np.mean(e**2)))
    if size == 0.0:
        raise InputError("experiment: the residuals are zero; they have no correlation")
    e = e / size
    u = u / np.sqrt(np.mean(u**2, axis=0))
    auto = _correlation(e, e, lags)
    point = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
    drives = [_correlation(column, column, lags) for column in u.T]
    spread = np.array([1.0 + 2.0 * float(np.sum(auto[1:] * drive[1:])) for drive in drives])
    return Residuals(
        np.arange(lags + 1.0),
        auto,
        point / np.sqrt(e.size),
        np.stack([_correlation(e, column, lags) for column in u.T]),
        point * np.sqrt(np.clip(spread, 0.0, None) / e.size),
    )


def _correlation(a: Real, b: Real, lags: int) -> Real:
    """mean(a[k] b[k-l]) for l = 0 .. lags."""
    full = signal.correlate(a, b, mode="full", method="fft") / a.size
    return np.asarray(full[b.size - 1 : b.size + lags])
