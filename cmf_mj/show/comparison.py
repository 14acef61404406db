"""Table and figures of a comparison."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cmf_mj.analysis.measurable import CLEAR, dof_history
from cmf_mj.analysis.measures import Measures
from cmf_mj.core import units
from cmf_mj.core.errors import NoPoseError
from cmf_mj.core.result import Cell, Column, Result, Table, number
from cmf_mj.machine.geometry import by_kind, dof_unit
from cmf_mj.show.look import (
    COLOURS,
    DARK,
    FAINT,
    GREY,
    bode_axes,
    legend,
    plot_bode,
    plot_printed,
    save_files,
    stack,
)
from cmf_mj.signals.single import Step
from cmf_mj.studies.case import CaseResult, Qualities
from cmf_mj.studies.comparison import PUBLISHED

AGREEMENT = 0.1
"""Distance of two readings of -90 deg from which on a table shows both [Hz]."""

_LINES = {"hexapod": "-", "single_legs": "--"}
_TITLES = {"hexapod": "hexapod", "single_legs": "single legs"}

_LEGEND = (
    "-90, -3 dB: bandwidths in Hz from DCL leg demand to leg feedback, -3 dB from absolute 0 dB; "
    "peak in dB; zeta: damping ratio from the step's overshoot; unstable: the legs ring on "
    "undiminished 12 s after the step, and only that counts. ~: the phase grazes -90 deg; "
    "a/b: it falls through it at a and, having come back, at b; [c]: -90 deg of small motion, "
    f"where that is more than {AGREEMENT:g} Hz off. Published: h measured on the hardware, m from "
    "the report's non-linear model of six single legs."
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
    for name in [*(_TITLES[plant] for plant in plants), "published"]:
        columns += [(f"{name}\n-90", ".2f"), ("\n-3 dB", ".2f")]
        columns += [] if name == "published" else [("\npeak", ".1f")]
        columns += [("\nzeta", ".2f")]
    by_case = {(r.case.law.name, r.case.dof, r.case.plant): r for r in results}
    cells = []
    for law, dof in dict.fromkeys(key[:2] for key in by_case):
        line: list[Cell] = [law, dof]
        for plant in plants:
            result = by_case[law, dof, plant]
            measures = result.measures
            line += [phase_text(measures, result.small_motion_phase_hz), *measures[1:3]]
            line.append(measures.damping_ratio if measures.stable else "unstable")
        printed = by_case[law, dof, plants[0]].published
        line += [getattr(printed, name, None) for name in PUBLISHED]
        of = {"hardware": "h", "nonlinear": "m"}.get(printed.of, "") if printed else ""
        cells.append([*line, of])
    title = f"hydraulics: {first.hydraulics.name}" + (f", cab: {cab}" if cab else "")
    return Table(title, [*columns, ("\nof", "")], cells, _LEGEND, grouped=True)


_QUALITIES = (
    ("-90 over\ndrive lag", ".2f", "corner of the servo drive's lag"),
    ("-90 over\noil mode", ".2f", "lowest hydraulic mode, valves shut"),
    ("-90 over\nsaturation", ".2f", "where unit gain opens a valve fully or stalls a leg"),
    ("stiffness\nat rest", ".0f", "klbf/in or klbf ft/deg; inf: a force leaves no motion"),
    ("stiffness\n0.5 to 5 Hz", ".1f", "the least, linearised"),
    ("rejection\nto", ".2f Hz", "3 dB off what a force moves with the valves shut, linearised"),
    ("rejection\npeak", ".1f dB", "the most that the law adds to it"),
    ("noise\nto valve", ".2f %", "rms of the busiest at rest, noisy electronics"),
)
"""Title, format and definition of `Qualities` by field."""


def quality_rows(dof: str, found: Qualities) -> list[tuple[str, str, str]]:
    """Title, value in the field's units and definition of each."""
    unit = 1000.0 * units.POUND_FORCE / by_kind(dof, units.INCH, units.DEGREE / units.FOOT)
    stiffness = [value / unit for value in found[3:5]]
    values = (*found[:3], *stiffness, *found[5:7], 100.0 * found.valve_noise)
    return [
        (title.replace("\n", " "), number(value, form), definition)
        for (title, form, definition), value in zip(_QUALITIES, values, strict=True)
    ]


def qualities_table(results: Sequence[CaseResult], found: Sequence[Qualities]) -> Table:
    """What compares laws: a row per law, degree of freedom and plant."""
    rows = []
    for case, one in zip((result.case for result in results), found, strict=True):
        values = [value for _, value, _ in quality_rows(case.dof, one)]
        rows.append((case.law.name, case.dof, _TITLES[case.plant], *values))
    legend = "; ".join(f"{title}: {text}" for title, _, text in _QUALITIES).replace("\n", " ")
    columns = ("law", "dof", "plant", *((title, "") for title, *_ in _QUALITIES))
    return Table("", columns, rows, legend, grouped=True)


def _colours(results: Sequence[CaseResult]) -> dict[str, str]:
    laws = dict.fromkeys(result.case.law.name for result in results)
    return {law: COLOURS[i % len(COLOURS)] for i, law in enumerate(laws)}


