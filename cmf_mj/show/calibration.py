"""Tables, CSV files and figures of a calibration."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from cmf_mj.core.files import whole_file, write_csv, write_text
from cmf_mj.show.comparison import markdown
from cmf_mj.studies.calibration.examination import Examination
from cmf_mj.studies.calibration.fit import Calibration, Residual, residual_rows
from cmf_mj.studies.calibration.sensitivity import Sensitivity, Spread
from cmf_mj.studies.calibration.trial import Verdict

_MEASURE = {"phase": "-90 deg", "gain": "-3 dB", "damping": "zeta"}
_OF = {"hardware": "h", "nonlinear": "m"}
_FITTED, _PREDICTED = "#0072b2", "#d55e00"


def _off(row: Residual) -> str:
    if row.deviation != row.deviation:
        return "-"
    text = f"{row.deviation:+.2f}" if row.measure == "damping" else f"{100 * row.deviation:+.1f} %"
    return text if row.within else f"{text} !"


def _pairs(calibration: Calibration) -> list[tuple[Residual, Residual]]:
    before, after = (
        residual_rows(calibration.study, stage.simulated)
        for stage in (calibration.before, calibration.after)
    )
    return list(zip(before, after, strict=True))


_RESIDUAL_HEADER = (
    "table",
    "law",
    "of",
    "what",
    "role",
    "printed",
    "shipped",
    "off",
    "fitted",
    "off",
)


def _residual_cells(calibration: Calibration) -> list[list[str]]:
    return [
        [
            first.table,
            first.law,
            _OF[first.of],
            _MEASURE[first.measure],
            first.role,
            f"{first.printed:.2f}",
            "-" if first.computed != first.computed else f"{first.computed:.2f}",
            _off(first),
            "-" if last.computed != last.computed else f"{last.computed:.2f}",
            _off(last),
        ]
        for first, last in _pairs(calibration)
    ]


def _parameter_cells(calibration: Calibration) -> list[list[str]]:
    before, after = calibration.before.values, calibration.after.values
    cells = []
    for p in calibration.study.parameters:
        error = calibration.standard_errors.get(p.name)
        fitted = "held" if error is None else f"{after[p.name]:.4g} +- {error:.2g}"
        cells.append(
            [p.name, p.unit, f"{before[p.name]:.4g}", fitted, f"{p.low:g} to {p.high:g}", p.source]
        )
    return cells


_PARAMETER_HEADER = ("parameter", "unit", "shipped", "fitted", "range", "source of the range")
_SPREAD_HEADER = ("law", "what", "nominal", "5 %", "95 %", "unstable")


def _spread_cells(rows: Iterable[Spread]) -> list[list[str]]:
    return [
        [
            row.law,
            _MEASURE[row.measure],
            f"{row.nominal:.2f}",
            f"{row.low:.2f}",
            f"{row.high:.2f}",
            f"{100 * row.unstable:.0f} %",
        ]
        for row in rows
    ]


def _damping_cells(calibration: Calibration) -> list[list[str]]:
    before, after = calibration.before.least_damping, calibration.after.least_damping
    return [[cab, f"{before[cab]:.3f}", f"{after[cab]:.3f}"] for cab in before]


_DAMPING_HEADER = ("cab", "least damping, shipped", "fitted")


def tables(found: Examination) -> list[Table]:
    """Parameters, residuals, least damping and uncertainty for the terminal."""
    calibration = found.calibration
    title = f"{calibration.study.name}: {calibration.study.title}"
    parts = [
        (title, _PARAMETER_HEADER, _parameter_cells(calibration)),
        ("residuals of the simulation", _RESIDUAL_HEADER, _residual_cells(calibration)),
        ("uncertainty from the ranges", _SPREAD_HEADER, _spread_cells(found.spread)),
    ]
    if calibration.before.least_damping:
        parts.append(("velocity law, linear", _DAMPING_HEADER, _damping_cells(calibration)))
    return [_table(*part) for part in parts]


def _table(title: str, header: Sequence[str], cells: Iterable[Sequence[str]]) -> Table:
    table = Table(title=title)
    for name in header:
        table.add_column(name, overflow="fold")
    for row in cells:
        table.add_row(*row)
    return table


def verdict_text(found: Examination) -> str:
    """One line on the stability runs, or nothing."""
    if not found.verdicts:
        return ""
    worst = max(found.verdicts, key=lambda verdict: verdict.residual)
    bad = [f"{v.cab} {v.dof}" for v in found.verdicts if not v.stable]
    return (
        f"velocity law, {len(found.verdicts)} step runs with the fitted values: "
        + (f"unstable in {', '.join(bad)}" if bad else "all stable")
        + f"; largest swing left {100 * worst.residual:.2f} % ({worst.cab}, {worst.dof})"
    )


def text(found: Examination) -> str:
    """The tables as Markdown, for docs/calibration.md."""
    calibration = found.calibration
    parts = [
        markdown(_PARAMETER_HEADER, _parameter_cells(calibration)),
        markdown(_RESIDUAL_HEADER, _residual_cells(calibration)),
        markdown(_SPREAD_HEADER, _spread_cells(found.spread)),
    ]
    if calibration.before.least_damping:
        parts.append(markdown(_DAMPING_HEADER, _damping_cells(calibration)))
    if found.verdicts:
        parts.append(f"{verdict_text(found).capitalize()}.\n")
    return "\n".join(parts)


def residual_figure(calibration: Calibration) -> Figure:
    """Deviations over their tolerance, as shipped and as fitted."""
    pairs = [pair for pair in _pairs(calibration) if pair[0].deviation == pair[0].deviation]
    figure = Figure(figsize=(7.5, 1.3 + 0.21 * len(pairs)), layout="constrained")
    axes = figure.add_subplot()
    axes.axvspan(-1.0, 1.0, color="0.92")
    axes.axvline(0.0, color="0.6", linewidth=0.8)
    for place, (first, last) in enumerate(pairs):
        colour = _FITTED if first.role == "fitted" else _PREDICTED
        ends = [row.deviation / row.tolerance for row in (first, last)]
        axes.plot(ends, [place, place], color=colour, linewidth=0.8)
        axes.plot(ends[0], place, "o", color=colour, markerfacecolor="white", markersize=5)
        axes.plot(ends[1], place, "o", color=colour, markersize=5)
    labels = [f"{p.table.removeprefix('section ')} {p.law} {_MEASURE[p.measure]}" for p, _ in pairs]
    axes.set_yticks(range(len(pairs)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("deviation from the print over its tolerance")
    tolerance = calibration.study.tolerance
    axes.set_title(
        f"{calibration.study.name}: open as shipped, full as fitted; blue fitted to, orange "
        f"predicted\ntolerance {100 * tolerance.phase:g} % (-90 deg), {100 * tolerance.gain:g} % "
        f"(-3 dB), {tolerance.damping:g} (zeta)",
        fontsize=9,
    )
    return figure


def sensitivity_figure(found: Sensitivity, name: str) -> Figure:
    """Heat map of the normalised derivatives."""
    rows = [(law, m) for law in found.laws for m in found.measures]
    values = found.derivative.reshape(len(rows), len(found.parameters))
    there = ~np.all(np.isnan(values), axis=1)
    rows = [row for row, kept in zip(rows, there, strict=True) if kept]
    values = values[there]
    figure = Figure(figsize=(7.5, 1.6 + 0.24 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    limit = 1.0
    image = axes.imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit, aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        if value == value:
            dark = abs(value) > 0.6 * limit
            axes.text(
                j,
                i,
                f"{value:+.2f}",
                ha="center",
                va="center",
                fontsize=7,
                color="white" if dark else "black",
            )
    axes.set_xticks(range(len(found.parameters)), found.parameters, rotation=30, ha="right")
    axes.set_yticks(range(len(rows)), [f"{law} {_MEASURE[m]}" for law, m in rows], fontsize=8)
    axes.set_title(f"{name}: d ln(result) / d ln(parameter), colours cut at +-1", fontsize=10)
    figure.colorbar(image, ax=axes, shrink=0.8)
    return figure


def save(found: Examination, folder: Path) -> list[Path]:
    """Write CSV files, figures and the Markdown of a study.

    Returns:
        The paths.
    """
    folder.mkdir(parents=True, exist_ok=True)
    calibration = found.calibration
    stages = [("shipped", calibration.before), ("fitted", calibration.after)]
    residuals = [
        (stage, *row)
        for stage, result in stages
        for row in residual_rows(calibration.study, result.simulated)
    ]
    derivative = found.sensitivity.derivative
    derivatives = [
        (law, measure, parameter, derivative[i, j, k])
        for i, law in enumerate(found.sensitivity.laws)
        for j, measure in enumerate(found.sensitivity.measures)
        for k, parameter in enumerate(found.sensitivity.parameters)
    ]
    values = [
        (p.name, p.unit, calibration.before.values[p.name], calibration.after.values[p.name])
        for p in calibration.study.parameters
    ]
    paths = [
        _csv(folder / "parameters.csv", ("parameter", "unit", "shipped", "fitted"), values),
        _csv(folder / "residuals.csv", ("stage", *Residual._fields), residuals),
        _csv(
            folder / "sensitivity.csv",
            ("law", "measure", "parameter", "normalised_derivative"),
            derivatives,
        ),
        _csv(folder / "uncertainty.csv", Spread._fields, found.spread),
    ]
    if found.verdicts:
        paths.append(_csv(folder / "stability.csv", Verdict._fields, found.verdicts))
    for name, figure in (
        ("residuals.png", residual_figure(calibration)),
        ("sensitivity.png", sensitivity_figure(found.sensitivity, calibration.study.name)),
    ):
        with whole_file(folder / name) as partial:
            figure.savefig(partial, dpi=110, format="png")
        paths.append(folder / name)
    write_text(folder / "calibration.md", text(found))
    return [*paths, folder / "calibration.md"]


def _csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> Path:
    known = (["" if value != value else value for value in row] for row in rows)
    return write_csv(path, header, known, digits=6)
