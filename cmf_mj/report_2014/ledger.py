"""The ledger: misprints and contradictions of the 2014 report, and what this project does.

The entries are in `ledger.toml`, numbered by their place: a new entry moves the numbers of all
after it. Every entry names a test that shows the claim in numbers. Its figures are the numbers that
the test computes; the fixture `entry` of `tests/conftest.py` checks that the test asks for all of
them. `cmf report ledger` prints the ledger, docs/reference/ledger.md is made from it.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Table
from cmf_mj.core.settings import Settings, read_toml, validated

_FILE = Path(__file__).with_suffix(".toml")

_Text = Annotated[str, Field(min_length=1)]


class LedgerFigure(Settings):
    """A number that the finding rests on, as its demonstration computes it."""

    name: _Text
    value: float
    unit: str  #: Unit known to `cmf_mj.core.units`; `1` for a ratio, `dB` for a level.

    @field_validator("unit")
    @classmethod
    def _check_unit(cls, unit: str) -> str:
        if unit != "dB":
            units.factor(unit)
        return unit

    def __str__(self) -> str:
        """Name, value and unit."""
        return f"{self.name}: {self.value:g}" + (f" {self.unit}" if self.unit != "1" else "")


class LedgerEntry(Settings):
    """One misprint or contradiction."""

    number: Annotated[int, Field(ge=1)]
    """Place in the ledger, from 1 on, in the order of the report."""
    title: _Text
    where: _Text  #: Section, table or equation of the report.
    printed: _Text  #: What the report says.
    finding: _Text  #: What is wrong with it.
    project: _Text  #: What this project does.
    demonstration: Annotated[
        str, Field(pattern=r"^tests/report_2014/test_ledger\w*\.py::test_\w+$")
    ]
    """The test that shows it in numbers."""
    figures: Annotated[tuple[LedgerFigure, ...], Field(strict=False)] = ()  #: Of that test.

    def figure(self, name: str) -> float:
        """The value of a figure; a name that the entry lacks is refused."""
        values = {figure.name: figure.value for figure in self.figures}
        if name not in values:
            known = ", ".join(values) or "none"
            raise InputError(f"figure: {name!r} is not one of entry {self.number}'s: {known}")
        return values[name]


@lru_cache
def load_ledger() -> tuple[LedgerEntry, ...]:
    """All entries, in the order of the report."""
    return tuple(
        validated(LedgerEntry, row | {"number": i}, f"{_FILE.name}: entry {i}")
        for i, row in enumerate(read_toml(_FILE)["entry"], start=1)
    )


def ledger_entry(number: int) -> LedgerEntry:
    """The entry of a number; one that is not there is refused."""
    entries = load_ledger()
    if not 1 <= number <= len(entries):
        raise InputError(f"number: {number} is not one of 1 to {len(entries)}")
    return entries[number - 1]


def figures_text(entry: LedgerEntry) -> str:
    """The figures of an entry in one line."""
    return "; ".join(str(figure) for figure in entry.figures)


def ledger_table(entries: Sequence[LedgerEntry]) -> Table:
    """One row an entry: what is printed, what is wrong with it, what the project does."""
    columns = (("no.", ""), "where", "printed", "finding", "figures", "what we do")
    rows = [
        (str(e.number), e.where, e.printed, e.finding, figures_text(e), e.project) for e in entries
    ]
    return Table("misprints and contradictions of the report", columns, rows)
