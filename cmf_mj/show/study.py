"""Tables, figures and files of studies, of failures and of certificates."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.analysis.measures import Measures
from cmf_mj.core import units
from cmf_mj.core.result import Result, Table, column, groups, number, where
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show import look
from cmf_mj.show.comparison import phase_text
from cmf_mj.studies.certificate import Certificate
from cmf_mj.studies.effects import Rate, finished, largest_crosstalk, rates, rung_effects
from cmf_mj.studies.evaluation import MEASURE_NAMES
from cmf_mj.studies.failure import FailureResult
from cmf_mj.studies.settings import NOMINAL

Array = NDArray[np.float64]

_MEASURES = (
    ("phase_bandwidth_hz", "-90 deg [Hz]"),
    ("peak_gain_db", "peak [dB]"),
    ("damping_ratio", "damping ratio"),
    ("crosstalk", "largest crosstalk"),
)


def rate_figure(rates: Result[Rate]) -> Figure:
    """Shares of stable and of damped machines [%], laws down, a panel a cab."""
    cabs, laws = (rates.frame[name].unique().to_pylist() for name in ("cab", "law"))
    figure = look.new_figure(3.3 * len(cabs) + 1.8, 0.33 * len(laws) + 1.4, gridded=False)
    (panels,) = figure.subplots(1, len(cabs), sharey=True, squeeze=False)
    shares = {(rate.cab, rate.law): rate.shares.values() for rate in rates}
    for cab, axes in zip(cabs, panels, strict=True):
        percent = np.array([[100.0 * share.value for share in shares[cab, law]] for law in laws])
        axes.imshow(percent, cmap="cividis", vmin=0.0, vmax=100.0, aspect="auto")
        for (row, column_index), value in np.ndenumerate(percent):
            colour = "white" if value < 50.0 else "black"
            style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8}
            axes.text(column_index, row, number(value, ".0f"), color=colour, **style)
        axes.set_xticks(range(1 + len(DOFS)), ["stable", *DOFS], rotation=45)
        axes.set_yticks(range(len(laws)), laws)
        axes.set(title=cab.upper(), xlabel="stable; damped in")
    figure.suptitle("Share of machines that a law leaves stable, and damped by 0.3 or more [%]")
    return figure


def measure_table(results: pa.Table) -> Table:
    """Measures of every case that was swept, a column a rung or cab."""
    done = finished(results)
    plants = [plant for plant, _ in groups(done, "rung", "cab")]
    has_several_cabs = len({cab for _, cab in plants}) > 1
    header = ["law", "dof", *(cab if has_several_cabs else rung for rung, cab in plants)]
    table_rows = []
    for (law, dof), rows in groups(done, "law", "dof"):
        cells = {(row["rung"], row["cab"]): _cell(row) for row in rows.to_pylist()}
        table_rows.append([law, dof, *(cells.get(plant, "") for plant in plants)])
    return Table("", header, table_rows)


def _cell(row: Mapping[str, Any]) -> str:
    """-90 deg, peak and damping ratio of a case, or `u` for unstable."""
    if not row["stable"]:
        return "u"
    measures = Measures(**{name: row[name] for name in MEASURE_NAMES})
    peak, damping = number(measures.peak_gain_db, ".1f"), number(measures.damping_ratio, ".2f")
    return f"{phase_text(measures)} / {peak} / {damping}"


def effect_table(results: pa.Table) -> Table:
    """What each effect changes, medians over the laws: rungs down, degrees of freedom across."""
    changes = rung_effects(results)
    measures = [field for field in changes.fields if field.name not in ("rung", "dof")]
    row_by_rung = dict[str, list[str]]()
    for change in changes:
        text = " / ".join(field.text(field.value(change)) for field in measures)
        row_by_rung.setdefault(change["rung"], [change["rung"]]).append(text)
    dofs = dict.fromkeys(change["dof"] for change in changes)
    return Table("", ("adds", *dofs), list(row_by_rung.values()))


def ladder_figure(results: pa.Table) -> Figure:
    """Measures over the rungs: measures down, degrees of freedom across, a line a law.

    Crosses at the foot are unstable.
    """
    done = finished(results)
    rungs, laws, dofs = (done[name].unique().to_pylist() for name in ("rung", "law", "dof"))
    figure = look.new_figure(2.6 * len(dofs) + 0.6, 10.5)
    panels = figure.subplots(len(_MEASURES), len(dofs), sharex=True, sharey="row", squeeze=False)
    for (name, title), panels_of_measure in zip(_MEASURES, panels, strict=True):
        for dof, axes in zip(dofs, panels_of_measure, strict=True):
            for law, colour in zip(laws, cycle(look.COLOURS), strict=False):
                cases = where(done, law=law, dof=dof)
                is_crosstalk = name == "crosstalk"
                values = largest_crosstalk(cases, dof) if is_crosstalk else column(cases, name)
                line = "-" if law in laws[: len(look.COLOURS)] else "--"
                style: dict[str, Any] = {"label": law, "color": colour, "linestyle": line}
                _plot_over_rungs(axes, cases, rungs, values, style)
            if name == "crosstalk":
                axes.set_yscale("log")
                axes.set_xticks(range(len(rungs)), rungs, rotation=90)
                axes.set_xlabel("with all effects before")
        panels_of_measure[0].set_ylabel(title)
    for dof, axes in zip(dofs, panels[0], strict=True):
        axes.set_title(dof)
    look.legend(figure)
    figure.suptitle("Bandwidth, peak, damping and crosstalk as one effect after another is added")
    return figure


def _plot_over_rungs(
    axes: Axes, cases: pa.Table, rungs: Sequence[str], values: Array, style: Mapping[str, Any]
) -> None:
    """Draw the values of a law's cases over their rungs; crosses at the foot are unstable."""
    indices = np.array([rungs.index(rung) for rung in cases["rung"].to_pylist()], dtype=int)
    value_by_rung = np.full(len(rungs), np.nan)
    value_by_rung[indices] = values
    axes.plot(value_by_rung, marker="o", markersize=3.0, linewidth=1.0, **style)
    unstable = indices[~np.array(cases["stable"])]
    crosses: dict[str, Any] = {"linestyle": "", "marker": "x", "markersize": 7.0}
    foot = axes.get_xaxis_transform()
    heights = np.full(len(unstable), 0.03)
    axes.plot(unstable, heights, color=style["color"], transform=foot, **crosses)


