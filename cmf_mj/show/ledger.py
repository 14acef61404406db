"""The ledger for the terminal and as the body of docs/ledger.md."""

import textwrap
from collections.abc import Sequence

from rich.table import Table

from cmf_mj.analysis.ledger import LedgerEntry
from cmf_mj.show.comparison import markdown

_WIDTH = 116


def figures_text(entry: LedgerEntry) -> str:
    """The figures of an entry in one line."""
    return "; ".join(str(figure) for figure in entry.figures)


def ledger_table(entries: Sequence[LedgerEntry]) -> Table:
    """One row an entry: what is printed, what is wrong with it, what the project does."""
    table = Table(title="misprints and contradictions of the report", show_lines=True)
    for name in ("no.", "where", "printed", "finding", "figures", "what we do"):
        table.add_column(name, justify="right" if name == "no." else "left", overflow="fold")
    for entry in entries:
        table.add_row(
            str(entry.number),
            entry.where,
            entry.printed,
            entry.finding,
            figures_text(entry),
            entry.project,
        )
    return table


def ledger_markdown(entries: Sequence[LedgerEntry]) -> str:
    """A list of contents as a table, then a section an entry."""
    contents = markdown(
        ("no.", "where", "what"),
        ([str(entry.number), entry.where, entry.title] for entry in entries),
    )
    return contents + "".join(f"\n{_section(entry)}" for entry in entries)


def _section(entry: LedgerEntry) -> str:
    points = (
        ("Printed", entry.printed),
        ("Finding", entry.finding),
        ("Figures", figures_text(entry)),
        ("Here", entry.project),
        ("Shown by", f"`{entry.demonstration}`"),
    )
    lines = [
        textwrap.fill(f"- {name}: {text}.", _WIDTH, subsequent_indent="  ", break_long_words=False)
        for name, text in points
    ]
    return f"## {entry.number}. {entry.title}\n\n{entry.where}.\n\n" + "\n".join(lines) + "\n"
