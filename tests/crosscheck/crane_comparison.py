"""How far the engines of the hydraulic crane are apart, term by term: table and figure."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.core.result import Table
from cmf_mj.core.units import FRAME
from cmf_mj.show.look import BLUE, DARK, GREEN, GREY, ORANGE, legend, new_figure, save_files
from crosscheck.crane import PUMP, History, Terms, apart, in_mujoco, in_scipy
from crosscheck.crane_exudyn import in_exudyn

NAMES = {
    "valve": "valve linear below 2 bar",
    "damper": "end stop damps",
    "volume": "flows count volume, not content",
    "start": "starts at printed pressures",
}
"""Of the `Terms` in which the plant differs; a throttle adds the third volume."""


PLAIN, EXUDYN = "MuJoCo, Chrono's equations", "Exudyn, Chrono's equations"
THROTTLED = f"{PLAIN}, throttled"


class Comparison(NamedTuple):
    """One row: which engines, what differs between them, and how far they are apart."""

    engines: str  #: What is compared.
    differs: str  #: Terms in which it differs.
    pressure: float  #: Largest difference of a pressure, over the pump's.
    early: float  #: The same before the piston reaches its end stop.
    force: float  #: [N].
    angle: float  #: [rad].


def compare() -> tuple[list[Comparison], dict[str, History]]:
    """All comparisons over 20 s, and the histories that a figure shows.

    MuJoCo takes steps of 1/32768 s, Exudyn, whose method is of order 4, of 1/2048 s.
    """
    seconds, steps = 20.0, 16
    none = Terms(*[False] * len(Terms._fields))
    ours, theirs = in_mujoco(seconds, steps), in_exudyn(seconds)
    shown = {"MuJoCo": ours, "Exudyn": theirs}
    throttled = in_mujoco(seconds, steps, throttled=True)
    each = [(name, none._replace(**{field: True})) for field, name in NAMES.items()]
    cases = [
        *((PLAIN, ours, *case) for case in (("all", Terms()), *each, ("none", none))),
        (EXUDYN, theirs, "none", Terms(valve=False, damper=False)),
        (THROTTLED, throttled, "all", Terms()),
        (THROTTLED, throttled, "third volume before the throttle", none._replace(hose=True)),
        (THROTTLED, throttled, "none", none),
    ]
    rows: list[Comparison] = []
    for engines, history, name, terms in cases:
        found = in_scipy(seconds, terms, throttled=engines == THROTTLED)
        rows.append(Comparison(engines, name, *apart(history, found)))
        if engines == PLAIN and name in ("all", "none"):
            shown["Chrono's equations" + " in our terms" * (name == "none")] = found
    said = f"{NAMES['volume']}; {NAMES['start']}"
    rows.insert(len(NAMES) + 2, Comparison("MuJoCo, Exudyn", said, *apart(ours, theirs)))
    return rows, shown


def crane_table(rows: list[Comparison]) -> Table:
    """A row a comparison; pressures in per cent of the pump's."""
    columns = (
        *("engines", "differ in", ("pressure [%]", ".4f"), ("before the stop [%]", ".4f")),
        *(("force [N]", ".1f"), ("angle [deg]", ".5f")),
    )
    cells = [
        (*row[:2], 100.0 * row.pressure, 100.0 * row.early, row.force, np.degrees(row.angle))
        for row in rows
    ]
    return Table("The hydraulic crane: largest differences over 20 s", columns, cells)


def crane_figure(shown: dict[str, History]) -> Figure:
    """Both pressures of all engines, and how far each is from MuJoCo's."""
    figure = new_figure(9.0, 6.0)
    above, below = figure.subplots(2, 1, sharex=True)
    ours, time = shown["MuJoCo"], FRAME * np.arange(shown["MuJoCo"].cap.size)
    above.plot(time, 1e-6 * ours.cap, color=BLUE, label="cap, MuJoCo")
    above.plot(time, 1e-6 * ours.rod, color=ORANGE, label="rod, MuJoCo")
    for name, colour, mark in zip(
        list(shown)[1:], (GREEN, DARK, GREY), ("x", "+", ""), strict=True
    ):
        other = shown[name]
        if mark:
            for side in ("cap", "rod"):
                label = name if side == "cap" else None
                values = 1e-6 * getattr(other, side)[::1024]
                style: dict[str, Any] = {"color": colour, "linestyle": "", "marker": mark}
                above.plot(time[::1024], values, label=label, markersize=5, **style)
        far = np.maximum(np.abs(ours.cap - other.cap), np.abs(ours.rod - other.rod)) / PUMP
        blocks = 100.0 * far[: far.size // 64 * 64].reshape(-1, 64).max(axis=1)
        below.semilogy(time[::64][: blocks.size], blocks, color=colour, label=f"to {name}")
    below.axhline(0.1, color=GREY, linestyle=":")
    above.set(ylabel="pressure [MPa]")
    below.set(xlabel="time [s]", ylabel="difference [% of the pump]", ylim=(1e-6, 3.0))
    legend(above, below)
    figure.suptitle("The hydraulic crane: chamber pressures in three engines")
    return figure


def save_crane(folder: Path) -> list[Path]:
    """Run, and write `crane.md`, from which the data file is taken, and `crane.png`."""
    rows, shown = compare()
    return save_files(
        {"crane.md": crane_table(rows), "crane.png": crane_figure(shown)}, folder, 100
    )
