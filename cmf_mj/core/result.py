"""What a study returns: rows, the fields that are declared of them once, and where they come from.

A field names a column of the data frame and says how to print it. The frame, CSV, Parquet and JSON
have every field that has a name, in SI; the table in the terminal and in Markdown has those that
are printed, in the unit of the field.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import pairwise
from operator import and_
from pathlib import Path
from typing import Any, Generic, TypeVar, get_type_hints

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_json, write_text
from cmf_mj.core.tables import write_csv, write_parquet

_ROW = "row of the table"  #: Column of row numbers.


def column(table: pa.Table, name: str) -> NDArray[np.float64]:
    """A column as floats, NaN where it is empty."""
    return np.array(table[name].cast(pa.float64()).to_numpy(zero_copy_only=False))


def where(table: pa.Table, **equal: Any) -> pa.Table:
    """Rows that have these values."""
    return table.filter(reduce(and_, (pc.field(name) == value for name, value in equal.items())))


def groups(table: pa.Table, *names: str) -> Iterator[tuple[tuple[Any, ...], pa.Table]]:
    """Rows that are alike in some columns, in the order of their first: values, and the rows.

    >>> table = pa.table({"law": ["b", "a", "b"], "damping": [0.1, 0.2, 0.3]})
    >>> [(*law, column(rows, "damping").tolist()) for law, rows in groups(table, "law")]
    [('b', [0.1, 0.3]), ('a', [0.2])]
    """
    numbered = table.append_column(_ROW, pa.array(np.arange(table.num_rows)))
    grouped = numbered.group_by(names, use_threads=False).aggregate([(_ROW, "list")]).to_pylist()
    row_lists = {tuple(group[name] for name in names): group[f"{_ROW}_list"] for group in grouped}
    for values, rows in sorted(row_lists.items(), key=lambda item: min(item[1])):
        yield values, table.take(rows)


Column = Sequence[str]
"""A title alone, for text; or a title and a format, for numbers and what stands at the right."""

Cell = str | float | None


def number(value: Cell, form: str = "") -> str:
    """A cell as text, a dash for NaN and None; a unit may follow the format after a space.

    What rounds to zero has no minus sign.

    >>> number(-0.01, ".1f %"), number(float("nan"), ".1f %"), number("unstable", ".1f %")
    ('0.0 %', '-', 'unstable')
    """
    if isinstance(value, str):
        return value
    if value is None or value != value:
        return "-"
    spec, _, unit = form.partition(" ")
    text = f"{value:{spec}}"
    if not set(text) & set("123456789i"):  # the last is of inf
        text = f"{abs(value):{spec}}"
    return f"{text} {unit}".rstrip()


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

    def column_groups(self) -> list["Table"]:
        """A table a group of columns, the first ones before each, for a terminal that is narrow.

        A group is a title of two lines and those after it whose first line is empty.
        """
        heads = self.header
        starts = [i for i, head in enumerate(heads) if head.find("\n") > 0]
        if len(starts) < 2:
            return [self]
        tables, common = [], range(starts[0])
        for start, stop in pairwise([*starts, len(heads)]):
            chosen = [*common, *range(start, stop)]
            table = replace(
                self,
                title=self.title if start == common.stop else "",
                caption=self.caption if stop == len(heads) else "",
                rows=[[row[i] for i in chosen] for row in self.rows],
                columns=[self.columns[i] for i in chosen],
            )
            tables.append(table)
        return tables

    def __rich__(self) -> Any:
        """The table for the terminal."""
        import rich.table
        from rich.box import SIMPLE_HEAD
        from rich.markup import escape

        table = rich.table.Table(
            title=escape(self.title),
            caption=escape(self.caption),
            caption_justify="left",
            box=SIMPLE_HEAD,
            pad_edge=False,
        )
        for column in self.columns:
            if isinstance(column, str):
                table.add_column(escape(column), overflow="fold")
            else:
                table.add_column(escape(column[0]), justify="right", no_wrap=True)
        label: str | None = None
        for first, *others in self.cells:
            is_repeated = self.grouped and first == label
            if label is not None and self.grouped and not is_repeated:
                table.add_section()
            label = first
            table.add_row(*map(escape, ["" if is_repeated else first, *others]))
        return table

    def markdown(self) -> str:
        """The table in Markdown; line breaks in the header become spaces."""
        titles = [title.replace("\n", " ").strip() for title in self.header]
        rows = [titles, ["---"] * len(titles), *self.cells]
        escaped = ([cell.replace("|", r"\|") for cell in row] for row in rows)
        return "".join(f"| {' | '.join(row)} |\n" for row in escaped)

    def save(self, path: Path) -> Path:
        """Write cells as text: as CSV, or Markdown below its title and above its caption."""
        if path.suffix == ".csv":
            return write_csv(path, self.header, self.cells)
        parts = (self.title and f"# {self.title}\n", self.markdown(), self.caption + "\n")
        return write_text(path, "\n".join(part for part in parts if part.strip()))


RowT = TypeVar("RowT")

_KEY = "cmf_mj_result"


@dataclass(frozen=True)
class Field:
    """A quantity of every row.

    >>> load = Field("load_n", "load [kN]", ".1f", "kN", of="largest.value")
    >>> load.text(12345.6)
    '12.3'
    """

    name: str = ""  #: Column of frame and files; empty for what is only printed.
    title: str | None = None  #: Head of the column where it is printed; by default the name.
    form: str | Callable[[Any], str] | None = None
    """Format of a number, which may end in a unit, see `number`; or what makes it text."""
    unit: str = ""  #: In which it is printed; the frame has SI.
    of: str | Callable[[Any], Any] = ""
    """Path of attributes and entries that leads from a row to the value, by default the name; or
    what takes it from a row."""
    printed: bool = True  #: Whether the table has it, beside the frame.
    about: str = ""  #: What it is, where a table explains its rows.

    def value(self, row: Any) -> Any:
        """The value of a row; None where the path ends before."""
        if callable(self.of):
            return self.of(row)
        for part in (self.of or self.name).split("."):
            if row is not None:
                row = row[part] if isinstance(row, Mapping) else getattr(row, part)
        return row

    def text(self, value: Any) -> str:
        """A value as it is printed."""
        if callable(self.form):
            return self.form(value)
        if self.unit and value is not None:
            value = units.from_si(self.unit, value)
        return number(value, self.form or "")

    @property
    def header(self) -> str:
        """Title of the printed column."""
        return self.name.replace("_", " ") if self.title is None else self.title

    @property
    def column(self) -> Column:
        """Head of the printed column: numbers stand at the right."""
        return (self.header, "") if isinstance(self.form, str) else self.header


def lines(row: Any, fields: Iterable[Field]) -> list[tuple[str, str, str]]:
    """A row as a table of its own: title, value and meaning of each printed field."""
    return [
        (field.header.replace("\n", " "), field.text(field.value(row)), field.about)
        for field in fields
        if field.printed
    ]


def fields_of(row: type) -> tuple[Field, ...]:
    """The fields of a class of rows: its attributes, printed as their annotations say.

    >>> class Loop(NamedTuple):
    ...     law: str
    ...     phase_hz: Annotated[float, Field(title="-90 deg", form=".1f Hz")]
    >>> print(Result([Loop("velocity", 2.75)], fields_of(Loop)))
    | law | -90 deg |
    | --- | --- |
    | velocity | 2.8 Hz |
    """
    fields = []
    for name, hint in get_type_hints(row, include_extras=True).items():
        annotations = getattr(hint, "__metadata__", ())
        field = next((entry for entry in annotations if isinstance(entry, Field)), Field())
        fields.append(replace(field, name=name))
    return tuple(fields)


@dataclass(frozen=True)
class Result(Sequence[RowT], Generic[RowT]):
    """Rows of a study with their fields; a sequence of the rows, and a data frame of them.

    >>> from cmf_mj.core.result import Field, Result
    >>> fields = Field("law"), Field("bandwidth_hz", "-90 deg", ".1f Hz")
    >>> rows = [{"law": "velocity", "bandwidth_hz": 2.75}, {"law": "force", "bandwidth_hz": 4.0}]
    >>> result = Result(rows, fields)
    >>> print(result)
    | law | -90 deg |
    | --- | --- |
    | velocity | 2.8 Hz |
    | force | 4.0 Hz |
    >>> result.to_pandas()["bandwidth_hz"].max()
    np.float64(4.0)
    """

    rows: Sequence[RowT]
    fields: Sequence[Field]
    title: str = ""
    caption: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Where the rows come from, as JSON values; Parquet and JSON keep it."""
    grouped: bool = False  #: As of `Table`.
    digits: int = 9  #: Significant digits of numbers in CSV.

    def __getitem__(self, index: Any) -> Any:
        """A row, or rows of a slice."""
        return self.rows[index]

    def __len__(self) -> int:
        """How many rows."""
        return len(self.rows)

    def __iter__(self) -> Iterator[RowT]:
        """The rows."""
        return iter(self.rows)

    def __str__(self) -> str:
        """The table in Markdown."""
        return self.table.markdown().rstrip()

    def __rich__(self) -> Any:
        """The table for the terminal."""
        return self.table.__rich__()

    @cached_property
    def frame(self) -> pa.Table:
        """All named fields, in SI."""
        named = [field for field in self.fields if field.name]
        return pa.table({field.name: [field.value(row) for row in self.rows] for field in named})

    @property
    def table(self) -> Table:
        """All printed fields, as text."""
        printed = [field for field in self.fields if field.printed]
        cells = [[field.text(field.value(row)) for field in printed] for row in self.rows]
        columns = [field.column for field in printed]
        return Table(self.title, columns, cells, self.caption, grouped=self.grouped)

    @property
    def turned(self) -> Table:
        """The first row as a table of its own, a line a field."""
        head = ("measure", "value", "definition")
        return Table(self.title, head, lines(self.rows[0], self.fields), self.caption)

    def to_pandas(self) -> Any:
        """The frame as one of pandas, which must be installed."""
        return self.frame.to_pandas()

    def save(self, path: Path) -> Path:
        """Write the frame as CSV, Parquet or JSON, or the table as Markdown, by the name's end.

        CSV leaves empty what is missing or NaN. Parquet and JSON have titles, units and provenance.
        """
        fields = {f.name: {"title": f.title, "unit": f.unit} for f in self.fields if f.name}
        header = {"title": self.title, "fields": fields, "provenance": dict(self.provenance)}
        rows = self.frame.to_pylist()
        match path.suffix:
            case ".md":
                return self.table.save(path)
            case ".parquet":
                return write_parquet(self.frame, path, (_KEY, header))
            case ".json":
                content = header | {"rows": rows}
                return write_json(path, to_jsonable_python(content, inf_nan_mode="null"))
            case ".csv":
                cells = ([None if cell != cell else cell for cell in row.values()] for row in rows)
                return write_csv(path, self.frame.column_names, cells, self.digits)
        raise InputError(f"{path}: must end in .md, .csv, .parquet or .json")
