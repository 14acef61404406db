"""Tables and figures of a comparison, for the terminal, for Markdown and as PNG files."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.analysis.frequency_response import dof_history
from cmf_mj.analysis.published import published
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.studies.comparison import CaseResult, Comparison, ComparisonRow

_LINES: dict[str, Literal["-", "--"]] = {"hexapod": "-", "single_legs": "--"}
_Corner = Literal["lower left", "lower right"]
_TITLES = {"hexapod": "hexapod", "single_legs": "single legs"}
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999933")

LEGEND = (
    "-90, -3 dB: bandwidths in Hz from DCL leg demand to leg feedback, -3 dB from absolute 0 dB; "
    "peak in dB; zeta: damping ratio from the step's overshoot; unstable: the legs ring on "
    "undiminished 12 s after the step. Published: h measured on the hardware, m from the report's "
    "non-linear model of six single legs."
)
"""What the columns of the table mean."""


def _number(value: float, digits: int = 2) -> str:
    return "-" if value != value else f"{value:.{digits}f}"


def _cells(row: ComparisonRow) -> list[str]:
    return [
        _number(row.phase_bandwidth_hz),
        _number(row.gain_bandwidth_hz),
        _number(row.peak_gain_db, 1),
        _number(row.damping_ratio) if row.stable else "unstable",
    ]


def _published_cells(row: ComparisonRow) -> list[str]:
    beside = published(row.law, row.dof, row.hydraulics)
    return [
        _number(row.published_phase_bandwidth_hz),
        _number(row.published_gain_bandwidth_hz),
        _number(row.published_damping_ratio),
        "" if beside is None else {"hardware": "h", "nonlinear": "m"}.get(beside.of, ""),
    ]


def comparison_cells(rows: Sequence[ComparisonRow]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of the comparison: a line per law and degree of freedom."""
    plants = list(dict.fromkeys(row.plant for row in rows))
    header = ["law", "dof"]
    for plant in plants:
        header += [f"{_TITLES[plant]}\n-90", "\n-3 dB", "\npeak", "\nzeta"]
    header += ["published\n-90", "\n-3 dB", "\nzeta", "\nof"]
    lines = []
    for law, dof in dict.fromkeys((row.law, row.dof) for row in rows):
        chosen = {row.plant: row for row in rows if (row.law, row.dof) == (law, dof)}
        line = [law, dof]
        for plant in plants:
            line += _cells(chosen[plant])
        lines.append(line + _published_cells(next(iter(chosen.values()))))
    return header, lines


def comparison_table(rows: Sequence[ComparisonRow]) -> Table:
    """The comparison as a terminal table."""
    header, lines = comparison_cells(rows)
    first = rows[0]
    cab = next((row.cab for row in rows if row.cab), "")
    title = f"hydraulics: {first.hydraulics}" + (f", cab: {cab}" if cab else "")
    table = Table(
        title=title, caption=LEGEND, caption_justify="left", box=SIMPLE_HEAD, pad_edge=False
    )
    for index, name in enumerate(header):
        table.add_column(name, justify="left" if index < 2 else "right", no_wrap=True)
    law = ""
    for line in lines:
        if law and line[0] != law:
            table.add_section()
        table.add_row("" if line[0] == law else line[0], *line[1:])
        law = line[0]
    return table


