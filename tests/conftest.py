"""Fixtures of several test modules, and one compilation for all workers."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from lengths import LONG

from cmf_mj.analysis.ledger import LedgerEntry, load_ledger

settings.register_profile(LONG)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the loops once, side by side, before workers start."""
    config = session.config
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    if config.getoption("numprocesses", default=None):
        warm = Path(__file__).with_name("warm.py")
        runs = [subprocess.Popen([sys.executable, warm, loop]) for loop in ("table", "chain")]
        if any([run.wait() for run in runs]):
            raise pytest.UsageError(f"{warm.name}: the loops could not be compiled")


@pytest.fixture
def entry(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[LedgerEntry]:
    """The entry of the ledger that the test demonstrates; it must ask for every figure of it."""
    own = f"tests/{request.path.name}::{request.node.name}"
    (found,) = (row for row in load_ledger() if row.demonstration == own)
    asked: set[str] = set()
    figure = LedgerEntry.figure

    def tracked(row: LedgerEntry, name: str) -> float:
        asked.add(name)
        return figure(row, name)

    monkeypatch.setattr(LedgerEntry, "figure", tracked)
    yield found
    assert asked == {row.name for row in found.figures}
