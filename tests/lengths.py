"""How long a search for counterexamples goes on: short in `make test`, whole in `make test-all`."""

from hypothesis import settings

LONG = "long"
"""Hypothesis profile of `make test-all`."""

_SHARE = 5
"""The short search has one in this many examples of the long one."""


def examples(number: int) -> int:
    """Number of examples of a property test whose long search has `number`."""
    return number if settings.get_current_profile_name() == LONG else -(-number // _SHARE)
