"""Tables, figures and files of a run of the facility: what became of the host's frames, and time.

Every frame a host sends is in exactly one line of the account:

    received = early + lost + after the end + at the DCU
    at the DCU = accepted + refused, by reason + the one that waits for confirmation at the end
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.control.states import State
from cmf_mj.core import units
from cmf_mj.core.files import write_csv
from cmf_mj.core.rates import FRAME
from cmf_mj.facility.operation import Operation, Timing, account

PERCENTILES = (50.0, 90.0, 99.0, 99.9)
"""Shares of the frames that are printed [%]."""

_BLUE, _ORANGE = "#0072b2", "#d55e00"


def account_table(
    operation: Operation,
    received: int | None = None,
    datagrams: Mapping[str, int] | None = None,
) -> Table:
    """The account as a table; of the reasons only those that occurred."""
    table = Table("host frames", "count", "meaning", title="host", box=SIMPLE_HEAD)
    told = {
        "received": "good datagrams of the host",
        "early": "before the clock started",
        "lost": "between receiver and loop",
        "after_end": "after the last control frame",
        "accepted": "taken by the DCU",
        "waiting": "neither: held at the end until confirmed",
        "late": "accepted after their turn had begun",
        "missing": "numbers that never came",
        "resynchronised": "starts of a stream, jumps followed, clocks set anew",
        "silent": "streams lost by timeout",
    }
    always = ("received", "accepted", "late", "missing")
    for name, count in account(operation, received, datagrams).items():
        if count or name in always:
            where = "datagrams dropped" if name in (datagrams or {}) else "refused by the DCU"
            table.add_row(name, str(count), told.get(name, where))
    return table


def timing_rows(timing: Timing) -> list[tuple[str, str]]:
    """Computing time and lateness of the frames, as names and values."""
    frames = timing.busy.size
    rows = [(f"{share:g} % of frames below", timing.percentile(share)) for share in PERCENTILES]
    rows += [("largest", float(timing.busy.max())), ("largest lateness", float(timing.late.max()))]
    over = f"{timing.over} of {frames}"
    behind = f"{int((timing.late > FRAME).sum())} of {frames}"
    return [
        *((name, f"{1e6 * seconds:.1f} us") for name, seconds in rows[:5]),
        (f"over {1e6 * FRAME:.0f} us of computing", over),
        (rows[5][0], f"{1e3 * rows[5][1]:.3f} ms"),
        ("begun more than a frame late", behind),
    ]


def timing_table(timing: Timing) -> Table:
    """Computing time and lateness of the frames."""
    table = Table("control frames", "measured", title="real time", box=SIMPLE_HEAD)
    for row in timing_rows(timing):
        table.add_row(*row)
    return table


def timing_figure(timing: Timing) -> Figure:
    """Histograms of computing time and lateness; both axes logarithmic."""
    figure = Figure(figsize=(8.0, 6.5), layout="constrained")
    busy, late = figure.subplots(2, 1)
    frame = 1e6 * FRAME
    for axis, values, colour, label in (
        (busy, timing.busy, _BLUE, "computing time of a frame [us]"),
        (late, timing.late, _ORANGE, "start of a frame behind its time [us]"),
    ):
        shown = np.maximum(1e6 * values, 0.01)
        high = max(float(shown.max()), 2.0 * frame)
        edges = np.geomspace(max(float(shown.min()), 0.01) * 0.9, high * 1.1, 120)
        axis.hist(shown, edges, color=colour, log=True)
        axis.axvline(frame, color="0.3", linestyle=":", label=f"control frame, {frame:.0f} us")
        axis.set(xscale="log", xlabel=label, ylabel="frames")
        axis.grid(True, color="0.9", linewidth=0.6)
        axis.set_axisbelow(True)
    share = 1e6 * timing.percentile(99.9)
    busy.axvline(share, color="0.3", linestyle="--", label=f"99.9 % below {share:.0f} us")
    title = f"{timing.busy.size} control frames, {timing.over} over {frame:.0f} us of computing"
    busy.set_title(title)
    for axis in (busy, late):
        axis.legend(fontsize=8, loc="upper right")
    return figure


def operation_figure(operation: Operation) -> Figure:
    """Operating state, leg references and positions, errors and valve commands of a run."""
    record = operation.record
    figure = Figure(figsize=(9.0, 9.0), layout="constrained")
    state, legs, error, valve = figure.subplots(4, 1, sharex=True, height_ratios=(1.4, 3, 2, 2))
    state.step(record.time, record["operating_state"], where="post", color="0.2")
    state.set_yticks([int(code) for code in State], [code.name.lower() for code in State])
    state.tick_params(axis="y", labelsize=7)
    stale = record["host_stale"] > 0.5
    state.fill_between(record.time, -0.5, 6.5, where=stale.tolist(), color=_ORANGE, alpha=0.2)
    state.set(ylim=(-0.5, 6.5), title="operating state; shaded: no stream from the host")
    reference, position = record["leg_reference"], record["leg_extension"]
    for leg in range(reference.shape[1]):
        label = "reference" if leg == 0 else None
        legs.plot(record.time, reference[:, leg] / units.INCH, color="0.6", lw=2.0, label=label)
    legs.plot(record.time, position / units.INCH, linewidth=0.8)
    legs.legend(fontsize=8, loc="upper right")
    error.plot(record.time, (reference - position) / units.INCH, linewidth=0.6)
    valve.plot(record.time, 100.0 * record["valve_command"], linewidth=0.5)
    for axis, name in ((legs, "legs [in]"), (error, "error [in]"), (valve, "valve command [%]")):
        axis.set_ylabel(name)
        axis.grid(True, color="0.9", linewidth=0.6)
    valve.set_xlabel("time [s]")
    return figure


def save_operation(
    operation: Operation,
    folder: Path,
    received: int | None = None,
    datagrams: Mapping[str, int] | None = None,
) -> list[Path]:
    """Write record, host session, account and figures of a run.

    `record.parquet`, `host.parquet`, `account.csv` and `operation.png`; in real time also
    `timing.csv` (all percentiles in steps of 0.1) and `timing.png`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [
        operation.record.save(folder / "record.parquet"),
        operation.session.save(folder / "host.parquet"),
    ]
    counts = account(operation, received, datagrams)
    paths.append(write_csv(folder / "account.csv", ("name", "count"), counts.items()))
    operation_figure(operation).savefig(folder / "operation.png", dpi=110)
    paths.append(folder / "operation.png")
    timing = operation.timing
    if timing is not None:
        shares = np.linspace(0.0, 100.0, 1001)
        columns = (np.percentile(values, shares) for values in (timing.busy, timing.late))
        lines = (
            (f"{s:.1f}", f"{b:.9f}", f"{a:.9f}") for s, b, a in zip(shares, *columns, strict=True)
        )
        header = ("percentile", "computing_s", "lateness_s")
        paths.append(write_csv(folder / "timing.csv", header, lines))
        timing_figure(timing).savefig(folder / "timing.png", dpi=110)
        paths.append(folder / "timing.png")
    return paths
