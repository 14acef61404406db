"""Tables, figures and files of comparisons and studies, of failures and of certificates."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.figure import Figure

from cmf_mj.analysis.measurable import CLEAR, dof_history
from cmf_mj.analysis.measures import Measures
from cmf_mj.core import units
from cmf_mj.core.errors import NoPoseError
from cmf_mj.core.result import Cell, Column, Result, Table, column, groups, number, where
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.plant.hexapod import PLANTS
from cmf_mj.show import look
from cmf_mj.signals.single import Step
from cmf_mj.studies.case import CaseResult, dof_amplitude
from cmf_mj.studies.certificate import Certificate
from cmf_mj.studies.comparison import PUBLISHED
from cmf_mj.studies.effects import Rate, agreement, climb, finished, largest_crosstalk, rates
from cmf_mj.studies.evaluation import MEASURED
from cmf_mj.studies.failure import FailureResult
from cmf_mj.studies.settings import NOMINAL

AGREEMENT = 0.1  #: Distance of two readings of -90 deg from which on a table shows both [Hz].

_LINES = {"hexapod": "-", "single_legs": "--"}

_LEGEND = (
    "-90, -3 dB: bandwidths in Hz, from the legs' demand to their feedback in the control law, "
    "-3 dB from absolute 0 dB (of small motion it may be far higher: `cmf linearize`); peak in dB; "
    "at rest: gain; zeta: damping ratio from the step's overshoot, 0 where it is more than the "
    "step. -: the sweep, to 10 Hz, does not reach it, or no overshoot. unstable: legs ring on "
    "undiminished 12 s after the step; drifts: the law holds no position, so legs move on to a "
    "stop. Neither has other measures. "
)
_MARKS = {
    "~": "~: the phase grazes -90 deg. ",
    "/": "a/b: the phase falls through -90 deg at a and, having come back, at b. ",
    "[": "[c]: -90 deg of small motion, on the linearised machine, as `cmf tune` and `cmf "
    f"linearize` have it, where that is more than {AGREEMENT:g} Hz off. ",
}
_PUBLISHED = (
    "Published: h measured on the hardware, m from the report's non-linear model of six single "
    "legs."
)


def phase_text(measures: Measures, small_motion_hz: float = float("nan")) -> str:
    """-90 deg [Hz] as in tables: `~` where the phase grazes it, a later fall, small motion.

    >>> phase_text(Measures(3.16, later_phase_hz=3.52), 3.3), phase_text(Measures())
    ('3.16/3.52 [3.30]', '-')
    """
    first, later = measures.phase_bandwidth_hz, measures.later_phase_hz
    graze = "~" if later != later and measures.graze_from_hz == measures.graze_from_hz else ""
    text = f"{graze}{number(first, '.2f')}"
    if later == later:
        text += f"/{later:.2f}"
    apart = min(abs(small_motion_hz - at) if at == at else np.inf for at in (first, later))
    return f"{text} [{small_motion_hz:.2f}]" if AGREEMENT < apart < np.inf else text


def comparison_table(results: Sequence[CaseResult]) -> Table:
    """The comparison: a row per law and degree of freedom, next to what is published."""
    first, plants = results[0].case, list(dict.fromkeys(r.case.plant for r in results))
    cab = next((result.case.cab_name for result in results if result.case.cab), "")
    columns: list[Column] = ["law", "dof"]
    printed = any(result.published for result in results)
    for name in [*plants, *(["published"] if printed else [])]:
        columns += [(f"{name.replace('_', ' ')}\n-90", ".2f"), ("\n-3 dB", ".2f")]
        columns += [] if name == "published" else [("\npeak", ".1f"), ("\nat rest", ".3f")]
        columns += [("\nzeta", ".2f")]
    by_case = {(r.case.law.name, r.case.dof, r.case.plant): r for r in results}
    cells = []
    for law, dof in dict.fromkeys(key[:2] for key in by_case):
        line: list[Cell] = [law, dof]
        for plant in plants:
            result = by_case[law, dof, plant]
            measures = result.measures
            line += [phase_text(measures, result.small_motion_phase_hz), *measures[1:3]]
            line.append(measures.static_gain)
            line.append(result.verdict or measures.damping_ratio)
        row = by_case[law, dof, plants[0]].published
        if printed:
            line += [getattr(row, name, None) for name in PUBLISHED]
            line.append({"hardware": "h", "nonlinear": "m"}.get(row.of, "") if row else "")
        cells.append(line)
    length = first.size / dof_amplitude(first.dof, 1.0)
    inches = units.from_si("in", length)
    degrees = units.from_si("deg", dof_amplitude("roll", length))
    title = f"hydraulics: {first.hydraulics.name}" + (f", cab: {cab}" if cab else "")
    title += f"; simulated sweeps of {inches:.3g} in, {degrees:.3g} deg"
    said = " ".join(cell for line in cells for cell in line[2:] if isinstance(cell, str))
    legend = _LEGEND + "".join(text for mark, text in _MARKS.items() if mark in said)
    if printed:
        columns, legend = [*columns, ("\nof", "")], legend + _PUBLISHED
    return Table(title, columns, cells, legend, grouped=True)


def _colours(results: Sequence[CaseResult]) -> dict[str, str]:
    laws = dict.fromkeys(result.case.law.name for result in results)
    return {law: look.COLOURS[i % len(look.COLOURS)] for i, law in enumerate(laws)}


def _style(result: CaseResult, colours: Mapping[str, str]) -> dict[str, Any]:
    """Laws by colour, plants by line."""
    case, verdict = result.case, result.verdict
    label = f"{case.law.name}, {case.plant.replace('_', ' ')}{verdict and f', {verdict}'}"
    return {"color": colours[case.law.name], "linestyle": _LINES[case.plant], "label": label}


def _title(quantity: str, dof: str, size: float, results: Sequence[CaseResult]) -> str:
    cab = next((r.case.cab_name.upper() for r in results if r.case.cab), "")
    of = f"{quantity} in {dof}, {units.from_si(dof_unit(dof), size):.3g} {dof_unit(dof)}"
    hydraulics = results[0].case.hydraulics.name
    return f"{of}, {hydraulics} hydraulics" + (f", {cab}" if cab else "")


def responses_figure(results: Sequence[CaseResult]) -> Figure:
    """Gain and phase of all cases of one degree of freedom, published bandwidths as circles."""
    first, colours = results[0].case, _colours(results)
    title = _title("Frequency response", first.dof, first.size, results)
    figure, gain, phase = look.bode_axes(title, limits=True)
    for result in results:
        style, printed = _style(result, colours), result.published
        if result.response is not None:
            look.plot_bode(gain, phase, result.response, stable=result.measures.stable, **style)
        if printed is not None:
            look.plot_printed(gain, phase, printed, style["color"])
    gain.set(ylim=(-20.0, 20.0))
    phase.set(ylim=(-270.0, 30.0), xlim=(0.1, 10.0))
    note = f"circles: published; pale: coherence below {CLEAR:g}, or unstable"
    look.legend(figure, title=note, title_fontsize=8)
    return figure


def step_figure(results: Sequence[CaseResult]) -> Figure:
    """Step responses of one degree of freedom, and what the law asked of the first leg's valve."""
    dof = results[0].case.dof
    unit, colours = dof_unit(dof), _colours(results)
    labels, under = (f"{dof} [{unit}]", "valve 1 [%]"), "time after the step [s]"
    figure, (response, command) = look.stack(8.0, 7.0, *labels, x=under, ratios=(2, 1))
    reference = results[0].step
    demanded = units.from_si(unit, dof_history(reference, "leg_reference", dof))
    begin, step = reference.signal_as(Step).at, reference.signal_as(Step).size
    response.plot(reference.time - begin, demanded, color=look.GREY, linewidth=1.0)
    low, high = -0.5 * demanded[-1], 2.0 * demanded[-1]
    for result in results:
        record, style = result.step, _style(result, colours)
        try:
            history = dof_history(record, "leg_position", dof)
        except NoPoseError:
            continue
        moved = units.from_si(unit, history)
        response.plot(record.time - begin, moved, **style)
        if result.measures.stable:
            low, high = min(low, 1.1 * moved.min()), max(high, 1.1 * moved.max())
        command.plot(record.time - begin, 100.0 * record["valve_command"][:, 0], **style)
    response.set(title=_title("Step response", dof, step, results), ylim=(low, high))
    command.set(xlim=(-0.2, 3.0), ylim=(-105, 105))
    late = any(one.verdict == "unstable" for one in results)
    look.legend(figure, title="unstable: legs ring on 12 s after the step" if late else None)
    return figure


