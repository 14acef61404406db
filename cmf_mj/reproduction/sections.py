"""The sections of the page, in order. A section is a function from what was run to its blocks.

A section that is left out of `SECTIONS` is left out of the page and of its contents; a new one is a
function and its entry.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

from cmf_mj.parameters import Quantity
from cmf_mj.published import published_results
from cmf_mj.record import Record
from cmf_mj.reproduction import force, statements
from cmf_mj.reproduction.blocks import (
    Block,
    Content,
    PageFigure,
    PageTable,
    Section,
    TableRow,
    Text,
    Verdict,
)
from cmf_mj.reproduction.ledger_section import calibration, ledger
from cmf_mj.reproduction.runs import CAB, HYDRAULICS, Runs, hydraulics_of
from cmf_mj.reproduction.tables import (
    TITLES,
    TOLERANCES,
    ResultRow,
    gain_rows,
    limit_rows,
    printed_number,
    result_rows,
)
from cmf_mj.studies import CaseResult


def result_table(runs: Runs, table: str) -> PageTable:
    """A result table as the page shows it."""
    rows = result_rows(runs, table)
    title = f"Table {table}" if table[0] != "s" else table.capitalize()
    appendix = table.startswith("D-")
    common = ("", "of", "quantity", "printed", "computed", "deviation", "allowed", "verdict")
    header = (*common, "hexapod", "remark") if appendix else (*common, "remark")
    return PageTable(
        f"table-{table.replace(' ', '-')}",
        f"{title}: {TITLES[table]}",
        header,
        _said_once(_result_cells(row, appendix) for row in rows),
        TOLERANCES,
    )


def _said_once(rows: Iterable[TableRow]) -> tuple[TableRow, ...]:
    """Rows whose remark, the last cell, repeats only as a reference to the first."""
    seen: set[str] = set()
    found = []
    for row in rows:
        remark = row.cells[-1]
        again = len(remark) > 40 and remark in seen
        seen.add(remark)
        found.append(row._replace(cells=(*row.cells[:-1], "as above")) if again else row)
    return tuple(found)


def _result_cells(row: ResultRow, appendix: bool) -> TableRow:
    relative = row.unit == "Hz"

    def share(value: float, sign: str) -> str:
        if value != value:
            return "–"
        return f"{100.0 * value:{sign}.1f} %" if relative else f"{value:{sign}.2f}"

    verdict: Verdict = "reported" if row.within is None else "within" if row.within else "outside"
    cells = [
        row.label,
        row.of,
        f"{row.quantity} [{row.unit}]" if row.unit else row.quantity,
        "N/A" if row.printed != row.printed else f"{row.printed:g}",
        f"{row.computed:.2f}" if row.computed == row.computed else "none below 10 Hz",
        share(row.deviation, "+"),
        share(row.tolerance, ""),
        verdict,
    ]
    if appendix:
        cells.append(f"{row.hexapod:.2f}" if row.hexapod == row.hexapod else "–")
    return TableRow((*cells, row.note), verdict)


def gains_table(number: str) -> PageTable:
    """A gain table beside the shipped law."""
    rows = []
    for row in gain_rows():
        if row.table != number:
            continue
        verdict: Verdict = "within" if row.same else "outside" if not row.note else "reported"
        printed = "not printed here" if row.printed != row.printed else f"{row.printed:g}"
        said = "same" if row.same else "differs"
        rows.append(
            TableRow((row.law, row.gain, printed, f"{row.shipped:g}", said, row.note), verdict)
        )
    return PageTable(
        f"table-{number}",
        f"Table {number}: gains",
        ("law", "gain", "printed", "in use", "", "remark"),
        tuple(rows),
        "In use: laws.toml. Units: % per in, Pa, in/s, in s, in/s², lbf.",
    )


def limits_table() -> PageTable:
    """Table 2-1 beside the geometry."""
    rows = tuple(
        TableRow(
            (
                row.dof,
                f"{row.mechanical:+g} {row.unit}",
                f"{row.operational:+g} {row.unit}",
                f"{row.computed:+.1f} {row.unit}",
                f"{100.0 * row.deviation:+.1f} %",
                row.note,
            ),
            "reported",
        )
        for row in limit_rows()
    )
    return PageTable(
        "table-2-1",
        "Table 2-1: displacement limits",
        ("", "mechanical", "operational", "where a leg reaches ±37.5 in", "deviation", "remark"),
        rows,
        "z down: positive heave lowers. The computed excursion is along one axis from neutral. The "
        "printed limits are used as they are; the deviation is from the mechanical one.",
    )


def _figures(content: Content, prefix: str) -> list[PageFigure]:
    return [
        PageFigure(
            figure.anchor, f"Figure {figure.number}: {figure.title}", figure.draw(content.runs)
        )
        for figure in content.figures
        if figure.number.startswith(prefix)
    ]


def _tables(content: Content, *numbers: str) -> list[PageTable]:
    return [result_table(content.runs, number) for number in numbers if number in content.tables]


def about(content: Content) -> Section:
    """What the page is, and how the plants are read."""
    quick = (
        "Quick version: sweeps of 30 s for 100 s and shorter rounds; bandwidths move by about 2 %."
    )
    lines = [
        "Figures and result tables of Investigation and Development of Control Laws for the NASA "
        "Langley Research Center Cockpit Motion Facility (June 2014), made anew by simulation. "
        "Printed results stand beside ours and enter no computation.",
        "Non-linear model: the report's own plant, six uncoupled legs, with the report set of "
        "hydraulics. Hardware: no recording is available; a simulated stand-in takes its place, "
        "the "
        "hexapod with the Generic Flight Deck and the hardware set, which was calibrated on the "
        "hardware rows of Tables 2-4 and 2-6. Frequency responses go from DCL leg demand to leg "
        "feedback; host and DCU, with their delay, are outside.",
        TOLERANCES,
    ]
    if content.runs.quick:
        lines.append(quick)
    return Section("about", "About this page", tuple(Text(line) for line in lines))


def chapter_2(content: Content) -> Section:
    """Axes, original law, velocity feedback."""
    blocks: list[Block] = [limits_table(), gains_table("2-2"), gains_table("2-5")]
    blocks += [*_tables(content, "2-4", "2-6"), *_figures(content, "2-")]
    return Section("chapter-2", "Chapter 2: the facility and its first laws", tuple(blocks))


def chapter_3(content: Content) -> Section:
    """New compensators."""
    blocks: list[Block] = [gains_table(number) for number in ("3-1", "3-3", "3-4")]
    blocks += [*_tables(content, "section 3.2.2", "3-2", "3-5"), *_figures(content, "3-")]
    return Section("chapter-3", "Chapter 3: new compensators", tuple(blocks))


def steady_state(content: Content) -> Section:
    """The velocity law's offset, and the integral that removes it."""
    rows = tuple(
        TableRow(
            (
                row.law,
                row.formula or "integral",
                f"{row.dc_gain:.3f}",
                f"{row.model:.3f}",
                f"{row.machine:.3f}",
            )
        )
        for row in statements.rest_rows(content.runs)
    )
    table = PageTable(
        "steady-states",
        "Where a heave step of 1 in ends, over the demand",
        (
            "law",
            "gain of the demand over net gain of the position",
            "its value",
            "single legs",
            "hexapod",
        ),
        rows,
        "Mean of the last second of the run. The pressure gains add the change of the static "
        "pressures, which is small.",
    )
    text = Text(
        "At rest the compensator's output is nearly zero, so that the leg stops where the gain of "
        "the demand balances the net gain of the position, D_p + C B_p/(1 - A): -50.48 %/in for "
        "Table 2-5, whose 47 %/in on the demand leaves 7 % of every step undone. The report saw "
        "the "
        "offset in Figure 2-16 and ignored it at first; the error integral of section 3.2 removes "
        "it on both plants, without changing the bandwidths much (Figures 3-2 to 3-4)."
    )
    return Section("steady-state", "The offset, and the integral that removes it", (text, table))


