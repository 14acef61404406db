"""Tables, figures and files of an identification."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from rich.box import SIMPLE_HEAD
from rich.table import Table
from scipy import stats

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.identification.model import PolynomialModel, Root
from cmf_mj.analysis.identification.validation import Residuals, fit_percentage, simulated
from cmf_mj.core.files import write_json
from cmf_mj.studies.identification import Identified, MatrixStudy
from cmf_mj.studies.measurement import plain

CONFIDENCE = 0.95
"""Probability of ellipses and bands."""

_SHOWN = 8
"""Orders listed."""

_WINDOW = 10.0
"""Length of the fit's figure [s]."""


def orders_table(found: Identified) -> Table:
    """The best ARX orders of the grid by validation fit, with AIC and BIC."""
    header = ("na", "nb", "nk", "parameters", "loss", "AIC", "BIC", "validation fit")
    table = Table(*header, title="ARX orders", box=SIMPLE_HEAD)
    if found.selection is not None:
        ranked = sorted(found.selection.candidates, key=lambda c: -c.fit)[:_SHOWN]
        chosen = found.selection.best()
        if chosen not in ranked:
            ranked.append(chosen)
        for c in ranked:
            style = "bold" if c.orders == found.model.orders else ""
            table.add_row(
                *(str(value) for value in (*c.orders, c.parameters)),
                f"{c.loss:.3g}",
                f"{c.aic:.0f}",
                f"{c.bic:.0f}",
                f"{c.fit:.2f} %",
                style=style,
            )
    return table


def _root_cells(root: Root, step: float) -> tuple[str, str, str]:
    """Frequency [Hz], its standard deviation and the damping ratio of s = ln z / T."""
    s = np.log(complex(root.value)) / step
    # ds = dz / (z T); the modulus changes by the part of ds along s.
    along = np.conj(s) / abs(s) / (root.value * step) if s != 0.0 else complex(np.nan, np.nan)
    slope = np.array([along.real, -along.imag])
    spread = np.sqrt(max(float(slope @ root.covariance @ slope), 0.0)) / (2.0 * np.pi)
    damping = -s.real / abs(s) if s != 0.0 else float("nan")
    return f"{abs(s) / (2.0 * np.pi):.3f} Hz", f"{spread:.3f} Hz", f"damping ratio {damping:.3f}"


def model_table(found: Identified) -> Table:
    """Model, fits, poles and zeros with standard errors, residuals and closed loop."""
    model, loop = found.model, found.loop
    table = Table("quantity", "value", "standard error", "note", box=SIMPLE_HEAD)
    table.title = f"{found.axis}: {model.method}, orders {tuple(model.orders)}"
    ended = "" if model.converged else "the iteration has not ended; try other orders"
    table.add_row("fit, estimation", f"{found.estimation_fit:.2f} %", "", ended)
    table.add_row("fit, validation", f"{found.validation_fit:.2f} %", "", "NRMSE, simulated")
    for kind, roots in (("pole", model.poles()), ("zero", model.zeros())):
        for root in roots:
            if root.value.imag >= 0.0 and root.value != 0.0:
                table.add_row(kind, *_root_cells(root, model.step))
    for name, group in (("unstable", model.unstable_poles), ("reflected", model.reflected)):
        for pole in group:
            table.add_row(f"pole, {name}", f"{abs(pole):.5f}", "", "modulus in the z plane")
    outside = 100.0 * found.residuals.cross_outside[0]
    note = "correlation with past commands beyond 99 % bounds"
    table.add_row("residuals", f"{outside:.0f} % of lags", "", note)
    table.add_row(
        "continuous model", f"{100.0 * found.continuous.misfit:.2f} %", "", "misfit to the discrete"
    )
    if loop is not None:
        for label, kind in (("-90 deg", "phase"), ("-3 dB", "gain")):
            mine, theirs = (getattr(side, f"{kind}_bandwidth_hz") for side in loop)
            off = getattr(loop, f"{kind}_error")
            table.add_row(
                f"closed loop, {label}",
                f"{mine:.3f} Hz",
                "",
                f"measured {theirs:.3f} Hz, error {100.0 * off:+.1f} %, law {found.law}",
            )
        if not np.isnan(loop.measured.rise_time):
            for label, name in (("damping ratio", "damping_ratio"), ("rise time", "rise_time")):
                mine, theirs = (getattr(side, name) for side in loop)
                unit = " s" if name == "rise_time" else ""
                note = f"measured {theirs:.3f}{unit}, of the step"
                table.add_row(f"closed loop, {label}", f"{mine:.3f}{unit}", "", note)
    return table


