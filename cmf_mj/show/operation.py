"""Tables, figures and files of runs: overview, account of host frames, timing, replay."""

from collections.abc import Iterable, Mapping
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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

_LEAST = 1e-9  #: Demand below which a degree of freedom is at rest [m or rad].


def overview_figure(
    record: Record, title: str = "", changes: Iterable[float] = (), events: Iterable[float] = ()
) -> Figure:
    """Demand and response, errors, valve commands, pressures and supply of a run.

    A run of the facility gets its operating state, shaded where the host was silent or late;
    changes are dotted lines, events dashed ones [s]; the title is by default plant and law.
    """
    time, state = record.time, "operating_state" in record.channels
    labels = ["", "", "leg error [in]", "valve command [%]", "cap (-), rod (--) [psi]"]
    labels, heights = [*labels, "supply [psi]"], (1.2, 2.4, 1.6, 1.6, 2.0, 1.2)
    first = 0 if state else 1
    figure, axes = look.stack(9.0, 11.0 if state else 9.6, *labels[first:], ratios=heights[first:])
    if state:
        states = [code.name.lower() for code in State]
        axes[0].step(time, record["operating_state"], where="post", color=look.DARK, lw=1.0)
        axes[0].set_yticks([int(code) for code in State], states)
        axes[0].set_ylim(-0.5, len(State) - 0.5)
        if "host_stale" in record.channels:
            late = np.maximum(record["host_stale"], record["host_late"]) > 0.5
            look.shade(axes[0], time, late)
            axes[0].set_title("operating state; shaded: host silent or late")
    motion, error, valve, pressure, supply = axes[-5:]
    plot_motion(motion, record)
    missing = (record["leg_reference"] - record["leg_extension"]) / units.INCH
    error.plot(time, missing, lw=0.8, label=[f"leg {leg + 1}" for leg in range(missing.shape[1])])
    valve.plot(time, 100.0 * record["valve_command"], lw=0.8)
    for side, line in (("cap", "-"), ("rod", "--")):
        pressure.set_prop_cycle(color=look.COLOURS)
        pressure.plot(time, record[f"{side}_pressure"] / units.PSI, line, lw=0.8)
    for name, colour in (("supply", look.DARK), ("return", look.GREY)):
        supply.plot(time, record[f"{name}_pressure"] / units.PSI, color=colour, lw=1.0, label=name)
    supply.set_ylim(bottom=0.0)
    times = [*((at, "0.4", ":") for at in changes), *((at, "#b00020", "--") for at in events)]
    for axis, (at, colour, line) in product(axes, times):
        axis.axvline(at, color=colour, ls=line, lw=0.9)
    look.legend(motion, error, supply)
    figure.align_ylabels(axes)
    of = title or f"{record.metadata['plant']}, {record.metadata['law']}"
    figure.suptitle(f"Motion, valves and pressures: {of}")
    return figure


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


def plot_motion(axis: Axes, record: Record) -> None:
    """Demand, grey, and response of what is moved; lengths in in, angles in deg."""
    demand, time = record["demand_pose"], record.time
    moved = np.flatnonzero(np.ptp(demand, axis=0) > _LEAST)
    pose = record.channels.get("platform_pose")
    if pose is None:
        axis.plot(time, record["leg_reference"] / units.INCH, color="0.7", lw=2.0)
        axis.set_prop_cycle(color=look.COLOURS)
        reached = record["leg_extension"] / units.INCH
        axis.plot(time, reached, lw=0.9, label=[f"leg {n + 1}" for n in range(reached.shape[1])])
        axis.set_ylabel("legs [in]")
        return
    for index in moved if moved.size else range(6):
        unit = dof_unit(int(index))
        demanded, reached = (units.from_si(unit, values[:, index]) for values in (demand, pose))
        axis.plot(time, demanded, color="0.7", lw=2.0)
        axis.plot(time, reached, color=look.COLOURS[index], lw=0.9, label=f"{DOFS[index]} [{unit}]")
    axis.set_ylabel("demand (grey), response")


_MEANINGS = {
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
    """The account as a table; of the reasons only those that occurred."""
    rows = []
    for name, count in account(operation, received, datagrams).items():
        if count or name in ("received", "accepted", "late", "missing"):
            where = "datagrams dropped" if name in (datagrams or {}) else "refused by the DCU"
            rows.append((name, count, _MEANINGS.get(name, where)))
    return Table("host", ("host frames", ("count", "d"), "meaning"), rows)


def timing_table(timing: Timing) -> Table:
    """Computing time and lateness of the frames."""
    frames, us = timing.busy.size, 1e6
    shares = ((share, us * timing.percentile(share)) for share in (50.0, 90.0, 99.0, 99.9))
    rows = [
        *((f"{share:g} % of frames below", f"{time:.1f} us") for share, time in shares),
        ("largest", f"{us * timing.busy.max():.1f} us"),
        (f"over {us * FRAME:.0f} us of computing", f"{timing.over} of {frames}"),
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
    output, recorded = 100.0 * replayed.output, replayed.recorded
    names = [f"leg {leg + 1} [%]" for leg in range(output.shape[1])]
    figure, (*legs, apart) = look.stack(9.0, 8.0, *names, "largest\ndifference [%]")
    if recorded is not None:
        for axis, values in zip(legs, 100.0 * recorded.T, strict=True):
            axis.plot(replayed.time, values, color="#bbbbbb", linewidth=3.0)
        difference = np.abs(output - 100.0 * recorded).max(axis=1)
        apart.plot(replayed.time, difference, color=look.ORANGE, linewidth=0.8)
    for axis, values in zip(legs, output.T, strict=True):
        axis.plot(replayed.time, values, color=look.BLUE, linewidth=0.8)
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
