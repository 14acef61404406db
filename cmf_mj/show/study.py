"""Tables and figures of finished studies."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.look import BLUE, COLOURS, grid, new_figure, save_figures
from cmf_mj.show.table import Cell, Table, number
from cmf_mj.studies.effects import (
    ENOUGH_DAMPING,
    Interval,
    Row,
    agreement,
    climb,
    crosstalk_matrix,
    in_order,
    largest_crosstalk,
    law_effects,
    rates,
    rows_of,
)
from cmf_mj.studies.settings import NOMINAL

REFERENCES = {"rotation": "position_error_rate", "rotation_flown": "velocity"}
"""Tables of effects and the laws they are against: the one that acceleration feedback is added to,
and the one flown."""

_MEASURES = (
    ("phase_bandwidth_hz", "-90 deg [Hz]"),
    ("peak_gain_db", "peak [dB]"),
    ("damping_ratio", "damping ratio"),
    ("crosstalk", "largest crosstalk"),
)


def _percent(share: Interval) -> str:
    if share.machines == 0:
        return "-"
    return f"{100.0 * share.value:.0f} ({100.0 * share.low:.0f}-{100.0 * share.high:.0f})"


def _difference(change: Interval, digits: int) -> str:
    if change.machines == 0:
        return "-"
    middle, low, high = (number(v, f"+.{digits}f") for v in (change.value, change.low, change.high))
    between = "" if np.isnan(change.low) else f" ({low} to {high}), n = {change.machines}"
    return middle + (between or f" (n = {change.machines})")


def rate_table(table: pa.Table) -> Table:
    """Shares of machines that are stable, and damped in each degree of freedom [%]."""
    names = ("cab", "law", "stable %", *(f"{dof} damped %" for dof in DOFS))
    rows: list[tuple[Cell, ...]] = [
        (
            *(rate.cab, rate.law, _percent(rate.stable)),
            *(_percent(rate.damped[dof]) for dof in DOFS),
            rate.mode_damping.value,
        )
        for rate in rates(table)
    ]
    return Table("", (*names, ("least mode damping", ".3f")), rows)


def effect_table(table: pa.Table, against: str) -> Table:
    """What all other laws change in rotation against one."""
    header = ("cab", "law", "dof", "stable %", "-90 deg [Hz]", "zeta", "least mode damping")
    rows = [
        (
            *(effect.cab, effect.law, effect.dof, _percent(effect.stable)),
            _difference(effect.phase_bandwidth_hz, 2),
            _difference(effect.damping_ratio, 3),
            _difference(effect.mode_damping, 3),
        )
        for effect in law_effects(table, against)
    ]
    return Table("", header, rows)


def agreement_table(table: pa.Table) -> Table:
    """Linear cases compared with simulated ones."""
    columns = (
        *("law", ("machines", "d"), ("same verdict", "d")),
        *(("-90 deg: median difference [Hz]", ".2f"), ("zeta", ".2f")),
    )
    rows = [
        (each.law, each.machines, each.verdicts, each.phase_hz, each.damping_ratio)
        for each in agreement(table)
    ]
    return Table("", columns, rows)


def measure_table(table: pa.Table) -> Table:
    """Measures of every case that was swept, a column a rung or cab."""
    rows = rows_of(table)
    columns = list(dict.fromkeys((row["rung"], row["cab"]) for row in rows))
    several = len({cab for _, cab in columns}) > 1
    header = ["law", "dof", *(cab if several else rung for rung, cab in columns)]
    by_case = {(r["law"], r["dof"], r["rung"], r["cab"]): r for r in rows}
    lines = []
    for law, dof in dict.fromkeys((row["law"], row["dof"]) for row in rows):
        cases = [by_case.get((law, dof, *column)) for column in columns]
        lines.append([law, dof, *("" if row is None else _cell(row) for row in cases)])
    return Table("", header, lines)


def _cell(row: Row) -> str:
    damping = number(row["damping_ratio"], ".2f") if row["stable"] else "u"
    width, peak = number(row["phase_bandwidth_hz"], ".2f"), number(row["peak_gain_db"], ".1f")
    return f"{width} / {peak} / {damping}"


def climb_table(table: pa.Table) -> Table:
    """Share of each effect: median change over the laws, a row a rung."""
    steps = climb(table)
    by_place = {(step.rung, step.dof): step for step in steps}
    dofs, rungs = (list(dict.fromkeys(getattr(s, name) for s in steps)) for name in ("dof", "rung"))
    forms = [(name, "+.1f" if name == "peak_gain_db" else "+.2f") for name, _ in _MEASURES]
    rows = [
        [
            rung,
            *(
                " / ".join(number(getattr(by_place[rung, dof], name), form) for name, form in forms)
                for dof in dofs
            ),
        ]
        for rung in rungs
    ]
    return Table("", ("adds", *dofs), rows)


def _value(row: Row | None, name: str) -> float:
    if row is None or (name == "damping_ratio" and not row["stable"]):
        return float("nan")
    return largest_crosstalk(row) if name == "crosstalk" else float(row[name])


def ladder_figure(table: pa.Table) -> Figure:
    """The climb: measures down, degrees of freedom across, a line a law; crosses are unstable."""
    rows = rows_of(table)
    rungs, laws, dofs = (in_order(rows, name) for name in ("rung", "law", "dof"))
    by_case = {(r["rung"], r["law"], r["dof"]): r for r in rows}
    figure = new_figure(2.6 * len(dofs) + 0.6, 10.5)
    axes = figure.subplots(len(_MEASURES), len(dofs), sharex=True, sharey="row", squeeze=False)
    for (name, title), line in zip(_MEASURES, axes, strict=True):
        for dof, axis in zip(dofs, line, strict=True):
            for i, law in enumerate(laws):
                cases = [by_case.get((rung, law, dof)) for rung in rungs]
                values = np.array([_value(row, name) for row in cases])
                style: dict[str, Any] = {
                    "color": COLOURS[i % len(COLOURS)],
                    "linestyle": "-" if i < len(COLOURS) else "--",
                }
                axis.plot(values, marker="o", markersize=3.0, linewidth=1.0, label=law, **style)
                unstable = [k for k, row in enumerate(cases) if row and not row["stable"]]
                style["linestyle"] = ""
                axis.plot(unstable, values[unstable], marker="x", markersize=7.0, **style)
            if name == "crosstalk":
                axis.set_yscale("log")
                axis.set_xticks(range(len(rungs)), rungs, rotation=90, fontsize=8)
        line[0].set_ylabel(title)
    grid(*axes.flat)
    for dof, axis in zip(dofs, axes[0], strict=True):
        axis.set_title(dof)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8)
    return figure


def _matrix(axis: Axes, matrix: NDArray[np.float64], title: str) -> AxesImage:
    image = axis.imshow(matrix, norm=LogNorm(1e-2, 1e1), cmap="viridis")
    axis.set_xticks(range(6), DOFS, rotation=90, fontsize=7)
    axis.set_yticks(range(6), DOFS, fontsize=7)
    axis.set_title(title, fontsize=9)
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 6}
    for (i, j), value in np.ndenumerate(matrix):
        if not np.isnan(value):
            text = f"{value:.2f}" if value < 9.95 else f"{value:.0f}"
            axis.text(j, i, text, color="w" if value < 1.0 else "k", **style)
    return image


def crosstalk_figure(table: pa.Table, law: str) -> Figure:
    """Crosstalk of a law: the nominal machine, then the median and 95 % of those drawn."""
    rows = rows_of(table, method="linear", law=law)
    cabs = in_order(rows, "cab")
    figure = new_figure(9.6, 3.1 * len(cabs) + 0.4)
    axes = figure.subplots(len(cabs), 3, squeeze=False)
    for cab, line in zip(cabs, axes, strict=True):
        of_cab = [row for row in rows if row["cab"] == cab]
        nominal = [row for row in of_cab if row["draw"] == NOMINAL]
        drawn = [row for row in of_cab if row["draw"] != NOMINAL]
        stable = sum(row["stable"] for row in drawn if row["dof"] == DOFS[0])
        image = _matrix(line[0], crosstalk_matrix(nominal, 0.5), f"{cab.upper()}, nominal")
        _matrix(line[1], crosstalk_matrix(drawn, 0.5), f"median of {stable} machines")
        _matrix(line[2], crosstalk_matrix(drawn, 0.95), "95 % stay below")
        line[0].set_ylabel("moved")
    for axis in axes[-1]:
        axis.set_xlabel("driven")
    figure.colorbar(image, ax=axes, label="largest gain, 0.1 to 10 Hz", shrink=0.6)
    figure.suptitle(f"crosstalk, {law}", fontsize=10)
    return figure


def rate_figure(table: pa.Table) -> Figure:
    """Shares of stable machines and of damped ones in each degree of freedom, with intervals."""
    every = rates(table)
    cabs, laws = (list(dict.fromkeys(getattr(r, name) for r in every)) for name in ("cab", "law"))
    titles = ["stable", *DOFS]
    figure = new_figure(11.0, 0.38 * len(laws) * len(cabs) + 1.6)
    axes = figure.subplots(len(cabs), len(titles), sharex=True, sharey=True, squeeze=False)
    for cab, line in zip(cabs, axes, strict=True):
        of_cab = [rate for rate in every if rate.cab == cab]
        for title, axis in zip(titles, line, strict=True):
            shares = [r.stable if title == "stable" else r.damped[title] for r in of_cab]
            middle = 100.0 * np.array([s.value for s in shares])
            errors = np.array([[s.value - s.low, s.high - s.value] for s in shares]).T
            spread = 100.0 * np.maximum(errors, 0.0)
            axis.errorbar(
                middle, range(len(of_cab)), xerr=spread, fmt="o", markersize=4.0, color=BLUE
            )
            axis.set_xlim(-5.0, 105.0)
        line[0].set_yticks(range(len(of_cab)), [rate.law for rate in of_cab], fontsize=8)
        line[0].set_ylim(len(of_cab) - 0.5, -0.5)
        line[-1].yaxis.set_label_position("right")
        line[-1].set_ylabel(cab.upper())
    grid(*axes.flat)
    for title, axis in zip(titles, axes[0], strict=True):
        name = title if title == "stable" else f"{title}\nzeta > {ENOUGH_DAMPING:g}"
        axis.set_title(name, fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("machines [%]", fontsize=8)
    return figure


def tables_of(table: pa.Table) -> dict[str, Table]:
    """The tables a study has something for, by the name of their file."""
    rows = rows_of(table)
    methods, laws = in_order(rows, "method"), in_order(rows, "law")
    tables: dict[str, Table] = {}
    if "sweep" in methods:
        tables["measures"] = measure_table(table)
    if len(in_order(rows, "rung")) > 1:
        tables["effects"] = climb_table(table)
    if "linear" in methods and any(row["draw"] != NOMINAL for row in rows):
        tables["rates"] = rate_table(table)
        for name, against in REFERENCES.items():
            if against in laws and len(laws) > 1:
                tables[name] = effect_table(table, against)
    if "linear" in methods and "matrix" in methods:
        tables["agreement"] = agreement_table(table)
    return tables


def figures_of(table: pa.Table) -> dict[str, Figure]:
    """The figures a study has something for, by the name of their file."""
    rows = rows_of(table)
    figures: dict[str, Figure] = {}
    if len(in_order(rows, "rung")) > 1:
        figures["ladder"] = ladder_figure(table)
    if any(row["method"] == "linear" and row["draw"] != NOMINAL for row in rows):
        figures["rates"] = rate_figure(table)
        for law in in_order(rows, "law"):
            figures[f"crosstalk_{law}"] = crosstalk_figure(table, law)
    return figures


def save_report(table: pa.Table, folder: Path) -> list[Path]:
    """Write every table as Markdown and CSV and every figure as PNG."""
    paths = [
        each.save(folder / f"{name}.{kind}")
        for name, each in tables_of(table).items()
        for kind in ("md", "csv")
    ]
    return paths + save_figures(figures_of(table), folder, 80)


def summary_table(table: pa.Table) -> Table:
    """Cases by law and method: how many ran, were stable, failed."""
    rows = table.to_pylist()
    lines = []
    for method, law in dict.fromkeys((row["method"], row["law"]) for row in rows):
        every = [row for row in rows if (row["method"], row["law"]) == (method, law)]
        wrong = sum(bool(row["error_type"]) for row in every)
        stable = sum(row["stable"] for row in every)
        lines.append((method, law, len(in_order(every, "case")), stable, len(every) - wrong, wrong))
    counts = ((name, "d") for name in ("cases", "stable rows", "rows", "failed"))
    return Table(f"{len(in_order(rows, 'case'))} cases", ("method", "law", *counts), lines)
