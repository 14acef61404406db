"""Tables, figures and files of comparisons."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.analysis.measurable import CLEAR, dof_history
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
from cmf_mj.studies.comparison import PUBLISHED

AGREEMENT = 0.1  #: Distance of two readings of -90 deg from which on a table shows both [Hz].

_LINES = {"hexapod": "-", "single_legs": "--"}

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
            line.append(_verdict(result) or measures.damping_ratio)
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


def _verdict(result: CaseResult) -> str:
    """The verdict, with the axis that swings most at the end of the step where that is another."""
    if result.verdict != "unstable" or result.case.plant != "hexapod":
        return result.verdict
    record, machine = result.step, result.case.motion_base
    try:
        poses = legs_to_pose(record["leg_position"][-round(record.rate) :: 4], machine)
    except NoPoseError:
        return result.verdict
    dof = DOFS[int((np.ptp(poses, axis=0) / REPORT_AMPLITUDES).argmax())]
    return result.verdict if dof == result.case.dof else f"{result.verdict} ({dof})"


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
    return f"{of}, simulated with hydraulics {hydraulics}" + (f", {cab}" if cab else "")


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
    circles = "circles: published; " if any(result.published for result in results) else ""
    note = f"{circles}pale: coherence below {CLEAR:g}, or unstable"
    look.legend(figure, title=note, title_fontsize=8)
    return figure


def step_figure(results: Sequence[CaseResult]) -> Figure:
    """Step responses of one degree of freedom, and what laws ask of the valve that moves most."""
    dof = results[0].case.dof
    unit, colours = dof_unit(dof), _colours(results)
    labels, under = (f"{dof} [{unit}]", "valve [%]"), "time after the step [s]"
    figure, (response, command) = look.stack(8.0, 7.0, *labels, x=under, ratios=(2, 1))
    reference = results[0].step
    demanded = units.from_si(unit, dof_history(reference, "leg_reference", dof))
    begin, step = reference.signal_as(Step).at, reference.signal_as(Step).size
    response.plot(reference.time - begin, demanded, color=look.GREY, linewidth=1.0)
    low, high, busy = -0.5 * demanded[-1], 2.0 * demanded[-1], -1
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
        valves = 100.0 * record["valve_command"]
        busy = int(np.ptp(valves, axis=0).argmax()) if busy < 0 else busy
        command.set(ylabel=f"valve {busy + 1} [%]")
        command.plot(record.time - begin, valves[:, busy], **style)
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
