"""Tables and figures of finished studies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from cmf_mj.analysis.measures import Measures
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show.comparison import phase_text
from cmf_mj.show.look import COLOURS, new_figure, save_files
from cmf_mj.show.table import Table, number
from cmf_mj.studies.effects import (
    Interval,
    Row,
    agreement,
    climb,
    in_order,
    largest_crosstalk,
    rates,
    rows_of,
)
from cmf_mj.studies.evaluation import MEASURED
from cmf_mj.studies.settings import NOMINAL

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


def rate_table(table: pa.Table) -> Table:
    """Shares of machines that are stable, and damped in each degree of freedom [%]."""
    names = ("cab", "law", "stable %", *(f"{dof} damped %" for dof in DOFS))
    rows = [(cab, law, *map(_percent, shares), least) for cab, law, shares, least in rates(table)]
    return Table("", (*names, ("least mode damping", ".3f")), rows)


def rate_figure(found: Sequence[tuple[str, str, list[Interval], float]]) -> Figure:
    """Shares of stable and of damped machines [%], laws down, a panel a cab."""
    cabs, laws = (list(dict.fromkeys(names)) for names in list(zip(*found, strict=True))[:2])
    figure = new_figure(3.3 * len(cabs) + 1.8, 0.33 * len(laws) + 1.4, gridded=False)
    axes = figure.subplots(1, len(cabs), sharey=True, squeeze=False)[0]
    by_case = {(cab, law): [100.0 * one.value for one in ones] for cab, law, ones, _ in found}
    for cab, axis in zip(cabs, axes, strict=True):
        shares = np.array([by_case[cab, law] for law in laws])
        axis.imshow(shares, cmap="cividis", vmin=0.0, vmax=100.0, aspect="auto")
        for (row, column), share in np.ndenumerate(shares):
            colour = "white" if share < 50.0 else "black"
            middle: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8}
            axis.text(column, row, number(share, ".0f"), color=colour, **middle)
        axis.set_xticks(range(1 + len(DOFS)), ["stable", *DOFS], rotation=45, fontsize=8)
        axis.set_yticks(range(len(laws)), laws, fontsize=8)
        axis.set(title=cab.upper(), xlabel="stable; damped in")
    figure.suptitle("Share of machines that a law leaves stable, and damped by 0.3 or more [%]")
    return figure


def agreement_table(table: pa.Table) -> Table:
    """Linear cases compared with simulated ones."""
    columns = (
        *("law", ("machines", "d"), ("same verdict", "d")),
        *(("-90 deg: median difference [Hz]", ".2f"), ("zeta", ".2f")),
    )
    return Table("", columns, agreement(table))


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
    if not row["stable"]:
        return "u"
    measures = Measures(**{name: row[name] for name in MEASURED})
    peak, damping = number(measures.peak_gain_db, ".1f"), number(measures.damping_ratio, ".2f")
    return f"{phase_text(measures)} / {peak} / {damping}"


def climb_table(table: pa.Table) -> Table:
    """Share of each effect: median change over the laws, a row a rung."""
    rows: dict[str, list[str]] = {}
    for (rung, _), changes in climb(table).items():
        text = " / ".join(map(number, changes, ("+.2f", "+.1f", "+.2f", "+.2f")))
        rows.setdefault(rung, [rung]).append(text)
    return Table("", ("adds", *in_order(rows_of(table), "dof")), list(rows.values()))


def _value(row: Row | None, name: str) -> float:
    if row is None:
        return float("nan")
    return largest_crosstalk(row) if name == "crosstalk" else float(row[name])


def ladder_figure(table: pa.Table) -> Figure:
    """The climb: measures down, degrees of freedom across, a line a law.

    Crosses at the foot are unstable.
    """
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
                foot = axis.get_xaxis_transform()
                style |= {"marker": "x", "markersize": 7.0, "transform": foot}
                axis.plot(unstable, np.full(len(unstable), 0.03), **style)
            if name == "crosstalk":
                axis.set_yscale("log")
                axis.set_xticks(range(len(rungs)), rungs, rotation=90, fontsize=8)
        line[0].set_ylabel(title)
    for dof, axis in zip(dofs, axes[0], strict=True):
        axis.set_title(dof)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle("Bandwidth, peak, damping and crosstalk as one effect after another is added")
    return figure


def tables_of(table: pa.Table) -> dict[str, Table]:
    """The tables a study has something for, by the name of their file."""
    rows = rows_of(table)
    methods = in_order(rows, "method")
    tables: dict[str, Table] = {}
    if "sweep" in methods:
        tables["measures"] = measure_table(table)
    if len(in_order(rows, "rung")) > 1:
        tables["effects"] = climb_table(table)
    if "linear" in methods and any(row["draw"] != NOMINAL for row in rows):
        tables["rates"] = rate_table(table)
    if "linear" in methods and "matrix" in methods:
        tables["agreement"] = agreement_table(table)
    return tables


def save_report(table: pa.Table, folder: Path) -> list[Path]:
    """Write every table as Markdown and CSV, of a ladder `ladder.png`, of shares `rates.png`."""
    files: dict[str, Any] = {
        f"{name}.{kind}": each.save
        for name, each in tables_of(table).items()
        for kind in ("md", "csv")
    }
    if "effects.md" in files:
        files["ladder.png"] = ladder_figure(table)
    if "rates.md" in files:
        files["rates.png"] = rate_figure(rates(table))
    return save_files(files, folder, 80)


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
