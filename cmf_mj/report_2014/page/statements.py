"""Numbers of the report's text; how many printed results are met.

Every printed number counts once, however often the report prints it. A law whose step rings on has
no bandwidth and no damping ratio, and so agrees with no printed one. Deviations are relative, those
of damping ratios too.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Annotated, NamedTuple

import numpy as np

from cmf_mj.analysis.linear.loop import closed_loop, loop_step
from cmf_mj.analysis.measures import Measures
from cmf_mj.core import units
from cmf_mj.core.result import Field, Result, fields_of, number
from cmf_mj.report_2014.models import bandwidth_example, characteristics, hardware_velocity
from cmf_mj.report_2014.page.runs import Runs, leg_motion, specs
from cmf_mj.report_2014.page.tables import (
    BANDWIDTHS,
    CONTENTS,
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
from cmf_mj.signals.single import Step

STATEMENT_NEEDS = specs(
    "model original,velocity_integral,force",
    "machine original,velocity_integral",
    "machine velocity heave rise",
)
"""Runs of the numbers."""


def _values(runs: Runs) -> dict[str, float]:
    """What runs and formulas give, by the names that `contents.toml` has for it."""
    gravity = units.STANDARD_GRAVITY
    model, machine = runs.case("model", "original"), runs.case("machine", "original")
    with_integral = runs.case("machine", "velocity_integral").measures
    ringing, force = runs.case("model", "velocity_integral").step, runs.case("model", "force")
    late = ringing.time > ringing.signal_as(Step).at + 1.0
    example = bandwidth_example()
    reference = leg_motion(runs.record("machine", "velocity", "rise"), "leg_reference", "in")
    values = {
        "machine_overshoot": 100.0 * machine.measures.overshoot,
        "model_overshoot": 100.0 * model.measures.overshoot,
        "integral_overshoot": 100.0 * with_integral.overshoot,
        "integral_error": 100.0 * abs(with_integral.steady_state_error),
        "late_acceleration": float(np.abs(ringing["leg_acceleration"][late]).max()) / gravity,
        "rate_bandwidth": characteristics(example["rate"]).gain_bandwidth_hz,
        "acceleration_bandwidth": characteristics(example["acceleration"]).gain_bandwidth_hz,
        "force_peak": force.measures.peak_gain_db,
        "force_acceleration": float(np.abs(force.step["leg_acceleration"]).max()) / gravity,
        "leg_extension": float(reference[-1]),
    }
    for which in (1, 2):
        _, step = loop_step(closed_loop("velocity", hardware_velocity(which)), 3.0)
        values[f"peak_{which}"] = float(step.max()) * float(reference[-1])
    if runs.sensors is not None:
        numbers = runs.sensors.numbers
        values |= {"rest_reading": numbers["mean"], "filter_delay": numbers["delay"]}
    return values


def statement_rows(runs: Runs) -> list[tuple[str, ...]]:
    """All numbers of the text that a run or a formula gives; NaN is a peak of legs that ring on."""
    values, rows = _values(runs), list[tuple[str, ...]]()
    for entry in CONTENTS["statement"]:
        if entry["value"] in values:
            value, unit = values[entry["value"]], entry["unit"]
            ours = f"{value:.3g} {unit}" if value == value else "unstable"
            printed = f"{entry['printed']} {unit}"
            rows.append((entry["section"], entry["what"], printed, ours, entry["remark"]))
    return rows


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
