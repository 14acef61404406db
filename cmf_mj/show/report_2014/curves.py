"""What the figures of all chapters are made of: frequency responses, steps, histories."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse, dof_history
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.record.record import Record
from cmf_mj.show.chart import GREY, Curve, Dash, Panel, curve
from cmf_mj.show.look import COLOURS
from cmf_mj.show.report_2014.runs import On, Runs

Marks = tuple[list[Curve], list[Curve]]
"""Curves on the gain and on the phase."""


class Response(NamedTuple):
    """A named frequency response."""

    name: str
    response: FrequencyResponse | None
    colour: str
    dash: Dash = "solid"
    marks: bool = False


class History(NamedTuple):
    """A named step or other history."""

    name: str
    time: NDArray[np.float64]  #: From the step on [s].
    values: NDArray[np.float64]
    colour: str
    dash: Dash = "solid"


def law_title(name: str) -> str:
    """Of a shipped law."""
    return load_law(name).title


def printed(
    law: str, dof: str, of: str, colour: str, name: str = "printed", *, table: str = ""
) -> Marks:
    """Printed bandwidths as circles on the gain and on the phase; the last table counts."""
    rows = [
        row
        for row in published_results()
        if (row.law, row.dof, row.of) == (law, dof, of) and table in ("", row.table)
    ]
    gains, phases = (
        [curve(name, [f], [level], colour, marks=True) for f in widths if f]
        for level, widths in (
            (-3.0, [row.gain_bandwidth_hz for row in rows[-1:]]),
            (-90.0, [row.phase_bandwidth_hz for row in rows[-1:]]),
        )
    )
    return gains, phases


def bode(
    responses: Sequence[Response],
    marks: Sequence[Marks] = (),
    *,
    gain_range: tuple[float, float] = (-20.0, 15.0),
    x_range: tuple[float, float] = (0.1, 10.0),
) -> tuple[Panel, Panel]:
    """Gain and phase over frequency, with the lines of -3 dB and -90 deg."""
    measured = [(item, item.response) for item in responses if item.response is not None]
    gains, phases = (
        tuple(
            curve(
                *(item.name, response.frequency, values(response), item.colour, item.dash),
                marks=item.marks,
                within=x_range,
            )
            for item, response in measured
        )
        for values in (lambda r: r.gain_db, lambda r: r.phase_deg)
    )
    gains += tuple(circle for on_gain, _ in marks for circle in on_gain)
    phases += tuple(circle for _, on_phase in marks for circle in on_phase)
    phase = Panel("phase [deg]", phases, (-270.0, 20.0), 45.0, guides=(-90.0,))
    return (
        Panel("gain [dB]", gains, gain_range, 5.0, guides=(-3.0,)),
        phase._replace(x_title="frequency [Hz]", x_range=x_range, x_log=True),
    )


def after_step(record: Record) -> NDArray[np.float64]:
    """Time from the step on [s]."""
    return np.asarray(record.time - getattr(record.signal, "at", 0.0))


def step_history(record: Record, channel: str, along: str) -> NDArray[np.float64]:
    """A channel in in or deg, along a degree of freedom or of a leg as its retraction.

    A positive heave step lowers the platform (z down), so that the legs retract.
    """
    values = dof_history(record, channel, along)
    if along.startswith("leg_"):
        return -units.from_si("in", values)
    return units.from_si("in" if DOFS.index(along) < 3 else "deg", values)


def motion(
    histories: Sequence[History],
    y_title: str,
    x_range: tuple[float, float],
    *,
    x_title: str = "time after the step [s]",
    y_range: tuple[float, float] | None = None,
    height: float = 1.7,
) -> Panel:
    """Histories in one panel."""
    lines = tuple(
        curve(h.name, h.time, h.values, h.colour, h.dash, within=x_range) for h in histories
    )
    return Panel(y_title, lines, y_range, x_title=x_title, x_range=x_range, height=height)


def law_steps(runs: Runs, laws: Sequence[str], along: str, on: On = "model") -> list[History]:
    """The demand and the steps under several laws on one plant."""
    first = runs.case(on, laws[0]).step
    histories = [
        History("demand", after_step(first), step_history(first, "leg_reference", along), GREY)
    ]
    for law, colour in zip(laws, COLOURS, strict=False):
        record = runs.case(on, law).step
        values = step_history(record, "leg_position", along)
        histories.append(History(law_title(law), after_step(record), values, colour))
    return histories
