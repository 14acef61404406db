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
from cmf_mj.studies.evaluation import MEASURED
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
    axes = figure.subplots(1, len(cabs), sharey=True, squeeze=False)[0]
    by_case = {(rate.cab, rate.law): rate.shares.values() for rate in rates}
    for cab, axis in zip(cabs, axes, strict=True):
        percent = np.array([[100.0 * share.value for share in by_case[cab, law]] for law in laws])
        axis.imshow(percent, cmap="cividis", vmin=0.0, vmax=100.0, aspect="auto")
        for (row, place), value in np.ndenumerate(percent):
            colour = "white" if value < 50.0 else "black"
            style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8}
            axis.text(place, row, number(value, ".0f"), color=colour, **style)
        axis.set_xticks(range(1 + len(DOFS)), ["stable", *DOFS], rotation=45)
        axis.set_yticks(range(len(laws)), laws)
        axis.set(title=cab.upper(), xlabel="stable; damped in")
    figure.suptitle("Share of machines that a law leaves stable, and damped by 0.3 or more [%]")
    return figure


def measure_table(table: pa.Table) -> Table:
    """Measures of every case that was swept, a column a rung or cab."""
    done = finished(table)
    plants = [plant for plant, _ in groups(done, "rung", "cab")]
    has_several_cabs = len({cab for _, cab in plants}) > 1
    header = ["law", "dof", *(cab if has_several_cabs else rung for rung, cab in plants)]
    lines = []
    for (law, dof), rows in groups(done, "law", "dof"):
        cells = {(row["rung"], row["cab"]): _cell(row) for row in rows.to_pylist()}
        lines.append([law, dof, *(cells.get(plant, "") for plant in plants)])
    return Table("", header, lines)


def _cell(row: Mapping[str, Any]) -> str:
    """-90 deg, peak and damping ratio of a case, or `u` for unstable."""
    if not row["stable"]:
        return "u"
    measures = Measures(**{name: row[name] for name in MEASURED})
    peak, damping = number(measures.peak_gain_db, ".1f"), number(measures.damping_ratio, ".2f")
    return f"{phase_text(measures)} / {peak} / {damping}"


def climb_table(table: pa.Table) -> Table:
    """Share of each effect: median change over the laws, a row a rung."""
    changes = rung_effects(table)
    measures = [field for field in changes.fields if field.name not in ("rung", "dof")]
    rows = dict[str, list[str]]()
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
    panels = figure.subplots(len(_MEASURES), len(dofs), sharex=True, sharey="row", squeeze=False)
    for (name, title), panels_of_measure in zip(_MEASURES, panels, strict=True):
        for dof, axis in zip(dofs, panels_of_measure, strict=True):
            for law, colour in zip(laws, cycle(look.COLOURS), strict=False):
                cases = where(done, law=law, dof=dof)
                is_crosstalk = name == "crosstalk"
                values = largest_crosstalk(cases, dof) if is_crosstalk else column(cases, name)
                line = "-" if law in laws[: len(look.COLOURS)] else "--"
                style: dict[str, Any] = {"label": law, "color": colour, "linestyle": line}
                _plot_climb(axis, cases, rungs, values, style)
            if name == "crosstalk":
                axis.set_yscale("log")
                axis.set_xticks(range(len(rungs)), rungs, rotation=90)
                axis.set_xlabel("with all effects before")
        panels_of_measure[0].set_ylabel(title)
    for dof, axis in zip(dofs, panels[0], strict=True):
        axis.set_title(dof)
    look.legend(figure)
    figure.suptitle("Bandwidth, peak, damping and crosstalk as one effect after another is added")
    return figure


def _plot_climb(
    axis: Axes, cases: pa.Table, rungs: Sequence[str], values: Array, style: Mapping[str, Any]
) -> None:
    """Draw the values of a law's cases over their rungs; crosses at the foot are unstable."""
    places = np.array([rungs.index(rung) for rung in cases["rung"].to_pylist()], dtype=int)
    by_rung = np.full(len(rungs), np.nan)
    by_rung[places] = values
    axis.plot(by_rung, marker="o", markersize=3.0, linewidth=1.0, **style)
    unstable = places[~np.array(cases["stable"])]
    crosses: dict[str, Any] = {"linestyle": "", "marker": "x", "markersize": 7.0}
    foot = axis.get_xaxis_transform()
    heights = np.full(len(unstable), 0.03)
    axis.plot(unstable, heights, color=style["color"], transform=foot, **crosses)


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
        f"{name}.{kind}": result
        for name, result in tables_of(table).items()
        for kind in ("md", "csv")
    }
    if "effects.md" in files:
        files["ladder.png"] = ladder_figure(table)
    if "rates.md" in files:
        files["rates.png"] = rate_figure(rates(table))
    return look.save_files(files, folder, 80)


def summary_table(table: pa.Table) -> Table:
    """Cases by law and method: how many ran, were stable, failed; the least -90 deg."""
    lines = []
    for (method, law), rows in groups(table, "method", "law"):
        stable, done = sum(rows["stable"].to_pylist()), finished(rows).num_rows
        cases = len(rows["case"].unique())
        least = pc.min(rows["phase_bandwidth_hz"]).as_py()
        lines.append((method, law, cases, stable, done, rows.num_rows - done, least))
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
    event, state = result.label.replace("-", " "), result.state.replace("_", " ")
    law, cab, hydraulics = (record.metadata[key] for key in ("law", "cab", "hydraulics"))
    case = f"{law} in {result.dof}, {cab}, {hydraulics}, {result.setting}"
    title = f"Legs, crew and pressures after {event}: {state}\n{case}"
    legs.set(title=title, xlim=(max(time[0], -4.0), time[-1]))
    for axis in axes:
        axis.axvline(0.0, color=look.ORANGE, linestyle="--", linewidth=1.0, label="event")
        if result.detection_time is not None:
            style: dict[str, Any] = {"color": look.PURPLE, "linestyle": ":", "linewidth": 1.4}
            axis.axvline(result.detection_time, label="detected", **style)
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
