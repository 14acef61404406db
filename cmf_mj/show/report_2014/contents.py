"""What the page is made of: its texts, captions and heads of tables, read from `contents.toml`."""

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

from cmf_mj.core.settings import read_toml
from cmf_mj.show.chart import Chart, Panel
from cmf_mj.show.report_2014.runs import Runs, RunSpec

CONTENTS: Mapping[str, Any] = read_toml(Path(__file__).with_suffix(".toml"))
"""The tables of `contents.toml`."""

Verdict = Literal["within", "outside", "reported", ""]
VERDICTS: Mapping[bool | None, Verdict] = {True: "within", False: "outside", None: "reported"}


class TableRow(NamedTuple):
    """Cells of a line and its verdict, which colours it."""

    cells: tuple[str, ...]
    verdict: Verdict = ""


class PageTable(NamedTuple):
    """A table of the page."""

    anchor: str
    title: str
    header: tuple[str, ...]
    rows: tuple[TableRow, ...]
    note: str = ""


class PageFigure(NamedTuple):
    """A figure of the page."""

    anchor: str
    title: str
    chart: Chart


class Text(NamedTuple):
    """A paragraph."""

    text: str


Block = PageTable | PageFigure | Text
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

    def draw(self, runs: Runs) -> Chart:
        """The figure with its caption."""
        panels, values = self.drawing(runs, self)
        return captioned(self.drawing.__name__, panels, values)


class Content(NamedTuple):
    """All that sections are made of."""

    runs: Runs
    figures: tuple[ReportFigure, ...]  #: Figures of the page.
    tables: tuple[str, ...]  #: Result tables of the page.
    studies: bool
    """Whether the page has its sections on force feedback, steady states and the text's numbers."""


def captioned(name: str, panels: Sequence[Panel], values: Mapping[str, Any]) -> Chart:
    """A chart with the caption of this name."""
    caption = CONTENTS["caption"][name].format(**(CONTENTS["words"] | dict(values)))
    return Chart(tuple(panels), caption)


def texts(name: str, **values: Any) -> list[Text]:
    """The paragraphs of this name."""
    return [Text(paragraph.format(**values)) for paragraph in CONTENTS["text"][name]]


def table(
    name: str,
    rows: Sequence[TableRow | tuple[str, ...]],
    *,
    anchor: str = "",
    title: str = "",
    note: str = "",
) -> PageTable:
    """A table with the head of this name; `anchor`, `title` and `note` take the place of its."""
    head = CONTENTS["table"][name]
    lines = tuple(row if isinstance(row, TableRow) else TableRow(row) for row in rows)
    return PageTable(
        anchor or name,
        title or head["title"],
        tuple(head["header"]),
        lines,
        note or head.get("note", ""),
    )


def specs(*lines: str) -> tuple[RunSpec, ...]:
    """Runs from lines of `plant law dof signal`: commas between several; last two heave, case."""
    return tuple(
        RunSpec(*chosen)  # type: ignore[arg-type]
        for line in lines
        for chosen in product(*(part.split(",") for part in line.split()))
    )
