"""Tables, figures and files of runs: overview, account of host frames, real time, replay."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.control.states import State
from cmf_mj.core import units
from cmf_mj.core.result import Table
from cmf_mj.core.units import FRAME
from cmf_mj.facility.host.handover import LARGEST_RATE
from cmf_mj.facility.host.stream import write_arrivals
from cmf_mj.facility.operation import Operation, Timing, account
from cmf_mj.facility.replay import Replay
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import save_scenario
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.record.record import Record
from cmf_mj.show import look

_LEAST_DEMAND = 1e-9  #: Demand below which a degree of freedom is at rest [m or rad].


def overview_figure(
    record: Record, title: str = "", changes: Sequence[float] = (), events: Sequence[float] = ()
) -> Figure:
    """Demand and response, errors, valve commands, pressures and supply of a run.

    A run of the facility gets its operating state, shaded where the host was silent or late;
    changes are dotted lines, events dashed ones [s]; the title is by default plant and law.
    """
    time, has_states = record.time, "operating_state" in record.channels
    height_by_label = {
        "motion": 2.4,
        "leg error [in]": 1.6,
        "valve command [%]": 1.6,
        "cap (-), rod (--) [psi]": 2.0,
        "supply [psi]": 1.2,
    }
    if has_states:
        height_by_label = {"": 1.2} | height_by_label
    height, ratios = 11.0 if has_states else 9.6, list(height_by_label.values())
    figure, panels = look.stack(9.0, height, *height_by_label, ratios=ratios)
    *state_panels, motion, error, valve, pressure, supply = panels
    for panel in state_panels:
        _plot_states(panel, record)
    plot_motion(motion, record)
    leg_error = (record["leg_reference"] - record["leg_extension"]) / units.INCH
    error.plot(time, leg_error, lw=0.8, label=_leg_names(leg_error))
    valve.plot(time, 100.0 * record["valve_command"], lw=0.8)
    for side, line in (("cap", "-"), ("rod", "--")):
        pressure.set_prop_cycle(color=look.COLOURS)
        pressure.plot(time, record[f"{side}_pressure"] / units.PSI, line, lw=0.8)
    for name, colour in (("supply", look.DARK), ("return", look.GREY)):
        supply.plot(time, record[f"{name}_pressure"] / units.PSI, color=colour, lw=1.0, label=name)
    supply.set_ylim(bottom=0.0)
    for panel in panels:
        for change in changes:
            panel.axvline(change, color="0.4", ls=":", lw=0.9)
        for event in events:
            panel.axvline(event, color="#b00020", ls="--", lw=0.9)
    look.legend(motion, error, supply)
    figure.align_ylabels(panels)
    run = title or f"{record.metadata['plant']}, {record.metadata['law']}"
    figure.suptitle(f"Motion, valves and pressures: {run}")
    return figure


def _plot_states(axes: Axes, record: Record) -> None:
    """Operating states by name, shaded where the host was silent or late."""
    axes.step(record.time, record["operating_state"], where="post", color=look.DARK, lw=1.0)
    axes.set_yticks([int(state) for state in State], [state.name.lower() for state in State])
    axes.set_ylim(-0.5, len(State) - 0.5)
    if "host_stale" in record.channels:
        is_missing = np.maximum(record["host_stale"], record["host_late"]) > 0.5
        look.shade(axes, record.time, is_missing)
        axes.set_title("operating state; shaded: host silent or late")


def _leg_names(values: NDArray[np.float64]) -> list[str]:
    """Names of the legs whose values are columns."""
    return [f"leg {leg}" for leg in range(1, values.shape[1] + 1)]


def save_run(record: Record, scenario: Run, folder: Path) -> list[Path]:
    """Write the scenario, with absolute names of the files in it, its record and a figure."""
    changes = [change.at_frame(scenario.rate) / scenario.rate for change in scenario.change]
    events = [event.at for event in scenario.events]
    files = {
        "scenario.toml": partial(save_scenario, scenario),
        "record.parquet": record,
        "overview.png": overview_figure(record, scenario.title, changes, events),
    }
    return look.save_files(files, folder)


def plot_motion(axes: Axes, record: Record) -> None:
    """Demand, grey, and response of all that the demand moves; lengths in in, angles in deg."""
    demand, time = record["demand_pose"], record.time
    driven_dofs = np.flatnonzero(np.ptp(demand, axis=0) > _LEAST_DEMAND)
    pose = record.channels.get("platform_pose")
    if pose is None:
        axes.plot(time, record["leg_reference"] / units.INCH, color="0.7", lw=2.0)
        axes.set_prop_cycle(color=look.COLOURS)
        extension = record["leg_extension"] / units.INCH
        axes.plot(time, extension, lw=0.9, label=_leg_names(extension))
        axes.set_ylabel("legs [in]")
        return
    for dof in driven_dofs.tolist() or range(6):
        unit = dof_unit(dof)
        axes.plot(time, units.from_si(unit, demand[:, dof]), color="0.7", lw=2.0)
        response, label = units.from_si(unit, pose[:, dof]), f"{DOFS[dof]} [{unit}]"
        axes.plot(time, response, color=look.COLOURS[dof], lw=0.9, label=label)
    axes.set_ylabel("demand (grey), response")


_MEANING_BY_COUNT = {
    "received": "good datagrams of the host",
    "early": "before the clock started",
    "lost": "between receiver and loop",
    "thinned": f"faster than {LARGEST_RATE} a second: only the newest went on",
    "after_end": "after the last control frame",
    "accepted": "taken by the DCU",
    "waiting": "neither: held at the end until confirmed",
    "late": "accepted after their turn had begun",
    "missing": "numbers that never came",
    "resynchronised": "starts of a stream, jumps followed, clocks set again",
    "silent": "streams lost by timeout",
    "overrun": "datagrams dropped by the system, its buffer being full",
}


def account_table(
    operation: Operation, received: int | None = None, datagrams: Mapping[str, int] | None = None
) -> Table:
    """The account of host frames as a table; of the reasons of refusal those that occurred."""
    rows = []
    for name, count in account(operation, received, datagrams).items():
        if count or name in ("received", "accepted", "late", "missing"):
            refusal = "datagrams dropped" if name in (datagrams or {}) else "refused by the DCU"
            rows.append((name, count, _MEANING_BY_COUNT.get(name, refusal)))
    return Table("host", ("host frames", ("count", "d"), "meaning"), rows)


_TO_US = 1e6  #: Microseconds in a second.


def timing_table(timing: Timing) -> Table:
    """Computing time and lateness of the frames."""
    frames = timing.busy.size
    rows = [
        (f"{percent:g} % of frames below", f"{_TO_US * timing.percentile(percent):.1f} us")
        for percent in (50.0, 90.0, 99.0, 99.9)
    ]
    rows += [
        ("largest", f"{_TO_US * timing.busy.max():.1f} us"),
        (f"over {_TO_US * FRAME:.0f} us of computing", f"{timing.overrun_frames} of {frames}"),
        ("largest lateness", f"{1e3 * timing.late.max():.3f} ms"),
        ("begun more than a frame late", f"{int((timing.late > FRAME).sum())} of {frames}"),
    ]
    return Table("real time", ("control frames", "measured"), rows)


def save_operation(
    operation: Operation,
    folder: Path,
    received: int | None = None,
    datagrams: Mapping[str, int] | None = None,
) -> list[Path]:
    """Write record, host's frames, account and figure of a run.

    `record.parquet`, `host.parquet`, `account.csv` and `operation.png`; in real time also
    `timing.csv`.
    """
    counts = account(operation, received, datagrams)
    files: dict[str, Any] = {
        "record.parquet": operation.record,
        "host.parquet": partial(write_arrivals, operation.arrivals),
        "account.csv": {"name": counts.keys(), "count": counts.values()},
        "operation.png": overview_figure(operation.record),
    }
    if operation.timing is not None:
        files["timing.csv"] = timing_table(operation.timing)
    return look.save_files(files, folder)


def replay_figure(replayed: Replay) -> Figure:
    """Recorded and replayed compensator output of all legs, and their difference."""
    output = 100.0 * replayed.output
    labels = [f"{name} [%]" for name in _leg_names(output)]
    figure, (*legs, difference) = look.stack(9.0, 8.0, *labels, "largest\ndifference [%]")
    if replayed.recorded is not None:
        recorded = 100.0 * replayed.recorded
        for leg, values in zip(legs, recorded.T, strict=True):
            leg.plot(replayed.time, values, color="#bbbbbb", linewidth=3.0)
        largest = np.abs(output - recorded).max(axis=1)
        difference.plot(replayed.time, largest, color=look.ORANGE, linewidth=0.8)
    for leg, values in zip(legs, output.T, strict=True):
        leg.plot(replayed.time, values, color=look.BLUE, linewidth=0.8)
    legs[0].set_title(f"compensator output: recorded (grey) and {replayed.law} replayed (blue)")
    return figure


def replay_summary(replayed: Replay) -> str:
    """The largest difference in one sentence."""
    if replayed.recorded is None:
        return f"{replayed.law}: nothing to compare with; the record has no compensator output"
    if replayed.identical:
        return f"{replayed.law}: identical, bit for bit, over {replayed.time.size} frames"
    note = ", interpolated to 2048 Hz" if replayed.interpolated else ""
    return f"{replayed.law}: largest difference {100.0 * replayed.difference:.3g} %{note}"
