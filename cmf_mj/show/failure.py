"""Tables, figures and files of a failure study."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.core import units
from cmf_mj.core.files import write_csv, write_text
from cmf_mj.show.comparison import markdown
from cmf_mj.studies.failure.measures import FailureResult, Peak

LEGEND = (
    "load: largest axial leg load before the event, after it until a leg meets a stop, and in all "
    "the time after it, in kN and times the leg's static load, negative pulls; crew: largest "
    "acceleration at the crew's heads, gravity removed, in g; found: time to detect in s; "
    "pressures in psi gauge: least supply, least and largest of all chambers; stops: speed of the "
    "first and of the fastest leg to meet one, in/s."
)
"""What the columns of the table mean."""

_MARKS = {"event": ("#d55e00", "--"), "detected": ("#cc79a7", ":")}


def label(result: FailureResult) -> str:
    """The event in a few words, fit for a file name."""
    event = result.event
    parts: list[str] = [event.kind]
    if event.leg is not None:
        parts.append(f"leg_{event.leg}")
    if event.valve is not None:
        parts.append(f"valve_{event.valve}")
    return "-".join(parts)


def _speed(peak: Peak | None) -> str:
    return "-" if peak is None else f"{units.from_si('in/s', peak.value):.1f}"


def failure_cells(results: Sequence[FailureResult]) -> tuple[list[str], list[list[str]]]:
    """Header and lines: a line an event."""
    header = ["event", "load\nbefore", "\nx", "\nafter", "\nx", "\nall", "\nx"]
    header += ["crew\nbefore", "\nafter", "\nall", "found\nby", "\nafter", "ends"]
    header += ["supply\nleast", "chamber\nleast", "\nmost", "stops\nfirst", "\nfastest"]
    lines = []
    for result in results:
        found = result.detection_time
        loads = (result.load_before, result.load_free, result.load_after)
        felt = (result.acceleration_before, result.acceleration_free, result.acceleration_after)
        pressures = (result.supply_least, result.pressure_least, result.pressure_peak)
        lines.append(
            [
                label(result).replace("-", " "),
                *(
                    text
                    for load in loads
                    for text in (f"{1e-3 * load.value:.1f}", f"{result.multiple(load):.2f}")
                ),
                *(f"{units.from_si('g', peak.value):.2f}" for peak in felt),
                result.detected_by or "-",
                "-" if found is None else f"{found:.4f}",
                result.state,
                *(f"{units.from_si('psi', peak.value):.0f}" for peak in pressures),
                _speed(result.contact_speed),
                _speed(result.impact_speed),
            ]
        )
    return header, lines


def failure_table(results: Sequence[FailureResult]) -> Table:
    """The study as a terminal table."""
    first = results[0]
    about = first.record.metadata
    guard = "on" if first.protected else "off"
    table = Table(
        title=f"{about['law']} in {first.dof}, {about['cab']} cab, {about['hydraulics']} "
        f"hydraulics, protection {guard}",
        caption=LEGEND,
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    header, lines = failure_cells(results)
    for index, name in enumerate(header):
        left = index in (0, 10, 12)
        table.add_column(name, justify="left" if left else "right", no_wrap=True)
    for line in lines:
        table.add_row(*line)
    return table


def _columns(result: FailureResult) -> dict[str, object]:
    """One line of `failures.csv`, SI; missing measures are empty."""
    event, about = result.event, result.record.metadata
    row: dict[str, object] = {
        "event": event.kind,
        "leg": event.leg,
        "valve": event.valve,
        "size_si": event.magnitude,
        "at_s": event.at,
        "law": about["law"],
        "cab": about["cab"],
        "hydraulics": about["hydraulics"],
        "dof": result.dof,
        "protected": result.protected,
    }
    for name, load in (
        ("before", result.load_before),
        ("free", result.load_free),
        ("after", result.load_after),
    ):
        row[f"load_{name}_n"] = load.value
        row[f"load_{name}_multiple"] = result.multiple(load)
        row[f"load_{name}_leg"] = load.leg
    for name, peak in (
        ("crew_acceleration_before_m_s2", result.acceleration_before),
        ("crew_acceleration_free_m_s2", result.acceleration_free),
        ("crew_acceleration_after_m_s2", result.acceleration_after),
        ("crew_specific_force_before_m_s2", result.specific_force_before),
        ("crew_specific_force_after_m_s2", result.specific_force_after),
        ("chamber_pressure_most_pa", result.pressure_peak),
        ("chamber_pressure_least_pa", result.pressure_least),
        ("supply_pressure_least_pa", result.supply_least),
        ("stop_speed_first_m_s", result.contact_speed),
        ("stop_speed_fastest_m_s", result.impact_speed),
    ):
        row[name] = None if peak is None else peak.value
    return row | {
        "detected_by": result.detected_by,
        "detection_time_s": result.detection_time,
        "state": result.state,
        "message": result.message,
    }


def save_failures(results: Sequence[FailureResult], folder: Path) -> list[Path]:
    """Write `failures.csv`, `failures.md` and a figure an event."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "failures.csv", folder / "failures.md"]
    rows = [_columns(result) for result in results]
    write_csv(paths[0], rows[0], [row.values() for row in rows])
    header, lines = failure_cells(results)
    write_text(paths[1], markdown(header, lines))
    for result in results:
        path = folder / f"{label(result)}.png"
        failure_figure(result).savefig(path, dpi=110)
        paths.append(path)
    return paths


