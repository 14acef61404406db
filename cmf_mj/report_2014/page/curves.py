"""What the page is made of, as `contents.toml` has it; responses and histories of figures."""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.measurable import CLEAR, dof_history
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.core.result import Table
from cmf_mj.core.settings import read_toml
from cmf_mj.machine.geometry import DOFS
from cmf_mj.record.record import Record
from cmf_mj.report_2014.page.runs import On, Runs, RunSpec
from cmf_mj.show.look import COLOURS, GREY, Curve, Dash, Marks, Panel
from cmf_mj.studies.case import CaseResult

CONTENTS: Mapping[str, Any] = read_toml(Path(__file__).with_name("contents.toml"))
"""The tables of `contents.toml`."""

VERDICTS = {True: "within", False: "outside"}


class PageTable(NamedTuple):
    """A table of the page; the verdict of a row stands in the column of this name."""

    anchor: str
    table: Table


class PageFigure(NamedTuple):
    """A figure of the page."""

    anchor: str
    title: str
    panels: tuple[Panel, ...]
    caption: str


Block = PageTable | PageFigure | str
"""A string is a paragraph."""

Drawing = tuple[Sequence[Panel], dict[str, Any]]
"""Panels of a figure, and what its caption fills in."""


class Section(NamedTuple):
    """A section with an entry in the contents."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]


class ReportFigure(NamedTuple):
    """A figure of the report, and how ours is made."""

    number: str
    title: str
    drawing: Callable[[Runs, "ReportFigure"], Drawing]
    needs: tuple[RunSpec, ...] = ()  #: Runs it is drawn from.
    sensors: bool = False  #: Whether it needs the accelerometers' readings.
    options: Mapping[str, Any] = {}  #: What one drawing function does differently in each figure.

    @property
    def laws(self) -> tuple[str, ...]:
        """Laws of its runs."""
        return tuple(dict.fromkeys(need.law for need in self.needs))

    def draw(self, runs: Runs) -> PageFigure:
        """The figure with its caption."""
        panels, values = self.drawing(runs, self)
        title = f"Figure {self.number}: {self.title}"
        name = self.options.get("caption", self.drawing.__name__)
        return figure(f"figure-{self.number}", title, name, panels, **values)


class Content(NamedTuple):
    """All that sections are made of."""

    runs: Runs
    figures: tuple[ReportFigure, ...]  #: Figures of the page.
    tables: tuple[str, ...]  #: Result tables of the page.
    studies: bool
    """Whether the page has its sections on force feedback, steady states and the text's numbers."""


def figure(
    anchor: str, title: str, name: str, panels: Sequence[Panel], **values: Any
) -> PageFigure:
    """A figure with the caption of this name, which also says what circles and pale curves are."""
    words, curves = CONTENTS["words"], [curve for panel in panels for curve in panel.curves]
    caption = [CONTENTS["caption"][name].format(**(words | values))]
    caption += [words["circles"]] if any(curve.marks == "ring" for curve in curves) else []
    caption += [words["pale"].format(clear=CLEAR)] if any(curve.pale for curve in curves) else []
    return PageFigure(anchor, title, tuple(panels), " ".join(caption))


def texts(name: str, **values: Any) -> list[str]:
    """The paragraphs of this name."""
    return [paragraph.format(**values) for paragraph in CONTENTS["text"][name]]


def table(
    name: str, rows: Collection[Sequence[Any]], anchor: str = "", title: str = "", note: str = ""
) -> PageTable:
    """A table with the head of this name; `title` and `note` are for heads that have none."""
    head = {"title": title, "note": note} | CONTENTS["table"][name]
    return PageTable(anchor or name, Table(head["title"], head["header"], rows, head["note"]))


def specs(*lines: str) -> tuple[RunSpec, ...]:
    """Runs from lines of `plant law dof signal`: commas between several; last two heave, case."""
    return tuple(
        RunSpec(*chosen)  # type: ignore[arg-type]
        for line in lines
        for chosen in product(*(part.split(",") for part in line.split()))
    )


Pair = tuple[Sequence[Curve], Sequence[Curve]]
"""Curves on the gain and on the phase."""


def law_title(name: str) -> str:
    """Of a shipped law."""
    return load_law(name).title


def case_title(result: CaseResult, plant: str = "") -> str:
    """The law, the plant if named, and `unstable` where the step rings on."""
    parts = (result.case.law.title, plant, "" if result.measures.stable else "unstable")
    return ", ".join(part for part in parts if part)


def response(
    name: str,
    measured: FrequencyResponse | None,
    colour: str,
    dash: Dash = "solid",
    marks: Marks = "",
    *,
    stable: bool = True,
) -> Pair:
    """A frequency response, pale where its coherence is below `CLEAR` or all of it if not `stable`.

    None, where legs left what a platform pose can have, draws nothing.
    """
    if measured is None:
        return (), ()
    clear = stable & ~(measured.coherence < CLEAR)
    ends = np.flatnonzero(np.diff(clear, prepend=False, append=False))
    stretches = [slice(*pair) for pair in ends.reshape(-1, 2)]

    def drawn(values: NDArray[np.floating]) -> list[Curve]:
        whole = Curve(name, measured.frequency, values, colour, dash, marks, pale=True)
        parts = [whole._replace(x=whole.x[s], y=values[s], pale=False) for s in stretches]
        return parts if clear.all() else [whole, *parts]

    return drawn(measured.gain_db), drawn(measured.phase_deg)


def case_response(result: CaseResult, colour: str, dash: Dash = "solid", plant: str = "") -> Pair:
    """The frequency response of a case."""
    title, stable = case_title(result, plant), result.measures.stable
    return response(title, result.response, colour, dash, stable=stable)


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
        [Curve(name, np.array([f]), np.array([level]), colour, marks="ring") for f in widths if f]
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


def law_histories(records: Sequence[Record], titles: Sequence[str], along: str) -> list[Curve]:
    """The demand and the motion under several laws."""
    first = records[0]
    return [
        Curve("demand", after_step(first), step_history(first, "leg_reference", along), GREY),
        *(
            Curve(title, after_step(r), step_history(r, "leg_position", along), colour)
            for r, title, colour in zip(records, titles, COLOURS, strict=False)
        ),
    ]


def law_steps(runs: Runs, laws: Sequence[str], along: str, on: On = "model") -> list[Curve]:
    """The demand and the steps under several laws on one plant."""
    results = [runs.case(on, law) for law in laws]
    return law_histories([r.step for r in results], [*map(case_title, results)], along)
