"""Tables, figures and files of studies, of failures and of certificates."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.figure import Figure

from cmf_mj.analysis.measures import Measures
from cmf_mj.core import units
from cmf_mj.core.result import Result, Table, column, groups, number, where
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show import look
from cmf_mj.show.comparison import phase_text
from cmf_mj.studies.certificate import Certificate
from cmf_mj.studies.effects import Rate, finished, largest_crosstalk, rates, rung_effects
from cmf_mj.studies.evaluation import MEASURED
from cmf_mj.studies.failure import FailureResult
from cmf_mj.studies.settings import NOMINAL

_MEASURES = (
    ("phase_bandwidth_hz", "-90 deg [Hz]"),
    ("peak_gain_db", "peak [dB]"),
    ("damping_ratio", "damping ratio"),
    ("crosstalk", "largest crosstalk"),
)


def rate_figure(found: Result[Rate]) -> Figure:
    """Shares of stable and of damped machines [%], laws down, a panel a cab."""
    cabs, laws = (found.frame[name].unique().to_pylist() for name in ("cab", "law"))
    figure = look.new_figure(3.3 * len(cabs) + 1.8, 0.33 * len(laws) + 1.4, gridded=False)
    axes = figure.subplots(1, len(cabs), sharey=True, squeeze=False)[0]
    by_case = {(r.cab, r.law): [100.0 * one.value for one in r.shares.values()] for r in found}
    for cab, axis in zip(cabs, axes, strict=True):
        shares = np.array([by_case[cab, law] for law in laws])
        axis.imshow(shares, cmap="cividis", vmin=0.0, vmax=100.0, aspect="auto")
        for (row, place), share in np.ndenumerate(shares):
            colour = "white" if share < 50.0 else "black"
            middle: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8}
            axis.text(place, row, number(share, ".0f"), color=colour, **middle)
        axis.set_xticks(range(1 + len(DOFS)), ["stable", *DOFS], rotation=45)
        axis.set_yticks(range(len(laws)), laws)
        axis.set(title=cab.upper(), xlabel="stable; damped in")
    figure.suptitle("Share of machines that a law leaves stable, and damped by 0.3 or more [%]")
    return figure


def measure_table(table: pa.Table) -> Table:
    """Measures of every case that was swept, a column a rung or cab."""
    done = finished(table)
    columns = [values for values, _ in groups(done, "rung", "cab")]
    several = len({cab for _, cab in columns}) > 1
    header = ["law", "dof", *(cab if several else rung for rung, cab in columns)]
    lines = []
    for axis, rows in groups(done, "law", "dof"):
        cells = {(row["rung"], row["cab"]): _cell(row) for row in rows.to_pylist()}
        lines.append([*axis, *(cells.get(each, "") for each in columns)])
    return Table("", header, lines)


def _cell(row: Mapping[str, Any]) -> str:
    if not row["stable"]:
        return "u"
    measures = Measures(**{name: row[name] for name in MEASURED})
    peak, damping = number(measures.peak_gain_db, ".1f"), number(measures.damping_ratio, ".2f")
    return f"{phase_text(measures)} / {peak} / {damping}"


def climb_table(table: pa.Table) -> Table:
    """Share of each effect: median change over the laws, a row a rung."""
    changes = rung_effects(table)
    measures, rows = changes.fields[2:], dict[str, list[str]]()
    for row in changes:
        text = " / ".join(field.text(field.value(row)) for field in measures)
        rows.setdefault(row["rung"], [row["rung"]]).append(text)
    return Table("", ("adds", *dict.fromkeys(row["dof"] for row in changes)), list(rows.values()))


def ladder_figure(table: pa.Table) -> Figure:
    """The climb: measures down, degrees of freedom across, a line a law.

    Crosses at the foot are unstable.
    """
    done = finished(table)
    rungs, laws, dofs = (done[name].unique().to_pylist() for name in ("rung", "law", "dof"))
    figure = look.new_figure(2.6 * len(dofs) + 0.6, 10.5)
    axes = figure.subplots(len(_MEASURES), len(dofs), sharex=True, sharey="row", squeeze=False)
    for (name, title), line in zip(_MEASURES, axes, strict=True):
        for dof, axis in zip(dofs, line, strict=True):
            for i, law in enumerate(laws):
                cases = where(done, law=law, dof=dof)
                at = [rungs.index(rung) for rung in cases["rung"].to_pylist()]
                values = np.full(len(rungs), np.nan)
                mixed = name == "crosstalk"
                values[at] = largest_crosstalk(cases, dof) if mixed else column(cases, name)
                style: dict[str, Any] = {
                    "color": look.COLOURS[i % len(look.COLOURS)],
                    "linestyle": "-" if i < len(look.COLOURS) else "--",
                }
                axis.plot(values, marker="o", markersize=3.0, linewidth=1.0, label=law, **style)
                unstable = np.array(at)[~np.array(cases["stable"])]
                style["linestyle"] = ""
                foot = axis.get_xaxis_transform()
                style |= {"marker": "x", "markersize": 7.0, "transform": foot}
                axis.plot(unstable, np.full(len(unstable), 0.03), **style)
            if name == "crosstalk":
                axis.set_yscale("log")
                axis.set_xticks(range(len(rungs)), rungs, rotation=90)
                axis.set_xlabel("with all effects before")
        line[0].set_ylabel(title)
    for dof, axis in zip(dofs, axes[0], strict=True):
        axis.set_title(dof)
    look.legend(figure)
    figure.suptitle("Bandwidth, peak, damping and crosstalk as one effect after another is added")
    return figure


def tables_of(table: pa.Table) -> dict[str, Table]:
    """The tables a study has something for, by the name of their file."""
    done, tables = finished(table), dict[str, Table]()
    methods = set(done["method"].to_pylist())
    if "sweep" in methods:
        tables["measures"] = measure_table(table)
    if len(done["rung"].unique()) > 1:
        tables["effects"] = climb_table(table)
    if "linear" in methods and any(draw != NOMINAL for draw in done["draw"].to_pylist()):
        tables["rates"] = rates(table).table
    return tables


def save_report(table: pa.Table, folder: Path) -> list[Path]:
    """Write every table as Markdown and CSV, of a ladder `ladder.png`, of shares `rates.png`."""
    files: dict[str, Any] = {
        f"{name}.{kind}": each for name, each in tables_of(table).items() for kind in ("md", "csv")
    }
    if "effects.md" in files:
        files["ladder.png"] = ladder_figure(table)
    if "rates.md" in files:
        files["rates.png"] = rate_figure(rates(table))
    return look.save_files(files, folder, 80)


def summary_table(table: pa.Table) -> Table:
    """Cases by law and method: how many ran, were stable, failed; the least -90 deg."""
    lines = []
    for names, rows in groups(table, "method", "law"):
        stable, done = sum(rows["stable"].to_pylist()), finished(rows).num_rows
        cases = len(rows["case"].unique())
        least = pc.min(rows["phase_bandwidth_hz"]).as_py()
        lines.append((*names, cases, stable, done, rows.num_rows - done, least))
    counts = [(name, "d") for name in ("cases", "stable rows", "rows", "failed")]
    header = ("method", "law", *counts, ("least -90 deg [Hz]", ".2f"))
    return Table(f"{len(table['case'].unique())} cases", header, lines)


def save_failures(results: Result[FailureResult], folder: Path) -> list[Path]:
    """Write `failures.csv`, `failures.md` and a figure an event."""
    files = {"failures.csv": results, "failures.md": results}
    figures = {f"{result.label}.png": failure_figure(result) for result in results}
    return look.save_files(files | figures, folder)


def failure_figure(result: FailureResult) -> Figure:
    """Extensions, axial loads, crew acceleration and pressures, with event and detection."""
    record = result.record
    time = record.time - result.event.at
    labels = ("extension [in]", "axial leg load [kN]", "crew acceleration [g]", "pressure [psi]")
    figure, axes = look.stack(9.0, 11.0, *labels, x="time after the event [s]")
    legs, loads, crew, pressures = axes
    legs.plot(time, record["leg_reference"] / units.INCH, linewidth=0.6, alpha=0.5)
    numbers = [f"leg {leg}" for leg in range(1, 7)]
    legs.set_prop_cycle(color=look.COLOURS)
    legs.plot(time, record["leg_extension"] / units.INCH, label=numbers)
    loads.plot(time, 1e-3 * record["axial_load"])
    felt = record["crew_acceleration"] / units.STANDARD_GRAVITY
    crew.plot(time, felt, linewidth=0.8, label=["x", "y", "z"])
    crew.plot(time, np.linalg.norm(felt, axis=1), color=look.DARK, linewidth=0.8, label="size")
    for side in ("cap", "rod"):
        values = record[f"{side}_pressure"] / units.PSI
        for name, extreme in (("largest", values.max(axis=1)), ("least", values.min(axis=1))):
            pressures.plot(time, extreme, label=f"{name} {side}", linewidth=0.9)
    pressures.plot(time, record["supply_pressure"] / units.PSI, label="supply", linewidth=0.9)
    about, state = record.metadata, result.state.replace("_", " ")
    legs.set(
        title=f"Legs, crew and pressures after {result.label.replace('-', ' ')}: {state}\n"
        f"{about['law']} in {result.dof}, "
        f"{about['cab']}, {about['hydraulics']}, {result.setting}",
        xlim=(max(time[0], -4.0), time[-1]),
    )
    for axis in axes:
        axis.axvline(0.0, color=look.ORANGE, linestyle="--", linewidth=1.0, label="event")
        if (at := result.detection_time) is not None:
            axis.axvline(at, color=look.PURPLE, linestyle=":", linewidth=1.4, label="detected")
    look.legend(legs, crew, pressures)
    return figure


def certificate_figure(certificates: Sequence[Certificate]) -> Figure:
    """Boxes of all laws: what is proven, what is not known, and where machines fail."""
    figure = look.new_figure(7.0, 1.2 + 0.32 * len(certificates))
    axes = figure.add_subplot()
    proven, broken = np.array([(one.proven, one.broken) for one in certificates]).T
    most = 1.15 * float(np.nanmax([*proven, *broken, 1.0]))
    ends = np.array([0.0 * proven, proven, np.where(np.isnan(broken), most, broken)])
    widths, place = np.diff(ends, axis=0, append=most), np.arange(len(certificates))
    colours = look.GREEN, look.PALE, look.ORANGE
    labels = "proven stable", "neither", "machines fail"
    for left, wide, colour, label in zip(ends, widths, colours, labels, strict=True):
        axes.barh(place, wide, left=left, color=colour, label=label)
    axes.axvline(1.0, color=look.DARK, linestyle="--")
    axes.set(xlim=(0.0, most), xlabel="scale of the unit box")
    axes.set_yticks(place, [f"{one.law}, {one.cab}" for one in certificates])
    axes.invert_yaxis()
    axes.set_title("Boxes of machines that are proven stable")
    look.legend(figure)
    return figure
