"""Tables, figures and files of measured responses and of identified models."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.identification.estimation import Candidate
from cmf_mj.analysis.identification.model import (
    PolynomialModel,
    Residuals,
    Root,
    fit_percentage,
    simulated,
)
from cmf_mj.analysis.measurable import CLEAR
from cmf_mj.analysis.measures import Measures, joined
from cmf_mj.analysis.metrics import SecondOrder
from cmf_mj.core import units
from cmf_mj.core.result import Field, Result, Table, number
from cmf_mj.machine.geometry import DOFS, by_kind, dof_unit
from cmf_mj.show import look
from cmf_mj.show.comparison import quality_rows
from cmf_mj.show.look import dress_bode, legend, plot_band, plot_bode, save_files, stack
from cmf_mj.studies.identification import Identified
from cmf_mj.studies.measurement import Measurement, RecordingMeasures, plain

_COLUMNS = ("measure", "value", "definition")


def _share(value: float) -> str:
    return f"{100.0 * value:.2f} %"


def _response_rows(
    response: FrequencyResponse, widths: Measures, fit: SecondOrder | None
) -> list[tuple[str, str, str]]:
    coherence = ("coherence", f"{response.coherence.min():.4f}", "least of all lines")
    if fit is None:
        return [coherence]
    first, second = widths.phase_bandwidth_hz, "second-order fit with delay"
    rows = [("-90 deg bandwidth", number(first, ".3f Hz"), "first fall of the phase through it")]
    if widths.later_phase_hz == widths.later_phase_hz:
        later = number(widths.later_phase_hz, ".3f Hz")
        rows.append(("-90 deg, later", later, "last fall through it, after coming back"))
    if widths.graze_from_hz == widths.graze_from_hz:
        ends = f"{widths.graze_from_hz:.2f} to {widths.graze_to_hz:.2f} Hz"
        rows.append(("-90 deg, grazed", ends, "the phase lingers within 10 deg of it"))
    return [
        *rows,
        ("-3 dB bandwidth", number(widths.gain_bandwidth_hz, ".3f Hz"), "from 0 dB"),
        ("peak", f"{widths.peak_gain_db:.2f} dB", "largest gain"),
        coherence,
        ("natural frequency", f"{fit.natural_frequency_hz:.3f} Hz", second),
        ("damping ratio", f"{fit.damping_ratio:.3f}", second),
        ("fit residual", _share(fit.residual), "rms misfit over rms response"),
    ]


def recordings_table(measures: RecordingMeasures) -> Table:
    """Bandwidths, peak and second-order fit of recordings."""
    title = f"{measures.dof}: {', '.join(path.name for path in measures.files)}"
    response = measures.response
    rows = _response_rows(response, joined(bandwidths(response)), measures.second_order)
    why = f"not excited, or of a coherence below {CLEAR:g}"
    rows.append(("lines left out", str(measures.left_out), why))
    return Table(title, _COLUMNS, rows)


def measurement_table(measured: Measurement) -> Table:
    """Every measure of a session with its definition."""
    dof, step = measured.case.dof, measured.measures
    unit, turn = dof_unit(dof), by_kind(dof, "m/s^2", "deg/s^2")
    rows = [
        ("stable", str(step.stable), "legs at rest or decaying 12 s after the step"),
        *_response_rows(measured.response, step, measured.second_order),
    ]
    if step.stable:
        rows += [
            ("overshoot", _share(step.overshoot), "of the step, over the final value"),
            ("damping ratio", f"{step.damping_ratio:.3f}", "from the overshoot"),
            ("steady-state error", _share(step.steady_state_error), "demanded minus reached"),
            ("rise time", f"{step.rise_time:.3f} s", "10 to 90 % of the step"),
            ("settling time", f"{step.settling_time:.3f} s", "into 2 % of the final value"),
        ]
    rows += [
        ("delay", f"{1e3 * measured.transport_delay:.1f} ms", "cross-correlation of the sweep"),
        ("hysteresis", _share(measured.hysteresis), "loop width at 0.01 Hz, over peak-to-peak"),
        *quality_rows(dof, measured.qualities),
    ]
    for at in measured.describing_function:
        size = f"{at.frequency_hz:g} Hz, {units.from_si(unit, at.amplitude):.3g} {unit}"
        value = f"{at.gain_db:.2f} dB, {at.phase_deg:.1f} deg"
        rows.append((f"describing function, {size}", value, "fundamental over the demand"))
    for amplitude, noise in measured.half_hertz_noise:
        size = f"{units.from_si(unit, amplitude):.3g} {unit}"
        rows += [
            (f"half-hertz noise, {size}", _share(noise.total), "acceleration, all of the below"),
            ("  low harmonics", _share(noise.low_harmonics), "2 and 3"),
            ("  high harmonics", _share(noise.high_harmonics), "4 and up"),
            ("  stochastic", _share(noise.stochastic), "no harmonic"),
            ("  peak", _share(noise.peak), "largest deviation from the fundamental"),
        ]
    for point in measured.threshold:
        level = f"{point.acceleration / by_kind(dof, 1.0, units.DEGREE):.3g} {turn}"
        time = f"{1e3 * point.time:.1f} ms"
        rows.append((f"dynamic threshold, {level}", time, "to 63 % of the step"))
    for other, value in zip(DOFS, measured.crosstalk[DOFS.index(dof)], strict=True):
        if other != dof:
            same = dof_unit(other) == unit
            text = _share(value) if same else f"{value:.4f} SI"
            rows.append((f"crosstalk into {other}", text, "acceleration at 1 Hz, rms over rms"))
    case = measured.case
    machine = " ".join(part for part in (case.plant, case.cab_name, case.hydraulics.name) if part)
    return Table(f"{case.law.name} in {dof}, {machine}", _COLUMNS, rows)


def response_figure(title: str, name: str, response: FrequencyResponse) -> Figure:
    """Gain and phase of a measured response with their 95 % bounds, and its coherence."""
    labels, ratios = ("gain [dB]", "phase [deg]", "coherence"), (3, 3, 1)
    figure, axes = stack(8.0, 8.0, *labels, x="frequency [Hz]", ratios=ratios)
    gain, phase, coherence = axes
    dress_bode(gain, phase, title, limits=True)
    phase.set_xlabel("")
    colour = plot_bode(gain, phase, response, label=name)
    coherence.plot(response.frequency, response.coherence, color=colour)
    coherence.set_ylim(0.0, 1.05)
    share = np.minimum(response.bound / np.abs(response.response), 0.99)
    plot_band(gain, phase, response, share, np.arcsin(share), color=colour)
    legend(gain)
    return figure


def _response_files(response: FrequencyResponse, figure: Figure) -> dict[str, Any]:
    """`response.csv`, with the radius of the 95 % circle, and `response.png`."""
    curves = (response.frequency, response.gain_db, response.phase_deg)
    columns = (*curves, response.coherence, response.bound)
    header = ("frequency_hz", "gain_db", "phase_deg", "coherence", "radius_95")
    return {"response.csv": (header, zip(*columns, strict=True)), "response.png": figure}


def save_recordings(measures: RecordingMeasures, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    figure = response_figure(
        f"Frequency response in {measures.dof}", measures.files[0].stem, measures.response
    )
    files = _response_files(measures.response, figure)
    return save_files(files | {"summary.json": plain(measures.summary())}, folder)


def save_measurement(measured: Measurement, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    case, stable = measured.case, measured.measures.stable
    title = f"Frequency response in {case.dof}, {case.law.title}" + ("" if stable else ", unstable")
    figure = response_figure(title, measured.case.plant, measured.response)
    files = _response_files(measured.response, figure)
    return save_files(files | {"summary.json": measured.summary()}, folder)


CONFIDENCE = 0.95
"""Probability of bands."""

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
    return f"{abs(s) / (2.0 * np.pi):.3f} Hz", f"{spread:.3f} Hz", f"damping ratio {damping:.3f}"


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
        width = f" Hz, error {{:+.1f}} %, law {result.law}"
        lines = [
            ("-90 deg", "phase_bandwidth_hz", " Hz", width.format(100.0 * loop.phase_error)),
            ("-3 dB", "gain_bandwidth_hz", " Hz", width.format(100.0 * loop.gain_error)),
        ]
        if not np.isnan(loop.measured.rise_time):
            lines.append(("damping ratio", "damping_ratio", "", ", of the step"))
            lines.append(("rise time", "rise_time", " s", " s, of the step"))
        for label, name, unit, note in lines:
            mine, theirs = (getattr(side, name) for side in loop)
            text = f"measured {theirs:.3f}{note}"
            rows.append((f"closed loop, {label}", f"{mine:.3f}{unit}", "", text))
    title = f"{result.axis}: {model.method}, orders {tuple(model.orders)}"
    return Table(title, ("quantity", "value", "standard error", "note"), rows)


def fit_figure(result: Identified) -> Figure:
    """Measured and simulated output of the validation run, and their difference."""
    run = result.validation
    unit = run.output_units[0]
    labels = (f"{run.output_names[0]} [{unit}]", f"difference [{unit}]")
    figure, (top, bottom) = look.stack(9.0, 5.5, *labels, ratios=(3, 1))
    time = np.arange(run.samples) * run.step
    modelled, measured = simulated(result.model, run)[:, 0], run.output[:, 0]
    middle = max(0.5 * (time[-1] - _WINDOW), 0.0)
    inside = (time >= middle) & (time <= middle + _WINDOW)
    fit = float(fit_percentage(measured, modelled)[0])
    top.plot(time[inside], measured[inside], color=look.DARK, label="measured")
    top.plot(time[inside], modelled[inside], "--", color=look.ORANGE, label=f"model, {fit:.1f} %")
    bottom.plot(time[inside], (measured - modelled)[inside], color=look.BLUE)
    top.set_title(f"Motion of the validation run, {result.axis}")
    look.legend(top, loc="upper right")
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
    look.legend(auto, cross, loc="upper right")
    return figure


def bode_figure(model: PolynomialModel, response: FrequencyResponse | None) -> Figure:
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
    look.legend(phase)
    return figure


def _summary(result: Identified) -> dict[str, object]:
    """What `model.json` holds."""
    model, rational, loop = result.model, result.continuous.rational, result.loop
    return {
        "axis": result.axis,
        "method": model.method,
        "orders": model.orders._asdict(),
        "step": model.step,
        "converged": model.converged,
        "denominator": model.denominators[0].tolist(),
        "numerator": model.numerators[0, 0].tolist(),
        "standard_errors": model.standard_errors().tolist(),
        "noise_variance": float(model.noise_variance[0]),
        "input": [model.input_names[0], model.input_units[0]],
        "output": [model.output_names[0], model.output_units[0]],
        "unstable_poles": [[p.real, p.imag] for p in model.unstable_poles],
        "estimation_fit": result.estimation_fit,
        "validation_fit": result.validation_fit,
        "continuous": {
            "numerator": rational.num[0][0].tolist(),
            "denominator": rational.den[0][0].tolist(),
            "misfit": result.continuous.misfit,
        },
        "closed_loop": loop
        and {
            "law": result.law,
            "model": loop.model._asdict(),
            "measured": loop.measured._asdict(),
            "phase_error": loop.phase_error,
            "gain_error": loop.gain_error,
        },
    }


def save_identification(result: Identified, folder: Path) -> list[Path]:
    """Write `model.json`, `fit.png`, `residuals.png` and `bode.png`."""
    files = {
        "model.json": plain(_summary(result)),
        "fit.png": fit_figure(result),
        "residuals.png": residual_figure(result.residuals, result.model.step),
        "bode.png": bode_figure(result.model, result.response),
    }
    return look.save_files(files, folder)
