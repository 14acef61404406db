"""What sections are made of."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from cmf_mj.show.report_2014.chart import Chart
from cmf_mj.show.report_2014.curves import ReportFigure
from cmf_mj.show.report_2014.runs import Runs

Verdict = Literal["within", "outside", "reported", ""]


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


class Section(NamedTuple):
    """A section with an entry in the contents."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Content:
    """All that sections are made of."""

    runs: Runs
    figures: tuple[ReportFigure, ...]  #: Figures to show.
    tables: tuple[str, ...]  #: Result tables to show.
    studies: bool
    """Whether the sections on force feedback, steady states and the text's numbers are shown."""
