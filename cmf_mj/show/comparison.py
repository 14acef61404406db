"""Tables, figures and files of comparisons of laws."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.measurable import LEAST_COHERENCE, dof_history
from cmf_mj.analysis.measures import Measures
from cmf_mj.core import units
from cmf_mj.core.errors import NoPoseError
from cmf_mj.core.result import Cell, Column, Result, Table, number
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.plant.hexapod import PLANTS
from cmf_mj.show import look
from cmf_mj.signals.single import Step
from cmf_mj.studies.case import REPORT_AMPLITUDES, CaseResult, dof_amplitude
from cmf_mj.studies.comparison import PUBLISHED_NAMES

AGREEMENT = 0.1  #: Distance of two readings of -90 deg above which a table shows both [Hz].

_LINE_STYLES = {"hexapod": "-", "single_legs": "--"}
_SOURCE_LETTERS = {"hardware": "h", "nonlinear": "m"}

_LEGEND = (
    "-90, -3 dB: bandwidths in Hz, from the legs' demand to their feedback in the control law, "
    "-3 dB from absolute 0 dB (of small motion it may be far higher: `cmf linearize`); peak in dB; "
    "at rest: gain; zeta: damping ratio from the step's overshoot, 0 where it is more than the "
    "step. -: the sweep, to 10 Hz, does not reach it, or no overshoot. unstable: legs ring on "
    "undiminished 12 s after the step (of the axis named most); drifts: the law holds no position, "
    "so legs move on to a "
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
    text = number(first, ".2f")
    if not np.isnan(later):
        text = f"{text}/{later:.2f}"
    elif not np.isnan(measures.graze_from_hz):
        text = f"~{text}"
    falls = [hertz for hertz in (first, later) if not np.isnan(hertz)]
    distance = min((abs(small_motion_hz - hertz) for hertz in falls), default=np.inf)
    return f"{text} [{small_motion_hz:.2f}]" if AGREEMENT < distance < np.inf else text


def comparison_table(results: Sequence[CaseResult]) -> Table:
    """The comparison: a row per law and degree of freedom, next to what is published."""
    plants = list(dict.fromkeys(result.case.plant for result in results))
    has_published = any(result.published for result in results)
    columns: list[Column] = ["law", "dof"]
    for plant in plants:
        columns += [(f"{plant.replace('_', ' ')}\n-90", ".2f"), ("\n-3 dB", ".2f")]
        columns += [("\npeak", ".1f"), ("\nat rest", ".3f"), ("\nzeta", ".2f")]
    if has_published:
        columns += [("published\n-90", ".2f"), ("\n-3 dB", ".2f"), ("\nzeta", ".2f"), ("\nof", "")]
    by_case = {(r.case.law.name, r.case.dof, r.case.plant): r for r in results}
    rows: list[list[Cell]] = []
    texts = list[str]()
    for law, dof in dict.fromkeys((r.case.law.name, r.case.dof) for r in results):
        cells = [cell for plant in plants for cell in _cells(by_case[law, dof, plant])]
        texts += [cell for cell in cells if isinstance(cell, str)]
        published = by_case[law, dof, plants[0]].published
        if has_published:
            cells += [getattr(published, name, None) for name in PUBLISHED_NAMES]
            cells.append(_SOURCE_LETTERS.get(published.of, "") if published else "")
        rows.append([law, dof, *cells])
    marks = [text for mark, text in _MARKS.items() if any(mark in cell for cell in texts)]
    legend = _LEGEND + "".join(marks) + (_PUBLISHED if has_published else "")
    return Table(_table_title(results), columns, rows, legend, grouped=True)


def _cells(result: CaseResult) -> list[Cell]:
    """Measures of a law on a plant, or its verdict in place of the damping ratio."""
    measures = result.measures
    return [
        phase_text(measures, result.small_motion_phase_hz),
        measures.gain_bandwidth_hz,
        measures.peak_gain_db,
        measures.static_gain,
        _verdict(result) or measures.damping_ratio,
    ]


def _table_title(results: Sequence[CaseResult]) -> str:
    """Hydraulics and cab, and the amplitudes of the sweeps."""
    case = results[0].case
    cab = next((result.case.cab_name for result in results if result.case.cab), "")
    translation = case.size / dof_amplitude(case.dof, 1.0)
    inches = units.from_si("in", translation)
    degrees = units.from_si("deg", dof_amplitude("roll", translation))
    plant = f"hydraulics: {case.hydraulics.name}" + (f", cab: {cab}" if cab else "")
    return f"{plant}; simulated sweeps of {inches:.3g} in, {degrees:.3g} deg"


def _verdict(result: CaseResult) -> str:
    """The verdict, with the degree of freedom that swings most at the end if not the step's."""
    if result.verdict != "unstable" or result.case.plant != "hexapod":
        return result.verdict
    record, machine = result.step, result.case.motion_base
    try:
        poses = legs_to_pose(record["leg_position"][-round(record.rate) :: 4], machine)
    except NoPoseError:
        return result.verdict
    dof = DOFS[int((np.ptp(poses, axis=0) / REPORT_AMPLITUDES).argmax())]
    return result.verdict if dof == result.case.dof else f"{result.verdict} ({dof})"


