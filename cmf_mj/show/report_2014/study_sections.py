"""Sections on single questions: the offset at rest, force feedback, the numbers of the text."""

from cmf_mj.analysis.published import published_results
from cmf_mj.show.report_2014 import force, statements
from cmf_mj.show.report_2014.blocks import (
    Block,
    Content,
    PageFigure,
    PageTable,
    Section,
    TableRow,
    Text,
)
from cmf_mj.show.report_2014.tables import printed_number


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
        "all likeness to the report's. With the printed gains, 25 Hz needs oil three to five "
        "times as "
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
