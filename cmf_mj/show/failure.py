"""Figures and files of a failure study."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core import units
from cmf_mj.core.result import Result
from cmf_mj.show.look import COLOURS, DARK, ORANGE, PURPLE, legend, save_files, stack
from cmf_mj.studies.failure.measures import FailureResult


def save_failures(results: Result[FailureResult], folder: Path) -> list[Path]:
    """Write `failures.csv`, `failures.md` and a figure an event."""
    files = {"failures.csv": results.save, "failures.md": results.save}
    figures = {f"{result.label}.png": failure_figure(result) for result in results}
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
        title=f"Legs, crew and pressures after {result.label.replace('-', ' ')}: {state}\n"
        f"{about['law']} in {result.dof}, "
        f"{about['cab']}, {about['hydraulics']}, {result.setting}",
        xlim=(max(time[0], -4.0), time[-1]),
    )
    for axis in axes:
        axis.axvline(0.0, color=ORANGE, linestyle="--", linewidth=1.0, label="event")
        if (at := result.detection_time) is not None:
            axis.axvline(at, color=PURPLE, linestyle=":", linewidth=1.4, label="detected")
    legend(legs, crew, pressures, fontsize=7, ncols=2, loc="upper right")
    return figure
