"""The ledger: its form, its page and its command."""

import ast
import re
import runpy
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from cmf_mj.cli.common import app
from cmf_mj.core.settings import validated
from cmf_mj.report_2014.ledger import LedgerEntry, ledger_entry, load_ledger

TESTS = Path(__file__).parents[1]


def test_every_entry_has_its_test_and_every_demonstration_its_entry() -> None:
    """A demonstration is a test that asks for the fixture `entry`."""
    there = {
        f"{path.relative_to(TESTS.parent)}::{node.name}"
        for path in TESTS.rglob("test_*.py")
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
        and node.name.startswith("test_")
        and "entry" in (argument.arg for argument in node.args.args)
    }
    assert sorted(there) == sorted(entry.demonstration for entry in load_ledger())


def test_numbers_run_from_one_and_titles_differ() -> None:
    entries = load_ledger()
    assert [entry.number for entry in entries] == list(range(1, len(entries) + 1))
    assert len({entry.title for entry in entries}) == len(entries)


def test_unknown_requests_are_named() -> None:
    with pytest.raises(ValueError, match="number: 0 is not one of 1 to "):
        ledger_entry(0)
    with pytest.raises(ValueError, match="figure: 'age' is not one of entry 1's: heave down"):
        ledger_entry(1).figure("age")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"figures": [{"name": "n", "value": 1.0, "unit": "furlong"}]}, "unit: 'furlong'"),
        ({"demonstration": "by eye"}, "entry 1: demonstration: 'by eye' is refused"),
    ],
)
def test_refused_entries_are_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        validated(LedgerEntry, load_ledger()[0].model_dump() | change, "entry 1")


def test_page_is_what_the_data_give() -> None:
    """docs/reference/ledger.md holds the text that scripts/update_docs.py makes."""
    page = (TESTS.parent / "docs" / "reference" / "ledger.md").read_text(encoding="utf-8")
    script = runpy.run_path(str(TESTS.parent / "scripts" / "update_docs.py"))
    assert f"<!-- data: ledger -->\n\n{script['ledger']()}\n<!-- end -->" in page


@pytest.mark.parametrize(("arguments", "count"), [([], None), (["3"], 1)])
def test_command_prints_entries(arguments: list[str], count: int | None) -> None:
    result = CliRunner().invoke(app, ["report", "ledger", *arguments])
    assert result.exit_code == 0, result.output
    rows = [line for line in result.output.splitlines() if "B = 0.1709" in line]
    assert len(rows) == 1
    numbers = [int(one) for one in re.findall(r"^ +(\d+)   \S", result.output, re.MULTILINE)]
    every = [entry.number for entry in load_ledger()]
    assert numbers == ([3] if count else every)
