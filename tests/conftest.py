"""Fixtures of several test modules."""

from collections.abc import Iterator

import pytest

from cmf_mj.analysis.ledger import LedgerEntry, load_ledger


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
