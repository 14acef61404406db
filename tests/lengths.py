"""How long a search for counterexamples goes on: in `make test`, `make test-all`, `make search`."""

from hypothesis import settings

LONG, WHOLE = "long", "whole"  #: Hypothesis profiles of `make test-all` and `make search`.

_SHARE, _TIMES = 5, 10
"""The short search has one in so many examples of the long one, the whole so many times as many."""


def examples(number: int) -> int:
    """Number of examples of a property test whose long search has `number`."""
    profile = settings.get_current_profile_name()
    if profile == WHOLE:
        return _TIMES * number
    return number if profile == LONG else -(-number // _SHARE)
