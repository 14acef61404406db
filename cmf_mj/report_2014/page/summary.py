"""The page's first screen: what is met, what deviates and why, and the answer on rotation."""

from collections.abc import Sequence

from cmf_mj.analysis.measures import Measures
from cmf_mj.core.table import number
from cmf_mj.report_2014.page.curves import Block, Content, PageTable, law_title, table, texts
from cmf_mj.report_2014.page.runs import Runs
from cmf_mj.report_2014.page.statements import (
    agreement_table,
    agreements,
    not_available,
    once,
    verdict_table,
)
from cmf_mj.report_2014.page.tables import TITLES, ResultRow, result_rows

_SHARES = {
    "bandwidths": "all -90 deg and -3 dB",
    "of them calibrated": "calibrated",
    "of them predicted": "predicted",
    "damping ratios, all predicted": "damping ratios, predicted",
}
"""Classes of `agreements`, as the summary names them."""

_LAWS = ("position_error_rate", "acceleration", "acceleration_d2")


def verdict_tables(content: Content) -> list[PageTable]:
    """Verdicts by table, and with all tables the shares of agreement."""
    tables = [verdict_table(content.runs, content.tables)] if content.tables else []
    return tables + ([agreement_table(content.runs)] if _whole(content) else [])


def _whole(content: Content) -> bool:
    return len(content.tables) == len(TITLES)


def _shares(runs: Runs) -> PageTable:
    """Counts within 5, 10, 15 % by class; the last cell is drawn as a bar."""
    rows = []
    for one in agreements(runs):
        if one.what in _SHARES:
            counts = [round(share * one.printed) for share in one.shares]
            bar = " ".join(f"{count / one.printed:.4f}" for count in counts)
            rows.append((_SHARES[one.what], *map(str, (one.printed, *counts)), bar))
    return table("shares", rows)


def _span(rows: Sequence[ResultRow], field: str, form: str) -> str:
    """A number of rows of one quantity with its unit: one, or the lowest to the highest."""
    values = [getattr(row, field) for row in rows]
    known = sorted(value for value in values if value == value)
    ends = dict.fromkeys(f"{value:{form}}" for value in known[:: len(known) - 1 or 1])
    return " ".join([" to ".join(ends), rows[0].unit]).strip() if known else "unstable"


def _deviations(runs: Runs) -> PageTable:
    """What lies outside its tolerance, a row for each table and law."""
    groups: dict[tuple[str, str], dict[str, list[ResultRow]]] = {}
    for name in TITLES:
        for row in once(result_rows(runs, name)):
            if row.read and not row.within:
                groups.setdefault((name, row.law), {}).setdefault(row.quantity, []).append(row)
    rows = []
    for (name, law), found in groups.items():
        count = {quantity: len(same) for quantity, same in found.items()}
        what = ", ".join(q if n == 1 else f"{q} in {n} axes" for q, n in count.items())
        printed, computed = (
            list(dict.fromkeys(_span(same, field, form) for same in found.values()))
            for field, form in (("printed", "g"), ("computed", ".3g"))
        )
        every = [row for same in found.values() for row in same]
        swept = [row for row in every if row.swept == row.swept and not row.stable]
        notes = [row.note for row in every if row not in swept and row.note]
        if swept:
            widths = " and ".join(f"{row.swept:.2f}" for row in swept)
            notes.append(f"the step rings on; its sweep has {widths} Hz all the same")
        cells = (f"{law_title(law)}: {what}", ", ".join(printed), ", ".join(computed))
        rows.append((name, *cells, "; ".join(dict.fromkeys(notes))))
    return table("outside", rows)


def _phase(measures: Measures) -> str:
    return number(measures.phase_bandwidth_hz, ".1f Hz") if measures.stable else "unstable"


def _rotation(runs: Runs) -> list[Block]:
    """-90 deg in rotation: as Table D-2 has it, of single legs, of the hexapod."""
    rows: list[Sequence[str]] = []
    for row in result_rows(runs, "D-2"):
        if row.read and row.quantity == "-90 deg" and row.label in ("roll", "pitch", "yaw"):
            cases = [runs.case("machine", law, row.label) for law in _LAWS]
            ours = [runs.case("model", "acceleration_d2", row.label), *cases]
            rows.append((row.label, f"{row.printed:g} Hz", *(_phase(one.measures) for one in ours)))
    as_read, as_printed = (sum(row[i] == "unstable" for row in rows) for i in (-1, -2))
    numbers = {"as_read": as_read, "as_printed": as_printed, "axes": len(rows)}
    return [*texts("rotation", **numbers), table("rotation", rows)]


def blocks(content: Content, argument: str) -> Sequence[Block]:
    """The summary of a page with everything in it; nothing for a part."""
    if not (content.studies and _whole(content)):
        return []
    runs = content.runs
    rows = [row for name in TITLES for row in result_rows(runs, name) if row.read]
    blank, met = not_available(runs)
    lead = texts("summary", numbers=len(once(rows)), blank=blank, met=met)
    return [*lead, _shares(runs), *_rotation(runs), _deviations(runs)]