def markdown(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A Markdown table; line breaks in the header become spaces."""
    titles = [name.replace("\n", " ").strip() for name in header]
    rows = [titles, ["---"] * len(titles), *lines]
    return "".join("| " + " | ".join(row) + " |\n" for row in rows)


def parameter_cells(parameters: HydraulicParameters) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a hydraulic set: value, unit, status and source of every number."""
    lines = [
        [name, f"{quantity.value:g}", quantity.unit, quantity.status, quantity.source]
        for name, quantity in parameters.quantities().items()
    ]
    return ["parameter", "value", "unit", "status", "source"], lines


def parameter_table(parameters: HydraulicParameters) -> Table:
    """A hydraulic set as a terminal table."""
    table = Table(title=f"hydraulics: {parameters.name}")
    header, lines = parameter_cells(parameters)
    for name in header:
        table.add_column(name, justify="right" if name == "value" else "left", overflow="fold")
    for line in lines:
        table.add_row(*line)
    return table


def law_table(laws: Sequence[Law]) -> Table:
    """Laws with their sources."""
    table = Table(title="control laws")
    for name in ("name", "title", "source"):
        table.add_column(name, overflow="fold")
    for law in laws:
        table.add_row(law.name, law.title, law.source)
    return table


def _styles(results: Sequence[CaseResult]) -> dict[str, str]:
    laws = dict.fromkeys(result.case.law.name for result in results)
    return {law: _COLOURS[i % len(_COLOURS)] for i, law in enumerate(laws)}


def _legend(
    axis: Axes, results: Sequence[CaseResult], place: _Corner, *, published_marks: bool
) -> None:
    colours = _styles(results)
    titles = {result.case.law.name: result.case.law.title for result in results}
    handles = [Line2D([], [], color=colours[law], label=titles[law]) for law in colours]
    handles += [
        Line2D([], [], color="0.3", linestyle=_LINES[plant], label=_TITLES[plant])
        for plant in dict.fromkeys(result.case.plant for result in results)
    ]
    if published_marks:
        handles.append(
            Line2D(
                [], [], color="0.3", marker="o", fillstyle="none", linestyle="", label="published"
            )
        )
    axis.legend(handles=handles, fontsize=8, loc=place, framealpha=0.9)


def bode_figure(results: Sequence[CaseResult]) -> Figure:
    """Gain and phase of all cases of one degree of freedom, published bandwidths as circles."""
    first = results[0].case
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    colours = _styles(results)
    marked = False
    for result in results:
        case = result.case
        if result.response is not None:
            style = {"color": colours[case.law.name], "linestyle": _LINES[case.plant]}
            gain.semilogx(result.response.frequency, result.response.gain_db, **style)
            phase.semilogx(result.response.frequency, result.response.phase_deg, **style)
        beside = published(case.law.name, case.dof, case.hydraulics.name)
        for axis, value, level in (
            (phase, beside and beside.phase_bandwidth_hz, -90.0),
            (gain, beside and beside.gain_bandwidth_hz, -3.0),
        ):
            if value:
                axis.plot(value, level, "o", color=colours[case.law.name], fillstyle="none")
                marked = True
    gain.axhline(-3.0, color="0.6", linewidth=0.8)
    phase.axhline(-90.0, color="0.6", linewidth=0.8)
    gain.set(
        ylabel="gain [dB]", ylim=(-20.0, 20.0), title=_title(first.dof, first.amplitude, results)
    )
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]", ylim=(-270.0, 30.0), xlim=(0.1, 10.0))
    phase.set_yticks(range(-270, 31, 45))
    for axis in (gain, phase):
        axis.grid(True, which="both", color="0.9", linewidth=0.6)
    _legend(gain, results, "lower left", published_marks=marked)
    return figure


def _title(dof: str, amplitude: float, results: Sequence[CaseResult]) -> str:
    case = results[0].case
    cab = next((r.case.cab.upper() for r in results if r.case.cab), "")
    size = f"{units.from_si(dof_unit(dof), amplitude):.3g} {dof_unit(dof)}"
    return f"{dof}, {size}, {case.hydraulics.name} hydraulics" + (f", {cab}" if cab else "")


def step_figure(results: Sequence[CaseResult]) -> Figure:
    """Step responses of one degree of freedom, and what the law asked of the first leg's valve."""
    dof = results[0].case.dof
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    response, command = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    colours = _styles(results)
    reference = results[0].step
    demanded = units.from_si(dof_unit(dof), dof_history(reference, "leg_reference", dof))
    begin, step = (reference.metadata["command"][key] for key in ("at", "amplitude"))
    response.plot(reference.time - begin, demanded, color="0.5", linewidth=1.0)
    for result in results:
        case, record = result.case, result.step
        style = {
            "color": colours[case.law.name],
            "linestyle": _LINES[case.plant],
            "linewidth": 1.2,
        }
        time = record.time - begin
        try:
            history = dof_history(record, "leg_position", dof)
        except ValueError:
            continue  # no platform pose has these legs: the run went unstable
        response.plot(time, units.from_si(dof_unit(dof), history), **style)
        command.plot(time, 100.0 * record["valve_command"][:, 0], **style)
    size = float(demanded[-1])
    response.set(ylabel=f"{dof} [{dof_unit(dof)}]", title=_title(dof, step, results))
    response.set_ylim(-0.5 * size, 2.0 * size)
    command.set(xlabel="time after the step [s]", ylabel="valve 1 [%]", ylim=(-105, 105))
    command.set_xlim(-0.2, 3.0)
    for axis in (response, command):
        axis.grid(True, color="0.9", linewidth=0.6)
    _legend(response, results, "lower right", published_marks=False)
    return figure


def save_figures(comparison: Comparison, folder: Path) -> list[Path]:
    """Write `bode_<dof>.png` and `step_<dof>.png` for every degree of freedom."""
    paths = []
    for dof in dict.fromkeys(result.case.dof for result in comparison.results):
        chosen = [result for result in comparison.results if result.case.dof == dof]
        for name, figure in (("bode", bode_figure(chosen)), ("step", step_figure(chosen))):
            path = folder / f"{name}_{dof}.png"
            figure.savefig(path, dpi=110)
            paths.append(path)
    return paths