def force_feedback(content: Content) -> Section:
    """The oscillation of section 3.4.2."""
    found = force.readings(content.runs)
    number = printed_number
    readings = tuple(
        TableRow(
            (
                r.title,
                f"{r.gain:+.3g}",
                f"{number(r.linear.pole_hz)} / {r.linear.pole_damping:+.3f}",
                f"{number(r.linear.crossover_hz)} / {number(r.linear.crossover_gain, 2)}",
                number(r.cycle_hz),
                f"{r.pressure:.0f}",
                f"{r.acceleration:.1f}",
                number(r.bandwidths.phase_hz),
                number(r.bandwidths.gain_hz),
                f"{r.bandwidths.peak_db:.1f}",
            )
        )
        for r in found
    )
    printed = next(
        r for r in published_results() if r.law == "force" and r.phase_bandwidth_hz is not None
    )
    readings += (
        TableRow(
            (
                *("printed", "", "", "", f"{force.REPORTED_HZ:g}", "", f"{force.REPORTED_G:g}"),
                *(f"{printed.phase_bandwidth_hz:g}", f"{printed.gain_bandwidth_hz:g}", "about 1"),
            ),
            "reported",
        ),
    )
    first = PageTable(
        "force-readings",
        "Force feedback on single legs, report set: readings of the gain",
        (
            *("reading", "%/lbf", "poles [Hz] / damping", "crossover [Hz] / gain"),
            *("limit cycle [Hz]", "± [psi]", "acceleration [g]", "-90 deg [Hz]", "-3 dB [Hz]"),
            "peak [dB]",
        ),
        readings,
        "Poles, crossover: of the linear loop. Limit cycle, pressure, acceleration: last 4 s of "
        "the "
        "simulated step of 1 in. Bandwidths: simulated chirp of 0.33 in.",
    )
    second = PageTable(
        "force-variations",
        "The printed gains on other plants, linear loop",
        ("plant", "poles [Hz]", "damping", "crossover [Hz]", "gain there"),
        tuple(
            TableRow(
                (
                    v.title,
                    number(v.linear.pole_hz),
                    f"{v.linear.pole_damping:+.3f}",
                    number(v.linear.crossover_hz),
                    number(v.linear.crossover_gain, 2),
                )
            )
            for v in force.variations()
        ),
    )
    texts = (
        f"The report's force feedback oscillates at about {force.REPORTED_HZ:g} Hz with more than "
        f"{force.REPORTED_G:g} g. Ours oscillates too, undiminished, at "
        f"{number(found[0].cycle_hz)} Hz "
        f"with {found[0].acceleration:.1f} g and a pressure difference of "
        f"±{found[0].pressure:.0f} psi, "
        "while its frequency response agrees with Table 3-5. The cause is not the force signal: "
        "with "
        "position error rate gain 6 alone the oil mode grows faster. Force opposing it raises the "
        "mode's frequency and slows its growth, but does not stop it.",
        "25 Hz cannot be had from this plant. Above the oil mode the force lags the spool's "
        "opening "
        "by 90 deg; the command lags of 3 and 75 Hz turn it by another 90 deg at sqrt(3 x 75) = 15 "
        "Hz, 14 Hz with the computing frame and the hold. There feedback of force stops "
        "opposing and "
        "starts driving, whatever its gain. A larger gain moves the unstable poles up: read as "
        "% per "
        "newton, or with the pressure in kPa, they have 21 and 25 Hz in the linear loop. But the "
        "command then clamps, the limit cycle falls back to 16 Hz, and the frequency response "
        "loses "
        "all likeness to the report's. With the printed gains, 25 Hz needs oil some three times as "
        "stiff, which contradicts the leg mode of Eq 4.1, or lags that Eqs 4.1 and 4.4 exclude.",
        "So the oscillation is reproduced, its frequency is not, and the printed gains are "
        "right by "
        "every other number of the report. Two swings a cycle, counted in a figure, would make "
        "13.7 "
        "into 27 Hz; a valve that passes nothing below a pressure drop, which section 2.4.1 "
        "describes "
        "and no number fixes, might also drive the pressures faster. The figures that could "
        "tell are "
        "not available.",
    )
    blocks: list[Block] = [Text(texts[0]), first, Text(texts[1])]
    blocks.append(
        PageFigure("figure-force", "Least damped poles over the force gain", force.gain_chart())
    )
    blocks += [second, Text(texts[2])]
    return Section("force", "Force feedback and the oscillation of section 3.4.2", tuple(blocks))


