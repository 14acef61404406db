"""What the figures of all chapters are made of: frequency responses, steps, histories."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse, dof_history
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.machine.dof import dof_unit
from cmf_mj.record.record import Record
from cmf_mj.show.report_2014.chart import COLOURS, GREY, Chart, Curve, Dash, Panel, curve
from cmf_mj.show.report_2014.runs import On, Runs, Wanted

PLANT_TITLES: dict[On, str] = {"model": "single legs", "machine": "hexapod"}
"""Names of the plants in legends."""

STAND_IN = (
    "Hardware: a simulated stand-in, the hexapod with the GFD and the hardware set; "
    "no recording of the machine is used."
)
"""Said in every caption that stands for hardware data."""

MODEL = "Non-linear model: six single legs with the report set."

CIRCLES = "Circles: bandwidths as printed."


class ReportFigure(NamedTuple):
    """A figure of the report, and how ours is made."""

    number: str
    title: str
    needs: tuple[Wanted, ...]  #: Runs it is drawn from.
    draw: Callable[[Runs], Chart]
    sensors: bool = False  #: Whether it needs the accelerometers' readings.

    @property
    def anchor(self) -> str:
        """Of the page."""
        return f"figure-{self.number}"


class Response(NamedTuple):
    """A named frequency response."""

    name: str
    response: FrequencyResponse | None
    colour: str
    dash: Dash = "solid"
    marks: bool = False


def law_title(name: str) -> str:
    """Of a shipped law."""
    return load_law(name).title


def printed(
    law: str, dof: str, of: str, colour: str, name: str = "", *, table: str = ""
) -> tuple[list[Curve], list[Curve]]:
    """Printed bandwidths as circles on the gain and on the phase; the last table counts."""
    rows = [
        row
        for row in published_results()
        if (row.law, row.dof, row.of) == (law, dof, of) and table in ("", row.table)
    ]
    gains, phases = [], []
    for row in rows[-1:]:
        label = name or "printed"
        if row.gain_bandwidth_hz:
            gains.append(curve(label, [row.gain_bandwidth_hz], [-3.0], colour, marks=True))
        if row.phase_bandwidth_hz:
            phases.append(curve(label, [row.phase_bandwidth_hz], [-90.0], colour, marks=True))
    return gains, phases


def bode(
    responses: Sequence[Response],
    marks: Sequence[tuple[list[Curve], list[Curve]]] = (),
    *,
    gain_range: tuple[float, float] = (-20.0, 15.0),
    x_range: tuple[float, float] = (0.1, 10.0),
) -> tuple[Panel, Panel]:
    """Gain and phase over frequency, with the lines of -3 dB and -90 deg."""
    gains: list[Curve] = []
    phases: list[Curve] = []
    for item in responses:
        if item.response is None:
            continue
        for lines, values in (
            (gains, item.response.gain_db),
            (phases, item.response.phase_deg),
        ):
            lines.append(
                curve(
                    item.name,
                    item.response.frequency,
                    values,
                    item.colour,
                    item.dash,
                    marks=item.marks,
                    within=x_range,
                )
            )
    for on_gain, on_phase in marks:
        gains += on_gain
        phases += on_phase
    return (
        Panel("gain [dB]", tuple(gains), gain_range, 5.0, guides=(-3.0,)),
        Panel(
            "phase [deg]",
            tuple(phases),
            (-270.0, 20.0),
            45.0,
            guides=(-90.0,),
            x_title="frequency [Hz]",
            x_range=x_range,
            x_log=True,
        ),
    )


class History(NamedTuple):
    """A named step or other history."""

    name: str
    time: NDArray[np.float64]  #: From the step on [s].
    values: NDArray[np.float64]
    colour: str
    dash: Dash = "solid"


def after_step(record: Record) -> NDArray[np.float64]:
    """Time from the step on [s]."""
    return np.asarray(record.time - record.metadata["command"]["at"])


def step_history(record: Record, channel: str, along: str) -> NDArray[np.float64]:
    """A channel in in or deg, along a degree of freedom or of a leg as its retraction.

    A positive heave step lowers the platform (z down), so that the legs retract.
    """
    if along.startswith("leg_"):
        return -units.from_si("in", dof_history(record, channel, along))
    return units.from_si(dof_unit(along), dof_history(record, channel, along))


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


def law_steps(
    runs: Runs, laws: Sequence[str], along: str, on: On = "model", dof: str = "heave"
) -> list[History]:
    """The demand and the steps under several laws on one plant."""
    first = runs.case(on, laws[0], dof).step
    found = [
        History("demand", after_step(first), step_history(first, "leg_reference", along), GREY)
    ]
    for law, colour in zip(laws, COLOURS, strict=False):
        record = runs.case(on, law, dof).step
        found.append(
            History(
                law_title(law),
                after_step(record),
                step_history(record, "leg_position", along),
                colour,
            )
        )
    return found


def law_responses(
    runs: Runs, laws: Sequence[str], on: On = "model", dof: str = "heave"
) -> list[Response]:
    """The responses under several laws on one plant."""
    return [
        Response(law_title(law), runs.case(on, law, dof).response, colour)
        for law, colour in zip(laws, COLOURS, strict=False)
    ]


def cases(on: On, laws: Sequence[str], dofs: Sequence[str] = ("heave",)) -> tuple[Wanted, ...]:
    """Chirp and step of several laws."""
    return tuple(Wanted(on, law, dof) for law in laws for dof in dofs)
