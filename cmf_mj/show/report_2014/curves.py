"""What the figures of all chapters are made of: frequency responses, steps, histories."""

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse, dof_history
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.record import Record
from cmf_mj.show.chart import GREY, Curve, Dash, Panel
from cmf_mj.show.look import COLOURS
from cmf_mj.show.report_2014.runs import On, Runs

Pair = tuple[Sequence[Curve], Sequence[Curve]]
"""Curves on the gain and on the phase."""


def law_title(name: str) -> str:
    """Of a shipped law."""
    return load_law(name).title


def response(
    name: str,
    measured: FrequencyResponse | None,
    colour: str,
    dash: Dash = "solid",
    marks: bool = False,
) -> Pair:
    """A frequency response; None, where legs left what a platform pose can have, draws nothing."""
    if measured is None:
        return (), ()
    gain, phase = (
        [Curve(name, measured.frequency, values, colour, dash, marks)]
        for values in (measured.gain_db, measured.phase_deg)
    )
    return gain, phase


def printed(
    law: str, dof: str, of: str, colour: str, name: str = "printed", *, table: str = ""
) -> Pair:
    """Printed bandwidths as circles on the gain and on the phase; the last table counts."""
    rows = [
        row
        for row in published_results()
        if row.is_of(law) and (row.dof, row.of) == (dof, of) and table in ("", row.table)
    ][-1:]
    gains, phases = (
        [Curve(name, np.array([f]), np.array([level]), colour, marks=True) for f in widths if f]
        for level, widths in (
            (-3.0, [row.gain_bandwidth_hz for row in rows]),
            (-90.0, [row.phase_bandwidth_hz for row in rows]),
        )
    )
    return gains, phases


def bode(
    pairs: Sequence[Pair],
    gain_range: tuple[float, float] = (-20.0, 15.0),
    x_range: tuple[float, float] = (0.1, 10.0),
) -> tuple[Panel, Panel]:
    """Gain and phase over frequency, with the lines of -3 dB and -90 deg."""
    gains, phases = (tuple(chain(*curves)) for curves in zip(*pairs, strict=True))
    phase = Panel("phase [deg]", phases, (-270.0, 20.0), 45.0, guides=(-90.0,))
    return (
        Panel("gain [dB]", gains, gain_range, 5.0, guides=(-3.0,)),
        phase._replace(x_title="frequency [Hz]", x_range=x_range, x_log=True),
    )


def after_step(record: Record) -> NDArray[np.float64]:
    """Time from the step on [s]; of other signals from the begin."""
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
    y_title: str,
    curves: Sequence[Curve],
    x_range: tuple[float, float],
    x_title: str = "time after the step [s]",
    height: float = 1.7,
) -> Panel:
    """Histories in one panel."""
    return Panel(y_title, tuple(curves), x_title=x_title, x_range=x_range, height=height)


def law_histories(records: Sequence[Record], laws: Sequence[str], along: str) -> list[Curve]:
    """The demand and the motion under several laws."""
    first = records[0]
    return [
        Curve("demand", after_step(first), step_history(first, "leg_reference", along), GREY),
        *(
            Curve(law_title(law), after_step(r), step_history(r, "leg_position", along), colour)
            for r, law, colour in zip(records, laws, COLOURS, strict=False)
        ),
    ]


def law_steps(runs: Runs, laws: Sequence[str], along: str, on: On = "model") -> list[Curve]:
    """The demand and the steps under several laws on one plant."""
    return law_histories([runs.case(on, law).step for law in laws], laws, along)
