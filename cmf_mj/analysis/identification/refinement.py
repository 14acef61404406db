"""Output error and instrumental variables: models free of the bias that ARX has on noisy outputs.

Output error minimises the simulation error over all experiments at once,

    sum_k (y[k] - sum_j B_j(q)/A(q) u_j[k] - free response)^2

by Gauss-Newton steps in a trust region (`scipy.optimize.least_squares`), with the exact Jacobian
dy/da_i = -q^-i yhat / A, dy/db = q^-l u / A, every column scaled. The initial state of every run is
one of the unknowns; it is linear and taken out at each step. Consistent for noise v of any colour
that the inputs do not know.

Instrumental variables solve Z^T (y - phi theta) = 0 with instruments Z that the noise does not
reach. The refined form (Young; SRIV) filters everything by 1/A of the iteration before and takes as
instruments the noise-free regressors of the model before, which makes it efficient for white v:

    Z = 1/A (-x[k-i], w[k-l]),   x = B/A w,   cov theta = s^2 (Z^T phi)^-1 Z^T Z (phi^T Z)^-1

Closed loop: where the law feeds the noise of the outputs back to the valves, the input knows v, and
output error is biased unless v is white; so are instruments made of the input. With
`instrument="reference"` w is the part of the input that the external reference explains, from a
long ARX model of reference to input; Z then depends on the reference alone and the estimate is
consistent under any feedback and noise (Gilson and Van den Hof, Automatica 41 (2005) 241-249).
Records of simulated runs hold no noise, only the distortion of orifices; records of the machine
hold both.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from scipy import linalg, optimize, signal

from cmf_mj.analysis.identification.arx import arx, as_experiments, regressors
from cmf_mj.analysis.identification.data import LABELS, Experiment, Real
from cmf_mj.analysis.identification.model import (
    STABILITY,
    FittedRow,
    Orders,
    PolynomialModel,
    from_rows,
)
from cmf_mj.core.errors import InputError, check_name

Instrument = Literal["input", "reference"]

PREFILTER = 24
"""Orders of the ARX model from reference to input."""

_SINGULAR = 1e12
"""Condition from which on parameters count as not distinguishable."""

_ITERATIONS, _CLOSE = 30, 0.02
"""Most iterations; change of a parameter over its standard deviation at which they end."""

_EVALUATIONS = 200
"""Most simulations of a row."""


def instrumental_variable(
    experiments: Experiment | Sequence[Experiment],
    orders: Orders | tuple[int, int, int],
    *,
    instrument: Instrument = "input",
) -> PolynomialModel:
    """Refined instrumental variables, started from ARX.

    `instrument` is `input` where the inputs are free of the outputs' noise (open loop), `reference`
    where the outputs are fed back; the experiments then need a reference an input or more. Poles
    outside the unit circle are reflected for the filter and the instruments, not in the estimate.
    Raises `InputError` as `arx`, and where the iteration diverges; one that only has not ended is
    marked by the result's `converged`.
    """
    check_name("instrument", instrument, get_args(Instrument))
    runs = as_experiments(experiments)
    chosen = Orders(*orders).check()
    drives = [run.input for run in runs] if instrument == "input" else _driven(runs)
    model = arx(runs, chosen)
    rows = [_refined(runs, drives, model, row) for row in range(model.outputs)]
    return from_rows(chosen, rows, runs[0], method="iv", samples=sum(r.samples for r in runs))


def _driven(runs: list[Experiment]) -> list[Real]:
    """The part of each input that the references explain: simulated from them alone."""
    swapped = []
    for run in runs:
        if run.reference is None:
            raise InputError("instrument: the experiments have no reference")
        names = tuple(f"reference_{i + 1}" for i in range(run.reference.shape[1]))
        labels = (names, run.input_names, ("1",) * len(names), run.input_units)
        renamed: dict[str, Any] = dict(zip(LABELS, labels, strict=True))
        swapped.append(replace(run, input=run.reference, output=run.input, **renamed))
    model = arx(swapped, (PREFILTER, PREFILTER, 0)).stabilised()
    return [model.simulate(run.input) for run in swapped]


def _refined(
    runs: list[Experiment], drives: list[Real], start: PolynomialModel, row: int
) -> FittedRow:
    theta = start.parameters(row)
    for sweep in range(_ITERATIONS):
        model = _single(theta, start.orders, runs[0]).stabilised()
        phi, y, z = _filtered(runs, drives, model, row, theta.size)
        new, half = _instrumented(z, phi, y)
        misfit = y - phi @ new
        variance = float(misfit @ misfit) / (y.size - theta.size)
        covariance = variance * (half @ half.T)
        change = float(np.max(np.abs(new - theta) / np.sqrt(np.diag(covariance))))
        # Where distortion counts as noise the iteration may swing about its end: halve it.
        theta = new if sweep < _ITERATIONS // 3 else 0.5 * (theta + new)
        if change < _CLOSE:
            return FittedRow(new, covariance, variance, True)
    return FittedRow(theta, covariance, variance, False)


def _single(theta: Real, orders: Orders, run: Experiment) -> PolynomialModel:
    """The model of one row, of which nothing but the parameters is known."""
    row = FittedRow(theta, np.full((theta.size, theta.size), np.nan), np.nan)
    return from_rows(orders, [row], run, method="oe", samples=0)


def _filtered(
    runs: list[Experiment], drives: list[Real], model: PolynomialModel, row: int, count: int
) -> tuple[Real, Real, Real]:
    """Filtered regressors, outputs and instruments of all runs."""
    a = model.denominators[0]
    lag = model.orders.lag
    phis, ys, zs = [], [], []
    for run, drive in zip(runs, drives, strict=True):
        measured = run.output[:, row], run.input
        clean = model.simulate(drive)[:, 0], drive
        (y, u), (x, w) = ([_filter(a, part) for part in pair] for pair in (measured, clean))
        phis.append(regressors(y, u, model.orders, lag))
        zs.append(regressors(x, w, model.orders, lag))
        ys.append(y[lag:])
    phi, z = np.concatenate(phis), np.concatenate(zs)
    if phi.shape[1] != count or phi.shape[0] <= count:
        raise InputError(f"orders: {count} parameters; the experiments give {phi.shape[0]} samples")
    return phi, np.concatenate(ys), z


def _instrumented(z: Real, phi: Real, y: Real) -> tuple[Real, Real]:
    """Solution of Z^T (y - phi theta) = 0 and (Q^T phi)^-1, by the QR of the scaled Z = Q R.

    (Q^T phi)^-1 (Q^T phi)^-T = (Z^T phi)^-1 Z^T Z (phi^T Z)^-1, without squaring conditions.
    """
    size = np.linalg.norm(phi, axis=0)
    length = np.linalg.norm(z, axis=0)
    if not (np.isfinite(size).all() and np.isfinite(length).all() and (length > 0.0).all()):
        raise InputError("orders: the iteration has left the finite numbers; other orders may do")
    q, _ = np.linalg.qr(z / length)
    matrix = q.T @ (phi / size)
    if np.linalg.cond(matrix) > _SINGULAR:
        raise InputError("orders: the instruments do not tell the parameters apart; lower them")
    inverse = np.linalg.inv(matrix) / size[:, None]
    return inverse @ (q.T @ y), inverse


def output_error(
    experiments: Experiment | Sequence[Experiment],
    orders: Orders | tuple[int, int, int],
    *,
    start: PolynomialModel | None = None,
) -> PolynomialModel:
    """Fit an output-error model to one or several experiments.

    `start` is a model of the same orders, by default of instrumental variables. Its poles outside
    the unit circle are reflected first and listed in the result's `reflected`; the fit stays
    stable. A search that has not ended is marked by the result's `converged`. Raises `InputError`
    as `arx`.
    """
    runs = as_experiments(experiments)
    chosen = Orders(*orders).check()
    if start is not None and start.orders != chosen:
        raise InputError(f"start: has orders {tuple(start.orders)}; allowed: {tuple(chosen)}")
    begin = (start or instrumental_variable(runs, chosen)).stabilised()
    begin.check(runs[0])
    rows = [_OutputError(runs, begin, row).solve() for row in range(begin.outputs)]
    made = from_rows(chosen, rows, runs[0], method="oe", samples=sum(r.samples for r in runs))
    return replace(made, reflected=begin.reflected)


class _OutputError:
    """The simulation error of one row and its Jacobian."""

    def __init__(self, runs: list[Experiment], start: PolynomialModel, row: int) -> None:
        self.runs, self.orders, self.row = runs, start.orders, row
        self.first = start.parameters(row)
        self.size = float(np.sqrt(np.mean(np.concatenate([r.output[:, row] for r in runs]) ** 2)))

    def errors(self, theta: Real) -> Real:
        """Scaled simulation errors of all runs; infinite where a pole is outside."""
        model = _single(theta, self.orders, self.runs[0])
        if np.abs(np.roots(model.denominators[0])).max() > 1.0 + STABILITY:
            return np.full(sum(run.samples for run in self.runs), np.inf)
        return np.concatenate([self._one(model, run, jacobian=False) for run in self.runs])

    def jacobian(self, theta: Real) -> Real:
        model = _single(theta, self.orders, self.runs[0])
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
        back = np.pad(_filter(a, y + start), (lag, 0))
        drives = np.pad(_filter(a, run.input), ((lag, 0), (0, 0)))
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


def _filter(a: Real, series: Real) -> Real:
    """Series (N, ...) filtered by 1/A."""
    return np.asarray(signal.lfilter([1.0], a, series, axis=0))
