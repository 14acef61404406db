"""How many of the report's printed results are met: shares of agreement, with nothing left out.

Every printed number counts once, however often the report prints it. A law whose step rings on has
no bandwidth and no damping ratio, and so agrees with no printed one. Deviations are relative, those
of damping ratios too.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from cmf_mj.show.report_2014.contents import PageTable, table, texts
from cmf_mj.show.report_2014.runs import Runs
from cmf_mj.show.report_2014.tables import (
    BANDWIDTHS,
    RATIO,
    TITLES,
    TOLERANCES,
    ResultRow,
    result_rows,
)

LIMITS = (0.05, 0.10, 0.15)
"""Deviations that shares are counted within."""


class Agreement(NamedTuple):
    """What of a class of printed numbers is met."""

    what: str
    printed: int  #: How many numbers are printed.
    shares: tuple[float, ...]  #: Of them, within each of `LIMITS`.
    median: float  #: Of the deviations, signed.
    below: float  #: Share of those computed that lie below the print.


def once(rows: Iterable[ResultRow]) -> list[ResultRow]:
    """The rows without the numbers that the report prints once more."""
    seen = {(r.law, r.label, r.of, r.quantity, r.printed, r.read): r for r in reversed([*rows])}
    return [*reversed(seen.values())]


def agreement(what: str, rows: Collection[ResultRow], *, swept: bool = False) -> Agreement:
    """Shares of rows, of ringing laws the bandwidths of their sweeps if `swept`."""
    off = np.array([(r.swept if swept else r.computed) / r.printed - 1.0 for r in rows])
    known = off[np.isfinite(off)]
    shares = tuple(float(np.mean(np.abs(off) <= limit + 1e-9)) for limit in LIMITS)
    return Agreement(what, len(rows), shares, float(np.median(known)), float(np.mean(known < 0.0)))


def agreements(runs: Runs) -> list[Agreement]:
    """All classes, from all result tables."""
    rows = once(row for table in TITLES for row in result_rows(runs, table))

    def of(quantities: Collection[str], keep: Callable[[ResultRow], bool]) -> list[ResultRow]:
        numbers = [r for r in rows if r.quantity in quantities and r.printed == r.printed]
        return [row for row in numbers if keep(row)]

    widths = of(BANDWIDTHS, lambda row: row.read)
    literal = of(BANDWIDTHS, lambda row: not row.read)
    literal += [row for row in widths if row.law not in {other.law for other in literal}]
    return [
        agreement("bandwidths", widths),
        agreement("of them calibrated", [row for row in widths if row.calibrated]),
        agreement("of them predicted", [row for row in widths if not row.calibrated]),
        *(agreement(f"of them {name}", of((name,), lambda row: row.read)) for name in BANDWIDTHS),
        agreement("bandwidths, sweeps that ring read too", widths, swept=True),
        agreement("bandwidths, gains and filter as printed", literal),
        agreement("damping ratios, all predicted", of((RATIO,), lambda row: row.read)),
    ]


def not_available(runs: Runs) -> tuple[int, int]:
    """How many -3 dB are printed as N/A, and how many of these ours does not reach either."""
    rows = [row for table in TITLES for row in result_rows(runs, table)]
    blank = [row for row in rows if row.read and row.printed != row.printed]
    return len(blank), sum(row.within for row in blank)


def agreement_table(runs: Runs) -> PageTable:
    """`agreements` as the page has them."""
    rows = [
        (one.what, f"{one.printed}", *(100.0 * s for s in (*one.shares, one.median, one.below)))
        for one in agreements(runs)
    ]
    printed, met = not_available(runs)
    return table("agreement", rows, note=texts("agreement", printed=printed, met=met)[0])


def verdict_table(runs: Runs, names: Sequence[str]) -> PageTable:
    """Verdicts by result table; of laws as read, not of their gains as printed."""
    rows = []
    for name in names:
        verdicts = [row.within for row in result_rows(runs, name) if row.read]
        rows.append((name, f"{verdicts.count(True)}", f"{verdicts.count(False)}"))
    return table("verdicts", rows, note=TOLERANCES)