def tables_of(results: pa.Table) -> dict[str, Table]:
    """The tables that the results of a study fill, by the name of their file."""
    done, tables = finished(results), dict[str, Table]()
    methods = set(done["method"].to_pylist())
    if "sweep" in methods:
        tables["measures"] = measure_table(results)
    if len(done["rung"].unique()) > 1:
        tables["effects"] = effect_table(results)
    if "linear" in methods and any(draw != NOMINAL for draw in done["draw"].to_pylist()):
        tables["rates"] = rates(results).table
    return tables


def save_report(results: pa.Table, folder: Path) -> list[Path]:
    """Write every table as Markdown and CSV, of a ladder `ladder.png`, of shares `rates.png`."""
    files: dict[str, Any] = {
        f"{name}.{kind}": table
        for name, table in tables_of(results).items()
        for kind in ("md", "csv")
    }
    if "effects.md" in files:
        files["ladder.png"] = ladder_figure(results)
    if "rates.md" in files:
        files["rates.png"] = rate_figure(rates(results))
    return look.save_files(files, folder, 80)


def summary_table(results: pa.Table) -> Table:
    """Cases by law and method: how many ran, were stable, failed; the least -90 deg."""
    table_rows = []
    for (method, law), rows in groups(results, "method", "law"):
        stable, done = sum(rows["stable"].to_pylist()), finished(rows).num_rows
        cases = len(rows["case"].unique())
        least = pc.min(rows["phase_bandwidth_hz"]).as_py()
        table_rows.append((method, law, cases, stable, done, rows.num_rows - done, least))
    counts = [(name, "d") for name in ("cases", "stable rows", "rows", "failed")]
    header = ("method", "law", *counts, ("least -90 deg [Hz]", ".2f"))
    return Table(f"{len(results['case'].unique())} cases", header, table_rows)


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
    figure, panels = look.stack(9.0, 11.0, *labels, x="time after the event [s]")
    legs, loads, crew, pressures = panels
    legs.plot(time, record["leg_reference"] / units.INCH, linewidth=0.6, alpha=0.5)
    leg_names = [f"leg {leg}" for leg in range(1, 7)]
    legs.set_prop_cycle(color=look.COLOURS)
    legs.plot(time, record["leg_extension"] / units.INCH, label=leg_names)
    loads.plot(time, 1e-3 * record["axial_load"])
    acceleration = record["crew_acceleration"] / units.STANDARD_GRAVITY
    crew.plot(time, acceleration, linewidth=0.8, label=["x", "y", "z"])
    crew.plot(
        time, np.linalg.norm(acceleration, axis=1), color=look.DARK, linewidth=0.8, label="size"
    )
    for side in ("cap", "rod"):
        values = record[f"{side}_pressure"] / units.PSI
        for name, extreme in (("largest", values.max(axis=1)), ("least", values.min(axis=1))):
            pressures.plot(time, extreme, label=f"{name} {side}", linewidth=0.9)
    pressures.plot(time, record["supply_pressure"] / units.PSI, label="supply", linewidth=0.9)
    event, state = result.label.replace("-", " "), result.state.replace("_", " ")
    law, cab, hydraulics = (record.metadata[key] for key in ("law", "cab", "hydraulics"))
    case = f"{law} in {result.dof}, {cab}, {hydraulics}, {result.setting}"
    title = f"Legs, crew and pressures after {event}: {state}\n{case}"
    legs.set(title=title, xlim=(max(time[0], -4.0), time[-1]))
    for axes in panels:
        axes.axvline(0.0, color=look.ORANGE, linestyle="--", linewidth=1.0, label="event")
        if result.detection_time is not None:
            style: dict[str, Any] = {"color": look.PURPLE, "linestyle": ":", "linewidth": 1.4}
            axes.axvline(result.detection_time, label="detected", **style)
    look.legend(legs, crew, pressures)
    return figure


def certificate_figure(certificates: Sequence[Certificate]) -> Figure:
    """Boxes of all laws: what is proven, what is not known, and where machines fail."""
    figure = look.new_figure(7.0, 1.2 + 0.32 * len(certificates))
    axes = figure.add_subplot()
    proven = np.array([certificate.proven_scale for certificate in certificates])
    broken = np.array([certificate.breaking_scale for certificate in certificates])
    right = 1.15 * float(np.nanmax([*proven, *broken, 1.0]))
    failing = np.where(np.isnan(broken), right, broken)
    rows = np.arange(len(certificates))
    axes.barh(rows, proven, left=0.0 * proven, color=look.GREEN, label="proven stable")
    axes.barh(rows, failing - proven, left=proven, color=look.PALE, label="neither")
    axes.barh(rows, right - failing, left=failing, color=look.ORANGE, label="machines fail")
    axes.axvline(1.0, color=look.DARK, linestyle="--")
    axes.set(xlim=(0.0, right), xlabel="scale of the unit box")
    axes.set_yticks(rows, [f"{certificate.law}, {certificate.cab}" for certificate in certificates])
    axes.invert_yaxis()
    axes.set_title("Boxes of machines that are proven stable")
    look.legend(figure)
    return figure