def chapter_4(content: Content) -> Section:
    """Linear models."""
    blocks: list[Block] = [*_tables(content, "4-1"), *_figures(content, "4-")]
    return Section("chapter-4", "Chapter 4: linear models of the hardware", tuple(blocks))


def text_numbers(content: Content) -> Section:
    """Numbers of the text."""
    rows = tuple(
        TableRow(
            (
                s.section,
                s.what,
                f"{s.printed} {s.unit}",
                f"{printed_number(s.computed)} {s.unit}",
                s.remark,
            )
        )
        for s in statements.statements(content.runs)
    )
    table = PageTable(
        "text-numbers",
        "Numbers stated in the text",
        ("section", "what", "printed", "computed", "remark"),
        rows,
    )
    return Section("text", "Numbers in the text", (table,))


def appendix_b(content: Content) -> Section:
    """Original and velocity feedback in all degrees of freedom."""
    return Section(
        "appendix-b", "Appendix B: original and velocity feedback", tuple(_figures(content, "B-"))
    )


def appendix_d(content: Content) -> Section:
    """Rate and acceleration feedback in the other degrees of freedom."""
    blocks: list[Block] = [*_tables(content, "D-1", "D-2"), *_figures(content, "D-")]
    return Section("appendix-d", "Appendix D: the other degrees of freedom", tuple(blocks))


