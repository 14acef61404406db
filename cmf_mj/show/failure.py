"""Tables, figures and files of a failure study."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core import units
from cmf_mj.core.table import Column, Table
from cmf_mj.show.look import COLOURS, DARK, ORANGE, PURPLE, legend, save_files, stack
from cmf_mj.studies.failure.measures import FailureResult

_LEGEND = (
    "load: largest axial leg load before the event, after it until a leg meets a stop, and in all "
    "the time after it, in kN and times the leg's static load, negative pulls; crew: largest "
    "acceleration at the crew's heads, gravity removed, in g; found: time to detect in s; "
    "pressures in psi gauge: least supply, least and largest of all chambers; stops: speed of the "
    "first and of the fastest leg to meet one, in/s."
)

_COLUMNS: tuple[Column, ...] = (
    *("event", ("load\nbefore", ".1f"), ("\nx", ".2f"), ("\nafter", ".1f"), ("\nx", ".2f")),
    *(("\nall", ".1f"), ("\nx", ".2f"), ("crew\nbefore", ".2f"), ("\nafter", ".2f")),
    *(("\nall", ".2f"), "found\nby", ("\nafter", ".4f"), "ends", ("supply\nleast", ".0f")),
    *(("chamber\nleast", ".0f"), ("\nmost", ".0f"), ("stops\nfirst", ".1f"), ("\nfastest", ".1f")),
)


def label(result: FailureResult) -> str:
    """The event in a few words, fit for a file name."""
    places = {"leg": result.event.leg, "valve": result.event.valve}
    known = (f"{name}_{place}" for name, place in places.items() if place is not None)
    return "-".join([result.event.kind, *known])


def _setting(result: FailureResult) -> str:
    return f"protection {'on' if result.protected else 'off'}"


def failure_table(results: Sequence[FailureResult]) -> Table:
    """The study: a row an event."""
    about = results[0].record.metadata
    rows = []
    for result in results:
        loads, crew = ((p.before, p.free, p.after) for p in (result.load, result.acceleration))
        pressures = (result.supply_least, result.pressure_least, result.pressure_peak)
        speeds = (result.contact_speed, result.impact_speed)
        rows.append(
            (
                label(result).replace("-", " "),
                *(n for load in loads for n in (1e-3 * load.value, result.multiple(load))),
                *(units.from_si("g", peak.value) for peak in crew),
                *(result.detected_by, result.detection_time, result.state),
                *(units.from_si("psi", peak.value) for peak in pressures),
                *(peak and units.from_si("in/s", peak.value) for peak in speeds),
            )
        )
    title = (
        f"{about['law']} in {results[0].dof}, {about['cab']} cab, {about['hydraulics']} "
        f"hydraulics, {_setting(results[0])}"
    )
    return Table(title, _COLUMNS, rows, _LEGEND)


def _columns(result: FailureResult) -> dict[str, object]:
    """One line of `failures.csv`, SI; missing measures are empty."""
    event = result.event
    about = {name: result.record.metadata[name] for name in ("law", "cab", "hydraulics")}
    row: dict[str, object] = {"event": event.kind, "leg": event.leg, "valve": event.valve}
    row |= {"size_si": event.magnitude, "at_s": event.at} | about
    row |= {"dof": result.dof, "protected": result.protected}
    for name in ("before", "free", "after"):
        load = getattr(result.load, name)
        row |= {f"load_{name}_n": load.value, f"load_{name}_multiple": result.multiple(load)}
        row[f"load_{name}_leg"] = load.leg
    for name, peak in (
        ("crew_acceleration_before_m_s2", result.acceleration.before),
        ("crew_acceleration_free_m_s2", result.acceleration.free),
        ("crew_acceleration_after_m_s2", result.acceleration.after),
        ("chamber_pressure_most_pa", result.pressure_peak),
        ("chamber_pressure_least_pa", result.pressure_least),
        ("supply_pressure_least_pa", result.supply_least),
        ("stop_speed_first_m_s", result.contact_speed),
        ("stop_speed_fastest_m_s", result.impact_speed),
    ):
        row[name] = peak and peak.value
    row |= {"detected_by": result.detected_by, "detection_time_s": result.detection_time}
    return row | {"state": result.state, "message": result.message}


def save_failures(results: Sequence[FailureResult], folder: Path) -> list[Path]:
    """Write `failures.csv`, `failures.md` and a figure an event."""
    rows = [_columns(result) for result in results]
    files = {
        "failures.csv": (rows[0], [row.values() for row in rows]),
        "failures.md": failure_table(results).save,
    }
    figures = {f"{label(result)}.png": failure_figure(result) for result in results}
    return save_files(files | figures, folder)


def failure_figure(result: FailureResult) -> Figure:
    """Extensions, axial loads, crew acceleration and pressures, with event and detection."""
    record = result.record
    time = record.time - result.event.at
    labels = ("extension [in]", "axial leg load [kN]", "crew acceleration [g]", "pressure [psi]")
    figure, axes = stack(9.0, 11.0, *labels, x="time after the event [s]")
    legs, loads, crew, pressures = axes
    legs.plot(time, record["leg_reference"] / units.INCH, linewidth=0.6, alpha=0.5)
    numbers = [f"leg {leg}" for leg in range(1, 7)]
    legs.set_prop_cycle(color=COLOURS)
    legs.plot(time, record["leg_extension"] / units.INCH, label=numbers)
    loads.plot(time, 1e-3 * record["axial_load"])
    felt = record["crew_acceleration"] / units.STANDARD_GRAVITY
    crew.plot(time, felt, linewidth=0.8, label=["x", "y", "z"])
    crew.plot(time, np.linalg.norm(felt, axis=1), color=DARK, linewidth=0.8, label="size")
    for side in ("cap", "rod"):
        values = record[f"{side}_pressure"] / units.PSI
        for name, extreme in (("largest", values.max(axis=1)), ("least", values.min(axis=1))):
            pressures.plot(time, extreme, label=f"{name} {side}", linewidth=0.9)
    pressures.plot(time, record["supply_pressure"] / units.PSI, label="supply", linewidth=0.9)
    about, state = record.metadata, result.state.replace("_", " ")
    legs.set(
        title=f"Legs, crew and pressures after {label(result).replace('-', ' ')}: {state}\n"
        f"{about['law']} in {result.dof}, "
        f"{about['cab']}, {about['hydraulics']}, {_setting(result)}",
        xlim=(max(time[0], -4.0), time[-1]),
    )
    for axis in axes:
        axis.axvline(0.0, color=ORANGE, linestyle="--", linewidth=1.0, label="event")
        if (at := result.detection_time) is not None:
            axis.axvline(at, color=PURPLE, linestyle=":", linewidth=1.4, label="detected")
    legend(legs, crew, pressures, fontsize=7, ncols=2, loc="upper right")
    return figure
