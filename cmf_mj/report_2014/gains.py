"""The report's tables of gains as printed, to compare with. They never enter a computation."""

from functools import lru_cache
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator

from cmf_mj.analysis.published import Names
from cmf_mj.core.settings import Settings, as_tuples, read_toml, validated

_FILE = Path(__file__).with_suffix(".toml")

Numbers = Annotated[tuple[float, ...], BeforeValidator(as_tuples)]
"""A list of numbers of a table."""


class PublishedGains(Settings):
    """One set of compensator gains as printed; units as in `control/laws.toml`."""

    table: str
    law: str
    a: float
    b: Numbers  #: B, a column a signal.
    c: float
    d: Numbers  #: D, a column a signal.
    signals: Names  #: What the columns act on.


@lru_cache
def published_gains() -> tuple[PublishedGains, ...]:
    """All gain tables, in the report's order."""
    rows = read_toml(_FILE)["gains"]
    return tuple(
        validated(PublishedGains, row, f"{_FILE.name}: gains {i}") for i, row in enumerate(rows)
    )
