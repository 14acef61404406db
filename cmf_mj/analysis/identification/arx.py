"""Equation-error least squares (ARX) and the choice of its orders.

Each row of the model is linear in its parameters (Eq 4.10),

    y[k] = phi[k] theta + e[k],   phi = (-y[k-1] .. -y[k-na], u_j[k-nk] .. u_j[k-nk-nb+1])

and is solved by QR of the regressors of all experiments together, each scaled to unit size:

    cov theta = s^2 (R^T R)^-1,   s^2 = |e|^2 / (N - p)

Consistent where the noise really enters as A y = B u + e. Noise on a motion sensor enters as
y = B/A u + v: the past outputs in phi then hold the noise, and poles are biased towards more
damping. `output_error` and `instrumental_variable` are free of that.

Orders: with V the mean square of e over the samples that every candidate explains,

    AIC = N ln V + 2 p,   BIC = N ln V + p ln N      (summed over the rows)

and the fit (NRMSE, `fit_percentage`) of the simulated model to experiments not used in the fit. On
records without noise V falls with every order and AIC and BIC choose the largest; the validation
fit shows which order gains by it.
"""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, signal, stats

from cmf_mj.analysis.frequency_response import FrequencyResponse, excited_response
from cmf_mj.analysis.identification.data import Experiment, Real, experiment
from cmf_mj.analysis.identification.model import FittedRow, Orders, PolynomialModel, from_rows
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.record.record import Record

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


RATE = 128.0
"""Sampling rate of the analysis [Hz], the facility recorder's."""


def plant_response(record: Record, axis: str) -> FrequencyResponse:
    """Response from the command at the valve to leg velocity along a leg or degree of freedom.

    The record is of a chirp, noise or multisine along the axis, surge to yaw or leg_1 and so on.
    Lines lie in the band of the excitation, in SI per full command; the coherence is the lesser of
    reference to input and reference to output. Raises `InputError` without excitation.
    """
    # The analysis rate, or the record's where it is lower or no multiple.
    factor = record.rate / RATE
    rate = RATE if factor >= 1.0 and abs(factor - round(factor)) < 1e-9 else record.rate
    series = experiment(record, axis, rate=rate)
    if series.reference is None or np.ptp(series.reference[:, 0]) < 1e-9:
        raise InputError(f"axis: the record holds no demand in {axis}")
    to_input, to_output = (
        excited_response(series.reference[:, 0], values[:, 0], series.rate, record.signal)
        for values in (series.input, series.output)
    )
    response = to_output.response / to_input.response
    shares = [each.radius / np.abs(each.response) for each in (to_output, to_input)]
    coherence = np.minimum(to_input.coherence, to_output.coherence)
    bound = (shares[0] + shares[1]) * np.abs(response)
    names = {"inputs": list(series.input_names), "outputs": list(series.output_names)}
    return FrequencyResponse(response, 2.0 * np.pi * to_input.frequency, coherence, bound, **names)


Criterion = Literal["aic", "bic", "validation"]

_SLACK = 0.2  # of the validation fit [%]


def as_experiments(experiments: Experiment | Sequence[Experiment]) -> list[Experiment]:
    """One or several experiments as a list of at least one, all of the same signals and rate."""
    runs = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    if not runs:
        raise InputError("experiments: none given; at least one is needed")
    for run in runs[1:]:
        for field in ("input_names", "output_names"):
            if getattr(run, field) != getattr(runs[0], field):
                raise InputError(f"experiments: {field} differ between them")
        if abs(run.step / runs[0].step - 1.0) > 1e-9:
            raise InputError(f"experiments: steps {runs[0].step} and {run.step} s; must be one")
    return runs


def regressors(y: Real, u: Real, orders: Orders, lag: int) -> Real:
    """Regressors phi of an output (N,) and inputs (N, nu) from sample `lag` on, (N - lag, p)."""
    end = y.size
    past = [-y[lag - i : end - i] for i in range(1, orders.na + 1)]
    drive = [
        u[lag - i : end - i, j]
        for j in range(u.shape[1])
        for i in range(orders.nk, orders.nk + orders.nb)
    ]
    return np.column_stack(past + drive)


def arx(
    experiments: Experiment | Sequence[Experiment], orders: Orders | tuple[int, int, int]
) -> PolynomialModel:
    """Fit an ARX model to one or several experiments by least squares.

    The experiments have the same signals and rate; an experiment's rest is not joined to the next.
    Poles outside the unit circle stay, see `PolynomialModel.unstable_poles` and `stabilised`.
    Raises `InputError` for orders out of range, too few samples, or inputs that do not excite the
    model (regressors linearly dependent).
    """
    runs = as_experiments(experiments)
    chosen = Orders(*orders).check()
    factors = [_factor(runs, row, chosen, chosen.lag) for row in range(runs[0].output.shape[1])]
    solved = [_solve(factor, np.arange(factor.triangle.shape[1] - 1))[0] for factor in factors]
    return from_rows(chosen, solved, runs[0], method="arx", samples=factors[0].samples)


class _Factor(NamedTuple):
    """Triangle of (phi, y), its columns scaled to unit length."""

    triangle: Real
    scale: Real
    samples: int


