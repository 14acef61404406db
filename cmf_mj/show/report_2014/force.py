"""Force feedback: why the legs oscillate, how fast, and what the report's 25 Hz would need."""

from typing import Any

import numpy as np

from cmf_mj.analysis.linear.poles import Oscillation, limit_cycle, oscillation
from cmf_mj.analysis.published import published_results
from cmf_mj.show.chart import Curve, Panel
from cmf_mj.show.look import COLOURS
from cmf_mj.show.report_2014.curves import Block, PageFigure, figure, table, texts
from cmf_mj.show.report_2014.runs import FORCE_READINGS, Runs, RunSpec, hydraulics_of, law_of
from cmf_mj.show.report_2014.tables import printed_number as number

_PRINTED = next(row for row in published_results() if row.acceleration_g is not None)
REPORTED_HZ, REPORTED_G = (
    float(_PRINTED.oscillation_hz or 0.0),
    float(_PRINTED.acceleration_g or 0.0),
)
"""Of the oscillation in Figures 3-20 and 3-21, section 3.4.2."""


def force_law(reading: str) -> str:
    """Name of the law with this reading; the first reading is the shipped law."""
    return "force" if reading == next(iter(FORCE_READINGS)) else f"force:{reading}"


FORCE_NEEDS = tuple(RunSpec("model", force_law(reading)) for reading in FORCE_READINGS)
"""Runs of the study."""


def _readings(runs: Runs) -> list[tuple[Any, ...]]:
    """Each reading of the gain: linear loop, simulated step, simulated response; then the print."""
    rows = []
    for title, gain in FORCE_READINGS.items():
        name = force_law(title)
        result, linear = runs.case("model", name), oscillation(law_of(name), hydraulics_of("model"))
        m = result.measures
        widths = (m.phase_bandwidth_hz, m.gain_bandwidth_hz, m.peak_gain_db)
        rows.append(
            (
                *(title, gain, f"{number(linear.pole_hz)} / {linear.pole_damping:+.3f}"),
                f"{number(linear.crossover_hz)} / {number(linear.crossover_gain, 2)}",
                *limit_cycle(result.step),
                *(widths if m.stable else ("unstable",) * 3),
            )
        )
    printed = next(
        row for row in published_results() if row.law == "force" and row.phase_bandwidth_hz
    )
    known = (printed.phase_bandwidth_hz, printed.gain_bandwidth_hz, "about 1")
    print_row = ("printed", "", "", "", REPORTED_HZ, "", f"{REPORTED_G:g}", *known)
    return [*rows, print_row]


def _gain_figure() -> PageFigure:
    """Frequency and damping of the least damped pair over the force gain."""
    sizes = np.geomspace(0.1, 10.0, 41)
    base = law_of("force")

    def at(size: float) -> Oscillation:
        gains = base.direct_gain.model_copy(update={"force": -0.01 * float(size)})
        return oscillation(base.model_copy(update={"direct_gain": gains}), hydraulics_of("model"))

    poles, damping, crossover, _ = map(np.array, zip(*map(at, sizes), strict=True))
    frequencies = (
        Curve("unstable poles", sizes, poles, COLOURS[0]),
        Curve("phase crossover", sizes, crossover, COLOURS[1], "dash"),
    )
    ratio = Panel(
        "damping ratio of the poles",
        (Curve("unstable poles", sizes, damping, COLOURS[0]),),
        guides=(0.0,),
        x_title="force gain over the printed 0.01 % per lbf",
        x_range=(0.1, 10.0),
        x_log=True,
    )
    frequency = Panel("frequency [Hz]", frequencies, (5.0, 30.0), guides=(REPORTED_HZ,))
    title = "Least damped poles over the force gain"
    return figure("figure-force", title, "force_gain", (frequency, ratio))


def blocks(runs: Runs) -> list[Block]:
    """The section on the oscillation of section 3.4.2."""
    rows = _readings(runs)
    cycle_hz, pressure, acceleration = rows[0][4:7]
    first, second, third = texts(
        "force",
        reported_hz=REPORTED_HZ,
        reported_g=REPORTED_G,
        cycle_hz=number(cycle_hz),
        acceleration=acceleration,
        pressure=pressure,
    )
    return [first, table("force-readings", rows), second, _gain_figure(), third]