def matrix_table(study: MatrixStudy) -> Table:
    """One model for every degree of freedom against one each and the matrix."""
    shared = study.comparison.shared
    table = Table(
        "dof",
        f"fit, {shared} model",
        "own model",
        "6 by 6",
        "measured -90",
        f"{shared} model",
        "6 by 6",
        title=f"validation fit [%] and closed loop [Hz], law {study.law}",
        box=SIMPLE_HEAD,
    )
    loops = zip(study.measured_hz, study.shared_hz, study.matrix_hz, strict=True)
    for score, (measured, common, whole) in zip(study.comparison.scores, loops, strict=True):
        table.add_row(
            score.axis,
            *(f"{fit:.1f}" for fit in (score.shared, score.own, score.matrix)),
            f"{measured:.2f}",
            *(f"{hz:.2f} ({100.0 * (hz / measured - 1.0):+.1f} %)" for hz in (common, whole)),
        )
    return table


def _grid(*axes: Axes) -> None:
    for axis in axes:
        axis.grid(True, which="both", color="0.9", linewidth=0.6)


def fit_figure(found: Identified) -> Figure:
    """Measured and simulated output of the validation run, and their difference."""
    figure = Figure(figsize=(9.0, 5.5), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    run = found.validation
    time = np.arange(run.samples) * run.step
    modelled = simulated(found.model, run)[:, 0]
    middle = max(0.5 * (time[-1] - _WINDOW), 0.0)
    inside = (time >= middle) & (time <= middle + _WINDOW)
    unit = run.output_units[0]
    fit = float(fit_percentage(run.output[:, 0], modelled)[0])
    top.plot(time[inside], run.output[inside, 0], color="0.2", label="measured")
    top.plot(time[inside], modelled[inside], "--", color="#d55e00", label=f"model, {fit:.1f} %")
    bottom.plot(time[inside], (run.output[:, 0] - modelled)[inside], color="#0072b2")
    top.set(ylabel=f"{run.output_names[0]} [{unit}]", title=f"validation: {found.axis}")
    bottom.set(xlabel="time [s]", ylabel=f"difference [{unit}]")
    top.legend(fontsize=8, loc="upper right")
    _grid(top, bottom)
    return figure


def residual_figure(found: Residuals, step: float) -> Figure:
    """Auto- and cross-correlation of the residuals with their 99 % bounds."""
    figure = Figure(figsize=(9.0, 5.5), layout="constrained")
    auto, cross = figure.subplots(2, 1, sharex=True)
    lags = found.lags * step
    for axis, values, bound, title in (
        (auto, found.auto, found.auto_bound, "residual with itself"),
        (cross, found.cross[0], found.cross_bound[0], "residual with past command"),
    ):
        axis.axhspan(-bound, bound, color="#0072b2", alpha=0.15, label="99 % of a right model")
        axis.vlines(lags, 0.0, values, color="0.3", linewidth=1.2)
        axis.axhline(0.0, color="0.3", linewidth=0.8)
        axis.set(title=title, ylabel="correlation")
        axis.legend(fontsize=8, loc="upper right")
    cross.set(xlabel="lag [s]")
    _grid(auto, cross)
    return figure


def _ellipse(axis: Axes, root: Root, colour: str) -> None:
    """Ellipse that holds a root with 95 % probability."""
    if not np.isfinite(root.covariance).all():
        return
    size, turn = np.linalg.eigh(root.covariance)
    radius = np.sqrt(np.clip(size, 0.0, None) * stats.chi2(2).ppf(CONFIDENCE))
    angle = float(np.degrees(np.arctan2(turn[1, 1], turn[0, 1])))
    centre = (root.value.real, root.value.imag)
    shape = Ellipse(centre, 2.0 * radius[1], 2.0 * radius[0], angle=angle)
    shape.set(facecolor=colour, alpha=0.25, edgecolor=colour)
    axis.add_patch(shape)


def roots_figure(model: PolynomialModel) -> Figure:
    """Poles and zeros in the z plane with 95 % ellipses."""
    figure = Figure(figsize=(6.5, 6.5), layout="constrained")
    axis = figure.subplots()
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    axis.plot(np.cos(turn), np.sin(turn), color="0.6", linewidth=0.8)
    for roots, mark, colour in ((model.poles(), "x", "#d55e00"), (model.zeros(), "o", "#0072b2")):
        values = np.array([root.value for root in roots])
        near = values[np.abs(values) < 2.0]
        label = {"x": "poles", "o": "zeros"}[mark]
        left_out = values.size - near.size
        label += f" ({left_out} beyond the figure)" if left_out else ""
        fill = colour if mark == "x" else "none"
        axis.scatter(near.real, near.imag, marker=mark, color=colour, facecolor=fill, label=label)
        for root in roots:
            if abs(root.value) < 2.0:
                _ellipse(axis, root, colour)
    reach = 1.15
    for root in (*model.poles(), *model.zeros()):
        if abs(root.value) < 2.0:
            reach = max(reach, 1.1 * abs(root.value))
    axis.set(
        xlim=(-reach, reach),
        ylim=(-reach, reach),
        aspect="equal",
        xlabel="real",
        ylabel="imaginary",
        title=f"{model.method} {tuple(model.orders)} at {1.0 / model.step:g} Hz, 95 % ellipses",
    )
    axis.legend(fontsize=8)
    _grid(axis)
    return figure


def bode_figure(model: PolynomialModel, response: FrequencyResponse | None) -> Figure:
    """Bode plot of the model with its 95 % band beside the measured response."""
    figure = Figure(figsize=(8.0, 6.5), layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    highest = 0.4 / model.step if response is None else float(response.frequency[-1])
    frequency = np.geomspace(0.1, min(highest, 0.45 / model.step), 300)
    g = model.response(frequency)[:, 0, 0]
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
    level = 20.0 * np.log10(np.abs(g))
    angle = np.degrees(np.unwrap(np.angle(g)))
    if response is not None:
        gain.semilogx(response.frequency, response.gain_db, ".", color="0.5", markersize=3)
        measured = response.phase_deg
        shift = 360.0 * np.round(
            (np.interp(1.0, response.frequency, measured) - np.interp(1.0, frequency, angle))
            / 360.0
        )
        phase.semilogx(
            response.frequency, measured - shift, ".", color="0.5", markersize=3, label="measured"
        )
    gain.semilogx(frequency, level, color="#d55e00")
    phase.semilogx(frequency, angle, color="#d55e00", label=model.method)
    near = 20.0 * np.log10(np.clip(1.0 - wide, 1e-3, None))
    far = 20.0 * np.log10(1.0 + wide)
    gain.fill_between(frequency, level + near, level + far, color="#d55e00", alpha=0.25)
    half = np.degrees(np.minimum(turn, np.pi))
    phase.fill_between(
        frequency, angle - half, angle + half, color="#d55e00", alpha=0.25, label="95 % band"
    )
    gain.set(ylabel="gain [dB]", title=f"{model.input_names[0]} to {model.output_names[0]}")
    phase.set(ylabel="phase [deg]", xlabel="frequency [Hz]")
    phase.legend(fontsize=8)
    _grid(gain, phase)
    return figure


def save_identification(found: Identified, folder: Path) -> list[Path]:
    """Write `model.json`, `fit.png`, `residuals.png`, `roots.png` and `bode.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "fit.png": fit_figure(found),
        "residuals.png": residual_figure(found.residuals, found.model.step),
        "roots.png": roots_figure(found.model),
        "bode.png": bode_figure(found.model, found.response),
    }
    model, rational = found.model, found.continuous.rational
    loop = found.loop
    write_json(
        folder / "model.json",
        plain(
            {
                "axis": found.axis,
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
                "estimation_fit": found.estimation_fit,
                "validation_fit": found.validation_fit,
                "continuous": {
                    "numerator": rational.num[0][0].tolist(),
                    "denominator": rational.den[0][0].tolist(),
                    "misfit": found.continuous.misfit,
                },
                "closed_loop": None
                if loop is None
                else {
                    "law": found.law,
                    "model": loop.model._asdict(),
                    "measured": loop.measured._asdict(),
                    "phase_error": loop.phase_error,
                    "gain_error": loop.gain_error,
                },
            }
        ),
    )
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=110)
    return [folder / name for name in ("model.json", *figures)]