_FIGURES = re.compile(rf"(bode|step)_({'|'.join(DOFS)})\.({'|'.join(look.FORMATS)})")
_RECORDS = re.compile(rf"({'|'.join(PLANTS)})-.+-({'|'.join(DOFS)})-(chirp|step)\.parquet")


def drop_comparison(folder: Path, comparison: Sequence[CaseResult], records: bool) -> int:
    """Remove what an earlier comparison left in a folder, and say how many files that were.

    Of files with the names it gives: `measures.md`, figures, and, but for those of this comparison
    if it keeps any, `records`. All others stay.
    """
    labels = [result.case.label for result in comparison] if records else []
    kept = {f"{label}-{kind}.parquet" for label in labels for kind in ("chirp", "step")}
    stale = [path for path in folder.glob("*") if _FIGURES.fullmatch(path.name)]
    stale += folder.glob("measures.md")
    for path in folder.glob("records/*"):
        if _RECORDS.fullmatch(path.name) and path.name not in kept:
            stale.append(path)
    for path in stale:
        path.unlink()
    if not records:
        with suppress(OSError):  # not there, or not empty
            (folder / "records").rmdir()
    return len(stale)


def save_comparison(comparison: Result[CaseResult], folder: Path) -> list[Path]:
    """Write `comparison.csv`, `comparison.md`, and `bode_<dof>.png` and `step_<dof>.png`."""
    table = comparison_table(comparison)
    files: dict[str, Any] = {"comparison.csv": comparison, "comparison.md": table}
    for dof in dict.fromkeys(result.case.dof for result in comparison):
        chosen = [result for result in comparison if result.case.dof == dof]
        files[f"bode_{dof}.png"] = responses_figure(chosen)
        files[f"step_{dof}.png"] = step_figure(chosen)
    return look.save_files(files, folder)


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
    changes = climb(table)
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
    if {"linear", "matrix"} <= methods:
        tables["agreement"] = agreement(table).table
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
