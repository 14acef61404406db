"""Tables and figures of finished studies, for the terminal, for Markdown, CSV and PNG files."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray
from rich.table import Table

from cmf_mj.core.files import whole_file, write_csv, write_text
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.show.comparison import markdown
from cmf_mj.studies.effects import (
    ENOUGH_DAMPING,
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
from cmf_mj.studies.intervals import Interval
from cmf_mj.studies.settings import NOMINAL

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999933")

REFERENCES = {"rotation": "position_error_rate", "rotation_flown": "velocity"}
"""Tables of effects and the laws they are against: the one that acceleration feedback is added to,
and the one flown."""

ROTATION = DOFS[3:]

_MEASURES = (
    ("phase_bandwidth_hz", "-90 deg [Hz]"),
    ("peak_gain_db", "peak [dB]"),
    ("damping_ratio", "damping ratio"),
    ("crosstalk", "largest crosstalk"),
)


class Lines(NamedTuple):
    """A table as text."""

    header: list[str]
    lines: list[list[str]]


def _number(value: float, digits: int = 2, *, sign: bool = False) -> str:
    return "-" if value != value else f"{value:{'+' if sign else ''}.{digits}f}"


def _percent(found: Interval) -> str:
    if found.machines == 0:
        return "-"
    return f"{100.0 * found.value:.0f} ({100.0 * found.low:.0f}-{100.0 * found.high:.0f})"


def _difference(found: Interval, digits: int) -> str:
    if found.machines == 0:
        return "-"
    middle = _number(found.value, digits, sign=True)
    if np.isnan(found.low):
        return f"{middle} (n = {found.machines})"
    low, high = (_number(v, digits, sign=True) for v in (found.low, found.high))
    return f"{middle} ({low} to {high}), n = {found.machines}"


def rate_lines(table: pa.Table) -> Lines:
    """Shares of machines that are stable, and damped in each degree of freedom [%]."""
    header = ["cab", "law", "stable %", *(f"{dof} damped %" for dof in DOFS), "least mode damping"]
    lines = [
        [
            found.cab,
            found.law,
            _percent(found.stable),
            *(_percent(found.damped[dof]) for dof in DOFS),
            _number(found.mode_damping.value, 3),
        ]
        for found in rates(table)
    ]
    return Lines(header, lines)


def effect_lines(table: pa.Table, against: str) -> Lines:
    """What all other laws change in rotation against one."""
    laws = [law for law in in_order(rows_of(table), "law") if law != against]
    header = ["cab", "law", "dof", "stable %", "-90 deg [Hz]", "zeta", "least mode damping"]
    lines = [
        [
            found.cab,
            found.law,
            found.dof,
            _percent(found.stable),
            _difference(found.phase_bandwidth_hz, 2),
            _difference(found.damping_ratio, 3),
            _difference(found.mode_damping, 3),
        ]
        for found in law_effects(table, laws, against=against, dofs=ROTATION)
    ]
    return Lines(header, lines)


def agreement_lines(table: pa.Table) -> Lines:
    """Linear cases beside simulated ones."""
    header = ["law", "machines", "same verdict", "-90 deg: median difference [Hz]", "zeta"]
    lines = [
        [
            found.law,
            str(found.machines),
            str(found.verdicts),
            _number(found.phase_hz),
            _number(found.damping_ratio),
        ]
        for found in agreement(table)
    ]
    return Lines(header, lines)


def measure_lines(table: pa.Table) -> Lines:
    """Measures of every case that was swept, a column a rung or cab."""
    rows = rows_of(table)
    columns = list(dict.fromkeys((row["rung"], row["cab"]) for row in rows))
    several = len({cab for _, cab in columns}) > 1
    header = ["law", "dof", *(cab if several else rung for rung, cab in columns)]
    by_case = {(r["law"], r["dof"], r["rung"], r["cab"]): r for r in rows}
    lines = []
    for law, dof in dict.fromkeys((row["law"], row["dof"]) for row in rows):
        found = [by_case.get((law, dof, *column)) for column in columns]
        lines.append([law, dof, *("" if row is None else _cell(row) for row in found)])
    return Lines(header, lines)


def _cell(row: Row) -> str:
    damping = _number(row["damping_ratio"]) if row["stable"] else "u"
    return f"{_number(row['phase_bandwidth_hz'])} / {_number(row['peak_gain_db'], 1)} / {damping}"


def climb_lines(table: pa.Table) -> Lines:
    """Share of each effect: median change over the laws, a line a rung."""
    found = climb(table)
    dofs = list(dict.fromkeys(step.dof for step in found))
    header = ["adds", *dofs]
    by_place = {(step.rung, step.dof): step for step in found}
    lines = []
    for rung in dict.fromkeys(step.rung for step in found):
        cells = []
        for dof in dofs:
            step = by_place[rung, dof]
            cells.append(
                f"{_number(step.phase_bandwidth_hz, sign=True)} / "
                f"{_number(step.peak_gain_db, 1, sign=True)} / "
                f"{_number(step.damping_ratio, sign=True)} / "
                f"{_number(step.crosstalk, sign=True)}"
            )
        lines.append([rung, *cells])
    return Lines(header, lines)


def _value(row: Row, name: str) -> float:
    if name == "crosstalk":
        return largest_crosstalk(row)
    if name == "damping_ratio" and not row["stable"]:
        return float("nan")
    return float(row[name])


def ladder_figure(table: pa.Table) -> Figure:
    """The climb: measures down, degrees of freedom across, a line a law; crosses are unstable."""
    rows = rows_of(table)
    rungs, laws, dofs = (in_order(rows, name) for name in ("rung", "law", "dof"))
    by_case = {(r["rung"], r["law"], r["dof"]): r for r in rows}
    figure = Figure(figsize=(2.6 * len(dofs) + 0.6, 10.5), layout="constrained")
    axes = figure.subplots(len(_MEASURES), len(dofs), sharex=True, sharey="row", squeeze=False)
    for (name, title), line in zip(_MEASURES, axes, strict=True):
        for dof, axis in zip(dofs, line, strict=True):
            for i, law in enumerate(laws):
                found = [by_case.get((rung, law, dof)) for rung in rungs]
                values = np.array([np.nan if row is None else _value(row, name) for row in found])
                style = {"color": _COLOURS[i % len(_COLOURS)]}
                axis.plot(
                    values,
                    marker="o",
                    markersize=3.0,
                    linewidth=1.0,
                    linestyle="-" if i < len(_COLOURS) else "--",
                    label=law,
                    **style,
                )
                unstable = [k for k, row in enumerate(found) if row and not row["stable"]]
                axis.plot(unstable, values[unstable], "x", markersize=7.0, **style)
            axis.grid(True, color="0.9", linewidth=0.6)
            if name == "crosstalk":
                axis.set_yscale("log")
                axis.set_xticks(range(len(rungs)), rungs, rotation=90, fontsize=8)
        line[0].set_ylabel(title)
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
    for (i, j), value in np.ndenumerate(matrix):
        if not np.isnan(value):
            text = f"{value:.2f}" if value < 9.95 else f"{value:.0f}"
            axis.text(
                j, i, text, ha="center", va="center", fontsize=6, color="w" if value < 1.0 else "k"
            )
    return image


def crosstalk_figure(table: pa.Table, law: str) -> Figure:
    """Crosstalk of a law: the nominal machine beside the median and 95 % of those drawn."""
    rows = rows_of(table, method="linear", law=law)
    cabs = in_order(rows, "cab")
    figure = Figure(figsize=(9.6, 3.1 * len(cabs) + 0.4), layout="constrained")
    axes = figure.subplots(len(cabs), 3, squeeze=False)
    for cab, line in zip(cabs, axes, strict=True):
        own = [row for row in rows if row["cab"] == cab]
        nominal = [row for row in own if row["draw"] == NOMINAL]
        drawn = [row for row in own if row["draw"] != NOMINAL]
        stable = sum(row["stable"] for row in drawn if row["dof"] == DOFS[0])
        image = _matrix(line[0], crosstalk_matrix(nominal, np.median), f"{cab.upper()}, nominal")
        _matrix(line[1], crosstalk_matrix(drawn, np.median), f"median of {stable} machines")
        _matrix(
            line[2],
            crosstalk_matrix(drawn, lambda values: float(np.quantile(values, 0.95))),
            "95 % stay below",
        )
        line[0].set_ylabel("moved")
    for axis in axes[-1]:
        axis.set_xlabel("driven")
    figure.colorbar(image, ax=axes, label="largest gain, 0.1 to 10 Hz", shrink=0.6)
    figure.suptitle(f"crosstalk, {law}", fontsize=10)
    return figure


def rate_figure(table: pa.Table) -> Figure:
    """Shares of stable machines and of damped ones in each degree of freedom, with intervals."""
    found = rates(table)
    cabs = list(dict.fromkeys(rate.cab for rate in found))
    laws = list(dict.fromkeys(rate.law for rate in found))
    titles = ["stable", *DOFS]
    figure = Figure(figsize=(11.0, 0.38 * len(laws) * len(cabs) + 1.6), layout="constrained")
    axes = figure.subplots(len(cabs), len(titles), sharex=True, sharey=True, squeeze=False)
    for cab, line in zip(cabs, axes, strict=True):
        own = [rate for rate in found if rate.cab == cab]
        for title, axis in zip(titles, line, strict=True):
            shares = [r.stable if title == "stable" else r.damped[title] for r in own]
            middle = np.array([s.value for s in shares])
            errors = np.array([[s.value - s.low, s.high - s.value] for s in shares]).T
            axis.errorbar(
                100.0 * middle,
                range(len(own)),
                xerr=100.0 * np.maximum(errors, 0.0),
                fmt="o",
                markersize=4.0,
                color="#0072b2",
            )
            axis.grid(True, color="0.9", linewidth=0.6)
            axis.set_xlim(-5.0, 105.0)
        line[0].set_yticks(range(len(own)), [rate.law for rate in own], fontsize=8)
        line[0].set_ylim(len(own) - 0.5, -0.5)
        line[-1].yaxis.set_label_position("right")
        line[-1].set_ylabel(cab.upper())
    for title, axis in zip(titles, axes[0], strict=True):
        name = title if title == "stable" else f"{title}\nzeta > {ENOUGH_DAMPING:g}"
        axis.set_title(name, fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("machines [%]", fontsize=8)
    return figure


def tables_of(table: pa.Table) -> dict[str, Lines]:
    """The tables a study has something for, by the name of their file."""
    rows = rows_of(table)
    methods = in_order(rows, "method")
    found: dict[str, Lines] = {}
    if "sweep" in methods:
        found["measures"] = measure_lines(table)
    if len(in_order(rows, "rung")) > 1:
        found["effects"] = climb_lines(table)
    if "linear" in methods and any(row["draw"] != NOMINAL for row in rows):
        found["rates"] = rate_lines(table)
        there = in_order(rows, "law")
        for name, against in REFERENCES.items():
            if against in there and len(there) > 1:
                found[name] = effect_lines(table, against)
    if "linear" in methods and "matrix" in methods:
        found["agreement"] = agreement_lines(table)
    return found


def figures_of(table: pa.Table) -> dict[str, Figure]:
    """The figures a study has something for, by the name of their file."""
    rows = rows_of(table)
    found: dict[str, Figure] = {}
    if len(in_order(rows, "rung")) > 1:
        found["ladder"] = ladder_figure(table)
    if any(row["method"] == "linear" and row["draw"] != NOMINAL for row in rows):
        found["rates"] = rate_figure(table)
        for law in in_order(rows, "law"):
            found[f"crosstalk_{law}"] = crosstalk_figure(table, law)
    return found


def save_report(table: pa.Table, folder: str | Path) -> list[Path]:
    """Write every table as Markdown and CSV and every figure as PNG."""
    place = Path(folder)
    paths = []
    for name, (header, lines) in tables_of(table).items():
        target = place / f"{name}.md"
        write_text(target, markdown(header, lines))
        paths.append(target)
        paths.append(write_csv(place / f"{name}.csv", header, lines))
    for name, figure in figures_of(table).items():
        target = place / f"{name}.png"
        with whole_file(target) as partial:
            figure.savefig(partial, dpi=80, format="png")
        paths.append(target)
    return paths


def summary_table(table: pa.Table) -> Table:
    """Cases by law and method: how many ran, were stable, failed."""
    rows = table.to_pylist()
    shown = Table(title=f"{len(in_order(rows, 'case'))} cases")
    for name in ("method", "law", "cases", "stable rows", "rows", "failed"):
        shown.add_column(name, justify="left" if name in ("method", "law") else "right")
    for method, law in dict.fromkeys((row["method"], row["law"]) for row in rows):
        own = [row for row in rows if (row["method"], row["law"]) == (method, law)]
        wrong = [row for row in own if row["error_type"]]
        counts = (
            len(in_order(own, "case")),
            sum(row["stable"] for row in own),
            len(own) - len(wrong),
            len(wrong),
        )
        shown.add_row(method, law, *(str(count) for count in counts))
    return shown