def _parameter_table(name: str, values: Mapping[str, Quantity]) -> PageTable:
    rows = tuple(
        TableRow((key.replace("_", " "), f"{q.value:g} {q.unit}", q.status, q.source))
        for key, q in values.items()
    )
    return PageTable(
        f"parameters-{name}",
        f"Hydraulics: {name}",
        ("parameter", "value", "status", "source"),
        rows,
        "Stated: printed in the report; derived: follows from printed numbers; calibrated: "
        "fitted to "
        "printed results; assumed: nobody published it.",
    )


def parameters(content: Content) -> Section:
    """All hydraulic numbers with their status."""
    tables = tuple(
        _parameter_table(HYDRAULICS[on], hydraulics_of(on).quantities())
        for on in ("model", "machine")
    )
    return Section("parameters", "Parameters and their status", tables)


def _records(runs: Runs) -> Sequence[Record]:
    found = []
    for result in runs.results.values():
        kept = (
            result
            if isinstance(result, tuple) and not isinstance(result, CaseResult)
            else (result,)
        )
        found += [item.step if isinstance(item, CaseResult) else item for item in kept]
    return found


def provenance(content: Content) -> Section:
    """What made the page: models, versions, seed."""
    rows: dict[tuple[str, ...], None] = {
        ("seed", str(content.runs.seed)): None,
        ("cab of the hexapod", CAB.upper()): None,
        ("runs", str(len(content.runs.results))): None,
    }
    for record in _records(content.runs):
        meta = record.metadata
        rows[(f"model digest, {meta['plant']}", str(meta["model_digest"]))] = None
        for key, value in sorted(meta["versions"].items()):
            rows[(f"version, {key}", str(value))] = None
    table = PageTable(
        "provenance-table", "Made by", ("", ""), tuple(TableRow(cells) for cells in rows)
    )
    return Section("provenance", "Models, versions and seed", (table,))


SECTIONS: tuple[Callable[[Content], Section], ...] = (
    about,
    chapter_2,
    chapter_3,
    steady_state,
    force_feedback,
    chapter_4,
    text_numbers,
    appendix_b,
    appendix_d,
    ledger,
    calibration,
    parameters,
    provenance,
)
"""The page, in order."""

STUDIES = (steady_state, force_feedback, text_numbers, calibration)
"""Sections shown only with all figures and tables, since they need runs of their own."""
