"""Least squares (ARX) with the choice of its orders, and output error, free of ARX's bias.

Each row of an ARX model is linear in its parameters (Eq 4.10),

    y[k] = phi[k] theta + e[k],   phi = (-y[k-1] .. -y[k-na], u_j[k-nk] .. u_j[k-nk-nb+1])

and is solved by QR of the regressors of all experiments together, each scaled to unit size:

    cov theta = s^2 (R^T R)^-1,   s^2 = |e|^2 / (N - p)

Consistent where the noise really enters as A y = B u + e. Noise on a motion sensor enters as
y = B/A u + v: the past outputs in phi then hold the noise, and poles are biased towards more
damping. Output error is free of that: it minimises the simulation error over all experiments,

    sum_k (y[k] - sum_j B_j(q)/A(q) u_j[k] - free response)^2

by Gauss-Newton steps in a trust region (`scipy.optimize.least_squares`), with the exact Jacobian
dy/da_i = -q^-i yhat / A, dy/db = q^-l u / A, every column scaled. The initial state of every run is
one of the unknowns; it is linear and taken out at each step. The start is ARX on series
filtered by 1/A of ARX (K. Steiglitz and L. McBride, IEEE Trans. Automatic Control 10 (1965)
461-464). Consistent for noise v of any colour
that the inputs do not know; where a law feeds it back to the valves they do, and v must be white.

Orders: with V the mean square of e over the samples that every candidate explains,

    AIC = N ln V + 2 p,   BIC = N ln V + p ln N      (summed over the rows)

and the fit (NRMSE, `fit_percentage`) of the simulated model to experiments not used in the fit. On
records without noise V falls with every order and AIC and BIC choose the largest; the validation
fit shows which order gains by it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from scipy import linalg, optimize, signal

from cmf_mj.analysis.identification.data import Experiment, Real
from cmf_mj.analysis.identification.model import (
    STABILITY,
    FittedRow,
    Orders,
    PolynomialModel,
    from_rows,
    simulation_fit,
)
from cmf_mj.core.errors import InputError, check_name

_EVALUATIONS = 200
"""Most simulations of a row."""

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

    def without(self, orders: Orders) -> tuple[Candidate, ...]:
        """The other candidates."""
        return tuple(c for c in self.candidates if c.orders != orders)


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


def output_error(
    experiments: Experiment | Sequence[Experiment], orders: Orders | tuple[int, int, int]
) -> PolynomialModel:
    """Fit an output-error model to one or several experiments.

    Poles of the ARX start outside the unit circle are reflected first and listed in the result's
    `reflected`; the fit stays stable. A search that has not ended is marked by the result's
    `converged`. Raises `InputError` as `arx`.
    """
    runs = as_experiments(experiments)
    begin = arx(runs, orders).stabilised()
    rows = [_OutputError(runs, begin, row).solve() for row in range(begin.outputs)]
    samples = sum(run.samples for run in runs)
    made = from_rows(begin.orders, rows, runs[0], method="oe", samples=samples)
    return replace(made, reflected=begin.reflected)


def _filtered(a: Real, series: Real) -> Real:
    """Series (N, ...) filtered by 1/A."""
    return np.asarray(signal.lfilter([1.0], a, series, axis=0))


class _OutputError:
    """The simulation error of one row and its Jacobian."""

    def __init__(self, runs: list[Experiment], start: PolynomialModel, row: int) -> None:
        self.runs, self.orders, self.row = runs, start.orders, row
        self.size = float(np.sqrt(np.mean(np.concatenate([r.output[:, row] for r in runs]) ** 2)))
        # Least squares on series filtered by 1/A is nearer to the simulation error.
        a = start.denominators[row]
        seen = [
            replace(r, input=_filtered(a, r.input), output=_filtered(a, r.output)) for r in runs
        ]
        factor = _factor(seen, row, self.orders, self.orders.lag)
        theta = _solve(factor, np.arange(factor.triangle.shape[1] - 1))[0].parameters
        self.first = self._model(theta).stabilised().parameters()

    def _model(self, theta: Real) -> PolynomialModel:
        """The model of this row, of which nothing but the parameters is known."""
        row = FittedRow(theta, np.full((theta.size, theta.size), np.nan), np.nan)
        return from_rows(self.orders, [row], self.runs[0], method="oe", samples=0)

    def errors(self, theta: Real) -> Real:
        """Scaled simulation errors of all runs; infinite where a pole is outside."""
        model = self._model(theta)
        if np.abs(np.roots(model.denominators[0])).max() > 1.0 + STABILITY:
            return np.full(sum(run.samples for run in self.runs), np.inf)
        return np.concatenate([self._one(model, run, jacobian=False) for run in self.runs])

    def jacobian(self, theta: Real) -> Real:
        model = self._model(theta)
        return np.concatenate([self._one(model, run, jacobian=True) for run in self.runs])

    def _one(self, model: PolynomialModel, run: Experiment, *, jacobian: bool) -> Real:
        """Of one run, with its best initial state, or the Jacobian of that (Kaufman's form)."""
        a = model.denominators[0]
        free, _ = np.linalg.qr(model.free_responses(0, run.samples))
        y = model.simulate(run.input)[:, 0]
        missing = run.output[:, self.row] - y
        start = free @ (free.T @ missing)
        if not jacobian:
            return np.asarray((missing - start) / self.size)
        lag = model.orders.lag
        back = np.pad(_filtered(a, y + start), (lag, 0))
        drives = np.pad(_filtered(a, run.input), ((lag, 0), (0, 0)))
        slope = regressors(back, drives, model.orders, lag)
        return np.asarray((free @ (free.T @ slope) - slope) / self.size)

    def solve(self) -> FittedRow:
        how: dict[str, Any] = {"method": "trf", "x_scale": "jac", "max_nfev": _EVALUATIONS}
        how |= {"ftol": 1e-8, "xtol": 1e-9, "gtol": 1e-9}
        fit = optimize.least_squares(self.errors, self.first, self.jacobian, **how)
        states = self.orders.na * len(self.runs)
        freedom = fit.fun.size - fit.x.size - states
        variance = 2.0 * float(fit.cost) / freedom
        scale = np.linalg.norm(fit.jac, axis=0)
        r = np.linalg.qr(fit.jac / scale, mode="r")
        half = linalg.solve_triangular(r, np.eye(scale.size)) / scale[:, None]
        return FittedRow(
            fit.x, variance * (half @ half.T), variance * self.size**2, bool(fit.success)
        )
