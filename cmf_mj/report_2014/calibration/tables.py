"""Tables, CSV files and figures of a calibration."""

from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from cmf_mj.core.files import write_text
from cmf_mj.core.table import Cell, Table, number
from cmf_mj.report_2014.calibration.fit import (
    MEASURE_TITLES,
    Calibration,
    Examination,
    Residual,
    residual_rows,
)
from cmf_mj.report_2014.calibration.trial import MEASURES
from cmf_mj.show.look import BLUE, GREY, ORANGE, new_figure, save_files

_OF = {"hardware": "h", "nonlinear": "m"}


def _computed(row: Residual) -> Cell:
    return row.computed if row.stable else "unstable"


def _deviation(row: Residual) -> str:
    scale, form = (1.0, "+.2f") if row.measure == "damping" else (100.0, "+.1f %")
    text = number(scale * row.deviation, form)
    return f"{text} !" if not row.within and (text != "-" or not row.stable) else text


def _pairs(calibration: Calibration) -> list[tuple[Residual, Residual]]:
    """Residuals as shipped and as fitted."""
    before, after = (
        residual_rows(calibration.study, stage.simulated)
        for stage in (calibration.before, calibration.after)
    )
    return list(zip(before, after, strict=True))


def tables(result: Examination) -> list[Table]:
    """Parameters, residuals, uncertainty and, where there is one, least damping."""
    calibration = result.calibration
    study, before, after = calibration.study, calibration.before, calibration.after
    parameters = []
    for p in study.parameters:
        error = calibration.standard_errors.get(p.name)
        fitted = "held" if error is None else f"{after.values[p.name]:.4g} +- {error:.2g}"
        bounds = f"{p.low:g} to {p.high:g}"
        parameters.append((p.name, p.unit, before.values[p.name], fitted, bounds, p.source))
    residuals = [
        (
            *(a.table, a.law, _OF[a.of], MEASURE_TITLES[a.measure], a.role),
            *(a.printed, _computed(a), _deviation(a), _computed(b), _deviation(b)),
        )
        for a, b in _pairs(calibration)
    ]
    header = ("table", "law", "of", "what", "role", ("printed", ".2f"), ("shipped", ".2f"))
    every = [
        Table(
            f"{study.name}: {study.title}",
            ("parameter", "unit", ("shipped", ".4g"), "fitted", "range", "source of the range"),
            parameters,
        ),
        Table(
            "residuals of the simulation",
            (*header, ("off", ""), ("fitted", ".2f"), ("off", "")),
            residuals,
        ),
        result.spread.table,
    ]
    if before.least_damping:
        damping = [
            (cab, before.least_damping[cab], after.least_damping[cab])
            for cab in before.least_damping
        ]
        columns = ("cab", ("least damping, shipped", ".3f"), ("fitted", ".3f"))
        every.append(Table("velocity law, linear", columns, damping))
    return every


def verdict_text(result: Examination) -> str:
    """One line on the stability runs, or nothing."""
    if not result.verdicts:
        return ""
    worst = max(result.verdicts, key=lambda verdict: verdict.residual)
    bad = [f"{v.cab} {v.dof}" for v in result.verdicts if not v.stable]
    return (
        f"velocity law, {len(result.verdicts)} step runs with the fitted values: "
        + (f"unstable in {', '.join(bad)}" if bad else "all stable")
        + f"; largest swing left {100 * worst.residual:.2f} % ({worst.cab}, {worst.dof})"
    )


def markdown(result: Examination) -> str:
    """The tables as Markdown, for docs/reference/calibration_tables.md."""
    parts = [table.markdown() for table in tables(result)]
    if result.verdicts:
        parts.append(f"{verdict_text(result).capitalize()}.\n")
    return "\n".join(parts)


def residual_figure(calibration: Calibration) -> Figure:
    """Deviations over their tolerance, as shipped and as fitted."""
    pairs = [pair for pair in _pairs(calibration) if pair[0].deviation == pair[0].deviation]
    figure = new_figure(7.5, 1.3 + 0.21 * len(pairs), gridded=False)
    axes = figure.subplots()
    axes.axvspan(-1.0, 1.0, color="0.92")
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    for place, (first, last) in enumerate(pairs):
        colour = BLUE if first.role == "fitted" else ORANGE
        ends = [row.deviation / row.tolerance for row in (first, last)]
        axes.plot(ends, [place, place], color=colour, linewidth=0.8)
        axes.plot(ends[0], place, "o", color=colour, markerfacecolor="white", markersize=5)
        axes.plot(ends[1], place, "o", color=colour, markersize=5)
    labels = [
        f"{p.table.removeprefix('section ')} {p.law} {MEASURE_TITLES[p.measure]}" for p, _ in pairs
    ]
    axes.set_yticks(range(len(pairs)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("deviation from the print over its tolerance")
    phase, gain, zeta = (calibration.study.tolerance[measure] for measure in MEASURES)
    axes.set_title(
        f"Deviations from the print, {calibration.study.name} set\n"
        "open as shipped, full as fitted; blue fitted to, orange predicted; tolerance "
        f"{100 * phase:g} % (-90 deg), {100 * gain:g} % (-3 dB), "
        f"{zeta:g} (zeta)",
        fontsize=9,
    )
    return figure


def save_calibration(result: Examination, folder: Path) -> list[Path]:
    """Write `residuals.png`, and the tables as `calibration.md`."""
    tables = partial(write_text, text=markdown(result))
    figure = residual_figure(result.calibration)
    return save_files({"residuals.png": figure, "calibration.md": tables}, folder)
