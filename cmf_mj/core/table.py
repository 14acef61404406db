"""One table for the terminal, Markdown and CSV.

A column is a title, or a title and the format of its numbers, with a unit where the cells carry
one: `("-90 deg", ".2f")`, `("share", ".1f %")`. Text stands as it is; a number that is NaN or
missing is a dash.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cmf_mj.core.files import write_csv, write_text

if TYPE_CHECKING:
    import rich.table

Column = Sequence[str]
"""A title alone, for text; or a title and a format, for numbers and what stands at the right."""

Cell = str | float | None


def number(value: Cell, form: str = "") -> str:
    """A cell as text, a dash for NaN and None; a unit may follow the format after a space.

    >>> number(0.1234, ".1f %"), number(float("nan"), ".1f %"), number("unstable", ".1f %")
    ('0.1 %', '-', 'unstable')
    """
    if isinstance(value, str):
        return value
    if value is None or value != value:
        return "-"
    spec, _, unit = form.partition(" ")
    return f"{value:{spec}} {unit}".rstrip()


@dataclass(frozen=True)
class Table:
    """Rows below a header.

    >>> print(Table("", ("law", ("-90 deg", ".2f")), [("velocity", 4.0)]).markdown(), end="")
    | law | -90 deg |
    | --- | --- |
    | velocity | 4.00 |
    """

    title: str
    columns: Sequence[Column]
    rows: Collection[Sequence[Any]]  #: Each of cells: text, numbers, None for none.
    caption: str = ""
    grouped: bool = False
    """In the terminal, write a first cell that repeats only once, and rule the groups off."""
    rules: Collection[int] = ()  #: Rows to draw a rule above in the terminal.
    ruled: bool = False  #: Draw a rule between all rows in the terminal.

    @property
    def header(self) -> list[str]:
        """Titles of the columns."""
        return [column if isinstance(column, str) else column[0] for column in self.columns]

    @property
    def cells(self) -> list[list[str]]:
        """Rows as text."""
        forms = ["" if isinstance(column, str) else column[1] for column in self.columns]
        return [
            [number(cell, form) for cell, form in zip(row, forms, strict=True)] for row in self.rows
        ]

    def __rich__(self) -> "rich.table.Table":
        """The table for the terminal."""
        import rich.table
        from rich.box import HEAVY_HEAD, SIMPLE_HEAD
        from rich.markup import escape

        table = rich.table.Table(
            title=escape(self.title),
            caption=escape(self.caption),
            caption_justify="left",
            box=HEAVY_HEAD if self.ruled else SIMPLE_HEAD,
            show_lines=self.ruled,
            pad_edge=False,
        )
        for column in self.columns:
            if isinstance(column, str):
                table.add_column(escape(column), overflow="fold")
            else:
                table.add_column(escape(column[0]), justify="right", no_wrap=True)
        first = ""
        for index, row in enumerate(self.cells):
            repeats = self.grouped and row[0] == first
            if index and (index in self.rules or (self.grouped and not repeats)):
                table.add_section()
            first = row[0]
            table.add_row(*map(escape, ["", *row[1:]] if repeats else row))
        return table

    def markdown(self) -> str:
        """The table in Markdown; line breaks in the header become spaces."""
        titles = [title.replace("\n", " ").strip() for title in self.header]
        rows = [titles, ["---"] * len(titles), *self.cells]
        return "".join("| " + " | ".join(row) + " |\n" for row in rows)

    def save(self, path: Path) -> Path:
        """Write the table, its cells as text, as Markdown or CSV by the name's end."""
        if path.suffix == ".csv":
            return write_csv(path, self.header, self.cells)
        return write_text(path, self.markdown())
