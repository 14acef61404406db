"""Tables, figures and files of a run of the facility: account of host frames, and timing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core.rates import FRAME
from cmf_mj.facility.host.handover import MOST_RATE
from cmf_mj.facility.operation import Operation, Timing, account
from cmf_mj.show.look import BLUE, DARK, ORANGE, legend, new_figure, save_files
from cmf_mj.show.overview import overview_figure
from cmf_mj.show.table import Table

_MEANINGS = {
    "received": "good datagrams of the host",
    "early": "before the clock started",
    "lost": "between receiver and loop",
    "thinned": f"faster than {MOST_RATE} a second: only the newest went on",
    "after_end": "after the last control frame",
    "accepted": "taken by the DCU",
    "waiting": "neither: held at the end until confirmed",
    "late": "accepted after their turn had begun",
    "missing": "numbers that never came",
    "resynchronised": "starts of a stream, jumps followed, clocks set anew",
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


def timing_figure(timing: Timing) -> Figure:
    """Histograms of computing time and lateness; both axes logarithmic."""
    figure = new_figure(8.0, 6.5)
    busy, late = figure.subplots(2, 1)
    frame = 1e6 * FRAME
    for axis, values, colour, label in (
        (busy, timing.busy, BLUE, "computing time of a frame [us]"),
        (late, timing.late, ORANGE, "start of a frame behind its time [us]"),
    ):
        times = np.maximum(1e6 * values, 0.01)
        high = max(float(times.max()), 2.0 * frame)
        edges = np.geomspace(max(float(times.min()), 0.01) * 0.9, high * 1.1, 120)
        axis.hist(times, edges, color=colour, log=True)
        axis.axvline(frame, color=DARK, linestyle=":", label=f"control frame, {frame:.0f} us")
        axis.set(xscale="log", xlabel=label, ylabel="frames")
    share = 1e6 * timing.percentile(99.9)
    busy.axvline(share, color=DARK, linestyle="--", label=f"99.9 % below {share:.0f} us")
    title = f"{timing.busy.size} control frames, {timing.over} over {frame:.0f} us of computing"
    busy.set_title(title)
    legend(busy, late, loc="upper right")
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
    counts = account(operation, received, datagrams)
    files: dict[str, Any] = {
        "record.parquet": operation.record.save,
        "host.parquet": operation.session.save,
        "account.csv": (("name", "count"), counts.items()),
        "operation.png": overview_figure(operation.record),
    }
    timing = operation.timing
    if timing is not None:
        shares = np.linspace(0.0, 100.0, 1001)
        columns = (np.percentile(values, shares) for values in (timing.busy, timing.late))
        lines = (
            (f"{s:.1f}", f"{b:.9f}", f"{a:.9f}") for s, b, a in zip(shares, *columns, strict=True)
        )
        files["timing.csv"] = (("percentile", "computing_s", "lateness_s"), lines)
        files["timing.png"] = timing_figure(timing)
    return save_files(files, folder)
