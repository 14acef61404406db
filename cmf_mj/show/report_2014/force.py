"""Force feedback: why the legs oscillate, how fast, and what the report's 25 Hz would need."""

from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.linear.oscillation import Oscillation, limit_cycle, oscillation
from cmf_mj.analysis.measures import Measures
from cmf_mj.analysis.published import published_results
from cmf_mj.show.chart import Chart, Panel, curve
from cmf_mj.show.look import COLOURS
from cmf_mj.show.report_2014.contents import (
    CONTENTS,
    Block,
    PageFigure,
    PageTable,
    TableRow,
    captioned,
    table,
    texts,
)
from cmf_mj.show.report_2014.runs import FORCE_READINGS, Runs, RunSpec, hydraulics_of, law_of
from cmf_mj.show.report_2014.tables import printed_number as number

REPORTED_HZ, REPORTED_G = 25.0, 3.0
"""Of the oscillation in Figures 3-20 and 3-21, section 3.4.2."""


class Reading(NamedTuple):
    """One reading of the force gain: linear loop, simulated step, simulated response."""

    title: str
    gain: float  #: [%/lbf].
    linear: Oscillation
    cycle_hz: float
    """Of the pressure difference in the last seconds of the step; NaN where it has died down."""
    pressure: float  #: Its amplitude [psi].
    acceleration: float  #: Largest leg acceleration in these seconds [g].
    measures: Measures  #: Of chirp and step.


def force_law(reading: str) -> str:
    """Name of the law with this reading; the first reading is the shipped law."""
    return "force" if reading == next(iter(FORCE_READINGS)) else f"force:{reading}"


FORCE_NEEDS = tuple(RunSpec("model", force_law(reading)) for reading in FORCE_READINGS)
"""Runs of the study."""


def readings(runs: Runs) -> list[Reading]:
    """All readings of the gain."""
    parameters = hydraulics_of("model")
    rows = []
    for title, gain in FORCE_READINGS.items():
        name = force_law(title)
        result = runs.case("model", name)
        linear = oscillation(law_of(name), parameters)
        rows.append(Reading(title, gain, linear, *limit_cycle(result.step), result.measures))
    return rows


def variations() -> dict[str, Oscillation]:
    """The printed gains around plants with other oil, lags and leakage, by title."""
    law, base = law_of("force"), hydraulics_of("model")
    results = {}
    for change in CONTENTS["variation"]:
        quantity = getattr(base, change["field"])
        varied = quantity.model_copy(update={"value": change.get("value", quantity.value)})
        parameters = base.model_copy(update={change["field"]: varied})
        results[change["title"]] = oscillation(law, parameters)
    return results


def _gain_chart() -> Chart:
    """Frequency and damping of the least damped pair over the force gain."""
    parameters = hydraulics_of("model")
    sizes = np.geomspace(0.1, 10.0, 41)
    base = law_of("force")

    def at(size: float) -> Oscillation:
        gains = base.direct_gain.model_copy(update={"force": -0.01 * float(size)})
        return oscillation(base.model_copy(update={"direct_gain": gains}), parameters)

    poles, damping, crossover, _ = zip(*map(at, sizes), strict=True)
    frequencies = (
        curve("unstable poles", sizes, poles, COLOURS[0]),
        curve("phase crossover", sizes, crossover, COLOURS[1], "dash"),
    )
    ratio = Panel(
        "damping ratio of the poles",
        (curve("unstable poles", sizes, damping, COLOURS[0]),),
        guides=(0.0,),
        x_title="force gain over the printed 0.01 % per lbf",
        x_range=(0.1, 10.0),
        x_log=True,
    )
    frequency = Panel("frequency [Hz]", frequencies, (5.0, 30.0), guides=(REPORTED_HZ,))
    return captioned("force_gain", (frequency, ratio), {})


def _readings_table(rows: list[Reading]) -> PageTable:
    cells: list[TableRow | tuple[str, ...]] = [
        (
            r.title,
            f"{r.gain:+.3g}",
            f"{number(r.linear.pole_hz)} / {r.linear.pole_damping:+.3f}",
            f"{number(r.linear.crossover_hz)} / {number(r.linear.crossover_gain, 2)}",
            number(r.cycle_hz),
            f"{r.pressure:.0f}",
            f"{r.acceleration:.1f}",
            number(r.measures.phase_bandwidth_hz),
            number(r.measures.gain_bandwidth_hz),
            f"{r.measures.peak_gain_db:.1f}",
        )
        for r in rows
    ]
    printed = next(
        r for r in published_results() if r.law == "force" and r.phase_bandwidth_hz is not None
    )
    widths = (f"{printed.phase_bandwidth_hz:g}", f"{printed.gain_bandwidth_hz:g}", "about 1")
    last = ("printed", "", "", "", f"{REPORTED_HZ:g}", "", f"{REPORTED_G:g}", *widths)
    return table("force-readings", [*cells, TableRow(last, "reported")])


def blocks(runs: Runs) -> list[Block]:
    """The section on the oscillation of section 3.4.2."""
    rows = readings(runs)
    first, second, third = texts(
        "force",
        reported_hz=REPORTED_HZ,
        reported_g=REPORTED_G,
        cycle_hz=number(rows[0].cycle_hz),
        acceleration=rows[0].acceleration,
        pressure=rows[0].pressure,
    )
    title = "Least damped poles over the force gain"
    changed = [
        (
            *(plant, number(linear.pole_hz), f"{linear.pole_damping:+.3f}"),
            *(number(linear.crossover_hz), number(linear.crossover_gain, 2)),
        )
        for plant, linear in variations().items()
    ]
    return [
        *(first, _readings_table(rows), second),
        *(PageFigure("figure-force", title, _gain_chart()), table("force-variations", changed)),
        third,
    ]