def failure_figure(result: FailureResult) -> Figure:
    """Extensions, axial loads, crew acceleration and pressures, with event and detection."""
    record = result.record
    time = record.time - result.event.at
    figure = Figure(figsize=(9.0, 11.0), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    legs, loads, crew, pressures = axes
    for leg in range(record["leg_extension"].shape[1]):
        name = f"leg {leg + 1}"
        (line,) = legs.plot(time, record["leg_extension"][:, leg] / units.INCH, label=name)
        legs.plot(
            time,
            record["leg_reference"][:, leg] / units.INCH,
            color=line.get_color(),
            linewidth=0.6,
            alpha=0.5,
        )
        loads.plot(time, 1e-3 * record["axial_load"][:, leg], color=line.get_color())
    felt = record["crew_acceleration"] / units.STANDARD_GRAVITY
    for name, values in zip(("x", "y", "z"), felt.T, strict=True):
        crew.plot(time, values, linewidth=0.8, label=name)
    crew.plot(time, np.linalg.norm(felt, axis=1), color="0.2", linewidth=0.8, label="size")
    for name, values in (
        ("largest cap", record["cap_pressure"].max(axis=1)),
        ("least cap", record["cap_pressure"].min(axis=1)),
        ("largest rod", record["rod_pressure"].max(axis=1)),
        ("least rod", record["rod_pressure"].min(axis=1)),
        ("supply", record["supply_pressure"]),
    ):
        pressures.plot(time, values / units.PSI, label=name, linewidth=0.9)
    about = record.metadata
    state = result.state.replace("_", " ")
    legs.set(
        ylabel="extension [in]",
        title=f"{label(result).replace('-', ' ')}: {state}\n{about['law']} in {result.dof}, "
        f"{about['cab']}, {about['hydraulics']}, protection {'on' if result.protected else 'off'}",
    )
    loads.set(ylabel="axial leg load [kN]")
    crew.set(ylabel="crew acceleration [g]")
    pressures.set(ylabel="pressure [psi]", xlabel="time after the event [s]")
    for axis in axes:
        axis.grid(True, color="0.9", linewidth=0.6)
        _mark(axis, result)
    for axis, columns in ((legs, 2), (crew, 2), (pressures, 2)):
        axis.legend(fontsize=7, ncols=columns, loc="upper right")
    legs.set_xlim(max(time[0], -4.0), time[-1])
    return figure


def _mark(axis: Axes, result: FailureResult) -> None:
    """Lines at the event and at its detection."""
    colour, style = _MARKS["event"]
    axis.axvline(0.0, color=colour, linestyle=style, linewidth=1.0, label="event")
    if result.detection_time is not None:
        colour, style = _MARKS["detected"]
        axis.axvline(
            result.detection_time, color=colour, linestyle=style, linewidth=1.4, label="detected"
        )
