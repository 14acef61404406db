"""Tables and figures of what was fitted: machines to recordings, and identified linear models.

Of a fit: what is known of each number, and the recordings beside the fitted machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.identification.estimation import Candidate
from cmf_mj.analysis.identification.model import (
    PolynomialModel,
    Residuals,
    Root,
    fit_percentage,
)
from cmf_mj.analysis.identification.model import simulated as output_of
from cmf_mj.core.result import Field, Result, Table, number
from cmf_mj.show import look
from cmf_mj.show.look import BLUE, GREY, ORANGE, legend, new_figure, stack
from cmf_mj.studies.fit.doubt import FAR, Stated
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.model import Model
from cmf_mj.studies.identification import Identified

_SHOWN = 4.0  #: Seconds of a recording.


def figures(posterior: Posterior, rows: Sequence[Stated]) -> dict[str, Figure]:
    """Figures by file name; `rows` are what is stated."""
    found = {"numbers.png": numbers(posterior)}
    if posterior.campaign.recordings:
        found["recordings.png"] = recordings(posterior)
    return found | ({"stated.png": stated(rows)} if rows else {})


def numbers(posterior: Posterior) -> Figure:
    """90 % intervals of all numbers in quantiles of what was known before."""
    figure = new_figure(7.0, 0.28 * len(posterior.names) + 1.0)
    axes = figure.add_subplot()
    low, high = stats.norm.cdf(posterior.bounds())
    known, place = posterior.identified(), np.arange(len(posterior.names))[::-1]
    for chosen, colour, name in ((known, "C0", "identified"), (~known, "C3", "open")):
        if chosen.any():
            axes.hlines(place[chosen], low[chosen], high[chosen], colour, lw=5, label=name)
    axes.plot(stats.norm.cdf(posterior.z), place, "k|")
    axes.set_yticks(place, posterior.names)
    title = "90 % intervals of the machine's numbers"
    axes.set(xlim=(0.0, 1.0), xlabel="quantile of what the data sheet allows", title=title)
    legend(axes)
    return figure


def recordings(posterior: Posterior) -> Figure:
    """A few seconds of each recording held back, else of each fitted, leg 1."""
    held = bool(posterior.campaign.of(held_back=True))
    model = Model(posterior.campaign, held_back=held)
    machine, pieces = model.machine(posterior.z), model.pieces[:4]
    channel = next((name for name in pieces[0].measured if "pressure" in name), "leg_position")
    scale, unit = (1e-5, "bar") if channel != "leg_position" else (1e3, "mm")
    label = f"{channel.replace('_', ' ')} 1 [{unit}]"
    figure, rows = stack(7.0, 2.0 * len(pieces) + 1.0, *[label] * len(pieces))
    for axes, one in zip(rows, pieces, strict=True):
        found, since = one.simulated(machine, model.electronics), one.since - one.since[0]
        shown = since <= _SHOWN
        axes.plot(since[shown], scale * one.measured[channel][shown, 0], label="measured")
        axes.plot(since[shown], scale * found[channel][shown, 0], "--", label="fitted machine")
        axes.set_title(f"{channel.replace('_', ' ')} of leg 1, {one.name.replace('_', ' ')}")
    legend(rows[0])
    return figure


def stated(rows: Sequence[Stated]) -> Figure:
    """What is stated: how far the fitted machine is off, with the spread of what is open."""
    figure = new_figure(7.5, 1.3 + 0.21 * len(rows), gridded=False)
    axes = figure.add_subplot()
    axes.axvspan(-FAR, FAR, color="0.92")
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    known = [(place, one) for place, one in enumerate(rows) if np.isfinite(one.off)]
    for role, colour in (("fitted", BLUE), ("held back", ORANGE)):
        mine = [(one.off, place) for place, one in known if one.role == role]
        if mine:
            axes.plot(*zip(*mine, strict=True), "o", color=colour, label=role)
    axes.set_yticks(range(len(rows)), [f"{one.evidence}, {one.what}" for one in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="fitted machine less what is stated [deviations]")
    axes.set_title("What is stated of the machine")
    legend(axes)
    return figure


CONFIDENCE = 0.95  #: Probability of bands.

_LISTED = 8  # orders
_WINDOW = 10.0  # length of the fit's figure [s]


ORDERS = (
    *(Field(name, form="d", of=f"orders.{name}") for name in ("na", "nb", "nk")),
    Field("parameters", form="d"),
    Field("loss", form=".3g"),
    Field("aic", "AIC", ".0f"),
    Field("bic", "BIC", ".0f"),
    Field("fit", "validation fit", ".2f %"),
)


def orders_table(result: Identified) -> Result[Candidate]:
    """The best ARX orders of the grid by validation fit, with AIC and BIC."""
    candidates = []
    if result.selection is not None:
        best = sorted(result.selection.candidates, key=lambda c: -c.fit)[:_LISTED]
        candidates = list(dict.fromkeys([*best, result.selection.best()]))
    return Result(candidates, ORDERS, "ARX orders")


def _root_cells(root: Root, step: float) -> tuple[str, str, str]:
    """Frequency [Hz], its standard deviation and the damping ratio of s = ln z / T."""
    s = np.log(complex(root.value)) / step
    # ds = dz / (z T); the modulus changes by the part of ds along s.
    along = np.conj(s) / abs(s) / (root.value * step) if s != 0.0 else complex(np.nan, np.nan)
    slope = np.array([along.real, -along.imag])
    spread = np.sqrt(max(float(slope @ root.covariance @ slope), 0.0)) / (2.0 * np.pi)
    damping = -s.real / abs(s) if s != 0.0 else float("nan")
    hertz, damped = abs(s) / (2.0 * np.pi), number(damping, ".3f")
    return f"{hertz:.3f} Hz", f"{spread:.3f} Hz", f"damping ratio {damped}"


def model_table(result: Identified) -> Table:
    """Model, fits, poles and zeros with standard errors, residuals and closed loop."""
    model, loop = result.model, result.loop
    ended = "" if model.converged else "the iteration has not ended; try other orders"
    rows = [
        ("fit, estimation", f"{result.estimation_fit:.2f} %", "", ended),
        ("fit, validation", f"{result.validation_fit:.2f} %", "", "NRMSE, simulated"),
    ]
    rows += [
        (kind, *_root_cells(root, model.step))
        for kind, roots in (("pole", model.poles()), ("zero", model.zeros()))
        for root in roots
        if root.value.imag >= 0.0 and root.value != 0.0
    ]
    rows += [
        (f"pole, {name}", f"{abs(pole):.5f}", "", "modulus in the z plane")
        for name, poles in (("unstable", model.unstable_poles), ("reflected", model.reflected))
        for pole in poles
    ]
    outside = 100.0 * result.residuals.cross_outside[0]
    note = "correlation with past commands beyond 99 % bounds"
    rows.append(("residuals", f"{outside:.0f} % of lags", "", note))
    misfit = f"{100.0 * result.continuous.misfit:.2f} %"
    rows.append(("continuous model", misfit, "", "misfit to the discrete"))
    if loop is not None:
        for label, name, form, error in (
            ("-90 deg", "phase_bandwidth_hz", ".3f Hz", loop.phase_error),
            ("-3 dB", "gain_bandwidth_hz", ".3f Hz", loop.gain_error),
            ("damping ratio", "damping_ratio", ".3f", None),
            ("rise time", "rise_time", ".3f s", None),
        ):
            mine, theirs = (number(getattr(side, name), form) for side in loop)
            off = "" if error is None else f", error {number(100.0 * error, '+.1f %')}"
            off += f", law {result.law}" if off else ""
            rows.append((f"closed loop, {label}", mine, "", f"measured {theirs}{off}"))
    title = f"{result.axis}: {model.method}, orders {tuple(model.orders)}"
    return Table(title, ("quantity", "value", "standard error", "note"), rows)


def fit_figure(result: Identified) -> Figure:
    """Measured and simulated output of the validation run, and their difference."""
    run = result.validation
    unit = run.output_units[0]
    labels = (f"{run.output_names[0]} [{unit}]", f"difference [{unit}]")
    figure, (top, bottom) = look.stack(9.0, 5.5, *labels, ratios=(3, 1))
    time = np.arange(run.samples) * run.step
    modelled, measured = output_of(result.model, run)[:, 0], run.output[:, 0]
    middle = max(0.5 * (time[-1] - _WINDOW), 0.0)
    inside = (time >= middle) & (time <= middle + _WINDOW)
    fit = float(fit_percentage(measured, modelled)[0])
    top.plot(time[inside], measured[inside], color=look.DARK, label="measured")
    top.plot(time[inside], modelled[inside], "--", color=look.ORANGE, label=f"model, {fit:.1f} %")
    bottom.plot(time[inside], (measured - modelled)[inside], color=look.BLUE)
    top.set_title(f"Motion of the validation run, {result.axis}")
    look.legend(figure)
    return figure


def residual_figure(residuals: Residuals, step: float) -> Figure:
    """Auto- and cross-correlation of the residuals with their 99 % bounds."""
    figure, (auto, cross) = look.stack(9.0, 5.5, "correlation", "correlation", x="lag [s]")
    for axis, values, bound, title in (
        (auto, residuals.auto, residuals.auto_bound, "Correlation of the residual with itself"),
        (
            cross,
            residuals.cross[0],
            residuals.cross_bound[0],
            "Correlation of the residual with past command",
        ),
    ):
        axis.axhspan(-bound, bound, color=look.BLUE, alpha=0.15, label="99 % of a right model")
        axis.vlines(residuals.lags * step, 0.0, values, color=look.DARK, linewidth=1.2)
        axis.axhline(0.0, color=look.DARK, linewidth=0.8)
        axis.set_title(title)
    look.legend(figure)
    return figure


def model_figure(model: PolynomialModel, response: FrequencyResponse | None) -> Figure:
    """Bode plot of the model with its 95 % band, and the measured response."""
    figure, gain, phase = look.bode_axes(
        f"Frequency response, {model.input_names[0]} to {model.output_names[0]}"
    )
    highest = 0.4 / model.step if response is None else float(response.frequency[-1])
    frequency = np.geomspace(0.1, min(highest, 0.45 / model.step), 300)
    g = model.response(frequency)[:, 0, 0]
    curve = FrequencyResponse(g, 2.0 * np.pi * frequency, np.ones(g.size))
    covariance = model.response_covariance(frequency)
    # Along and across the response: gain and phase.
    unit = g / np.abs(g)
    along = np.stack([unit.real, unit.imag], axis=1)
    across = np.stack([-unit.imag, unit.real], axis=1)
    point = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
    wide, turn = (
        point * np.sqrt(np.clip(np.einsum("ki,kij,kj->k", v, covariance, v), 0.0, None)) / np.abs(g)
        for v in (along, across)
    )
    if response is not None:
        measured, at = response.phase_deg, response.frequency
        ahead = np.interp(1.0, at, measured) - np.interp(1.0, frequency, curve.phase_deg)
        style: dict[str, Any] = {"color": look.GREY, "markersize": 3, "label": "measured"}
        gain.plot(at, response.gain_db, ".", **style)
        phase.plot(at, measured - 360.0 * np.round(ahead / 360.0), ".", **style)
    look.plot_bode(gain, phase, curve, color=look.ORANGE, label=model.method)
    band = np.minimum(turn, np.pi)
    look.plot_band(gain, phase, curve, wide, band, color=look.ORANGE, label="95 % band")
    look.legend(figure)
    return figure


def save_identification(result: Identified, folder: Path) -> list[Path]:
    """Write `model.json`, `fit.png`, `residuals.png` and `bode.png`."""
    model, rational, loop = result.model, result.continuous.rational, result.loop
    errors = loop and {"phase_error": loop.phase_error, "gain_error": loop.gain_error}
    files = {
        "model.json": {
            "axis": result.axis,
            "law": result.law,
            "estimation_fit": result.estimation_fit,
            "validation_fit": result.validation_fit,
            **vars(model),
            "standard_errors": model.standard_errors(),
            "unstable_poles": model.unstable_poles,
            "continuous": {
                "numerator": rational.num[0][0],
                "denominator": rational.den[0][0],
                "misfit": result.continuous.misfit,
            },
            "closed_loop": loop and loop._asdict() | (errors or {}),
        },
        "fit.png": fit_figure(result),
        "residuals.png": residual_figure(result.residuals, model.step),
        "bode.png": model_figure(model, result.response),
    }
    return look.save_files(files, folder)