def _legend(
    axis: Axes, results: Sequence[CaseResult], place: str, *, circles: bool = False
) -> None:
    """Laws by colour, plants by line, each case that is unstable, and what pale curves are."""
    titles = {result.case.law.name: result.case.law.title for result in results}
    colours, bode = _colours(results), axis.get_xscale() == "log"
    entries: list[dict[str, Any]] = [
        {"color": colour, "label": titles[law]} for law, colour in colours.items()
    ]
    entries += [
        {"color": DARK, "linestyle": _LINES[plant], "label": _TITLES[plant]}
        for plant in dict.fromkeys(result.case.plant for result in results)
    ]
    for case in (result.case for result in results if not result.measures.stable):
        label = f"unstable: {case.law.title}, {_TITLES[case.plant]}"
        style = {"color": colours[case.law.name], "linestyle": _LINES[case.plant]}
        entries.append({**style, "label": label, "alpha": FAINT if bode else 1.0})
    if bode and any(_unclear(result) for result in results):
        entries.append({"color": DARK, "alpha": FAINT, "label": f"coherence below {CLEAR:g}"})
    if circles:
        circle = {"marker": "o", "fillstyle": "none", "linestyle": ""}
        entries.append({"color": DARK, "label": "published", **circle})
    legend(axis, handles=[Line2D([], [], **entry) for entry in entries], loc=place)


def _unclear(result: CaseResult) -> bool:
    """Whether the coherence of a stable case is low somewhere."""
    found = result.response
    return found is not None and result.measures.stable and bool((found.coherence < CLEAR).any())


def _title(quantity: str, dof: str, size: float, results: Sequence[CaseResult]) -> str:
    cab = next((r.case.cab_name.upper() for r in results if r.case.cab), "")
    of = f"{quantity} in {dof}, {units.from_si(dof_unit(dof), size):.3g} {dof_unit(dof)}"
    hydraulics = results[0].case.hydraulics.name
    return f"{of}, {hydraulics} hydraulics" + (f", {cab}" if cab else "")


def bode_figure(results: Sequence[CaseResult]) -> Figure:
    """Gain and phase of all cases of one degree of freedom, published bandwidths as circles."""
    first, colours, circles = results[0].case, _colours(results), False
    title = _title("Frequency response", first.dof, first.size, results)
    figure, gain, phase = bode_axes(title, limits=True)
    for result in results:
        case, colour = result.case, colours[result.case.law.name]
        if result.response is not None:
            style = {"color": colour, "linestyle": _LINES[case.plant]}
            plot_bode(gain, phase, result.response, stable=result.measures.stable, **style)
        if result.published is not None:
            circles |= plot_printed(gain, phase, result.published, colour)
    gain.set(ylim=(-20.0, 20.0))
    phase.set(ylim=(-270.0, 30.0), xlim=(0.1, 10.0))
    _legend(gain, results, "lower left", circles=circles)
    return figure


def step_figure(results: Sequence[CaseResult]) -> Figure:
    """Step responses of one degree of freedom, and what the law asked of the first leg's valve."""
    dof = results[0].case.dof
    unit, colours = dof_unit(dof), _colours(results)
    labels, under = (f"{dof} [{unit}]", "valve 1 [%]"), "time after the step [s]"
    figure, (response, command) = stack(8.0, 7.0, *labels, x=under, ratios=(2, 1))
    reference = results[0].step
    demanded = units.from_si(unit, dof_history(reference, "leg_reference", dof))
    begin, step = reference.signal_as(Step).at, reference.signal_as(Step).size
    response.plot(reference.time - begin, demanded, color=GREY, linewidth=1.0)
    for result in results:
        case, record = result.case, result.step
        style: dict[str, Any] = {"color": colours[case.law.name], "linestyle": _LINES[case.plant]}
        try:
            history = dof_history(record, "leg_position", dof)
        except NoPoseError:
            continue
        response.plot(record.time - begin, units.from_si(unit, history), **style)
        command.plot(record.time - begin, 100.0 * record["valve_command"][:, 0], **style)
    size = float(demanded[-1])
    response.set(title=_title("Step response", dof, step, results), ylim=(-0.5 * size, 2.0 * size))
    command.set(xlim=(-0.2, 3.0), ylim=(-105, 105))
    _legend(response, results, "lower right")
    return figure


def save_comparison(comparison: Result[CaseResult], folder: Path) -> list[Path]:
    """Write `comparison.csv`, `comparison.md`, and `bode_<dof>.png` and `step_<dof>.png`."""
    table = comparison_table(comparison)
    files: dict[str, Any] = {"comparison.csv": comparison.save, "comparison.md": table.save}
    for dof in dict.fromkeys(result.case.dof for result in comparison):
        chosen = [result for result in comparison if result.case.dof == dof]
        files[f"bode_{dof}.png"] = bode_figure(chosen)
        files[f"step_{dof}.png"] = step_figure(chosen)
    return save_files(files, folder)
