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
from cmf_mj.analysis.measures import joined
from cmf_mj.core import units
from cmf_mj.core.result import Field, Result, Table, lines, number
from cmf_mj.machine.geometry import DOFS, by_kind, dof_unit
from cmf_mj.show import look
from cmf_mj.studies.case import QUALITIES
from cmf_mj.studies.identification import Identified
from cmf_mj.studies.measurement import Measurement, RecordingMeasures

_FIT = "second-order fit with delay"


def _fields(*rows: tuple[str, str, str, str]) -> tuple[Field, ...]:
    """Of path, title, format and meaning."""
    return tuple(
        Field("", title, form, "%" if form[-1] == "%" else "", path, about=about)
        for path, title, form, about in rows
    )


RESPONSE = _fields(
    ("measures.phase_bandwidth_hz", "-90 deg bandwidth", ".3f Hz", "first fall through it"),
    ("measures.later_phase_hz", "-90 deg, later", ".3f Hz", "last fall, after coming back"),
    ("measures.graze_from_hz", "-90 deg, grazed from", ".2f Hz", "lingers within 10 deg of it"),
    ("measures.graze_to_hz", "  to", ".2f Hz", ""),
    ("measures.gain_bandwidth_hz", "-3 dB bandwidth", ".3f Hz", "from 0 dB"),
    ("measures.peak_gain_db", "peak", ".2f dB", "largest gain"),
    ("coherence", "coherence", ".4f", "least of all lines"),
    ("second_order.natural_frequency_hz", "natural frequency", ".3f Hz", _FIT),
    ("second_order.damping_ratio", "damping ratio", ".3f", _FIT),
    ("second_order.residual", "fit residual", ".2f %", "rms misfit over rms response"),
)
STEP = _fields(
    ("measures.overshoot", "overshoot", ".2f %", "of the step, over the final value"),
    ("measures.damping_ratio", "damping ratio", ".3f", "from the overshoot"),
    ("measures.steady_state_error", "steady-state error", ".2f %", "demanded minus reached"),
    ("measures.rise_time", "rise time", ".3f s", "10 to 90 % of the step"),
    ("measures.settling_time", "settling time", ".3f s", "into 2 % of the final value"),
    ("transport_delay", "delay", ".4f s", "cross-correlation of the sweep"),
    ("hysteresis", "hysteresis", ".2f %", "loop width at 0.01 Hz, over peak-to-peak"),
)
NOISE = _fields(
    ("low_harmonics", "  low harmonics", ".2f %", "2 and 3"),
    ("high_harmonics", "  high harmonics", ".2f %", "4 and up"),
    ("stochastic", "  stochastic", ".2f %", "no harmonic"),
    ("peak", "  peak", ".2f %", "largest deviation from the fundamental"),
)


def recordings_table(measures: RecordingMeasures) -> Table:
    """Bandwidths, peak and second-order fit of recordings."""
    response = measures.response
    found = {"measures": joined(bandwidths(response)), "second_order": measures.second_order}
    why = f"not excited, or of a coherence below {CLEAR:g}"
    rows = lines(found | {"coherence": response.coherence.min()}, RESPONSE)
    title = f"{measures.dof}: {', '.join(path.name for path in measures.files)}"
    return _sheet(title, [*rows, ("lines left out", str(measures.left_out), why)])


def _sheet(title: str, rows: list[tuple[str, str, str]]) -> Table:
    return Table(title, ("measure", "value", "definition"), rows)


def measurement_table(measured: Measurement) -> Table:
    """Every measure of a session with its definition."""
    case, dof = measured.case, measured.case.dof
    unit, (turn, size) = dof_unit(dof), by_kind(dof, ("m/s^2", 1.0), ("deg/s^2", units.DEGREE))
    found = vars(measured) | {"coherence": measured.response.coherence.min()}
    stable = str(measured.measures.stable)
    rows = [
        ("stable", stable, "legs at rest or decaying 12 s after the step"),
        *lines(found, (*RESPONSE, *STEP)),
        *lines(measured.qualities, QUALITIES),
    ]
    for at in measured.describing_function:
        where = f"{at.frequency_hz:g} Hz, {units.from_si(unit, at.amplitude):.3g} {unit}"
        value = f"{number(at.gain_db, '.2f dB')}, {number(at.phase_deg, '.1f deg')}"
        rows.append((f"describing function, {where}", value, "fundamental over the demand"))
    for amplitude, noise in measured.half_hertz_noise:
        name = f"half-hertz noise, {units.from_si(unit, amplitude):.3g} {unit}"
        total = f"{100.0 * noise.total:.2f} %"
        rows += [(name, total, "acceleration, all of the below"), *lines(noise, NOISE)]
    for point in measured.threshold:
        name = f"dynamic threshold, {point.acceleration / size:.3g} {turn}"
        rows.append((name, f"{1e3 * point.time:.1f} ms", "to 63 % of the step"))
    for other, value in zip(DOFS, measured.crosstalk[DOFS.index(dof)], strict=True):
        if other != dof:
            text = f"{100.0 * value:.2f} %" if dof_unit(other) == unit else f"{value:.4f} SI"
            rows.append((f"crosstalk into {other}", text, "acceleration at 1 Hz, rms over rms"))
    machine = " ".join(filter(None, (case.plant, case.cab_name, case.hydraulics.name)))
    return _sheet(f"{case.law.name} in {dof}, {machine}", rows)


def response_figure(title: str, name: str, response: FrequencyResponse) -> Figure:
    """Gain and phase of a measured response with their 95 % bounds, and its coherence."""
    labels, ratios = ("gain [dB]", "phase [deg]", "coherence"), (3, 3, 1)
    figure, axes = look.stack(8.0, 8.0, *labels, x="frequency [Hz]", ratios=ratios)
    gain, phase, coherence = axes
    look.dress_bode(gain, phase, title, limits=True)
    phase.set_xlabel("")
    colour = look.plot_bode(gain, phase, response, label=name)
    coherence.plot(response.frequency, response.coherence, color=colour)
    coherence.set_ylim(0.0, 1.05)
    share = np.minimum(response.bound / np.abs(response.response), 0.99)
    look.plot_band(gain, phase, response, share, np.arcsin(share), color=colour)
    look.legend(figure)
    return figure


def _response_files(response: FrequencyResponse, figure: Figure) -> dict[str, Any]:
    """`response.csv`, with the radius of the 95 % circle, and `response.png`."""
    columns = {
        "frequency_hz": response.frequency,
        "gain_db": response.gain_db,
        "phase_deg": response.phase_deg,
        "coherence": response.coherence,
        "radius_95": response.bound,
    }
    return {"response.csv": columns, "response.png": figure}


def save_recordings(measures: RecordingMeasures, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    figure = response_figure(
        f"Frequency response in {measures.dof}", measures.files[0].stem, measures.response
    )
    files = _response_files(measures.response, figure)
    return look.save_files(files | {"summary.json": measures.summary()}, folder)


def save_measurement(measured: Measurement, folder: Path) -> list[Path]:
    """Write `response.csv`, `response.png` and `summary.json`."""
    case, stable = measured.case, measured.measures.stable
    title = f"Frequency response in {case.dof}, {case.law.title}" + ("" if stable else ", unstable")
    figure = response_figure(title, measured.case.plant, measured.response)
    files = _response_files(measured.response, figure)
    return look.save_files(files | {"summary.json": measured.summary()}, folder)


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
    modelled, measured = simulated(result.model, run)[:, 0], run.output[:, 0]
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