def _colour_by_law(results: Sequence[CaseResult]) -> dict[str, str]:
    laws = dict.fromkeys(result.case.law.name for result in results)
    return {law: look.COLOURS[i % len(look.COLOURS)] for i, law in enumerate(laws)}


def _curve_style(result: CaseResult, colours: Mapping[str, str]) -> dict[str, Any]:
    """Laws by colour, plants by line."""
    case, verdict = result.case, result.verdict
    label = ", ".join(filter(None, (case.law.name, case.plant.replace("_", " "), verdict)))
    line = _LINE_STYLES[case.plant]
    return {"color": colours[case.law.name], "linestyle": line, "label": label}


def _figure_title(quantity: str, dof: str, size: float, results: Sequence[CaseResult]) -> str:
    cab = next((result.case.cab_name.upper() for result in results if result.case.cab), "")
    motion = f"{quantity} in {dof}, {units.from_si(dof_unit(dof), size):.3g} {dof_unit(dof)}"
    hydraulics = results[0].case.hydraulics.name
    return f"{motion}, simulated with hydraulics {hydraulics}" + (f", {cab}" if cab else "")


def responses_figure(results: Sequence[CaseResult]) -> Figure:
    """Gain and phase of all cases of one degree of freedom, published bandwidths as circles."""
    first, colours = results[0].case, _colour_by_law(results)
    title = _figure_title("Frequency response", first.dof, first.size, results)
    figure, gain, phase = look.bode_axes(title, limits=True)
    for result in results:
        style, published = _curve_style(result, colours), result.published
        if result.response is not None:
            look.plot_bode(gain, phase, result.response, stable=result.measures.stable, **style)
        if published is not None:
            look.plot_published(gain, phase, published, style["color"])
    gain.set(ylim=(-20.0, 20.0))
    phase.set(ylim=(-270.0, 30.0), xlim=(0.1, 10.0))
    circles = "circles: published; " if any(result.published for result in results) else ""
    note = f"{circles}pale: coherence below {LEAST_COHERENCE:g}, or unstable"
    look.legend(figure, title=note, title_fontsize=8)
    return figure


def step_figure(results: Sequence[CaseResult]) -> Figure:
    """Step responses of one degree of freedom, and what laws ask of the valve that moves most."""
    dof, reference, colours = results[0].case.dof, results[0].step, _colour_by_law(results)
    unit, step = dof_unit(dof), reference.signal_as(Step)
    labels, x = (f"{dof} [{unit}]", "valve [%]"), "time after the step [s]"
    figure, (response, command) = look.stack(8.0, 7.0, *labels, x=x, ratios=(2, 1))
    demand = units.from_si(unit, dof_history(reference, "leg_reference", dof))
    response.plot(reference.time - step.at, demand, color=look.GREY, linewidth=1.0)
    low, high = -0.5 * demand[-1], 2.0 * demand[-1]
    busiest: int | None = None
    for result in results:
        record, style = result.step, _curve_style(result, colours)
        try:
            motion = units.from_si(unit, dof_history(record, "leg_position", dof))
        except NoPoseError:
            continue
        response.plot(record.time - step.at, motion, **style)
        if result.measures.stable:
            low, high = min(low, 1.1 * motion.min()), max(high, 1.1 * motion.max())
        valves = 100.0 * record["valve_command"]
        if busiest is None:
            busiest = int(np.ptp(valves, axis=0).argmax())
            command.set(ylabel=f"valve {busiest + 1} [%]")
        command.plot(record.time - step.at, valves[:, busiest], **style)
    title = _figure_title("Step response", dof, step.size, results)
    response.set(title=title, ylim=(low, high))
    command.set(xlim=(-0.2, 3.0), ylim=(-105, 105))
    is_unstable = any(result.verdict == "unstable" for result in results)
    note = "unstable: legs ring on 12 s after the step" if is_unstable else None
    look.legend(figure, title=note)
    return figure


_FIGURES = re.compile(rf"(bode|step)_({'|'.join(DOFS)})\.({'|'.join(look.FORMATS)})")
_RECORDS = re.compile(rf"({'|'.join(PLANTS)})-.+-({'|'.join(DOFS)})-(chirp|step)\.parquet")


def drop_comparison(folder: Path, comparison: Sequence[CaseResult], records: bool) -> int:
    """Remove the files of an earlier comparison from a folder, and return their number.

    They are `measures.md`, figures and records by their names; with `records` those of this
    comparison stay. All other files stay.
    """
    labels = [result.case.label for result in comparison] if records else []
    current = {f"{label}-{kind}.parquet" for label in labels for kind in ("chirp", "step")}
    stale = [path for path in folder.glob("*") if _FIGURES.fullmatch(path.name)]
    stale += folder.glob("measures.md")
    for path in folder.glob("records/*"):
        if _RECORDS.fullmatch(path.name) and path.name not in current:
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
        results = [result for result in comparison if result.case.dof == dof]
        files[f"bode_{dof}.png"] = responses_figure(results)
        files[f"step_{dof}.png"] = step_figure(results)
    return look.save_files(files, folder)
