"""How good a model is: fit to measured outputs and what is left in the residuals.

    fit = 100 (1 - |y - yhat| / |y - mean y|)  %     (NRMSE; as MATLAB's `compare` prints it)

Residuals e[k] of a right model are white (where the noise is modelled) and, whatever the noise, not
correlated with past inputs. With R_ab(l) = mean(a[k] b[k-l]) and a probability of 99 %,

    |R_ee(l)| / R_ee(0) < 2.576 / sqrt(N),
    |R_eu(l)| / sqrt(R_ee(0) R_uu(0)) < 2.576 sqrt(P / N),   P = sum_l R_ee(l) R_uu(l) / (R_ee R_uu)

(Ljung, System Identification, 2nd ed., section 16.6). Under feedback e is correlated with later
inputs, l < 0, even for the right model: only l >= 0 judges it.

Measured responses from valve command to leg signals of a machine in closed loop.

The law drives the valves, so output over input is not what an open-loop estimator makes of it:
under feedback S_uy / S_uu lies between the plant's response and minus the inverse of the law's.
With the external reference r, which no noise of the loop reaches,

    G = H_ry H_ru^-1

is free of that bias (Soderstrom and Stoica, System Identification, section 12.3): two responses of
the kind `frequency_response` measures. The 95 % radius is the sum of the two relative ones, at most
what the error can be when they add up.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal, stats

from cmf_mj.analysis.frequency_response import FrequencyResponse, excited_response
from cmf_mj.analysis.identification.data import Experiment, Real, experiment
from cmf_mj.analysis.identification.model import PolynomialModel
from cmf_mj.core.errors import InputError
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
