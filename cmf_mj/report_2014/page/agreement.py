"""How many printed results are met.

Every printed number counts once, however often the report prints it. A law whose step rings on has
no bandwidth and no damping ratio, and so agrees with no printed one. Deviations are relative, those
of damping ratios too.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Annotated, NamedTuple

import numpy as np

from cmf_mj.analysis.measures import Measures
from cmf_mj.core.result import Field, Result, fields_of, number
from cmf_mj.report_2014.page.runs import Runs
from cmf_mj.report_2014.page.tables import (
    BANDWIDTHS,
    RATIO,
    TITLES,
    TOLERANCES,
    PageTable,
    ResultRow,
    computed_text,
    page_table,
    remarks_once,
    result_rows,
    texts,
)


class Agreement(NamedTuple):
    """What of a class of printed numbers is met."""

    what: Annotated[str, Field(title="")]
    printed: Annotated[int, Field(form="d")]  #: How many numbers are printed.
    within_5: Annotated[float, Field(title="within 5 %", form=".0f %", unit="%")]
    """Share of them that is off by at most so much; likewise those that follow."""
    within_10: Annotated[float, Field(title="10 %", form=".0f %", unit="%")]
    within_15: Annotated[float, Field(title="15 %", form=".0f %", unit="%")]
    median: Annotated[float, Field(title="median deviation", form="+.1f %", unit="%")]
    below: Annotated[float, Field(title="below the print", form=".0f %", unit="%")]
    """Share of those computed that lie below the print."""


def once(rows: Iterable[ResultRow]) -> list[ResultRow]:
    """The rows without the numbers that the report prints once more."""
    seen = {(r.law, r.label, r.of, r.quantity, r.printed, r.read): r for r in reversed([*rows])}
    return [*reversed(seen.values())]


def share_met(what: str, rows: Collection[ResultRow], *, swept: bool = False) -> Agreement:
    """Shares of rows, of ringing laws the bandwidths of their sweeps if `swept`."""
    off = np.array([(r.swept if swept else r.computed) / r.printed - 1.0 for r in rows])
    known = off[np.isfinite(off)]
    values = [np.mean(np.abs(off) <= limit + 1e-9) for limit in (0.05, 0.10, 0.15)]
    values += [np.median(known), np.mean(known < 0.0)]
    return Agreement(what, len(rows), *map(float, values))


def agreements(runs: Runs) -> Result[Agreement]:
    """All classes, from all result tables."""
    rows = once(row for table in TITLES for row in result_rows(runs, table))

    def of(quantities: Collection[str], keep: Callable[[ResultRow], bool]) -> list[ResultRow]:
        numbers = [r for r in rows if r.quantity in quantities and r.printed == r.printed]
        return [row for row in numbers if keep(row)]

    widths = of(BANDWIDTHS, lambda row: row.read)
    literal = of(BANDWIDTHS, lambda row: not row.read)
    literal += [row for row in widths if row.law not in {other.law for other in literal}]
    classes = [
        share_met("bandwidths", widths),
        share_met("of them calibrated", [row for row in widths if row.calibrated]),
        share_met("of them predicted", [row for row in widths if not row.calibrated]),
        *(share_met(f"of them {name}", of((name,), lambda row: row.read)) for name in BANDWIDTHS),
        share_met("bandwidths, sweeps that ring read too", widths, swept=True),
        share_met("bandwidths, gains and filter as printed", literal),
        share_met("damping ratios, all predicted", of((RATIO,), lambda row: row.read)),
    ]
    printed, met = not_available(runs)
    (note,) = texts("agreement", printed=printed, met=met)
    return Result(classes, fields_of(Agreement), "Share of the printed numbers that are met", note)


def not_available(runs: Runs) -> tuple[int, int]:
    """How many -3 dB are printed as N/A, and how many of these ours does not reach either."""
    rows = [row for table in TITLES for row in result_rows(runs, table)]
    blank = [row for row in rows if row.read and row.printed != row.printed]
    return len(blank), sum(row.within for row in blank)


def verdict_table(runs: Runs, names: Sequence[str]) -> PageTable:
    """Verdicts by result table; of laws as read, not of their gains as printed."""
    rows = []
    for name in names:
        verdicts = [row.within for row in result_rows(runs, name) if row.read]
        rows.append((name, f"{verdicts.count(True)}", f"{verdicts.count(False)}"))
    return page_table("verdicts", rows, note=TOLERANCES)


_LAWS = ("position_error_rate", "acceleration", "acceleration_d2")


def outside_table(runs: Runs) -> PageTable:
    """What lies outside its tolerance, of laws as read."""
    rows = []
    for name in TITLES:
        far = [row for row in once(result_rows(runs, name)) if row.read and not row.within]
        for row in remarks_once(far):
            what, printed = f"{row.label}, {row.of}: {row.quantity}", f"{row.printed:g} {row.unit}"
            printed = printed.rstrip() if row.printed == row.printed else "N/A"
            why = row.note or ("" if row.stable else "the step rings on")
            rows.append((name, what, printed, computed_text(row, row.unit), why))
    return page_table("outside", rows)


def _phase(measures: Measures) -> str:
    return number(measures.phase_bandwidth_hz, ".1f Hz") if measures.stable else "unstable"


def _rotation(runs: Runs) -> list[PageTable | str]:
    """-90 deg in rotation: as Table D-2 has it, of single legs, of the hexapod."""
    rows: list[Sequence[str]] = []
    for row in result_rows(runs, "D-2"):
        if row.read and row.quantity == "-90 deg" and row.label in ("roll", "pitch", "yaw"):
            cases = [runs.case("machine", law, row.label) for law in _LAWS]
            ours = [runs.case("model", "acceleration_d2", row.label), *cases]
            rows.append((row.label, f"{row.printed:g} Hz", *(_phase(one.measures) for one in ours)))
    as_read, as_printed = (sum(row[i] == "unstable" for row in rows) for i in (-1, -2))
    numbers = {"as_read": as_read, "as_printed": as_printed, "axes": len(rows)}
    return [*texts("rotation", **numbers), page_table("rotation", rows)]


def first_screen(runs: Runs) -> list[PageTable | str]:
    """The first screen of a page with everything in it."""
    rows = [row for name in TITLES for row in result_rows(runs, name) if row.read]
    blank, met = not_available(runs)
    lead = texts("summary", numbers=len(once(rows)), blank=blank, met=met)
    return [
        *lead,
        PageTable("agreement", agreements(runs).table),
        *_rotation(runs),
        outside_table(runs),
    ]
