"""The ledger: its form, its page and its command."""

import ast
import re
import runpy
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cmf_mj.cli.common import app
from cmf_mj.report_2014 import ledger
from cmf_mj.report_2014.ledger import ledger_entry, load_ledger

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
        ({"unit": "furlong"}, "entry 1: figures.0.unit: 'furlong' is refused: unit: 'furlong'"),
        ({"demonstration": "by eye"}, "entry 1: demonstration: 'by eye' is refused"),
        ({"finding": ""}, "entry 1: finding: '' is refused"),
    ],
)
def test_refused_entries_are_named(
    change: dict[str, str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = {
        "title": "t",
        "where": "w",
        "printed": "p",
        "finding": "f",
        "project": "p",
        "demonstration": "tests/report_2014/test_ledger.py::test_x",
    } | {name: value for name, value in change.items() if name != "unit"}
    figures = [{"name": "n", "value": 1.0, "unit": change.get("unit", "1")}]
    monkeypatch.setattr(ledger, "read_toml", lambda _: {"entry": [entry | {"figures": figures}]})
    with pytest.raises(ValueError, match=message):
        load_ledger.__wrapped__()


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


def test_command_refuses_an_unknown_entry() -> None:
    result = CliRunner().invoke(app, ["report", "ledger", "999"])
    assert result.exit_code == 2
    assert "number: 999 is not one of 1 to" in result.output
