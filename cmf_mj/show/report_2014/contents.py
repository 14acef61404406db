"""What the page is made of: its texts, captions and heads of tables, read from `contents.toml`."""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from cmf_mj.core.settings import read_toml
from cmf_mj.show.chart import Panel
from cmf_mj.show.report_2014.runs import Runs, RunSpec
from cmf_mj.show.table import Table

CONTENTS: Mapping[str, Any] = read_toml(Path(__file__).with_suffix(".toml"))
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
    """A figure with the caption of this name."""
    caption = CONTENTS["caption"][name].format(**(CONTENTS["words"] | values))
    return PageFigure(anchor, title, tuple(panels), caption)


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