def _factor(runs: list[Experiment], row: int, orders: Orders, lag: int) -> _Factor:
    for run in runs:
        if run.samples <= lag:
            raise InputError(f"orders: reach back {lag} samples; the experiment has {run.samples}")
    phi = np.concatenate([regressors(run.output[:, row], run.input, orders, lag) for run in runs])
    y = np.concatenate([run.output[lag:, row] for run in runs])
    if y.size <= phi.shape[1]:
        raise InputError(f"orders: {phi.shape[1]} parameters; experiments give {y.size} samples")
    table = np.column_stack([phi, y])
    scale = np.linalg.norm(table, axis=0)
    silent = np.flatnonzero(scale == 0.0)
    if silent.size:
        raise InputError("experiments: an input or output is zero all the time")
    (triangle,) = linalg.qr(table / scale, mode="r", overwrite_a=True, check_finite=False)[:1]
    return _Factor(triangle[: table.shape[1]], scale, y.size)


def _solve(factor: _Factor, columns: Real) -> tuple[FittedRow, float]:
    """Least squares with some of the regressors, and the mean square of e."""
    count = columns.size
    keep = np.concatenate([columns, [factor.triangle.shape[1] - 1]])
    triangle = linalg.qr(factor.triangle[:, keep], mode="r")[0][: count + 1]
    r = triangle[:count, :count]
    if np.abs(np.diag(r)).min() < 1e-13 * np.abs(np.diag(r)).max():
        raise InputError("orders: the experiments do not tell these parameters apart; lower them")
    scale = factor.scale[keep]
    theta = linalg.solve_triangular(r, triangle[:count, count])
    inverse = linalg.solve_triangular(r, np.eye(count))
    square = float((triangle[count, count] * scale[-1]) ** 2)
    variance = square / (factor.samples - count)
    shrink = 1.0 / scale[:-1]
    covariance = variance * (inverse @ inverse.T) * np.outer(shrink, shrink)
    row = FittedRow(theta * scale[-1] * shrink, covariance, variance)
    return row, square / factor.samples


class Candidate(NamedTuple):
    """One row of an order selection."""

    orders: Orders
    parameters: int  #: Of all rows of the model.
    loss: float  #: Mean square of e over the mean square of y, mean over the outputs.
    aic: float
    bic: float
    fit: float
    """Least fit of an output in simulation of the validation experiments [%]; -inf if unstable."""
    stable: bool


class Selection(NamedTuple):
    """Result of an order selection."""

    candidates: tuple[Candidate, ...]

    def best(self, criterion: Criterion = "validation") -> Candidate:
        """The best of the stable candidates; if there is none, of all.

        `validation` takes the fewest parameters whose fit is within 0.2 % of the best one, `aic`
        and `bic` their minimum.
        """
        check_name("criterion", criterion, get_args(Criterion))
        pool = [c for c in self.candidates if c.stable] or list(self.candidates)
        if criterion == "validation":
            enough = max(c.fit for c in pool) - _SLACK
            good = [c for c in pool if c.fit >= enough]
            return min(good, key=lambda c: (c.parameters, -c.fit))
        return min(pool, key=lambda c: c.aic if criterion == "aic" else c.bic)


def select_orders(
    estimation: Experiment | Sequence[Experiment],
    validation: Experiment | Sequence[Experiment],
    *,
    na: Iterable[int],
    nb: Iterable[int],
    nk: Iterable[int] = (1,),
) -> Selection:
    """Compare ARX orders by AIC, BIC and validation fit on a grid.

    One QR of the largest regressors serves all candidates, and all are judged on the same samples.
    """
    runs, others = as_experiments(estimation), as_experiments(validation)
    grid = [Orders(*o).check() for o in product(na, nb, nk)]
    if not grid:
        raise InputError("na, nb, nk: the grid is empty")
    first = min(o.nk for o in grid)
    span = max(o.nk + o.nb for o in grid) - first
    widest = Orders(max(o.na for o in grid), span, first)
    inputs = runs[0].input.shape[1]
    factors = [_factor(runs, row, widest, widest.lag) for row in range(runs[0].output.shape[1])]
    power = [
        np.mean(np.concatenate([r.output[:, i] for r in runs]) ** 2) for i in range(len(factors))
    ]
    candidates = []
    for orders in grid:
        places = [np.arange(orders.na)]
        places += [
            widest.na + span * j + orders.nk - first + np.arange(orders.nb) for j in range(inputs)
        ]
        solved, losses = zip(
            *(_solve(factor, np.concatenate(places)) for factor in factors), strict=True
        )
        model = from_rows(orders, solved, runs[0], method="arx", samples=factors[0].samples)
        count = orders.parameters(inputs)
        misfit = sum(f.samples * np.log(e) for f, e in zip(factors, losses, strict=True))
        penalty = sum(np.log(f.samples) for f in factors)
        stable = not model.unstable_poles
        fit = min(float(simulation_fit(model, run).min()) for run in others) if stable else -np.inf
        loss = float(np.mean([e / p for e, p in zip(losses, power, strict=True)]))
        aic, bic = float(misfit + 2.0 * count * len(factors)), float(misfit + count * penalty)
        candidates.append(Candidate(orders, count * len(factors), loss, aic, bic, fit, stable))
    return Selection(tuple(candidates))
